"""What is usual among points as far from the sensor."""

from __future__ import annotations

import numpy as np

from pwralign_kin.estimation.sensing.by_range import usual_at_range
from pwralign_kin.estimation.sensing.scene_options import SceneOptions

RNG = np.random.default_rng(0)


def test_what_is_usual_is_so_at_one_range_and_not_at_another() -> None:
    directions = RNG.normal(size=(4000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    ranges = np.repeat([1.0, 3.0], 2000)
    points, origin = (ranges[:, None] * directions).astype(np.float32), np.zeros(3, np.float32)
    spacing = (0.01 * ranges * RNG.uniform(0.8, 1.2, 4000)).astype(np.float32)
    spacing[::50] = 1.0  # strays
    usual = usual_at_range(spacing, points, origin, SceneOptions())
    np.testing.assert_allclose(usual, 0.01 * ranges, rtol=0.05)


def test_without_a_sensor_it_is_so_at_one_place() -> None:
    places = np.repeat(np.array([[0.2, 0.2, 0.2], [3.2, 0.2, 0.2]]), 500, axis=0)
    points = (places + RNG.uniform(-0.05, 0.05, (1000, 3))).astype(np.float32)
    values = np.repeat(np.float32([1.0, 2.0]), 500)
    np.testing.assert_array_equal(usual_at_range(values, points, None, SceneOptions()), values)
