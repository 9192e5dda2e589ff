"""The robot of boxes in a temporary folder, and models from text."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from boxbot import BOT, BOT_JOINTS, STL, placement, read_quickly

from pwralign_kin.model import ArticulatedModel
from pwralign_kin.state import State


@pytest.fixture(scope="session")
def bot_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("robot")
    (folder / "meshes").mkdir()
    (folder / "meshes" / "wedge.stl").write_text(STL)
    (folder / "bot.urdf").write_text(BOT)
    return folder / "bot.urdf"


@pytest.fixture(scope="session")
def bot(bot_path: Path) -> ArticulatedModel:
    return read_quickly(bot_path)


@pytest.fixture(scope="session")
def bot_state() -> State:
    return State(placement(1), BOT_JOINTS, "base")


@pytest.fixture
def read(tmp_path: Path) -> Callable[[str], ArticulatedModel]:
    """Read the model whose URDF is given as text."""

    def read(text: str) -> ArticulatedModel:
        path = tmp_path / "source" / "robot.urdf"
        path.parent.mkdir(exist_ok=True)
        path.write_text(text)
        return read_quickly(path)

    return read
