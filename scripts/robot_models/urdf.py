"""Links and joints of a sample model, and their URDF text."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from robot_models.shapes import Mesh, write_stl

Vector = Sequence[float]


@dataclass
class Link:
    """A rigid link: meshes by material name, in the link frame, m."""

    name: str
    meshes: dict[str, Mesh] = field(default_factory=dict)

    collision_box: tuple[Vector, Vector] | None = None
    """Size and centre of a box that serves as collision geometry; None takes the meshes."""


@dataclass
class Joint:
    """A joint of a URDF; `xyz` (m) and `rpy` (rad) place the child's frame in the parent's at value 0."""

    name: str
    kind: str
    parent: str
    child: str
    xyz: Vector = (0.0, 0.0, 0.0)
    rpy: Vector = (0.0, 0.0, 0.0)
    axis: Vector = (0.0, 0.0, 1.0)
    limits: tuple[float, float] | None = None
    mimic: tuple[str, float, float] | None = None
    """Name of the joint that is followed, multiplier, offset."""
    effort: float = 10.0
    velocity: float = 1.0


@dataclass
class Robot:
    """A whole model; `materials` maps a name to rgba in [0, 1]."""

    name: str
    comment: str
    materials: Mapping[str, Vector]
    links: list[Link]
    joints: list[Joint]

    def write(self, folder: Path) -> None:
        """Write NAME.urdf and meshes/*.stl into `folder`."""
        (folder / "meshes").mkdir(parents=True, exist_ok=True)
        for link in self.links:
            for material, mesh in link.meshes.items():
                write_stl(mesh, folder / mesh_path(link, material))
        (folder / f"{self.name}.urdf").write_text(self.text(), encoding="utf-8")

    def text(self) -> str:
        lines = [
            '<?xml version="1.0"?>',
            f"<!-- {self.comment}. Built by scripts/build_robots.py -->",
            f'<robot name="{self.name}">',
        ]
        for name, rgba in self.materials.items():
            lines += [f'  <material name="{name}">', f'    <color rgba="{_numbers(rgba)}"/>', "  </material>"]
        for link in self.links:
            lines += _link_lines(link)
        for joint in self.joints:
            lines += _joint_lines(joint)
        return "\n".join([*lines, "</robot>"]) + "\n"


def mesh_path(link: Link, material: str) -> str:
    name = link.name if len(link.meshes) == 1 else f"{link.name}_{material}"
    return f"meshes/{name}.stl"


def _link_lines(link: Link) -> list[str]:
    if not link.meshes:
        return [f'  <link name="{link.name}"/>']
    lines = [f'  <link name="{link.name}">']
    for material in link.meshes:
        geometry = f'<mesh filename="{mesh_path(link, material)}"/>'
        lines += [
            "    <visual>",
            f"      <geometry>{geometry}</geometry>",
            f'      <material name="{material}"/>',
            "    </visual>",
        ]
        if link.collision_box is None:
            lines.append(f"    <collision><geometry>{geometry}</geometry></collision>")
    if link.collision_box is not None:
        size, centre = link.collision_box
        lines += [
            "    <collision>",
            f'      <origin xyz="{_numbers(centre)}" rpy="0 0 0"/>',
            f'      <geometry><box size="{_numbers(size)}"/></geometry>',
            "    </collision>",
        ]
    return [*lines, "  </link>"]


def _joint_lines(joint: Joint) -> list[str]:
    lines = [
        f'  <joint name="{joint.name}" type="{joint.kind}">',
        f'    <origin xyz="{_numbers(joint.xyz)}" rpy="{_numbers(joint.rpy)}"/>',
        f'    <parent link="{joint.parent}"/>',
        f'    <child link="{joint.child}"/>',
    ]
    if joint.kind != "fixed":
        lines.append(f'    <axis xyz="{_numbers(joint.axis)}"/>')
        bounds = "" if joint.limits is None else f'lower="{joint.limits[0]!r}" upper="{joint.limits[1]!r}" '
        lines.append(f'    <limit {bounds}effort="{_number(joint.effort)}" velocity="{_number(joint.velocity)}"/>')
    if joint.mimic is not None:
        name, multiplier, offset = joint.mimic
        lines.append(f'    <mimic joint="{name}" multiplier="{_number(multiplier)}" offset="{_number(offset)}"/>')
    return [*lines, "  </joint>"]


def _number(value: float) -> str:
    return f"{round(value, 10) + 0.0:.10g}"


def _numbers(values: Vector) -> str:
    return " ".join(_number(float(value)) for value in values)
