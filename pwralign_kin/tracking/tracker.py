"""An estimate per frame: follow the model while it is seen, search for it when it is lost."""

from __future__ import annotations

import logging
import time as clock
from collections.abc import Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pwralign_kin import kernels
from pwralign_kin.estimation import Estimate, estimate
from pwralign_kin.exceptions import PwralignError, ScanError, UnknownNameError
from pwralign_kin.model import ArticulatedModel
from pwralign_kin.scan import DepthFrame, Scan
from pwralign_kin.se3 import Array, rotation_angle
from pwralign_kin.state import State
from pwralign_kin.tracking import local_search
from pwralign_kin.tracking.motion import LONGEST, Motion
from pwralign_kin.tracking.options import TrackerOptions

logger = logging.getLogger(__name__)

Frame = Scan | DepthFrame | NDArray[Any]
"""A scan, a depth image, or bare points (n, 3) in m of an unknown viewpoint."""

LEAST_SIGMA, MOST_SIGMA = 0.004, 0.015
"""Bounds of the robust scale at the end of a fit, which follows the noise, model diagonals."""

MARGIN_SPEED = 0.4
"""How much farther a frame is looked at for each second since the model was seen, model diagonals / s."""

WIDE_SIGMA, WIDE_ITERATIONS, WIDER = 0.06, 4, 3.0
"""Robust scale at the start of a fit from far away, model diagonals, how many times more iterations it may take, and
how many times less sure its start is."""

DOUBTFUL, LOST, FOUND = 0.85, 0.6, 0.75
"""Shares of the usual quality: below the first a frame is fitted again from farther starts; below the second the model
is not seen; a lost model is found above the third."""

CLEAR, STAYED = 0.9, 0.05
"""Shares of the points and of the visible surface that are explained when a given start is taken without a search; of
the points close to the model only, if no variable that the frame determines moved by more than the second (rad or model
diagonals)."""

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

SUSPECT = 0.25
"""A part is suspected when so much more of its points or of its visible surface than usual does not fit."""

UNEXPLAINED = 0.05
"""So is the model as a whole when so much more of the points than usual is unexplained."""

FEW_POINTS, LITTLE_SURFACE = 8, 0.002
"""Fewer points close to a part, or less visible surface (share of the model's), tell nothing about it."""

UNDETERMINED = float(np.radians(2.5))
"""A joint whose standard deviation is larger (rad; of slides this share of a diagonal) is undetermined."""

TOLD, VAGUE = 0.75, float(np.radians(8.0))
"""A frame tells a joint when it takes away this share of its variance and leaves a smaller deviation than the second;
others keep their value."""

SYSTEMATIC = 0.0009
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

MOST_DOUBT = 16
"""Frames between two searches about a suspected configuration that found nothing, at most; the wait doubles."""

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
    std: Mapping[str, float]
    """Standard deviation of each joint, rad or m; it grows while a joint is undetermined."""
    undetermined: tuple[str, ...]
    """Joints that the frame does not tell: they keep the value that was told last."""
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
            "std": dict(self.std),
            "undetermined": list(self.undetermined),
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
    rmse: float = 0.0
    noise: float = 0.0
    """Robust standard deviation of the distances of points close to the model."""
    coverage: float = 0.0
    agreement: float = 0.0
    """Share of the points that count for or against the model that it explains."""
    visible: float = 0.0
    """Share of the facing surface that nothing hides."""
    support: float = 0.0
    """Share of the visible surface that the frame shows."""
    points: int = 0
    """Points used."""
    strays: Array = field(default_factory=lambda: np.zeros(0))
    """(parts,) share of the points close to each part that it does not explain; 0 where they are few."""
    missing: Array = field(default_factory=lambda: np.zeros(0))
    """(parts,) share of the visible surface of each part that the frame does not show; 0 where it is little."""
    covariance: Array = field(default_factory=lambda: np.zeros((0, 0)))
    """(6 + k, 6 + k) covariance, rad and model diagonals."""
    levers: Array = field(default_factory=lambda: np.zeros(0))
    """(k,) how far each joint moves the surface that is seen along its normals (rms), when all else makes up for it as
    well as it can, model diagonals for each unit."""


@dataclass(frozen=True)
class _Usual:
    """How the model fits when it is found."""

    coverage: float
    agreement: float
    support: float
    noise: float
    """Of the distances of points close to the model, model diagonals."""
    sigma: float
    """Robust scale at the end of a fit."""
    strays: Array
    missing: Array
    confidence: float
    """Of the estimate that found it."""

    @classmethod
    def of(cls, fit: _Fit, confidence: float) -> _Usual:
        """Return what a first fit makes usual."""
        return cls(
            fit.coverage, fit.agreement, fit.support, fit.noise, _sigma(fit), fit.strays, fit.missing, confidence
        )

    @property
    def alone(self) -> bool:
        """Whether there is little but the model: else what it does not explain does not speak against it."""
        return self.coverage >= CLEAR

    def misfit(self, fit: _Fit | _Usual) -> float:
        """Return how much speaks against a fit."""
        return 2.0 - fit.agreement - fit.support + (1.0 - fit.coverage if self.alone else 0.0)

    @property
    def tolerance(self) -> float:
        """Distance within which the noise allows points of the model, model diagonals."""
        return kernels.explained_within(self.noise)

    def quality(self, fit: _Fit) -> float:
        """Return how well a fit does beside the usual, from 0 to 1."""
        return float(np.clip(min(fit.agreement / self.agreement, fit.support / self.support), 0.0, 1.0))

    def suspects(self, fit: _Fit) -> NDArray[np.bool_]:
        """Return the parts (parts,) that fit clearly worse than usual."""
        return np.asarray((fit.strays > self.strays + SUSPECT) | (fit.missing > self.missing + SUSPECT))

    def renewed(self, fit: _Fit) -> _Usual:
        """Return the usual after another good fit."""

        def mixed(old: Any, new: Any) -> Any:
            return old + FORGETTING * (new - old)

        return replace(
            self,
            coverage=mixed(self.coverage, fit.coverage),
            agreement=mixed(self.agreement, fit.agreement),
            support=mixed(self.support, fit.support),
            noise=mixed(self.noise, fit.noise),
            sigma=mixed(self.sigma, _sigma(fit)),
            strays=mixed(self.strays, fit.strays),
            missing=mixed(self.missing, fit.missing),
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
        self._free = ~np.isin(model.joint_names, self.options.estimator.locked)
        self._most_doubt = (model.upper - model.lower) / self._unit / np.sqrt(12.0)
        self._native = self._kernel()
        self._centre, self._viewed = np.zeros(3), False
        self._doubt, self._doubted, self._vain = 1, 0, 0
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
        self._look(frame, motion)
        fit = self._fitted(motion, np.inf, wide=True)
        clear = fit.coverage >= CLEAR or (fit.agreement >= CLEAR and self._stayed(fit, motion))
        if clear and fit.support >= CLEAR:
            self._usual = _Usual.of(fit, 1.0)
        return motion, fit

    def _stayed(self, fit: _Fit, motion: Motion) -> bool:
        """Return whether a fit is about where it started."""
        turn = rotation_angle(fit.T[:3, :3] @ motion.T[:3, :3].T)
        shift = float(np.linalg.norm((fit.T - motion.T)[:3, 3])) / self.model.diagonal
        told = np.diag(fit.covariance)[6:] < UNDETERMINED**2
        joints = np.abs(fit.values - motion.values)[told].max(initial=0.0)
        return bool(max(turn, shift, joints) < STAYED)

    def _followed(self, frame: Frame, expected: Motion, before: Motion, start: float) -> _Fit:
        """Fit the frame from where the model is expected; where that is doubtful, from farther starts and searched."""
        limit = np.inf if self.options.time_limit is None else start + self.options.time_limit
        usual = self._usual
        if usual is None:
            return _Fit(expected.T, expected.values)
        self._look(frame, expected)
        fit = self._fitted(expected, limit)
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
                other = self._fitted(start_from, limit, wide=True)
                if usual.misfit(other) < usual.misfit(fit):
                    fit = other
        return self._searched_about(fit, expected, limit)

    def _searched_about(self, fit: _Fit, expected: Motion, limit: float) -> _Fit:
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

    def _freed(self, fit: _Fit, expected: Motion, freed: NDArray[np.bool_], limit: float) -> _Fit:
        """Return the fit once joints that were held, and that the frame tells, are looked for and fitted too."""
        far = expected.deviations > NEAR
        ranges = np.where(np.r_[np.zeros(6, bool), freed] & far, SWEPT_DEVIATIONS * expected.deviations, 0.0)
        T, values, _ = self._sweep(fit.T, fit.values, ranges, 1)
        other = self._fitted(expected, limit, start=(T, values), held=expected.held & ~freed)
        assert self._usual is not None
        return other if self._usual.misfit(other) <= self._usual.misfit(fit) + LEAST_GAIN else fit

    def _swept(self, fit: _Fit, expected: Motion, ranges: Array, limit: float) -> _Fit:
        """Search about a fit and where the model was expected; return what fits clearly better, else the fit."""
        usual = self._usual
        assert usual is not None
        best, against = fit, usual.misfit(fit)
        least = against - max(LEAST_GAIN, BETTER * (against - usual.misfit(usual)))
        for T, values in ((fit.T, fit.values), (expected.T, expected.values)):
            if clock.perf_counter() >= limit:
                break
            T, values, gained = self._sweep(T, values, ranges, SWEEP_ROUNDS)
            if not gained:
                continue
            held = expected.held & (ranges[6:] == 0.0)
            other = self._fitted(expected, limit, wide=True, start=(T, values), held=held)
            if usual.misfit(other) < least:
                best, least = other, usual.misfit(other)
        return best

    def _sweep(self, T: Array, values: Array, ranges: Array, rounds: int) -> tuple[Array, Array, bool]:
        return local_search.swept(self._native, self._inward(T), values, ranges, rounds)

    def _look(self, frame: Frame, expected: Motion) -> None:
        """Look at a frame around an expected configuration."""
        native, model = self._native, self.model
        self._centre = expected.T[:3, 3].copy()
        margin = self.options.margin + MARGIN_SPEED * min(expected.ahead, LONGEST)
        origin = _sensor(frame)
        self._viewed = len(origin) > 0
        native.expect(self._inward(expected.T)[None], expected.values, self._centre, model.diagonal, origin, margin)
        if isinstance(frame, DepthFrame):
            native.look_at_depth(frame.depth, frame.intrinsics, frame.scale, frame.T_scan_camera[None])
        else:
            native.look_at_points(frame.points if isinstance(frame, Scan) else frame)

    def _inward(self, T: Array) -> Array:
        """Return a base placement in model diagonals about the centre of the frame."""
        inside = T.copy()
        inside[:3, 3] = (T[:3, 3] - self._centre) / self.model.diagonal
        return inside

    def _fitted(
        self,
        expected: Motion,
        limit: float,
        *,
        wide: bool = False,
        start: tuple[Array, Array] | None = None,
        held: NDArray[np.bool_] | None = None,
    ) -> _Fit:
        """Fit the frame about an expected configuration, from a `wide` range of it or a narrow one.

        `start` is where to begin instead (base about the centre, in model diagonals, and values), `held` (k,) joints
        that stay there, else those that are not told.
        """
        native = self._native
        predicted = self._inward(expected.T)
        base, values = (predicted, expected.values) if start is None else start
        usual = self._usual
        sigma, tolerance = (2 * LEAST_SIGMA, 0.0) if usual is None else (usual.sigma, usual.tolerance)
        if native.points < LEAST_POINTS:
            judged = native.judge(base[None], values, tolerance)
            return _Fit(expected.T, expected.values, visible=judged[4], support=judged[5], points=native.points)
        if wide:
            expected = expected.loosened(WIDER)
        first = WIDE_SIGMA if wide else float(np.clip(0.012 + 0.25 * expected.ahead, 2 * sigma, WIDE_SIGMA))
        iterations = self.options.iterations * (WIDE_ITERATIONS if wide else 1)
        still = expected.held if held is None else held
        believed: Array = np.asarray(np.linalg.inv(expected.covariance), float)
        T, fitted, done, rmse = native.fit(
            base[None],
            values,
            predicted[None],
            expected.values,
            believed,
            still.astype(np.uint8),
            first,
            sigma,
            iterations,
            limit - clock.perf_counter(),
        )
        information, doubt = native.information, np.diag(expected.covariance)[6:]
        covariance: Array = np.asarray(np.linalg.inv(information), float)
        # What the frame adds for a joint while all else is free, beside what it would add were all else known.
        marginal = np.maximum(1.0 / np.diag(covariance)[6:] - 1.0 / doubt, 0.0)
        conditional = np.diag(information)[6:] - np.diag(believed)[6:]
        levers = native.levers * np.sqrt(marginal / np.maximum(conditional, 1e-12))
        noise, tolerance, coverage, agreement, visible, support = native.judge(T[None], fitted, tolerance)
        strays, missing = self._part_misfits()
        if not self._viewed:  # what is in front of the model, or behind it, cannot be told
            agreement = coverage
        T[:3, 3] = T[:3, 3] * self.model.diagonal + self._centre
        return _Fit(
            T=T,
            values=fitted,
            iterations=done,
            rmse=rmse,
            noise=noise,
            coverage=coverage,
            agreement=agreement,
            visible=visible,
            support=support,
            points=native.points,
            strays=strays,
            missing=missing,
            covariance=covariance,
            levers=levers,
        )

    def _part_misfits(self) -> tuple[Array, Array]:
        """Return strays and missing (parts,) of the configuration judged last."""
        native = self._native
        strays, close = native.strays, native.strays + native.explained
        visible = native.visible
        missing = visible - native.shown
        return (
            np.where(close >= FEW_POINTS, strays / np.maximum(close, 1.0), 0.0),
            np.where(visible >= LITTLE_SURFACE, missing / np.maximum(visible, 1e-9), 0.0),
        )

    def _untold(self, fit: _Fit, expected: Motion) -> NDArray[np.bool_]:
        """Return the joints (k,) that a frame does not tell; those that are locked need not be told."""
        if not fit.iterations:
            return self._free
        variance = np.diag(fit.covariance)[6:]
        told = (variance < (1.0 - TOLD) * np.diag(expected.covariance)[6:]) | (variance < UNDETERMINED**2)
        return np.asarray(self._free & ~(told & (variance < VAGUE**2)))

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
        self._look(frame, start)
        usual, self._usual = self._usual, None  # what was usual must not bias how the answer is fitted
        fit = self._fitted(start, np.inf, wide=late)
        self._usual = usual
        if fit.agreement == 0.0 or fit.support == 0.0:
            return None
        if self._usual is not None:
            sure = answer.confidence >= SURE
            in_vain = self._wait == MOST_WAIT
            quality = min(self._usual.quality(fit), fit.coverage / self._usual.coverage)
            if not (sure and in_vain) and quality < (LOST if sure else FOUND):
                return None
        self._motion = start
        self._usual = _Usual.of(fit, answer.confidence)
        return fit

    def _take(self, fit: _Fit, before: Motion, searched: bool) -> None:
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

    def _report(self, fit: _Fit, time: float, found: bool, searched: bool, start: float) -> TrackedFrame:
        assert self._motion is not None
        quality = 0.0 if self._usual is None else self._usual.quality(fit) * self._usual.confidence
        covariance = self._covariance(fit) if self.options.covariance and found else None
        doubt = self._motion.deviations[6:]
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
            undetermined=tuple(np.array(self.model.joint_names, object)[doubt > UNDETERMINED].tolist()),
            covariance=covariance,
        )

    def _covariance(self, fit: _Fit) -> Array:
        scale = np.r_[np.ones(3), np.full(3, self.model.diagonal), self._unit]
        return np.asarray(fit.covariance * np.outer(scale, scale))

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
