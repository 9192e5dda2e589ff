"""Rigid registration without a start by KISS-Matcher (Lim et al., ICRA 2025).

Set up as its example for Python has it: nothing but the voxel size is given
(https://github.com/MIT-SPARK/KISS-Matcher/blob/main/python/examples/run_kiss_matcher.py).
"""

from __future__ import annotations

import numpy as np

from pwralign_kin.dependencies import peer
from pwralign_kin.exceptions import ScanError
from pwralign_kin.se3 import Array


def kiss_matcher(source: Array, target: Array, voxel: float) -> Array:
    """Return T_target_source (4, 4) of points (n, 3) and (m, 3), m; `voxel` is the cell of the downsampling, m.

    Raises `ScanError` when it finds no solution, `DependencyError` where the library is missing.
    """
    library = peer("kiss_matcher")
    matcher = library.KISSMatcher(library.KISSMatcherConfig(voxel))
    found = matcher.estimate(source.astype(np.float32), target.astype(np.float32))
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = found.rotation, np.ravel(found.translation)
    if not found.valid or not np.isfinite(T).all():
        raise ScanError("scan", "KISS-Matcher finds no solution")
    return T
