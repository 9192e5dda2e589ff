"""Planar and floating joints as chains of joints with one degree of freedom over virtual links."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from pwralign_kin.model.description import Joint, Origin, triple
from pwralign_kin.se3 import Array


def planar_chain(joint: Joint) -> list[Joint]:
    """Return slides along two directions orthogonal to the axis, then a turn about the axis.

    The directions are the next two coordinate axes in cyclic order (for the axis z: x and y), made orthogonal
    to the axis.
    """
    axis = np.array(joint.axis)
    first = np.eye(3)[(int(np.argmax(np.abs(axis))) + 1) % 3]
    first = first - axis * (axis @ first)
    first /= np.linalg.norm(first)
    second = np.cross(axis, first)
    return _chain(joint, [("x", "prismatic", first), ("y", "prismatic", second), ("yaw", "continuous", axis)])


def floating_chain(joint: Joint) -> list[Joint]:
    """Return slides along x, y, z, then turns in the order that makes roll, pitch, yaw URDF's fixed-axis angles."""
    x, y, z = np.eye(3)
    slides = [("x", "prismatic", x), ("y", "prismatic", y), ("z", "prismatic", z)]
    turns = [("yaw", "continuous", z), ("pitch", "revolute", y), ("roll", "continuous", x)]
    chain = _chain(joint, [*slides, *turns])
    return [*chain[:3], *reversed(chain[3:])]


def _chain(joint: Joint, steps: Sequence[tuple[str, str, Array]]) -> list[Joint]:
    """Return one-axis joints over virtual links that together move like `joint`."""
    chain, parent, origin = [], joint.parent, joint.origin
    for position, (suffix, kind, axis) in enumerate(steps, start=1):
        name = f"{joint.name}.{suffix}"
        child = joint.child if position == len(steps) else virtual_link(name)
        limit = math.pi / 2 if kind == "revolute" else None
        lower = None if limit is None else -limit
        chain.append(Joint(name, kind, parent, child, origin, triple(axis), lower, limit, free=True))
        parent, origin = child, Origin()
    return chain


def virtual_link(joint: str) -> str:
    """Return the name of the link without geometry that a chain puts behind its joint `joint`."""
    return f"{joint}.link"
