"""Slides that cancel: those of a telescope, of which two together move only what is between them.

A sleeve lies along its neighbours wherever it is, so that the nearest surface tells hardly anything of it, and the
slope there no more: a least squares stays where it begins, and believes itself. The points tell where its ends are, for
none is seen close behind a surface that would hide it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pwralign_kin import kernels
from pwralign_kin.estimation.comparison.candidates import Candidates
from pwralign_kin.estimation.doubt.uncertainty import LEAST_POINTS, POINTS_AS_ONE, PROBE_SLIDE, Errors
from pwralign_kin.estimation.refinement.joint_least_squares import JointLeastSquares
from pwralign_kin.estimation.refinement.problem import Solution
from pwralign_kin.estimation.refinement.surface_mixture import solved
from pwralign_kin.se3 import Array

SAME = 1e-6
"""Directions that differ by less are the same."""
COARSE, FINE = 2, 8
"""Values that are compared in a probe motion, and to either side of the best in the step between two of those."""
MOST_VALUES = 60
"""Of the first, at most."""
MOST_POINTS = 800
"""Scan points that are looked at."""
MOST_STD = 3.0
"""A residual of more standard deviations counts as one of so many."""
FACING = 0.7
"""Cosine of a point's normal with the way to a surface, and with its normal, from which that hides the point."""
ROUNDS = 2
"""How often all pairs are gone through: all else is fitted anew to where a sleeve is found."""


@dataclass(frozen=True)
class Cancelling:
    """Two slides of which one undoes what the other does to all that hangs on both."""

    inner: int
    outer: int
    ratio: float
    """Motion of the outer joint that undoes one of the inner."""
    between: NDArray[np.int64]
    """Parts with surface that hang on the inner one only."""

    def direction(self, joints: int) -> Array:
        """Return how base and joints (6 + k,) move."""
        v = np.zeros(6 + joints)
        v[6 + self.inner], v[6 + self.outer] = 1.0, self.ratio
        return v


def cancelling(J: Array, exists: NDArray[np.bool_], slides: NDArray[np.bool_]) -> list[Cancelling]:
    """Return the pairs of `slides` (k,) that cancel for all that hangs on both, and move something with surface.

    `J` (parts, 6, 6 + k) are part twists by base and joints, `exists` (parts,) says which have surface.
    """
    joints = np.flatnonzero(slides)
    twists = np.moveaxis(J[:, :, 6:][:, :, joints], 2, 0)
    moved = (np.abs(twists) > SAME).any(axis=2).astype(float)
    flat = (twists * moved[:, :, None]).reshape(len(joints), 6 * len(exists))
    squared, products = np.square(twists).sum(axis=2), flat @ flat.T
    own = np.maximum(np.diag(products), SAME**2)
    # What the inner joint (rows) moves is all that the outer one (columns) moves, alike but for a factor, and more.
    hangs = (moved @ moved.T == moved.sum(axis=1)) & (moved.sum(axis=1) > 0.0)
    more = (moved @ exists)[:, None] > moved @ exists
    left = squared @ moved.T - products**2 / own
    return [
        Cancelling(
            int(joints[inner]), int(joints[outer]), float(-products[inner, outer] / own[outer]),
            np.flatnonzero((moved[inner] > moved[outer]) & exists),
        )
        for inner, outer in np.argwhere(hangs & more & (left < SAME**2))
    ]  # fmt: skip


@dataclass(frozen=True)
class Parted:
    """What the points tell of slides that cancel."""

    solution: Solution
    held: NDArray[np.bool_]
    """(k,) those slides."""
    untold: NDArray[np.bool_]
    """(k,) those of them that the scan does not tell."""
    covariance: Array
    """(6 + k, 6 + k) of base twist and joints, by how well each value of theirs explains the points."""


def parted(solver: JointLeastSquares, solution: Solution, errors: Errors) -> Parted:
    """Give slides that cancel the values that the points prefer, and say how sure these are."""
    count = len(solution.values)
    held, untold, spread = np.zeros(count, bool), np.zeros(count, bool), np.zeros((6 + count, 6 + count))
    pairs = cancelling(solution.problem.J, solver.comparison.exists, solver.model.prismatic & ~solver.locked)
    if not pairs:
        return Parted(solution, held, untold, spread)
    held[[joint for pair in pairs for joint in (pair.inner, pair.outer)]] = True
    stds = np.zeros(len(pairs))
    for _ in range(ROUNDS):
        values, moved = solution.values, np.zeros(len(pairs))
        for place, pair in enumerate(pairs):
            before = values
            values, stds[place] = _best(solver, solution.base, before, pair, errors)
            moved[place] = abs(values - before)[pair.inner]
        if (moved <= stds).all():
            break  # no better than what is there
        solution = solved(solver.with_locked(held, values), solution.base, values, solution.problem.blur)
    for pair, std in zip(pairs, stds, strict=True):
        untold[[pair.inner, pair.outer]] |= std > PROBE_SLIDE
        direction = pair.direction(count)
        spread += std**2 * np.outer(direction, direction)
    return Parted(solution, held, untold, spread)


def _best(
    solver: JointLeastSquares, base: Array, values: Array, pair: Cancelling, errors: Errors
) -> tuple[Array, float]:
    """Return the values (k,) with the pair where the points prefer it, and the standard deviation of that."""
    low, high = _range(solver, values, pair)
    step = max(PROBE_SLIDE / COARSE, (high - low) / MOST_VALUES)
    moves = np.arange(np.ceil(low / step), np.floor(high / step) + 1) * step
    slid = _Slid(solver, base, values, pair, moves)
    if len(slid.points) < LEAST_POINTS:
        return values, (high - low) / np.sqrt(12.0)
    costs = slid.costs(moves, errors)
    middle = moves[int(np.argmin(costs))]
    fine = middle + np.arange(1 - FINE, FINE) / FINE * step
    fine = fine[(fine >= low) & (fine <= high) & (fine != middle)]
    moves, costs = np.append(moves, fine), np.append(costs, slid.costs(fine, errors))
    order = np.argsort(moves)
    moves, costs = moves[order], costs[order]
    best = float(moves[np.argmin(costs)])
    chances = np.exp(costs.min() - costs) * (np.gradient(moves) if len(moves) > 1 else 1.0)
    variance = float(chances @ np.square(moves - best) / chances.sum()) + (step / FINE) ** 2 / 12.0
    return solver.limited(values + best * pair.direction(len(values))[6:]), float(np.sqrt(variance))


def _range(solver: JointLeastSquares, values: Array, pair: Cancelling) -> tuple[float, float]:
    """Return how far the inner joint can move, the outer one following, within the limits of both."""
    rates = pair.direction(len(values))[6:]
    moves = np.flatnonzero(rates)
    ends = (np.array([solver.lower, solver.upper]) - values)[:, moves] / rates[moves]
    return min(float(ends.min(axis=0).max()), 0.0), max(float(ends.max(axis=0).min()), 0.0)


class _Slid:
    """What is between two joints moved by them, held against the points near to where it may be."""

    def __init__(self, solver: JointLeastSquares, base: Array, values: Array, pair: Cancelling, moves: Array) -> None:
        """Take the points that are near after one of the `moves` (m,) of the inner joint."""
        self.solver, self.base, self.values, self.pair = solver, base, values, pair
        comparison, observation = solver.comparison, solver.comparison.observation
        self.mask = np.isin(np.arange(len(comparison.exists)), pair.between)
        placed = self.placed(moves)
        reach = comparison.options.near
        near = comparison.distances(observation.given, placed, self.mask, reach).min(axis=0) < reach
        chosen = np.flatnonzero(near)
        chosen = chosen[np.linspace(0, len(chosen) - 1, min(len(chosen), MOST_POINTS)).astype(int)]
        self.points = np.ascontiguousarray(observation.given[chosen])
        self.normals = np.ascontiguousarray(observation.given_normals[chosen])
        others = comparison.exists & ~self.mask
        self.otherwise = comparison.assigned(self.points, placed[0], others, reach)[0].astype(float)
        self.each = float(near.sum()) / max(len(chosen), 1) / POINTS_AS_ONE

    def placed(self, moves: Array) -> Array:
        """Return the placements (m, parts, 4, 4) of all parts."""
        values = self.values + moves[:, None] * self.pair.direction(len(self.values))[6:]
        bases = np.tile(self.base, (len(moves), 1, 1))
        return self.solver.comparison.part_placements(Candidates(bases, values, np.zeros(len(moves), np.float32)))

    def costs(self, moves: Array, errors: Errors) -> Array:
        """Return the negative log-likelihood (m,) of the points after each of the `moves`."""
        variance = errors.noise**2 + errors.systematic**2
        left = np.array([self._residuals(placements) for placements in self.placed(moves)])
        left = left.reshape(len(moves), len(self.points))
        return np.asarray(np.minimum(left**2 / variance, MOST_STD**2).sum(axis=1) * self.each / 2.0)

    def _residuals(self, placements: Array) -> Array:
        """Return how far the points (n,) are from the surface, or behind what hides them."""
        comparison = self.solver.comparison
        reach = comparison.options.near
        meshes = [self.solver.model.kernel_meshes[part] for part in self.pair.between]
        at = np.ascontiguousarray(placements[self.pair.between])
        closest, part = kernels.closest_on_meshes(meshes, at, self.points, reach, comparison.threads)
        way = closest.astype(float) - self.points
        distance = np.where(part >= 0, np.linalg.norm(way, axis=1), reach)
        alike = comparison.facing(self.points, self.normals, placements, self.mask, reach) > FACING
        hidden = alike & (part >= 0) & (np.einsum("ij,ij->i", way, self.normals) > FACING * distance)
        return np.where(hidden, distance, np.minimum(distance, self.otherwise))
