"""What speaks for and against an answer: a few figures that mean the same for any model and scan."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pwralign_kin.arrays import Bools, Singles
from pwralign_kin.estimation.comparison.candidates import Candidates
from pwralign_kin.estimation.comparison.continuation import continued, continued_beside
from pwralign_kin.estimation.comparison.scan_comparison import ALIKE, ScanComparison
from pwralign_kin.estimation.comparison.search_options import BAND
from pwralign_kin.estimation.evidence.other_size import SAME_SIZE
from pwralign_kin.estimation.sensing.observation import ONE_SIDE
from pwralign_kin.estimation.sensing.patches import patches
from pwralign_kin.estimation.sensing.points import median

LEAST_POINTS = 8
"""Scan points that a part must explain to count as seen, ..."""
LEAST_RESIDUALS = 25
"""... and for its residual to be compared with that of the others."""
HARDLY = 0.3
"""A part that explains less than this, against the average of all parts, explains hardly anything."""
APART = 0.015
"""Mean distance (model diagonals) of a seen part from another answer's surface from which that one is a rival, ..."""
BESIDE = 0.01
"""... and from which the answer is wrong if that one is right."""
MODES, RIVALS = 3, 8
"""Values of each joint that are tried, and the best rivals that are compared with the answer."""
CONTINUED_MORE = 0.2
"""A better rival of which this share more of the edges is continued is none."""
SPARSE_PROBES = 200
"""Samples of each part, at most, by which points that are far apart are near it."""
PROBES = 40
"""Samples of each part that are compared."""
BLUR, REACH = 0.012, BAND
"""Distances (model diagonals) from a surface at which, besides the noise, a point lies on it less well, and not at all,
when answer and rivals are told apart."""
UNSHARED = 0.0025
"""Residual beyond the noise (model diagonals) that answers leave which are merely wrong somewhere."""
SURFACE_NOISE, VOLUME_NOISE = 0.025, 0.035
"""Noise (model diagonals) up to which simulated scans were answered right, and from which on points fill a volume."""
ASTRAY = 0.2
"""Distance from the model, as a share of the points' spacing, within which none is astray: between points so sparse,
noise passes for curvature of the surface."""


@dataclass(frozen=True)
class Evidence:
    """What speaks for and against an answer."""

    nearby: float
    """Share of the scan that lies near the model without being explained by it, but for a patch of floor, table or
    wall. Whatever else the scan holds is mostly farther away."""

    lacking: float
    """Share of the model's surface in parts that explain hardly anything, against the average of all parts."""

    uneven: float
    """Largest residual of a part over that of all points on the model: noise and bias of the sensor are in both. 1 in
    a scene, where other things touch the model."""

    margin: float
    """Score by which the answer is better than the best rival: another answer that the search found, or this one with
    one joint moved, that takes a seen part off the surface. Negative where the rival is better."""

    distinct: float
    """The same in standard deviations, and by the points alone: how much better each of them lies on the answer than
    on the rival, summed, over the root of the sum of the squares. Noise, and few points, make all answers alike. In a
    scene, points speak for a better rival only where they are oriented like it: the others are of other things."""

    told: float
    """The same, and against what is hardly a rival: would the answer be wrong if the other were right?"""

    ahead: float
    """Score by which the answer is ahead of the next of all others that were found, or that the model's symmetry makes,
    wherever they lie; 1 without any. Limbs that can be taken for each other are the likelier to be mistaken."""

    noise: float
    """Standard deviation of the scan points from their local planes, model diagonals."""

    borne_out: float
    """Share of the surface that a scan usually shows, of what its picture holds, that points confirm: they lie on it,
    and are oriented like it."""

    in_sight: float
    """Share of the model's surface that points confirm, of that which is in sight: a single view does not show what is
    turned away, or hidden by what it saw."""

    shown: float
    """Share of the model's surface that is in sight, of what a picture of it usually shows: some answers hide most of
    it, where nothing can contradict them. 1 unless the one place of the sensor is known."""

    agreed: float
    """Share of the model's surface that points confirm, of that which they lie on, however they are oriented: a scan
    with holes does not show all that is in sight, but what it shows is like the model."""

    explained: float
    """Share of the scan, in a scene of what is near the answer, that lies on the model; a patch of floor, table or wall
    does not count. Where there is much else, some of that is like the model by chance."""

    strange: float
    """Share of what lies on or near the model that it does not explain, but for a patch of floor, table or wall; in a
    scene, where other things touch the model, as `nearby`. Points farther apart than what is near otherwise are near
    within their spacing."""

    astray: float
    """Share of what lies on the model that is farther from it than noise explains: other surface, or bent by the
    sensor."""

    refuted: float
    """Share of the model's surface that a single view should show and looks past; 0 for other scans. Where no ray came
    back it counts for a tenth once a first search convinced nobody."""

    continued: float
    """Share of the model's edges beyond which the scan goes on in the same plane: surface of something larger."""

    points_per_part: float
    """Points that lie on the model, over its parts with surface."""

    size: float
    """How many times as large a model the scan is more like; 1 where it is like none more."""

    size_gain: float
    """Mean by which points near the model lie better on one of that size, each from 0 to 1, and half the share by which
    they confirm more of its surface in sight."""

    mirrored: float
    """Score by which an answer to the mirror image of the scan is better; 0 where that is not looked at."""


def gathered(
    comparison: ScanComparison, final: Candidates, others: Candidates, surroundings: Bools | None = None
) -> Evidence:
    """Return the evidence for the `final` configuration (one) against all `others` that the search ended with.

    The answer is the first of the others. Points of its `surroundings` (m,), none of which lie on the model, are no
    part of the scan. Another size of the model is not looked for (`other_size`), nor are answers that its symmetry
    makes, nor a mirror image of the scan.
    """
    observation = comparison.observation
    distance, part, cosine = comparison.lying(final)
    explained = distance <= comparison.reach
    areas = observation.areas * comparison.searched
    if surroundings is not None:
        areas = areas * ~surroundings
    nearby = areas[~explained & (distance < comparison.options.near)].sum() / areas.sum()
    owners = np.where(explained & comparison.searched, part, -1)
    shares = np.minimum(comparison.explained_shares(owners), 1.0)
    weights = comparison.weights * comparison.exists
    lacking = weights[shares <= HARDLY * float(shares @ weights) / weights.sum()].sum() / weights.sum()
    on_model = areas[explained].sum() / areas.sum()
    alike = explained & (np.abs(cosine) >= ALIKE)
    confirmed = float(areas[alike].sum() / max(areas[explained].sum(), 1e-9))
    beside = areas[~explained & _near(comparison, final, distance)].sum() / areas.sum()
    strange = nearby if observation.scene else beside / max(beside + on_model, 1e-9)
    well = areas[explained & (distance <= max(comparison.noise_reach, ASTRAY * observation.spacing))].sum()
    astray = max(0.0, 1.0 - well / max(areas[explained].sum(), 1e-9))  # sums of other terms round otherwise
    points = np.bincount(owners[owners >= 0], minlength=len(comparison.exists))
    beyond = continued_beside(comparison, final, distance, cosine)
    rivals, apart = _rivals(comparison, final, others, points)
    answer, support = comparison.scored(final)
    compared = Candidates.concatenate([answer, comparison.scored(rivals)[0]]) if len(rivals) else answer
    refuted = max(0.0, -float(support[0] @ weights / weights.sum())) if observation.single_view else 0.0
    margin, distinct, told = _margins(comparison, compared, apart, beyond)
    in_sight, agreed, shown = comparison.confirmed(final)
    pictured = comparison.pictured(final)
    return Evidence(
        nearby=float(nearby),
        lacking=float(lacking),
        uneven=_uneven(comparison, final),
        margin=margin,
        distinct=distinct,
        told=told,
        ahead=ahead_of(others.scores[:1], others.scores[1:]),
        noise=observation.noise,
        borne_out=min(1.0, confirmed * float(shares @ weights) / float(weights.sum()) / pictured),
        in_sight=in_sight,
        shown=min(1.0, shown / (ONE_SIDE * pictured)) if observation.single_view else 1.0,
        agreed=agreed,
        explained=1.0 - comparison.unexplained(final) if observation.scene else float(on_model),
        strange=float(strange),
        astray=float(astray),
        refuted=refuted,
        continued=beyond,
        points_per_part=float(points.sum() / comparison.exists.sum()),
        size=SAME_SIZE.factor,
        size_gain=SAME_SIZE.gain,
        mirrored=0.0,
    )


def _near(comparison: ScanComparison, final: Candidates, distance: Singles) -> Bools:
    """Return which scan points (m,) are on or near the model, by their `distance` (m,) from it.

    In a scan of points farther apart than what is near, they are near within their spacing: hardly any that something
    else left beside the model is nearer.
    """
    observation = comparison.observation
    if observation.scene or observation.spacing <= comparison.options.near:
        return np.asarray(distance < comparison.options.near)
    from scipy.spatial import cKDTree

    tree = cKDTree(comparison.probe_positions(final, SPARSE_PROBES)[0])
    away = tree.query(observation.points, distance_upper_bound=observation.spacing)[0]
    return np.asarray((distance < comparison.options.near) | np.isfinite(away))


def ahead_of(score: Singles, others: Singles) -> float:
    """Return by how much an answer's `score` (1,) is ahead of the next of the `others` (m,); 1 without any."""
    return float((score - others).min(initial=1.0))


def on_surface(evidence: Evidence) -> float:
    """Return how far the points lie on a surface, from 1 to 0, and do not fill a volume."""
    return float(np.clip((VOLUME_NOISE - evidence.noise) / (VOLUME_NOISE - SURFACE_NOISE), 0.0, 1.0))


def logistic(coefficients: tuple[float, ...], values: NDArray[np.float64]) -> float:
    """Return the chance in [0, 1] that `coefficients` of 1 and of `values` make."""
    return float(1.0 / (1.0 + np.exp(-(coefficients[0] + values @ np.array(coefficients[1:])))))


def _uneven(comparison: ScanComparison, final: Candidates) -> float:
    """Return the largest median distance of a part's points over that of all; 1 where that tells nothing."""
    if comparison.observation.scene:
        return 1.0  # other things that touch the model count as points of its parts
    distance, part = comparison.given_owners(final)
    near = distance < comparison.reach
    distance, part = distance[near], part[near]
    all_of = median(distance) if len(distance) else 0.0
    counts = np.bincount(part, minlength=len(comparison.exists))
    each = [median(distance[part == i]) for i in np.flatnonzero(counts >= LEAST_RESIDUALS)]
    return max(each, default=all_of) / all_of if all_of > 0 else 1.0


def _margins(
    comparison: ScanComparison, compared: Candidates, apart: NDArray[np.bool_], beyond: float
) -> tuple[float, float, float]:
    """Return how much better the answer is than the best of its rivals: by score, in standard deviations, and in
    standard deviations than what is hardly a rival, too.

    The answer is the first of what is `compared`, with scores; the others are rivals where `apart` (m,). Without any,
    1 and what is the most that so many points can tell. What explains more because it lies in something larger, beyond
    whose edges more of the scan goes on than `beyond` those of the answer, is none.
    """
    margins = compared.scores[0] - compared.scores[1:]
    distinct = _distinctness(comparison, compared)
    stands = apart.copy()
    for rank in np.flatnonzero(apart & ((margins < 0.0) | (distinct < 0.0))):
        stands[rank] = continued(comparison, compared.take([1 + rank])) <= beyond + CONTINUED_MORE
    most = float(np.sqrt(len(comparison.observation.given)))
    return (
        float(margins[stands].min(initial=1.0)),
        float(distinct[stands].min(initial=most)),
        float(distinct[stands | ~apart].min(initial=most)),
    )


def _rivals(
    comparison: ScanComparison, final: Candidates, others: Candidates, points: NDArray[np.int64]
) -> tuple[Candidates, NDArray[np.bool_]]:
    """Return which of the `others`, and of the best ways to move one joint, take one of the seen parts off the surface,
    if only `BESIDE` it, and whether (m,) they are `APART`.

    `points` (parts,) of the scan lie on each part.
    """
    seen = np.flatnonzero(points >= LEAST_POINTS)
    moved = _with_joints_moved(comparison, final, points).best_first()
    several = [_off(comparison, final, others, seen, len(others)), _off(comparison, final, moved, seen, RIVALS)]
    rivals, departures = zip(*several, strict=True)
    return Candidates.concatenate(rivals), np.concatenate(departures) > APART


def _off(
    comparison: ScanComparison, final: Candidates, rivals: Candidates, seen: NDArray[np.int64], count: int
) -> tuple[Candidates, NDArray[np.float64]]:
    """Return the first of the rivals that place one of the `seen` parts off the answer's surface, and how far.

    `count` of them, at most, are apart.
    """
    departures = np.zeros(0)
    while len(departures) < len(rivals) and (departures > APART).sum() < count:
        some = rivals.take(slice(len(departures), len(departures) + 2 * RIVALS))
        departures = np.append(departures, _departures(comparison, final, some, seen))
    kept = np.flatnonzero((departures > BESIDE) & (np.cumsum(departures > APART) <= count))
    return rivals.take(kept), departures[kept]


def _distinctness(comparison: ScanComparison, compared: Candidates) -> NDArray[np.float64]:
    """Return by how many standard deviations the points speak for the first candidate against each other.

    What noise does not explain of a large residual, points of a patch have in common: a sensor that bends surfaces
    makes others fit a whole patch better, which tells no more than one point would.
    """
    given, noise = comparison.observation.given, comparison.observation.noise
    residual = comparison.residual(compared.take([0]))
    blur = math.hypot(max(noise, residual), BLUR)
    distances = comparison.distances(given, comparison.part_placements(compared), comparison.exists, REACH)
    explained = np.exp(-0.5 * (distances / blur) ** 2)
    gains = explained[0] - explained[1:]
    if comparison.observation.scene:
        gains = _but_for_other_things(comparison, compared, explained, gains)
    sums, variances = gains.sum(axis=1), (gains**2).sum(axis=1)
    better = sums < 0.0
    shared = 1.0 - (noise**2 + UNSHARED**2) / max(residual, 1e-9) ** 2
    if better.any() and shared > 0.0:
        patch = patches(given, comparison.given_owners(compared.take([0]))[1])
        together = np.array([np.square(np.bincount(patch, own)).sum() for own in gains[better]])
        variances[better] += shared * np.maximum(together - variances[better], 0.0)
    return np.asarray(sums / np.sqrt(variances + 1e-9), np.float64)


def _but_for_other_things(
    comparison: ScanComparison, compared: Candidates, explained: Singles, gains: Singles
) -> Singles:
    """Return how much better (rivals, n) the points of a scene lie on the answer than on each rival: of those that are
    better, by points that are oriented like the surface. In other things, limbs explain much that is not."""
    given, normals = comparison.observation.given, comparison.observation.given_normals
    placements, gains = comparison.part_placements(compared), gains.copy()

    def alike(rank: int) -> Singles:
        cosine = comparison.facing(given, normals, placements[rank], comparison.exists, REACH)
        return np.asarray(explained[rank] * (np.abs(cosine) >= ALIKE), np.float32)

    better = np.flatnonzero(gains.sum(axis=1) < 0.0)
    if len(better):
        gains[better] = alike(0) - np.array([alike(1 + int(rank)) for rank in better])
    return gains


def _with_joints_moved(comparison: ScanComparison, final: Candidates, points: NDArray[np.int64]) -> Candidates:
    """Return the configuration with each joint in turn at its best other values; the side with fewer points moves."""
    count = final.values.shape[1]
    joints = np.arange(count, dtype=np.int32)
    nudged = Candidates(
        np.repeat(final.bases, count, axis=0), final.values + 0.1 * np.eye(count), np.zeros(count, np.float32)
    )
    hangs = (np.abs(comparison.part_placements(nudged) - comparison.part_placements(final)) > 1e-9).any(axis=(2, 3))
    base_moves = hangs @ points > 0.5 * points.sum()
    # Nothing that is seen departs where only the rest moves.
    tells = base_moves | (hangs & (points >= LEAST_POINTS)).any(axis=1)
    return comparison.swept(final, joints[tells], base_moves[tells], MODES)


def _departures(
    comparison: ScanComparison, final: Candidates, rivals: Candidates, parts: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Return of each rival the largest mean distance of one of `parts`, as the answer places it, to its surface."""
    placements = comparison.part_placements(final)[0]
    placed = [comparison.surfaces[i].samples[:PROBES] @ placements[i][:3, :3].T + placements[i][:3, 3] for i in parts]
    if not placed:
        return np.zeros(len(rivals))
    probes = np.ascontiguousarray(np.concatenate(placed), np.float32)
    starts = np.cumsum([0, *(len(own) for own in placed[:-1])])
    sizes = [len(own) for own in placed]
    distances = comparison.distances(probes, comparison.part_placements(rivals), comparison.exists, REACH)
    return np.asarray((np.add.reduceat(distances, starts, axis=1) / sizes).max(axis=1))
