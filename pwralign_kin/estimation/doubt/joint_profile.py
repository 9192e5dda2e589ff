"""Joints that the points tell little of, compared at all their values.

The slope of the surface at one value says little of a nearly round base: its few bolts and edges tell the value, but an
answer may stand at the wrong one, from where no least squares leads to the right one. So it is with parts that few or
noisy points lie on.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pwralign_kin.arrays import Bools, Indices, Ints
from pwralign_kin.estimation.comparison.candidates import Candidates
from pwralign_kin.estimation.comparison.search_options import BAND
from pwralign_kin.estimation.doubt.uncertainty import POINTS_AS_ONE, PROBE_SLIDE, PROBE_TURN, Errors
from pwralign_kin.estimation.refinement.joint_least_squares import JointLeastSquares
from pwralign_kin.estimation.sensing.points import at_most
from pwralign_kin.se3 import Array, inverse

MOST_STD = 3.0
"""A residual of more standard deviations counts as one of so many: a point of something else."""
UNMOVED = 1e-9
"""Placements that differ by less are the same."""
APART = 2.5
"""Values farther apart than this many probe motions are different answers."""
MOST_POINTS = 1500
"""Points of either side that are looked at, ..."""
LOOKS, NEIGHBOURS = (1, 3, 12), 8
"""... some at first and the others only of values that those do not speak against by `NO_RIVAL`: so many sixteenths of
the groups of so many points that lie next to each other."""
NO_RIVAL = 6.0
"""Log-likelihood by which the best value of a weakly determined joint must be better than all others."""
RIVALS = 2
"""Other answers that are worth a closer look, at most."""


@dataclass(frozen=True)
class Profile:
    """How well one joint's values explain the points near the model."""

    bases: Array
    values: Array
    """The configurations (m, 4, 4), (m, k) with the joint at its best value and at the best of those that are other
    answers, search units."""
    behind: Array
    """(m,) log-likelihood of the best value over that of each."""
    gain: float
    """Log-likelihood of the best value over that of the value before."""
    margin: float
    """Log-likelihood of the best value over the best of those that are another answer; infinite without any."""
    spread: float
    """Log-likelihood of the best value over the worst. Like the others it is of few points where it is more than
    `NO_RIVAL`."""


def profiled(solver: JointLeastSquares, base: Array, values: Array, joint: int, errors: Errors, weak: bool) -> Profile:
    """Compare all values of one joint within its limits, the side with more points held in place.

    Where the surface tells the joint only weakly that side is turned as well: it may be the round one. Points have
    independent errors of the noise and the systematic residual, but only one in `POINTS_AS_ONE` counts.
    """
    comparison = solver.comparison
    here = Candidates.single(base, values)
    T = comparison.part_placements(here)[0]
    distance, owner = comparison.given_owners(here)
    owned = np.bincount(owner[distance < comparison.reach], minlength=len(T))
    tried, steps = _tried(solver, values, joint)
    turned = np.tile(values, (len(tried), 1))
    turned[:, joint] = tried
    bases = np.tile(base, (len(tried), 1, 1))
    placed = comparison.part_placements(Candidates(bases, turned, np.zeros(len(tried), np.float32)))
    # By the value next to this one: a full turn brings everything back.
    next_to = int(np.argmin(np.where(steps == 0, np.inf, np.abs(steps))))
    hangs = (np.abs(placed[next_to] - T) > UNMOVED).any(axis=(1, 2))
    back = T[np.argmax(hangs)] @ inverse(placed[:, np.argmax(hangs)])
    sides = [(bases, placed, hangs), (back @ bases, back[:, None] @ placed, ~hangs)]
    if owned[hangs].sum() > 0.5 * owned.sum():
        sides.reverse()
    now = int(np.flatnonzero(steps == 0)[0])
    bases, cost = sides[0][0], _cost(solver, T, owner, *sides[0][1:], now, errors)
    if weak:
        other = _cost(solver, T, owner, *sides[1][1:], now, errors)
        bases, cost = np.where((other < cost)[:, None, None], sides[1][0], bases), np.minimum(cost, other)
    count = len(cost) if solver.model.continuous[joint] else None
    modes = _modes(cost, steps, count)
    others = cost[_away(steps, modes[0], count) > APART]
    return Profile(
        bases[modes],
        turned[modes],
        cost[modes] - cost.min(),
        -float(cost.min()),
        float(others.min() - cost.min()) if len(others) else float("inf"),
        float(np.ptp(cost)),
    )


def _cost(
    solver: JointLeastSquares, T: Array, owner: Ints, placed: Array, moves: Bools, now: int, errors: Errors
) -> Array:
    """Return the negative log-likelihood (m,) of the points on the parts that move, when all are `placed`, over that of
    the value that the joint has `now`; of few points where these speak against a value by more than `NO_RIVAL`.

    They move from `T` (parts, 4, 4) to each of (m, parts, 4, 4); `owner` (n,) is the part that each point lies on.
    """
    comparison = solver.comparison
    on_side = comparison.observation.given[(owner >= 0) & moves[owner]]
    points = at_most(np.ascontiguousarray(on_side), MOST_POINTS)
    variance = errors.noise**2 + errors.systematic**2
    # Points farther off count all the same.
    reach = min(BAND, MOST_STD * float(np.sqrt(variance)))
    each = len(on_side) / max(len(points), 1) / (2.0 * POINTS_AS_ONE * variance)
    turn = np.arange(len(points)) // NEIGHBOURS % sum(LOOKS)
    cost, last = np.zeros(len(placed)), 0
    for share in LOOKS:
        some = np.ascontiguousarray(points[(turn >= last) & (turn < last + share)])
        last += share
        likely = np.flatnonzero(cost <= NO_RIVAL)
        # What the other side explains it explains whatever the value is.
        otherwise = comparison.distances(some, T[None], comparison.exists & ~moves, reach, loosely=True)
        left = comparison.distances(some, placed[likely], comparison.exists & moves, reach, loosely=True)
        np.square(np.minimum(left, otherwise, out=left), out=left)
        sums = left.sum(axis=1)
        cost[likely] += each * (sums - sums[likely == now])
    return cost


def _modes(cost: Array, steps: Indices, count: int | None) -> list[int]:
    """Return the index of the least cost, and those of the least others that are least among their neighbours."""
    left = np.pad(cost, 1, mode="wrap") if count is not None else np.pad(cost, 1, constant_values=np.inf)
    least = (cost <= left[:-2]) & (cost <= left[2:])
    modes: list[int] = []
    far = np.ones(len(cost), bool)
    for index in np.flatnonzero(least)[np.argsort(cost[least], kind="stable")]:
        if far[index]:
            modes.append(int(index))
            far &= _away(steps, modes[-1], count) > APART
        if len(modes) == 1 + RIVALS:
            break
    return modes


def _away(steps: Indices, index: int, count: int | None) -> Indices:
    """Return how many steps all values are from one, where `count` of them may be a full turn."""
    away: Indices = np.abs(steps - steps[index])
    return away if count is None else np.minimum(away, count - away)


def _tried(solver: JointLeastSquares, values: Array, joint: int) -> tuple[Array, Indices]:
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
