"""Rigid registration without a start by KISS-Matcher (Lim et al., ICRA 2025).

Set up as its example for Python has it: nothing but the voxel size is given
(https://github.com/MIT-SPARK/KISS-Matcher/blob/main/python/examples/run_kiss_matcher.py).
"""

from __future__ import annotations

import numpy as np

from pwralign_kin.dependencies import peer
from pwralign_kin.exceptions import ScanError
from pwralign_kin.se3 import Array

NORMAL_RADIUS = 3.0
"""Radius in which it takes normals, voxels: its default."""

LEAST_NEIGHBOURS = 3
"""Points within that radius that half of the points must have: where none has, it crashes the process."""


def kiss_matcher(source: Array, target: Array, voxel: float) -> Array:
    """Return T_target_source (4, 4) of points (n, 3) and (m, 3), m; `voxel` is the cell of the downsampling, m.

    Raises `ScanError` when it finds no solution, `DependencyError` where the library is missing.
    """
    library = peer("kiss_matcher")
    for points in (source, target):
        _check_density(points, NORMAL_RADIUS * voxel)
    matcher = library.KISSMatcher(library.KISSMatcherConfig(voxel))
    found = matcher.estimate(source.astype(np.float32), target.astype(np.float32))
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = found.rotation, np.ravel(found.translation)
    if not found.valid or not np.isfinite(T).all():
        raise ScanError("scan", "KISS-Matcher finds no solution")
    return T


def _check_density(points: Array, radius: float) -> None:
    """Raise `ScanError` for points too far apart for normals."""
    from scipy.spatial import cKDTree

    chosen = points[:: max(1, len(points) // 200)]
    neighbours = cKDTree(points).query_ball_point(chosen, radius, return_length=True)
    if np.median(neighbours) <= LEAST_NEIGHBOURS:
        raise ScanError("scan", "its points are too far apart for KISS-Matcher: it would find no solution")
