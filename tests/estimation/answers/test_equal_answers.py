"""Answers that a model's symmetry makes equal are listed, whether or not a search has found them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import pwralign_kin as pk
from pwralign_kin import se3
from pwralign_kin.estimation.evidence.confidence import confidence
from pwralign_kin.model.symmetry import find_symmetry
from pwralign_kin.simulation import FULL, SimulatedScan

LEG = """
  <link name="{name}">
    <visual><origin xyz="0 {y} -0.15"/><geometry><box size="0.1 0.06 0.4"/></geometry></visual>
    <visual><origin xyz="0 {foot} -0.33"/><geometry><box size="0.1 0.1 0.04"/></geometry></visual>
  </link>
  <joint name="{name}_hip" type="revolute">
    <parent link="body"/><child link="{name}"/><origin xyz="{x} {y} 0"/><axis xyz="0 1 0"/>
    <limit lower="-1.5" upper="1.5" effort="1" velocity="1"/>
  </joint>"""

WALKER = (
    '<robot name="walker"><link name="body"><visual><geometry><box size="0.6 0.24 0.12"/></geometry></visual></link>'
    + LEG.format(name="left", x=0.2, y=0.05, foot=0.13)
    + LEG.format(name="right", x=-0.2, y=-0.05, foot=-0.13)
    + "</robot>"
)
"""A body that looks the same from both ends, and two legs with feet to the outside, of which a half-turn makes one the
other."""


@pytest.fixture(scope="module")
def walker(tmp_path_factory: pytest.TempPathFactory) -> pk.ArticulatedModel:
    path = tmp_path_factory.mktemp("walker") / "walker.urdf"
    path.write_text(WALKER)
    return pk.ArticulatedModel.from_urdf(path)


@pytest.fixture(scope="module")
def scanned(walker: pk.ArticulatedModel) -> SimulatedScan:
    return pk.simulate(walker, pk.State(np.eye(4), {"left_hip": 0.7, "right_hip": -0.2}), seed=2)


def test_interchanged_legs_are_an_equal_answer(walker: pk.ArticulatedModel, scanned: SimulatedScan) -> None:
    estimate = pk.estimate(walker, scanned.scan, initial=scanned.state)
    left, right = estimate.state.joints["left_hip"], estimate.state.joints["right_hip"]
    (other,) = [other for other in estimate.alternatives if other.equal]
    assert other.cost == pytest.approx(estimate.cost, abs=0.02)
    assert other.state.joints["left_hip"] == pytest.approx(-right, abs=0.01)
    assert other.state.joints["right_hip"] == pytest.approx(-left, abs=0.01)
    turn = se3.inverse(estimate.state.T_scan_base) @ other.state.T_scan_base
    np.testing.assert_allclose(turn[:3, :3], np.diag([-1.0, -1.0, 1.0]), atol=0.02)
    assert np.linalg.norm(turn[:3, 3]) < 0.01


def test_an_equal_answer_leaves_none_ahead(walker: pk.ArticulatedModel, scanned: SimulatedScan) -> None:
    estimate = pk.estimate(walker, scanned.scan)
    assert estimate.evidence.ahead == pytest.approx(min(own.cost - estimate.cost for own in estimate.alternatives))
    assert estimate.evidence.ahead < 0.01
    alone = replace(estimate.evidence, ahead=1.0)
    assert estimate.confidence == confidence(estimate.evidence) < confidence(alone)


def test_limits_forbid_what_only_looks_equal(walker: pk.ArticulatedModel, scanned: SimulatedScan) -> None:
    locked = pk.EstimatorOptions(locked=("left_hip",))
    estimate = pk.estimate(walker, scanned.scan, initial=scanned.state, options=locked)
    assert all(other.state.joints["left_hip"] == pytest.approx(0.7) for other in estimate.alternatives)


def test_a_model_without_symmetry_has_no_equal_answers(arm: pk.ArticulatedModel, full_scan: SimulatedScan) -> None:
    estimate = pk.estimate(arm, full_scan.scan, initial=full_scan.state)
    assert not any(other.equal for other in estimate.alternatives)


def test_parts_are_sorted_by_their_looks(walker: pk.ArticulatedModel) -> None:
    symmetry = find_symmetry(walker.surfaces)
    assert symmetry.kind.tolist() == [0, 1, 1]
    assert [len(turns) for turns in symmetry.turns] == [4, 1, 0]
    lengths = np.linalg.norm(symmetry.to_kind[2][:3, 3])
    assert lengths < 0.01
    np.testing.assert_allclose(symmetry.to_kind[2][:3, :3], np.diag([-1.0, -1.0, 1.0]), atol=0.02)


def test_mirror_images_do_not_look_alike(tmp_path: Path) -> None:
    path = tmp_path / "hands.urdf"
    path.write_text(WALKER.replace("0 -0.13 -0.33", "0.04 -0.13 -0.33").replace("0 0.13 -0.33", "0.04 0.13 -0.33"))
    assert find_symmetry(pk.ArticulatedModel.from_urdf(path).surfaces).kind.tolist() == [0, 1, 2]


PLATE = '<visual><origin xyz="0.27 0 0.06"/><geometry><box size="0.05 0.2 0.01"/></geometry></visual>'
"""A plate on one end of the body, about as thick as the noise."""


def test_a_detail_no_thicker_than_the_noise_tells_the_ends_apart(tmp_path: Path) -> None:
    path = tmp_path / "walker.urdf"
    path.write_text(WALKER.replace('<link name="body">', f'<link name="body">{PLATE}'))
    model = pk.ArticulatedModel.from_urdf(path)
    assert model.symmetry.turns[0].shape[0] > 1
    for seed in range(4):
        truth = pk.State(np.eye(4), {"left_hip": 0.7 - seed / 5, "right_hip": -0.2})
        scan = pk.simulate(model, truth, sensor=replace(FULL, noise=0.005), seed=seed).scan
        estimate = pk.estimate(model, scan, options=pk.EstimatorOptions(seed=seed))
        assert estimate.state.joints["left_hip"] == pytest.approx(truth.joints["left_hip"], abs=0.05)
        assert [other for other in estimate.alternatives if other.equal]


def test_of_equal_answers_the_one_near_the_guess_is_meant(walker: pk.ArticulatedModel, scanned: SimulatedScan) -> None:
    first = pk.estimate(walker, scanned.scan)
    (other,) = [other for other in first.alternatives if other.equal]
    for meant in (first.state, other.state):
        found = pk.estimate(walker, scanned.scan, initial=meant).state
        assert found.joints["left_hip"] == pytest.approx(meant.joints["left_hip"], abs=0.01)


def test_of_equal_answers_the_one_near_the_prior_is_meant(walker: pk.ArticulatedModel, scanned: SimulatedScan) -> None:
    first = pk.estimate(walker, scanned.scan)
    (other,) = [other for other in first.alternatives if other.equal]
    for meant in (first.state, other.state):
        found = pk.estimate(walker, scanned.scan, options=pk.EstimatorOptions(prior=meant.joints)).state
        assert found.joints["left_hip"] == pytest.approx(meant.joints["left_hip"], abs=0.01)
