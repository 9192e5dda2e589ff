"""The pieces of a scene that are searched."""

from __future__ import annotations

import numpy as np

from pwralign_kin.estimation.sensing.points import sixth_neighbour
from pwralign_kin.estimation.sensing.regions import areas_of, near_enough, regions_of, with_surroundings
from pwralign_kin.estimation.sensing.scene_options import SceneOptions

RNG = np.random.default_rng(0)
OPTIONS = SceneOptions()
MODEL_AREA = 0.5


def patch(side: float, at: tuple[float, float, float], spacing: float) -> np.ndarray:
    """Points of a level square, about so far apart."""
    count = max(3, int((side / spacing) ** 2))
    return (np.column_stack([side * (RNG.random((count, 2)) - 0.5), np.zeros(count)]) + at).astype(np.float32)


def regions(points: np.ndarray, searched: np.ndarray) -> np.ndarray:
    return regions_of(points, sixth_neighbour(points, 1), searched, MODEL_AREA, OPTIONS)


def test_what_is_too_far_from_the_sensor_to_be_dense_is_not_searched() -> None:
    near, far = patch(1.5, (0.0, 0.0, 2.0), 0.012), patch(4.0, (0.0, 0.0, 9.0), 0.08)
    points, origin = np.concatenate([near, far]), np.zeros(3, np.float32)
    spacing = sixth_neighbour(points, 1)
    found = near_enough(points, spacing, areas_of(spacing), origin, MODEL_AREA, OPTIONS)
    assert found[: len(near)].mean() > 0.95 and not found[len(near) :].any()


def test_regions_are_apart_and_the_largest_is_the_first() -> None:
    small, large = patch(0.3, (-1.0, 0.0, 0.0), 0.01), patch(0.6, (1.0, 0.0, 0.0), 0.01)
    points = np.concatenate([small, large])
    region = regions(points, np.ones(len(points), bool))
    assert (region[: len(small)] == 1).all() and (region[len(small) :] == 0).all()


def test_fragments_are_of_the_region_near_them_and_of_none_far_away() -> None:
    thing, bit, stray = patch(0.5, (0, 0, 0), 0.01), patch(0.03, (0.4, 0, 0), 0.01), patch(0.03, (2, 0, 0), 0.01)
    points = np.concatenate([thing, bit, stray])
    region = regions(points, np.ones(len(points), bool))
    assert (region[: len(thing) + len(bit)] == 0).all() and (region[-len(stray) :] == -1).all()


def test_what_is_not_searched_is_of_no_region() -> None:
    points = patch(0.5, (0, 0, 0), 0.01)
    assert (regions(points, np.zeros(len(points), bool)) == -1).all()
    half = points[:, 0] < 0.0
    assert ((regions(points, half) == 0) == half).all()


def test_surroundings_are_kept_as_far_as_the_margin() -> None:
    thing, near, far = patch(0.4, (0, 0, 0), 0.02), patch(0.2, (0, 0, 0.2), 0.02), patch(0.2, (0, 0, 0.6), 0.02)
    points = np.concatenate([thing, near, far])
    searched = np.arange(len(points)) < len(thing)
    kept = with_surroundings(points, searched, 0.3)
    assert kept[: len(thing) + len(near)].all() and not kept[-len(far) :].any()
