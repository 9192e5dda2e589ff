"""Joint values that calibration is given wrongly are told by the scans."""

from __future__ import annotations

import numpy as np
import pytest

import pwralign_kin as pk
from pwralign_kin.simulation import TIERS, SimulatedScan

VALUES = (
    {"shoulder": 0.4, "elbow": -0.9, "grip": 0.03},
    {"shoulder": -0.7, "elbow": 0.8, "grip": 0.08},
    {"shoulder": 0.1, "elbow": 0.3, "grip": 0.05},
)


@pytest.fixture(scope="module")
def scans(arm: pk.ArticulatedModel, single_scan: SimulatedScan) -> list[pk.Scan]:
    base = single_scan.state.T_scan_base
    return [
        pk.simulate(arm, pk.State(base, values), TIERS["single"], seed=seed).scan for seed, values in enumerate(VALUES)
    ]


def _calibrated(
    arm: pk.ArticulatedModel, scans: list[pk.Scan], errors: tuple[float, float, float]
) -> pk.SharedBaseEstimate:
    """Calibrate with the elbow's values wrong by so much in each scan."""
    given = [{**values, "elbow": values["elbow"] + error} for values, error in zip(VALUES, errors, strict=True)]
    return pk.calibrate(arm, scans, given)


def test_right_values_are_not_contradicted(arm: pk.ArticulatedModel, scans: list[pk.Scan]) -> None:
    found = _calibrated(arm, scans, (0.0, 0.0, 0.0))
    assert found.contradicted == []
    for offset in found.offsets.shared.values():
        assert abs(offset.value) < 3.0 * offset.std


def test_the_zero_of_an_encoder_is_told(arm: pk.ArticulatedModel, scans: list[pk.Scan]) -> None:
    found = _calibrated(arm, scans, (0.1, 0.1, 0.1))
    assert found.offsets.shared["elbow"].value == pytest.approx(-0.1, abs=np.radians(0.5))
    assert [(scan, name) for scan, name, _ in found.offsets.large()] == [(None, "elbow")]
    assert "elbow seems -5." in str(found)


def test_the_scan_whose_values_are_wrong_is_named(arm: pk.ArticulatedModel, scans: list[pk.Scan]) -> None:
    found = _calibrated(arm, scans, (0.0, 0.0, 0.12))
    assert (2, "elbow") in [(scan, name) for scan, name, _ in found.offsets.large()]


def test_joints_that_were_not_given_have_no_offset(arm: pk.ArticulatedModel, scans: list[pk.Scan]) -> None:
    given = [{name: values[name] for name in ("shoulder", "grip")} for values in VALUES]
    found = pk.calibrate(arm, scans, given)
    assert set(found.offsets.shared) == {"shoulder", "grip"}
    assert found.contradicted == []
    assert pk.estimate(arm, scans).offsets.shared == {}
