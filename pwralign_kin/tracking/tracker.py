"""An estimate per frame: follow the model while it is seen, search for it when it is lost."""

from __future__ import annotations

import logging
import time as clock
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from numbers import Real

import numpy as np
from numpy.typing import NDArray

from pwralign_kin import kernels
from pwralign_kin.estimation import Estimate
from pwralign_kin.estimation.estimator import Estimator
from pwralign_kin.exceptions import CorrespondenceError, ScanError, StateError
from pwralign_kin.model import ArticulatedModel
from pwralign_kin.scan import DepthFrame, Scan
from pwralign_kin.se3 import Array, rotation_angle
from pwralign_kin.state import State
from pwralign_kin.tracking.fit import CLEAR, Fit, Usual
from pwralign_kin.tracking.frame_fitting import LEAST_POINTS, Frame, FrameFitting, checked
from pwralign_kin.tracking.motion import LONGEST, Motion
from pwralign_kin.tracking.options import TrackerOptions
from pwralign_kin.tracking.tracked_frame import TrackedFrame

logger = logging.getLogger(__name__)

DOUBTFUL, LOST, FOUND = 0.85, 0.6, 0.75
"""Shares of the usual quality: below the first a frame is fitted again from farther starts; below the second the model
is not seen; a lost model is found above the third."""

STAYED = 0.05
"""A given start that explains clearly what is close to it, among other things, is taken without a search if no variable
that the frame determines moves by more than this (rad or model diagonals)."""

PATIENCE = 3
"""Frames in a row without the model after which it is lost."""

LEAST_VISIBLE = 0.15
"""Share of the surface facing the sensor below which something hides the model."""

CONVINCING, SURE = 0.5, 0.9
"""Confidence of an estimate that ends a search where the model then fits like one that is found, or, with the second,
not like a lost one; after many searches in vain the second is enough."""

MOST_WAIT = 32
"""Frames between two searches for a lost model, at most; the wait doubles from search to search."""

UNEXPLAINED = 0.05
"""So is the model as a whole when so much more of the points than usual is unexplained."""

UNDETERMINED = float(np.radians(2.5))
"""A joint whose standard deviation is larger (rad; of slides this share of a diagonal) is undetermined, ..."""

MUCH_DOUBT = 0.5
"""... or larger than this share of that of a value that may be anywhere within the limits."""

TOLD, VAGUE = 0.75, float(np.radians(8.0))
"""A frame tells a joint when it takes away this share of its variance and leaves a smaller deviation than the second;
others keep their value."""

SYSTEMATIC = 0.0005
"""Models are no rounder or smoother than this (model diagonals): a joint that moves the surface that is seen by less
may as well not have moved."""

SWEEP_ROUNDS, SWEPT_DEVIATIONS, LEAST_SWEPT = 2, 2.5, 0.4
"""Of the search about a suspected configuration: rounds over all variables, and the range of each, in its standard
deviations and at least (rad; shifts a quarter of it)."""

NEAR = 0.1
"""Standard deviation (rad or model diagonals) of a joint within which a fit finds it without a search."""

BETTER, LEAST_GAIN = 0.15, 0.01
"""What is found by a search about a configuration must take away this share of the misfit beyond the usual, and so much
of it at least."""

TRIALS, TRIED, FITTED, BELIEVED = 5, 48, 3, 2
"""Joints that come back may have come to rest on what is not theirs: so often, after waits that double, so many values
of them are tried, and so many of the best are fitted; after so many trials without doubt they are believed."""

EVIDENT = 3.0
"""Points by which one of two fits must do better to be the right one for sure."""

MOST_DOUBT = 16
"""Frames between two searches about a suspected configuration that found nothing, at most; the wait doubles."""


class Tracker:
    """Follows one model from frame to frame.

    The first frame is searched for the model unless `initial` tells about where it is. A model that is not seen goes
    on a little and then holds still; after `PATIENCE` frames it counts as lost and is searched for, from where it was
    and then everywhere. Joints that come back after frames that did not tell them are on trial until other values have
    been tried and none does as well; trials that a time limit cuts short do not count. The same frames give the same
    states, bit for bit, unless there is a time limit.
    """

    def __init__(
        self, model: ArticulatedModel, options: TrackerOptions | None = None, initial: State | None = None
    ) -> None:
        """Prepare for the first frame. Raises what `estimate` raises for options and guesses that do not fit."""
        self.model = model
        if not isinstance(options, TrackerOptions | None):
            raise StateError(f"options must be TrackerOptions, not {type(options).__name__}")
        self.options = options or TrackerOptions()
        self._estimator = Estimator(model, self.options.estimator)
        self._unit = model.joint_scales
        self._turns = np.where(model.continuous, model.upper - model.lower, np.inf)
        self._initial = initial
        if initial is not None:
            if not isinstance(initial, State):
                raise StateError(f"a tracker starts from a State, not {type(initial).__name__}")
            model.root_placement(initial), model.values(initial.joints)
        self._free = ~np.isin(model.joint_names, self.options.estimator.locked)
        self._most_doubt = (model.upper - model.lower) / self._unit / np.sqrt(12.0)
        self._much_doubt = np.minimum(UNDETERMINED, MUCH_DOUBT * self._most_doubt)
        self._fitting = FrameFitting(self._kernel(), model.diagonal, self.options)
        self._doubt, self._doubted, self._vain = 1, 0, 0
        # Joints on trial: their deviations when they came back (else 0), and how far values are apart that fit as well.
        self._back, self._apart = np.zeros_like(self._most_doubt), np.zeros_like(self._most_doubt)
        self._trial, self._waiting, self._random = 0, 0, np.random.default_rng(0)
        self._motion: Motion | None = None
        self._usual: Usual | None = None
        self._missed = 0
        self._wait, self._waited, self._searches = 1, 0, 0
        self._search: Future[Estimate | None] | None = None
        self._pool: ThreadPoolExecutor | None = None

    @property
    def lost(self) -> bool:
        """Whether the model is not found, as of the last frame."""
        return self._usual is None or self._missed >= PATIENCE

    def update(self, frame: Frame, time: float) -> TrackedFrame:
        """Return where the model is in the next frame, taken at `time` (s).

        Raises `ScanError` for a frame that is none, or no later than the one before. A frame without returns is one in
        which the model is not seen.
        """
        start = clock.perf_counter()
        if not isinstance(time, Real) or not np.isfinite(time):
            raise ScanError("track", f"the time of a frame is a finite number of seconds, not {time!r}")
        if self._motion is not None and time <= self._motion.time:
            raise ScanError("track", f"a frame at {time!r} s is not later than the one before, {self._motion.time!r} s")
        frame = checked(frame)
        if self._motion is None:
            before, fit = self._first(frame, time)
        else:
            before = self._motion
            self._motion = before.predicted(time)
            fit = self._followed(frame, self._motion, before, start)
        found = self._accepts(fit)
        searches, answer = self._searches, None
        if not found:
            self._missed += 1
            answer = self._searched(frame, time, fit)
            fit, found = (fit, False) if answer is None else (answer, True)
        searched = answer is not None or self._searches > searches
        if found:
            self._take(fit, before, answer is not None)
        return self._report(fit, time, found, searched, start)

    def _kernel(self) -> kernels.Tracking:
        model, locked = self.model, self.options.estimator.locked
        native = model.kernel_model
        if locked:
            given = {} if self._initial is None else dict(self._initial.joints)
            values = model.values({**self.options.estimator.prior, **given}) / self._unit
            held = np.isin(model.joint_names, locked)
            lower, upper = model.lower / self._unit, model.upper / self._unit
            native = native.restricted(np.where(held, values, lower), np.where(held, values, upper))
        return kernels.Tracking(native, self.options.points, self.options.cell)

    def _first(self, frame: Frame, time: float) -> tuple[Motion, Fit]:
        """Return a model at rest where the initial state has it, or anywhere, and its fit."""
        if self._initial is None:
            self._motion = Motion.at_rest(time, np.eye(4), self.model.values({}) / self._unit, time - LONGEST)
            return self._motion, Fit(self._motion.T, self._motion.values)
        T = self.model.root_placement(self._initial)
        motion = Motion.at_rest(time, T, self.model.values(self._initial.joints) / self._unit, time - LONGEST)
        self._motion = motion
        self._fitting.look(frame, motion)
        fit = self._fitting.fitted(motion, None, np.inf, wide=True)
        clear = fit.coverage >= CLEAR or (fit.agreement >= CLEAR and self._stayed(fit, motion))
        if clear and fit.support >= CLEAR:
            self._usual = Usual.of(fit, 1.0)
        return motion, fit

    def _stayed(self, fit: Fit, motion: Motion) -> bool:
        """Return whether a fit is about where it started."""
        turn = rotation_angle(fit.T[:3, :3] @ motion.T[:3, :3].T)
        shift = float(np.linalg.norm((fit.T - motion.T)[:3, 3])) / self.model.diagonal
        told = np.diag(fit.covariance)[6:] < UNDETERMINED**2
        joints = np.abs(fit.values - motion.values)[told].max(initial=0.0)
        return bool(max(turn, shift, joints) < STAYED)

    def _followed(self, frame: Frame, expected: Motion, before: Motion, start: float) -> Fit:
        """Fit the frame from where the model is expected; where that is doubtful, from farther starts and searched."""
        limit = np.inf if self.options.time_limit is None else start + self.options.time_limit
        usual = self._usual
        if usual is None:
            return Fit(expected.T, expected.values)
        self._fitting.look(frame, expected)
        fit = self._fitting.fitted(expected, usual, limit)
        freed = expected.held & ~self._untold(fit, expected)
        if freed.any():
            fit = self._freed(fit, expected, freed, limit)
        if fit.visible == 0.0 or fit.points < LEAST_POINTS:
            return fit
        poor = usual.quality(fit) < DOUBTFUL
        if poor:
            for start_from in (expected, replace(before, time=expected.time, covariance=expected.covariance)):
                if clock.perf_counter() >= limit:
                    return fit
                other = self._fitting.fitted(start_from, usual, limit, wide=True)
                if usual.misfit(other) < usual.misfit(fit):
                    fit = other
        return self._tried(self._searched_about(fit, expected, limit), expected, limit)

    def _searched_about(self, fit: Fit, expected: Motion, limit: float) -> Fit:
        """Return what fits a frame better where parts of the model do not fit or have not been seen for a while.

        The waits between two searches in vain double.
        """
        usual = self._usual
        assert usual is not None
        suspected = bool(usual.suspects(fit).any()) or (usual.alone and fit.coverage < usual.coverage - UNEXPLAINED)
        held = self._free & expected.held
        if not suspected and not held.any():
            self._doubt, self._doubted, self._vain = 1, 0, 0
            return fit
        self._doubted += 1
        if self._doubted < self._doubt or clock.perf_counter() >= limit:
            return fit
        ranges = SWEPT_DEVIATIONS * expected.deviations
        if suspected:
            least = np.full(len(ranges), LEAST_SWEPT * (1 + self._vain))
            least[3:6] *= 0.25
            better = self._swept(fit, expected, np.maximum(ranges, least), limit)
        else:
            better = self._swept(fit, expected, np.where(np.r_[np.zeros(6, bool), held], ranges, 0.0), limit)
        found = better is not fit
        self._doubt, self._vain = (1, 0) if found else (min(2 * self._doubt, MOST_DOUBT), min(self._vain + 1, 3))
        self._doubted = 0
        return better

    def _freed(self, fit: Fit, expected: Motion, freed: NDArray[np.bool_], limit: float) -> Fit:
        """Return the fit once joints that were held, and that the frame tells, are looked for and fitted too."""
        far = expected.deviations > NEAR
        ranges = np.where(np.r_[np.zeros(6, bool), freed] & far, SWEPT_DEVIATIONS * expected.deviations, 0.0)
        T, values, _ = self._fitting.swept(fit.T, fit.values, ranges, 1)
        other = self._fitting.fitted(expected, self._usual, limit, start=(T, values), held=expected.held & ~freed)
        assert self._usual is not None
        return other if self._usual.misfit(other) <= self._usual.misfit(fit) + LEAST_GAIN else fit

    def _tried(self, fit: Fit, expected: Motion, limit: float) -> Fit:
        """Return the best fit about other values of joints that came back lately, and doubt them until it is clear."""
        usual = self._usual
        assert usual is not None
        untold, doubt = self._untold(fit, expected), expected.deviations[6:]
        back = expected.held & ~untold & (doubt > NEAR)
        self._back = np.where(back, np.maximum(doubt, self._back), self._back)
        self._apart = np.where(back, self._back, np.where(self._back > 0.0, self._apart, 0.0))
        on_trial = (self._back > 0.0) & ~untold  # those that are hidden again go on when they are back
        if back.any():
            self._trial, self._waiting = 0, 0
        if not on_trial.any() or clock.perf_counter() >= limit:
            return fit
        if self._waiting and not usual.doubts(fit):
            self._waiting -= 1
            return fit
        fits = [fit, *self._others(fit, expected, np.where(on_trial, self._back, 0.0), limit)]
        if clock.perf_counter() >= limit:
            return fit  # what is cut short tells nothing
        best = min(fits, key=lambda other: other.against)
        if best.against > fit.against - EVIDENT:
            best = fit
        near = [other.values for other in fits if other.against < best.against + EVIDENT]
        doubted = usual.doubts(best)
        self._trial += not doubted
        self._waiting = 2**self._trial - 1
        apart = np.abs(near - best.values)
        apart = np.minimum(apart, np.abs(self._turns / self._unit - apart)).max(axis=0)
        if doubted or self._trial < BELIEVED:
            apart = np.maximum(apart, self._back)
        self._apart = np.where(on_trial, apart, self._apart)
        if self._trial >= TRIALS:
            self._back = np.where(on_trial, 0.0, self._back)
        return best

    def _others(self, fit: Fit, expected: Motion, doubt: Array, limit: float) -> list[Fit]:
        """Return fits from the best of many values within the doubt (k,) of joints, all other variables as they are."""
        usual = self._usual
        assert usual is not None
        starts = fit.values + self._random.normal(size=(TRIED, len(doubt))) * doubt
        lower, upper = self.model.lower / self._unit, self.model.upper / self._unit
        turned = lower + (starts - lower) % np.maximum(upper - lower, 1e-9)
        starts = np.where(self.model.continuous, turned, np.clip(starts, lower, upper))
        against: list[float] = []
        for start in starts:
            if clock.perf_counter() >= limit:
                return []
            against.append(self._fitting.against(fit.T, start, usual))
        order = np.argsort(against, kind="stable")
        loose = replace(expected, covariance=expected.covariance + np.diag(np.r_[np.zeros(6), doubt**2]))
        held = expected.held & self._untold(fit, expected)
        T = self._fitting.inward(fit.T)
        return [self._fitting.fitted(loose, usual, limit, start=(T, starts[i]), held=held) for i in order[:FITTED]]

    def _swept(self, fit: Fit, expected: Motion, ranges: Array, limit: float) -> Fit:
        """Search about a fit and where the model was expected; return what fits clearly better, else the fit."""
        usual = self._usual
        assert usual is not None
        best, against = fit, usual.misfit(fit)
        least = against - max(LEAST_GAIN, BETTER * (against - usual.misfit(usual)))
        for T, values in ((fit.T, fit.values), (expected.T, expected.values)):
            if clock.perf_counter() >= limit:
                break
            T, values, gained = self._fitting.swept(T, values, ranges, SWEEP_ROUNDS)
            if not gained:
                continue
            held = expected.held & (ranges[6:] == 0.0)
            other = self._fitting.fitted(expected, usual, limit, wide=True, start=(T, values), held=held)
            if usual.misfit(other) < least:
                best, least = other, usual.misfit(other)
        return best

    def _untold(self, fit: Fit, expected: Motion) -> NDArray[np.bool_]:
        """Return the joints (k,) that a frame does not tell; those that are locked need not be told."""
        if not fit.iterations:
            return self._free
        variance = np.diag(fit.covariance)[6:]
        told = (variance < (1.0 - TOLD) * np.diag(expected.covariance)[6:]) | (variance < UNDETERMINED**2)
        return np.asarray(self._free & ~(told & (variance < VAGUE**2)))

    def _accepts(self, fit: Fit) -> bool:
        """Return whether a fit shows the model; once it is lost that takes more."""
        if self._usual is None or fit.iterations == 0 or fit.visible < LEAST_VISIBLE:
            return False
        return self._usual.quality(fit) >= (FOUND if self.lost else LOST)

    def _searched(self, frame: Frame, time: float, fit: Fit) -> Fit | None:
        """Search for a lost model, now and then; return its fit once it is found."""
        if not self.lost or self._motion is None:
            return None
        if self._search is not None:
            return self._search_result(frame, time)
        if not self._due(hidden=self._usual is not None and fit.visible < LEAST_VISIBLE):
            return None
        # Around a guess first; a guess confines the search in a scene, so every other search does without.
        self._searches += 1
        guess = None
        if self._searches % 2:
            guess = self._initial if self._usual is None else self._state(self._motion.T, self._motion.values)
        if self.options.time_limit is not None:
            if self._pool is None:
                self._pool = ThreadPoolExecutor(1)
            self._search = self._pool.submit(self._estimate, frame, guess)
            return None
        return self._adopted(self._estimate(frame, guess), frame, time)

    def _due(self, hidden: bool) -> bool:
        """Return whether this frame is searched; the waits double, and are longest while something hides the model."""
        self._waited += 1
        if self._waited < (MOST_WAIT if hidden else self._wait):
            return False
        self._waited, self._wait = 0, min(2 * self._wait, MOST_WAIT)
        return True

    def _search_result(self, frame: Frame, time: float) -> Fit | None:
        """Return the fit of this frame from what a search of an earlier frame found, if it is done."""
        search = self._search
        if search is None or not search.done():
            return None
        self._search = None
        return self._adopted(search.result(), frame, time)

    def _estimate(self, frame: Frame, guess: State | None) -> Estimate | None:
        """Return the estimate of a frame, first from a guess, then without one; None where it cannot be made."""
        try:
            scan = frame.to_scan() if isinstance(frame, DepthFrame) else frame
            scan = scan if isinstance(scan, Scan) else Scan(scan)
            return self._estimator.run(scan, guess, None)
        except (ScanError, CorrespondenceError) as error:  # too little is seen
            logger.debug("search: %s", error)
            return None

    def _adopted(self, answer: Estimate | None, frame: Frame, time: float) -> Fit | None:
        """Take over a convincing estimate as the start of a new track."""
        if answer is None or answer.confidence < CONVINCING:
            return None
        values = self.model.values(answer.state.joints) / self._unit
        start = Motion.at_rest(time, self.model.root_placement(answer.state), values, time - LONGEST)
        late = self.options.time_limit is not None  # the model has gone on since the frame that was searched
        self._fitting.look(frame, start)
        fit = self._fitting.fitted(start, None, np.inf, wide=late)  # what was usual must not bias it
        if fit.agreement == 0.0 or fit.support == 0.0:
            return None
        if self._usual is not None:
            sure = answer.confidence >= SURE
            in_vain = self._wait == MOST_WAIT
            quality = min(self._usual.quality(fit), fit.coverage / self._usual.coverage)
            if not (sure and in_vain) and quality < (LOST if sure else FOUND):
                return None
        self._motion = start
        self._usual = Usual.of(fit, answer.confidence)
        self._back, self._apart = np.zeros_like(self._back), np.zeros_like(self._apart)
        return fit

    def _take(self, fit: Fit, before: Motion, searched: bool) -> None:
        """Go on from a fit."""
        assert self._motion is not None and self._usual is not None
        time = self._motion.time
        if searched or time == before.time or self.lost:
            self._motion = replace(Motion.at_rest(time, fit.T, fit.values, time), covariance=fit.covariance)
        else:
            untold = self._untold(fit, self._motion)
            self._motion = self._motion.corrected(
                fit.T, fit.values, fit.covariance, untold, self._turns / self._unit, before
            )
        if self._usual.quality(fit) >= DOUBTFUL:
            self._usual = self._usual.renewed(fit)
        self._missed, self._wait, self._waited, self._searches = 0, 1, 0, 0

    def _report(self, fit: Fit, time: float, found: bool, searched: bool, start: float) -> TrackedFrame:
        assert self._motion is not None
        quality = 0.0 if self._usual is None else self._usual.quality(fit) * self._usual.confidence
        covariance = self._covariance(fit) if self.options.covariance and found else None
        doubt = self._most_doubt if self._usual is None else self._motion.deviations[6:]
        doubt = np.hypot(doubt, self._apart)
        if found:
            systematic = SYSTEMATIC / np.maximum(fit.levers, 1e-9)
            doubt = np.where(self._motion.held, doubt, np.hypot(doubt, systematic))
        doubt = np.where(self._free, np.minimum(doubt, self._most_doubt), 0.0)
        return TrackedFrame(
            time=time,
            state=self._state(self._motion.T, self._motion.values),
            confidence=quality if found else 0.0,
            lost=self.lost,
            searched=searched,
            scan_coverage=fit.coverage,
            model_support=fit.support,
            inlier_rmse=fit.rmse * self.model.diagonal,
            points=fit.points,
            iterations=fit.iterations,
            seconds=clock.perf_counter() - start,
            std=dict(zip(self.model.joint_names, (doubt * self._unit).tolist(), strict=True)),
            undetermined=tuple(np.array(self.model.joint_names, object)[doubt > self._much_doubt].tolist()),
            covariance=covariance,
        )

    def _covariance(self, fit: Fit) -> Array:
        scale = np.r_[np.ones(3), np.full(3, self.model.diagonal), self._unit]
        on_trial = np.diag(np.r_[np.zeros(6), self._apart**2])
        return np.asarray((fit.covariance + on_trial) * np.outer(scale, scale))

    def _state(self, T: Array, values: Array) -> State:
        joints = self.model.within_limits(values * self._unit)
        return State(T, dict(zip(self.model.joint_names, joints.tolist(), strict=True)), self.model.root_link)
