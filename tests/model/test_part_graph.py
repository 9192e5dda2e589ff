"""Welding links into parts, and walking the graph of parts."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from urdf_text import LIMIT, chain, joint, link

from pwralign_kin import se3
from pwralign_kin.model import ArticulatedModel
from pwralign_kin.model.part_graph import joint_motion

Read = Callable[..., ArticulatedModel]

SMALL = '<visual><geometry><box size="0.1 0.1 0.1"/></geometry></visual>'
MIDDLE = '<visual><geometry><box size="0.5 0.5 0.5"/></geometry></visual>'
LARGE = '<visual><geometry><box size="2 2 2"/></geometry></visual>'


def origin(x: float) -> str:
    return f'<origin xyz="{x} 0 0"/>'


@pytest.fixture
def tree(read: Read) -> ArticulatedModel:
    """base+plate -> (arm+hand -> finger, leg); the joints stand in the file before those that carry them."""
    links = [
        link("base", MIDDLE),
        link("plate", SMALL),
        link("arm", SMALL),
        link("hand", ""),
        link("finger", LARGE),
    ]
    joints = [
        joint("grip", "hand", "finger", "prismatic", LIMIT + origin(5)),
        joint("weld", "base", "plate", "fixed", origin(1)),
        joint("shoulder", "plate", "arm", "revolute", LIMIT + origin(2)),
        joint("wrist", "arm", "hand", "fixed", origin(3)),
        joint("hip", "base", "leg", "continuous", origin(4)),
    ]
    return read("".join([*links, link("leg", SMALL), *joints]))


def test_links_over_fixed_joints_are_one_part(tree: ArticulatedModel) -> None:
    assert [part.name for part in tree.parts] == ["base", "leg", "arm", "finger"]
    assert [part.links for part in tree.parts] == [("base", "plate"), ("leg",), ("arm", "hand"), ("finger",)]
    assert [part.parent for part in tree.parts] == [-1, 0, 0, 2]
    assert tree.joint_names == ("grip", "shoulder", "hip")
    assert [part.joint and part.joint.name for part in tree.parts] == [None, "hip", "shoulder", "grip"]


def test_joints_stand_in_the_parent_part(tree: ArticulatedModel) -> None:
    offsets = [part.joint.T_parent_joint[0, 3] for part in tree.parts if part.joint]
    assert offsets == [4, 1 + 2, 3 + 5]
    placements = tree.link_placements(tree.values({"grip": 0.5}))
    assert {name: T[0, 3] for name, T in placements.items()} == {
        "base": 0, "plate": 1, "arm": 3, "hand": 6, "finger": 11.5, "leg": 4
    }  # fmt: skip


def test_a_part_holds_the_geometry_of_all_its_links(tree: ArticulatedModel) -> None:
    base, leg, arm, finger = tree.parts
    assert [piece.link for piece in base.visuals] == ["base", "plate"]
    assert base.vertices.min(axis=0) == pytest.approx([-0.25] * 3) and base.vertices[:, 0].max() == pytest.approx(1.05)
    assert len(base.faces) == 24 and base.faces.max() == len(base.vertices) - 1
    assert leg.size == pytest.approx(arm.size) == pytest.approx(0.1 * np.sqrt(3)) and finger.size == pytest.approx(
        2 * np.sqrt(3)
    )


def test_placements_follow_from_the_joints_alone(read: Read, rng: np.random.Generator) -> None:
    """The invariant that compiled kinematics relies on."""
    contents = [
        f'{LIMIT}<origin xyz="{a} 0.1 0" rpy="{a} 0.2 0.3"/><axis xyz="{a} 1 2"/>' for a in (0.1, 0.2, 0.3, 0.4)
    ]
    contents[2] += '<mimic joint="j1" multiplier="-0.5" offset="0.1"/>'
    model = read(chain(*contents, kinds=("revolute", "prismatic", "revolute", "continuous")))
    values = rng.uniform(model.lower, model.upper)
    placements = model.part_placements(values)
    assert placements[0] == pytest.approx(np.eye(4))
    for part, T in zip(model.parts[1:], placements[1:], strict=True):
        assert part.joint is not None
        value = part.joint.multiplier * values[part.joint.actuated] + part.joint.offset
        motion = joint_motion(part.joint.kind, part.joint.axis, value)
        assert se3.inverse(placements[part.parent]) @ T == pytest.approx(part.joint.T_parent_joint @ motion, abs=1e-12)
