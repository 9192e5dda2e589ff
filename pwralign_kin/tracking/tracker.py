"""An estimate per frame: follow the model while it is seen, search for it when it is lost."""

from __future__ import annotations

import logging
import time as clock
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pwralign_kin import kernels
from pwralign_kin.estimation import Estimate, estimate
from pwralign_kin.exceptions import PwralignError, ScanError, UnknownNameError
from pwralign_kin.model import ArticulatedModel
from pwralign_kin.scan import DepthFrame, Scan
from pwralign_kin.se3 import Array
from pwralign_kin.state import State
from pwralign_kin.tracking.motion import LONGEST, Motion
from pwralign_kin.tracking.options import TrackerOptions

logger = logging.getLogger(__name__)

Frame = Scan | DepthFrame | NDArray[Any]
"""A scan, a depth image, or bare points (n, 3) in m of an unknown viewpoint."""

LEAST_SIGMA, MOST_SIGMA = 0.004, 0.015
"""Bounds of the robust scale at the end of a fit, which follows the noise, model diagonals."""

WIDE_SIGMA, WIDE_ITERATIONS, WIDER = 0.06, 4, 3.0
"""Robust scale at the start of a fit from far away, model diagonals, how many times more iterations it may take, and
how many times less sure its start is."""

DOUBTFUL, LOST, FOUND = 0.85, 0.6, 0.75
"""Shares of the usual quality: below the first a frame is fitted again from farther starts; below the second the model
is not seen; a lost model is found above the third."""

CLEAR = 0.9
"""Shares of the points and of the visible surface that are explained when a given start is taken without a search."""

PATIENCE = 3
"""Frames in a row without the model after which it is lost."""

LEAST_VISIBLE = 0.15
"""Share of the surface facing the sensor below which something hides the model."""

LEAST_POINTS = 20
"""Fewer points around the model do not show it."""

CONVINCING, SURE = 0.5, 0.9
"""Confidence of an estimate that ends a search where the model then fits like one that is found, or, with the second,
not like a lost one; after many searches in vain the second is enough."""

MOST_WAIT = 32
"""Frames between two searches for a lost model, at most; the wait doubles from search to search."""

FORGETTING = 0.02
"""Share of what is usual that each frame renews."""


@dataclass(frozen=True)
class TrackedFrame:
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
    """Whether `state` comes from a search, not from following."""
    scan_coverage: float
    """Share of the points around the model that it explains."""
    model_support: float
    """Share of the surface facing the sensor, and not hidden, that the frame shows."""
    inlier_rmse: float
    """Of the distances of the explained points, m."""
    points: int
    """Points used."""
    iterations: int
    """Gauss-Newton iterations."""
    seconds: float
    """Time that the frame took."""
    covariance: Array | None
    """(6 + k, 6 + k) covariance of the base (rotation vector about its origin in scan axes, rad; translation, m) and of
    the joints (rad or m); None unless asked for, and where the model is not seen."""

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
            "points": self.points,
            "iterations": self.iterations,
            "seconds": self.seconds,
        }


@dataclass(frozen=True)
class _Fit:
    """A configuration fitted to a frame, and how well it fits."""

    T: Array
    values: Array
    iterations: int = 0
    coverage: float = 0.0
    agreement: float = 0.0
    """Share of the points that count for or against the model that it explains."""
    rmse: float = 0.0
    visible: float = 0.0
    """Share of the facing surface that nothing hides."""
    support: float = 0.0
    """Share of the visible surface that the frame shows."""
    points: int = 0
    """Points used."""
    told: Array | None = None
    """(6 + k,) share of each variable that the frame tells, not the prediction."""
    information: Array | None = None
    """(6 + k, 6 + k) inverse covariance, rad and model diagonals."""


@dataclass(frozen=True)
class _Usual:
    """How the model fits when it is found."""

    coverage: float
    agreement: float
    support: float
    sigma: float
    """Robust scale at the end of a fit."""
    confidence: float
    """Of the estimate that found it."""

    def quality(self, fit: _Fit) -> float:
        """Return how well a fit does beside the usual, from 0 to 1."""
        return float(np.clip(min(fit.agreement / self.agreement, fit.support / self.support), 0.0, 1.0))

    def renewed(self, fit: _Fit) -> _Usual:
        """Return the usual after another good fit."""
        return replace(
            self,
            coverage=self.coverage + FORGETTING * (fit.coverage - self.coverage),
            agreement=self.agreement + FORGETTING * (fit.agreement - self.agreement),
            support=self.support + FORGETTING * (fit.support - self.support),
            sigma=self.sigma + FORGETTING * (_sigma(fit) - self.sigma),
        )


class Tracker:
    """Follows one model from frame to frame.

    The first frame is searched for the model unless `initial` tells about where it is. A model that is not seen goes
    on a little and then holds still; after `PATIENCE` frames it counts as lost and is searched for, from where it was
    and then everywhere. The same frames give the same states, bit for bit, unless there is a time limit.
    """

    def __init__(
        self, model: ArticulatedModel, options: TrackerOptions | None = None, initial: State | None = None
    ) -> None:
        """Prepare for the first frame. Raises `UnknownNameError` for joints or links that the model lacks."""
        self.model = model
        self.options = options or TrackerOptions()
        for name in self.options.estimator.locked:
            if name not in model.joint_names:
                raise UnknownNameError("joint", name, model.joint_names)
        self._unit = np.array([model.diagonal if model.units[name] == "m" else 1.0 for name in model.joint_names])
        self._turns = np.where(model.continuous, model.upper - model.lower, np.inf)
        self._initial = initial
        if initial is not None:
            model.root_placement(initial), model.values(initial.joints)
        self._native = self._kernel()
        self._motion: Motion | None = None
        self._usual: _Usual | None = None
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
        if not np.isfinite(time) or (self._motion is not None and time <= self._motion.time):
            raise ScanError("track", f"a frame at {time} s is not later than the one before")
        frame = _checked(frame)
        if self._motion is None:
            before, fit = self._first(frame, time)
        else:
            before = self._motion
            self._motion = before.predicted(time)
            fit = self._followed(frame, self._motion, before, start)
        found = self._accepts(fit)
        searched = False
        if not found:
            self._missed += 1
            answer = self._searched(frame, time, fit)
            if answer is not None:
                fit, found, searched = answer, True, True
        if found:
            self._take(fit, before, searched)
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

    def _first(self, frame: Frame, time: float) -> tuple[Motion, _Fit]:
        """Return a model at rest where the initial state has it, or anywhere, and its fit."""
        if self._initial is None:
            self._motion = Motion.at_rest(time, np.eye(4), self.model.values({}) / self._unit, time)
            return self._motion, _Fit(self._motion.T, self._motion.values)
        T = self.model.root_placement(self._initial)
        motion = Motion.at_rest(time, T, self.model.values(self._initial.joints) / self._unit, time - LONGEST)
        self._motion = motion
        fit = self._fitted(frame, motion, 2 * LEAST_SIGMA, np.inf, wide=True)
        if min(fit.coverage, fit.support) >= CLEAR:
            self._usual = _Usual(fit.coverage, fit.agreement, fit.support, _sigma(fit), 1.0)
        return motion, fit

    def _followed(self, frame: Frame, expected: Motion, before: Motion, start: float) -> _Fit:
        """Fit the frame from where the model is expected; again from farther starts where that is doubtful."""
        limit = np.inf if self.options.time_limit is None else start + self.options.time_limit
        if self._usual is None:
            return _Fit(expected.T, expected.values)
        fit = self._fitted(frame, expected, self._usual.sigma, limit)
        if self._usual.quality(fit) >= DOUBTFUL or fit.visible == 0.0:
            return fit
        for start_from in (expected, replace(before, time=expected.time)):
            if clock.perf_counter() >= limit:
                break
            other = self._fitted(frame, start_from, self._usual.sigma, limit, wide=True)
            if self._usual.quality(other) > self._usual.quality(fit):
                fit = other
        return fit

    def _fitted(self, frame: Frame, expected: Motion, sigma: float, limit: float, wide: bool = False) -> _Fit:
        """Fit the frame about an expected configuration, from a `wide` range of it or a narrow one."""
        native, model = self._native, self.model
        centre = expected.T[:3, 3].copy()
        base = expected.T.copy()
        base[:3, 3] = 0.0
        origin = _sensor(frame)
        native.expect(base[None], expected.values, centre, model.diagonal, origin, self.options.margin)
        if isinstance(frame, DepthFrame):
            native.look_at_depth(frame.depth, frame.intrinsics, frame.scale, frame.T_scan_camera[None])
        else:
            native.look_at_points(frame.points if isinstance(frame, Scan) else frame)
        ahead = expected.time - expected.seen
        first = WIDE_SIGMA if wide else float(np.clip(0.012 + 0.25 * ahead, 2 * sigma, WIDE_SIGMA))
        iterations = self.options.iterations * (WIDE_ITERATIONS if wide else 1)
        sureness = expected.inverse_deviations() / (WIDER if wide else 1.0)
        if native.points < LEAST_POINTS:
            visible, support = native.support(base[None], expected.values)
            return _Fit(expected.T, expected.values, visible=visible, support=support, points=native.points)
        seconds = limit - clock.perf_counter()
        T, values, done, coverage, agreement, rmse = native.fit(
            base[None], expected.values, base[None], expected.values, sureness, first, sigma, iterations, seconds
        )
        visible, support = native.support(T[None], values)
        if not len(origin):  # what is in front of the model, or behind it, cannot be told
            agreement = coverage
        T[:3, 3] = T[:3, 3] * model.diagonal + centre
        return _Fit(
            T, values, done, coverage, agreement, rmse, visible, support, native.points, native.told, native.information
        )

    def _accepts(self, fit: _Fit) -> bool:
        """Return whether a fit shows the model; once it is lost that takes more."""
        if self._usual is None or fit.iterations == 0 or fit.visible < LEAST_VISIBLE:
            return False
        return self._usual.quality(fit) >= (FOUND if self.lost else LOST)

    def _searched(self, frame: Frame, time: float, fit: _Fit) -> _Fit | None:
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

    def _search_result(self, frame: Frame, time: float) -> _Fit | None:
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
            return estimate(self.model, scan, initial=guess, options=self.options.estimator)
        except PwralignError as error:
            logger.debug("search: %s", error)
            return None

    def _adopted(self, answer: Estimate | None, frame: Frame, time: float) -> _Fit | None:
        """Take over a convincing estimate as the start of a new track."""
        if answer is None or answer.confidence < CONVINCING:
            return None
        values = self.model.values(answer.state.joints) / self._unit
        start = Motion.at_rest(time, self.model.root_placement(answer.state), values, time - LONGEST)
        late = self.options.time_limit is not None  # the model has gone on since the frame that was searched
        fit = self._fitted(frame, start, 2 * LEAST_SIGMA, np.inf, wide=late)
        if fit.agreement == 0.0 or fit.support == 0.0:
            return None
        if self._usual is not None:
            sure = answer.confidence >= SURE
            in_vain = self._wait == MOST_WAIT
            quality = min(self._usual.quality(fit), fit.coverage / self._usual.coverage)
            if not (sure and in_vain) and quality < (LOST if sure else FOUND):
                return None
        self._motion = start
        self._usual = _Usual(fit.coverage, fit.agreement, fit.support, _sigma(fit), answer.confidence)
        return fit

    def _take(self, fit: _Fit, before: Motion, searched: bool) -> None:
        """Go on from a fit."""
        assert self._motion is not None and self._usual is not None
        time = self._motion.time
        if searched or time == before.time or self.lost:
            self._motion = Motion.at_rest(time, fit.T, fit.values, time)
        else:
            assert fit.told is not None
            self._motion = self._motion.corrected(fit.T, fit.values, fit.told, self._turns / self._unit, before)
        if self._usual.quality(fit) >= DOUBTFUL:
            self._usual = self._usual.renewed(fit)
        self._missed, self._wait, self._waited, self._searches = 0, 1, 0, 0

    def _report(self, fit: _Fit, time: float, found: bool, searched: bool, start: float) -> TrackedFrame:
        assert self._motion is not None
        quality = 0.0 if self._usual is None else self._usual.quality(fit) * self._usual.confidence
        covariance = self._covariance(fit) if self.options.covariance and found else None
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
            covariance=covariance,
        )

    def _covariance(self, fit: _Fit) -> Array:
        assert fit.information is not None
        scale = np.r_[np.ones(3), np.full(3, self.model.diagonal), self._unit]
        return np.asarray(np.linalg.inv(fit.information) * np.outer(scale, scale))

    def _state(self, T: Array, values: Array) -> State:
        model = self.model
        given = values * self._unit
        span = np.where(model.continuous, model.upper - model.lower, 1.0)
        turned = model.lower + np.mod(given - model.lower, span)
        joints = np.where(model.continuous, turned, np.clip(given, model.lower, model.upper))
        return State(T, dict(zip(model.joint_names, joints.tolist(), strict=True)), model.root_link)


def _checked(frame: Frame) -> Frame:
    """Return bare points as the kernels take them. Raises `ScanError` for what is no frame."""
    if isinstance(frame, Scan | DepthFrame):
        return frame
    points = np.asarray(frame)
    if points.ndim != 2 or points.shape[1] != 3 or points.dtype.kind != "f":
        raise ScanError("frame", f"expected a Scan, a DepthFrame or points (n, 3), got shape {points.shape}")
    return np.ascontiguousarray(points, np.float32 if points.dtype == np.float32 else np.float64)


def _sensor(frame: Frame) -> Array:
    """Return where the frame was seen from (3,), empty where that is unknown or not one place."""
    if isinstance(frame, DepthFrame):
        return np.ascontiguousarray(frame.T_scan_camera[:3, 3])
    if isinstance(frame, Scan) and frame.sensor_origin is not None and frame.sensor_origin.ndim == 1:
        return np.ascontiguousarray(frame.sensor_origin)
    return np.zeros(0)


def _sigma(fit: _Fit) -> float:
    return float(np.clip(2.0 * fit.rmse, LEAST_SIGMA, MOST_SIGMA))
