"""`pwralign calibrate`, and several scans or priors given to `pwralign estimate`."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from command_line import Call

from pwralign_kin import Scan, State


@pytest.fixture
def truth(scan: Path) -> Path:
    return scan.with_name("truth.json")


def test_calibrate_finds_the_base_and_writes_it(
    arm: Path, scan: Path, truth: Path, tmp_path: Path, pwralign: Call
) -> None:
    file = tmp_path / "calibration.json"
    outcome = pwralign("calibrate", arm, f"{scan}={truth}", f"{scan}={truth}", "--out", file, "--json")
    assert outcome.code == 0, outcome.err
    answer = json.loads(outcome.out)
    assert answer == json.loads(file.read_text())
    np.testing.assert_allclose(answer["T_scan_base"], State.load(truth).T_scan_base, atol=0.02)
    assert len(answer["estimates"]) == 2


def test_calibrate_takes_bare_joint_values(arm: Path, scan: Path, tmp_path: Path, pwralign: Call) -> None:
    joints = tmp_path / "joints.json"
    joints.write_text('{"shoulder": 0.5, "elbow": -0.4}')
    outcome = pwralign("calibrate", arm, f"{scan}={joints}")
    assert outcome.code == 0, outcome.err
    assert outcome.out.startswith("base base: xyz")


@pytest.mark.parametrize("content", ["[]", "{}", "nonsense", '{"shoulder": "high"}', '{"joints": 3}'])
def test_bad_joint_files_are_one_line(arm: Path, scan: Path, tmp_path: Path, pwralign: Call, content: str) -> None:
    joints = tmp_path / "joints.json"
    joints.write_text(content)
    outcome = pwralign("calibrate", arm, f"{scan}={joints}")
    assert outcome.code == 1
    assert "joints.json" in outcome.error()


@pytest.mark.parametrize("pairs", [(), ("scan.ply",), ("=joints.json",), ("scan.ply=",)])
def test_pairs_must_be_pairs(arm: Path, pwralign: Call, pairs: tuple[str, ...]) -> None:
    outcome = pwralign("calibrate", arm, *pairs)
    assert outcome.code == 2
    assert "SCAN=JOINTS" in outcome.error()


def test_estimate_takes_several_scans(arm: Path, scan: Path, tmp_path: Path, pwralign: Call) -> None:
    outcome = pwralign("estimate", arm, scan, scan, "--out", tmp_path / "out")
    assert outcome.code == 0, outcome.err
    assert {path.name for path in (tmp_path / "out").iterdir()} == {"0_scan", "1_scan", "shared.json"}
    one, two = (State.load(tmp_path / "out" / name / "state.json") for name in ("0_scan", "1_scan"))
    np.testing.assert_allclose(one.T_scan_base, two.T_scan_base, atol=1e-12)
    assert outcome.out.count("elbow") == 1 and "scan 1" in outcome.out
    shared = json.loads((tmp_path / "out" / "shared.json").read_text())
    np.testing.assert_allclose(one.T_scan_base, shared["T_scan_base"], atol=1e-12)
    assert len(shared["base_covariance"]) == 6 and len(shared["estimates"]) == 2


def test_scans_of_different_units_take_no_hint(arm: Path, scan: Path, tmp_path: Path, pwralign: Call) -> None:
    np.save(tmp_path / "mm.npy", 1e3 * Scan.load(scan).points)
    outcome = pwralign("estimate", arm, scan, tmp_path / "mm.npy", "--units", "auto", "--near", 0, 0, 0)
    assert outcome.code == 2 and "units" in outcome.error()


def test_estimate_takes_what_is_known_of_the_base(arm: Path, scan: Path, truth: Path, pwralign: Call) -> None:
    T = State.load(truth).T_scan_base
    low, high = T[:3, 3] - 0.05, T[:3, 3] + 0.05
    outcome = pwralign("estimate", arm, scan, "--json", "--gravity", *-T[:3, 2], "--base-region", *low, *high)
    assert outcome.code == 0, outcome.err
    found = np.array(json.loads(outcome.out)["T_scan_base"])
    assert found[:3, 2] @ T[:3, 2] > 0.99
    assert "--base-std" in pwralign("estimate", arm, scan, "--base-std", 0, 0).error()


def test_wrong_joint_values_are_warned_about(arm: Path, scan: Path, tmp_path: Path, pwralign: Call) -> None:
    joints = tmp_path / "joints.json"
    joints.write_text(json.dumps({"shoulder": 0.5, "elbow": -0.2}), encoding="utf-8")
    outcome = pwralign("calibrate", arm, f"{scan}={joints}")
    assert outcome.code == 3
    assert "the scans contradict joint values" in outcome.err
    assert "elbow seems" in outcome.out
