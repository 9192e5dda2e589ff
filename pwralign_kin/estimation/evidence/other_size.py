"""Whether the points fit a model of another size better: a wrong unit or variant, or a thing that is merely alike."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pwralign_kin import kernels
from pwralign_kin.estimation.refinement.bounded_step import bounded_step
from pwralign_kin.estimation.refinement.joint_least_squares import JointLeastSquares
from pwralign_kin.estimation.refinement.problem import Solution
from pwralign_kin.se3 import Array

MOST_POINTS = 600
"""Scan points that are looked at."""
LEAST_POINTS = 50
"""Points near the model below which they tell no size."""
SIGMA, REACH = 0.012, 0.036
"""Scale of the robust kernel and farthest correspondence (model diagonals): sizes are far from one another."""
ROUNDS = 12
MOST_GROWTH = 0.1
"""Logarithm of the size in one step, at most."""
UNCHANGED = 0.003
"""Step up to which the size is the one before."""
LEAST_GAIN, LEAST_CHANGE = 0.025, 0.02
"""Less than this gain, and less than this logarithm of a size, come of the bias of sensors, ..."""
CHANGE_BY_NOISE = 6.0
"""... and so much more of it, times the noise, of points that noise takes out of thin parts."""
NOISES = 1.5
"""How many times the noise points are from a surface that they lie on less well."""


@dataclass(frozen=True)
class OtherSize:
    """What else the size of the model could be."""

    factor: float = 1.0
    """How many times as large as the model; 1 where no other size explains more."""
    gain: float = 0.0
    """Mean by which points near the answer lie better on a model so large, each from 0 to 1."""


SAME_SIZE = OtherSize()


def other_size(solver: JointLeastSquares, solution: Solution) -> OtherSize:
    """Return the size that the points near an answer prefer, base and joints fitted along with it.

    Point to triangle, by Gauss-Newton; points are shrunk about the base's origin instead of the model grown.
    """
    comparison, observation = solver.comparison, solver.comparison.observation
    base, values, meshes = solution.base, solution.values, solver.model.kernel_meshes
    placements, twists = solver.part_twists(base, values)
    some = np.linspace(0, len(observation.given) - 1, min(len(observation.given), MOST_POINTS)).astype(int)
    near = some[comparison.assigned(observation.given[some], placements, comparison.exists, REACH)[0] < REACH]
    if len(near) < LEAST_POINTS:
        return SAME_SIZE
    given, normals = observation.given[near].astype(float), observation.given_normals[near].astype(float)
    blur = max(SIGMA, NOISES * observation.noise)
    lying: list[float] = []
    growth = 0.0
    while len(lying) <= ROUNDS:
        centre = base[:3, 3]
        points = np.ascontiguousarray(centre + (given - centre) * np.exp(-growth), np.float32)
        closest, part = kernels.closest_on_meshes(meshes, placements, points, REACH, comparison.threads)
        off = np.asarray(points - closest, np.float64)
        lying.append(float(np.where(part >= 0, np.exp(-0.5 * np.square(off).sum(axis=1) / blur**2), 0.0).mean()))
        if 1.0 - lying[0] < LEAST_GAIN:
            break  # no size could explain more
        try:
            step = _step(
                closest - centre, off, normals, part, twists, solver.step_bounds(values), solver.options.damping
            )
        except np.linalg.LinAlgError:
            return SAME_SIZE
        if abs(step[-1]) < UNCHANGED:
            break
        growth += step[-1]
        base, values = solver.stepped(base, values, step[:-1])
        placements, twists = solver.part_twists(base, values)
    gain = lying[-1] - lying[0]
    told = gain > LEAST_GAIN and abs(growth) > LEAST_CHANGE + CHANGE_BY_NOISE * observation.noise
    return OtherSize(float(np.exp(growth)), gain) if told else SAME_SIZE


def _step(
    arm: Array,
    off: Array,
    normals: Array,
    part: NDArray[np.int32],
    twists: Array,
    bounds: tuple[Array, Array],
    damping: float,
) -> Array:
    """Return the step (6 + k + 1,) of base twist, joints, and logarithm of the size.

    Points are `off` (n, 3) their closest on the model, which are at `arm` (n, 3) from the base's origin.
    """
    lines = np.concatenate([np.cross(arm, normals), normals], axis=1)
    moves = np.einsum("na,nab->nb", lines, twists[np.maximum(part, 0)])
    J = np.column_stack([moves, np.einsum("ij,ij->i", arm, normals)])
    weights = np.where(part >= 0, 1.0 / np.square(1.0 + np.square(off).sum(axis=1) / SIGMA**2), 0.0) / len(arm)
    weighted = J * weights[:, None]
    low, high = (np.append(bound, limit) for bound, limit in zip(bounds, (-MOST_GROWTH, MOST_GROWTH), strict=True))
    return bounded_step(weighted.T @ J, weighted.T @ np.einsum("ij,ij->i", off, normals), low, high, damping)
