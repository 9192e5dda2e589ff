"""Types of arrays; that of numbers in double precision is `se3.Array`."""

import numpy as np
from numpy.typing import NDArray

Singles = NDArray[np.float32]
"""Coordinates, distances and scores, as kernels take them."""
Ints = NDArray[np.int32]
"""Numbers of parts, joints and points, as kernels take them."""
Indices = NDArray[np.int64]
"""Rows of other arrays, and whole numbers at large."""
Bools = NDArray[np.bool_]
"""Which rows of another array."""
Image = NDArray[np.uint8]
"""(h, w) or (h, w, 3)."""
