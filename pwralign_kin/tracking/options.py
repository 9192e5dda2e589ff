"""Options of a tracker."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated

from pwralign_kin.checked_options import CheckedOptions, Count, Positive, Range
from pwralign_kin.estimation import EstimatorOptions


@dataclass(frozen=True)
class TrackerOptions(CheckedOptions):
    """Options of `pwralign_kin.Tracker`. Lengths in model diagonals. Raises `OptionError` for values out of range."""

    points: Annotated[int, Range(100, 10**6)] = 2000
    """Points of a frame that are used, at most."""
    cell: Annotated[float, Range(1e-5, 1)] = 0.012
    """One point is used for each cell of this size."""
    margin: Positive = 0.12
    """What is farther from where the model is expected is not looked at."""
    iterations: Count = 12
    """Gauss-Newton iterations of a fit, at most; one that has not settled goes on for as many again, and one from far
    away takes four times as many."""
    time_limit: Positive | None = None
    """Seconds that a frame may take: iterations and trials that do not fit are left out, and a lost model is
    searched for while the frames go on. Results then depend on how fast the machine is."""
    covariance: bool = False
    """Whether each frame tells the covariance of its state."""
    estimator: EstimatorOptions = field(default_factory=EstimatorOptions)
    """Of the search for a model that is lost or not found yet; its locked joints are locked here too."""
