"""Configurations fitted to one frame, around where the model is expected."""

from __future__ import annotations

import time as clock
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pwralign_kin import kernels
from pwralign_kin.exceptions import ScanError
from pwralign_kin.scan import DepthFrame, Scan
from pwralign_kin.se3 import Array
from pwralign_kin.tracking import local_search
from pwralign_kin.tracking.fit import LEAST_NOISE, LEAST_SIGMA, FrameFit, Usual
from pwralign_kin.tracking.motion import LONGEST, BelievedMotion
from pwralign_kin.tracking.options import TrackerOptions

Frame = Scan | DepthFrame | NDArray[Any]
"""A scan, a depth image, or bare points (n, 3) in m of an unknown viewpoint."""

MARGIN_SPEED = 0.4
"""How much farther a frame is looked at for each second since the model was seen, model diagonals / s."""

WIDE_SIGMA, WIDE_ITERATIONS, WIDER = 0.06, 4, 3.0
"""Robust scale at the start of a fit from far away, model diagonals, how many times more iterations it may take, and
how many times less sure its start is."""

LEAST_POINTS = 20
"""Fewer points around the model do not show it."""

FEW_POINTS, LITTLE_SURFACE = 8, 0.002
"""Fewer points close to a part, or less visible surface (share of the model's), tell nothing about it."""


class FrameFitting:
    """Fits one frame after another with the kernels, which work in model diagonals about a centre near the model."""

    def __init__(self, native: kernels.Tracking, diagonal: float, options: TrackerOptions) -> None:
        """Take the model's `diagonal` (m)."""
        self.native = native
        self.diagonal = diagonal
        self.options = options
        self.centre, self.viewed = np.zeros(3), False

    def look(self, frame: Frame, expected: BelievedMotion) -> None:
        """Look at a frame around an expected configuration."""
        native = self.native
        self.centre = expected.T_scan_base[:3, 3].copy()
        margin = self.options.margin + MARGIN_SPEED * min(expected.ahead, LONGEST)
        origin = _sensor(frame)
        self.viewed = len(origin) > 0
        native.expect(
            self.inward(expected.T_scan_base)[None], expected.values, self.centre, self.diagonal, origin, margin
        )
        if isinstance(frame, DepthFrame):
            native.look_at_depth(frame.depth, frame.intrinsics, frame.metres, frame.T_scan_camera[None])
        else:
            native.look_at_points(frame.points if isinstance(frame, Scan) else frame)

    def swept(self, T_scan_base: Array, values: Array, ranges: Array, rounds: int) -> tuple[Array, Array, bool]:
        """Return a configuration about a base (4, 4) (m) and values (k,) that fits better, its base as `fitted` takes
        it, and whether any was found: see `local_search.swept`."""
        return local_search.swept(self.native, self.inward(T_scan_base), values, ranges, rounds)

    def weighed(self, T_scan_base: Array, values: Array, varied: NDArray[np.bool_], tolerance: float) -> Array:
        """Return how much speaks against a base (4, 4) (m) with rows of values (n, k), in points.

        The rows differ in joints that are `varied` (k,) only; points may be off by `tolerance` (model diagonals).
        """
        against = self.native.weigh(self.inward(T_scan_base)[None], values, varied.astype(np.uint8), tolerance)
        return np.asarray(self.native.points * against, float)

    def inward(self, T_scan_base: Array) -> Array:
        """Return a base placement (m) in model diagonals about the centre of the frame."""
        inside = T_scan_base.copy()
        inside[:3, 3] = (T_scan_base[:3, 3] - self.centre) / self.diagonal
        return inside

    def outward(self, inside: Array) -> Array:
        """Return T_scan_base (m) of a base placement in model diagonals about the centre of the frame."""
        T_scan_base = inside.copy()
        T_scan_base[:3, 3] = inside[:3, 3] * self.diagonal + self.centre
        return T_scan_base

    def fitted(
        self,
        expected: BelievedMotion,
        usual: Usual | None,
        limit: float,
        *,
        wide: bool = False,
        start: tuple[Array, Array] | None = None,
        held: NDArray[np.bool_] | None = None,
        doubt: Array | None = None,
    ) -> FrameFit:
        """Fit the frame about an expected configuration, from a `wide` range of it or a narrow one.

        `start` is where to begin instead (base about the centre, in model diagonals, and values), `held` (k,) joints
        that stay there, else those that are not told. `doubt` (k,) are standard deviations by which the values are less
        sure than expected. What is less sure, or wide, is so for the fit to get about: the covariance does without.
        """
        native = self.native
        predicted = self.inward(expected.T_scan_base)
        base, values = (predicted, expected.values) if start is None else start
        sigma, noise, tolerance = 2 * LEAST_SIGMA, LEAST_SIGMA, 0.0
        if usual is not None:
            sigma, noise, tolerance = usual.sigma, max(usual.noise, LEAST_NOISE), usual.tolerance
        if native.points < LEAST_POINTS:
            return self._unfitted(expected, base, values, tolerance)
        first = WIDE_SIGMA if wide else float(np.clip(0.012 + 0.25 * expected.ahead, 2 * sigma, WIDE_SIGMA))
        believed = _believed(expected, doubt, wide=wide)
        found, fitted, done, rmse = native.fit(
            base=base[None],
            values=values,
            predicted=predicted[None],
            predicted_values=expected.values,
            expected=believed,
            held=(expected.held if held is None else held).astype(np.uint8),
            sigma_first=first,
            sigma_last=sigma,
            noise=noise,
            iterations=self.options.iterations * (WIDE_ITERATIONS if wide else 1),
            seconds=limit - clock.perf_counter(),
        )
        covariance, levers = self._told(_semidefinite(native.information - believed), expected)
        judged = native.judge(found[None], fitted, tolerance)
        strays, missing = self._part_misfits()
        return FrameFit(
            T_scan_base=self.outward(found),
            values=fitted,
            iterations=done,
            rmse=rmse,
            noise=judged.noise,
            coverage=judged.coverage,
            # From an unknown viewpoint, what is in front of the model, or behind it, cannot be told.
            agreement=judged.agreement if self.viewed else judged.coverage,
            visible=judged.visible,
            support=judged.supported,
            cost=judged.cost,
            points=native.points,
            strays=strays,
            missing=missing,
            covariance=covariance,
            levers=levers,
        )

    def _unfitted(self, expected: BelievedMotion, base: Array, values: Array, tolerance: float) -> FrameFit:
        """Return the expected configuration where a frame shows too little to fit it to, judged where a fit would have
        begun."""
        judged = self.native.judge(base[None], values, tolerance)
        return FrameFit(
            expected.T_scan_base,
            expected.values,
            visible=judged.visible,
            support=judged.supported,
            points=self.native.points,
        )

    def _told(self, information: Array, expected: BelievedMotion) -> tuple[Array, Array]:
        """Return the covariance (6 + k, 6 + k) after the last fit, and the levers (k,) of its joints, by the
        `information` (6 + k, 6 + k) that the frame adds to what was expected."""
        covariance: Array = np.asarray(np.linalg.inv(information + _believed(expected)), float)
        # What the frame adds for a joint while all else is free, beside what it would add were all else known.
        marginal = np.maximum(1.0 / np.diag(covariance)[6:] - 1.0 / np.diag(expected.covariance)[6:], 0.0)
        conditional = np.diag(information)[6:]
        return covariance, self.native.levers * np.sqrt(marginal / np.maximum(conditional, 1e-12))

    def _part_misfits(self) -> tuple[Array, Array]:
        """Return strays and missing (parts,) of the configuration judged last."""
        native = self.native
        strays, close = native.strays, native.strays + native.explained
        visible = native.visible
        missing = visible - native.shown
        return (
            np.where(close >= FEW_POINTS, strays / np.maximum(close, 1.0), 0.0),
            np.where(visible >= LITTLE_SURFACE, missing / np.maximum(visible, 1e-9), 0.0),
        )


def checked(frame: Frame) -> Frame:
    """Return bare points as the kernels take them. Raises `ScanError` for what is no frame."""
    if isinstance(frame, Scan | DepthFrame):
        return frame
    points = np.asarray(frame)
    if points.ndim != 2 or points.shape[1] != 3 or points.dtype.kind != "f":
        got = f"{points.dtype} of shape {points.shape}"
        raise ScanError("frame", f"expected a Scan, a DepthFrame or floating-point points (n, 3), got {got}")
    return np.ascontiguousarray(points, np.float32 if points.dtype == np.float32 else np.float64)


def _believed(expected: BelievedMotion, doubt: Array | None = None, *, wide: bool = False) -> Array:
    """Return the information (6 + k, 6 + k) that is expected beforehand, less with `doubt` (k,) of the values, and of a
    `wide` range."""
    covariance = expected.covariance
    if doubt is not None:
        covariance = covariance + np.diag(np.r_[np.zeros(6), doubt**2])
    believed: Array = np.asarray(np.linalg.inv(covariance), float)
    return believed / WIDER**2 if wide else believed


def _semidefinite(information: Array) -> Array:
    """Return the nearest information (n, n) that takes nothing away: sums of single precision fall a little short."""
    told, along = np.linalg.eigh((information + information.T) / 2.0)
    return np.asarray((np.maximum(told, 0.0) * along) @ along.T)


def _sensor(frame: Frame) -> Array:
    """Return where the frame was seen from (3,), empty where that is unknown or not one place."""
    if isinstance(frame, DepthFrame):
        return np.ascontiguousarray(frame.T_scan_camera[:3, 3])
    if isinstance(frame, Scan) and frame.sensor_origin is not None and frame.sensor_origin.ndim == 1:
        return np.ascontiguousarray(frame.sensor_origin)
    return np.zeros(0)
