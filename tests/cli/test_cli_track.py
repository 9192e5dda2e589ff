"""`pwralign track`: what it prints, writes and refuses."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from command_line import Call

from pwralign_kin import State


def test_track_of_one_scan_seen_twice(arm: Path, scan: Path, tmp_path: Path, pwralign: Call) -> None:
    truth = State.load(scan.parent / "truth.json")
    out = tmp_path / "out"
    outcome = pwralign("track", arm, scan, scan, scan, "--rate", 10, "--out", out, "--json")
    assert outcome.code == 0, outcome.err
    frames = json.loads(outcome.out)
    assert [frame["time"] for frame in frames] == pytest.approx([0.0, 0.1, 0.2])
    assert [frame["searched"] for frame in frames] == [True, False, False]
    assert {path.name for path in out.iterdir()} == {"joints.csv", "base.tum", "track.json"}
    rows = list(csv.DictReader((out / "joints.csv").read_text().splitlines()))
    assert len(rows) == 3 and rows[0].keys() == {"time", "lost", "shoulder", "elbow", "std(shoulder)", "std(elbow)"}
    for name, value in truth.joints.items():
        assert float(rows[-1][name]) == pytest.approx(value, abs=0.03)
    base = np.loadtxt(out / "base.tum")
    assert base.shape == (3, 8)
    np.testing.assert_allclose(base[-1, 1:4], truth.T_scan_base[:3, 3], atol=0.01)
    np.testing.assert_allclose(np.linalg.norm(base[:, 4:], axis=1), 1.0, atol=1e-6)


def test_initial_state_and_table(arm: Path, scan: Path, pwralign: Call) -> None:
    outcome = pwralign("track", arm, scan, "--initial", scan.parent / "truth.json")
    assert outcome.code == 0, outcome.err
    assert "1 frame, 0 of them lost, 0 searched" in outcome.out
    assert "shoulder     28." in outcome.out and "deg" in outcome.out


def test_tracks_of_something_else_are_doubted(arm: Path, tmp_path: Path, pwralign: Call) -> None:
    sphere = np.random.default_rng(0).normal(size=(2000, 3))
    np.save(tmp_path / "ball.npy", sphere / np.linalg.norm(sphere, axis=1, keepdims=True) * 0.4)
    outcome = pwralign("track", arm, tmp_path / "ball.npy", "--out", tmp_path / "out")
    assert outcome.code == 3
    assert "low confidence" in outcome.err
    assert (tmp_path / "out" / "base.tum").read_text() == ""


def test_mcap(arm: Path, scan: Path, tmp_path: Path, pwralign: Call) -> None:
    highlevel = pytest.importorskip("rosbags.highlevel", reason="the ros extra is not installed")
    from rosbags.typesys import Stores, get_typestore

    truth = scan.parent / "truth.json"
    outcome = pwralign("track", arm, scan, scan, "--initial", truth, "--out", tmp_path / "out", "--mcap")
    assert outcome.code == 0, outcome.err
    store = get_typestore(Stores.ROS2_HUMBLE)
    with highlevel.AnyReader([tmp_path / "out" / "track.mcap"], default_typestore=store) as reader:
        read = [(one.topic, reader.deserialize(raw, one.msgtype)) for one, _, raw in reader.messages()]
    joints = [message for topic, message in read if topic == "/joint_states"]
    transforms = [message for topic, message in read if topic == "/tf"]
    assert len(joints) == len(transforms) == 2
    assert joints[0].name == ["shoulder", "elbow"]
    assert joints[0].position[0] == pytest.approx(State.load(truth).joints["shoulder"], abs=0.03)
    assert {one.child_frame_id for one in transforms[0].transforms} == {"base", "upper", "lower"}


def test_a_bad_frame_does_not_take_away_the_others(arm: Path, scan: Path, tmp_path: Path, pwralign: Call) -> None:
    (tmp_path / "bad.ply").write_text("ply\n")
    outcome = pwralign("track", arm, scan, tmp_path / "bad.ply", "--out", tmp_path / "out")
    assert outcome.code == 1 and "bad.ply" in outcome.error()
    assert len((tmp_path / "out" / "joints.csv").read_text().splitlines()) == 2


def test_names_that_do_not_exist_are_no_lost_model(arm: Path, scan: Path, pwralign: Call) -> None:
    assert "'elbow'" in pwralign("track", arm, scan, "--joint", "elbo=1").error()


def test_refusals(arm: Path, scan: Path, tmp_path: Path, pwralign: Call) -> None:
    assert "at least one frame" in pwralign("track", arm).error()
    assert "--out" in pwralign("track", arm, scan, "--mcap").error()
    assert "the URDF comes first" in pwralign("track", scan, arm).error()
    missing = pwralign("track", arm, tmp_path / "no.npy")
    assert missing.code == 1 and "no such file" in missing.error()
    assert "rate" in pwralign("track", arm, scan, "--rate", 0).error()
    assert "--time-limit" in pwralign("track", arm, scan, "--time-limit", -1).error()
    (tmp_path / "out").write_text("")
    assert pwralign("track", arm, scan, "--out", tmp_path / "out").code == 1
