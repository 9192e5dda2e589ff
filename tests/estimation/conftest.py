"""A small arm of boxes that no turn maps onto itself, and scans of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import pwralign_kin as pk
from pwralign_kin.estimation.observation import ObservationOptions, observe
from pwralign_kin.estimation.tree_search import SearchOptions, TreeSearch
from pwralign_kin.simulation import TIERS, SimulatedScan

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
  <link name="jaw">
    <visual><origin xyz="0.05 0 0.03"/><geometry><box size="0.1 0.1 0.02"/></geometry></visual>
  </link>
  <joint name="shoulder" type="revolute">
    <parent link="base"/><child link="upper"/><origin xyz="-0.1 0 0.1"/><axis xyz="0 1 0"/>
    <limit lower="-1.2" upper="1.2" effort="1" velocity="1"/>
  </joint>
  <joint name="elbow" type="revolute">
    <parent link="upper"/><child link="lower"/><origin xyz="0 0 0.42"/><axis xyz="0 1 0"/>
    <limit lower="-2" upper="2" effort="1" velocity="1"/>
  </joint>
  <joint name="grip" type="prismatic">
    <parent link="lower"/><child link="jaw"/><origin xyz="0.3 0 0"/><axis xyz="0 0 1"/>
    <limit lower="0" upper="0.1" effort="1" velocity="1"/>
  </joint>
</robot>
"""


@pytest.fixture(scope="session")
def arm(tmp_path_factory: pytest.TempPathFactory) -> pk.ArticulatedModel:
    path = tmp_path_factory.mktemp("arm") / "arm.urdf"
    path.write_text(ARM)
    return pk.ArticulatedModel.from_urdf(path)


@pytest.fixture(scope="session")
def full_scan(arm: pk.ArticulatedModel) -> SimulatedScan:
    return pk.simulate(arm, sensor=TIERS["full"], seed=3)


@pytest.fixture(scope="session")
def single_scan(arm: pk.ArticulatedModel) -> SimulatedScan:
    return pk.simulate(arm, sensor=TIERS["single"], seed=3)


@pytest.fixture(scope="session")
def units(arm: pk.ArticulatedModel) -> np.ndarray:
    """What the search counts each joint value in."""
    return np.array([arm.diagonal if arm.units[name] == "m" else 1.0 for name in arm.joint_names])


@pytest.fixture(scope="session")
def search(arm: pk.ArticulatedModel, full_scan: SimulatedScan, units: np.ndarray) -> TreeSearch:
    observation = observe(full_scan.scan, arm.diagonal, ObservationOptions(), 2)
    return TreeSearch(arm.kernel_model, arm.surfaces, observation, arm.values({}) / units, SearchOptions(), 2)


@pytest.fixture(scope="session")
def robots_folder() -> Path:
    return Path(__file__).resolve().parents[2] / "robots"
