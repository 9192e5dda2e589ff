"""Rigid placements as (4, 4) arrays: made, taken apart and checked; the one place where quaternion order is converted.

`T_a_b` maps coordinates of frame b into frame a. Twists are (6,): rotation vector first, then translation.
Quaternions are xyzw everywhere in this package (as in Pinocchio, SciPy and ROS).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pwralign_kin.exceptions import StateError

Array = NDArray[np.float64]


def skew(v: Array) -> Array:
    """Return the matrices (..., 3, 3) of the cross products with `v` (..., 3)."""
    out = np.zeros((*v.shape, 3))
    out[..., 2, 1], out[..., 0, 2], out[..., 1, 0] = v[..., 0], v[..., 1], v[..., 2]
    out[..., 1, 2], out[..., 2, 0], out[..., 0, 1] = -v[..., 0], -v[..., 1], -v[..., 2]
    return out


def rotation_about(axis: Array, angle: Array | float) -> Array:
    """Return the rotations (..., 3, 3) by `angle` (...) (rad) about the unit `axis` (..., 3) (Rodrigues' formula)."""
    K, turn = skew(axis), np.asarray(angle)[..., None, None]
    return np.asarray(np.eye(3) + np.sin(turn) * K + (1.0 - np.cos(turn)) * K @ K)


def axes_across(direction: Array) -> Array:
    """Return unit vectors (2, 3) across the unit `direction` (3,) and each other: with it, a right-handed frame."""
    first = np.cross(direction, np.eye(3)[np.argmin(np.abs(direction))])
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(direction, first)])


def inverse(T: Array) -> Array:
    """Return the inverse of placements `T` (..., 4, 4)."""
    out = np.zeros_like(T)
    R_t = np.swapaxes(T[..., :3, :3], -1, -2)
    out[..., :3, :3] = R_t
    out[..., :3, 3] = -(R_t @ T[..., :3, 3, None])[..., 0]
    out[..., 3, 3] = 1.0
    return out


def transform(T: Array, points: Array) -> Array:
    """Map `points` (n, 3) by the placement `T` (4, 4)."""
    return np.asarray(points @ T[:3, :3].T + T[:3, 3])


def from_twist(twist: Array) -> Array:
    """Return the placements (..., 4, 4) reached by rotating by `twist[..., :3]` (rad) and translating by the rest.

    Rotation and translation are decoupled (R = exp(w), t = v): the retraction of the least-squares steps, not the
    exponential map of SE(3).
    """
    T = np.zeros((*twist.shape[:-1], 4, 4))
    angle = np.linalg.norm(twist[..., :3], axis=-1)
    T[..., :3, :3] = rotation_about(twist[..., :3] / np.where(angle > 0.0, angle, 1.0)[..., None], angle)
    T[..., :3, 3], T[..., 3, 3] = twist[..., 3:], 1.0
    return T


def rotation_angle(R: Array) -> float:
    """Return the angle (rad) of the rotation `R` (3, 3)."""
    sine = np.linalg.norm([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]]) / 2.0
    return float(np.arctan2(sine, (np.trace(R) - 1.0) / 2.0))


def rotation_vector(R: Array) -> Array:
    """Return the rotation vector (3,), rad, of the rotation `R` (3, 3), which must turn by less than half a turn."""
    v = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]]) / 2.0
    sine = math.sqrt(float(v @ v))
    return v if sine < 1e-12 else v * (math.atan2(sine, (float(np.trace(R)) - 1.0) / 2.0) / sine)


def orthonormalised(T: Array) -> Array:
    """Return `T` (4, 4) with its rotation replaced by the nearest one (polar decomposition)."""
    U, _, Vt = np.linalg.svd(T[:3, :3])
    U[:, 2] *= np.linalg.det(U @ Vt)
    out = np.eye(4)
    out[:3, :3] = U @ Vt
    out[:3, 3] = T[:3, 3]
    return out


def as_floats(value: Any) -> Array:
    """Return a new array of float64; raises `TypeError` or `ValueError` for what is not made of real numbers."""
    if np.iscomplexobj(value):
        raise TypeError("complex numbers")
    return np.array(value, dtype=np.float64, order="C")


def checked_placement(value: Any, name: str) -> Array:
    """Return `value` as an exactly rigid (4, 4) placement.

    Raises `StateError` when it is not a finite 4x4 matrix whose rotation is orthonormal within 1e-3.
    """
    try:
        T = as_floats(value)
    except (TypeError, ValueError) as error:
        raise StateError(f"{name} is not a 4x4 matrix of numbers: {error}") from None
    if T.shape != (4, 4):
        raise StateError(f"{name} must be a 4x4 matrix, got shape {T.shape}")
    if not np.isfinite(T).all():
        raise StateError(f"{name} holds numbers that are not finite")
    rigid = orthonormalised(T)
    if np.abs(rigid - T).max() > 1e-3:
        raise StateError(
            f"{name} is not a rigid placement: its rotation is not orthonormal or its last row not 0 0 0 1"
        )
    return rigid


def from_quaternion(translation: Array, xyzw: Array) -> Array:
    """Return the placement with `translation` (3,) and the quaternion `xyzw` (4,), normalised here.

    Raises `StateError` for a zero or non-finite quaternion, or a translation that is not finite.
    """
    from scipy.spatial.transform import Rotation

    q = np.asarray(xyzw, dtype=np.float64)
    if q.shape != (4,) or not np.isfinite(q).all() or np.linalg.norm(q) < 1e-9:
        raise StateError(
            f"quaternion x y z w must be four finite numbers, not all zero, got {np.asarray(xyzw).tolist()}"
        )
    if not np.isfinite(translation).all():
        raise StateError(f"x y z must be finite numbers, got {np.asarray(translation).tolist()}")
    T = np.eye(4)
    T[:3, :3] = Rotation.from_quat(q).as_matrix()
    T[:3, 3] = translation
    return T


def quaternion_xyzw(T: Array) -> Array:
    """Return the unit quaternion xyzw (4,) of the placement `T`, with w >= 0."""
    from scipy.spatial.transform import Rotation

    q = np.asarray(Rotation.from_matrix(T[:3, :3]).as_quat())
    return -q if q[3] < 0 else q


def placement_text(T: Array, digits: int) -> str:
    """Return a placement `T` (m) for reading: xyz and quaternion, with so many digits."""
    xyz, xyzw = (" ".join(f"{v:.{digits}f}" for v in values) for values in (T[:3, 3], quaternion_xyzw(T)))
    return f"xyz {xyz} m, xyzw {xyzw}"


def roll_pitch_yaw(T: Array) -> tuple[float, float, float]:
    """Return URDF's rpy of the placement `T`: fixed-axis roll, pitch, yaw (rad), exact at a pitch of a right angle too.

    Where roll and yaw turn about the same axis their split is arbitrary; roll is taken from what is left once yaw is
    undone, so that an error in one is made good by the other.
    """
    R = T[:3, :3]
    yaw = math.atan2(R[1, 0], R[0, 0]) if math.hypot(R[0, 0], R[1, 0]) > 1e-12 else 0.0
    cosine, sine = math.cos(yaw), math.sin(yaw)
    pitch = math.atan2(-R[2, 0], cosine * R[0, 0] + sine * R[1, 0])
    roll = math.atan2(sine * R[0, 2] - cosine * R[1, 2], cosine * R[1, 1] - sine * R[0, 1])
    return roll, pitch, yaw
