"""Which joints the scan determines, and how well; the others keep their prior value where that costs nothing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pwralign_kin import kernels
from pwralign_kin.arrays import Ints
from pwralign_kin.estimation.comparison.candidates import Candidates
from pwralign_kin.estimation.comparison.ranking import finest
from pwralign_kin.estimation.doubt.cancelling import parted
from pwralign_kin.estimation.doubt.joint_profile import NO_RIVAL, profiled
from pwralign_kin.estimation.doubt.uncertainty import (
    LEAST_POINTS,
    PLAIN_DISPLACEMENT,
    PROBE_SLIDE,
    PROBE_TURN,
    WEAK_DISPLACEMENT,
    Errors,
    covariance,
    inverse_covariance,
    observed_errors,
    probe_motions,
    undetermined_joints,
)
from pwralign_kin.estimation.refinement.joint_least_squares import JointLeastSquares
from pwralign_kin.estimation.refinement.likelihood import log_likelihoods
from pwralign_kin.estimation.refinement.problem import Solution
from pwralign_kin.estimation.refinement.surface_mixture import mean_log_likelihoods, solved
from pwralign_kin.estimation.sensing.points import at_most
from pwralign_kin.se3 import Array, from_twist, inverse

FEW_POINTS = 500
"""Points that the displacement by a probe motion is measured at."""
ON_PART, UNMOVED = 0.02, 2e-4
"""Distances (model diagonals) within which a point lies on a part, and from which a motion moves it."""
NO_COST = 0.004
"""Score that an undetermined joint may cost when it is set to its prior, ..."""
NO_POINTS = 3.0
"""... and scan points that it may leave unexplained, ..."""
NO_SUPPORT = 0.15
"""... and support that it may cost any one part: that of a small part is little of the score, ..."""
NO_LIKELIHOOD = 5.0
"""... and logarithm of the likelihood of all scan points, ..."""
NO_SURFACE = 0.005
"""... and, in scans of the model from all sides, mean logarithm of that by the surface that is seen, where a part that
moves with it holds points: surface in sight that has none speaks against the joint."""
BETTER = 3.0
"""Log-likelihood by which another value must be better than the one found, by the likelihood of all points."""
CHOICES = 2
"""The likeliest other values, by samples of the surface, among which its triangles choose."""
LOOSE = 1.0 / 3.0
"""Standard deviation of a joint, in units of its probe motion, from which on its other values are compared: noise may
have led to the wrong one."""


@dataclass(frozen=True)
class Doubt:
    """What the scan does not tell, in search units."""

    undetermined: NDArray[np.bool_]
    """(k,) joints."""
    covariance: Array
    """(6 + k, 6 + k) of base twist and joints; zero rows where undetermined."""


def doubted(solver: JointLeastSquares, solution: Solution, prior: Array) -> tuple[Solution, Doubt]:
    """Find the joints that the scan does not tell, and give them their `prior` value (k,) where that costs nothing."""
    comparison, final = solver.comparison, solution.configuration
    errors = observed_errors(comparison, final, solution.problem)
    # Points of its neighbours touch a part that the scan lacks.
    absent = comparison.scored(final)[1][0] <= 0.0 if not comparison.observation.single_view else ~comparison.exists
    motions, displacement = probe_motions(solution.problem, absent, solver.model.prismatic, solver.locked)
    nearly = undetermined_joints(displacement, solver.locked, errors, PLAIN_DISPLACEMENT)
    nearly &= ~undetermined_joints(displacement, solver.locked, errors)
    if nearly.any():
        closer = _displaced(solver, solution, absent, motions[:, nearly].T)
        displacement[nearly] = np.minimum(displacement[nearly], closer)
    undetermined = undetermined_joints(displacement, solver.locked, errors)
    weak = undetermined & ~undetermined_joints(displacement, solver.locked, errors, WEAK_DISPLACEMENT)
    probe = np.where(solver.model.prismatic, PROBE_SLIDE, PROBE_TURN)
    H = inverse_covariance(solution.problem, absent, errors, solver.upper - solver.lower)
    std = np.sqrt(np.diag(covariance(H, solver.locked, undetermined))[6:])
    loose = weak | (std > LOOSE * probe)
    if loose.any():
        solution, sure = _compared(solver, solution, loose, weak, errors)
        undetermined &= ~sure
    parting = parted(solver, solution, errors)
    solution = parting.solution
    undetermined = np.where(parting.held, parting.untold, undetermined)
    if undetermined.any():
        base, values = solution.base, solution.values.copy()
        for joint in np.flatnonzero(undetermined):
            base, values = _at_prior(solver, base, values, int(joint), prior, solution.problem.counts)
        held = undetermined | parting.held
        solution = solved(solver.with_locked(held, values), base, values, solution.problem.blur)
    H = inverse_covariance(solution.problem, absent, errors, solver.upper - solver.lower)
    return solution, Doubt(undetermined, covariance(H, solver.locked, undetermined, parting.covariance))


def _displaced(solver: JointLeastSquares, solution: Solution, absent: NDArray[np.bool_], motions: Array) -> Array:
    """Return by how much (n,) (model diagonals) `motions` (n, 6 + k) of base and joints take what is seen off the
    model's triangles.

    As in `probe_motions`: the mean squares of all observed parts are added.
    """
    problem, given = solution.problem, solver.comparison.observation.given
    placements, twists = solver.part_twists(solution.base, solution.values)
    meshes, threads = solver.model.kernel_meshes, solver.comparison.threads
    given = at_most(given, FEW_POINTS)
    seen, part = kernels.closest_on_meshes(meshes, placements, given, ON_PART, threads)
    counted = np.append((problem.counts >= LEAST_POINTS) & ~absent, False)
    seen, part = seen[counted[part]], part[counted[part]]
    about = solution.base[:3, 3]
    T = np.swapaxes(from_twist(motions @ np.swapaxes(twists, 1, 2))[part], 0, 1)  # (n, points, 4, 4)
    moved = (T[..., :3, :3] @ (seen - about)[..., None])[..., 0] + T[..., :3, 3] + about
    away = np.linalg.norm(moved - seen, axis=2) > UNMOVED
    points = np.ascontiguousarray(moved[away], np.float32)
    closest, near = kernels.closest_on_meshes(meshes, placements, points, ON_PART, threads)
    off = np.zeros(away.shape)
    off[away] = np.where(near >= 0, np.linalg.norm(points - closest, axis=1), ON_PART)
    count = np.maximum(np.bincount(part, minlength=len(absent)), 1)
    displaced: Array = np.sqrt((np.square(off) / count[part]).sum(axis=1))
    return displaced


def _compared(
    solver: JointLeastSquares, solution: Solution, loose: NDArray[np.bool_], weak: NDArray[np.bool_], errors: Errors
) -> tuple[Solution, NDArray[np.bool_]]:
    """Give loosely determined joints their best values; return too which (k,) have no rival to them.

    The surface tells those that are `weak` (k,) hardly.
    """
    comparison, sure = solver.comparison, np.zeros(len(solution.values), bool)
    rivals, of = [solution.configuration], [-1]
    for joint in np.flatnonzero(loose):
        profile = profiled(solver, solution.base, solution.values, int(joint), errors, bool(weak[joint]))
        sure[joint] = profile.margin > NO_RIVAL
        # What is weakly told, and not alone, is undetermined whichever value is better.
        if profile.spread < BETTER or (weak[joint] and not sure[joint]):
            continue
        worth = profile.behind < NO_RIVAL
        worth[0] &= profile.gain > 0.0
        scores = np.zeros(int(worth.sum()), np.float32)
        rivals.append(Candidates(profile.bases[worth], profile.values[worth], scores))
        of += [int(joint)] * len(scores)
    if len(of) == 1:
        return solution, sure
    # What refinement alone would gain is no merit of a rival.
    points = comparison.options.fine_points
    together = comparison.refined(Candidates.concatenate(rivals), points=points, iterations=10, sigma=0.01)
    likelihood = finest(comparison, together) * len(comparison.observation.given)
    # The likelihood is of the points alone: what they leave of the model unseen may speak against it.
    scores = comparison.weighed(together)[0]
    likelihood[scores < scores[0] - NO_COST] = -np.inf
    if likelihood.max() < likelihood[0] + BETTER:
        return solution, sure
    # Samples of the surface tell that the answer is wrong; which of the others is right is for the triangles.
    order = 1 + np.argsort(-likelihood[1:], kind="stable")[:CHOICES]
    near = np.append(0, order[likelihood[order] > likelihood.max() - NO_RIVAL])
    exact = log_likelihoods(solver, together.take(near))
    best = int(np.argmax(exact[1:])) + 1
    if exact[best] >= exact[0]:
        chosen = near[best]
        values = solver.limited(together.values[chosen])
        solution = solved(solver, together.bases[chosen], values, solution.problem.blur)
        sure[of[chosen]] |= exact[best] >= np.delete(exact, best).max() + NO_RIVAL
    return solution, sure


def _at_prior(
    solver: JointLeastSquares, base: Array, values: Array, joint: int, prior: Array, counts: Ints
) -> tuple[Array, Array]:
    """Set one joint to its prior, moving what hangs on it or else all the rest, unless the scan speaks against;
    `counts` (parts,) are the points of each part."""
    comparison = solver.comparison
    moved = values.copy()
    moved[joint] = prior[joint]
    child = next(i for i, part in enumerate(solver.model.parts) if part.joint and part.joint.actuated == joint)
    before, after = (comparison.part_placements(Candidates.single(np.eye(4), v))[0] for v in (values, moved))
    bases = np.array([base, base, base @ before[child] @ inverse(after[child])])
    choices = Candidates(bases, np.array([values, moved, moved]), np.zeros(3, np.float32))
    scores, coverage, seen = comparison.weighed(choices)
    best = int(np.argmax(scores[1:])) + 1
    lost = (coverage[0] - coverage[best]) * len(comparison.observation.points)
    hidden = float((seen[0] - seen[best]).max(initial=0.0, where=comparison.exists))
    if scores[best] < scores[0] - NO_COST or lost > NO_POINTS or hidden > NO_SUPPORT:
        return base, values
    likelihood = finest(comparison, choices.take([0, best])) * len(comparison.observation.given)
    if likelihood[1] < likelihood[0] - NO_LIKELIHOOD:
        return base, values
    moving = (before != after).any(axis=(1, 2)) == (best == 1)
    of_all_sides = not (comparison.observation.single_view or comparison.observation.scene)
    # What holds no points may be anywhere.
    if of_all_sides and (counts[moving] >= LEAST_POINTS).any():
        shown = mean_log_likelihoods(solver, choices.take([0, best]))
        if shown[1] < shown[0] - NO_SURFACE:
            return base, values
    return bases[best], moved
