"""The region of interest holds whatever the joints can do to a part, and not much more."""

from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest

import pwralign_kin as pk
from pwralign_kin.estimation.search.region_of_interest import path_between, region_of_interest
from pwralign_kin.estimation.search.tree_search import TreeSearch
from pwralign_kin.se3 import Array


@pytest.fixture(scope="module")
def placed(arm: pk.ArticulatedModel, search: TreeSearch, units: np.ndarray) -> Array:
    """Placements (m, parts, 4, 4) of all parts in random configurations."""
    values = np.random.default_rng(0).uniform(arm.lower, arm.upper, (60, len(units))) / units
    return np.asarray(search.model.forward(np.tile(np.eye(4), (len(values), 1, 1)), values))


def farthest(search: TreeSearch, placed: Array, part: int, anchor: int, centre: Array) -> float:
    """Return how far the part comes from `centre`, given in the frame of the anchor, over all configurations."""
    relative = np.linalg.inv(placed[:, anchor]) @ placed[:, part]
    samples = search.surfaces[part].samples @ np.swapaxes(relative[:, :3, :3], 1, 2) + relative[:, None, :3, 3]
    return float(np.linalg.norm(samples - centre, axis=-1).max())


def test_no_configuration_takes_a_part_out_of_its_region(
    arm: pk.ArticulatedModel, search: TreeSearch, placed: Array
) -> None:
    fullness = []
    for part, anchor in permutations(range(len(arm.parts)), 2):
        way = path_between(search.parent, part, anchor)
        for now in placed[:10]:
            ball = region_of_interest(search, now, way)
            within_anchor = np.linalg.inv(now[anchor]) @ np.append(ball.centre, 1.0)
            reached = farthest(search, placed, part, anchor, within_anchor[:3])
            assert reached <= ball.radius + 1e-6
            fullness.append(reached / ball.radius)
    assert np.median(fullness) > 0.6
