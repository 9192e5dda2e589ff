"""The pinhole camera that pictures are taken with."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pwralign_kin.arrays import Indices
from pwralign_kin.exceptions import ArgumentError
from pwralign_kin.se3 import Array


@dataclass(frozen=True)
class View:
    """A pinhole camera in the scan frame."""

    eye: Array
    """(3,) place of the camera, m."""

    target: Array
    """(3,) point in the middle of the picture, m."""

    up: Array
    """(3,) direction that points up in the picture."""

    fov: float
    """Angle that the shorter side of the picture spans, rad."""

    def axes(self) -> Array:
        """Return (3, 3) rows: right, down, forward, as unit vectors in the scan frame.

        Raises `ArgumentError` when eye and target coincide.
        """
        forward = np.asarray(self.target, dtype=np.float64) - self.eye
        length = np.linalg.norm(forward)
        if not length > 0.0:
            raise ArgumentError("view", "an eye and a target that differ", f"{np.asarray(self.eye).tolist()} for both")
        return camera_axes(forward / length, np.asarray(self.up, dtype=np.float64))


def camera_axes(forward: Array, up: Array) -> Array:
    """Return (3, 3) rows right, down, forward for the unit direction `forward`; `up` may lie along it."""
    right = np.cross(forward, up)
    if np.linalg.norm(right) < 1e-6 * max(float(np.linalg.norm(up)), 1e-12):
        right = np.cross(forward, np.eye(3)[int(np.argmin(np.abs(forward)))])
    right = right / np.linalg.norm(right)
    return np.stack([right, np.cross(forward, right), forward])


def tangents(size: tuple[int, int], fov: float) -> Array:
    """Return half the width and half the height of the picture at distance 1."""
    return np.asarray(np.tan(fov / 2.0) * np.array(size) / min(size))


def projected(points: Array, view: View, size: tuple[int, int]) -> tuple[Indices, Array]:
    """Return the flat pixel index (n,) of each point, -1 outside the picture, and its depth (n,), m."""
    in_axes = (points - view.eye) @ view.axes().T
    depth = in_axes[:, 2]
    ahead = depth > 1e-9
    slopes = in_axes[:, :2] / np.where(ahead, depth, 1.0)[:, None]
    place = np.floor((slopes / tangents(size, view.fov) + 1.0) / 2.0 * np.array(size))
    inside = ahead & (place >= 0).all(axis=1) & (place < np.array(size)).all(axis=1)
    column, row = np.where(inside[:, None], place, 0.0).astype(np.int64).T
    return np.where(inside, row * size[0] + column, -1), depth
