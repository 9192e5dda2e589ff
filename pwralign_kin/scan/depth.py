"""A depth image as a sensor gives it: for streams, where making a whole `Scan` of each costs too much."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pwralign_kin.exceptions import ScanError
from pwralign_kin.files import check_path
from pwralign_kin.scan.pinhole import checked_depth, checked_intrinsics
from pwralign_kin.scan.scan import Scan
from pwralign_kin.se3 import Array, checked_placement

MILLIMETRES = 0.001
"""m per unit of what most depth cameras write."""


@dataclass(frozen=True, eq=False)
class DepthFrame:
    """A depth image and its pinhole camera; one without any return is a frame in which nothing is seen.

    Raises `ScanError` for wrong shapes or numbers, `StateError` for a `T_scan_camera` that is not rigid.
    """

    depth: NDArray[Any]
    """(h, w) distance along the optical axis: floats in m, or integers in units of `depth_scale`; 0: no return."""

    intrinsics: Array
    """(3, 3) matrix K, or (fx, fy, cx, cy), pixels; becomes the matrix."""

    T_scan_camera: Array = field(default_factory=lambda: np.eye(4))
    """(4, 4) placement of the camera (x right, y down, z forward) in the scan frame, m."""

    depth_scale: float | None = None
    """m per unit of `depth`; 0.001 for millimetres. Integers need it, floats are in m without it."""

    source: Path | str = "depth image"
    """The file, or a word for the array."""

    def __post_init__(self) -> None:
        """Check the fields; floats become single precision, integers 16 bits."""
        depth, _ = checked_depth(self.depth, self.depth_scale, str(self.source))
        compact = depth.dtype if depth.dtype in (np.uint16, np.float32) else np.dtype(np.float32)
        object.__setattr__(self, "depth", np.ascontiguousarray(depth, compact))
        object.__setattr__(self, "intrinsics", checked_intrinsics(self.intrinsics, str(self.source)))
        object.__setattr__(self, "T_scan_camera", checked_placement(self.T_scan_camera, "T_scan_camera"))

    @classmethod
    def load(
        cls,
        path: Path | str,
        intrinsics: ArrayLike | None,
        T_scan_camera: ArrayLike | None = None,
        depth_scale: float = MILLIMETRES,
    ) -> DepthFrame:
        """Read a PNG image of one channel of 16 bits; the arguments are the fields.

        Raises `ScanError` for a file that is missing or no such image, and without intrinsics.
        """
        from PIL import Image, UnidentifiedImageError

        check_path(path, partial(ScanError, "depth image"))
        path = Path(path)
        if intrinsics is None:
            raise ScanError(path, "a depth image needs its camera's fx fy cx cy, pixels (intrinsics / --intrinsics)")
        try:
            with Image.open(path, formats=["PNG"]) as image:
                mode = image.mode
                depth = np.asarray(image)
        except FileNotFoundError:
            raise ScanError(path, "no such file") from None
        except (OSError, UnidentifiedImageError, SyntaxError, ValueError) as error:
            raise ScanError(path, f"not a readable PNG image: {error}") from None
        if not mode.startswith("I"):
            raise ScanError(path, f"a depth image has one channel of 16 bits, this one is of mode {mode}")
        T = np.eye(4) if T_scan_camera is None else checked_placement(T_scan_camera, "T_scan_camera")
        return cls(depth.astype(np.uint16), checked_intrinsics(intrinsics, str(path)), T, depth_scale, path)

    def __repr__(self) -> str:
        """Return one line: source, pixels, focal length (pixels)."""
        height, width = self.depth.shape
        pixels, focal = f"{width} x {height} {self.depth.dtype} pixels", self.intrinsics[0, 0]
        return f"DepthFrame({self.source}: {pixels}, focal length {focal:.4g})"

    @property
    def metres(self) -> float:
        """What multiplies `depth` to make it metres."""
        return 1.0 if self.depth_scale is None else self.depth_scale

    def to_scan(self) -> Scan:
        """Return the points of all pixels with a return. Raises `ScanError` where there are too few."""
        return Scan.from_depth(
            self.depth, self.intrinsics, self.T_scan_camera, depth_scale=self.depth_scale, source=self.source
        )
