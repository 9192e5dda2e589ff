"""The region of interest holds whatever the joints can do to a part, and not much more."""

from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest

import pwralign_kin as pk
from pwralign_kin.estimation.comparison.scan_comparison import ScanComparison
from pwralign_kin.estimation.search.region_of_interest import path_between, region_of_interest, subtrees
from pwralign_kin.se3 import Array


@pytest.fixture(scope="module")
def placed(arm: pk.ArticulatedModel, comparison: ScanComparison, units: np.ndarray) -> Array:
    """Placements (m, parts, 4, 4) of all parts in random configurations."""
    values = np.random.default_rng(0).uniform(arm.lower, arm.upper, (60, len(units))) / units
    return np.asarray(comparison.model.forward(np.tile(np.eye(4), (len(values), 1, 1)), values))


def farthest(comparison: ScanComparison, placed: Array, part: int, anchor: int, centre: Array) -> float:
    """Return how far the part comes from `centre`, given in the frame of the anchor, over all configurations."""
    relative = np.linalg.inv(placed[:, anchor]) @ placed[:, part]
    samples = comparison.surfaces[part].samples @ np.swapaxes(relative[:, :3, :3], 1, 2) + relative[:, None, :3, 3]
    return float(np.linalg.norm(samples - centre, axis=-1).max())


def test_no_configuration_takes_a_part_out_of_its_region(
    arm: pk.ArticulatedModel, comparison: ScanComparison, placed: Array
) -> None:
    fullness = []
    for part, anchor in permutations(range(len(arm.parts)), 2):
        way = path_between(comparison.parent, part, anchor)
        for now in placed[:10]:
            ball = region_of_interest(comparison, now, way)
            within_anchor = np.linalg.inv(now[anchor]) @ np.append(ball.centre, 1.0)
            reached = farthest(comparison, placed, part, anchor, within_anchor[:3])
            assert reached <= ball.radius + 1e-6
            fullness.append(reached / ball.radius)
    assert np.median(fullness) > 0.6


def test_a_subtree_is_a_part_and_all_that_hangs_on_it(comparison: ScanComparison) -> None:
    below, parent = subtrees(comparison.parent), comparison.parent
    for part in range(len(parent)):
        above = path_between(parent, part, 0)
        np.testing.assert_array_equal(np.flatnonzero(below[:, part]), sorted(above))
