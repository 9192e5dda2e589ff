"""A scan in left-handed coordinates: told in the evidence, the confidence and the log."""

from __future__ import annotations

import logging

import numpy as np
import pytest

import pwralign_kin as pk
from pwralign_kin.simulation import TIERS


@pytest.mark.parametrize("sensor", [pk.Sensor(), TIERS["hololens"]])
def test_a_mirrored_scan_is_told(arm: pk.ArticulatedModel, caplog: pytest.LogCaptureFixture, sensor: pk.Sensor) -> None:
    scan = pk.simulate(arm, sensor=sensor, seed=0).scan.mirrored()
    with caplog.at_level(logging.WARNING, logger="pwralign_kin"):
        estimate = pk.estimate(arm, scan)
    assert estimate.confidence < 0.5
    assert "left-handed" in caplog.text


def test_what_else_makes_points_astray_is_not_taken_for_a_mirror_image(
    arm: pk.ArticulatedModel, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.WARNING, logger="pwralign_kin"):
        estimate = pk.estimate(arm, pk.simulate(arm, seed=0).scan.scaled(1.07))
    assert estimate.evidence.strange + estimate.evidence.astray > 0.02
    assert estimate.evidence.mirrored == 0.0
    assert "left-handed" not in caplog.text


def test_knowledge_in_the_frame_of_the_scan_tells_its_hand(arm: pk.ArticulatedModel) -> None:
    simulated = pk.simulate(arm, seed=0)
    up = tuple((np.diag([1.0, 1.0, -1.0]) @ simulated.state.T_scan_base[:3, 2]).tolist())
    options = pk.EstimatorOptions(base=pk.BasePrior(up=up))
    assert pk.estimate(arm, simulated.scan.mirrored(), options=options).evidence.mirrored == 0.0
