"""A cheap search about a configuration that a frame does not bear out: one variable after the other is swept."""

from __future__ import annotations

import numpy as np

from pwralign_kin import kernels
from pwralign_kin.se3 import Array, rotation_about

SIGMA = 0.02
"""Robust scale at which swept configurations are compared, model diagonals."""

GAIN = 0.004
"""A variable moves where that scores more than this."""


def swept(
    native: kernels.Tracking, base: Array, values: Array, ranges: Array, rounds: int
) -> tuple[Array, Array, bool]:
    """Return a configuration that fits the frame better, and whether any was found.

    `base` (4, 4) and `values` (k,) are in model diagonals about the frame's centre. Each variable (rotation vector and
    shift of the base, then joints from the root on) is tried up to its range (6 + k,) to either side, all others as
    they are, and takes what explains most of the frame's points and of its own surface that should be seen; variables
    of range zero stay.
    """
    base, values = base.copy(), values.copy()
    any_gain = False
    for _ in range(rounds):
        gained = False
        for variable in np.flatnonzero(ranges > 0.0):
            changes, scores = native.sweep(base[None], values, int(variable), float(ranges[variable]), SIGMA)
            best = int(np.argmax(scores))
            if scores[best] > scores[0] + GAIN:
                base, values = _changed(base, values, int(variable), float(changes[best]))
                gained = any_gain = True
        if not gained:
            break
    return base, values, any_gain


def _changed(base: Array, values: Array, variable: int, by: float) -> tuple[Array, Array]:
    base, values = base.copy(), values.copy()
    if variable < 3:
        base[:3, :3] = rotation_about(np.eye(3)[variable], by) @ base[:3, :3]
    elif variable < 6:
        base[variable - 3, 3] += by
    else:
        values[variable - 6] += by
    return base, values
