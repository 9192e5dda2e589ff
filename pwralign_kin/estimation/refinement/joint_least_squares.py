"""The last word of an estimate: one bounded least-squares problem over base and joints together.

Robust correspondences of all parts are reduced to one 6x6 information matrix and one 6-vector a part, in twist space
about the base's origin. Pinocchio's Jacobians J_k map base twist and joint increments to part twists, so that the
problem is  min 1/2 x' (sum J_k' H_k J_k) x - (sum J_k' g_k)' x  within the joint limits, whatever the number of
points. CasADi solves it; a new set of correspondences follows each step (Gauss-Newton with reweighting).
"""

from __future__ import annotations

import logging
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pwralign_kin import kernels
from pwralign_kin.checked_options import CheckedOptions, Natural, NotNegative, Positive, Threshold
from pwralign_kin.estimation.comparison.candidates import Candidates
from pwralign_kin.estimation.comparison.scan_comparison import ScanComparison
from pwralign_kin.estimation.knowledge.prior import SearchPrior
from pwralign_kin.estimation.refinement.bounded_step import bounded_step
from pwralign_kin.estimation.refinement.matrices import normal_matrix
from pwralign_kin.estimation.refinement.problem import Prior, Problem, Solution
from pwralign_kin.estimation.refinement.view import NOT_LOOKED_AT, View, view_of
from pwralign_kin.model import ArticulatedModel
from pwralign_kin.se3 import Array

logger = logging.getLogger(__name__)

SHORT = 5e-4
"""Last step (rad, model diagonals) up to which the problem before it is that at the end."""
ALIGNED = 0.7
"""Cosine between two steps, by the surface's displacement, from which the second goes on where the first went, ..."""
MOST_STRETCH = 4.0
"""... and how much farther it may go."""


@dataclass(frozen=True)
class LeastSquaresOptions(CheckedOptions):
    """How the joint least squares runs. Lengths in model diagonals."""

    enabled: bool = True
    """Off: the answer of the batch refinement stands."""
    bounds: bool = True
    """Whether the joint limits bound the problem; off: steps are clamped afterwards."""
    iterations: Natural = 30
    """Steps, at most."""
    least_sigma: Positive = 0.005
    sigmas: NotNegative = 2.0
    """Robust scale in standard deviations of the scan's noise; at least `least_sigma` and the residuals' own."""
    kernel_sigmas: NotNegative = 4.0
    """Least scale of the robust kernel in the same: a narrower one throws much of what noisy points tell away."""
    support_weight: NotNegative = 0.05
    """Weight of model samples pulled by the scan, against scan points pulled by the model."""
    reach: Positive = 3.0
    """Correspondences farther than this many robust scales do not count."""
    noisy: Threshold = 0.003
    """Noise from which a scan fused of several views is fitted to all surface near its points (`surface_mixture`)."""
    silhouette: bool = True
    """Whether the model's outline is fitted to that of a scan seen from one place."""
    most_silhouette: NotNegative = 6.0
    """Greatest weight of the outline against the surface; below it, they weigh by their variances."""
    damping: NotNegative = 1e-6
    """Added to the diagonal of the normal matrix, beside a small share of its own."""
    most_turn: Positive = 0.1
    """Largest step of a rotation, rad."""
    tolerance: NotNegative = 5e-5
    """A step that displaces the matched surface of every part by less than this (rms) is the last."""


class JointLeastSquares:
    """Base and joints of one model fitted to one observed scan."""

    def __init__(
        self,
        model: ArticulatedModel,
        comparison: ScanComparison,
        lower: Array,
        upper: Array,
        options: LeastSquaresOptions,
        view: View = NOT_LOOKED_AT,
    ) -> None:
        """Take the bounds `lower`, `upper` (k,) of the actuated joints in search units; equal bounds lock a joint."""
        self.model = model
        self.comparison = comparison
        self.lower = lower
        self.upper = upper
        self.options = options
        self.view = view

    @property
    def locked(self) -> NDArray[np.bool_]:
        """Which joints have no freedom (k,)."""
        return self.upper <= self.lower

    @property
    def is_noisy(self) -> bool:
        """Whether noise may have taken points to other surface than that nearest to them."""
        observation = self.comparison.observation
        return not observation.single_view and observation.noise > self.options.noisy

    def with_locked(self, joints: NDArray[np.bool_], values: Array) -> JointLeastSquares:
        """Return the same problem with some joints held at the given values."""
        lower, upper = np.where(joints, values, self.lower), np.where(joints, values, self.upper)
        return JointLeastSquares(self.model, self.comparison, lower, upper, self.options, self.view)

    def knowing(self, known: SearchPrior) -> JointLeastSquares:
        """Return the same problem by another prior of base and joints."""
        comparison = self.comparison.knowing(known)
        return JointLeastSquares(self.model, comparison, self.lower, self.upper, self.options, self.view)

    def seeing(self, view: View) -> JointLeastSquares:
        """Return the same problem with what the image of a single view tells besides."""
        return JointLeastSquares(self.model, self.comparison, self.lower, self.upper, self.options, view)

    def looking(self, base: Array, values: Array, residual: float) -> JointLeastSquares:
        """Return the same problem with the image looked at by a configuration, whose `residual` is given."""
        near = Candidates.single(base, values)
        return self.seeing(view_of(self.comparison, near, residual, outlined=self.options.silhouette))

    def residual(self, base: Array, values: Array) -> float:
        """Return the robust standard deviation of the given points that lie on a configuration."""
        return self.comparison.residual(Candidates.single(base, values))

    def robust_scale(self, residual: float) -> float:
        """Return the scale of the robust kernel: that of the noise or of the `residual` of a configuration."""
        noise = self.options.sigmas * self.comparison.observation.noise
        return max(self.options.least_sigma, noise, residual)

    def part_twists(self, base: Array, values: Array) -> tuple[Array, Array]:
        """Return placements (parts, 4, 4) and part twists (parts, 6, 6 + k) per unit of base twist and joints.

        All twists are about the base's origin.
        """
        placements, J = self.model.part_placements_and_twists(values * self.model.joint_scales)
        placements[:, :3, 3] /= self.model.diagonal
        turn = np.zeros((6, 6))
        turn[:3, :3], turn[3:, 3:] = base[:3, :3], base[:3, :3] / self.model.diagonal
        twists = np.empty((len(J), 6, 6 + len(values)))
        twists[:, :, :6], twists[:, :, 6:] = np.eye(6), turn @ J * self.model.joint_scales
        return base @ placements, twists

    def build(self, base: Array, values: Array, sigma: float) -> Problem:
        """Return the problem linearised at a configuration, with a robust kernel of scale `sigma`."""
        placed, full = self.part_twists(base, values)
        kernel_scale = max(sigma, self.options.kernel_sigmas * self.comparison.observation.noise)
        information, part_g, counts = self.comparison.normal_equations(
            placed,
            kernel_scale,
            self.options.reach * sigma,
            self.options.support_weight,
            along_rays=self.view.along_rays,
        )
        outline = self.view.outline(self.comparison, placed, base[:3, 3], self.options.most_silhouette)
        mass = np.trace(information[:, 3:, 3:], axis1=1, axis2=2)  # normals are unit vectors
        information, part_g = information + outline[0], part_g + outline[1]
        H = normal_matrix(full, information)
        g = np.einsum("pia,pi->a", full, part_g)
        return Problem(H, g, information, mass, full, counts, self.prior(base, values), sigma)

    def prior(self, base: Array, values: Array) -> Prior:
        """Return what is known beforehand at a configuration."""
        known = self.comparison.known
        H, g = np.zeros((6 + len(values), 6 + len(values))), np.zeros(6 + len(values))
        H[:6, :6], g[:6] = self.comparison.base_prior(base)
        H[range(6, len(H)), range(6, len(H))] = 1.0 / known.std**2
        g[6:] = (known.values - values) / known.std**2
        return Prior(H, g)

    def solve(self, problem: Problem, low: Array, high: Array) -> Array:
        """Return the step (6 + k,) within its bounds."""
        H = problem.H + problem.prior.H / problem.evidence
        g = problem.g + problem.prior.g / problem.evidence
        return bounded_step(H, g, low, high, self.options.damping)

    def step_bounds(self, values: Array) -> tuple[Array, Array]:
        """Return the least and the largest step (6 + k,) from `values`."""
        low = np.full(6 + len(values), -self.options.most_turn)
        high = -low
        if self.comparison.known.held:
            low[:6] = high[:6] = 0.0
        if self.options.bounds:
            # A joint that wraps has no wall at its limits, unless it is locked.
            free = self.model.continuous & (self.upper > self.lower)
            low[6:] = np.maximum(low[6:], np.where(free, -np.inf, self.lower - values))
            high[6:] = np.minimum(high[6:], np.where(free, np.inf, self.upper - values))
        return np.minimum(low, high), high

    def run(self, base: Array, values: Array) -> Solution:
        """Iterate from a configuration to convergence, after a look at the image where there was none yet."""
        residual = self.residual(base, values)
        looked = self if self.view.silhouette is not None else self.looking(base, values, residual)
        return looked._converged(base, values, self.robust_scale(residual))

    def _converged(self, base: Array, values: Array, sigma: float) -> Solution:
        """Iterate with a robust kernel of scale `sigma`."""
        converged, iterations = False, 0
        problem = self.build(base, values, sigma)
        before, stretch = np.zeros(6 + len(values)), 1.0
        while not converged and iterations < self.options.iterations:
            iterations += 1
            low, high = self.step_bounds(values)
            try:
                step = self.solve(problem, low, high)
            except np.linalg.LinAlgError as error:
                logger.warning("%s: the answer has not converged", error)
                break
            converged = problem.displacement(step) < self.options.tolerance
            stretch = 1.0 if converged else stretched(problem.H, before, step, stretch)
            before = step
            base, values = self.stepped(base, values, np.clip(stretch * step, low, high))
            # Unknowns that the scan hardly tells may move far without displacing what is matched.
            if not (converged and np.abs(step).max() < SHORT):
                problem = self.build(base, values, sigma)
        return Solution(base, values, problem, converged, iterations, self.view)

    def stepped(self, base: Array, values: Array, step: Array) -> tuple[Array, Array]:
        """Return the configuration after a step (6 + k,)."""
        return kernels.retracted(base, step[:6]), self.limited(values + step[6:])

    def limited(self, values: Array) -> Array:
        """Return values within the limits: wrapped where a full turn changes nothing, else clamped."""
        span = self.upper - self.lower
        wraps = self.model.continuous & (span > 0)
        turned = self.lower + np.mod(values - self.lower, np.where(wraps, span, 1.0))
        return np.where(wraps, turned, np.clip(values, self.lower, self.upper))


def stretched(H: Array, before: Array, step: Array, stretch: float) -> float:
    """Return by how much a step is to be prolonged, the step `before` having been by `stretch`.

    Surfaces that slide along themselves take many small steps in one direction: each step leaves the same share of the
    way, whose sum is a geometric series (Aitken's extrapolation).
    """
    squared, along, own = float(before @ H @ before), float(before @ H @ step), float(step @ H @ step)
    if along <= ALIGNED * np.sqrt(squared * own):
        return 1.0
    left = 1.0 - (1.0 - along / squared) / stretch
    return MOST_STRETCH if left >= 1.0 - 1.0 / MOST_STRETCH else max(1.0, 1.0 / (1.0 - left))
