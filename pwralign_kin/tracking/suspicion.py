"""Searches about a configuration whose parts do not fit a frame."""

from __future__ import annotations

import time as clock

import numpy as np

from pwralign_kin.se3 import Array
from pwralign_kin.tracking.fit import FrameFit, Usual
from pwralign_kin.tracking.frame_fitting import FrameFitting
from pwralign_kin.tracking.joints import Joints
from pwralign_kin.tracking.motion import BelievedMotion

UNEXPLAINED = 0.05
"""The model as a whole is suspected when so much more of the points than usual is unexplained."""

SWEEP_ROUNDS, SWEPT_DEVIATIONS, LEAST_SWEPT = 2, 2.5, 0.4
"""Of the search about a suspected configuration: rounds over all variables, and the range of each, in its standard
deviations and at least (rad; shifts a quarter of it)."""

BETTER, LEAST_GAIN = 0.15, 0.01
"""What is found by a search about a configuration must take away this share of the misfit beyond the usual, and so much
of it at least."""

MOST_DOUBLED, MOST_WIDENED = 4, 3
"""The second search that finds nothing doubles the wait for the next, and so do those after it, so many times at most;
so many in vain widen the ranges."""


class Suspicion:
    """Searches about suspected configurations; the waits between two searches in vain double."""

    def __init__(self, fitting: FrameFitting, joints: Joints) -> None:
        """Begin with no suspicion."""
        self._fitting = fitting
        self._joints = joints
        self._clear()

    def _clear(self) -> None:
        self._waited, self._vain = 0, 0

    def searched(self, fit: FrameFit, expected: BelievedMotion, usual: Usual, limit: float) -> FrameFit:
        """Return what fits a frame better where parts of the model do not fit."""
        if not usual.suspects(fit).any() and not (usual.alone and fit.coverage < usual.coverage - UNEXPLAINED):
            self._clear()
            return fit
        self._waited += 1
        if self._waited < 2 ** min(max(self._vain - 1, 0), MOST_DOUBLED) or clock.perf_counter() >= limit:
            return fit
        least = np.full(len(expected.deviations), LEAST_SWEPT * (1 + min(self._vain, MOST_WIDENED)))
        least[3:6] *= 0.25
        ranges = np.maximum(SWEPT_DEVIATIONS * expected.deviations, least)
        better = self._swept(fit, expected, ranges, usual, limit)
        if better is not fit:
            self._clear()
        else:
            self._waited, self._vain = 0, self._vain + 1
        return better

    def _swept(self, fit: FrameFit, expected: BelievedMotion, ranges: Array, usual: Usual, limit: float) -> FrameFit:
        """Search about a fit and where the model was expected; return what fits clearly better, else the fit."""
        best, against = fit, usual.misfit(fit)
        least = against - max(LEAST_GAIN, BETTER * (against - usual.misfit(usual)))
        for about in (fit, expected):
            if clock.perf_counter() >= limit:
                break
            base, values, gained = self._fitting.swept(about.T_scan_base, about.values, ranges, SWEEP_ROUNDS)
            if not gained:
                continue
            nothing = np.zeros_like(expected.held)
            other = self._fitting.fitted(expected, usual, limit, wide=True, start=(base, values), held=nothing)
            if usual.misfit(other) < least:
                best, least = other, usual.misfit(other)
        return best
