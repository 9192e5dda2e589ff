"""The committed models are what the script builds."""

from __future__ import annotations

import subprocess
import sys

import pytest
from sample_robot import NAMES, REPOSITORY, ROBOTS

BUILD = REPOSITORY / "scripts" / "build_robots.py"


@pytest.fixture(scope="module")
def rebuilt(tmp_path_factory):
    folder = tmp_path_factory.mktemp("robots")
    subprocess.run(
        [sys.executable, str(BUILD), "--out", str(folder), "--without-scans"],
        check=True, capture_output=True,
    )  # fmt: skip
    return folder


@pytest.mark.parametrize("name", NAMES)
def test_urdf_and_meshes_come_out_the_same_to_the_byte(rebuilt, name):
    built = sorted(path.relative_to(rebuilt / name) for path in (rebuilt / name).rglob("*") if path.is_file())
    assert built
    for path in built:
        assert (rebuilt / name / path).read_bytes() == (ROBOTS / name / path).read_bytes(), path


def test_unknown_name_is_refused():
    run = subprocess.run(
        [sys.executable, str(BUILD), "cubbot"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 2
    assert "cubbot" in run.stderr and "cubebot" in run.stderr
