"""Scores that refined answers are ranked by: coarse, tight, and by the likelihood of every point."""

from __future__ import annotations

import math

import numpy as np

from pwralign_kin.arrays import Ints, Singles
from pwralign_kin.estimation.comparison.candidates import Candidates
from pwralign_kin.estimation.comparison.scan_comparison import ScanComparison
from pwralign_kin.estimation.comparison.search_options import BAND

SAMPLING, ANYWHERE = 0.002, 0.02
"""Distance (model diagonals) that samples of the surface leave beside the noise, and density of points that are not on
the model against that of the noise at its peak."""


def ranked(comparison: ScanComparison, candidates: Candidates) -> Candidates:
    """Return refined candidates, the best known first, by coarse, tight and finest scores together, best first."""
    return candidates.with_scores(ranks(comparison, candidates)).best_first()


def better_ranked(comparison: ScanComparison, before: Candidates, refined: Candidates) -> Candidates:
    """Return of each candidate what it was `before` or what it is `refined`, whichever ranks higher, in the same order.

    In a scene, refinement pulls the model to what touches it, too.
    """
    count = len(before)
    both = Candidates.concatenate([before, refined])
    scores = ranks(comparison, both)
    return both.with_scores(scores).take(
        np.where(scores[count:] >= scores[:count], np.arange(count, 2 * count), np.arange(count))
    )


def ranks(comparison: ScanComparison, candidates: Candidates, likelihoods: Singles | None = None) -> Singles:
    """Return the scores that `ranked` ranks by; their `finest` may be known."""
    both_ways = comparison.scored_both_ways(candidates, _tight(comparison, candidates))[0]
    return np.asarray(both_ways + (finest(comparison, candidates) if likelihoods is None else likelihoods), np.float32)


def total_coverage(comparison: ScanComparison, candidates: Candidates) -> Singles:
    """Return the part of these scores that is coverage of the scan."""
    covered = comparison.scored_both_ways(candidates, _tight(comparison, candidates))[1]
    return np.asarray(comparison.coverage_scale * covered, np.float32)


def _tight(comparison: ScanComparison, candidates: Candidates) -> float:
    """Return the distance of the tight score, the first candidate being the best known."""
    blur = comparison.observation.noise
    if comparison.observation.scene:
        # Sensors bend whole surfaces besides their noise: what the best answer leaves must not count against it.
        blur = max(blur, comparison.residual(candidates.take([0])))
    return 0.012 + 1.5 * min(blur, 0.012)


def finest(comparison: ScanComparison, candidates: Candidates) -> Singles:
    """Return the mean logarithm of the likelihood of the scan's points, each on the model but for noise, or anywhere.

    Where a small part is wrong, other surface often lies so near to its points that wider scores hardly see it.
    """
    if comparison.observation.scene:
        return np.zeros(len(candidates), np.float32)  # most of it is other things
    if len(candidates) == 1:
        distances = comparison.given_owners(candidates)[0][None]
    else:
        placements = comparison.part_placements(candidates)
        distances = comparison.distances(comparison.observation.given, placements, comparison.exists, BAND)
    residual = comparison.residual_of(distances[0])
    return np.asarray(_log_likelihoods(comparison, distances, residual).mean(axis=1), np.float32)


def point_likelihoods(comparison: ScanComparison, candidate: Candidates) -> tuple[Singles, Ints]:
    """Return the logarithm of the likelihood of each of the scan's points by one candidate, and the part (-1: none)
    that it is nearest to."""
    distances, part = comparison.given_owners(candidate)
    return _log_likelihoods(comparison, distances, comparison.residual_of(distances)), part


def ahead_of_mirrored(answer: tuple[ScanComparison, Candidates], image: tuple[ScanComparison, Candidates]) -> float:
    """Return by how much an answer (one) to a scan ranks above one to its mirror image, each by its own comparison.

    Likelihoods compare by one and the same noise only: that which the better leaves, unless that of its scan is more.
    """
    residual = min(comparison.residual(candidate) for comparison, candidate in (answer, image))

    def rank(comparison: ScanComparison, candidate: Candidates) -> float:
        both_ways = comparison.scored_both_ways(candidate, _tight(comparison, candidate))[0][0]
        distances = comparison.given_owners(candidate)[0]
        return float(both_ways + _log_likelihoods(comparison, distances, residual).mean())

    return rank(*answer) - rank(*image)


def _log_likelihoods(comparison: ScanComparison, distances: Singles, residual: float) -> Singles:
    # The noise counts, and what a bent scan leaves beside it.
    noise = math.hypot(max(comparison.observation.noise, residual), SAMPLING)
    return np.asarray(np.log(np.exp(-0.5 * (distances / noise) ** 2) + ANYWHERE), np.float32)
