"""Plates that are seen from their inner side only, by nobody knows whom."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import pwralign_kin as pk
from pwralign_kin.estimation.answers.one_sided import turned_over
from pwralign_kin.estimation.comparison.candidates import Candidates
from pwralign_kin.estimation.comparison.scan_comparison import ScanComparison, Sought
from pwralign_kin.estimation.comparison.search_options import SearchOptions
from pwralign_kin.estimation.knowledge.prior import SearchPrior
from pwralign_kin.estimation.sensing.observation import ObservationOptions
from pwralign_kin.estimation.sensing.preparation import observe
from pwralign_kin.simulation import random_state


@pytest.fixture(scope="module")
def laptop(robots_folder: Path) -> pk.ArticulatedModel:
    return pk.ArticulatedModel.from_urdf(robots_folder / "laptop" / "laptop.urdf")


def seen_from_within(laptop: pk.ArticulatedModel, hinge: float, where: int, views: tuple[int, int]) -> pk.Scan:
    """Two views between lid and base, fused without telling where they were taken from."""
    state = pk.State(random_state(laptop, where).T_scan_base, {"lid_hinge": hinge})
    sensor = pk.Sensor(views=1, points=2500, noise=0.001)
    return pk.Scan(np.concatenate([pk.simulate(laptop, state, sensor, seed).scan.points for seed in views]))


@pytest.mark.parametrize(("hinge", "where", "views"), [(0.5, 0, (1, 12)), (0.9, 2, (2001, 2002))])
def test_a_laptop_seen_from_within_is_not_turned_inside_out(
    laptop: pk.ArticulatedModel, hinge: float, where: int, views: tuple[int, int]
) -> None:
    """Outside is the open side, and was taken for the one that was seen: parts were off by 14 and 25%."""
    estimate = pk.estimate(laptop, seen_from_within(laptop, hinge, where, views))
    truth = random_state(laptop, where).T_scan_base
    assert abs(estimate.state.joints["lid_hinge"] - hinge) < 0.02
    assert np.linalg.norm((estimate.state.T_scan_base - truth)[:3, 3]) < 0.01 * laptop.diagonal
    assert estimate.confidence > 0.8


def searched(laptop: pk.ArticulatedModel, scan: pk.Scan, turned: np.ndarray | None = None) -> ScanComparison:
    observation = observe(scan, laptop.diagonal, ObservationOptions(), 2, turned)
    return ScanComparison(
        Sought(laptop.kernel_model, laptop.surfaces, SearchOptions(), 2), observation, SearchPrior.nothing(np.zeros(1))
    )


def test_what_is_seen_from_one_side_is_turned_over_part_by_part(laptop: pk.ArticulatedModel) -> None:
    scan = seen_from_within(laptop, 0.5, 0, (1, 12))
    comparison = searched(laptop, scan)
    T = comparison.observation.to_search(random_state(laptop, 0).T_scan_base)
    over = turned_over(comparison, Candidates.single(T, np.array([0.5])))
    assert 1 <= len(over) <= 2
    again = searched(laptop, scan, over[0])
    before, after = comparison.observation.normals, again.observation.normals
    assert np.array_equal(after[over[0]], -before[over[0]])
    assert np.array_equal(after[~over[0]], before[~over[0]])


def test_what_is_seen_from_both_sides_is_left_alone(laptop: pk.ArticulatedModel) -> None:
    simulated = pk.simulate(laptop, seed=4)
    comparison = searched(laptop, simulated.scan)
    T = comparison.observation.to_search(simulated.state.T_scan_base)
    assert turned_over(comparison, Candidates.single(T, laptop.values(simulated.state.joints))) == []
