"""Is a scan in metres or in millimetres? Only the model beside it can tell."""

from __future__ import annotations

import logging

import numpy as np

from pwralign_kin.exceptions import ScanError, UnitError
from pwralign_kin.scan.scan import Scan, Units

logger = logging.getLogger(__name__)

MILLIMETRE = 1e-3

MIN_RELATIVE_SIZE = 0.15
"""A scan that shows the model spans at least this share of the model's diagonal."""

MAX_RELATIVE_SPACING = 0.1
"""With neighbours farther apart than this share of the diagonal, fewer than about a hundred points show the
model."""


def check_units(scan: Scan, model_diagonal: float, units: Units = "m") -> Scan:
    """Return `scan` in m, or say that it is in millimetres.

    A scan looks like millimetres when, read as metres, it could not serve anyhow (median distance between
    neighbouring points above 10% of `model_diagonal`, m) and, read as millimetres, it could (its own diagonal
    at least 15% of the model's). Size alone does not tell: a metric scan of a whole hall is rightly hundreds
    of times as large as a small object in it, but then dense, while an object in millimetres is as large but
    its points lie model lengths apart.

    With `units` "m" such a scan raises `UnitError` naming `--units mm`; with "auto" it is rescaled with a
    warning; with "mm" it is returned as it is, since `Scan.load` has converted it.
    """
    if units == "mm" or not _looks_like_millimetres(scan, model_diagonal):
        return scan
    ratio = scan.diagonal / model_diagonal
    sizes = f"{scan.diagonal:.3g} m against {model_diagonal:.3g} m"
    fault = f"the scan is {ratio:.0f} times as large as the model ({sizes})"
    if units == "auto":
        logger.warning("%s: %s; taken as millimetres", scan.source, fault)
        return scan.scaled(MILLIMETRE)
    raise UnitError(scan.source, f"{fault}; if it is in millimetres, use --units mm (units='mm')", MILLIMETRE)


def _looks_like_millimetres(scan: Scan, model_diagonal: float) -> bool:
    if not (np.isfinite(model_diagonal) and model_diagonal > 0.0):
        raise ScanError(scan.source, f"cannot compare the scan with a model of size {model_diagonal} m")
    if MILLIMETRE * scan.diagonal < MIN_RELATIVE_SIZE * model_diagonal:
        return False
    return _spacing(scan) > MAX_RELATIVE_SPACING * model_diagonal


def _spacing(scan: Scan) -> float:
    """Return the median distance between nearest neighbours, m, over at most 2000 points spread over the
    scan."""
    from scipy.spatial import cKDTree

    sample = scan.points[:: max(1, len(scan) // 2000)]
    distance, _ = cKDTree(scan.points).query(sample, k=2)
    return float(np.median(distance[:, 1]))
