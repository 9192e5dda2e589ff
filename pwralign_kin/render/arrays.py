"""Arrays of pictures and meshes."""

import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]
Indices = NDArray[np.int64]
Singles = NDArray[np.float32]
