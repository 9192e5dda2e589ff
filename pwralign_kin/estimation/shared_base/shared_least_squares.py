"""One base and the joints of all scans fitted to all scans together.

The normal matrix has the shape of an arrow: a block per scan that only the base's rows connect.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pwralign_kin import se3
from pwralign_kin.estimation.comparison.candidates import Candidates
from pwralign_kin.estimation.doubt.uncertainty import inverse_covariance, observed_errors
from pwralign_kin.estimation.refinement.bounded_step import bounded_step
from pwralign_kin.estimation.refinement.joint_least_squares import JointLeastSquares
from pwralign_kin.estimation.refinement.problem import Problem, Solution
from pwralign_kin.se3 import Array

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class SharedSolution:
    """The end of the joint least squares, in search units."""

    solutions: tuple[Solution, ...]
    """One a scan; the bases are the same placement in each scan's search frame."""
    base_covariance: Array
    """(6, 6)"""
    converged: bool
    iterations: int


class SharedLeastSquares:
    """One base and the joints of all scans fitted to all scans together."""

    def __init__(self, solvers: Sequence[JointLeastSquares]) -> None:
        """Take the problem of each scan; what they know of the base is counted once, as the first has it."""
        self.solvers = solvers
        self.joints = len(solvers[0].model.joint_names)
        points = np.array([len(solver.comparison.observation.given) for solver in solvers], float)
        self.shares = points / points.mean()

    def assembled(self, problems: Sequence[Problem]) -> tuple[Array, Array]:
        """Return normal matrix and right-hand side over [base twist, joints of scan 1, joints of scan 2, ...].

        The scans weigh by their points and the scales of their residuals: the result is an inverse covariance.
        """
        k = self.joints
        size = 6 + k * len(problems)
        H, g = np.zeros((size, size)), np.zeros(size)
        for i, (problem, share) in enumerate(zip(problems, self.shares, strict=True)):
            at = self.columns(i)
            prior_H, prior_g = problem.prior.H.copy(), problem.prior.g.copy()
            if i > 0:
                prior_H[:6, :6], prior_g[:6] = 0.0, 0.0
            H[np.ix_(at, at)] += share * problem.evidence * problem.H + prior_H
            g[at] += share * problem.evidence * problem.g + prior_g
        return H, g

    def columns(self, scan: int) -> NDArray[np.int64]:
        """Return where the base and the joints of one scan stand among all unknowns."""
        return np.concatenate([np.arange(6), 6 + scan * self.joints + np.arange(self.joints)])

    def run(self, starts: Sequence[Candidates]) -> SharedSolution:
        """Iterate from one configuration a scan, whose bases may differ a little, to convergence."""
        solvers, options = list(self.solvers), self.solvers[0].options
        observations = [solver.comparison.observation for solver in solvers]
        base = _mean([o.to_scan(start.bases[0]) for o, start in zip(observations, starts, strict=True)])
        known = solvers[0].comparison.known
        if known.held and known.placement is not None:
            base = observations[0].to_scan(known.placement)
        values = [s.limited(start.values[0]) for s, start in zip(solvers, starts, strict=True)]
        bases = [o.to_search(base) for o in observations]
        starting = list(zip(solvers, bases, values, strict=True))
        residuals = [solver.residual(b, v) for solver, b, v in starting]
        sigmas = [solver.robust_scale(residual) for solver, residual in zip(solvers, residuals, strict=True)]
        solvers = [solver.looking(b, v, own) for (solver, b, v), own in zip(starting, residuals, strict=True)]
        converged, iterations = not options.enabled, 0
        while True:
            bases = [o.to_search(base) for o in observations]
            problems = [s.build(b, v, sigma) for s, b, v, sigma in zip(solvers, bases, values, sigmas, strict=True)]
            if converged or iterations >= options.iterations:
                break
            iterations += 1
            try:
                step = self.solve(problems, values)
            except np.linalg.LinAlgError as error:
                logger.warning("%s: the answer has not converged", error)
                break
            move = se3.from_twist(step[:6])
            base[:3, :3] = move[:3, :3] @ base[:3, :3]
            base[:3, 3] += move[:3, 3] * observations[0].diagonal
            values = [
                s.limited(v + step[self.columns(i)[6:]]) for i, (s, v) in enumerate(zip(solvers, values, strict=True))
            ]
            converged = bool(np.abs(step).max() < options.tolerance)
        base = se3.orthonormalised(base)
        solutions = tuple(
            Solution(o.to_search(base), v, problem, converged, iterations, solver.view)
            for o, v, problem, solver in zip(observations, values, problems, solvers, strict=True)
        )
        return SharedSolution(solutions, self.base_covariance(bases, values, problems), converged, iterations)

    def solve(self, problems: Sequence[Problem], values: Sequence[Array]) -> Array:
        """Return the bounded step over all unknowns."""
        H, g = self.assembled(problems)
        scale = 1.0 / problems[0].evidence / len(problems)
        bounds = [solver.step_bounds(v) for solver, v in zip(self.solvers, values, strict=True)]
        low = np.concatenate([bounds[0][0][:6], *(low[6:] for low, _ in bounds)])
        high = np.concatenate([bounds[0][1][:6], *(high[6:] for _, high in bounds)])
        return bounded_step(scale * H, scale * g, low, high, self.solvers[0].options.damping)

    def base_covariance(self, bases: Sequence[Array], values: Sequence[Array], problems: Sequence[Problem]) -> Array:
        """Return the base's covariance (6, 6) when all joints are free to follow it.

        The doubt of each scan's joints leaves its inverse covariance as a Schur complement.
        """
        total = np.zeros((6, 6))
        for i, (solver, base, value, problem) in enumerate(zip(self.solvers, bases, values, problems, strict=True)):
            final = Candidates.single(base, value)
            absent = ~solver.comparison.exists
            errors = observed_errors(solver.comparison, final, problem)
            H = inverse_covariance(problem, absent, errors, solver.upper - solver.lower)
            if i > 0:
                H[:6, :6] -= problem.prior.H[:6, :6]  # known once
            free = 6 + np.flatnonzero(~solver.locked)
            total += H[:6, :6] - H[:6, free] @ np.linalg.solve(H[np.ix_(free, free)], H[free, :6])
        return np.asarray(np.linalg.inv(total))


def _mean(placements: Sequence[Array]) -> Array:
    """Return the mean of placements (chordal mean of the rotations)."""
    return se3.orthonormalised(np.mean(placements, axis=0))
