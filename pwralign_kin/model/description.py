"""What a URDF says once it is checked and mended: links with shapes, joined by joints of one degree of freedom."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from pwralign_kin import se3
from pwralign_kin.se3 import Array

Triple = tuple[float, float, float]
Color = tuple[float, float, float, float]

FREE_REACH = 3.0
"""Range of the translations of planar and floating joints, in model diagonals each way."""

SLIDE_REACH = 1.0
"""Range of a prismatic joint without limits, in model diagonals each way."""

LONGEST_SLIDE = 10.0
"""Prismatic limits beyond so many model diagonals mean "unlimited" and are cut to `FREE_REACH`."""


def triple(values: Sequence[float] | Array) -> Triple:
    """Return three numbers as plain floats."""
    return (float(values[0]), float(values[1]), float(values[2]))


@dataclass(frozen=True)
class Origin:
    """A placement as URDF writes it."""

    xyz: Triple = (0.0, 0.0, 0.0)
    """Translation, m."""

    rpy: Triple = (0.0, 0.0, 0.0)
    """Fixed-axis roll, pitch, yaw, rad."""

    @property
    def matrix(self) -> Array:
        """(4, 4) placement: R = Rz(yaw) Ry(pitch) Rx(roll)."""
        x, y, z = np.eye(3)
        roll, pitch, yaw = self.rpy
        T = np.eye(4)
        T[:3, :3] = se3.rotation_about(z, yaw) @ se3.rotation_about(y, pitch) @ se3.rotation_about(x, roll)
        T[:3, 3] = self.xyz
        return T


@dataclass(frozen=True)
class Shape:
    """One visual or collision element."""

    kind: str
    """box, cylinder, sphere, capsule or mesh."""

    size: tuple[float, ...]
    """box: x y z; cylinder and capsule: radius, length; sphere: radius (m); mesh: scale x y z.

    A capsule's length is that of its cylinder, without the two caps.
    """

    filename: str = ""
    """The mesh's name as the URDF gives it."""

    origin: Origin = Origin()
    """Placement in the link's frame."""

    rgba: Color | None = None
    """Colour of the URDF's material, each in [0, 1]."""


@dataclass(frozen=True)
class Link:
    """One link with its geometry of the kind in use."""

    name: str
    shapes: tuple[Shape, ...] = ()


@dataclass(frozen=True)
class Mimic:
    """value = multiplier * (value of `joint`) + offset; `joint` is actuated once chains are resolved."""

    joint: str
    multiplier: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True)
class Joint:
    """One joint with at most one degree of freedom."""

    name: str
    kind: str
    """fixed, revolute, continuous or prismatic."""

    parent: str
    child: str
    origin: Origin = Origin()
    """Placement of the joint (and child link at value 0) in the parent link's frame."""

    axis: Triple = (1.0, 0.0, 0.0)
    """Unit axis in the joint's frame."""

    lower: float | None = None
    upper: float | None = None
    """Limits, rad or m. None: unlimited (fixed, continuous), or a slide that waits for the model's size."""

    free: bool = False
    """Whether it is a component of a planar or floating joint."""

    mimic: Mimic | None = None


@dataclass(frozen=True)
class Description:
    """A checked URDF: a tree of links with one root."""

    name: str
    links: tuple[Link, ...]
    joints: tuple[Joint, ...]
    root: str
    warnings: tuple[str, ...] = ()
    """What was mended, one line each."""
    source: bytes = field(default=b"", repr=False)
    """The URDF as its author wrote it, after xacro."""

    def with_ranges(self, diagonal: float) -> Description:
        """Return the description with every slide's limits finite and sane for a model of `diagonal` (m)."""
        warnings = list(self.warnings)
        joints = {joint.name: _with_range(joint, diagonal, warnings) for joint in self.joints}
        for joint in joints.values():
            if joint.kind == "prismatic" and joint.lower is None and joint.mimic is not None:
                leader = joints[joint.mimic.joint]
                ends = (
                    (-math.pi, math.pi)
                    if leader.lower is None or leader.upper is None
                    else (leader.lower, leader.upper)
                )
                lower, upper = sorted(joint.mimic.multiplier * end + joint.mimic.offset for end in ends)
                joints[joint.name] = dataclasses.replace(joint, lower=lower, upper=upper)
        return dataclasses.replace(self, joints=tuple(joints.values()), warnings=tuple(warnings))


def _with_range(joint: Joint, diagonal: float, warnings: list[str]) -> Joint:
    """The joint with finite and sane limits if it is a slide that follows no other."""
    if joint.kind != "prismatic" or joint.mimic is not None:
        return joint
    if joint.lower is None or joint.upper is None:
        reach = (FREE_REACH if joint.free else SLIDE_REACH) * diagonal
        if not joint.free:
            warnings.append(
                f"joint {joint.name!r}: no limits, taken as {-reach:.3g}..{reach:.3g} m by the model's size"
            )
        return dataclasses.replace(joint, lower=-reach, upper=reach)
    if max(-joint.lower, joint.upper) <= LONGEST_SLIDE * diagonal:
        return joint
    reach = FREE_REACH * diagonal
    lower, upper = max(joint.lower, -reach), min(joint.upper, reach)
    if lower >= upper:
        return joint
    warnings.append(
        f"joint {joint.name!r}: limits {joint.lower:.3g}..{joint.upper:.3g} m are far beyond the model's "
        f"size: cut to {lower:.3g}..{upper:.3g} m"
    )
    return dataclasses.replace(joint, lower=lower, upper=upper)
