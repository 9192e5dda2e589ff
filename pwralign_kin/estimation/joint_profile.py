"""Joints that move the surface little, compared at all their values.

The slope of the surface at one value says little of a nearly round base: its few bolts and edges tell the value, but an
answer may stand at the wrong one, from where no least squares leads to the right one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pwralign_kin.estimation.candidates import Candidates
from pwralign_kin.estimation.joint_least_squares import JointLeastSquares
from pwralign_kin.estimation.tree_search import TreeSearch
from pwralign_kin.estimation.uncertainty import POINTS_AS_ONE, PROBE_SLIDE, PROBE_TURN, Errors
from pwralign_kin.se3 import Array, inverse

MOST_STD = 3.0
"""A residual of more standard deviations counts as one of so many: a point of something else."""
UNMOVED = 1e-9
"""Placements that differ by less are the same."""
APART = 2.5
"""Values farther apart than this many probe motions are different answers."""


@dataclass(frozen=True)
class Profile:
    """How well one joint's values explain the points near the model."""

    base: Array
    values: Array
    """The configuration (4, 4), (k,) with the joint at its best value, search units."""
    gain: float
    """Log-likelihood of the best value over that of the value before."""
    margin: float
    """Log-likelihood of the best value over the best of those that are another answer; infinite without any."""


def profiled(solver: JointLeastSquares, base: Array, values: Array, joint: int, errors: Errors) -> Profile:
    """Compare all values of one joint within its limits, the side with more points held in place.

    Points have independent errors of the noise and the systematic residual, but only one in `POINTS_AS_ONE` counts.
    """
    search = solver.search
    here = Candidates.single(base, values)
    T = search.part_placements(here)[0]
    distance, owner = _distances(search, search.observation.given, T, search.exists)
    owned = np.bincount(owner[distance < search.reach], minlength=len(T))
    tried, steps = _tried(solver, values, joint)
    turned = np.tile(values, (len(tried), 1))
    turned[:, joint] = tried
    bases = np.tile(base, (len(tried), 1, 1))
    placed = search.part_placements(Candidates(bases, turned, np.zeros(len(tried), np.float32)))
    moves = (np.abs(placed - T) > UNMOVED).any(axis=(0, 2, 3))
    if owned[moves].sum() > 0.5 * owned.sum():
        first = int(np.argmax(moves))
        back = T[first] @ inverse(placed[:, first])
        bases, placed = back @ bases, back[:, None] @ placed
        moves = (np.abs(placed - T) > UNMOVED).any(axis=(0, 2, 3))
    # What the other side explains it explains whatever the value is.
    on_side = (owner >= 0) & moves[owner]
    points = np.ascontiguousarray(search.observation.given[on_side])
    otherwise = _distances(search, points, T, search.exists & ~moves)[0]
    moved = search.distances(points, placed, search.exists & moves, search.options.near).astype(float)
    left = np.minimum(moved, otherwise)
    variance = errors.noise**2 + errors.systematic**2
    cost = np.minimum(np.square(left) / variance, MOST_STD**2).sum(axis=1) / (2.0 * POINTS_AS_ONE)
    best = int(cost.argmin())
    away = np.abs(steps - steps[best])
    if solver.model.continuous[joint]:
        away = np.minimum(away, round(2.0 * np.pi / PROBE_TURN) - away)
    others = cost[away > APART]
    return Profile(
        bases[best],
        turned[best],
        float(cost[steps == 0][0] - cost[best]),
        float(others.min() - cost[best]) if len(others) else float("inf"),
    )


def _tried(solver: JointLeastSquares, values: Array, joint: int) -> tuple[Array, NDArray[np.int64]]:
    """Return values of a joint (m,) within its limits, and how many probe motions they are from the one it has."""
    step = PROBE_SLIDE if solver.model.prismatic[joint] else PROBE_TURN
    if solver.model.continuous[joint]:
        count = round(2.0 * np.pi / step)
        steps = np.arange(count) - count // 2
    else:
        most = 2.0 * np.pi / PROBE_TURN
        below = min((values[joint] - solver.lower[joint]) / step, most)
        above = min((solver.upper[joint] - values[joint]) / step, most)
        steps = np.arange(-int(below), int(above) + 1)
    return values[joint] + step * steps, steps


def _distances(
    search: TreeSearch, points: NDArray[np.float32], placements: Array, parts: NDArray[np.bool_]
) -> tuple[Array, NDArray[np.int32]]:
    """Return of points how far they are from the nearest of `parts` of a posed model, and which it is."""
    distance, owner = search.assigned(points, placements, parts, search.options.near)
    return distance.astype(float), owner
