"""Depth images and the pinhole cameras that they come from: what both must be."""

from __future__ import annotations

from dataclasses import dataclass
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pwralign_kin.exceptions import ScanError
from pwralign_kin.read_only import ReadOnly
from pwralign_kin.se3 import Array, as_floats


@dataclass(frozen=True, eq=False)
class DepthCamera(ReadOnly):
    """The pinhole camera of a depth image. What lies outside its image was not looked at: unknown, not
    free."""

    intrinsics: Array
    """(3, 3) matrix from camera coordinates (x right, y down, z forward) to pixels; integers are pixel
    centres."""

    width: int
    """Columns of the image."""

    height: int
    """Rows of the image."""

    T_scan_camera: Array
    """(4, 4) placement of the camera in the scan frame, translation in m."""


def checked_intrinsics(intrinsics: ArrayLike, word: str) -> Array:
    """Return the (3, 3) camera matrix of `intrinsics`, which is one already or (fx, fy, cx, cy)."""
    try:
        K = as_floats(intrinsics)
    except (TypeError, ValueError):
        K = np.empty(0)
    if K.shape == (4,):
        fx, fy, cx, cy = K
        K = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    valid = K.shape == (3, 3) and np.isfinite(K).all() and K[0, 0] > 0 and K[1, 1] > 0
    if not valid or not np.allclose(K[2], [0.0, 0.0, 1.0]) or K[1, 0] != 0.0:
        raise ScanError(word, "intrinsics must be (fx, fy, cx, cy) or a 3x3 camera matrix, with positive focal lengths")
    return K


def checked_depth(depth: ArrayLike, depth_scale: float | None, word: str) -> tuple[NDArray[Any], float]:
    """Return the image (h, w) and what multiplies it to make it metres: `depth_scale`, which floats need not have.

    Raises `ScanError`, of the source `word`, for what is no image of numbers, and for a scale that is missing or not
    positive.
    """
    try:
        image = np.asarray(depth)
    except (TypeError, ValueError) as error:
        raise ScanError(word, f"depth is no numeric image (h, w): {error}") from None
    if image.ndim != 2 or image.dtype.kind not in "fiu" or image.size == 0:
        raise ScanError(word, f"depth must be a numeric image (h, w), got shape {image.shape} of {image.dtype}")
    if depth_scale is None:
        if image.dtype.kind != "f":
            raise ScanError(word, "integer depth needs depth_scale, in m per unit: 0.001 for millimetres")
        return image, 1.0
    if not (isinstance(depth_scale, Real) and np.isfinite(depth_scale) and depth_scale > 0.0):
        raise ScanError(word, f"depth_scale must be positive, got {depth_scale}")
    return image, depth_scale
