"""The small arm with a sliding jaw and scans of it, and the excavator in a room."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from truths import true_candidate

import pwralign_kin as pk
from pwralign_kin.estimation.comparison.candidates import Candidates
from pwralign_kin.estimation.comparison.scan_comparison import ScanComparison, Sought
from pwralign_kin.estimation.comparison.search_options import SearchOptions
from pwralign_kin.estimation.knowledge.prior import SearchPrior
from pwralign_kin.estimation.search.tree_search import TreeSearch
from pwralign_kin.estimation.sensing.observation import ObservationOptions
from pwralign_kin.estimation.sensing.preparation import observe
from pwralign_kin.simulation import TIERS, Room, SimulatedScan, simulate_scene

GRIPPER = """  <link name="jaw">
    <visual><origin xyz="0.05 0 0.03"/><geometry><box size="0.1 0.1 0.02"/></geometry></visual>
  </link>
  <joint name="grip" type="prismatic">
    <parent link="lower"/><child link="jaw"/><origin xyz="0.3 0 0"/><axis xyz="0 0 1"/>
    <limit lower="0" upper="0.1" effort="1" velocity="1"/>
  </joint>
"""


@pytest.fixture(scope="session")
def arm(tmp_path_factory: pytest.TempPathFactory, turning_arm: str) -> pk.ArticulatedModel:
    path = tmp_path_factory.mktemp("arm") / "arm.urdf"
    path.write_text(turning_arm.replace("</robot>", GRIPPER + "</robot>"))
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
def comparison(arm: pk.ArticulatedModel, full_scan: SimulatedScan, units: np.ndarray) -> ScanComparison:
    observation = observe(full_scan.scan, arm.diagonal, ObservationOptions(), 2)
    return ScanComparison(
        Sought(arm.kernel_model, arm.surfaces, SearchOptions(), 2),
        observation,
        SearchPrior.nothing(arm.values({}) / units),
    )


@pytest.fixture(scope="session")
def search(comparison: ScanComparison) -> TreeSearch:
    return TreeSearch(comparison)


@pytest.fixture(scope="session")
def right(
    arm: pk.ArticulatedModel, full_scan: SimulatedScan, comparison: ScanComparison, units: np.ndarray
) -> Candidates:
    """The truth about the full scan."""
    return true_candidate(arm, comparison.observation, full_scan, units)


@pytest.fixture(scope="session")
def robots_folder() -> Path:
    return Path(__file__).resolve().parents[2] / "robots"


@pytest.fixture(scope="session")
def excavator(robots_folder: Path) -> pk.ArticulatedModel:
    return pk.ArticulatedModel.from_urdf(robots_folder / "excavator" / "excavator.urdf")


@pytest.fixture(scope="session")
def scene(excavator: pk.ArticulatedModel) -> SimulatedScan:
    return simulate_scene(excavator, room=Room(contacts=1), seed=14)
