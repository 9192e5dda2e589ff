"""What all tests share: the option --slow, a cache of their own, and where models and benchmark data are."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parent.parent

TURNING_ARM = """<robot name="arm">
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


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--slow", action="store_true", help="also run the tests marked slow")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    if config.getoption("--slow"):
        return
    for item in items:
        if "slow" in item.keywords:
            item.add_marker(pytest.mark.skip(reason="slow: run with --slow"))


@pytest.fixture(scope="session", autouse=True)
def _own_folders(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Keep the user's cache and log folders out of the tests; the workers of one run share a cache."""
    base = tmp_path_factory.getbasetemp()
    shared = base.parent if "PYTEST_XDIST_WORKER" in os.environ else base
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PWRALIGN_CACHE_DIR", str(shared / "pwralign-cache"))
        patch.setenv("XDG_STATE_HOME", str(shared / "state"))
        yield


@pytest.fixture(scope="session")
def repository() -> Path:
    return REPOSITORY


@pytest.fixture(scope="session")
def shared_folder() -> Path:
    """The folder with recorded frames of real robots, which is not part of this repository."""
    folder = Path(os.environ.get("PWRALIGN_SHARED", REPOSITORY.parent / "shared"))
    if not folder.is_dir():
        pytest.skip(
            "the recorded frames of a real arm are not part of this repository: set PWRALIGN_SHARED to a folder that "
            "holds them as real/xarm7/NAME_robot.ply with their truth.json, or name it `shared` beside the repository"
        )
    return folder


@pytest.fixture(scope="session")
def wheel_folder() -> Path:
    """The robots of the wheel example-robot-data."""
    for folder in map(Path, sys.path):
        robots = folder / "cmeel.prefix/share/example-robot-data/robots"
        if robots.is_dir():
            return robots
    pytest.skip("the wheel example-robot-data is not installed")


@pytest.fixture(scope="session")
def turning_arm() -> str:
    """URDF of a small arm of boxes, two turning joints, that no turn maps onto itself."""
    return TURNING_ARM
