"""An estimate per frame: follow the model while it is seen, search for it when it is lost."""

from __future__ import annotations

import time as clock
from dataclasses import replace
from numbers import Real

import numpy as np

from pwralign_kin import kernels
from pwralign_kin.estimation import Estimate
from pwralign_kin.exceptions import ArgumentError, ScanError
from pwralign_kin.model import ArticulatedModel
from pwralign_kin.se3 import Array, rotation_angle
from pwralign_kin.state import State
from pwralign_kin.tracking.fit import CLEAR, FrameFit, Usual
from pwralign_kin.tracking.frame_fitting import LEAST_POINTS, Frame, FrameFitting, checked
from pwralign_kin.tracking.joints import UNDETERMINED, Joints
from pwralign_kin.tracking.motion import LONGEST, BelievedMotion
from pwralign_kin.tracking.options import TrackerOptions
from pwralign_kin.tracking.recovery import Recovery
from pwralign_kin.tracking.suspicion import Suspicion
from pwralign_kin.tracking.tracked_frame import TrackedFrame
from pwralign_kin.tracking.trials import Trials

DOUBTFUL, LOST, FOUND = 0.85, 0.6, 0.75
"""Shares of the usual quality: below the first a frame does not renew what is usual; below the second the model is not
seen; a lost model is found above the third."""

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

SYSTEMATIC = 0.0005
"""Models are no rounder or smoother than this (model diagonals): a joint that moves the surface that is seen by less
may as well not have moved."""


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
            raise ArgumentError("options", "TrackerOptions", type(options).__name__)
        self.options = options or TrackerOptions()
        beside = self.options.time_limit is not None
        self._recovery = Recovery(model, self.options.estimator, beside=beside)
        self._initial = initial
        if initial is not None:
            _check_start(model, initial)
        self._joints = Joints.of(model, self.options.estimator.locked)
        self._fitting = FrameFitting(self._kernel(), model.diagonal, self.options)
        self._suspicion = Suspicion(self._fitting, self._joints)
        self._trials = Trials(self._fitting, self._joints)
        self._motion: BelievedMotion | None = None
        self._usual: Usual | None = None
        self._missed = 0

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
            fit = self._followed(frame, self._motion, start)
        found = self._accepts(fit)
        searches, again = self._recovery.searches, None
        if not found:
            self._missed += 1
            again = self._searched(frame, time, fit) if self.lost else None
        searched = again is not None or self._recovery.searches > searches
        if again is not None:
            fit, found = again, True
        if found:
            self._take(fit, before, again is not None)
        return self._report(fit, time, found, searched, start)

    def _kernel(self) -> kernels.Tracking:
        model, locked = self.model, self.options.estimator.locked
        native = model.kernel_model
        if locked:
            given = {} if self._initial is None else dict(self._initial.joints)
            values = model.values({**self.options.estimator.prior, **given}) / self._joints.unit
            held = np.isin(model.joint_names, locked)
            lower, upper = self._joints.lower, self._joints.upper
            native = native.restricted(np.where(held, values, lower), np.where(held, values, upper))
        return kernels.Tracking(native, self.options.points, self.options.cell)

    def _first(self, frame: Frame, time: float) -> tuple[BelievedMotion, FrameFit]:
        """Return a model at rest where the initial state has it, or anywhere, and its fit."""
        if self._initial is None:
            self._motion = BelievedMotion.at_rest(
                time, np.eye(4), self.model.values({}) / self._joints.unit, time - LONGEST
            )
            return self._motion, FrameFit(self._motion.T_scan_base, self._motion.values)
        T = self.model.root_placement(self._initial)
        motion = BelievedMotion.at_rest(
            time, T, self.model.values(self._initial.joints) / self._joints.unit, time - LONGEST
        )
        self._motion = motion
        self._fitting.look(frame, motion)
        fit = self._fitting.fitted(motion, None, np.inf, wide=True)
        clear = fit.coverage >= CLEAR or (fit.agreement >= CLEAR and self._stayed(fit, motion))
        if clear and fit.support >= CLEAR:
            self._usual = Usual.of(fit, 1.0)
        return motion, fit

    def _stayed(self, fit: FrameFit, motion: BelievedMotion) -> bool:
        """Return whether a fit is about where it started."""
        turn = rotation_angle(fit.T_scan_base[:3, :3] @ motion.T_scan_base[:3, :3].T)
        shift = float(np.linalg.norm((fit.T_scan_base - motion.T_scan_base)[:3, 3])) / self.model.diagonal
        told = np.diag(fit.covariance)[6:] < UNDETERMINED**2
        joints = np.abs(fit.values - motion.values)[told].max(initial=0.0)
        return bool(max(turn, shift, joints) < STAYED)

    def _followed(self, frame: Frame, expected: BelievedMotion, start: float) -> FrameFit:
        """Fit the frame from where the model is expected; where that is doubtful, search about it."""
        limit = np.inf if self.options.time_limit is None else start + self.options.time_limit
        usual = self._usual
        if usual is None:
            return FrameFit(expected.T_scan_base, expected.values)
        self._fitting.look(frame, expected)
        fit = self._fitting.fitted(expected, usual, limit)
        if fit.iterations == self.options.iterations and usual.doubts(fit):  # it has not settled: go on
            reached = (self._fitting.inward(fit.T_scan_base), fit.values)
            settled = self._fitting.fitted(expected, usual, limit, start=reached)
            fit = replace(settled, iterations=fit.iterations + settled.iterations)
        freed = expected.held & ~self._joints.untold(fit, expected)
        if freed.any():
            fit = self._trials.freed(fit, expected, freed, usual, limit)
        if fit.visible == 0.0 or fit.points < LEAST_POINTS:
            return fit
        fit = self._suspicion.searched(fit, expected, usual, limit)
        return self._trials.tried(fit, expected, usual, limit)

    def _accepts(self, fit: FrameFit) -> bool:
        """Return whether a fit shows the model; once it is lost that takes more."""
        if self._usual is None or fit.iterations == 0 or fit.visible < LEAST_VISIBLE:
            return False
        return self._usual.quality(fit) >= (FOUND if self.lost else LOST)

    def _searched(self, frame: Frame, time: float, fit: FrameFit) -> FrameFit | None:
        """Search for a lost model, now and then; return its fit once it is found."""
        assert self._motion is not None
        guess = self._initial if self._usual is None else self._state(self._motion.T_scan_base, self._motion.values)
        hidden = self._usual is not None and fit.visible < LEAST_VISIBLE
        return self._adopted(self._recovery.answer(frame, guess, hidden=hidden), frame, time)

    def _adopted(self, answer: Estimate | None, frame: Frame, time: float) -> FrameFit | None:
        """Take over a convincing estimate as the start of a new track."""
        if answer is None or answer.confidence < CONVINCING:
            return None
        values = self.model.values(answer.state.joints) / self._joints.unit
        start = BelievedMotion.at_rest(time, self.model.root_placement(answer.state), values, time - LONGEST)
        late = self.options.time_limit is not None  # the model has gone on since the frame that was searched
        self._fitting.look(frame, start)
        fit = self._fitting.fitted(start, None, np.inf, wide=late)  # what was usual must not bias it
        if fit.agreement == 0.0 or fit.support == 0.0:
            return None
        if self._usual is not None:
            sure = answer.confidence >= SURE
            quality = min(self._usual.quality(fit), fit.coverage / self._usual.coverage)
            if not (sure and self._recovery.in_vain) and quality < (LOST if sure else FOUND):
                return None
        self._motion = start
        self._usual = Usual.of(fit, answer.confidence)
        self._trials.clear()
        return fit

    def _take(self, fit: FrameFit, before: BelievedMotion, searched: bool) -> None:
        """Go on from a fit."""
        assert self._motion is not None and self._usual is not None
        time = self._motion.time
        if searched or time == before.time or self.lost:
            self._motion = replace(
                BelievedMotion.at_rest(time, fit.T_scan_base, fit.values, time), covariance=fit.covariance
            )
        else:
            untold = self._joints.untold(fit, self._motion)
            self._motion = self._motion.corrected(
                fit.T_scan_base, fit.values, fit.covariance, untold, self._joints.turns, before
            )
        if self._usual.quality(fit) >= DOUBTFUL:
            self._usual = self._usual.renewed(fit)
        self._missed = 0
        self._recovery.found()

    def _report(self, fit: FrameFit, time: float, found: bool, searched: bool, start: float) -> TrackedFrame:
        assert self._motion is not None
        quality = 0.0 if self._usual is None else self._usual.quality(fit) * self._usual.confidence
        covariance = self._covariance(fit) if self.options.covariance and found else None
        doubt = self._joints.most_doubt if self._usual is None else self._motion.deviations[6:]
        doubt = np.hypot(doubt, self._trials.apart)
        if found:
            systematic = SYSTEMATIC / np.maximum(fit.levers, 1e-9)
            doubt = np.where(self._motion.held, doubt, np.hypot(doubt, systematic))
        doubt = np.where(self._joints.free, np.minimum(doubt, self._joints.most_doubt), 0.0)
        return TrackedFrame(
            time=time,
            state=self._state(self._motion.T_scan_base, self._motion.values),
            confidence=quality if found else 0.0,
            lost=self.lost,
            searched=searched,
            scan_coverage=fit.coverage,
            model_support=fit.support,
            inlier_rmse=fit.rmse * self.model.diagonal,
            points=fit.points,
            iterations=fit.iterations,
            seconds=clock.perf_counter() - start,
            std=dict(zip(self.model.joint_names, (doubt * self._joints.unit).tolist(), strict=True)),
            undetermined=tuple(np.array(self.model.joint_names, object)[doubt > self._joints.much_doubt].tolist()),
            covariance=covariance,
        )

    def _covariance(self, fit: FrameFit) -> Array:
        scale = np.r_[np.ones(3), np.full(3, self.model.diagonal), self._joints.unit]
        on_trial = np.diag(np.r_[np.zeros(6), self._trials.apart**2])
        return np.asarray((fit.covariance + on_trial) * np.outer(scale, scale))

    def _state(self, T: Array, values: Array) -> State:
        joints = self.model.within_limits(values * self._joints.unit)
        return State(T, dict(zip(self.model.joint_names, joints.tolist(), strict=True)), self.model.root_link)


def _check_start(model: ArticulatedModel, initial: State) -> None:
    """Raise `ArgumentError` for what is no state, `UnknownNameError` for one that is not of the model."""
    if not isinstance(initial, State):
        raise ArgumentError("initial", "a State to start from", type(initial).__name__)
    model.root_placement(initial)
    model.values(initial.joints)
