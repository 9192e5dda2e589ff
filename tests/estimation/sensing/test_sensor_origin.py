"""How a scan is told to have been seen from its sensor origin, or not."""

from __future__ import annotations

import numpy as np
import pytest

import pwralign_kin as pk
from pwralign_kin.estimation.sensing.sensor_origin import edge_on, finely_seen_through, is_view, seen_through


def sphere(count: int) -> np.ndarray:
    outward = np.random.default_rng(0).normal(size=(count, 3))
    return 0.4 * outward / np.linalg.norm(outward, axis=1)[:, None]


def test_an_origin_is_told_that_many_points_are_hidden_from() -> None:
    points, sensor = sphere(8000), np.array([3.0, 0.0, 0.0])
    seen = points[points @ sensor > 0.4**2]
    assert seen_through(pk.Scan(seen, sensor_origin=sensor), 1.0) < 0.1
    assert seen_through(pk.Scan(points, sensor_origin=sensor), 1.0) > 0.3
    assert seen_through(pk.Scan(seen, sensor_origin=[0.0, 3.0, 0.0]), 1.0) > 0.25
    assert seen_through(pk.Scan(points), 1.0) == 0.0
    assert not edge_on(pk.Scan(seen, sensor_origin=[0.0, 3.0, 0.0]), 1.0)


def test_a_plate_in_line_with_the_sensor_does_not_contradict_its_origin() -> None:
    """Its points are at many depths in one pixel; a second plate behind the first is at none in between."""
    rng = np.random.default_rng(0)
    plate = rng.uniform([-0.5, -0.4, 0.0], [0.5, 0.4, 0.005], (8000, 3))
    sensor = [2.0, 0.0, 0.1]
    assert seen_through(pk.Scan(plate, sensor_origin=sensor), 1.0) > 0.25
    assert edge_on(pk.Scan(plate, sensor_origin=sensor), 1.0)
    facing = plate[:, [2, 1, 0]]
    two = np.concatenate([facing, facing - np.array([0.5, 0.0, 0.0])])
    assert not edge_on(pk.Scan(two, sensor_origin=sensor), 1.0)


@pytest.mark.parametrize("noise", [0.0, 0.003])
def test_even_slender_bodies_hide_their_far_sides(noise: float) -> None:
    """They are no deeper than what mixed pixels put behind others, and passed for a view."""
    rng = np.random.default_rng(0)
    turn = rng.uniform(0.0, 2.0 * np.pi, 8000)
    sides = np.stack([0.02 * np.cos(turn), rng.uniform(-0.5, 0.5, 8000), 0.02 * np.sin(turn)], axis=1)
    sensor = np.array([1.5, 0.0, 0.0])
    points = sides + rng.normal(scale=noise, size=sides.shape)
    one, all_around = (pk.Scan(some, sensor_origin=sensor) for some in (points[sides[:, 0] > 0.0], points))
    assert seen_through(all_around, 1.0) < 0.25
    assert finely_seen_through(one, 1.0, noise, 2) < 0.03
    assert finely_seen_through(all_around, 1.0, noise, 2) > 0.1
    assert finely_seen_through(pk.Scan(points), 1.0, noise, 2) == 0.0


def test_a_view_has_all_its_points_before_the_sensor() -> None:
    points = sphere(4000)
    assert is_view(pk.Scan(points, sensor_origin=[0.6, 0.0, 0.0]))
    assert not is_view(pk.Scan(points, sensor_origin=[0.3, 0.0, 0.0]))
    stray = np.concatenate([points, [[2.0, 0.0, 0.0]]])
    assert is_view(pk.Scan(stray, sensor_origin=[0.6, 0.0, 0.0]))
