"""Answers that explain their scan so well that nothing more is searched."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pwralign_kin.estimation.comparison.candidates import Candidates
from pwralign_kin.estimation.comparison.scan_comparison import ScanComparison

PLAIN_UNEXPLAINED = 0.004
"""An answer that is plainly right leaves no greater share of the scan unexplained, ..."""
PLAIN_OFF, PLAIN_OFF_PART, PLAIN_POINTS = 0.01, 0.1, 25
"""... no more of the points farther from it than noise explains, be it of all points or of those of one part (or of so
many, where it has fewer), ..."""
PLAIN_SUPPORT = -0.12
"""... and has no part that a single view speaks against by more."""


def is_plainly_right(comparison: ScanComparison, candidate: Candidates, doubt: float = 1.0) -> bool:
    """Return whether one candidate explains its scan to within the noise, part by part, with nothing against it.

    `doubt` times as many points as usual may speak against it.
    """
    if not is_explained(comparison, candidate, doubt):
        return False
    support = comparison.scored(candidate)[1][0]
    if comparison.poorly_supported(support).any():
        return False
    return not comparison.observation.single_view or float(support[comparison.exists].min()) > PLAIN_SUPPORT


def is_explained(comparison: ScanComparison, candidate: Candidates, doubt: float = 1.0) -> bool:
    """Return whether one candidate explains all points of its scan of the model but for a few, or `doubt` times as
    many."""
    distance, owner = comparison.owners(candidate, comparison.exists)
    if (distance > comparison.reach).mean() > doubt * PLAIN_UNEXPLAINED:
        return False
    off = off_surface(comparison, distance)
    points = np.bincount(owner[owner >= 0], minlength=len(comparison.exists))
    off_part = np.bincount(owner[off & (owner >= 0)], minlength=len(comparison.exists))
    return bool(
        off.mean() <= doubt * PLAIN_OFF
        and (off_part <= doubt * PLAIN_OFF_PART * np.maximum(points, PLAIN_POINTS)).all()
    )


def off_surface(comparison: ScanComparison, distance: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Return which of the distances of scan points from the model are beyond what noise explains."""
    return np.asarray(distance > comparison.noise_reach)
