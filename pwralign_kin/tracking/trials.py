"""Joints that come back after frames that did not tell them, and that may have come to rest on what is not theirs."""

from __future__ import annotations

import time as clock
from dataclasses import replace

import numpy as np

from pwralign_kin.se3 import Array
from pwralign_kin.tracking.fit import Fit, Usual
from pwralign_kin.tracking.frame_fitting import FrameFitting
from pwralign_kin.tracking.joints import Joints
from pwralign_kin.tracking.motion import Motion

NEAR = 0.1
"""Standard deviation (rad or model diagonals) of a joint within which a fit finds it without a search."""

TRIALS, TRIED, FITTED, BELIEVED = 5, 48, 3, 2
"""So often, after waits that double, so many values of joints on trial are tried, and so many of the best are fitted;
after so many trials without doubt they are believed."""

EVIDENT = 3.0
"""Points by which one of two fits must do better to be the right one for sure."""


class Trials:
    """Tries other values of joints that came back lately, and doubts them until it is clear."""

    def __init__(self, fitting: FrameFitting, joints: Joints) -> None:
        """Begin with no joint on trial."""
        self._fitting = fitting
        self._joints = joints
        self._random = np.random.default_rng(0)
        self.clear()

    def clear(self) -> None:
        """End all trials: a search has told all joints."""
        none = np.zeros(len(self._joints.unit))
        # Deviations when they came back of joints on trial (else 0), and how far values are apart that fit as well.
        self._back, self.apart = none, none
        self._trial, self._waiting = 0, 0

    def tried(self, fit: Fit, expected: Motion, usual: Usual, limit: float) -> Fit:
        """Return the best fit about other values of joints on trial."""
        untold, doubt = self._joints.untold(fit, expected), expected.deviations[6:]
        back = expected.held & ~untold & (doubt > NEAR)
        self._back = np.where(back, np.maximum(doubt, self._back), self._back)
        self.apart = np.where(back, self._back, np.where(self._back > 0.0, self.apart, 0.0))
        on_trial = (self._back > 0.0) & ~untold  # those that are hidden again go on when they are back
        if back.any():
            self._trial, self._waiting = 0, 0
        if not on_trial.any() or clock.perf_counter() >= limit:
            return fit
        if self._waiting and not usual.doubts(fit):
            self._waiting -= 1
            return fit
        fits = [fit, *self._others(fit, expected, np.where(on_trial, self._back, 0.0), usual, limit)]
        if clock.perf_counter() >= limit:
            return fit  # what is cut short tells nothing
        best = min(fits, key=lambda other: other.against)
        if best.against > fit.against - EVIDENT:
            best = fit
        near = np.array([other.values for other in fits if other.against < best.against + EVIDENT])
        doubted = usual.doubts(best)
        self._trial += not doubted
        self._waiting = 2**self._trial - 1
        apart = self._joints.apart(near, best.values).max(axis=0)
        if doubted or self._trial < BELIEVED:
            apart = np.maximum(apart, self._back)
        self.apart = np.where(on_trial, apart, self.apart)
        if self._trial >= TRIALS:
            self._back = np.where(on_trial, 0.0, self._back)
        return best

    def _others(self, fit: Fit, expected: Motion, doubt: Array, usual: Usual, limit: float) -> list[Fit]:
        """Return fits from the best of many values within the doubt (k,) of joints, all other variables as they are."""
        starts = self._joints.within(fit.values + self._random.normal(size=(TRIED, len(doubt))) * doubt)
        against: list[float] = []
        for start in starts:
            if clock.perf_counter() >= limit:
                return []
            against.append(self._fitting.against(fit.T, start, usual))
        order = np.argsort(against, kind="stable")
        loose = replace(expected, covariance=expected.covariance + np.diag(np.r_[np.zeros(6), doubt**2]))
        held = expected.held & self._joints.untold(fit, expected)
        T = self._fitting.inward(fit.T)
        return [self._fitting.fitted(loose, usual, limit, start=(T, starts[i]), held=held) for i in order[:FITTED]]
