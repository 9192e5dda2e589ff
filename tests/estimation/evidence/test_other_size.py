"""A scan of the model at another size: told in the evidence, the confidence and the log."""

from __future__ import annotations

import logging

import pytest

import pwralign_kin as pk
from pwralign_kin.simulation import TIERS


@pytest.mark.parametrize("factor", [0.9, 1.07, 1.15])
def test_a_model_of_another_size_is_told(
    arm: pk.ArticulatedModel, caplog: pytest.LogCaptureFixture, factor: float
) -> None:
    scan = pk.simulate(arm, seed=0).scan.scaled(factor)
    with caplog.at_level(logging.WARNING, logger="pwralign_kin"):
        estimate = pk.estimate(arm, scan)
    assert estimate.evidence.size == pytest.approx(factor, rel=0.03)
    assert estimate.confidence < 0.5
    assert f"about {estimate.evidence.size:.2f} times as large" in caplog.text


@pytest.mark.parametrize("sensor", [pk.Sensor(), pk.Sensor(noise=0.01), TIERS["hololens"]])
def test_a_model_of_the_right_size_is_not(
    arm: pk.ArticulatedModel, caplog: pytest.LogCaptureFixture, sensor: pk.Sensor
) -> None:
    with caplog.at_level(logging.WARNING, logger="pwralign_kin"):
        estimate = pk.estimate(arm, pk.simulate(arm, sensor=sensor, seed=1).scan)
    assert (estimate.evidence.size, estimate.evidence.size_gain) == (1.0, 0.0)
    assert caplog.text == ""
