"""Rigid parts (links welded by fixed joints) and the moving joints between them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pwralign_kin import se3
from pwralign_kin.arrays import Bools, Indices
from pwralign_kin.model.description import Description, Joint
from pwralign_kin.se3 import Array


@dataclass(frozen=True, eq=False)
class Visual:
    """One coloured piece of a link's geometry."""

    link: str
    """The link it belongs to."""

    T_link_visual: Array
    """(4, 4) placement in the link's frame."""

    vertices: Array
    """(v, 3) in the visual's frame, m, mesh scale applied."""

    faces: Indices
    """(f, 3) vertex indices, counter-clockwise seen from outside."""

    rgba: Array
    """(4,) colour, each in [0, 1]."""


@dataclass(frozen=True, eq=False)
class MovingJoint:
    """The joint between a part and its parent.

    The child's placement in the parent's frame is T_parent_joint @ joint_motion(kind, axis, value).
    """

    name: str
    kind: str
    """"revolute" (also continuous ones) or "prismatic"."""

    continuous: bool
    """Whether its actuated joint wraps: a full turn more of that one's value changes nothing."""

    T_parent_joint: Array
    """(4, 4) placement of the joint's frame in the parent part's frame."""

    axis: Array
    """(3,) unit axis in the joint's frame, which is the child part's frame at value 0."""

    actuated: int
    """Index of the actuated joint that drives it (its own, or the one it mimics)."""

    multiplier: float
    offset: float
    """value = multiplier * (actuated value) + offset, rad or m."""


@dataclass(frozen=True, eq=False)
class Part:
    """Links that move as one."""

    name: str
    """The link at the top of the weld; its frame is the part's frame."""

    links: tuple[str, ...]
    """Its links, the one at the top first."""

    parent: int
    """Index of the parent part, -1 for the root."""

    joint: MovingJoint | None
    """The joint towards the parent; None for the root."""

    vertices: Array
    """(v, 3) all geometry of its links, in the part's frame, m; empty without geometry."""

    faces: Indices
    """(f, 3) vertex indices."""

    visuals: tuple[Visual, ...]
    """The same geometry in its coloured pieces, each in its link's frame."""

    size: float
    """Diagonal of the bounding box of `vertices`, m; 0 without geometry."""


def joint_motion(kind: str, axis: Array, value: float) -> Array:
    """Return the (4, 4) motion of a joint by `value` (rad or m) about or along the unit `axis` (3,)."""
    T = np.eye(4)
    if kind == "prismatic":
        T[:3, 3] = value * axis
    else:
        T[:3, :3] = se3.rotation_about(axis, value)
    return T


@dataclass(frozen=True, eq=False)
class Weld:
    """A part before its geometry is known: links, and how it hangs from its parent."""

    links: tuple[str, ...]
    T_part_links: tuple[Array, ...]
    """(4, 4) placement of each link in the frame of the first."""

    parent: int
    """Index of the parent weld, -1 for the root."""

    joint: Joint | None
    """The joint towards the parent; None for the root."""

    T_parent_joint: Array
    """(4, 4) placement of the joint's frame in the parent's frame."""


def weld_links(description: Description) -> tuple[Weld, ...]:
    """Merge links over fixed joints; parents come before children, otherwise in the URDF's order."""
    below: dict[str, list[Joint]] = {}
    for candidate in description.joints:
        below.setdefault(candidate.parent, []).append(candidate)
    welds: list[Weld] = []
    pending: list[tuple[int, Joint | None, Array, str]] = [(-1, None, np.eye(4), description.root)]
    while pending:
        parent, joint, T_parent_joint, top = pending.pop()
        links, placements, moving = [top], [np.eye(4)], list[tuple[Joint, Array]]()
        position = 0
        while position < len(links):
            for candidate in below.get(links[position], []):
                T = placements[position] @ candidate.origin.matrix
                if candidate.kind == "fixed":
                    links.append(candidate.child)
                    placements.append(T)
                else:
                    moving.append((candidate, T))
            position += 1
        pending.extend((len(welds), mover, T, mover.child) for mover, T in reversed(moving))
        welds.append(Weld(tuple(links), tuple(placements), parent, joint, T_parent_joint))
    return tuple(welds)


def assemble_parts(
    welds: Sequence[Weld],
    visuals: Mapping[str, Sequence[Visual]],
    actuated: Mapping[str, int],
    continuous: Bools,
) -> tuple[Part, ...]:
    """Join the welds with the links' geometry and the numbering of the actuated joints."""
    parts = []
    for weld in welds:
        pieces = tuple(visual for link in weld.links for visual in visuals.get(link, ()))
        T_part_link = dict(zip(weld.links, weld.T_part_links, strict=True))
        placed = [se3.transform(T_part_link[piece.link] @ piece.T_link_visual, piece.vertices) for piece in pieces]
        starts = np.cumsum([0, *(len(points) for points in placed)])
        vertices = np.concatenate([np.empty((0, 3)), *placed])
        faces = [piece.faces + start for piece, start in zip(pieces, starts, strict=False)]
        parts.append(
            Part(
                name=weld.links[0],
                links=weld.links,
                parent=weld.parent,
                joint=_moving_joint(weld, actuated, continuous),
                vertices=vertices,
                faces=np.concatenate([np.empty((0, 3), np.int64), *faces]),
                visuals=pieces,
                size=float(np.linalg.norm(np.ptp(vertices, axis=0))) if len(vertices) else 0.0,
            )
        )
    return tuple(parts)


def _moving_joint(weld: Weld, actuated: Mapping[str, int], continuous: Bools) -> MovingJoint | None:
    if weld.joint is None:
        return None
    mimic = weld.joint.mimic
    index = actuated[weld.joint.name if mimic is None else mimic.joint]
    return MovingJoint(
        name=weld.joint.name,
        kind="prismatic" if weld.joint.kind == "prismatic" else "revolute",
        continuous=bool(continuous[index]),
        T_parent_joint=weld.T_parent_joint,
        axis=np.array(weld.joint.axis),
        actuated=index,
        multiplier=1.0 if mimic is None else mimic.multiplier,
        offset=0.0 if mimic is None else mimic.offset,
    )
