"""The last word on noisy scans: base and joints of greatest likelihood, the noise being one of the unknowns.

Where noise is not small against the thickness of parts and the radius of edges, the surface nearest to a point is often
not the one that it was taken from: residuals look too small, and answers are drawn to what is near. Here a point may
come from all of the surface about it. The posed model is a distribution of points, its seen surface blurred by the
noise, with a few strays anywhere, and its likelihood is maximised by Fisher scoring: the sum over points of the outer
products of their scores stands for the Hessian (Berndt, Hall, Hall and Hausman, Annals of Economic and Social
Measurement 3/4, 1974), and its inverse for the covariance. CasADi solves the bounded steps.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace

import numpy as np

from pwralign_kin import kernels
from pwralign_kin.arrays import Singles
from pwralign_kin.directions import fibonacci_directions
from pwralign_kin.estimation.comparison.candidates import Candidates
from pwralign_kin.estimation.refinement.bounded_step import bounded_step
from pwralign_kin.estimation.refinement.joint_least_squares import JointLeastSquares
from pwralign_kin.estimation.refinement.problem import Blur, Problem, Solution
from pwralign_kin.se3 import Array

logger = logging.getLogger(__name__)

SPACING, FINEST = 1.2, 0.003
"""Side of the patches of surface, in standard deviations of the noise, and at least (model diagonals)."""
FIRST_NOISE = 1.2
"""The noise at first, in units of that measured in the scan, which thin parts hide some of."""
DIRECTIONS, UNSEEN = 24, 0.1
"""How many sensors all around are thought to have seen the model, and how much of the surface they may have missed."""
FIRST_STRAYS, LEAST_STRAYS, MOST_STRAYS = 0.05, 0.002, 0.95
"""Share of the points that are strays, at first and at least and at most."""
STEPS = 20
"""Steps at most."""
LITTLE = 0.1
"""A step is the last when it gains this log-likelihood, or when no more could be gained: the answer then lies within
half of its standard deviations from the best."""
LEAST_DAMPING, CAREFUL = 1e-3, 0.25
"""Least damping, in units of the Hessian's diagonal, and after a step that gained little."""
MOST_LOG_NOISE = 0.2
"""Largest change of the noise's logarithm in a step."""
FEW_POINTS, FEW_DIRECTIONS, BLUR, FEW_STRAYS = 1500, 12, 0.006, 0.01
"""Points, sensors, least noise (model diagonals) and share of strays by which several configurations are compared."""


@dataclass(frozen=True)
class _Evidence:
    """The likelihood at one configuration with its derivatives, in search units."""

    log_likelihood: float
    g: Array
    """(7 + k,) by base twist, joint increments and the noise's logarithm."""
    H: Array
    """(7 + k, 7 + k) what stands for the negative Hessian."""
    information: Array
    """(parts, 6, 6) that of the points alone by each part's twist."""
    strays: float
    """Share of the points that the model does not explain."""


@dataclass(frozen=True)
class _Place:
    """One set of the unknowns, in search units."""

    base: Array
    values: Array
    noise: float


class SurfaceMixture:
    """Base, joints and noise of one model fitted to one noisy scan."""

    def __init__(self, solver: JointLeastSquares, points: Singles, noise: float) -> None:
        """Take the problem whose bounds and priors hold, `points` (n, 3) of its scan, and about what noise they have.

        What is seen of the surface is yet to be looked at.
        """
        self.solver = solver
        self.points = points
        self.volume = float(np.prod(np.maximum(np.ptp(self.points, axis=0), 10 * noise)))
        self.mixture = kernels.SurfaceMixture(solver.model.kernel_model, max(SPACING * noise, FINEST))

    def look(self, base: Array, values: Array, directions: int = DIRECTIONS) -> None:
        """Look at what is seen of the surface, from all around, at a configuration near to the answer."""
        sensors = fibonacci_directions(directions).astype(np.float32)
        self.mixture.look(np.ascontiguousarray(self.solver.part_twists(base, values)[0]), sensors, UNSEEN)

    def evidence(self, at: _Place, strays: float) -> _Evidence:
        """Return the likelihood of the points at some unknowns, with `strays` the share of strays among them."""
        placements, J = self.solver.part_twists(at.base, at.values)
        log_likelihood, g, H, information, found = self.mixture.evidence(
            points=self.points,
            placements=np.ascontiguousarray(placements),
            jacobians=np.ascontiguousarray(J),
            sigma=at.noise,
            strays=strays,
            volume=self.volume,
            threads=self.solver.comparison.threads,
        )
        prior = self.solver.prior(at.base, at.values)
        g[:-1] += prior.g
        H[:-1, :-1] += prior.H
        span = np.maximum(self.solver.upper - self.solver.lower, 1e-9)
        joints = np.arange(6, len(H) - 1)
        H[joints, joints] += 12.0 / span**2
        H[-1, -1] += 1.0
        return _Evidence(log_likelihood, g, H, information, found / len(self.points))

    def run(self, base: Array, values: Array, noise: float) -> tuple[_Place, _Evidence, bool, int]:
        """Return the unknowns of greatest likelihood near those given, their evidence, whether steps came to an end,
        and their number."""
        at, damping, steps, ended = _Place(base, values, noise), LEAST_DAMPING, 0, False
        now = self.evidence(at, FIRST_STRAYS)
        while not ended and steps < STEPS:
            steps += 1
            try:
                step = self.step(at, now, damping)
            except np.linalg.LinAlgError as error:
                logger.warning("%s: the answer has not converged", error)
                break
            there = self.moved(at, step)
            then = self.evidence(there, float(np.clip(now.strays, LEAST_STRAYS, MOST_STRAYS)))
            expected, gained = 0.5 * float(step @ now.g), then.log_likelihood - now.log_likelihood
            ended = expected < LITTLE or abs(gained) < LITTLE
            damping = max(damping / 4, LEAST_DAMPING) if gained > expected / 2 else max(8 * damping, CAREFUL)
            if gained > 0:
                at, now = there, then
        return at, now, ended, steps

    def step(self, at: _Place, evidence: _Evidence, damping: float) -> Array:
        """Return the bounded step (7 + k,)."""
        low, high = self.solver.step_bounds(at.values)
        # Scaled for the solver's tolerances.
        scale = 1.0 / len(self.points)
        return bounded_step(
            scale * (evidence.H + damping * np.diag(np.diag(evidence.H))), scale * evidence.g,
            np.append(low, -MOST_LOG_NOISE), np.append(high, MOST_LOG_NOISE), 0.0,
        )  # fmt: skip

    def moved(self, at: _Place, step: Array) -> _Place:
        """Return the unknowns after a step."""
        base, values = self.solver.stepped(at.base, at.values, step[:-1])
        return _Place(base, values, at.noise * float(np.exp(step[-1])))


def solved(solver: JointLeastSquares, base: Array, values: Array, known: Blur | None = None) -> Solution:
    """Return the answer near a configuration: that of the joint least squares, or of the mixture for a noisy scan.

    The noise may be `known` from an answer nearby.
    """
    if not solver.is_noisy:
        return solver.run(base, values)
    observation = solver.comparison.observation
    noise = FIRST_NOISE * observation.noise if known is None else known.noise
    mixture = SurfaceMixture(solver, observation.given, noise)
    mixture.look(base, values)
    at, evidence, ended, steps = mixture.run(base.copy(), values.copy(), noise)
    problem: Problem = solver.build(at.base, at.values, solver.robust_scale(solver.residual(at.base, at.values)))
    problem = replace(problem, blur=Blur(at.noise, evidence.information))
    return Solution(at.base, at.values, problem, ended, steps, solver.view)


def mean_log_likelihoods(solver: JointLeastSquares, several: Candidates) -> Array:
    """Return (m,) the mean logarithm of the likelihood of some of the scan's points by the surface that is seen of each
    of several configurations. Details far smaller than limbs are blurred."""
    observation = solver.comparison.observation
    chosen = np.linspace(0, len(observation.given) - 1, min(len(observation.given), FEW_POINTS)).astype(int)
    noise = max(FIRST_NOISE * observation.noise, BLUR)
    mixture = SurfaceMixture(solver, np.ascontiguousarray(observation.given[chosen]), noise)
    found = []
    for base, values in zip(several.bases, several.values, strict=True):
        mixture.look(base, values, FEW_DIRECTIONS)
        found.append(mixture.evidence(_Place(base, values, noise), FEW_STRAYS).log_likelihood / len(chosen))
    return np.array(found)
