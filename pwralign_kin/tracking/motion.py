"""Where a model is expected next: base and joints go on as fast as they went."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pwralign_kin.se3 import Array, exp, rotation_vector

GAIN = 0.5
"""Share of what a frame shows beyond the expected that goes into the speed (the beta of an alpha-beta filter)."""

MEMORY = 0.15
"""Time constant (s) in which an unseen motion comes to rest."""

JOINT_SURPRISE, TURN_SURPRISE, SHIFT_SURPRISE = 1.5, 0.5, 0.4
"""Standard deviations of unexpected speeds: rad/s (or diagonals/s) of joints, rad/s and diagonals/s of the base."""

LONGEST = 0.5
"""Time (s) over which surprises add up, at most: what is lost for longer is searched for."""


@dataclass(frozen=True)
class Motion:
    """Position and speed at a moment."""

    time: float
    """s"""
    T: Array
    """(4, 4) base placement, scan frame, m."""
    values: Array
    """(k,) actuated values, rad or model diagonals."""
    twist: Array
    """(6,) speed of the base: rotation vector / s in scan axes, then m/s of its origin."""
    speeds: Array
    """(k,) speeds of the values."""
    seen: float
    """Time (s) at which the model was last seen."""

    @classmethod
    def at_rest(cls, time: float, T: Array, values: Array, seen: float) -> Motion:
        """Return a model of unknown speed that was last seen at a time (s): the longer ago, the less sure it is."""
        return cls(time, T, values, np.zeros(6), np.zeros(len(values)), seen)

    def predicted(self, time: float) -> Motion:
        """Return what is expected at a later time."""
        ahead = time - self.time
        blind = max(0.0, self.time - self.seen)
        # The speed fades while the model is unseen; integrated over the step.
        fade = float(np.exp(-blind / MEMORY))
        step = exp(fade * ahead * self.twist)
        T = self.T.copy()
        T[:3, :3] = step[:3, :3] @ T[:3, :3]
        T[:3, 3] += step[:3, 3]
        return replace(self, time=time, T=T, values=self.values + fade * ahead * self.speeds)

    def inverse_deviations(self) -> Array:
        """Return (6 + k,) one over the standard deviations of this prediction; rad and model diagonals."""
        ahead = float(np.clip(self.time - self.seen, 1e-3, LONGEST))
        surprises = np.r_[
            np.full(3, TURN_SURPRISE), np.full(3, SHIFT_SURPRISE), np.full(len(self.values), JOINT_SURPRISE)
        ]
        return np.asarray(1.0 / (ahead * surprises))

    def corrected(self, T: Array, values: Array, told: Array, turns: Array, since: Motion) -> Motion:
        """Return the motion once the frame has shown where the model is.

        `told` (6 + k,) is the share of each variable that the frame tells; `turns` (k,) is the range of joints that
        wrap, else infinite; `since` is the motion before the prediction.
        """
        ahead = self.time - since.time
        apart = values - self.values
        wraps = np.isfinite(turns)
        apart[wraps] -= turns[wraps] * np.round(apart[wraps] / turns[wraps])
        gain = GAIN / ahead
        twist = self.twist.copy()
        twist[:3] += gain * rotation_vector(T[:3, :3] @ self.T[:3, :3].T)
        twist[3:] += gain * (T[:3, 3] - self.T[:3, 3])
        return Motion(self.time, T, values, told[:6] * twist, told[6:] * (self.speeds + gain * apart), self.time)
