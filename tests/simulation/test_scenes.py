"""Simulated scenes: rooms with truth, seen by one depth camera."""

from __future__ import annotations

import numpy as np
import pytest

from pwralign_kin.exceptions import OptionError
from pwralign_kin.model import ArticulatedModel
from pwralign_kin.se3 import inverse, transform
from pwralign_kin.simulation import Room, simulate_scene

SMALL = {"columns": 120, "rows": 90}


def test_a_scene_is_mostly_of_other_things_and_knows_the_points_of_the_model(crane: ArticulatedModel) -> None:
    seen = simulate_scene(crane, room=Room(**SMALL, noise=0.0, mixed_pixels=0.0), seed=1)

    own = seen.labels >= 0
    assert 20 < own.sum() < 0.5 * len(own)
    np.testing.assert_array_equal(seen.scan.sensor_origin, np.zeros(3))
    assert (seen.scan.points[:, 2] > 0).all(), "the camera looks along +z"
    placements = seen.state.T_scan_base @ crane.part_placements(crane.values(seen.state.joints))
    for index, part in enumerate(crane.parts):
        local = transform(inverse(placements[index]), seen.scan.points[seen.labels == index])
        low, high = part.vertices.min(axis=0), part.vertices.max(axis=0)
        assert ((local > low - 1e-4) & (local < high + 1e-4)).all()


def test_the_same_seed_gives_the_same_scene(crane: ArticulatedModel) -> None:
    room = Room(**SMALL, contacts=1, occluders=1, second_copy=True)
    first, again, other = (simulate_scene(crane, room=room, seed=seed) for seed in (3, 3, 4))

    np.testing.assert_array_equal(first.scan.points, again.scan.points)
    assert len(first.scan.points) != len(other.scan.points) or (first.scan.points != other.scan.points).any()


def test_a_second_copy_comes_with_its_own_truth(crane: ArticulatedModel) -> None:
    seen = simulate_scene(crane, room=Room(**SMALL, second_copy=True, furniture=0), seed=2)

    (copy,) = seen.copies
    assert not ((copy.labels >= 0) & (seen.labels >= 0)).any()
    assert (copy.labels >= 0).any()
    assert np.linalg.norm(copy.state.T_scan_base[:3, 3] - seen.state.T_scan_base[:3, 3]) > 0.2 * crane.diagonal


def test_what_is_pushed_against_the_model_touches_it(crane: ArticulatedModel) -> None:
    """The points of the things are those that come with them: the nearest to the model is hardly off it."""
    from scipy.spatial import cKDTree

    gaps = []
    for contacts in (0, 6):
        room = Room(noise=0.0, mixed_pixels=0.0, furniture=0, table=False, contacts=contacts)
        seen = simulate_scene(crane, room=room, seed=5)
        points = seen.scan.points
        up = -seen.state.T_scan_base[:3, 2]
        height = -(points @ up)
        # Above the floor, so that only what stands on it counts.
        others = points[(seen.labels < 0) & (height > height[seen.labels >= 0].min() + 0.05 * crane.diagonal)]
        gaps.append(cKDTree(points[seen.labels >= 0]).query(others)[0].min() / crane.diagonal)

    assert gaps[1] < 0.02 < gaps[0]


@pytest.mark.parametrize("fault", [{"size": (2.0, 1.0)}, {"furniture": -1}, {"noise": -1.0}, {"field_of_view": 4.0}])
def test_impossible_rooms_are_refused(fault: dict[str, object]) -> None:
    with pytest.raises(OptionError, match=f"Room.{next(iter(fault))}"):
        Room(**fault)  # type: ignore[arg-type]
