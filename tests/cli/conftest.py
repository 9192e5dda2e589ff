"""The arm in a file, a scan of it, and the command line called within the process."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from command_line import ARM, LIMIT, Call, Outcome

from pwralign_kin.cli import main


@pytest.fixture
def pwralign(capfd: pytest.CaptureFixture[str]) -> Call:
    """Call the command line within the process; arguments may be paths and numbers."""

    def call(*arguments: object) -> Outcome:
        capfd.readouterr()
        code = main([str(argument) for argument in arguments])
        return Outcome(code, *capfd.readouterr())

    return call


@pytest.fixture
def write_arm(tmp_path: Path) -> Callable[..., Path]:
    """Write the arm's URDF, by default a sound one."""

    def write(head: str = '<robot name="arm">', shoulder_limit: str = LIMIT, more: str = "") -> Path:
        path = tmp_path / "arm.urdf"
        path.write_text(f"{head}{ARM.format(shoulder_limit=shoulder_limit)}{more}</robot>", encoding="utf-8")
        return path

    return write


@pytest.fixture
def arm(write_arm: Callable[..., Path]) -> Path:
    return write_arm()


@pytest.fixture
def scan(tmp_path: Path, arm: Path, pwralign: Call) -> Path:
    """A scan of the arm from all sides, its truth beside it."""
    folder = tmp_path / "scan"
    outcome = pwralign(
        "simulate", arm, "--out", folder, "--points", 3000, "--joint", "shoulder=0.5", "--joint", "elbow=-0.4"
    )
    assert outcome.code == 0, outcome.err
    return folder / "scan.ply"
