"""What a depth camera sees of the small arm as it moves."""

from __future__ import annotations

import pytest

import pwralign_kin as pk
from pwralign_kin.simulation import SimulatedFrame, simulate_sequence


@pytest.fixture(scope="session")
def arm(tmp_path_factory: pytest.TempPathFactory, turning_arm: str) -> pk.ArticulatedModel:
    path = tmp_path_factory.mktemp("arm") / "arm.urdf"
    path.write_text(turning_arm)
    return pk.ArticulatedModel.from_urdf(path)


@pytest.fixture(scope="session")
def moving(arm: pk.ArticulatedModel) -> list[SimulatedFrame]:
    """A second of motion, seen by one camera."""
    return list(simulate_sequence(arm, 30, size=(160, 120), seed=5))
