"""The part that each point lies on, against brute force."""

from __future__ import annotations

import numpy as np

from pwralign_kin.estimation.comparison.candidates import Candidates
from pwralign_kin.estimation.comparison.scan_comparison import ScanComparison

BAND = 0.06


def test_points_belong_to_the_part_whose_surface_is_nearest(comparison: ScanComparison) -> None:
    random = np.random.default_rng(0)
    at = Candidates(np.eye(4)[None], 0.3 * np.ones((1, len(comparison.known.values))), np.zeros(1, np.float32))
    placements = comparison.part_placements(at)[0]
    placed = [
        surface.dense @ T[:3, :3].T + T[:3, 3] for T, surface in zip(placements, comparison.surfaces, strict=True)
    ]
    near = np.concatenate(placed)[:: max(1, sum(map(len, placed)) // 1003)]
    points = np.concatenate([near + random.normal(scale=0.02, size=near.shape), random.uniform(-2, 2, (50, 3))])
    distance, part, sample = comparison.native.assign(
        points.astype(np.float32), np.ascontiguousarray(placements), comparison.exists.astype(np.uint8), BAND
    )
    true = np.array([np.linalg.norm(points[:, None] - own[None], axis=2).min(axis=1) for own in placed]).T
    best = true.min(axis=1)
    assert (part[best < 0.8 * BAND] >= 0).all()
    assert (part[best > 1.2 * BAND] < 0).all()
    assert (distance[part < 0] == np.float32(BAND)).all()
    # Cells name the sample nearest to their middle, which stands for a disc around it.
    found = part >= 0
    cell = max(surface.cell for surface in comparison.surfaces)
    assert (distance[found] <= true[found, part[found]] + cell).all()
    clear = found & (np.sort(true, axis=1)[:, 1] > best + 0.02)
    assert clear.sum() > 300
    assert (part[clear] == true[clear].argmin(axis=1)).all()
    assert all(0 <= s < len(comparison.surfaces[p].dense) for s, p in zip(sample[found], part[found], strict=True))


def test_the_order_of_the_points_changes_nothing(comparison: ScanComparison) -> None:
    points = comparison.observation.points
    placements = comparison.part_placements(
        Candidates(np.eye(4)[None], 0.3 * np.ones((1, len(comparison.known.values))), np.zeros(1, np.float32))
    )[0]
    mask = comparison.exists.astype(np.uint8)
    order = np.random.default_rng(0).permutation(len(points))
    given = comparison.native.assign(points, placements, mask, BAND)
    shuffled = comparison.native.assign(np.ascontiguousarray(points[order]), placements, mask, BAND)
    assert (given[1] >= 0).any()
    for before, after in zip(given, shuffled, strict=True):
        assert (before[order] == after).all()


def test_all_scan_points_have_the_owners_that_points_of_any_list_have(comparison: ScanComparison) -> None:
    placements = comparison.part_placements(Candidates.single(np.eye(4), 0.3 * np.ones(len(comparison.known.values))))[
        0
    ]
    mask = comparison.exists.astype(np.uint8)
    own = comparison.native.owners(placements, mask, BAND)
    assert (own[1] >= 0).any()
    for among_all, listed in zip(
        own, comparison.native.assign(comparison.observation.points, placements, mask, BAND), strict=True
    ):
        assert (among_all == listed).all()
