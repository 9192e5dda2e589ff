"""In which unit is a scan, and is it fine enough? Only the model beside it can tell."""

from __future__ import annotations

import logging

import numpy as np

from pwralign_kin.exceptions import ScanError, UnitError
from pwralign_kin.lengths import METRES, PLURALS, Units
from pwralign_kin.scan.scan import Scan

logger = logging.getLogger(__name__)

GUESSED = ("mm", "cm", "in")
"""Units that a scan may be taken to be in. In feet a model alone is as large as many a metric scene, and as dense."""

MIN_RELATIVE_SIZE = 0.15
"""A scan that shows the model spans at least this share of the model's diagonal."""

SEGMENTED = (0.5, 3.0)
"""Relative sizes of scans in units other than m and mm: of the model alone, for such scenes are rarer than metric ones
that are as large."""

ALONE = (0.5, 1.7)
"""Relative sizes of most scans of the model alone."""

MILLIMETRE_FIRST = 2.0
"""By so much a size in millimetres may be farther from the model's than one in another unit."""

SPECK = 0.02
"""A scan that spans less than this share of the model's diagonal in the unit it is said to have is in another."""

MAX_RELATIVE_SPACING = 0.1
"""With neighbours farther apart than this share of the diagonal, fewer than about a hundred points show the
model."""

COARSE = 0.03
"""Step that coordinates are rounded to, model diagonals, from which a caller is told: at 0.03 all of three robots were
found, at 0.05 with doubts, at 0.1 none."""


def check_units(scan: Scan, model_diagonal: float, units: Units = "m") -> Scan:
    """Return `scan` in m, or say in which unit it seems to be.

    A scan is not in metres when, read as metres, it could not serve anyhow (median distance between
    neighbouring points above 10% of `model_diagonal`, m) and, read in another unit, it could (its own diagonal
    at least 15% of the model's, and up to three times as large in centimetres or inches). Size alone does not tell: a
    metric scan of a whole hall is rightly hundreds of times as large as a small object in it, but then dense, while an
    object in millimetres is as large but its points lie model lengths apart.

    With `units` "m" such a scan raises `UnitError` naming the unit; with "auto" it is rescaled with a warning; with
    any other nothing is checked.
    """
    if units not in ("m", "auto"):
        return scan
    likely = likely_unit(scan, model_diagonal)
    if likely == "m":
        return scan
    ratio = scan.diagonal / model_diagonal
    sizes = f"{scan.diagonal:.3g} m against {model_diagonal:.3g} m"
    fault = f"the scan is {ratio:.0f} times as large as the model ({sizes})"
    if units == "auto":
        logger.warning("%s: %s; taken as %s", scan.source, fault, PLURALS[likely])
        return scan.scaled(METRES[likely])
    remedy = f"use units={likely!r} / --units {likely}"
    if scan.camera is not None:
        remedy = f"its depth scale is {METRES[likely]:g} times what it is said to be (scale / --depth-scale)"
    way_out = f"if it is in {PLURALS[likely]}, {remedy}, else crop it (Scan.cropped / --crop)"
    raise UnitError(scan.source, f"{fault}; {way_out}", METRES[likely])


def check_named_unit(scan: Scan, model_diagonal: float, units: Units) -> None:
    """Raise `UnitError` where `scan`, in the unit of its file, cannot be in the unit that it is said to have."""
    ratio = METRES[units] * scan.diagonal / model_diagonal
    if ratio >= SPECK:
        return
    likely = likely_unit(scan, model_diagonal)
    if likely != units:
        raise UnitError(
            scan.source,
            f"in {units} the scan is {ratio:.2g} times as large as the model; it is likely in {likely}: use "
            f"units={likely!r} / --units {likely}",
            METRES[likely],
        )


def likely_unit(scan: Scan, model_diagonal: float) -> str:
    """Return the unit in which the scan makes sense beside the model, "m" where none makes more."""
    if not (np.isfinite(model_diagonal) and model_diagonal > 0.0):
        raise ScanError(scan.source, f"cannot compare the scan with a model of size {model_diagonal} m")
    ratios = {unit: METRES[unit] * scan.diagonal / model_diagonal for unit in GUESSED}
    off = {unit: abs(np.log(ratio)) for unit, ratio in ratios.items() if SEGMENTED[0] <= ratio <= SEGMENTED[1]}
    if ratios["mm"] >= MIN_RELATIVE_SIZE:
        off["mm"] = abs(np.log(ratios["mm"])) - np.log(MILLIMETRE_FIRST)
    if not off or _spacing(scan) <= MAX_RELATIVE_SPACING * model_diagonal:
        return "m"
    return min(off, key=off.__getitem__)


def units_of_it_alone(scan: Scan, model_diagonal: float) -> tuple[str, ...]:
    """Return the units other than m in which a scan would be as large as one of the model alone."""
    ratio = scan.diagonal / model_diagonal
    return tuple(unit for unit in PLURALS if ALONE[0] <= METRES[unit] * ratio <= ALONE[1])


def note_of_unit(scan: Scan, model_diagonal: float) -> None:
    """Log in which other unit a scan in m, in which nothing was found for sure, would be of the model alone; not where
    its unit is known."""
    likely = units_of_it_alone(scan, model_diagonal)
    if likely and scan.camera is None and not scan.rescaled:
        logger.info(
            "%s: it was searched as a scene %.1f times as large as the model; if it is in %s, it may be of the model "
            "alone: units=%r / --units %s",
            scan.source, scan.diagonal / model_diagonal, PLURALS[likely[0]], likely[0], likely[0],
        )  # fmt: skip


def warn_of_rounding(scan: Scan, model_diagonal: float) -> None:
    """Log that the coordinates of a scan, m, are too coarse for the model, and whether single precision is to blame."""
    step = scan.rounding()
    if step < COARSE * model_diagonal:
        return
    farthest = float(np.abs(scan.points).max())
    cause = ""
    if step <= np.spacing(np.float32(farthest)):
        cause = (
            f": single precision tells no more {farthest:.3g} m from the origin; subtract an offset before it is "
            "stored, or store double precision"
        )
    share = 100.0 * step / model_diagonal
    logger.warning("%s: coordinates are rounded to %.3g m, %.0f%% of the model%s", scan.source, step, share, cause)


def _spacing(scan: Scan) -> float:
    """Return the median distance between nearest neighbours, m, over at most 2000 points spread over the
    scan."""
    from scipy.spatial import cKDTree

    sample = scan.points[:: max(1, len(scan) // 2000)]
    distance, _ = cKDTree(scan.points).query(sample, k=2)
    return float(np.median(distance[:, 1]))
