"""What tracking tells of one frame."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from pwralign_kin.read_only import ReadOnly
from pwralign_kin.se3 import Array
from pwralign_kin.state import State


@dataclass(frozen=True, eq=False)
class TrackedFrame(ReadOnly):
    """What one frame tells."""

    time: float
    """As given, s."""
    state: State
    """Base placement and joint values; of a model that is not seen, the expected ones."""
    confidence: float
    """From 0 to 1: how well the model fits beside how it fitted when it was found, times how sure that was."""
    lost: bool
    """Whether the model is not found: `state` is where it was last, gone on a little."""
    searched: bool
    """Whether the model was searched for in this frame, found or not; else it was followed."""
    scan_coverage: float
    """Share of the points around the model that it explains."""
    model_support: float
    """Share of the surface facing the sensor, neither hidden nor outside the image, that the frame shows."""
    inlier_rmse: float
    """Of the distances of the explained points, m."""
    std: Mapping[str, float]
    """Standard deviation of each joint, rad or m; it grows while a joint is undetermined, and stays large until one
    that came back is believed."""
    undetermined: tuple[str, ...]
    """Joints that the frame does not tell: they keep the value that was told last; and joints that came
    back and are not believed yet, whose values are fitted."""
    points: int
    """Points used."""
    iterations: int
    """Gauss-Newton iterations of the fit that was taken; of one that had not settled and went on, all of them."""
    seconds: float
    """Time that the frame took."""
    covariance: Array | None
    """(6 + k, 6 + k) covariance of the base (rotation vector about its origin in scan axes, rad; translation, m) and of
    the joints (rad or m); None unless asked for, and where the model is not seen."""

    def __repr__(self) -> str:
        """Return one line: when, how sure the answer is, and the answer."""
        undetermined = f"undetermined: {', '.join(self.undetermined)}; " * bool(self.undetermined)
        sure = "lost" if self.lost else f"confidence {self.confidence:.2f}"
        return f"TrackedFrame({self.time:g} s: {sure}; {undetermined}{self.state!r})"

    def to_dict(self) -> dict[str, Any]:
        """Return the frame as a JSON object."""
        return {
            "time": self.time,
            **self.state.to_dict(),
            "confidence": self.confidence,
            "lost": self.lost,
            "searched": self.searched,
            "scan_coverage": self.scan_coverage,
            "model_support": self.model_support,
            "inlier_rmse": self.inlier_rmse,
            "std": dict(self.std),
            "undetermined": list(self.undetermined),
            "points": self.points,
            "iterations": self.iterations,
            "seconds": self.seconds,
        }
