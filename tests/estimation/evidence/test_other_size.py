"""A scan of the model at another size: told in the evidence, the confidence and the log."""

from __future__ import annotations

import logging
from pathlib import Path

import pytest

import pwralign_kin as pk
from pwralign_kin.simulation import TIERS


@pytest.fixture(scope="module")
def laptop(repository: Path) -> pk.ArticulatedModel:
    return pk.ArticulatedModel.from_urdf(repository / "robots/laptop/laptop.urdf")


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


@pytest.mark.parametrize(("tier", "factor"), [("full", 0.87), ("full", 0.7), ("hololens", 1.15)])
def test_a_smaller_thing_lacks_surface_and_a_larger_one_goes_on(
    laptop: pk.ArticulatedModel, tier: str, factor: float
) -> None:
    # Plates of any size lie in the same planes: only where they end tells their size.
    scan = pk.simulate(laptop, sensor=TIERS[tier], seed=2).scan.scaled(factor)
    estimate = pk.estimate(laptop, scan)
    assert estimate.evidence.size == pytest.approx(factor, rel=0.04)
    assert estimate.evidence.size_gain > 0.05
    assert estimate.confidence < 0.5


@pytest.mark.parametrize("sensor", [TIERS["missing"], TIERS["single"], TIERS["sparse"]])
def test_a_lack_of_surface_that_no_smaller_model_mends_tells_no_size(
    laptop: pk.ArticulatedModel, sensor: pk.Sensor
) -> None:
    estimate = pk.estimate(laptop, pk.simulate(laptop, sensor=sensor, seed=2).scan)
    assert (estimate.evidence.size, estimate.evidence.size_gain) == (1.0, 0.0)
