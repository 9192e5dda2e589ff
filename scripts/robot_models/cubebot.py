"""A Cubebot-style wooden figure: 14 blocks on elastic cords, 27 revolute axes.

All numbers are in the unit in which the folded cube has a side of 6; one unit is built as 1 cm.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from robot_models.shapes import Mesh, box, cylinder, join, prism
from robot_models.urdf import Joint, Link, Robot

UNIT = 0.01
BEVEL = 0.1
CORD_RADIUS = 0.2


@dataclass(frozen=True)
class Block:
    """One block: its box (depth x width x height: x, y, z) and its centre from its parent's centre."""

    size: tuple[float, float, float]
    parent: str | None = None
    centre: tuple[float, float, float] = (0.0, 0.0, 0.0)
    limb: str = "z"
    """Axis along the limb: the twist axis and the normal of the contact face towards the parent."""
    fold: str | None = None


def blocks() -> dict[str, Block]:
    """Return the published boxes, parents before children; left is +y."""
    table = {
        "chest": Block((2.0, 6.0, 4.0)),
        "head": Block((2.0, 2.54, 2.82), "chest", (0.0, 0.0, 3.57), "z", "y"),
        "pelvis": Block((2.0, 6.0, 2.0), "chest", (0.0, 0.0, -3.2), "z", None),
    }
    for side, sign in (("left", 1.0), ("right", -1.0)):
        upper_leg, lower_leg = f"{side}_upper_leg", f"{side}_lower_leg"
        upper_arm, lower_arm = f"{side}_upper_arm", f"{side}_lower_arm"
        table[upper_leg] = Block((2.0, 3.0, 4.08), "pelvis", (0.0, sign * 1.5, -3.2), "z", "y")
        table[lower_leg] = Block((2.04, 2.0, 3.0), upper_leg, (0.0, sign * 0.48, -3.7), "z", "y")
        table[f"{side}_foot"] = Block((2.45, 1.99, 0.96), lower_leg, (0.95, 0.0, -1.75), "z", "y")
        table[upper_arm] = Block((2.0, 4.2, 1.7), "chest", (0.0, sign * 5.3, 1.2), "y", "x")
        table[lower_arm] = Block((2.04, 3.0, 2.0), upper_arm, (0.0, sign * 3.75, 0.0), "y", "z")
        table[f"{side}_hand"] = Block((1.36, 1.36, 2.0), lower_arm, (0.0, sign * 2.3, 0.0), "y", "z")
    return table


FOOT_CLEARANCE = 0.16
"""Gap between the sole of a lower leg and the middle of the foot under it, as elsewhere in the leg."""

TOE = 0.2
"""Length of the level front end of a foot's upper face."""


def foot_outline() -> list[tuple[float, float]]:
    """Return the outline (x, z) of the wedge about the centre of its box.

    The box reaches 0.23 above the sole of the lower leg in front of it, so the upper face of the wedge must
    rise towards the toe: from a thin heel through the middle of the contact face to the toe's full height.
    """
    foot = blocks()["left_foot"]
    contact_x, contact_z = foot_contact()
    toe, half_height = foot.size[0] / 2.0, foot.size[2] / 2.0
    slope = (half_height - contact_z) / (toe - TOE - contact_x)
    heel_height = contact_z - slope * (contact_x + toe)
    return [
        (-toe, -half_height),
        (toe, -half_height),
        (toe, half_height),
        (toe - TOE, half_height),
        (-toe, heel_height),
    ]


def foot_contact() -> tuple[float, float]:
    """Middle (x, z), from the centre of the foot's box, of the face that lies under the lower leg."""
    foot, leg = blocks()["left_foot"], blocks()["left_lower_leg"]
    front = leg.size[0] / 2.0 - foot.centre[0]
    return (front - foot.size[0] / 2.0) / 2.0, -leg.size[2] / 2.0 - FOOT_CLEARANCE - foot.centre[2]


def anchor(name: str) -> np.ndarray:
    """Return a block's joint (3,) from its box centre: the middle of the contact face towards the parent."""
    block = blocks()[name]
    if block.parent is None:
        return np.zeros(3)
    if name.endswith("foot"):
        x, z = foot_contact()
        return np.array([x, 0.0, z])
    k = "xyz".index(block.limb)
    point = np.zeros(3)
    point[k] = -math.copysign(block.size[k] / 2.0, block.centre[k])
    return point


def shape(name: str) -> Mesh:
    """Return the solid of a block about the centre of its box."""
    size = blocks()[name].size
    sign = -1.0 if name.startswith("right") else 1.0
    if name.endswith("upper_leg"):
        # The notch on the inner side of the knee takes the folded foot: 0.96 thick and 2.45 long.
        notch_width, notch_height = 0.96, 2.45
        y, z = size[1] / 2.0, size[2] / 2.0
        outline = [
            (y, -z),
            (y, z),
            (-y, z),
            (-y, -z + notch_height),
            (-y + notch_width, -z + notch_height),
            (-y + notch_width, -z),
        ]
        mesh = prism(outline, size[0], BEVEL, along="x")
    elif name.endswith("foot"):
        mesh = prism(foot_outline(), size[1], BEVEL, along="y")
    elif name.endswith("hand"):
        # The upper half stops short of the finger tips: with this step the two hands lap in the cube.
        step = 0.5
        y, z = size[1] / 2.0, size[2] / 2.0
        outline = [(-y, -z), (y, -z), (y, 0.0), (y - step, 0.0), (y - step, z), (-y, z)]
        mesh = prism(outline, size[0], BEVEL, along="x")
    else:
        return box(size, bevel=BEVEL)
    return mesh.mirrored("y") if sign < 0.0 else mesh


def build() -> Robot:
    table = blocks()
    anchors = {name: anchor(name) for name in table}
    links: list[Link] = []
    joints: list[Joint] = []
    for name, block in table.items():
        centre = -anchors[name]
        meshes = {"beech" if name in ("chest", "head", "pelvis") else "maple": shape(name).at(*centre)}
        cords = [_cord(other, table, anchors, centre) for other, candidate in table.items() if candidate.parent == name]
        if cords:
            meshes["elastic"] = join(cords)
        scaled = {material: mesh.scaled(UNIT) for material, mesh in meshes.items()}
        links.append(Link(name, scaled, ([UNIT * s for s in block.size], [UNIT * c for c in centre])))
        if block.parent is not None:
            joints += _elastic_joint(name, block, anchors)
            if block.fold is not None:
                links.insert(len(links) - 1, Link(f"{name}_twisted"))
    materials = {
        "beech": (0.80, 0.62, 0.42, 1.0),
        "maple": (0.90, 0.77, 0.57, 1.0),
        "elastic": (0.12, 0.12, 0.12, 1.0),
    }
    comment = "A Cubebot-style figure: 1 toy unit (a sixth of the folded cube's side) is 1 cm"
    return Robot("cubebot", comment, materials, links, joints)


def _elastic_joint(name: str, block: Block, anchors: dict[str, np.ndarray]) -> list[Joint]:
    """Return the one or two revolute joints of a block: twist about the limb, then fold."""
    assert block.parent is not None
    # A link's frame sits in its own joint, so the parent's box centre is at minus its anchor.
    place = (np.array(block.centre) + anchors[name] - anchors[block.parent]) * UNIT
    twist_child = name if block.fold is None else f"{name}_twisted"
    twist = Joint(
        f"{name}_twist",
        "revolute",
        block.parent,
        twist_child,
        place,
        axis=_unit(block.limb),
        limits=(-math.pi, math.pi),
    )
    if block.fold is None:
        return [twist]
    fold = Joint(
        f"{name}_fold",
        "revolute",
        twist_child,
        name,
        axis=_unit(block.fold),
        limits=(-math.pi / 2.0, math.pi / 2.0),
    )
    return [twist, fold]


def _cord(name: str, table: dict[str, Block], anchors: dict[str, np.ndarray], parent_centre: np.ndarray) -> Mesh:
    """Return the elastic from a parent's face to the joint of block `name`, in the parent's link frame."""
    block = table[name]
    assert block.parent is not None
    k = "xyz".index(block.limb)
    joint = np.array(block.centre) + anchors[name]
    face = math.copysign(table[block.parent].size[k] / 2.0, block.centre[k])
    inner = face - math.copysign(BEVEL, face)
    length = abs(joint[k] - inner)
    middle = joint.copy()
    middle[k] = (joint[k] + inner) / 2.0
    mesh = cylinder(CORD_RADIUS, length, 12)
    if block.limb == "y":
        mesh = mesh.turned("x", math.pi / 2.0)
    return mesh.at(*(middle + parent_centre))


def _unit(axis: str) -> list[float]:
    return [1.0 if name == axis else 0.0 for name in "xyz"]
