"""The value of every joint that moves, in the form in which ROS names and numbers joints."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from pwralign_kin import se3
from pwralign_kin.export.source import joint_types
from pwralign_kin.model import ArticulatedModel
from pwralign_kin.state import State


@dataclass(frozen=True)
class JointValues:
    """Values of the joints of the URDF."""

    single: Mapping[str, float]
    """Every joint of one degree of freedom, also those that mimic, in the tree's order; rad or m."""

    actuated: tuple[str, ...]
    """The joints of `single` that mimic none."""

    multiple: Mapping[str, tuple[float, ...]]
    """Planar joints: x, y (m), theta (rad). Floating joints: x, y, z (m) and the quaternion x, y, z, w."""


def joint_values(model: ArticulatedModel, state: State) -> JointValues:
    """Return the values that `state` gives to the joints of the URDF, neutral ones to those it lacks.

    Raises `UnknownNameError` for joints that the model lacks.
    """
    actuated = dict(zip(model.joint_names, model.values(state.joints).tolist(), strict=True))
    joints = [part.joint for part in model.parts if part.joint is not None]
    values = {
        joint.name: joint.multiplier * actuated[model.joint_names[joint.actuated]] + joint.offset for joint in joints
    }
    types = joint_types(model)
    multiple: dict[str, tuple[float, ...]] = {}
    for name, kind in types.items():
        if kind == "planar":
            multiple[name] = (values[f"{name}.x"], values[f"{name}.y"], values[f"{name}.yaw"])
        elif kind == "floating":
            x, y, z, roll, pitch, yaw = (values[f"{name}.{axis}"] for axis in ("x", "y", "z", "roll", "pitch", "yaw"))
            T = np.eye(4)
            for axis, angle in ((2, yaw), (1, pitch), (0, roll)):
                T[:3, :3] = T[:3, :3] @ se3.rotation_about(np.eye(3)[axis], angle)
            multiple[name] = (x, y, z, *se3.quaternion_xyzw(T).tolist())
    single = {name: value for name, value in values.items() if name in types}
    return JointValues(single, tuple(name for name in single if name in actuated), multiple)
