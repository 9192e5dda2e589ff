"""Options of a tracker."""

from __future__ import annotations

from dataclasses import dataclass, field
from numbers import Real

import numpy as np

from pwralign_kin.estimation import EstimatorOptions
from pwralign_kin.exceptions import StateError


@dataclass(frozen=True)
class TrackerOptions:
    """Options of `pwralign_kin.Tracker`. Lengths in model diagonals. Raises `StateError` for values out of range."""

    points: int = 2000
    """Points of a frame that are used, at most."""
    cell: float = 0.012
    """One point is used for each cell of this size."""
    margin: float = 0.12
    """What is farther from where the model is expected is not looked at."""
    iterations: int = 12
    """Gauss-Newton iterations of a fit, at most; one that has not settled goes on for as many again, and a doubtful
    frame is fitted with four times as many from each of two farther starts."""
    time_limit: float | None = None
    """Seconds that a frame may take: iterations and second attempts that do not fit are left out, and a lost model is
    searched for while the frames go on. Results then depend on how fast the machine is."""
    covariance: bool = False
    """Whether each frame tells the covariance of its state."""
    estimator: EstimatorOptions = field(default_factory=EstimatorOptions)
    """Of the search for a model that is lost or not found yet; its locked joints are locked here too."""

    def __post_init__(self) -> None:
        """Check the values."""
        for name in ("points", "cell", "margin", "iterations"):
            if not isinstance(getattr(self, name), Real):
                raise StateError(f"{name} must be a number, not {getattr(self, name)!r}")
        if not isinstance(self.time_limit, Real | None):
            raise StateError(f"the time limit of a frame must be a number, not {self.time_limit!r}")
        if not isinstance(self.estimator, EstimatorOptions):
            raise StateError(f"estimator must be EstimatorOptions, not {self.estimator!r}")
        if self.points < 100 or self.iterations < 1 or not (self.cell > 0.0 and self.margin > 0.0):
            raise StateError("a tracker needs at least 100 points and one iteration, and a positive cell and margin")
        if self.time_limit is not None and not (np.isfinite(self.time_limit) and self.time_limit > 0.0):
            raise StateError(f"the time limit of a frame must be a positive number of seconds, not {self.time_limit}")
