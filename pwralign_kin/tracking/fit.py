"""How well a configuration fits a frame, beside how well the model usually does."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pwralign_kin import kernels
from pwralign_kin.se3 import Array

LEAST_SIGMA, MOST_SIGMA = 0.006, 0.015
"""Bounds of the robust scale at the end of a fit, which follows the noise, model diagonals."""

LEAST_NOISE = 0.002
"""Points tell no more than points of this noise (model diagonals) would: models are not exact, and a nearest surface
says less of a turn than its slope does. With less, base and first joint of round arms turn against each other."""

CLEAR = 0.9
"""Share of the points, or of the visible surface, from which on there is little but what is explained."""

SUSPECT = 0.25
"""A part is suspected when so much more of its points or of its visible surface than usual does not fit."""

COSTLY = 1.2
"""A fit is doubted when so many times as much as usual speaks against it."""

EVIDENT = 3.0
"""Points by which one of two explanations must do better to be the right one for sure."""

FORGETTING = 0.02
"""Share of what is usual that each frame renews."""


@dataclass(frozen=True)
class FrameFit:
    """A configuration fitted to a frame, and how well it fits."""

    T_scan_base: Array
    """(4, 4), m."""
    values: Array
    """(k,) actuated values, rad or model diagonals."""
    iterations: int = 0
    """0: the frame shows too little to fit to."""
    rmse: float = 0.0
    """Of the distances of the explained points, model diagonals."""
    noise: float = 0.0
    """Robust standard deviation of the distances of points close to the model."""
    coverage: float = 0.0
    """Share of the points that it explains."""
    agreement: float = 0.0
    """Share of the points that count for or against the model that it explains."""
    visible: float = 0.0
    """Share of the facing surface that nothing hides and that lies within the image."""
    support: float = 0.0
    """Share of the visible surface that the frame shows."""
    cost: float = 1.0
    """Robust mean square of the points' distances, 1 far beyond what is explained."""
    points: int = 0
    """Points used."""
    strays: Array = field(default_factory=lambda: np.zeros(0))
    """(parts,) share of the points close to each part that it does not explain; 0 where they are few."""
    missing: Array = field(default_factory=lambda: np.zeros(0))
    """(parts,) share of the visible surface of each part that the frame does not show; 0 where it is little."""
    covariance: Array = field(default_factory=lambda: np.zeros((0, 0)))
    """(6 + k, 6 + k) covariance, rad and model diagonals."""
    levers: Array = field(default_factory=lambda: np.zeros(0))
    """(k,) how far each joint moves the surface that is seen along its normals (rms), when all else makes up for it as
    well as it can, model diagonals for each unit."""

    @property
    def against(self) -> float:
        """How much speaks against it, in points: those that are off, and surface that should be seen but is not."""
        return self.points * contradiction(self.cost, self.support)


def contradiction(cost: float, support: float) -> float:
    """Return how much speaks against a fit, from 0 to 2, by its points' cost and its support: see `FrameFit`."""
    return cost + 1.0 - support


@dataclass(frozen=True)
class Usual:
    """How the model fits when it is found."""

    coverage: float
    agreement: float
    support: float
    noise: float
    """Of the distances of points close to the model, model diagonals."""
    sigma: float
    """Robust scale at the end of a fit."""
    cost: float
    """Robust mean square of the points' distances."""
    strays: Array
    missing: Array
    confidence: float
    """Of the estimate that found it."""

    @classmethod
    def of(cls, fit: FrameFit, confidence: float) -> Usual:
        """Return what a first fit makes usual."""
        return cls(
            coverage=fit.coverage,
            agreement=fit.agreement,
            support=fit.support,
            noise=fit.noise,
            sigma=_sigma(fit),
            cost=fit.cost,
            strays=fit.strays,
            missing=fit.missing,
            confidence=confidence,
        )

    @property
    def alone(self) -> bool:
        """Whether there is little but the model: else what it does not explain does not speak against it."""
        return self.coverage >= CLEAR

    def misfit(self, fit: FrameFit | Usual) -> float:
        """Return how much speaks against a fit."""
        return 2.0 - fit.agreement - fit.support + (1.0 - fit.coverage if self.alone else 0.0)

    @property
    def tolerance(self) -> float:
        """Distance within which the noise allows points of the model, model diagonals."""
        return kernels.explained_within(self.noise)

    def quality(self, fit: FrameFit) -> float:
        """Return how well a fit does beside the usual, from 0 to 1."""
        return float(np.clip(min(fit.agreement / self.agreement, fit.support / self.support), 0.0, 1.0))

    def suspects(self, fit: FrameFit) -> NDArray[np.bool_]:
        """Return the parts (parts,) that fit clearly worse than usual."""
        return np.asarray((fit.strays > self.strays + SUSPECT) | (fit.missing > self.missing + SUSPECT))

    def doubts(self, fit: FrameFit) -> bool:
        """Return whether clearly more than usual speaks against a fit, however little of the whole it is."""
        return fit.against > COSTLY * fit.points * contradiction(self.cost, self.support)

    def renewed(self, fit: FrameFit) -> Usual:
        """Return the usual after another good fit."""

        def mixed(old: Any, new: Any) -> Any:
            return old + FORGETTING * (new - old)

        return replace(
            self,
            coverage=mixed(self.coverage, fit.coverage),
            agreement=mixed(self.agreement, fit.agreement),
            support=mixed(self.support, fit.support),
            noise=mixed(self.noise, fit.noise),
            sigma=mixed(self.sigma, _sigma(fit)),
            cost=mixed(self.cost, fit.cost),
            strays=mixed(self.strays, fit.strays),
            missing=mixed(self.missing, fit.missing),
        )


def _sigma(fit: FrameFit) -> float:
    return float(np.clip(2.0 * fit.rmse, LEAST_SIGMA, MOST_SIGMA))
