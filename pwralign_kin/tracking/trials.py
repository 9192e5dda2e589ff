"""Joints that frames do not tell, or did not lately, and that may have come to rest on what is not theirs."""

from __future__ import annotations

import time as clock
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pwralign_kin.se3 import Array
from pwralign_kin.tracking.even_points import EvenPoints
from pwralign_kin.tracking.fit import EVIDENT, FrameFit, Usual
from pwralign_kin.tracking.frame_fitting import FrameFitting
from pwralign_kin.tracking.joints import Joints
from pwralign_kin.tracking.motion import LONGEST, BelievedMotion
from pwralign_kin.tracking.suspicion import LEAST_GAIN, SWEPT_DEVIATIONS

NEAR = 0.1
"""Standard deviation (rad or model diagonals) of a joint within which a fit finds it without a search."""

TRIALS, BELIEVED, MOST_DOUBLED = 5, 2, 2
"""So many trials of a joint end them unless others fit as well, after so many it is believed, and waits between them
double so often."""

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
        # Largest deviations of joints on trial (else 0), how far values are apart that fit as well, the same or, of
        # joints on trial that are not told, the deviation.
        self._spread, self._alike, self.apart = np.zeros(count), np.zeros(count), np.zeros(count)
        self._passed, self._waited = np.zeros(count, int), np.zeros(count, int)
        self.sequence = EvenPoints()

    @property
    def active(self) -> bool:
        """Whether any joint is on trial."""
        return bool((self._spread > 0.0).any())

    def freed(
        self, fit: FrameFit, expected: BelievedMotion, freed: NDArray[np.bool_], usual: Usual, limit: float
    ) -> FrameFit:
        """Return the fit once joints (k,) that were held, and that the frame tells, are looked for and fitted too."""
        far = expected.deviations > NEAR
        ranges = np.where(np.r_[np.zeros(6, bool), freed] & far, SWEPT_DEVIATIONS * expected.deviations, 0.0)
        base, values, _ = self._fitting.swept(fit.T_scan_base, fit.values, ranges, 1)
        other = self._fitting.fitted(expected, usual, limit, start=(base, values), held=expected.held & ~freed)
        return other if usual.misfit(other) <= usual.misfit(fit) + LEAST_GAIN else fit

    def tried(self, fit: FrameFit, expected: BelievedMotion, usual: Usual, limit: float) -> FrameFit:
        """Return the best fit about other values of the chains of joints on trial that are due."""
        doubt = expected.deviations[6:]
        # After a pause any joint may be elsewhere, where it fits about as well.
        paused = (expected.ahead > LONGEST) & (self._spread == 0.0)
        far = self._joints.free & (expected.held | paused) & (doubt > NEAR)
        if not self.active and not far.any():
            return fit
        back = far & ~self._joints.untold(fit, expected)
        self._spread = np.where(far, np.maximum(doubt, self._spread), self._spread)
        self._alike = np.where(back, self._spread, self._alike)
        self._passed[back] = 0
        on_trial = self._spread > 0.0
        self._waited[on_trial] += 1
        due = on_trial & ((self._waited >= 2 ** np.minimum(self._passed, MOST_DOUBLED)) | usual.doubts(fit))
        for chain in self._joints.chains(on_trial):
            if (chain & due).any():
                fit = self._best(fit, expected, chain, usual, limit)
        hidden = (self._spread > 0.0) & self._joints.untold(fit, expected)
        self.apart = np.where(hidden, self._spread, self._alike)
        return fit

    def _best(
        self, fit: FrameFit, expected: BelievedMotion, chain: NDArray[np.bool_], usual: Usual, limit: float
    ) -> FrameFit:
        """Return the best fit about values of a chain (k,), and note how clear it is."""
        drawn, against, own = self._drawn_about(fit, chain, usual, limit)
        doubt = np.where(chain, self._spread, 0.0)
        base, held = self._fitting.inward(fit.T_scan_base), expected.held & self._joints.untold(fit, expected) & ~chain
        fits = [fit]
        better = against < own
        for values, least in zip(drawn[better][:FITTED], against[better], strict=False):
            if clock.perf_counter() >= limit:
                break
            start = (base, values)
            other = self._fitting.fitted(expected, usual, limit, start=start, held=held, doubt=doubt)
            if other.against > least + EVIDENT:  # back where it was expected, though that speaks against it
                there = replace(expected, values=np.where(chain, values, expected.values))
                other = self._fitting.fitted(there, usual, limit, start=start, held=held, doubt=doubt)
            fits.append(other)
        if clock.perf_counter() >= limit:
            return fit  # what is cut short tells nothing
        fitted = np.array([other.values for other in fits])
        against_fits = np.array([other.against for other in fits])
        first = int(np.argmin(against_fits))
        best = fits[first] if against_fits[first] < fit.against - EVIDENT else fit
        near = np.r_[fitted, drawn][np.r_[against_fits, against] < against_fits[first] + EVIDENT]
        told = chain & ~self._joints.untold(best, expected)
        self._note(self._joints.apart(near, best.values).max(axis=0), chain, told, doubted=usual.doubts(best))
        return best

    def _note(self, alike: Array, chain: NDArray[np.bool_], told: NDArray[np.bool_], *, doubted: bool) -> None:
        """Note after a trial of a chain how far values are apart that fit as well, and end what is clear."""
        self._waited[chain] = 0
        self._passed[chain] += not doubted
        doubtful = doubted | (self._passed < BELIEVED)
        alike = np.where(doubtful, np.maximum(alike, self._spread), alike)
        self._alike = np.where(told, alike, self._alike)
        # What is seen of a joint's parts tells it only together with the joints that move it.
        ended = told & (self._passed >= TRIALS) & (self._alike <= self._joints.much_doubt)
        others = (self._spread > 0.0) & ~ended
        ended &= ~(self._joints.moves & others[:, None]).any(axis=0)
        self._spread[ended], self._alike[ended], self._passed[ended] = 0.0, 0.0, 0

    def _drawn_about(
        self, fit: FrameFit, chain: NDArray[np.bool_], usual: Usual, limit: float
    ) -> tuple[Array, Array, float]:
        """Return values (n, k) of a chain drawn ever closer about the best until the time is up, the best first.

        Then what speaks against them (n,), and against those of the fit.
        """
        joints, reach = self._joints, REACHED * self._spread[chain]
        bounded = np.isinf(joints.turns[chain])
        low, high = fit.values[chain] - reach, fit.values[chain] + reach
        low = np.where(bounded, np.maximum(low, joints.lower[chain]), low)
        high = np.where(bounded, np.minimum(high, joints.upper[chain]), high)
        rows, against, own = fit.values[None], np.zeros(1), 0.0
        about = (low + high)[None] / 2.0
        for share, tolerance in ROUNDS:
            if clock.perf_counter() >= limit:
                break
            best = rows[:KEPT]
            drawn = share * (high - low) * (self.sequence.draw(DRAWN // len(about), len(reach)) - 0.5)
            rows = np.repeat(fit.values[None], len(about) * len(drawn), axis=0)
            rows[:, chain] = (about[:, None] + drawn).reshape(-1, len(reach))
            rows = np.concatenate([fit.values[None], best, joints.within(rows)])
            against = self._fitting.weighed(fit.T_scan_base, rows, chain, max(tolerance, usual.tolerance))
            own, order = float(against[0]), np.argsort(against, kind="stable")
            rows, against = rows[order], against[order]
            about = rows[:KEPT, chain]
            if against[-1] - against[0] < EVIDENT:  # nothing tells them apart, as of hidden parts or round ones
                return rows, against, float(against[0])
        return rows, against, own
