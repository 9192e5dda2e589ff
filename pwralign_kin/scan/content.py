"""What a scan file holds, before any cleaning."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pwralign_kin.se3 import Array


@dataclass(frozen=True)
class FileContent:
    """The arrays of a scan file, in the file's unit."""

    points: Array
    """(n, 3) points, possibly with non-finite ones."""

    normals: Array | None = None
    """(n, 3) normals, if the file has any."""

    sensor_origin: Array | None = None
    """(3,) or (n, 3) where the points were seen from, if the file tells."""

    faces: NDArray[np.int64] | None = None
    """(f, 3) triangles of a scanned mesh whose vertices are `points`; None for a point cloud."""
