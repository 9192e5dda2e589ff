"""Door, cabinet, laptop and excavator: joints that work as the real things do."""

from __future__ import annotations

import numpy as np
import pytest
from sample_robot import Sample


def kinds(sample):
    return {name: joint.type for name, joint in sample.joints.items()}


def test_door_opens_clear_of_its_frame_and_shuts_flush():
    door = Sample("door")
    assert kinds(door) == {"leaf_hinge": "revolute", "handle_turn": "revolute"}
    shut = door.vertices("leaf", "oak")
    assert np.ptp(shut, axis=0) == pytest.approx([0.044, 0.826, 2.040], abs=1e-4)
    frame = door.vertices("frame", "paint")
    assert frame[:, 0].min() < shut[:, 0].min() < shut[:, 0].max() < frame[:, 0].max()
    door.pose({"leaf_hinge": np.pi / 2})
    assert np.ptp(door.vertices("leaf", "oak"), axis=0)[:2] == pytest.approx([0.826, 0.044], abs=1e-3)
    assert door.vertices("leaf", "oak")[:, 0].min() > 0.0
    assert door.joints["leaf_hinge"].limit.upper > np.radians(100)


def test_pressing_the_handle_lowers_both_levers():
    door = Sample("door")
    rest = door.vertices("handle")
    door.pose({"handle_turn": 0.6})
    pressed = door.vertices("handle")
    ends = rest[:, 1] < rest[:, 1].min() + 0.02
    assert (pressed[ends, 2] < rest[ends, 2] - 0.05).all()
    assert rest[:, 0].max() - rest[:, 0].min() > 0.1


def test_cabinet_doors_and_drawers_open_to_the_front():
    cabinet = Sample("cabinet")
    assert sorted(kinds(cabinet).values()) == ["prismatic", "prismatic", "revolute", "revolute"]
    front = cabinet.vertices("left_door")[:, 0].max()
    for name, joint in cabinet.joints.items():
        cabinet.pose({name: joint.limit.upper})
        moved = cabinet.vertices(joint.child)
        assert moved[:, 0].max() > front + 0.2, name
        cabinet.pose({})
    left, right = cabinet.vertices("left_door", "white"), cabinet.vertices("right_door", "white")
    assert 0.001 < right[:, 1].min() - left[:, 1].max() < 0.006


def test_laptop_lid_shuts_on_the_base_and_opens_upwards():
    laptop = Sample("laptop")
    base, lid = laptop.vertices("base", "aluminium"), laptop.vertices("lid", "aluminium")
    assert 0.0 < lid[:, 2].min() - base[:, 2].max() < 0.004
    assert np.ptp(base, axis=0)[:2] == pytest.approx([0.222, 0.326], abs=1e-4)
    laptop.pose({"lid_hinge": np.pi / 2})
    assert laptop.vertices("lid")[:, 2].max() > 0.2
    assert np.degrees(laptop.joints["lid_hinge"].limit.upper) == pytest.approx(135.0)


def test_excavator_swings_without_end():
    excavator = Sample("excavator")
    assert excavator.joints["swing"].type == "continuous"
    assert sorted(excavator.urdf.actuated_joint_names) == [
        "blade_lift",
        "boom_lift",
        "bucket_curl",
        "stick_reach",
        "swing",
    ]


@pytest.mark.parametrize("curl", [-0.9, -0.3, 0.0, 0.7, 1.2])
def test_bucket_linkage_closes_at_every_angle(curl):
    """The mimic joints drive a parallelogram: the free end of the link stays on the pin of the bucket."""
    excavator = Sample("excavator")
    excavator.pose({"swing": 0.4, "boom_lift": -0.2, "stick_reach": 0.3, "bucket_curl": curl})
    end_of_link = excavator.placement("bucket_link") @ [0.25, 0, 0, 1]
    pin_of_bucket = excavator.placement("bucket") @ [0, 0, 0.17, 1]
    assert end_of_link == pytest.approx(pin_of_bucket, abs=1e-9)
    assert excavator.joints["rocker_turn"].mimic.joint == "bucket_curl"
