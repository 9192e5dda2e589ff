"""An articulated fit of distances by SciPy's least squares from many random starts: what one would write by hand.

Minimises the distances of scan points to the posed model, looked up in the grids that the model has anyway, over base
and joints together, with the limits as bounds and a robust loss (`scipy.optimize.least_squares`, trust region
reflective, as https://docs.scipy.org/doc/scipy/reference/generated/scipy.optimize.least_squares.html recommends for
bounded and robust problems). The distance is to the plane through the closest sample, signed by its outward normal.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pwralign_kin.checked_options import CheckedOptions, Count, Positive, Seed
from pwralign_kin.model import ArticulatedModel
from pwralign_kin.se3 import Array, skew
from pwralign_kin.state import State

_BEYOND = 65535
"""In a grid: no sample is near."""


@dataclass(frozen=True)
class SignedDistanceOptions(CheckedOptions):
    """Settings. Lengths in model diagonals."""

    points: Count = 600
    """Points of the scan that are fitted."""
    starts: Count = 16
    """Random starts where there is no guess; the lowest cost wins."""
    evaluations: Count = 40
    """Most evaluations of one start."""
    robust_scale: Positive = 0.02
    """Residual at which the loss (soft L1) turns from squares to absolute values."""
    beyond: Positive = 0.07
    """Residual of points that no grid covers: as far as grids reach."""
    seed: Seed = 0


def signed_distance_fit(
    model: ArticulatedModel, points: Array, initial: State | None = None, options: SignedDistanceOptions | None = None
) -> State:
    """Return the state of `model` that points (n, 3), m, are nearest to, started from `initial` if there is one."""
    from scipy.optimize import least_squares

    options = options or SignedDistanceOptions()
    random = np.random.default_rng(options.seed)
    problem = _Problem(model, points[random.permutation(len(points))[: options.points]], options)
    count = 1 if initial is not None else options.starts
    best, least = None, np.inf
    for _ in range(count):
        start = problem.random_start(random) if initial is None else problem.from_state(initial)
        found = least_squares(
            problem.residuals, start, problem.jacobian, bounds=problem.bounds, x_scale="jac", loss="soft_l1",
            f_scale=options.robust_scale, max_nfev=options.evaluations,
        )  # fmt: skip
        if found.cost < least:
            best, least = found.x, found.cost
    assert best is not None
    return problem.state(best)


class _Problem:
    """Variables: rotation vector and translation of the base, then the joints; lengths in diagonals."""

    def __init__(self, model: ArticulatedModel, points: Array, options: SignedDistanceOptions) -> None:
        self.model = model
        self.options = options
        self.centre = np.asarray(points.mean(axis=0))
        self.points = (points - self.centre) / model.diagonal
        self.unit = model.joint_scales
        # A locked joint would leave no room between its bounds.
        lower, upper = model.lower / self.unit, np.maximum(model.upper / self.unit, model.lower / self.unit + 1e-9)
        free = np.full(6, np.inf)
        self.bounds = np.r_[-free, lower], np.r_[free, upper]

    def random_start(self, random: np.random.Generator) -> Array:
        """Return random joints and a random turn about the middle of the scan, in which the model's middle is put."""
        from scipy.spatial.transform import Rotation

        lower, upper = (bound[6:] for bound in self.bounds)
        values = random.uniform(lower, upper)
        turn = Rotation.from_quat(random.normal(size=4))
        placed = self._placements(np.eye(4), values)
        weights = np.array([surface.area for surface in self.model.surfaces])
        middles = np.array([T[:3, :3] @ s.centre + T[:3, 3] for T, s in zip(placed, self.model.surfaces, strict=True)])
        middle = weights @ middles / weights.sum()
        return self._within(np.r_[turn.as_rotvec(), -turn.apply(middle), values])

    def from_state(self, state: State) -> Array:
        """Return the variables of a state."""
        from scipy.spatial.transform import Rotation

        T = self.model.root_placement(state)
        shift = (T[:3, 3] - self.centre) / self.model.diagonal
        values = self.model.values(state.joints) / self.unit
        return self._within(np.r_[Rotation.from_matrix(T[:3, :3]).as_rotvec(), shift, values])

    def state(self, variables: Array) -> State:
        """Return the state of the variables."""
        T = self._base(variables)
        T[:3, 3] = self.model.diagonal * T[:3, 3] + self.centre
        values = (self.unit * variables[6:]).tolist()
        return State(T, dict(zip(self.model.joint_names, values, strict=True)), self.model.root_link)

    def residuals(self, variables: Array) -> Array:
        """Return (n,) the signed distance of each point to the nearest part."""
        return self._nearest(variables)[0]

    def jacobian(self, variables: Array) -> Array:
        """Return (n, 6 + k) derivatives of the residuals, each with its closest sample held."""
        _, part, normals = self._nearest(variables)
        T = self._base(variables)
        jacobians = self.model.part_jacobians(self.unit * variables[6:]) * self.unit
        jacobians[:, 3:] /= self.model.diagonal
        origins = self._placements(np.eye(4), variables[6:])[:, :3, 3]
        J = np.zeros((len(self.points), len(variables)))
        on_model = part >= 0
        part, normals, arms = part[on_model], normals[on_model], self.points[on_model] - T[:3, 3]
        # What lies at a point of the surface moves with the base and with its part; residuals shrink as it follows.
        J[on_model, :3] = -np.cross(arms, normals) @ _left_jacobian(variables[:3])
        J[on_model, 3:6] = -normals
        local, turned = arms @ T[:3, :3] - origins[part], normals @ T[:3, :3]
        moments = np.concatenate([np.cross(local, turned), turned], axis=1)
        J[on_model, 6:] = -np.einsum("na,nak->nk", moments, jacobians[part])
        return J

    def _nearest(self, variables: Array) -> tuple[Array, NDArray[np.int64], Array]:
        """Return per point the signed distance to the nearest part, its index (-1: none near) and its normal."""
        placed = self._placements(self._base(variables), variables[6:])
        least = np.full(len(self.points), self.options.beyond)
        residual, part, normal = least.copy(), np.full(len(self.points), -1), np.zeros_like(self.points)
        for index, (T, surface) in enumerate(zip(placed, self.model.surfaces, strict=True)):
            if not surface.exists:
                continue
            local = (self.points - T[:3, 3]) @ T[:3, :3]
            cell = np.floor((local - surface.origin) / surface.cell).astype(np.int64)
            inside = np.flatnonzero(((cell >= 0) & (cell < surface.grid.shape)).all(axis=1))
            sample = surface.grid[tuple(cell[inside].T)]
            inside, sample = inside[sample != _BEYOND], sample[sample != _BEYOND]
            offset = local[inside] - surface.dense[sample]
            distance = np.linalg.norm(offset, axis=1)
            nearer = distance < least[inside]
            inside, own = inside[nearer], surface.dense_normals[sample[nearer]].astype(float)
            least[inside], part[inside] = distance[nearer], index
            residual[inside] = np.einsum("ni,ni->n", offset[nearer], own)
            normal[inside] = own @ T[:3, :3].T
        return residual, part, normal

    def _placements(self, T: Array, values: Array) -> Array:
        """Return (parts, 4, 4) with lengths in diagonals."""
        placed = self.model.part_placements(self.unit * values)
        placed[:, :3, 3] /= self.model.diagonal
        return np.asarray(T @ placed)

    @staticmethod
    def _base(variables: Array) -> Array:
        from scipy.spatial.transform import Rotation

        T = np.eye(4)
        T[:3, :3], T[:3, 3] = Rotation.from_rotvec(variables[:3]).as_matrix(), variables[3:6]
        return T

    def _within(self, variables: Array) -> Array:
        """Return the variables strictly within the bounds, as the solver wants them."""
        low, high = self.bounds
        room = np.where(np.isfinite(high - low), 1e-6 * (high - low), 0.0)
        return np.clip(variables, low + room, high - room)


def _left_jacobian(vector: Array) -> Array:
    """Return the (3, 3) derivative of a rotation by its rotation vector, in fixed axes (Sola et al., 2018, eq. 145)."""
    angle, cross = float(np.linalg.norm(vector)), skew(vector)
    if angle < 1e-6:
        return np.asarray(np.eye(3) + 0.5 * cross)
    first, second = (1.0 - np.cos(angle)) / angle**2, (angle - np.sin(angle)) / angle**3
    return np.asarray(np.eye(3) + first * cross + second * cross @ cross)
