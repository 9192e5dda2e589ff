"""A small arm of boxes that no turn maps onto itself, and what a depth camera sees of it as it moves."""

from __future__ import annotations

import pytest

import pwralign_kin as pk
from pwralign_kin.simulation import SimulatedFrame, simulate_sequence

ARM = """<robot name="arm">
  <link name="base">
    <visual><origin xyz="0 0 0.05"/><geometry><box size="0.5 0.3 0.1"/></geometry></visual>
    <visual><origin xyz="0.18 0.08 0.15"/><geometry><box size="0.08 0.1 0.1"/></geometry></visual>
  </link>
  <link name="upper">
    <visual><origin xyz="0 0 0.2"/><geometry><box size="0.12 0.08 0.4"/></geometry></visual>
    <visual><origin xyz="0.09 0 0.3"/><geometry><box size="0.06 0.05 0.1"/></geometry></visual>
  </link>
  <link name="lower">
    <visual><origin xyz="0.15 0 0"/><geometry><box size="0.3 0.06 0.09"/></geometry></visual>
    <visual><origin xyz="0.25 0.06 0"/><geometry><box size="0.05 0.08 0.04"/></geometry></visual>
  </link>
  <joint name="shoulder" type="revolute">
    <parent link="base"/><child link="upper"/><origin xyz="-0.1 0 0.1"/><axis xyz="0 1 0"/>
    <limit lower="-1.2" upper="1.2" effort="1" velocity="1"/>
  </joint>
  <joint name="elbow" type="revolute">
    <parent link="upper"/><child link="lower"/><origin xyz="0 0 0.42"/><axis xyz="0 1 0"/>
    <limit lower="-2" upper="2" effort="1" velocity="1"/>
  </joint>
</robot>
"""


@pytest.fixture(scope="session")
def arm(tmp_path_factory: pytest.TempPathFactory) -> pk.ArticulatedModel:
    path = tmp_path_factory.mktemp("arm") / "arm.urdf"
    path.write_text(ARM)
    return pk.ArticulatedModel.from_urdf(path)


@pytest.fixture(scope="session")
def moving(arm: pk.ArticulatedModel) -> list[SimulatedFrame]:
    """A second of motion, seen by one camera."""
    return list(simulate_sequence(arm, 30, size=(160, 120), seed=5))
