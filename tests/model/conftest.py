"""Small URDFs written into a temporary folder, and the robots of the wheel example-robot-data."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from pwralign_kin.model import ArticulatedModel, articulated_model

ROBOTS = {
    "panda": "panda_description/urdf/panda.urdf",
    "ur5": "ur_description/urdf/ur5_robot.urdf",
    "z1": "z1_description/urdf/z1.urdf",
    "allegro": "allegro_hand_description/urdf/allegro_right_hand.urdf",
    "solo12": "solo_description/robots/solo12.urdf",
    "tiago": "tiago_description/robots/tiago_no_hand.urdf",
    "baxter": "baxter_description/urdf/baxter.urdf",
    "pendulum": "double_pendulum_description/urdf/double_pendulum_continuous.urdf",
    "icub": "icub_description/robots/icub_reduced.urdf",
    "go2": "go2_description/urdf/go2.urdf",
    "twodof": "asr_twodof_description/urdf/TwoDofs.urdf",
    "quadruped": "quadruped_description/urdf/quadruped.urdf",
}


@pytest.fixture(autouse=True)
def _own_cache(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PWRALIGN_CACHE_DIR", str(tmp_path_factory.getbasetemp() / "cache"))


@pytest.fixture(autouse=True)
def _without_surfaces(monkeypatch: pytest.MonkeyPatch) -> None:
    """Sampling surfaces takes longer than everything tested here."""
    monkeypatch.setattr(articulated_model, "prepare_surfaces", lambda model: ())
    monkeypatch.setattr(articulated_model, "kernel_model", lambda model, surfaces: None)
    monkeypatch.setattr(articulated_model, "model_reach", lambda native, surfaces: 0.0)


@pytest.fixture
def write_urdf(tmp_path: Path) -> Callable[..., Path]:
    """Write `<robot name="bot">body</robot>` and return its path."""

    def write(body: str, file: str = "bot.urdf", head: str = '<robot name="bot">') -> Path:
        path = tmp_path / file
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(f"{head}{body}</robot>", encoding="utf-8")
        return path

    return write


@pytest.fixture
def read(write_urdf: Callable[..., Path]) -> Callable[..., ArticulatedModel]:
    """Write a URDF and read it."""

    def read(body: str, **options: object) -> ArticulatedModel:
        return ArticulatedModel.from_urdf(write_urdf(body), **options)  # type: ignore[arg-type]

    return read


@pytest.fixture(scope="session")
def robot_folder() -> Path:
    for folder in map(Path, sys.path):
        robots = folder / "cmeel.prefix/share/example-robot-data/robots"
        if robots.is_dir():
            return robots
    pytest.skip("the wheel example-robot-data is not installed")


@pytest.fixture(params=ROBOTS)
def robot(request: pytest.FixtureRequest, robot_folder: Path) -> Iterator[Path]:
    """Path of each robot's URDF in turn."""
    return robot_folder / ROBOTS[request.param]


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20240501)
