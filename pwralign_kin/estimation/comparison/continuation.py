"""Whether the scan's surface ends where the model's does.

Surface that merely coincides with a piece of something larger, as a plate does that lies in a wall, explains its points
as well as surface that is truly there; but beyond its edges the scan goes on.
"""

from __future__ import annotations

import numpy as np

from pwralign_kin import kernels
from pwralign_kin.arrays import Indices, Singles
from pwralign_kin.estimation.comparison.candidates import Candidates
from pwralign_kin.estimation.comparison.scan_comparison import ScanComparison

STARTS, DIRECTIONS = 1000, 8
"""Scan points on the model, at most, that a step is taken from in every direction along the surface."""
STEP, SPACINGS = 0.05, 2.0
"""Length of the step: so much (model diagonals), and at least so many times the points' spacing."""
BEYOND = 0.005
"""How much farther than points that lie on the model a step has ended that leaves it."""
AROUND, AROUND_SPACINGS = 0.02, 1.5
"""How near to the end of a step the scan has a point where its surface goes on, ..."""
TOLERANCE, NOISES = 0.008, 2.5
"""... how near to the plane that the step was taken in, besides so many times the noise, ..."""
ALIKE, SAME_PLANE = 0.8, 0.9
"""... and the cosine between the normals: of scan and model where the step starts, and of the scan at its two ends."""
LEAST_STEPS = 20
"""Steps off the model, below which their share tells less."""

PRICE, USUAL = 0.6, 0.15
"""Score of a scene's answer that is lost where all its edges are continued, and their share that costs nothing."""


def priced(comparison: ScanComparison, candidates: Candidates) -> Candidates:
    """Return the candidates in the same order, the scores of those that could be the best less what `continued` costs.

    Scores tell what is explained, and all of a plate that lies in a wall is.
    """
    scores = candidates.scores.copy()
    for rank in np.flatnonzero(scores > scores.max() - PRICE):
        scores[rank] -= _price(comparison, candidates.take([rank]))
    return candidates.with_scores(scores)


def best_priced(comparison: ScanComparison, candidates: Candidates) -> Candidates:
    """Return the best of the candidates (one) as `priced`, which is known before all prices are."""
    ordered, best = candidates.best_first(), -np.inf
    chosen = ordered.take([0])
    for rank, score in enumerate(ordered.scores):
        if score <= best:
            break
        one = ordered.take([rank])
        one.scores[0] -= _price(comparison, one)
        if one.scores[0] > best:
            chosen, best = one, float(one.scores[0])
    return chosen


def _price(comparison: ScanComparison, candidate: Candidates) -> float:
    """Return what the continued edges of one candidate cost."""
    return PRICE / (1.0 - USUAL) * max(0.0, continued(comparison, candidate) - USUAL)


def continued(comparison: ScanComparison, candidate: Candidates) -> float:
    """Return the share of the model's edges, of one candidate, beyond which the scan goes on in the same plane."""
    distance, _, cosine = comparison.lying(candidate)
    return continued_beside(comparison, candidate, distance, cosine)


def continued_beside(comparison: ScanComparison, candidate: Candidates, distances: Singles, cosines: Singles) -> float:
    """Return the same from how far the scan points are from the candidate's surface, and their normals from its.

    Steps are taken along the scan's surface from points on the model. Of those that leave the model, the share counts
    that ends on points of the same plane. At true edges the scan ends or turns, or something else hides what follows.
    """
    observation = comparison.observation
    # Without a sensor, which side of a surface is outside is a guess.
    alike = (cosines if observation.single_view else np.abs(cosines)) >= ALIKE
    starts = _spread(np.flatnonzero((distances <= comparison.reach) & alike), observation.areas)
    if len(starts) == 0:
        return 0.0
    points, normals = observation.points[starts], observation.normals[starts]
    step = max(STEP, SPACINGS * observation.spacing)
    ends = kernels.steps_around(points, normals, step, DIRECTIONS)
    reach = comparison.reach + BEYOND
    placements = comparison.part_placements(candidate)[0]
    off = np.flatnonzero(comparison.assigned(ends, placements, comparison.exists, 1.01 * reach)[0] > reach)
    follower = observation.field.nearest(ends[off], max(AROUND, AROUND_SPACINGS * observation.spacing))
    goes_on = (follower >= 0) & (distances[follower] > comparison.reach)
    start, follower = off[goes_on] // DIRECTIONS, follower[goes_on]
    following, turned = observation.points[follower], observation.normals[follower]
    away = np.abs(np.einsum("ij,ij->i", following - points[start], normals[start]))
    follows = away < TOLERANCE + NOISES * observation.noise
    follows &= np.abs(np.einsum("ij,ij->i", turned, normals[start])) > SAME_PLANE
    return float(follows.sum() / max(len(off), LEAST_STEPS))


def _spread(points: Indices, areas: Singles) -> Indices:
    """Return at most `STARTS` of the points, spread evenly over the area that they stand for."""
    if len(points) == 0:
        return points
    share = np.cumsum(areas[points], dtype=float)
    drawn = np.searchsorted(share / share[-1], (np.arange(STARTS) + 0.5) / STARTS)
    return np.asarray(points[np.unique(np.minimum(drawn, len(points) - 1))])
