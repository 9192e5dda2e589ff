"""How far the points of a scan scatter about the surface that they were taken from."""

from __future__ import annotations

import numpy as np

from pwralign_kin import kernels
from pwralign_kin.arrays import Indices, Singles
from pwralign_kin.estimation.sensing.points import at_most, median, medians
from pwralign_kin.se3 import Array

NEIGHBOURHOODS = 1000
"""Points about which noise is measured."""
NEIGHBOURS = np.array([6, 7, 8, 10, 12])
"""Counts of neighbours that it is measured with; twice as many where the fewest lie in a blob, ..."""
FLAT = 1.9
"""... not this much wider (rms) than thick, and then half of the points, ..."""
FEWEST = 2000
"""... down to this many: noise that hides the surface from the nearest neighbours reaches further than they do."""
SLENDER, FLAT_LINE = 0.3, 0.1
"""The nearest neighbours lie on a scan line if they spread so little across it, against along it, and so little across
a plane through it, against across the line (variances)."""


def noise_of(points: Singles, threads: int) -> float:
    """Return the standard deviation of the points about the surface they were taken from.

    The scatter about planes through the k nearest neighbours is that of the noise, and of the surface's curvature,
    which grows with the square of the neighbourhood's area: a line through the variances over k squared tells the two
    apart, down to scans so sparse that no neighbourhood is flat. Neighbours of one scan line tell nothing about planes
    through it, which hold the rays of a spinning sensor, but the same about the line.
    """
    if len(points) < 2 * NEIGHBOURS.max():
        return 0.0
    while True:
        chosen = np.random.default_rng(0).choice(len(points), min(NEIGHBOURHOODS, len(points)), replace=False)
        for counts in (NEIGHBOURS, 2 * NEIGHBOURS):
            across, along, slender = _variances(points, np.ascontiguousarray(points[chosen]), counts, threads)
            if slender < SLENDER and across[0] < FLAT_LINE * along[0]:
                return _without_curvature(counts, along, 4)
            if along[0] > FLAT**2 * across[0]:
                return _without_curvature(counts, across, 2)
        if len(points) < 2 * FEWEST:
            return _without_curvature(counts, across, 2)
        # Where the nearest neighbours lie within the noise, fewer points show the surface.
        points = at_most(points, len(points) // 2)


def _without_curvature(counts: Indices, across: Array, power: int) -> float:
    """Return the standard deviation that variances across planes or lines through `counts` neighbours tend to at none,
    as curvature grows with a `power` of the counts."""
    # A line by least squares, each variance known to the same relative accuracy.
    constant = 1.0 / np.maximum(across, 1e-18)
    growing = counts**power * constant
    apart = constant - (constant @ growing) / (growing @ growing) * growing
    return float(np.sqrt(max(apart.sum() / (apart @ constant), 0.0)))


def _variances(points: Singles, chosen: Singles, counts: Indices, threads: int) -> tuple[Array, Array, float]:
    """Return per count of neighbours the median variances across and along planes through so many about `chosen`, and
    the median share of the latter, of the fewest, in the variance at right angles to both."""
    variances = kernels.neighbourhood_variances(points, chosen, counts.tolist(), threads)
    thin, wide = medians(variances[:, :2]).T
    slender = median(variances[0, 1] / np.maximum(variances[0, 2], 1e-18))
    # The median of a chi-square distribution lies below its mean (Wilson and Hilferty's approximation).
    return thin / (1 - 2 / (9 * (counts - 3))) ** 3, wide, slender
