"""Streams of frames from files: scans, depth images, recorded sequences and ROS 2 bags."""

from __future__ import annotations

import logging
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pwralign_kin.exceptions import EmptyScanError, ScanError
from pwralign_kin.scan import readers
from pwralign_kin.scan.bags import read_bag
from pwralign_kin.scan.depth import DepthFrame
from pwralign_kin.scan.pinhole import checked_intrinsics
from pwralign_kin.scan.scan import Scan, cloud_frame
from pwralign_kin.scan.timed_frame import FrameOptions, TimedFrame
from pwralign_kin.se3 import Array

logger = logging.getLogger(__name__)

BAG_SUFFIXES = (".mcap", ".db3")
_DIMENSIONS = {
    "depth": (3,),
    "intrinsics": (1, 2),
    "depth_scale": (0,),
    "T_scan_camera": (2,),
    "time": (1,),
    "points": (2,),
    "counts": (1,),
    "sensor_origin": (1, 2),
}
"""Of the arrays of a sequence."""

_SECONDS = re.compile(r"\d+\.\d+")


def read_frames(paths: Sequence[Path | str], options: FrameOptions | None = None) -> Iterator[TimedFrame]:
    """Yield the frames of files with their times (s), one at a time; point clouds in the unit of their file.

    `paths` are scan files (see `Scan.load`) and depth images (16-bit PNG, `intrinsics` needed), or one folder of them
    in natural order of their names, or one recorded sequence, or one ROS 2 bag (a folder, or a .mcap or .db3 file;
    needs the ros extra). Files whose names are all times in seconds with a decimal point (1305031102.175304.png) have
    these times; others follow each other at `rate`.

    A sequence is an .npz with `time` (f,) (else the rate) and either

    - `depth` (f, h, w), `intrinsics` (3, 3) or (4,), and optionally `depth_scale` (m per unit of integers) and
      `T_scan_camera` (4, 4); or
    - `points` (n, 3) of all frames one after the other, `counts` (f,) points of each, and optionally `sensor_origin`
      (3,) or (f, 3).

    Clouds without a finite point, or of fewer than ten, are frames without returns: empty arrays (0, 3).

    Raises `ScanError` naming the file and the cause; `DependencyError` for a bag without the extra.
    """
    own = options or FrameOptions()
    given = [Path(path) for path in paths]
    if len(given) == 1:
        only = given[0]
        if _is_bag(only):
            return read_bag(only, own)
        if only.is_dir():
            return _files(_in_folder(only), own)
        if only.suffix.lower() == ".npz" and only.exists():
            archive = readers.numpy_content(only.read_bytes(), only, b"PK")
            if readers.is_sequence(archive):
                return _sequence(archive, only, own)
    if not given:
        raise ScanError("frames", "no files given")
    return _files(given, own)


def _is_bag(path: Path) -> bool:
    return (path / "metadata.yaml").is_file() or path.suffix.lower() in BAG_SUFFIXES


def _in_folder(folder: Path) -> list[Path]:
    """Return the scans or depth images in a folder, 2 before 10."""
    valid = {*readers.SUFFIXES, ".png"}
    found = [path for path in folder.iterdir() if path.suffix.lower() in valid and not path.name.startswith(".")]
    if not found:
        raise ScanError(folder, f"no frames in this folder: no file ends in {' '.join(sorted(valid))}")
    kinds = sorted({path.suffix.lower() for path in found})
    if len(kinds) > 1:
        raise ScanError(folder, f"files of several kinds ({' '.join(kinds)}): name the frames one by one")
    if all(_SECONDS.fullmatch(path.stem) for path in found):
        return sorted(found, key=lambda path: float(path.stem))
    return sorted(found, key=_natural)


def _natural(path: Path) -> list[tuple[int, str]]:
    """Return what sorts 2 before 10."""
    return [(int(piece), "") if piece.isdigit() else (-1, piece) for piece in re.split(r"(\d+)", path.name)]


def _files(paths: Sequence[Path], options: FrameOptions) -> Iterator[TimedFrame]:
    timed = all(_SECONDS.fullmatch(path.stem) for path in paths)
    for index, path in enumerate(paths):
        time = float(path.stem) if timed else index / options.rate
        if path.suffix.lower() == ".png":
            yield time, DepthFrame.load(path, options.intrinsics, options.T_scan_camera, options.depth_scale)
        else:
            try:
                yield time, Scan.load(path, sensor_origin=options.sensor_origin)
            except EmptyScanError as error:
                logger.warning("%s: taken as a frame without returns", error)
                yield time, np.zeros((0, 3))


def _sequence(archive: Any, path: Path, options: FrameOptions) -> Iterator[TimedFrame]:
    """Yield the frames of an .npz."""
    arrays = {name: readers.member(archive, name, path) for name in archive.files}
    for name, dimensions in _DIMENSIONS.items():
        array = arrays.get(name)
        if array is not None and (array.ndim not in dimensions or array.dtype.kind not in "fiu"):
            wanted = " or ".join(map(str, dimensions))
            raise ScanError(
                path, f"{name} must be numbers in {wanted} dimensions, got shape {array.shape} of {array.dtype}"
            )
    count = len(arrays["depth" if "depth" in arrays else "counts"])
    times = arrays.get("time", np.arange(count) / options.rate)
    if times.shape != (count,) or not (np.isfinite(times).all() and (np.diff(times) > 0).all()):
        raise ScanError(path, f"time must hold {count} increasing numbers")
    frames: Iterator[Scan | DepthFrame | Array]
    frames = _depths(arrays, path, options) if "depth" in arrays else _clouds(arrays, path, options)
    yield from zip(times.astype(float).tolist(), frames, strict=True)


def _depths(arrays: dict[str, NDArray[Any]], path: Path, options: FrameOptions) -> Iterator[DepthFrame]:
    depth, intrinsics = arrays["depth"], arrays.get("intrinsics", options.intrinsics)
    if intrinsics is None:
        raise ScanError(path, "no array named intrinsics: fx fy cx cy or a 3x3 camera matrix, pixels")
    intrinsics = checked_intrinsics(intrinsics, str(path))
    integers = depth.dtype.kind in "iu"
    scale = float(arrays.get("depth_scale", options.depth_scale if integers else 1.0))
    T_scan_camera = arrays.get("T_scan_camera", options.T_scan_camera)
    for index, image in enumerate(depth):
        yield DepthFrame(image, intrinsics, T_scan_camera, scale, f"{path}: frame {index}")


def _clouds(arrays: dict[str, NDArray[Any]], path: Path, options: FrameOptions) -> Iterator[Scan | Array]:
    counts, points = arrays["counts"], arrays.get("points")
    if points is None or counts.dtype.kind not in "iu":
        raise ScanError(path, "points (n, 3) of all frames and counts (f,) of each are needed")
    if (counts < 0).any() or counts.sum() != len(points):
        raise ScanError(path, f"the counts add up to {counts.sum()}, but there are {len(points)} points")
    origin = arrays.get("sensor_origin", options.sensor_origin)
    if isinstance(origin, np.ndarray) and origin.ndim == 2 and len(origin) != len(counts):
        raise ScanError(path, f"sensor_origin has {len(origin)} rows for {len(counts)} frames")
    ends = np.cumsum(counts)
    for index, end in enumerate(ends):
        own = origin[index] if isinstance(origin, np.ndarray) and origin.ndim == 2 else origin
        yield cloud_frame(points[end - counts[index] : end], own, f"{path}: frame {index}")
