"""How far joints lie from the values they were given, as several scans with one base tell together.

Encoders have zeros of their own, and files of joint values get mixed up: then a base that is fitted to these values is
wrong, and its standard deviation does not know. Base and one offset a joint, the same in all scans, are fitted to all
of them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pwralign_kin.estimation.comparison.candidates import Candidates
from pwralign_kin.estimation.doubt.uncertainty import (
    inverse_covariance,
    least_visible,
    mean_information,
    observed_errors,
)
from pwralign_kin.estimation.refinement.bounded_step import bounded_step
from pwralign_kin.estimation.refinement.joint_least_squares import JointLeastSquares
from pwralign_kin.estimation.refinement.matrices import normal_matrix
from pwralign_kin.estimation.refinement.problem import Problem, Solution
from pwralign_kin.model import ArticulatedModel
from pwralign_kin.se3 import Array

STEPS = 20
"""Most Gauss-Newton steps."""
LARGE_STDS, LEAST_TURN, LEAST_SLIDE = 3.0, float(np.radians(1.5)), 0.01
"""An offset is large from so many standard deviations on, and from this turn (rad) or slide (model diagonals)."""


@dataclass(frozen=True)
class JointOffset:
    """How far a joint lies from where it is said to be."""

    value: float
    """rad or m; what must be added."""
    std: float
    """Standard deviation, rad or m; that of the joint's range where the scans tell nothing."""
    large: bool
    """Whether noise and sensor cannot explain it."""


@dataclass(frozen=True)
class JointOffsets:
    """Offsets of the joints that are given in every scan, by name."""

    shared: Mapping[str, JointOffset]
    """From the given values, the same in all scans: zeros of encoders."""
    own: tuple[Mapping[str, JointOffset], ...]
    """Of each scan besides, with the base where all scans have it: mixed-up values, a robot that moved."""

    def large(self) -> Iterator[tuple[int | None, str, JointOffset]]:
        """Yield the offsets that noise and sensor cannot explain, with their scan, None for all, and their joint."""
        for scan, offsets in ((None, self.shared), *enumerate(self.own)):
            yield from ((scan, name, offset) for name, offset in offsets.items() if offset.large)


def joint_offsets(solvers: Sequence[JointLeastSquares], solutions: Sequence[Solution]) -> JointOffsets:
    """Return the offsets of the joints that are locked in every scan, at the solutions with the given values.

    The solutions have one base. Joints that are free in a scan follow in it. Offsets are found within the
    reach of the correspondences.
    """
    locked = np.stack([solver.locked for solver in solvers])
    given = np.flatnonzero(locked.all(axis=0))
    if len(given) == 0:
        return JointOffsets({}, tuple({} for _ in solvers))
    bases, values = [solution.base for solution in solutions], [solution.values for solution in solutions]
    together = _fitted(solvers, _places(locked), bases, values)
    shared = _offsets(solvers[0].model, given, together.values[0] - values[0], together, 6 + np.arange(len(given)))
    own = []
    for solver, base, value in zip(solvers, together.bases, together.values, strict=True):
        free = ~solver.locked
        free[given] = True
        at = np.full(6 + len(value), -1)
        at[6:][free] = np.arange(free.sum())
        alone = _fitted([solver], [at], [base], [value])
        own.append(_offsets(solver.model, given, alone.values[0] - value, alone, at[6 + given]))
    return JointOffsets(shared, tuple(own))


@dataclass(frozen=True)
class _Fitted:
    """Configurations (search units) of scans fitted together."""

    bases: list[Array]
    values: list[Array]
    std: Array
    """(n,) standard deviations of all unknowns."""
    visible: Array
    """(n,) how far an unknown must move to displace what is seen beyond what passes for an error of the sensor."""


def _fitted(
    solvers: Sequence[JointLeastSquares],
    places: Sequence[NDArray[np.int64]],
    bases: list[Array],
    values: list[Array],
) -> _Fitted:
    """Fit scans together, whose unknowns stand at `places` (see `_places`), from configurations near by."""
    problems = _problems(solvers, bases, values)
    for _ in range(STEPS):
        scale = 1.0 / problems[0].evidence
        H = _summed(places, [scale * problem.evidence * problem.H for problem in problems])
        g = _summed(places, [scale * problem.evidence * problem.g for problem in problems])
        most = np.full(len(g), solvers[0].options.most_turn)
        try:
            step = bounded_step(H, g, -most, most, solvers[0].options.damping)
        except np.linalg.LinAlgError:
            break
        own = [np.where(at >= 0, step[at], 0.0) for at in places]
        moved = [s.stepped(b, v, move) for s, b, v, move in zip(solvers, bases, values, own, strict=True)]
        bases = [base for base, _ in moved]
        values = [
            np.where(s.locked, v + move[6:], limited)
            for s, v, move, (_, limited) in zip(solvers, values, own, moved, strict=True)
        ]
        problems = _problems(solvers, bases, values)
        if np.abs(step).max() < solvers[0].options.tolerance:
            break
    std, visible = _doubts(solvers, places, bases, values, problems)
    return _Fitted(bases, values, std, visible)


def _offsets(
    model: ArticulatedModel, joints: NDArray[np.int64], found: Array, fitted: _Fitted, places: NDArray[np.int64]
) -> dict[str, JointOffset]:
    """Return the offsets of `joints` (m,), which stand at `places` (m,), by name; `found` (k,) of all joints."""
    least = np.where(model.prismatic, LEAST_SLIDE, LEAST_TURN)[joints]
    std, visible, found = fitted.std[places], fitted.visible[places], found[joints]
    large = np.abs(found) > np.maximum(np.maximum(LARGE_STDS * std, visible), least)
    scales = model.joint_scales[joints]
    return {
        model.joint_names[joint]: JointOffset(float(scale * value), float(scale * doubt), bool(beyond))
        for joint, scale, value, doubt, beyond in zip(joints, scales, found, std, large, strict=True)
    }


def _places(locked: NDArray[np.bool_]) -> list[NDArray[np.int64]]:
    """Return of each scan where base twist and joints (6 + k,) stand among all unknowns, -1 for those that are held.

    First comes the base, then the joints that are `locked` (scans, k) in all scans, then, scan by scan, those that are
    free in it.
    """
    everywhere = locked.all(axis=0)
    count = 6 + int(everywhere.sum())
    places = []
    for held in locked:
        at = np.full(6 + len(held), -1)
        at[:6] = np.arange(6)
        at[6:][everywhere] = 6 + np.arange(everywhere.sum())
        at[6:][~held] = count + np.arange(int((~held).sum()))
        count += int((~held).sum())
        places.append(at)
    return places


def _problems(solvers: Sequence[JointLeastSquares], bases: Sequence[Array], values: Sequence[Array]) -> list[Problem]:
    return [
        solver.build(base, value, solver.robust_scale(solver.residual(base, value)))
        for solver, base, value in zip(solvers, bases, values, strict=True)
    ]


def _summed(places: Sequence[NDArray[np.int64]], pieces: Sequence[Array]) -> Array:
    """Return the sum over scans of vectors (6 + k,) or matrices (6 + k, 6 + k), each entry at its place."""
    size = 1 + max(int(at.max()) for at in places)
    total = np.zeros((size,) * pieces[0].ndim)
    for at, piece in zip(places, pieces, strict=True):
        free = at >= 0
        total[np.ix_(*[at[free]] * piece.ndim)] += piece[np.ix_(*[free] * piece.ndim)]
    return total


def _doubts(
    solvers: Sequence[JointLeastSquares],
    places: Sequence[NDArray[np.int64]],
    bases: Sequence[Array],
    values: Sequence[Array],
    problems: Sequence[Problem],
) -> tuple[Array, Array]:
    """Return `std` and `visible` of `_Fitted`."""
    model = solvers[0].model
    span = (model.upper - model.lower) / model.joint_scales
    inverse: list[Array] = []
    displaced: list[Array] = []
    for solver, base, value, problem in zip(solvers, bases, values, problems, strict=True):
        absent = ~solver.comparison.exists
        errors = observed_errors(solver.comparison, Candidates.single(base, value), problem)
        H = inverse_covariance(problem, absent, errors, span)
        if inverse:
            H[:6, :6] -= problem.prior.H[:6, :6]  # known once
        inverse.append(H)
        seen, displacements = mean_information(problem, absent)
        displaced.append(normal_matrix(problem.J[seen], displacements) / (len(solvers) * least_visible(errors) ** 2))
    return _widths(_summed(places, inverse), 1e-6), _widths(_summed(places, displaced), 1e-9)


def _widths(H: Array, ridge: float) -> Array:
    """Return the roots of the diagonal of the inverse of `H` (n, n), with a `ridge` for what nothing holds."""
    return np.sqrt(np.maximum(np.diag(np.linalg.inv(H + ridge * np.eye(len(H)))), 0.0))
