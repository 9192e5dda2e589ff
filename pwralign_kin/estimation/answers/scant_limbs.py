"""Limbs of which a scan from all sides holds few points, held otherwise.

Most of such a limb is folded into other parts, or cut out of the scan. The scores of whole answers hardly tell where it
is: few points speak for it, and surface counts as lacking that no sensor could see. How likely all points are by the
surface that is seen of an answer does: the more of that is without points, the less likely are the others.
"""

from __future__ import annotations

import numpy as np

from pwralign_kin.arrays import Bools, Ints
from pwralign_kin.estimation.comparison.candidates import Candidates
from pwralign_kin.estimation.comparison.ranking import better_ranked, ranked, ranks
from pwralign_kin.estimation.comparison.scan_comparison import ScanComparison
from pwralign_kin.estimation.refinement.joint_least_squares import JointLeastSquares
from pwralign_kin.estimation.refinement.surface_mixture import mean_log_likelihoods
from pwralign_kin.estimation.search.reinterpretation import refined_both_ways
from pwralign_kin.estimation.search.tree_search import TreeSearch

TURNS, GAIN = 3, 0.005
"""How often in a row limbs are held otherwise, as long as the scores that answers are ranked by and the mean logarithm
of the likelihood together gain this."""
SWEPT, REFINED, LOOKED_AT, SETTLED = 5, 16, 6, 3
"""Values of each joint, or pair of joints, that are looked at, and how many ways to hold limbs are refined, the best of
them held against their points, and fitted to the end."""
NARROW, HOPEFUL, TIED = 0.01, 0.03, 0.006
"""Robust scale that they are refined from, and by how much less one may score before it is fitted to the end, and
after that, for its likelihood to be looked at."""
APART = 0.015
"""Displacement of one part (model diagonals) from which on two configurations are not the same."""
LEAST_POINTS, PROBES = 8, 12
"""Points of a part from which on they may tell where it is, and samples of its surface that its displacement is
measured at."""


def scant_limbs_held(solver: JointLeastSquares, final: Candidates) -> Candidates | None:
    """Return a configuration (one) that is more likely than the `final` one, with other values in limbs of which the
    scan holds few points; None where there is none, and in views, where most such limbs are merely not seen."""
    found = None
    if solver.comparison.observation.single_view:
        return None
    for _ in range(TURNS):
        better = _held_better(solver, final if found is None else found)
        if better is None:
            break
        found = better
    return found


def _held_better(solver: JointLeastSquares, final: Candidates) -> Candidates | None:
    comparison = solver.comparison
    swept = _swept(comparison, final)
    if swept is None:
        return None
    apart = APART / int(comparison.exists.sum())
    search = TreeSearch(comparison)
    promising = comparison.distinct(comparison.scored(swept, search.options.sift_points)[0], REFINED, apart)
    tried = comparison.refined(promising, iterations=10, sigma=NARROW)
    # What refinement alone would gain is no merit of another way to hold a limb.
    start = ranked(comparison, refined_both_ways(comparison, final)).take([0])
    both = Candidates.concatenate([start, tried])
    scores = ranks(comparison, both)
    hopeful = scores > scores[0] - HOPEFUL
    scores[0] = np.inf  # the first of all that are distinct
    several = comparison.distinct(Candidates(both.bases, both.values, scores).take(hopeful), 1 + LOOKED_AT, apart)
    several = several.take(np.flatnonzero(_tell(comparison, several))[: 1 + SETTLED])
    if len(several) == 1:
        return None
    settled = better_ranked(comparison, several, _settled(solver, several))
    settled = settled.take(settled.scores >= settled.scores[0] - TIED)
    if len(settled) == 1:
        return None
    likely = settled.scores + mean_log_likelihoods(solver, settled)
    best = int(np.argmax(likely))
    return settled.take([best]) if likely[best] >= likely[0] + GAIN else None


def _swept(comparison: ScanComparison, answer: Candidates) -> Candidates | None:
    """Return the answer (one) with the joints about parts that lack points swept, one by one and with the next; None
    where no part does."""
    single, first, second = _joints_about(comparison, answer)
    if len(single) == 0:
        return None
    alone = np.full_like(single, -1)
    joint, with_joint = np.concatenate([single, first]), np.concatenate([alone, second])
    return comparison.swept(answer, joint, np.zeros(len(joint), bool), SWEPT, with_joint)


def _joints_about(comparison: ScanComparison, answer: Candidates) -> tuple[Ints, Ints, Ints]:
    """Return the joints of and next to parts that lack points, and those in a row of these, inner and outer."""
    parent, actuated, lacks = comparison.parent, comparison.model.actuated, comparison.lacks(answer)
    single, pairs = set(), set()
    for part in range(1, len(parent)):
        above = int(parent[part])
        if not (lacks[part] or (above > 0 and lacks[above])):
            continue
        single.add(int(actuated[part]))
        if above > 0 and actuated[above] != actuated[part]:
            single.add(int(actuated[above]))
            pairs.add((int(actuated[above]), int(actuated[part])))
    first, second = np.array(sorted(pairs), np.int32).reshape(-1, 2).T
    return np.array(sorted(single), np.int32), np.ascontiguousarray(first), np.ascontiguousarray(second)


def _tell(comparison: ScanComparison, several: Candidates) -> Bools:
    """Return which (m,) of several configurations hold parts elsewhere than the first that have points there or here,
    and the first itself: what has none may be anywhere."""
    T = comparison.part_placements(several)
    moves = (T - T[:1])[:, comparison.exists]
    probes = [s.samples[:PROBES].T for s in comparison.surfaces if s.exists]
    apart = [np.linalg.norm(moves[:, i, :3, :3] @ x + moves[:, i, :3, 3:], axis=1) for i, x in enumerate(probes)]
    moved = np.stack([own.mean(axis=1) > APART for own in apart], axis=1)
    owners = [comparison.owners(several.take([i]), comparison.exists)[1] for i in range(len(several))]
    counts = [np.bincount(own[own >= 0], minlength=len(comparison.exists)) for own in owners]
    points = np.array(counts)[:, comparison.exists]
    told: Bools = (moved & (np.maximum(points, points[0]) >= LEAST_POINTS)).any(axis=1)
    told[0] = True
    return told


def _settled(solver: JointLeastSquares, several: Candidates) -> Candidates:
    """Return the configurations after the joint least squares."""
    fitted = [
        solver.run(base, solver.limited(values)).configuration
        for base, values in zip(several.bases, several.values, strict=True)
    ]
    return Candidates.concatenate(fitted)
