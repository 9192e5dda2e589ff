"""The least-squares problem at one configuration, and what solves it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pwralign_kin.estimation.comparison.candidates import Candidates
from pwralign_kin.estimation.knowledge.prior import INDEPENDENT_POINTS
from pwralign_kin.estimation.refinement.view import NOT_LOOKED_AT, View
from pwralign_kin.se3 import Array

LEAST_MASS = 0.005
"""Share of all residuals' weight below which a part's few correspondences do not hold up convergence."""


@dataclass(frozen=True)
class Prior:
    """What is known before the scan is looked at, linearised at one configuration."""

    H: Array
    """(6 + k, 6 + k) inverse covariance."""
    g: Array
    """(6 + k,) right-hand side."""


@dataclass(frozen=True)
class Blur:
    """What a fit to all surface near the points of a noisy scan finds besides the configuration."""

    noise: float
    """Standard deviation of the points from the surface, model diagonals."""
    information: Array
    """(parts, 6, 6) Fisher information of every part's twist about the base's origin."""


@dataclass(frozen=True)
class Problem:
    """The reduced problem at one configuration, in search units."""

    H: Array
    """(6 + k, 6 + k) normal matrix over base twist (rotation, translation) and joint increments."""
    g: Array
    """(6 + k,) right-hand side."""
    information: Array
    """(parts, 6, 6) information of every part in twist space."""
    mass: Array
    """(parts,) sum of the weights of the surface residuals of every part, without those of the outline."""
    J: Array
    """(parts, 6, 6 + k) part twists per unit of base twist and joint increments."""
    counts: NDArray[np.int32]
    """(parts,) correspondences per part."""
    prior: Prior
    """What is known beforehand; `H` and `g` are of the scan alone."""
    sigma: float
    """Robust scale of the residuals."""
    blur: Blur | None = None
    """For noisy scans; None where the nearest surface tells all."""

    @property
    def evidence(self) -> float:
        """What `H` must be multiplied by to be an inverse covariance beside the prior's."""
        return INDEPENDENT_POINTS / self.sigma**2

    def displacement(self, step: Array) -> float:
        """Return the greatest rms displacement, among parts, of the matched surface along its normals by a step."""
        twists = self.J @ step
        squared = np.einsum("pi,pij,pj->p", twists, self.information, twists)
        return float(np.sqrt((squared / np.maximum(self.mass, LEAST_MASS * self.mass.sum() + 1e-12)).max()))


@dataclass(frozen=True)
class Solution:
    """The configuration at the end, in search units."""

    base: Array
    values: Array
    problem: Problem
    """The problem at the end, for the covariance."""
    converged: bool
    iterations: int
    view: View = NOT_LOOKED_AT
    """What the image of a single view told besides; what is solved near to it is to see the same."""

    @property
    def configuration(self) -> Candidates:
        """What was found, for the search's own figures."""
        return Candidates.single(self.base, self.values)
