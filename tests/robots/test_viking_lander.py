"""The Viking-style lander against the published facts."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial import ConvexHull

LEGS = ("leg_1", "leg_2", "leg_3")


@pytest.fixture(autouse=True)
def at_rest(lander):
    lander.pose({})


def footpads(lander):
    pads = [lander.vertices(leg, "titanium") for leg in LEGS]
    return np.array([(pad.min(axis=0) + pad.max(axis=0)) / 2 for pad in pads]), pads


def test_body_is_a_hexagon_with_sides_of_1_09_and_0_56_m(lander):
    keel = lander.vertices("body", "white")
    keel = keel[np.abs(keel[:, 2] - 0.44) < 1e-5][:, :2]
    corners = keel[ConvexHull(keel).vertices]
    assert len(corners) == 6
    sides = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1)
    sides = sides if sides[0] > sides[1] else np.roll(sides, 1)
    assert sides == pytest.approx([1.09, 0.56] * 3, abs=1e-4)


def test_footpads_stand_on_an_equilateral_triangle_of_2_21_m(lander):
    centres, pads = footpads(lander)
    for first, second in ((0, 1), (1, 2), (2, 0)):
        assert np.linalg.norm(centres[first, :2] - centres[second, :2]) == pytest.approx(2.21, abs=2e-3)
    assert [pad[:, 2].min() for pad in pads] == pytest.approx([0.0] * 3, abs=1e-6)


def test_long_sides_lie_in_line_with_two_footpads(lander):
    keel = lander.vertices("body", "white")
    front = keel[np.abs(keel[:, 2] - 0.44) < 1e-5][:, 0].max()
    centres, _ = footpads(lander)
    assert centres[1:, 0] == pytest.approx([front, front], abs=2e-3)


def test_overall_size_is_about_2_by_3_m(lander):
    points = np.vstack([lander.vertices(link.name) for link in lander.urdf.robot.links if link.visuals])
    size = np.ptp(points, axis=0)
    assert 1.95 < size[2] < 2.2
    assert 2.85 < size[0] < 3.15


def test_dish_measures_0_76_m_and_turns_about_two_axes(lander):
    dish = lander.vertices("antenna_dish", "white")
    assert np.ptp(dish[:, 1]) == pytest.approx(0.76, abs=1e-3)
    azimuth, elevation = lander.joints["antenna_azimuth"], lander.joints["antenna_elevation"]
    assert azimuth.child == elevation.parent
    assert abs(np.dot(azimuth.axis, elevation.axis)) < 1e-12
    mast = lander.placement("antenna_yoke")[:2, 3]
    assert np.linalg.norm(mast) > 0.6, "the mast stands near an edge"


def test_sampler_ranges(lander):
    def span(name):
        return lander.joints[name].limit.upper - lander.joints[name].limit.lower

    assert np.degrees(span("sampler_azimuth")) == pytest.approx(288.0)
    assert np.degrees(span("sampler_elevation")) == pytest.approx(74.0)
    assert span("sampler_extension") == pytest.approx(3.0)
    assert lander.joints["sampler_extension"].type == "prismatic"


@pytest.mark.parametrize("extension", [0.0, 1.3, 3.0])
def test_boom_sections_stay_within_each_other(lander, extension):
    lander.pose({"sampler_extension": extension})
    chain = ["sampler_housing", *(f"sampler_boom_{k}" for k in range(1, 5)), "sampler_boom"]
    for outer, inner in pairwise(chain):
        overlap = lander.vertices(outer)[:, 0].max() - lander.vertices(inner)[:, 0].min()
        assert overlap > 0.05
    tip = lander.vertices("collector_head")[:, 0].max() - lander.placement("sampler_turret")[0, 3]
    assert tip == pytest.approx(0.93 + extension, abs=1e-4)


def test_cameras_stand_0_8_m_apart_with_the_arm_between_them(lander):
    windows = lander.vertices("body", "dark")
    windows = windows[windows[:, 0] > 0.4]
    left, right = windows[windows[:, 1] > 0], windows[windows[:, 1] < 0]
    assert left[:, 2].mean() == pytest.approx(1.30, abs=1e-3)
    assert left[:, 1].mean() - right[:, 1].mean() == pytest.approx(0.8, abs=0.04)
    assert abs(lander.placement("sampler_turret")[1, 3]) < 0.1


def test_meteorology_boom_swings_from_the_leg_to_1_6_m_above_the_ground(lander):
    stowed = lander.vertices("meteorology_boom", "white")
    lander.pose({"meteorology_hinge": lander.joints["meteorology_hinge"].limit.upper - 0.04})
    deployed = lander.vertices("meteorology_boom", "white")
    assert stowed[:, 2].max() < 0.5
    assert deployed[:, 2].mean() == pytest.approx(1.6, abs=0.1)
