"""Where the points of a scan were seen from, in the units of the search."""

from __future__ import annotations

import numpy as np

from pwralign_kin import kernels
from pwralign_kin.arrays import Singles
from pwralign_kin.scan import Scan
from pwralign_kin.se3 import Array

ONE_PLACE = 1e-3
"""Extent of the sensor's way (model diagonals) up to which it stood in one place."""


def common_origin(scan: Scan, centre: Array, diagonal: float) -> Singles | None:
    """Return the sensor origin in search units if all points share it."""
    origin = scan.sensor_origin
    if origin is None:
        return None
    origins = np.atleast_2d(origin)
    if np.ptp(origins, axis=0).max() > ONE_PLACE * diagonal:
        return None
    return np.asarray((origins[0] - centre) / diagonal, np.float32)


def origins_of(points: Singles, scan: Scan, centre: Array, diagonal: float, threads: int) -> Singles | Array | None:
    """Return where prepared points were seen from, in search units: (3,) if all of the scan was from one place, else of
    each (n, 3) where the given point nearest to it was; None where that is unknown."""
    origin = common_origin(scan, centre, diagonal)
    if origin is not None or scan.sensor_origin is None:
        return origin
    given = np.ascontiguousarray((scan.points - centre) / diagonal, np.float32)
    near = kernels.nearest_neighbours(given, points, 1, threads)[1][:, 0]
    return np.asarray((np.asarray(scan.sensor_origin)[near] - centre) / diagonal)
