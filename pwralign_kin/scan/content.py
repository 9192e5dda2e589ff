"""What a scan file holds, before any cleaning."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

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


Index = TypeVar("Index", bound=np.generic)


def fans(polygons: NDArray[Index]) -> NDArray[Index]:
    """Return the polygons (f, k) as fans of triangles (f (k - 2), 3); none for points and edges."""
    steps = [polygons[:, [0, i, i + 1]] for i in range(1, polygons.shape[1] - 1)]
    return np.concatenate([polygons[:0, :1].repeat(3, axis=1), *steps])
