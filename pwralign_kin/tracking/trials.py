"""Joints that frames do not tell, or did not lately, and that may have come to rest on what is not theirs."""

from __future__ import annotations

import time as clock
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pwralign_kin.se3 import Array
from pwralign_kin.tracking.fit import EVIDENT, Fit, Usual
from pwralign_kin.tracking.frame_fitting import FrameFitting
from pwralign_kin.tracking.joints import Joints
from pwralign_kin.tracking.motion import Motion

NEAR = 0.1
"""Standard deviation (rad or model diagonals) of a joint within which a fit finds it without a search."""

TRIALS, BELIEVED, MOST_WAIT = 5, 2, 16
"""So many trials of a joint, after waits that double up to so many frames; after so many without doubt it is
believed."""

DRAWN, KEPT, FITTED = 64, 4, 2
"""So many values of a chain are drawn at a time, so many of the best are drawn about again, and so many are fitted."""

REACHED = 2.5
"""Standard deviations to either side within which values are drawn."""

ROUNDS = ((1.0, 0.03), (0.3, 0.015), (0.1, 0.0))
"""Share of the range that is drawn from, and tolerance of points (model diagonals; 0: the usual one)."""


class Trials:
    """Tries other values of joints that come back or stay away, and doubts them until it is clear."""

    def __init__(self, fitting: FrameFitting, joints: Joints) -> None:
        """Begin with no joint on trial."""
        self._fitting = fitting
        self._joints = joints
        self.clear()

    def clear(self) -> None:
        """End all trials: a search has told all joints."""
        count = len(self._joints.unit)
        # Largest deviations of joints on trial (else 0), and how far values are apart that fit as well.
        self._spread, self.apart = np.zeros(count), np.zeros(count)
        self._passed, self._waited = np.zeros(count, int), np.zeros(count, int)
        self._drawn = 0

    @property
    def active(self) -> bool:
        """Whether any joint is on trial."""
        return bool((self._spread > 0.0).any())

    def tried(self, fit: Fit, expected: Motion, usual: Usual, limit: float) -> Fit:
        """Return the best fit about other values of one chain of joints on trial, that which has waited longest."""
        untold, doubt = self._joints.untold(fit, expected), expected.deviations[6:]
        far = self._joints.free & expected.held & (doubt > NEAR)
        back = far & ~untold
        self._spread = np.where(far, np.maximum(doubt, self._spread), self._spread)
        self.apart = np.where(back, self._spread, self.apart)
        self._passed[back] = 0
        on_trial = self._spread > 0.0
        self._waited[on_trial] += 1
        due = on_trial & ((self._waited >= np.minimum(2**self._passed, MOST_WAIT)) | usual.doubts(fit))
        chains = [chain for chain in self._joints.chains(on_trial) if (chain & due).any()]
        if not chains or clock.perf_counter() >= limit:
            return fit
        chain = max(chains, key=lambda chain: int(self._waited[chain].max()))
        fits = [fit, *self._others(fit, expected, chain, usual, limit)]
        if clock.perf_counter() >= limit:
            return fit  # what is cut short tells nothing
        best = min(fits, key=lambda other: other.against)
        if best.against > fit.against - EVIDENT:
            best = fit
        self._judge(fits, best, chain, chain & ~self._joints.untold(best, expected), doubted=usual.doubts(best))
        return best

    def _judge(
        self, fits: list[Fit], best: Fit, chain: NDArray[np.bool_], told: NDArray[np.bool_], *, doubted: bool
    ) -> None:
        """Note how clear the values of a chain are after a trial, of whose joints the best fit tells some."""
        self._waited[chain] = 0
        self._passed[chain] += not doubted
        near = np.array([other.values for other in fits if other.against < best.against + EVIDENT])
        apart = self._joints.apart(near, best.values).max(axis=0)
        doubtful = doubted | (self._passed < BELIEVED)
        apart = np.where(doubtful, np.maximum(apart, self._spread), apart)
        self.apart = np.where(told, apart, self.apart)
        ended = told & (self._passed >= TRIALS)
        self._spread[ended], self._passed[ended] = 0.0, 0

    def _others(self, fit: Fit, expected: Motion, chain: NDArray[np.bool_], usual: Usual, limit: float) -> list[Fit]:
        """Return fits from the best of many values of a chain (k,), all other variables as they are."""
        starts = self._likely(fit, chain, usual)
        doubt = np.where(chain, self._spread, 0.0)
        loose = replace(expected, covariance=expected.covariance + np.diag(np.r_[np.zeros(6), doubt**2]))
        held = expected.held & self._joints.untold(fit, expected) & ~chain
        T = self._fitting.inward(fit.T)
        return [
            self._fitting.fitted(loose, usual, limit, start=(T, start), held=held)
            for start in starts
            if clock.perf_counter() < limit
        ]

    def _likely(self, fit: Fit, chain: NDArray[np.bool_], usual: Usual) -> Array:
        """Return the values (FITTED, k) of a chain that least speaks against, drawn ever closer about the best."""
        joints, reach = self._joints, REACHED * self._spread[chain]
        bounded = np.isinf(joints.turns[chain])
        low, high = fit.values[chain] - reach, fit.values[chain] + reach
        low = np.where(bounded, np.maximum(low, joints.lower[chain]), low)
        high = np.where(bounded, np.minimum(high, joints.upper[chain]), high)
        best = fit.values[None]
        middle = (low + high) / 2.0
        for share, tolerance in ROUNDS:
            drawn = self._spaced(DRAWN // len(best), len(reach)) - 0.5
            rows = np.repeat(best, len(drawn), axis=0)
            about = np.repeat(middle[None] if share == 1.0 else best[:, chain], len(drawn), axis=0)
            rows[:, chain] = about + share * (high - low) * np.tile(drawn, (len(best), 1))
            rows = np.concatenate([best, joints.within(rows)])
            against = self._fitting.weighed(fit.T, rows, chain, max(tolerance, usual.tolerance))
            best = rows[np.argsort(against, kind="stable")[:KEPT]]
        return best[:FITTED]

    def _spaced(self, count: int, size: int) -> Array:
        """Return the next points (count, size) of a sequence that fills the unit cube evenly.

        M. Roberts, The Unreasonable Effectiveness of Quasirandom Sequences, 2018.
        """
        ratio = 2.0
        for _ in range(32):
            ratio = (1.0 + ratio) ** (1.0 / (size + 1))
        numbers = np.arange(self._drawn, self._drawn + count)[:, None]
        self._drawn += count
        return np.asarray((0.5 + numbers * ratio ** -np.arange(1.0, size + 1)) % 1.0)
