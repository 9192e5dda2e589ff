"""A robot whose right answers are known by hand: two interchangeable legs, a roller, a plate."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pwralign_kin import se3
from pwralign_kin.benchmark.metrics import Reference, Ruler
from pwralign_kin.model import ArticulatedModel
from pwralign_kin.state import State

# Half a turn about z maps the body, the roller and the plate onto themselves and the legs onto each other.
TWINS = """<?xml version="1.0"?>
<robot name="twins">
  <link name="body"><visual><geometry><box size="0.5 0.3 0.1"/></geometry></visual></link>
  <link name="left">
    <visual><origin xyz="0 0 -0.2"/><geometry><box size="0.06 0.03 0.4"/></geometry></visual>
  </link>
  <link name="right">
    <visual><origin xyz="0 0 -0.2"/><geometry><box size="0.06 0.03 0.4"/></geometry></visual>
  </link>
  <link name="roller"><visual><geometry><cylinder radius="0.08" length="0.1"/></geometry></visual></link>
  <link name="plate"><visual><geometry><box size="0.4 0.3 0.002"/></geometry></visual></link>
  <joint name="left_hip" type="revolute">
    <origin xyz="0 0.17 0"/><parent link="body"/><child link="left"/><axis xyz="0 1 0"/>
    <limit lower="-1.5" upper="1.5" effort="1" velocity="1"/>
  </joint>
  <joint name="right_hip" type="revolute">
    <origin xyz="0 -0.17 0"/><parent link="body"/><child link="right"/><axis xyz="0 1 0"/>
    <limit lower="-1.5" upper="1.5" effort="1" velocity="1"/>
  </joint>
  <joint name="spin" type="continuous">
    <origin xyz="0 0 0.1"/><parent link="body"/><child link="roller"/><axis xyz="0 0 1"/>
  </joint>
  <joint name="lift" type="prismatic">
    <origin xyz="0 0 0.2"/><parent link="body"/><child link="plate"/><axis xyz="0 0 1"/>
    <limit lower="0" upper="0.4" effort="1" velocity="1"/>
  </joint>
</robot>
"""

JOINTS = {"left_hip": 0.5, "right_hip": -0.9, "spin": 0.3, "lift": 0.1}
PARTS = ("body", "left", "right", "roller", "plate")


@pytest.fixture(scope="package")
def twins_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("robots") / "twins" / "twins.urdf"
    path.parent.mkdir()
    path.write_text(TWINS)
    return path


@pytest.fixture(scope="package")
def twins(twins_path: Path) -> ArticulatedModel:
    return ArticulatedModel.from_urdf(twins_path)


@pytest.fixture(scope="package")
def ruler(twins: ArticulatedModel) -> Ruler:
    return Ruler(twins)


@pytest.fixture(scope="package")
def truth() -> State:
    return State(se3.from_quaternion(np.array([0.4, -1.2, 2.0]), np.array([0.3, -0.5, 0.2, 0.7])), JOINTS)


@pytest.fixture(scope="package")
def reference(ruler: Ruler, truth: State) -> Reference:
    """All parts are seen."""
    return ruler.reference(truth, np.repeat(np.arange(len(PARTS)), 100))


@pytest.fixture(scope="package")
def swapped(truth: State) -> State:
    """The same surface with the legs taken for each other."""
    half_turn = np.diag([-1.0, -1.0, 1.0, 1.0])
    joints = {**JOINTS, "left_hip": -JOINTS["right_hip"], "right_hip": -JOINTS["left_hip"]}
    return State(truth.T_scan_base @ half_turn, joints)
