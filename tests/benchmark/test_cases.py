"""Cases are the same for everyone, and labelled right."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from pwralign_kin import files
from pwralign_kin.benchmark.cases import (
    PARKED,
    ROBOTS,
    SENSORS,
    load_robot,
    load_sample,
    nearest_parts,
    sample_cases,
    sample_names,
    simulated_case,
)
from pwralign_kin.exceptions import UnknownNameError
from pwralign_kin.model import ArticulatedModel
from pwralign_kin.scan import write_ply
from pwralign_kin.simulation import TIERS, simulate


def test_the_same_case_has_the_same_points(twins: ArticulatedModel) -> None:
    first, again = (simulated_case(twins, "twins", "hololens", 1) for _ in range(2))
    assert np.array_equal(first.scan.points, again.scan.points)
    assert np.array_equal(first.labels, again.labels)
    assert first.truth.to_dict() == again.truth.to_dict()


def test_robots_and_configurations_differ(twins: ArticulatedModel) -> None:
    cases = [simulated_case(twins, robot, "sparse", n) for robot, n in (("a", 0), ("a", 1), ("b", 0))]
    angles = [case.truth.joints["left_hip"] for case in cases]
    assert len({round(angle, 6) for angle in angles}) == 3


def test_tiers_of_a_configuration_share_its_state(twins: ArticulatedModel) -> None:
    single, warm, sparse = (simulated_case(twins, "twins", tier, 0) for tier in ("single", "warm", "sparse"))
    assert single.truth.to_dict() == warm.truth.to_dict() == sparse.truth.to_dict()
    assert np.array_equal(single.scan.points, warm.scan.points)
    assert single.guess is None and warm.guess is not None
    assert single.scan.sensor_origin is not None and sparse.scan.sensor_origin is None


def test_parked_joints_rest_at_limits(twins: ArticulatedModel) -> None:
    states = [simulated_case(twins, "twins", PARKED, n).truth for n in range(8)]
    values = np.array([twins.values(state.joints) for state in states])
    at_limit = (values == twins.lower) | (values == twins.upper)
    assert 0.2 < at_limit[:, ~twins.continuous].mean() < 0.8
    assert not at_limit[:, twins.continuous].any()


def test_unknown_names_are_told() -> None:
    with pytest.raises(UnknownNameError, match="did you mean 'panda'"):
        load_robot("pandda")
    with pytest.raises(UnknownNameError, match="did you mean 'full'"):
        simulated_case(None, "panda", "ful", 0)  # type: ignore[arg-type]


def test_every_tier_of_the_simulation_is_there() -> None:
    assert set(TIERS) < set(SENSORS)
    assert len(ROBOTS) == 12


def test_points_belong_to_the_part_that_was_hit(twins: ArticulatedModel) -> None:
    case = simulated_case(twins, "twins", "hololens", 0)
    labels = nearest_parts(twins, case.truth, case.scan)
    both = (labels >= 0) & (case.labels >= 0)
    assert both.mean() > 0.5
    assert np.mean(labels[both] == case.labels[both]) > 0.97  # where parts touch, noise decides
    assert np.mean(labels[case.labels < 0] < 0) > 0.8


def test_sample_scans_are_read_with_their_truth(twins_path: Path, twins: ArticulatedModel) -> None:
    folder = twins_path.parent.parent
    made = simulate(twins, None, TIERS["single"], 3)
    scans = twins_path.parent / "scans"
    write_ply(scans / "single.ply", made.scan.points.astype(np.float32))
    truth = {**made.state.to_dict(), "sensor_origin": made.view_origins[0].tolist()}
    files.write_text(scans / "single_truth.json", json.dumps(truth))

    assert sample_names(folder) == ["twins"]
    (case,) = sample_cases(load_sample(folder, "twins"), folder, "twins")
    assert case.tier == "single"
    assert case.truth.joints == made.state.joints
    assert case.scan.sensor_origin == pytest.approx(made.view_origins[0])
    assert np.mean(case.labels == made.labels[: len(case.labels)]) > 0.9
