"""Where a model is expected next: base and joints go on as fast as they went, and what is not seen grows doubtful."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pwralign_kin.se3 import Array, from_twist, rotation_vector

MEMORY = 0.15
"""Time constant (s) in which an unseen motion comes to rest."""

JOINT_SURPRISE, TURN_SURPRISE, SHIFT_SURPRISE = 1.5, 0.5, 0.4
"""Standard deviations of unexpected speeds: rad/s (or diagonals/s) of joints, rad/s and diagonals/s of the base."""

LONGEST = 0.5
"""Time (s) over which surprises add up, at most: what is lost for longer is searched for."""

SHORTEST = 1e-3
"""Time (s) over which surprises add up, at least."""


@dataclass(frozen=True)
class BelievedMotion:
    """Position, speed and doubt at a moment."""

    time: float
    """s"""
    T_scan_base: Array
    """(4, 4), m."""
    values: Array
    """(k,) actuated values, rad or model diagonals."""
    twist: Array
    """(6,) speed of the base: rotation vector / s in scan axes, then m/s of its origin."""
    speeds: Array
    """(k,) speeds of the values."""
    seen: Array
    """(6 + k,) times (s) at which base and joints were last told."""
    covariance: Array
    """(6 + k, 6 + k) of the base (rotation vector about its origin in scan axes, shift) and of the values; rad and
    model diagonals."""

    @classmethod
    def at_rest(cls, time: float, T_scan_base: Array, values: Array, seen: float) -> BelievedMotion:
        """Return a model of unknown speed that was last seen at a time (s): the longer ago, the less sure it is."""
        size = 6 + len(values)
        deviations = np.clip(time - seen, SHORTEST, LONGEST) * _surprises(size)
        rest = np.zeros(6), np.zeros(size - 6)
        return cls(time, T_scan_base, values, *rest, np.full(size, seen), np.diag(deviations**2))

    @property
    def ahead(self) -> float:
        """Time (s) since the model was last seen, whichever part of it."""
        return float(self.time - self.seen.max())

    @property
    def held(self) -> NDArray[np.bool_]:
        """(k,) joints that were not told when the model was last seen."""
        return np.asarray(self.seen[6:] < self.seen.max())

    @property
    def deviations(self) -> Array:
        """(6 + k,) standard deviations of base and values, rad and model diagonals."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    def predicted(self, time: float) -> BelievedMotion:
        """Return what is expected at a later time."""
        ahead = time - self.time
        blind = self.time - self.seen
        # A speed fades while it is unseen, and tells nothing of all of a long pause.
        going = np.exp(-blind / MEMORY) * min(ahead, LONGEST)
        step = from_twist(going[:6] * self.twist)
        T_scan_base = self.T_scan_base.copy()
        T_scan_base[:3, :3] = step[:3, :3] @ T_scan_base[:3, :3]
        T_scan_base[:3, 3] += step[:3, 3]
        # Unexpected speeds last: deviations grow in proportion to the time, however many frames it has.
        grown = np.minimum(blind + ahead, LONGEST) ** 2 - np.minimum(blind, LONGEST) ** 2
        doubt = self.covariance + np.diag((grown + SHORTEST**2) * _surprises(len(blind)) ** 2)
        values = self.values + going[6:] * self.speeds
        return replace(self, time=time, T_scan_base=T_scan_base, values=values, covariance=doubt)

    def corrected(
        self,
        T_scan_base: Array,
        values: Array,
        covariance: Array,
        held: NDArray[np.bool_],
        turns: Array,
        since: BelievedMotion,
    ) -> BelievedMotion:
        """Return the motion once the frame has shown where the model is, but for joints that it does not tell.

        `covariance` (6 + k, 6 + k) is what it is after the frame, `held` (k,) which joints are not told; `turns` (k,)
        is the range of joints that wrap, else infinite; `since` is the motion before the prediction.
        """
        ahead = self.time - since.time
        apart = values - self.values
        wraps = np.isfinite(turns)
        apart[wraps] -= turns[wraps] * np.round(apart[wraps] / turns[wraps])
        turned = rotation_vector(T_scan_base[:3, :3] @ self.T_scan_base[:3, :3].T)
        apart = np.r_[turned, T_scan_base[:3, 3] - self.T_scan_base[:3, 3], apart]
        # What is apart is a change of speed as far as that can have moved the model, and the doubt of where it was and
        # is cannot: of few frames nearly all of it, of many, or where they tell little, hardly any. A surprising speed
        # takes as long to come up as surprises add up.
        moved = (_surprises(len(apart)) * ahead**2 / LONGEST) ** 2
        gain = moved / (moved + np.diag(covariance) + np.diag(since.covariance))
        told = np.clip(1.0 - np.diag(covariance) / np.diag(self.covariance), 0.0, 1.0)
        before, unseen = np.r_[self.twist, self.speeds], np.r_[np.zeros(6, bool), held]
        speeds = np.where(unseen, before, told * (before + gain * apart / ahead))
        seen = np.where(unseen, self.seen, self.time)
        return BelievedMotion(self.time, T_scan_base, values, speeds[:6], speeds[6:], seen, covariance)


def _surprises(size: int) -> Array:
    return np.repeat([TURN_SURPRISE, SHIFT_SURPRISE, JOINT_SURPRISE], [3, 3, size - 6])
