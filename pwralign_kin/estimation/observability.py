"""Which joints the scan determines, and how well; the others keep their prior value where that costs nothing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pwralign_kin.estimation.answer_search import finest
from pwralign_kin.estimation.candidates import Candidates
from pwralign_kin.estimation.joint_least_squares import JointLeastSquares, Solution
from pwralign_kin.estimation.joint_profile import profiled
from pwralign_kin.estimation.surface_mixture import solved
from pwralign_kin.estimation.uncertainty import (
    WEAK_DISPLACEMENT,
    Errors,
    covariance,
    inverse_covariance,
    observed_errors,
    probe_displacements,
    undetermined_joints,
)
from pwralign_kin.se3 import Array, inverse

NO_COST = 0.004
"""Score that an undetermined joint may cost when it is set to its prior, ..."""
NO_POINTS = 3.0
"""... and scan points that it may leave unexplained, ..."""
NO_SUPPORT = 0.15
"""... and support that it may cost any one part: that of a small part is little of the score, ..."""
NO_LIKELIHOOD = 5.0
"""... and logarithm of the likelihood of all scan points."""
NO_RIVAL = 6.0
"""Log-likelihood by which the best value of a weakly determined joint must be better than all others."""


@dataclass(frozen=True)
class Doubt:
    """What the scan does not tell, in search units."""

    undetermined: NDArray[np.bool_]
    """(k,) joints."""
    covariance: Array
    """(6 + k, 6 + k) of base twist and joints; zero rows where undetermined."""


def doubted(solver: JointLeastSquares, solution: Solution, prior: Array) -> tuple[Solution, Doubt]:
    """Find the joints that the scan does not tell, and give them their `prior` value (k,) where that costs nothing."""
    search, final = solver.search, solution.configuration
    errors = observed_errors(search, final, solution.problem)
    # Points of its neighbours touch a part that the scan lacks.
    absent = search.scored(final)[1][0] <= 0.0 if not search.observation.single_view else ~search.exists
    displacement = probe_displacements(solution.problem, absent, solver.model.prismatic, solver.locked)
    undetermined = undetermined_joints(displacement, solver.locked, errors)
    weak = undetermined & ~undetermined_joints(displacement, solver.locked, errors, WEAK_DISPLACEMENT)
    if weak.any():
        solution, sure = _compared(solver, solution, np.flatnonzero(weak), errors)
        undetermined &= ~sure
    if undetermined.any():
        base, values = solution.base, solution.values.copy()
        for joint in np.flatnonzero(undetermined):
            base, values = _at_prior(solver, base, values, int(joint), prior)
        solution = solved(solver.with_locked(undetermined, values), base, values, solution.problem.blur)
    H = inverse_covariance(solution.problem, absent, errors, solver.upper - solver.lower)
    return solution, Doubt(undetermined, covariance(H, solver.locked, undetermined))


def _compared(
    solver: JointLeastSquares, solution: Solution, weak: NDArray[np.int64], errors: Errors
) -> tuple[Solution, NDArray[np.bool_]]:
    """Give weakly determined joints their best values; return too which (k,) have no rival to them."""
    sure = np.zeros(len(solution.values), bool)
    for joint in weak:
        profile = profiled(solver, solution.base, solution.values, int(joint), errors)
        if profile.margin <= NO_RIVAL:
            continue
        if profile.gain > 0.0:
            # The likelihood is of the points alone: what they leave of the model unseen may speak against it.
            better = solved(solver, profile.base, solver.limited(profile.values), solution.problem.blur)
            both = Candidates.concatenate([solution.configuration, better.configuration])
            before, after = solver.search.weighed(both)[0]
            if after < before - NO_COST:
                continue
            solution = better
        sure[joint] = True
    return solution, sure


def _at_prior(solver: JointLeastSquares, base: Array, values: Array, joint: int, prior: Array) -> tuple[Array, Array]:
    """Set one joint to its prior, moving what hangs on it or else all the rest, unless the scan speaks against."""
    search = solver.search
    moved = values.copy()
    moved[joint] = prior[joint]
    child = next(i for i, part in enumerate(solver.model.parts) if part.joint and part.joint.actuated == joint)
    before, after = (search.part_placements(Candidates.single(np.eye(4), v))[0, child] for v in (values, moved))
    bases = np.array([base, base, base @ before @ inverse(after)])
    choices = Candidates(bases, np.array([values, moved, moved]), np.zeros(3, np.float32))
    scores, coverage, seen = search.weighed(choices)
    best = int(np.argmax(scores[1:])) + 1
    lost = (coverage[0] - coverage[best]) * len(search.observation.points)
    hidden = float((seen[0] - seen[best]).max(initial=0.0, where=search.exists))
    if scores[best] < scores[0] - NO_COST or lost > NO_POINTS or hidden > NO_SUPPORT:
        return base, values
    likelihood = finest(search, choices) * len(search.observation.given)
    if likelihood[best] < likelihood[0] - NO_LIKELIHOOD:
        return base, values
    return bases[best], moved
