"""Whether the points fit a model of another size better: a wrong unit or variant, or a thing that is merely alike."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pwralign_kin import kernels
from pwralign_kin.arrays import Ints
from pwralign_kin.estimation.comparison.scan_comparison import ALIKE, ScanComparison
from pwralign_kin.estimation.refinement.bounded_step import bounded_step
from pwralign_kin.estimation.refinement.joint_least_squares import JointLeastSquares
from pwralign_kin.estimation.refinement.problem import Solution
from pwralign_kin.se3 import Array

MOST_POINTS, MOST_SAMPLES = 600, 600
"""Scan points, and samples of the model's surface, that are looked at, at most."""
LEAST_SAMPLES = 8
"""Of each part, however small, at least."""
LEAST_POINTS = 50
"""Points near the model below which they tell no size."""
LEAST_SEEN = 0.75
"""Share of the surface in sight that is confirmed from which on no more of it would be at another size."""
SIGMA, REACH = 0.02, 0.1
"""Scale of the robust kernel and farthest correspondence (model diagonals): sizes are far from one another."""
ROUNDS = 40
"""Plates slide slowly to another size; prolonged steps overshoot with joints that curl."""
MOST_GROWTH = 0.1
"""Logarithm of the size in one step, at most, ..."""
MOST_CHANGE = 0.5
"""... and in all."""
UNCHANGED = 0.002
"""Step up to which the size is the one before."""
TURNING = 0.002
"""Length (model diagonals) from which an offset tells where it leads; a shorter one leads along the normal."""
CONFIRMED = 0.5
"""How much a share of the surface that is confirmed counts, against one of the points that lie on it."""
LEAST_GAIN, LEAST_CHANGE = 0.025, 0.045
"""Less than this gain, and less than this logarithm of a size, come of the bias of sensors, and of edges that fused
meshes round off, ..."""
BY_NOISE = 6.0
"""... and so much more of both, times the noise, of points that noise takes out of thin parts."""
BLUR, NOISES = 0.012, 1.5
"""Distance (model diagonals), or so many times the noise, at which points lie on a surface less well."""


@dataclass(frozen=True)
class OtherSize:
    """What else the size of the model could be."""

    factor: float = 1.0
    """How many times as large as the model; 1 where no other size explains more."""
    gain: float = 0.0
    """Mean by which points near the answer lie better on a model so large, each from 0 to 1, and half the share by
    which they confirm more of its surface in sight."""


SAME_SIZE = OtherSize()


def other_size(solver: JointLeastSquares, solution: Solution) -> OtherSize:
    """Return the size at which scan and model are the most alike near an answer, base and joints fitted along with it.

    A model too large explains all points as well, but lacks many; one too small has all of its surface confirmed, but
    leaves points beside it. So both are fitted: points to the surface, and the surface to the points.
    """
    base, values = solution.base, solution.values
    fit = _SizeFit(solver, _near(solver, base, values))
    if len(fit.given) < LEAST_POINTS:
        return SAME_SIZE
    growth = 0.0
    same = fit.alike(base, values, growth)
    if 1.0 + CONFIRMED - same < LEAST_GAIN:
        return SAME_SIZE  # no size could explain more
    for _ in range(ROUNDS):
        low, high = solver.step_bounds(values)
        low, high = np.append(low, -MOST_GROWTH), np.append(high, MOST_GROWTH)
        try:
            step = bounded_step(*fit.normal_equations(base, values, growth), low, high, solver.options.damping)
        except np.linalg.LinAlgError:
            return SAME_SIZE
        growth = float(np.clip(growth + step[-1], -MOST_CHANGE, MOST_CHANGE))
        base, values = solver.stepped(base, values, step[:-1])
        if abs(step[-1]) < UNCHANGED:
            break
    gain, by_noise = fit.alike(base, values, growth) - same, BY_NOISE * solver.comparison.observation.noise
    told = gain > LEAST_GAIN + by_noise and abs(growth) > LEAST_CHANGE + by_noise
    return OtherSize(float(np.exp(growth)), gain) if told else SAME_SIZE


class _SizeFit:
    """Base, joints, and logarithm of the size of a model, fitted to the points near an answer."""

    def __init__(self, solver: JointLeastSquares, points: Ints) -> None:
        observation = solver.comparison.observation
        self.solver = solver
        self.given = observation.given[points].astype(float)
        self.given_normals = observation.given_normals[points].astype(float)
        self.blur = max(BLUR, NOISES * observation.noise)
        self.part, self.samples, self.normals = _samples(solver.comparison)

    def alike(self, base: Array, values: Array, growth: float) -> float:
        """Return the mean by which the points lie on the model at one size, and what they confirm of its surface."""
        size, comparison = float(np.exp(growth)), self.solver.comparison
        placements, _ = self.solver.part_twists(base, values)
        off, _, part = self._off(base, placements, size)
        lying = np.where(part >= 0, np.exp(-0.5 * np.square(off).sum(axis=1) / self.blur**2), 0.0).mean()
        return float(lying) + CONFIRMED * comparison.confirmed_share(_grown(base, placements, size), size)

    def normal_equations(self, base: Array, values: Array, growth: float) -> tuple[Array, Array]:
        """Return the normal matrix (6 + k + 1,) squared and right-hand side of base twist, joints, and logarithm of the
        size, by Gauss-Newton on the distances of points from the surface and of the surface from the points."""
        size = float(np.exp(growth))
        placements, twists = self.solver.part_twists(base, values)
        off, closest, part = self._off(base, placements, size)
        H, g = _pulled(off, self.given_normals, size * (closest - base[:3, 3]), part, twists)
        reached, normals, places, sampled = self._lacking(_grown(base, placements, size), placements)
        H_samples, g_samples = _pulled(reached, normals, places - base[:3, 3], sampled, twists)
        return H + H_samples, g + g_samples

    def _off(self, base: Array, placements: Array, size: float) -> tuple[Array, Array, Ints]:
        """Return how far (n, 3) the points are off the model, where (n, 3) they are nearest to it and on which part
        (n,), -1 for none: points are shrunk about the base's origin instead of the model grown."""
        shrunk = base[:3, 3] + (self.given - base[:3, 3]) / size
        points = np.ascontiguousarray(shrunk, np.float32)
        meshes, threads = self.solver.model.kernel_meshes, self.solver.comparison.threads
        closest, part = kernels.closest_on_meshes(meshes, placements, points, REACH, threads)
        return size * np.asarray(points - closest, np.float64), closest.astype(float), part

    def _lacking(self, grown: Array, placements: Array) -> tuple[Array, Array, Array, Ints]:
        """Return how far (n, 3) the scanned surface is from samples of the model, its normals (n, 3), where (n, 3) the
        samples are and on which part (n,); -1 for those that are not told to be seen.

        Points are discs that are as wide as their spacing, and of a single view none is of what is turned away.
        """
        observation = self.solver.comparison.observation
        turns = grown[self.part, :3, :3]
        places = np.einsum("nij,nj->ni", turns, self.samples) + grown[self.part, :3, 3]
        facing = np.einsum("nij,nj->ni", placements[self.part, :3, :3], self.normals)
        nearest = observation.field.nearest(np.ascontiguousarray(places, np.float32), REACH)
        scanned = np.maximum(nearest, 0)
        normals, to_point = observation.normals[scanned].astype(float), observation.points[scanned] - places
        cosine = np.einsum("ij,ij->i", facing, normals)
        tells = (nearest >= 0) & ((cosine if observation.single_view else np.abs(cosine)) > ALIKE)
        if observation.sensor_origin is not None:
            tells &= np.einsum("ij,ij->i", facing, observation.sensor_origin - places) > 0.0
        across = np.einsum("ij,ij->i", to_point, normals)[:, None] * normals
        along = to_point - across
        length = np.linalg.norm(along, axis=1, keepdims=True)
        along *= np.maximum(0.0, 1.0 - observation.spacing / np.maximum(length, 1e-9))
        return across + along, normals, places, np.where(tells, self.part, -1)


def _near(solver: JointLeastSquares, base: Array, values: Array) -> Ints:
    """Return which of the points (n,) are near an answer."""
    given = solver.comparison.observation.given
    some = np.linspace(0, len(given) - 1, min(len(given), MOST_POINTS)).astype(int)
    placements, meshes = solver.part_twists(base, values)[0], solver.model.kernel_meshes
    part = kernels.closest_on_meshes(meshes, placements, given[some], REACH, solver.comparison.threads)[1]
    return np.asarray(some[part >= 0], np.int32)


def _samples(comparison: ScanComparison) -> tuple[Ints, Array, Array]:
    """Return samples of the model's surface, by area as far as parts have so many: the part (n,), place (n, 3) and
    normal (n, 3) of each."""
    shares = comparison.areas * comparison.exists / comparison.areas[comparison.exists].sum()
    counts = np.maximum(LEAST_SAMPLES, np.round(MOST_SAMPLES * shares)).astype(int) * comparison.exists
    several = [
        (surface.samples[:count], surface.normals[:count])
        for surface, count in zip(comparison.surfaces, counts, strict=True)
    ]
    part = np.repeat(np.arange(len(several)), [len(samples) for samples, _ in several])
    places, normals = (np.concatenate(own).astype(float) for own in zip(*several, strict=True))
    return part.astype(np.int32), places, normals


def _grown(base: Array, placements: Array, size: float) -> Array:
    """Return the placements (parts, 4, 4) of parts so many times as large, grown about the base's origin."""
    grown = placements.copy()
    grown[:, :3, :3] *= size
    grown[:, :3, 3] = base[:3, 3] + size * (placements[:, :3, 3] - base[:3, 3])
    return grown


def _pulled(offsets: Array, normals: Array, arms: Array, part: Ints, twists: Array) -> tuple[Array, Array]:
    """Return the normal matrix and right-hand side that draw the surface at `arms` (n, 3) from the base's origin along
    `offsets` (n, 3), mean over all; those of no part (-1) do not.

    Distances lead where they fall: off a face along its normal, beyond its border to the side.
    """
    length = np.linalg.norm(offsets, axis=1)
    across = np.sign(np.einsum("ij,ij->i", offsets, normals))[:, None] * normals
    directions = np.where((length > TURNING)[:, None], offsets / np.maximum(length, 1e-9)[:, None], across)
    lines = np.concatenate([np.cross(arms, directions), directions], axis=1)
    moves = np.einsum("na,nab->nb", lines, twists[np.maximum(part, 0)])
    J = np.column_stack([moves, np.einsum("ij,ij->i", arms, directions)])
    weights = np.where(part >= 0, 1.0 / np.square(1.0 + np.square(length / SIGMA)), 0.0) / max(len(part), 1)
    return (J * weights[:, None]).T @ J, (J * weights[:, None]).T @ length
