"""Joint values that two placed parts take: the joints between them closed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pwralign_kin import kernels
from pwralign_kin.model import ArticulatedModel
from pwralign_kin.model.part_graph import MovingJoint
from pwralign_kin.se3 import Array, inverse, skew

OPEN_TURN, OPEN_SLIDE = 0.12, 0.015
"""How far a joint may be open (rad, model diagonals) before refinement: parts only nearly look alike."""
BEYOND = 0.05
"""How far beyond its limits (rad, model diagonals) a joint may be before refinement."""


@dataclass(frozen=True)
class Chain:
    """One or two joints between two parts with surface; the part between two joints has none."""

    above: int
    below: int
    joints: tuple[MovingJoint, ...]

    def other(self, part: int) -> int:
        """Return the part at the other end."""
        return self.below if part == self.above else self.above


def chains_between(model: ArticulatedModel) -> tuple[Chain, ...]:
    """Return the connections between parts with surface that can be solved for their joints."""
    chains = []
    for below, part in enumerate(model.parts):
        if model.symmetry.kind[below] < 0 or part.joint is None:
            continue
        joints: tuple[MovingJoint, ...] = (part.joint,)
        above = part.parent
        between = model.parts[above].joint
        if model.symmetry.kind[above] < 0 and between is not None:
            joints, above = (between, *joints), model.parts[above].parent
        turning = all(joint.kind != "prismatic" for joint in joints)
        if model.symmetry.kind[above] >= 0 and (len(joints) == 1 or turning):
            chains.append(Chain(above, below, joints))
    return tuple(chains)


class JointClosing:
    """Closes the joints of chains, in search units (lengths in model diagonals)."""

    def __init__(self, model: ArticulatedModel, native: kernels.Articulated) -> None:
        """Take the model, and its kernel form for the limits."""
        self.model = model
        self.lower, self.upper = (np.asarray(limit) for limit in native.limits)

    def values(self, joints: tuple[MovingJoint, ...], above: Array, below: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Return the actuated values (m, joints) that the placements of the parts above and below take (..., 4, 4),
        which are held against each other as they broadcast to m, and whether (m,) the joints close within their
        limits."""
        motion = (inverse(above @ self._offset(joints[0])) @ below).reshape(-1, 4, 4)
        found, fits = np.zeros((len(motion), len(joints))), np.ones(len(motion), bool)
        if len(joints) == 2:
            between = self._offset(joints[1])
            angle = _bringing(joints[0].axis, between[:3, :3] @ joints[1].axis, motion[:, :3, :3] @ joints[1].axis)
            found[:, 0], fits = self._actuated(joints[0], angle)
            motion = inverse(_turns(joints[0].axis, angle) @ between) @ motion
        joint, t = joints[-1], motion[:, :3, 3]
        angle, turned = turned_about(motion[:, :3, :3], joint.axis)
        if joint.kind == "prismatic":
            along = t @ joint.axis
            found[:, -1], within = self._actuated(joint, along * self.model.diagonal)
            turned, t = np.hypot(turned, angle), t - along[:, None] * joint.axis
        else:
            found[:, -1], within = self._actuated(joint, angle)
        return found, fits & within & (turned < OPEN_TURN) & ((t * t).sum(axis=1) < OPEN_SLIDE**2)

    def placed(self, joints: tuple[MovingJoint, ...], above: Array, values: Array) -> Array:
        """Return the placements (..., 4, 4) of the part below for those of the part above and `values` (..., joints),
        which broadcast."""
        T = above
        for column, joint in enumerate(joints):
            value = joint.multiplier * values[..., column] * self.model.joint_scales[joint.actuated] + joint.offset
            if joint.kind == "prismatic":
                move = np.tile(np.eye(4), (*value.shape, 1, 1))
                move[..., :3, 3] = value[..., None] / self.model.diagonal * joint.axis
            else:
                move = _turns(joint.axis, value)
            T = T @ self._offset(joint) @ move
        return T

    def _offset(self, joint: MovingJoint) -> Array:
        """Return the joint's placement in the part above."""
        T = joint.T_parent_joint.copy()
        T[:3, 3] /= self.model.diagonal
        return T

    def _actuated(self, joint: MovingJoint, value: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Return the actuated values (m,) of joint values (rad or m), clipped, and whether limits allow them."""
        lower, upper = self.lower[joint.actuated], self.upper[joint.actuated]
        unit = self.model.joint_scales[joint.actuated]
        u = (value - joint.offset) / joint.multiplier / unit
        if joint.kind != "prismatic":
            # Of all full turns the one nearest to the middle of the limits.
            period = 2 * np.pi / abs(joint.multiplier) / unit
            u = u - period * np.round((u - (lower + upper) / 2) / period)
        return np.minimum(np.maximum(u, lower), upper), (u > lower - BEYOND) & (u < upper + BEYOND)


def _bringing(axis: Array, source: Array, target: Array) -> Array:
    """Return the angles (m,) about `axis` that bring the direction `source` (3,) nearest to `target` (m, 3)."""
    return np.asarray(np.arctan2(np.cross(source, target) @ axis, target @ source - (axis @ source) * (target @ axis)))


def _turns(axis: Array, angle: Array) -> Array:
    """Return the placements (..., 4, 4) turned by `angle` (...) about `axis` (Rodrigues' formula)."""
    K = skew(axis)
    T = np.tile(np.eye(4), (*angle.shape, 1, 1))
    T[..., :3, :3] += np.sin(angle)[..., None, None] * K + (1.0 - np.cos(angle))[..., None, None] * (K @ K)
    return T


def turned_about(R: Array, axis: Array) -> tuple[Array, Array]:
    """Return the angles (m,) of the rotations (m, 3, 3) about `axis`, and what of them is not about it."""
    # In terms of the quaternion (w, v) with c = v . axis: 4 w c over 2 (w^2 - c^2), and 2 (w^2 + c^2) - 1.
    x, y, z = axis
    sine = (R[:, 2, 1] - R[:, 1, 2]) * x + (R[:, 0, 2] - R[:, 2, 0]) * y + (R[:, 1, 0] - R[:, 0, 1]) * z
    kept = (R @ axis) @ axis
    trace = R[:, 0, 0] + R[:, 1, 1] + R[:, 2, 2]
    return np.arctan2(sine, trace - kept), np.arccos(np.minimum(np.maximum(kept, -1.0), 1.0))
