"""The scan: clean points, and where they were seen from."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Mapping
from functools import cached_property
from numbers import Real
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pwralign_kin import kernels
from pwralign_kin.exceptions import EmptyScanError, ScanError
from pwralign_kin.lengths import METRES, Unit
from pwralign_kin.read_only import ReadOnly, read_only
from pwralign_kin.scan import readers
from pwralign_kin.scan.pinhole import DepthCamera, checked_depth, checked_intrinsics
from pwralign_kin.se3 import Array, as_floats, checked_placement, transform

logger = logging.getLogger(__name__)

MIN_POINTS = 10
"""Fewer distinct points than this cannot fix a rigid part, let alone joints."""

LARGEST = float(np.finfo(np.float32).max)
"""Coordinates beyond single precision count as not finite: their squares overflow, and no sensor means
them."""


ROUNDED_SAMPLE, LEAST_VALUES, OFF_STEP = 2000, 20, 0.01
"""The step of rounded coordinates is told from so many points; an axis tells it with at least so many values whose
distances are multiples of the least, up to this share of it."""


class Scan(ReadOnly):
    """Points of a scan in one frame, in m: finite, distinct, never changed.

    Attributes:
        points: (n, 3) float64, in the order given; read-only, for libraries that demand more `np.array(points)`.
        normals: (n, 3) unit normals as the source gave them, or None.
        sensor_origin: None (unknown), (3,) for one viewpoint, or (n, 3) aligned with `points` for fused
            scans; m.
        camera: the depth camera of a scan made by `from_depth`, else None.
        rescaled: whether its lengths were multiplied since: whoever did that knew their unit.
        source: the file, or a word for the array; error messages begin with it.
        n_input: number of points given.
        source_index: (n,) index of each kept point among the points given.
        dropped: how many points were dropped and why: "non_finite", "duplicate" and, after `cropped`,
            "cropped".
    """

    points: Array
    normals: Array | None
    sensor_origin: Array | None
    camera: DepthCamera | None
    rescaled: bool
    source: str
    n_input: int
    source_index: NDArray[np.int64]
    dropped: Mapping[str, int]

    def __init__(
        self,
        points: ArrayLike,
        *,
        sensor_origin: ArrayLike | None = None,
        normals: ArrayLike | None = None,
        source: Path | str = "array",
    ) -> None:
        """Clean `points` (n, 3), m; non-finite points and exact duplicates are dropped, counted and logged.

        `sensor_origin` (3,) or (n, 3), m, and `normals` (n, 3) belong to the points as given. Normals that
        are not all finite and non-zero are discarded as a whole.

        Raises `ScanError` for a wrong shape, non-numeric content, a non-finite sensor origin, no finite point
        at all, or fewer than ten distinct points.
        """
        self._set(source=str(source))
        given = self._numbers(points, "points")
        if given.ndim != 2 or given.shape[1] != 3:
            columns = given.ndim == 2 and len(given) == 3
            hint = ": its points are in columns, transpose it" if columns else ""
            raise ScanError(self.source, f"points must have the shape (n, 3), got {given.shape}{hint}")
        if len(given) == 0:
            raise EmptyScanError(self.source, "the scan has no points")
        finite = (np.abs(given) <= LARGEST).all(axis=1)
        if not finite.any():
            raise EmptyScanError(self.source, f"none of the {len(given)} points is finite")
        kept = np.flatnonzero(finite)
        kept = kept[kernels.first_occurrences(given[kept])]

        self._set(
            n_input=len(given),
            dropped={"non_finite": len(given) - int(finite.sum()), "duplicate": int(finite.sum()) - len(kept)},
            camera=None,
            rescaled=False,
        )
        self._keep(
            kept,
            given,
            self._checked_origin(sensor_origin, len(given)),
            self._checked_normals(normals, len(given)),
        )
        dropped = " and ".join(f"{count} {why.replace('_', '-')}" for why, count in self.dropped.items() if count)
        if dropped:
            logger.info("%s: dropped %s points of %d", self.source, dropped, self.n_input)

    @classmethod
    def load(cls, path: Path | str, *, sensor_origin: ArrayLike | None = None, units: Unit | None = "m") -> Scan:
        """Read a scan file: PLY, PCD, XYZ/PTS/TXT/CSV, NPY/NPZ, or a scanned mesh (OBJ, STL, GLB, PLY with
        faces).

        Meshes are sampled uniformly by area with a fixed seed; coarse ones give their vertices. `sensor_origin`
        (3,) or (n, 3), in the unit of the file, overrides one in the file. `units` is the unit of the file,
        converted to m; None keeps the numbers as they are in the file, for only beside a model can the unit be told:
        `check_units(scan, model.diagonal, "auto")` returns such a scan in m.

        Raises `ScanError` naming the file and the cause.
        """
        if units not in (*METRES, None):
            raise ScanError(path, f"unknown unit {units!r}; valid: {', '.join(METRES)}, None to keep the numbers")
        content = readers.read(path)
        origin = content.sensor_origin if sensor_origin is None else sensor_origin
        scan = cls(content.points, sensor_origin=origin, normals=content.normals, source=path)
        return scan if units in ("m", None) else scan.scaled(METRES[units])

    @classmethod
    def from_depth(
        cls,
        depth: ArrayLike,
        intrinsics: ArrayLike,
        T_scan_camera: ArrayLike | None = None,
        mask: ArrayLike | None = None,
        depth_scale: float | None = None,
        source: Path | str = "depth image",
    ) -> Scan:
        """Back-project a depth image (h, w) by the pinhole model: p = depth * K^-1 (column, row, 1).

        `depth` is the distance along the optical axis: floats in m, or integers with `depth_scale` (m per
        unit, 0.001 for millimetres). Zero, negative and non-finite depths are no return. `intrinsics` is the
        (3, 3) matrix K or (fx, fy, cx, cy), pixels. `T_scan_camera` (4, 4) places the camera (x right, y
        down, z forward), by default at the scan's origin. `mask` (h, w) tells which pixels to use. Points
        count as given per pixel, row by row, so that `source_index` is the flat pixel index; the sensor
        origin is the camera's.

        Raises `ScanError` for wrong shapes or numbers, `StateError` for a `T_scan_camera` that is not rigid.
        """
        word = str(source)
        raw, metres = checked_depth(depth, depth_scale, word)
        used = np.ones(raw.shape, dtype=bool) if mask is None else np.asarray(mask)
        if used.shape != raw.shape:
            raise ScanError(word, f"mask has the shape {used.shape}, depth {raw.shape}")
        K = checked_intrinsics(intrinsics, word)
        T = np.eye(4) if T_scan_camera is None else checked_placement(T_scan_camera, "T_scan_camera")

        height, width = raw.shape
        distance = raw.astype(np.float64) * metres
        with np.errstate(invalid="ignore"):
            returned = np.isfinite(distance) & (distance > 0.0) & used.astype(bool)
        if not returned.any():
            raise ScanError(word, "no pixel in use has a depth")
        rows, columns = np.nonzero(returned)
        rays = np.stack([columns, rows, np.ones_like(rows)], axis=-1) @ np.linalg.inv(K).T
        scan = cls(transform(T, distance[returned][:, None] * rays), sensor_origin=T[:3, 3], source=source)
        scan._set(
            source_index=np.flatnonzero(returned)[scan.source_index],
            n_input=raw.size,
            camera=DepthCamera(intrinsics=K, width=width, height=height, T_scan_camera=T),
        )
        return scan

    @cached_property
    def box(self) -> tuple[Array, Array]:
        """Least and greatest corner (3,) of the axis-aligned bounding box, m."""
        # Coordinate by coordinate: NumPy takes five times as long for rows of three.
        x, y, z = self.points.T
        return read_only(np.array([x.min(), y.min(), z.min()])), read_only(np.array([x.max(), y.max(), z.max()]))

    @property
    def extent(self) -> Array:
        """(3,) size of the axis-aligned bounding box, m."""
        return self.box[1] - self.box[0]

    @property
    def diagonal(self) -> float:
        """Diagonal of the axis-aligned bounding box, m."""
        return float(np.linalg.norm(self.extent))

    def rounding(self) -> float:
        """Return the largest step, m, that the coordinates of an axis are rounded to, 0 where none are."""
        sample = self.points[:: max(1, len(self.points) // ROUNDED_SAMPLE)]
        return max(_step(np.unique(coordinate)) for coordinate in sample.T)

    def scaled(self, factor: float) -> Scan:
        """Return the scan with all lengths multiplied by `factor`; it loses its depth camera.

        Raises `ScanError` for a factor that is not positive and finite.
        """
        if not isinstance(factor, Real) or not 0.0 < factor < np.inf:
            raise ScanError(self.source, f"lengths are multiplied by a positive number, not {factor!r}")
        origin = None if self.sensor_origin is None else factor * self.sensor_origin
        scan = self._derived(np.arange(len(self.points)), factor * self.points, origin)
        scan._set(rescaled=True)
        return scan

    def mirrored(self, axis: Literal["x", "y", "z"] = "z") -> Scan:
        """Return the mirror image of the scan, with the sign of `axis` turned; it loses its depth camera.

        Of left-handed coordinates it makes right-handed ones. Raises `ScanError` for another axis.
        """
        if axis not in ("x", "y", "z"):
            raise ScanError(self.source, f"it is mirrored along x, y or z, not {axis!r}")
        mirror = np.where(np.array(["x", "y", "z"]) == axis, -1.0, 1.0)
        origin = None if self.sensor_origin is None else mirror * self.sensor_origin
        scan = self._derived(np.arange(len(self.points)), mirror * self.points, origin)
        scan._set(normals=None if self.normals is None else mirror * self.normals)
        return scan

    def without_sensor_origin(self) -> Scan:
        """Return the scan without saying where it was seen from; it loses its depth camera."""
        return self._derived(np.arange(len(self.points)), self.points, None)

    def with_sensor_origin(self, origin: ArrayLike) -> Scan:
        """Return the scan as seen from `origin`, (3,) or one a point (n, 3), m, scan frame.

        Raises `ScanError` for a wrong shape or numbers that are not finite.
        """
        seen_from = self._checked_origin(origin, len(self.points))
        return self._derived(np.arange(len(self.points)), self.points, seen_from)

    def cropped(self, lower: ArrayLike, upper: ArrayLike) -> Scan:
        """Return the points within the axis-aligned box from `lower` (3,) to `upper` (3,), m, scan frame.

        `n_input` and `source_index` still speak of the points given at first.
        Raises `ScanError` for a malformed or reversed box, or when fewer than ten points lie in it.
        """
        low, high = self._numbers(lower, "lower corner"), self._numbers(upper, "upper corner")
        if low.shape != (3,) or high.shape != (3,) or not (low < high).all():
            raise ScanError(self.source, f"no box to crop to: from {low.tolist()} to {high.tolist()}")
        inside = np.flatnonzero(((self.points >= low) & (self.points <= high)).all(axis=1))
        if len(inside) < MIN_POINTS:
            raise ScanError(
                self.source,
                f"only {len(inside)} points lie in the crop box from {point_text(low)} to {point_text(high)}; "
                f"the scan spans {point_text(self.box[0])} to {point_text(self.box[1])}",
            )
        scan = self._derived(inside, self.points, self.sensor_origin)
        left_out = self.dropped.get("cropped", 0) + len(self.points) - len(inside)
        scan._set(camera=self.camera, dropped={**self.dropped, "cropped": left_out})
        return scan

    def __setattr__(self, name: str, value: object) -> None:
        """Refuse: a scan never changes."""
        raise AttributeError(f"a scan never changes: make another one instead of setting its {name}")

    def __len__(self) -> int:
        """Return the number of points."""
        return len(self.points)

    def __repr__(self) -> str:
        """Return one line: source, points, size, viewpoint."""
        size = " x ".join(f"{length:.3g}" for length in self.extent)
        seen = {None: "no sensor origin", 1: "one sensor origin", 2: "sensor origin per point"}
        origin = seen[None if self.sensor_origin is None else self.sensor_origin.ndim]
        return f"Scan({self.source}: {len(self)} points, {size} m, {origin})"

    def _numbers(self, value: ArrayLike, name: str) -> Array:
        try:
            return as_floats(value)
        except (TypeError, ValueError) as error:
            raise ScanError(self.source, f"{name} are not an array of numbers: {error}") from None

    def _checked_origin(self, sensor_origin: ArrayLike | None, count: int) -> Array | None:
        if sensor_origin is None:
            return None
        origin = self._numbers(sensor_origin, "sensor origins")
        if origin.shape not in ((3,), (count, 3)):
            raise ScanError(self.source, f"sensor_origin must have the shape (3,) or ({count}, 3), got {origin.shape}")
        if not np.isfinite(origin).all():
            raise ScanError(self.source, "sensor_origin is not finite")
        return origin

    def _checked_normals(self, normals: ArrayLike | None, count: int) -> Array | None:
        if normals is None:
            return None
        vectors = self._numbers(normals, "normals")
        if vectors.shape != (count, 3):
            raise ScanError(self.source, f"normals must have the shape ({count}, 3), got {vectors.shape}")
        return vectors

    def _keep(self, kept: NDArray[np.int64], points: Array, origin: Array | None, normals: Array | None) -> None:
        """Set the arrays per point from those of which `kept` selects the rows."""
        if len(kept) < MIN_POINTS:
            what = "point" if len(kept) == 1 else "points"
            raise EmptyScanError(
                self.source,
                f"the scan has only {len(kept)} distinct {what}; at least {MIN_POINTS} are needed",
            )
        seen_from = origin[kept] if origin is not None and origin.ndim == 2 else origin
        units = None
        if normals is not None:
            chosen = normals[kept]
            with np.errstate(over="ignore"):
                lengths = np.linalg.norm(chosen, axis=1, keepdims=True)
            if np.isfinite(lengths).all() and (lengths > 0.0).all():
                units = chosen / lengths
            else:
                logger.info("%s: normals discarded, some are zero or not finite", self.source)
        self._set(points=points[kept], source_index=kept, sensor_origin=seen_from, normals=units)

    def _derived(self, kept: NDArray[np.int64], points: Array, origin: Array | None) -> Scan:
        scan = object.__new__(Scan)
        scan._set(source=self.source, n_input=self.n_input, dropped=self.dropped, camera=None, rescaled=self.rescaled)
        scan._keep(kept, points, origin, self.normals)
        scan._set(source_index=self.source_index[kept])
        return scan

    def _set(self, **attributes: object) -> None:
        vars(self).update({name: read_only(value) for name, value in attributes.items()})


def _step(values: Array) -> float:
    """Return the least distance between sorted `values` (n,) if all others are multiples of it, else what single
    precision tells of them if it holds them exactly, else 0."""
    single = values.astype(np.float32)
    exact = float(np.spacing(np.abs(single).max())) if (single == values).all() else 0.0
    if len(values) < LEAST_VALUES:
        return exact
    gaps = np.diff(values)
    multiples = gaps / gaps.min()
    return float(gaps.min()) if (np.abs(multiples - np.round(multiples)) < OFF_STEP).all() else exact


def cloud_frame(points: ArrayLike, sensor_origin: ArrayLike | None, source: str) -> Scan | Array:
    """Return the scan of a frame's points (n, 3); where they are too few for one, none at all: (0, 3).

    Points that are not finite are rays without a return, no news in each of many frames.
    """
    returned = as_floats(points)
    returned = returned[np.isfinite(returned).all(axis=1)]
    try:
        return Scan(returned, sensor_origin=sensor_origin, source=source)
    except EmptyScanError:
        return np.zeros((0, 3))


def point_text(point: Iterable[float]) -> str:
    """Return a point as messages name it."""
    return "(" + ", ".join(f"{value:.4g}" for value in point) + ")"
