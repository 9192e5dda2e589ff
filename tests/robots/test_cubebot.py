"""The Cubebot-style figure against the published facts of the toy, once more written out, in toy units."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from scipy.spatial import ConvexHull

UNIT = 0.01
# name: (parent, depth x width x height, centre from the parent's centre, twist axis, fold axis); left is +y
FACTS = {
    "chest": (None, (2, 6, 4), (0, 0, 0), None, None),
    "head": ("chest", (2, 2.54, 2.82), (0, 0, 3.57), "z", "y"),
    "pelvis": ("chest", (2, 6, 2), (0, 0, -3.2), "z", None),
    "left_upper_leg": ("pelvis", (2, 3, 4.08), (0, 1.5, -3.2), "z", "y"),
    "right_upper_leg": ("pelvis", (2, 3, 4.08), (0, -1.5, -3.2), "z", "y"),
    "left_lower_leg": ("left_upper_leg", (2.04, 2, 3), (0, 0.48, -3.7), "z", "y"),
    "right_lower_leg": ("right_upper_leg", (2.04, 2, 3), (0, -0.48, -3.7), "z", "y"),
    "left_foot": ("left_lower_leg", (2.45, 1.99, 0.96), (0.95, 0, -1.75), "z", "y"),
    "right_foot": ("right_lower_leg", (2.45, 1.99, 0.96), (0.95, 0, -1.75), "z", "y"),
    "left_upper_arm": ("chest", (2, 4.2, 1.7), (0, 5.3, 1.2), "y", "x"),
    "right_upper_arm": ("chest", (2, 4.2, 1.7), (0, -5.3, 1.2), "y", "x"),
    "left_lower_arm": ("left_upper_arm", (2.04, 3, 2), (0, 3.75, 0), "y", "z"),
    "right_lower_arm": ("right_upper_arm", (2.04, 3, 2), (0, -3.75, 0), "y", "z"),
    "left_hand": ("left_lower_arm", (1.36, 1.36, 2), (0, 2.3, 0), "y", "z"),
    "right_hand": ("right_lower_arm", (1.36, 1.36, 2), (0, -2.3, 0), "y", "z"),
}
CHILDREN = [name for name in FACTS if name != "chest"]
FEET = ("left_foot", "right_foot")


def centre(name):
    parent, _, offset, _, _ = FACTS[name]
    return np.array(offset, float) + (centre(parent) if parent else 0.0)


def wood(cubebot, name):
    """Vertices of a block in toy units in the chest's frame."""
    return (
        np.vstack(
            [cubebot.vertices(name, material) for material in ("beech", "maple") if cubebot.meshes(name, material)]
        )
        / UNIT
    )


def volume(meshes):
    corners = np.vstack([vertices[faces] for vertices, faces in meshes])
    return np.einsum("ij,ij->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6.0


@pytest.mark.parametrize("name", FACTS)
def test_every_box_has_its_size_at_its_place(cubebot, name):
    points = wood(cubebot, name)
    assert np.ptp(points, axis=0) == pytest.approx(FACTS[name][1], abs=1e-4)
    assert (points.min(axis=0) + points.max(axis=0)) / 2 == pytest.approx(centre(name), abs=1e-4)


def test_fourteen_elastic_joints_make_27_revolute_axes_with_their_limits(cubebot):
    joints = cubebot.joints
    assert len(joints) == len(cubebot.urdf.actuated_joint_names) == 27
    assert {joint.type for joint in joints.values()} == {"revolute"}
    assert sum(name.endswith("_twist") for name in joints) == 14
    for name, joint in joints.items():
        bound = np.pi if name.endswith("_twist") else np.pi / 2
        assert (joint.limit.lower, joint.limit.upper) == pytest.approx((-bound, bound), abs=1e-12)
    assert "pelvis_fold" not in joints


def test_axes_are_the_limb_and_the_fold(cubebot):
    for name in CHILDREN:
        _, _, _, twist, fold = FACTS[name]
        assert joint_axis(cubebot, f"{name}_twist") == "xyz".index(twist)
        if fold is not None:
            assert joint_axis(cubebot, f"{name}_fold") == "xyz".index(fold)
            assert cubebot.joints[f"{name}_twist"].child == cubebot.joints[f"{name}_fold"].parent


def joint_axis(cubebot, name):
    """Index of the root axis along which a joint's axis lies at rest."""
    joint = cubebot.joints[name]
    axis = np.abs(cubebot.placement(joint.child)[:3, :3] @ joint.axis)
    assert np.sort(axis) == pytest.approx([0, 0, 1], abs=1e-12)
    return int(np.argmax(axis))


def test_links_between_twist_and_fold_are_empty(cubebot):
    empty = [link for link in cubebot.urdf.robot.links if not link.visuals]
    assert len(empty) == 13
    assert all(link.inertial is None and not link.collisions for link in empty)


@pytest.mark.parametrize("name", CHILDREN)
def test_joint_sits_in_the_middle_of_the_contact_face(cubebot, name):
    parent, size, offset, twist, _ = FACTS[name]
    joint = cubebot.placement(name)[:3, 3] / UNIT
    k = "xyz".index(twist)
    face = centre(name) - np.sign(offset[k]) * np.eye(3)[k] * size[k] / 2
    if name in FEET:
        # The wedge's upper face lies askew; its middle under the sole is what touches.
        sole_front, heel = centre(parent)[0] + 1.02, centre(name)[0] - size[0] / 2
        assert joint[0] == pytest.approx((sole_front + heel) / 2, abs=1e-6)
        assert joint[1] == pytest.approx(centre(name)[1], abs=1e-6)
        assert joint[2] == pytest.approx(upper_face(wood(cubebot, name), joint[0]), abs=1e-4)
    else:
        assert joint == pytest.approx(face, abs=1e-6)


@pytest.mark.parametrize("name", CHILDREN)
def test_cord_closes_the_gap_to_the_parent(cubebot, name):
    """The published boxes lie up to 0.2 apart; the parent's elastic reaches the joint on the child's face."""
    parent, _, offset, twist, _ = FACTS[name]
    k = "xyz".index(twist)
    joint = cubebot.placement(name)[:3, 3] / UNIT
    cord = cubebot.vertices(parent, "elastic") / UNIT
    reached = cord[np.abs(cord[:, k] - joint[k]) < 1e-4]
    assert np.linalg.norm(reached - joint, axis=1).min() < 1e-4
    block = wood(cubebot, parent)
    outermost = block[:, k].max() if offset[k] > 0 else block[:, k].min()
    gap = (joint[k] - outermost) * np.sign(offset[k])
    assert 0.0 < gap < 0.24


def test_blocks_do_not_cut_into_each_other_at_rest(cubebot):
    bounds = {name: (wood(cubebot, name).min(axis=0), wood(cubebot, name).max(axis=0)) for name in FACTS}
    for first, second in combinations(FACTS, 2):
        if second not in FEET or FACTS[second][0] != first:
            overlap = np.minimum(bounds[first][1], bounds[second][1]) - np.maximum(bounds[first][0], bounds[second][0])
            assert overlap.min() < 1e-4, (first, second)
    for name in FEET:
        leg = centre(FACTS[name][0])
        for x in (-0.2, 0.5, 1.02):
            assert upper_face(wood(cubebot, name), x) < leg[2] - 1.5


def upper_face(points, x):
    """Height of the top of a convex block, seen from the side, at `x`."""
    normals = ConvexHull(points[:, [0, 2]]).equations
    upwards = normals[normals[:, 1] > 1e-9]
    return (-(upwards[:, 0] * x + upwards[:, 2]) / upwards[:, 1]).min()


def test_folded_parts_have_their_own_shapes(cubebot):
    for name, least, most in (
        ("upper_leg", 0.75, 0.85),
        ("foot", 0.6, 0.9),
        ("hand", 0.75, 0.95),
        ("lower_leg", 0.97, 1.0),
    ):
        box = np.prod(FACTS[f"left_{name}"][1])
        share = volume(cubebot.meshes(f"left_{name}", "maple")) / UNIT**3 / box
        assert least < share < most, name


def test_left_and_right_are_mirror_images(cubebot):
    for name in CHILDREN:
        if name.startswith("left"):
            left, right = wood(cubebot, name), wood(cubebot, name.replace("left", "right"))
            mirrored = left * [1, -1, 1]
            assert np.sort(mirrored.round(4), axis=0) == pytest.approx(np.sort(right.round(4), axis=0), abs=2e-4)
