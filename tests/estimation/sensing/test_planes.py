"""Planes wider than the model, among what may be of it."""

from __future__ import annotations

import numpy as np
import pytest

from pwralign_kin.estimation.sensing.observation import ObservationOptions
from pwralign_kin.estimation.sensing.planes import Cloud, Size, wide_plane, wide_planes
from pwralign_kin.estimation.sensing.points import sixth_neighbour
from pwralign_kin.estimation.sensing.regions import areas_of
from pwralign_kin.estimation.sensing.scene_options import SceneOptions

RNG = np.random.default_rng(0)


def square(side: float, height: float, count: int) -> np.ndarray:
    """Points of a level square about the vertical axis."""
    return np.column_stack([side * (RNG.random((count, 2)) - 0.5), np.full(count, height)]).astype(np.float32)


def cube(side: float, count: int) -> np.ndarray:
    points = RNG.random((count, 3))
    points[np.arange(count), RNG.integers(0, 3, count)] = RNG.integers(0, 2, count)
    return (side * (points - 0.5)).astype(np.float32)


def background(points: np.ndarray, least: Size) -> np.ndarray:
    areas = areas_of(sixth_neighbour(points, 1))
    return wide_planes(Cloud.of(points, areas, None, SceneOptions(), 1), least, SceneOptions())


@pytest.mark.parametrize(("side", "wide"), [(2.0, True), (0.5, False)])
def test_the_dominant_plane_counts_where_it_is_wide(side: float, wide: bool) -> None:
    points = np.concatenate([square(side, -0.3, 8000), cube(0.4, 4000)])
    found = wide_plane(points, ObservationOptions(), 0.3, 1)
    assert (found is not None) == wide
    if found is not None:
        centre, normal = found
        assert abs(normal[2]) > 0.999 and abs(centre[2] + 0.3) < 0.01


def test_no_plane_is_found_where_there_is_none() -> None:
    ball = RNG.normal(size=(8000, 3))
    ball *= 0.5 / np.linalg.norm(ball, axis=1, keepdims=True)
    assert wide_plane(ball.astype(np.float32), ObservationOptions(), 0.3, 1) is None


def test_a_floor_is_background_and_a_cube_above_it_is_not() -> None:
    floor, thing = square(3.0, -0.6, 20000), cube(0.4, 4000)
    found = background(np.concatenate([floor, thing]), Size(0.3, 1.0))
    assert found[: len(floor)].mean() > 0.98 and not found[len(floor) :].any()


def test_small_pieces_of_one_plane_are_no_wide_one_together() -> None:
    tiles = [square(0.3, 0.0, 1500) + np.float32([x, y, 0.0]) for x in (-0.5, 0.0, 0.5) for y in (-0.5, 0.0, 0.5)]
    assert not background(np.concatenate(tiles), Size(0.2, 0.05)).any()
    assert background(square(1.3, 0.0, 12000), Size(0.2, 0.05)).mean() > 0.98
