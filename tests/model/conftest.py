"""Small URDFs written into a temporary folder, and robots of the wheel in turn."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from pwralign_kin.benchmark.cases import ROBOTS
from pwralign_kin.model import ArticulatedModel, articulated_model


@pytest.fixture(autouse=True)
def _own_cache(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PWRALIGN_CACHE_DIR", str(tmp_path_factory.getbasetemp() / "cache"))


@pytest.fixture(autouse=True)
def _without_surfaces(monkeypatch: pytest.MonkeyPatch) -> None:
    """Sampling surfaces takes longer than everything tested here."""
    monkeypatch.setattr(articulated_model.ArticulatedModel, "surfaces", ())
    monkeypatch.setattr(articulated_model, "set_surfaces", lambda native, surfaces: None)
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


@pytest.fixture(params=ROBOTS)
def robot(request: pytest.FixtureRequest, wheel_folder: Path) -> Iterator[Path]:
    """Path of each robot's URDF in turn."""
    return wheel_folder / ROBOTS[request.param]


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20240501)
