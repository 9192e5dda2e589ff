"""Several scans with one base, and calibration with known joint values."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import pwralign_kin as pk
from pwralign_kin import se3
from pwralign_kin.simulation import TIERS, SimulatedScan

XARM = "xarm_description/urdf/xarm7.urdf"
VALUES = ({"shoulder": 0.4, "elbow": -0.9, "grip": 0.03}, {"shoulder": -0.7, "elbow": 0.8, "grip": 0.08})


def _apart(one: np.ndarray, other: np.ndarray) -> tuple[float, float]:
    """Distance (m) and angle (rad) between two placements."""
    error = se3.inverse(one) @ other
    return float(np.linalg.norm(error[:3, 3])), se3.rotation_angle(error[:3, :3])


@pytest.fixture(scope="module")
def views(arm: pk.ArticulatedModel, single_scan: SimulatedScan) -> list[SimulatedScan]:
    """Two configurations on one base, each from one view."""
    base = single_scan.state.T_scan_base
    return [
        pk.simulate(arm, pk.State(base, values), TIERS["single"], seed=seed)
        for seed, values in zip((5, 6), VALUES, strict=True)
    ]


@pytest.fixture(scope="module")
def shared(arm: pk.ArticulatedModel, views: list[SimulatedScan]) -> pk.SharedBaseEstimate:
    return pk.estimate(arm, [view.scan for view in views])


def test_all_scans_have_one_base_and_their_own_joints(
    shared: pk.SharedBaseEstimate, views: list[SimulatedScan]
) -> None:
    distance, angle = _apart(views[0].state.T_scan_base, shared.T_scan_base)
    assert distance < 0.005
    assert angle < np.radians(1.0)
    for estimate, view in zip(shared.estimates, views, strict=True):
        np.testing.assert_allclose(estimate.state.T_scan_base, shared.T_scan_base, atol=1e-12)
        for name in set(view.state.joints) - set(estimate.undetermined):
            assert estimate.state.joints[name] == pytest.approx(view.state.joints[name], abs=np.radians(2.0))


def test_answers_are_ahead_of_others_as_they_are_alone(arm: pk.ArticulatedModel, single_scan: SimulatedScan) -> None:
    alone = pk.estimate(arm, single_scan.scan)
    (shared,) = pk.estimate(arm, [single_scan.scan]).estimates
    assert shared.evidence.ahead == pytest.approx(alone.evidence.ahead, rel=0.3)
    assert shared.cost == pytest.approx(alone.cost, rel=0.1)


def test_covariances_are_those_of_the_shared_base(shared: pk.SharedBaseEstimate) -> None:
    assert shared.base_covariance.shape == (6, 6)
    assert (np.linalg.eigvalsh(shared.base_covariance) > 0).all()
    for estimate in shared.estimates:
        np.testing.assert_allclose(estimate.covariance[:6, :6], shared.base_covariance, rtol=1e-6, atol=1e-15)
    assert json.loads(json.dumps(shared.to_dict(), allow_nan=False))["base_link"] == "base"
    assert "standard deviation" in str(shared)


def test_options_are_told_once_and_only_where_they_differ(arm: pk.ArticulatedModel, views: list[SimulatedScan]) -> None:
    options = pk.EstimatorOptions(
        seed=3, base=pk.BasePrior(T_scan_base=np.eye(4), translation_std=5.0, rotation_std=None)
    )
    told = pk.calibrate(arm, [view.scan for view in views], VALUES, options).to_dict()
    base = {"T_scan_base": np.eye(4).tolist(), "translation_std": 5.0, "rotation_std": None}
    assert json.loads(json.dumps(told["options"])) == {"seed": 3, "base": base, "locked": list(VALUES[0])}
    assert [own["options"] for own in told["estimates"]] == [{"prior": values} for values in VALUES]


def test_a_scan_that_goes_wrong_alone_follows_the_others(arm: pk.ArticulatedModel, views: list[SimulatedScan]) -> None:
    base, values = views[0].state.T_scan_base, VALUES[0]
    only_jaw_and_lower = TIERS["single"]
    third = pk.simulate(arm, pk.State(base, values), replace(only_jaw_and_lower, missing_parts=("base",)), seed=9)
    shared = pk.estimate(arm, [*(view.scan for view in views), third.scan])
    distance, angle = _apart(base, shared.T_scan_base)
    assert distance < 0.005
    assert angle < np.radians(1.0)
    assert shared.estimates[2].state.joints["elbow"] == pytest.approx(values["elbow"], abs=np.radians(2.0))


def test_calibration_keeps_the_joints_and_finds_the_base(arm: pk.ArticulatedModel, views: list[SimulatedScan]) -> None:
    found = pk.calibrate(arm, [view.scan for view in views], VALUES)
    distance, angle = _apart(views[0].state.T_scan_base, found.T_scan_base)
    assert distance < 0.003
    assert angle < np.radians(0.5)
    for estimate, values in zip(found.estimates, VALUES, strict=True):
        assert dict(estimate.state.joints) == pytest.approx(values)


def test_numbers_of_scans_and_values_must_agree(arm: pk.ArticulatedModel, views: list[SimulatedScan]) -> None:
    scans = [view.scan for view in views]
    with pytest.raises(pk.PwralignError, match="as many sets of joint values as scans, 2, got 1"):
        pk.calibrate(arm, scans, VALUES[:1])
    with pytest.raises(pk.PwralignError, match="as scans, 2, got 1 and 2"):
        pk.estimate(arm, scans, initial=[views[0].state])
    with pytest.raises(pk.PwralignError, match="got none"):
        pk.estimate(arm, [])
    with pytest.raises(pk.PwralignError, match="no joint named 'elbo'"):
        pk.calibrate(arm, scans, [{"elbo": 0.1}] * 2)


@pytest.mark.slow
def test_the_base_repeats_on_real_frames(wheel_folder: Path, shared_folder: Path) -> None:
    folder = shared_folder / "real" / "xarm7"
    if not folder.is_dir():
        pytest.skip(f"the real frames are not in {folder}")
    model = pk.ArticulatedModel.from_urdf(wheel_folder / XARM, package_dirs=[wheel_folder.parent.parent])
    truth = json.loads((folder / "truth.json").read_text())
    names = sorted(truth)
    scans = [pk.Scan.load(folder / f"{name}_robot.ply", sensor_origin=(0, 0, 0)) for name in names]
    joints = [truth[name]["joints"] for name in names]
    first, second = pk.calibrate(model, scans[:3], joints[:3]), pk.calibrate(model, scans[3:], joints[3:])
    distance, angle = _apart(first.T_scan_base, second.T_scan_base)
    assert distance < 0.005
    assert angle < np.radians(1.0)
    assert first.contradicted == second.contradicted == []
    # Of one frame the encoders tell an arm 2% D beside its points: that is doubted.
    assert sorted(estimate.confidence for estimate in (*first.estimates, *second.estimates))[1] > 0.9
