"""`pwralign calibrate`, and several scans or priors given to `pwralign estimate`."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from command_line import Call

from pwralign_kin import ArticulatedModel, Scan, State, se3
from pwralign_kin.cli.arguments import read_joints
from pwralign_kin.export.joints import joint_values
from pwralign_kin.export.states import write_joint_state


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
    np.testing.assert_allclose(np.array(answer["T_base_scan"]) @ answer["T_scan_base"], np.eye(4), atol=1e-9)
    assert len(answer["estimates"]) == 2


def test_calibrate_takes_bare_joint_values(arm: Path, scan: Path, tmp_path: Path, pwralign: Call) -> None:
    joints = tmp_path / "joints.json"
    joints.write_text('{"shoulder": 0.5, "elbow": -0.4}')
    outcome = pwralign("calibrate", arm, f"{scan}={joints}")
    assert outcome.code == 0, outcome.err
    assert outcome.out.startswith("base link base: xyz")


MESSAGE = "header: {stamp: {sec: 1, nanosec: 2}, frame_id: ''}\nname: [elbow, shoulder]\nposition: [-0.4, 5e-1]\n---\n"


@pytest.mark.parametrize(
    "content",
    [
        MESSAGE,
        '{"name": ["shoulder", "elbow"], "position": [0.5, -0.4], "velocity": []}',
        "initial_positions: {shoulder: 0.5, elbow: -0.4}",
        "shoulder: 0.5\nelbow: -0.4\n",
        '{\n\t"shoulder": 0.5,\n\t"elbow": -0.4\n}',
    ],
)
def test_joint_values_in_every_form(tmp_path: Path, content: str) -> None:
    (tmp_path / "joints.yaml").write_text(content)
    assert read_joints(tmp_path / "joints.yaml") == {"shoulder": 0.5, "elbow": -0.4}


def test_calibrate_reads_what_the_tool_writes_and_tells_ros(
    write_arm: Callable[..., Path], tmp_path: Path, pwralign: Call
) -> None:
    """Joints that mimic and those of other machines are in a JointState too."""
    mimic = '<joint name="finger" type="revolute"><parent link="base"/><child link="tip"/><axis xyz="0 0 1"/>'
    mimic += '<mimic joint="elbow"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint><link name="tip"/>'
    arm = write_arm(more=mimic)
    pose = ("--joint", "shoulder=0.5", "--joint", "elbow=-0.4", "--points", 3000)
    assert pwralign("simulate", arm, "--out", tmp_path / "s", *pose).code == 0
    model, scan = ArticulatedModel.from_urdf(arm), tmp_path / "s/scan.ply"
    joints = tmp_path / "joint_state.yaml"
    write_joint_state(joints, joint_values(model, State.load(tmp_path / "s/truth.json")))
    assert "finger" in joints.read_text()
    told = joints.read_text().replace("name:\n", "name:\n- wheel\n")
    joints.write_text(told.replace("position:\n", "position:\n- 7\n"))
    outcome = pwralign("calibrate", arm, f"{scan}={joints}", "--out", tmp_path / "c.json")
    assert outcome.code == 0, outcome.err
    assert "wheel" in outcome.err and "finger" not in outcome.err
    command = outcome.out.splitlines()[-1].split()
    assert command[:4] == ["ros2", "run", "tf2_ros", "static_transform_publisher"]
    placed = dict(zip(command[4::2], command[5::2], strict=True))
    assert (placed.pop("--frame-id"), placed.pop("--child-frame-id")) == ("base", "sensor")
    x, y, z, *quaternion = map(float, placed.values())
    found = se3.from_quaternion(np.array([x, y, z]), np.array(quaternion))
    truth = State.load(tmp_path / "s/truth.json").T_scan_base
    np.testing.assert_allclose(found, np.linalg.inv(truth), atol=0.02)


def test_degrees_and_unknown_joints_are_told(arm: Path, scan: Path, tmp_path: Path, pwralign: Call) -> None:
    joints = tmp_path / "joints.json"
    for content, words in (
        ('{"shoulder": 28.6, "elbow": -22.9}', "in degrees"),
        ('{"wheel": 1}', "'wheel'"),
        ('{"name": ["shoulder"], "position": []}', "JointState"),
        ("shoulder,elbow\n0.5,-0.4\n", "JSON or YAML"),
    ):
        joints.write_text(content)
        outcome = pwralign("calibrate", arm, f"{scan}={joints}")
        assert outcome.code == 1 and words in outcome.error()
    joints.write_text('{"shoulder": 900, "elbow": 0.1}')
    assert "meant in" not in pwralign("calibrate", arm, f"{scan}={joints}").error()


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


def test_a_scan_of_another_place_is_named(arm: Path, scan: Path, truth: Path, tmp_path: Path, pwralign: Call) -> None:
    pose = ("--joint", "shoulder=0.5", "--joint", "elbow=-0.4", "--points", 3000, "--seed", 7)
    assert pwralign("simulate", arm, "--out", tmp_path / "moved", *pose).code == 0
    joints = tmp_path / "joints.json"
    joints.write_text('{"shoulder": 0.5, "elbow": -0.4, "wheel": 0.0}', encoding="utf-8")
    own, moved = f"{scan}={joints}", f"{tmp_path / 'moved/scan.ply'}={joints}"
    outcome = pwralign("calibrate", arm, own, moved, own)
    assert outcome.code == 0, outcome.err
    assert "warning: scan 1: low confidence on the base that the others share" in outcome.err
    assert outcome.err.count("wheel is no joint of the model") == 1


def test_wrong_joint_values_are_warned_about(arm: Path, scan: Path, tmp_path: Path, pwralign: Call) -> None:
    joints = tmp_path / "joints.json"
    joints.write_text(json.dumps({"shoulder": 0.5, "elbow": -0.2}), encoding="utf-8")
    outcome = pwralign("calibrate", arm, f"{scan}={joints}")
    assert outcome.code == 3
    assert "the scans contradict joint values" in outcome.err
    assert "elbow seems" in outcome.out
