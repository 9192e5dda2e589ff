"""A two-link arm, scans of it, and the command line called within the process."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

from pwralign_kin.cli import main

ARM = """
  <link name="base"><visual><geometry><box size="0.5 0.4 0.1"/></geometry></visual></link>
  <link name="upper">
    <visual><origin xyz="0 0 0.2"/><geometry><box size="0.12 0.08 0.4"/></geometry></visual>
  </link>
  <link name="lower">
    <visual><origin xyz="0.15 0 0"/><geometry><box size="0.3 0.06 0.05"/></geometry></visual>
    <visual><origin xyz="0.3 0.05 0"/><geometry><sphere radius="0.05"/></geometry></visual>
  </link>
  <joint name="shoulder" type="revolute">
    <parent link="base"/><child link="upper"/><origin xyz="0.1 0.05 0.05"/><axis xyz="1 0 0"/>
    {shoulder_limit}
  </joint>
  <joint name="elbow" type="revolute">
    <parent link="upper"/><child link="lower"/><origin xyz="0 0 0.4"/><axis xyz="0 1 0"/>
    <limit lower="-1" upper="1" effort="1" velocity="1"/>
  </joint>
"""
LIMIT = '<limit lower="-1.2" upper="1.2" effort="1" velocity="1"/>'


@dataclass(frozen=True)
class Outcome:
    """What one call of the command line left behind."""

    code: int
    out: str
    err: str

    def error(self) -> str:
        """The error, having checked that it is one line, the last on stderr, and stdout empty."""
        *before, last = self.err.splitlines()
        assert last.startswith("pwralign: error: "), self.err
        assert all(line.startswith(("pwralign: warning: ", "pwralign: note: ")) for line in before), self.err
        assert self.out == ""
        return last.removeprefix("pwralign: error: ")


Call = Callable[..., Outcome]


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
