"""Parts whose points lie off them: what the scores of whole answers hardly tell of small parts."""

from __future__ import annotations

import numpy as np

from pwralign_kin.arrays import Indices
from pwralign_kin.estimation.comparison.candidates import Candidates
from pwralign_kin.estimation.comparison.ranking import point_likelihoods
from pwralign_kin.estimation.comparison.scan_comparison import ScanComparison
from pwralign_kin.se3 import Array

LESS, LESS_EACH = 8.0, 0.3
"""By how much the logarithm of the likelihood of a part's points must be less than that of as many usual ones, and by
how much of each point on average, for the part to be off them."""


def off_points(comparison: ScanComparison, answer: Candidates) -> tuple[Indices, Array]:
    """Return the parts whose points lie off them more than the points of others, the worst first, and by how much the
    logarithm of the likelihood of their points is less than that of as many usual ones."""
    likelihoods, part = point_likelihoods(comparison, answer)
    count = len(comparison.exists)
    points = np.bincount(part[part >= 0], minlength=count)
    each = np.bincount(part[part >= 0], likelihoods[part >= 0], count) / np.maximum(points, 1)
    less = np.median(each[points > 0]) - each if points.any() else np.zeros(count)
    off = 1 + np.flatnonzero(((less > LESS_EACH) & (less * points > LESS))[1:])  # the first part hangs on nothing
    off = off[np.argsort(-(less * points)[off], kind="stable")]
    return off, (less * points)[off]
