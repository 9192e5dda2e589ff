"""`pwralign estimate` on sound input."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from command_line import Call, Outcome
from PIL import Image

from pwralign_kin import ArticulatedModel, State, se3
from pwralign_kin.scan import Scan
from pwralign_kin.simulation import simulate_sequence


def _answer(outcome: Outcome) -> dict[str, object]:
    assert outcome.code == 0, outcome.err
    assert outcome.err == ""
    return json.loads(outcome.out)


def _assert_right(answer: dict[str, object], truth: State) -> None:
    joints = answer["joints"]
    assert isinstance(joints, dict)
    for name, value in truth.joints.items():
        assert joints[name] == pytest.approx(value, abs=np.radians(2.0))
    error = se3.inverse(truth.T_scan_base) @ np.array(answer["T_scan_base"])
    assert np.linalg.norm(error[:3, 3]) < 0.01
    assert se3.rotation_angle(error[:3, :3]) < np.radians(2.0)


@pytest.fixture
def truth(scan: Path) -> State:
    return State.load(scan.with_name("truth.json"))


def test_finds_the_pose_and_prints_a_table(arm: Path, scan: Path, pwralign: Call) -> None:
    outcome = pwralign("estimate", arm, scan)
    assert outcome.code == 0
    assert outcome.err == ""
    rows = [line.split() for line in outcome.out.splitlines()]
    value = next(row for row in rows if row[:1] == ["shoulder"])[1]
    assert float(value) == pytest.approx(np.degrees(0.5), abs=2.0)


def test_json_is_all_that_is_on_stdout(arm: Path, scan: Path, truth: State, pwralign: Call) -> None:
    _assert_right(_answer(pwralign("estimate", arm, scan, "--json")), truth)


def test_the_same_seed_gives_the_same_answer_at_any_thread_count(arm: Path, scan: Path, pwralign: Call) -> None:
    one, two = (
        _answer(pwralign("estimate", arm, scan, "--json", "--seed", 5, "--threads", threads)) for threads in (1, 2)
    )
    assert one["T_scan_base"] == two["T_scan_base"]
    assert one["joints"] == two["joints"]


def test_writes_the_result_into_a_folder(arm: Path, scan: Path, tmp_path: Path, pwralign: Call) -> None:
    outcome = pwralign("estimate", arm, scan, "--out", tmp_path / "deep" / "result")
    assert outcome.code == 0, outcome.err
    folder = tmp_path / "deep" / "result"
    (line,) = (line for line in outcome.out.splitlines() if line.startswith("wrote "))
    written = line.removeprefix(f"wrote {folder}: ").split()
    assert {"state.json", "aligned.urdf", "model.glb", "overlay.png"} <= set(written)
    assert sorted(written) == sorted(path.name for path in folder.iterdir() if path.stat().st_size > 0)
    assert re.fullmatch(
        r"read in \d+\.\d\d s, found in \d+\.\d\d s, files in \d+\.\d\d s", outcome.out.splitlines()[-1]
    )


@pytest.mark.parametrize(
    ("options", "up"),
    [
        ((), "z"),
        (("--gravity", 0.1, -9.8, 0.2), "y"),
        (("--gravity", 1, 0, 0), "-x"),
        (("--gravity", 0, -1, 0, "--up", "x"), "x"),
    ],
)
def test_up_is_against_gravity_unless_told(
    options: tuple[object, ...],
    up: str,
    arm: Path,
    scan: Path,
    tmp_path: Path,
    pwralign: Call,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    told: list[object] = []
    monkeypatch.setattr("pwralign_kin.export.export", lambda *_, **options: told.append(options["up"]) or [])
    assert pwralign("estimate", arm, scan, "--out", tmp_path / "result", *options).code in (0, 3)
    assert told == [up]


def test_a_result_serves_as_the_guess_of_the_next_estimate(
    arm: Path, scan: Path, truth: State, tmp_path: Path, pwralign: Call
) -> None:
    assert pwralign("estimate", arm, scan, "--out", tmp_path / "result").code == 0
    state = tmp_path / "result" / "state.json"
    _assert_right(_answer(pwralign("estimate", arm, scan, "--initial", state, "--json")), truth)


def test_a_base_on_the_command_line_is_a_guess(arm: Path, scan: Path, truth: State, pwralign: Call) -> None:
    place = [*truth.T_scan_base[:3, 3], *se3.quaternion_xyzw(truth.T_scan_base)]
    answer = _answer(pwralign("estimate", arm, scan, "--json", "--base", *place, "--joint", "shoulder=0.4"))
    _assert_right(answer, truth)


def test_locked_joints_keep_the_value_given(arm: Path, scan: Path, pwralign: Call) -> None:
    outcome = pwralign("estimate", arm, scan, "--json", "--joint", "elbow=0.3", "--lock", "elbow")
    assert outcome.code in (0, 3)
    assert json.loads(outcome.out)["joints"]["elbow"] == pytest.approx(0.3, abs=1e-9)


@pytest.mark.parametrize("units", ["mm", "auto"])
def test_a_scan_in_millimetres(units: str, arm: Path, scan: Path, truth: State, tmp_path: Path, pwralign: Call) -> None:
    points = 1e3 * Scan.load(scan).points
    np.save(tmp_path / "mm.npy", points)
    low, high = points.min(axis=0) - 1.0, points.max(axis=0) + 1.0
    outcome = pwralign("estimate", arm, tmp_path / "mm.npy", "--units", units, "--json", "--crop", *low, *high)
    assert outcome.code == 0
    assert ("taken as millimetres" in outcome.err) == (units == "auto")
    _assert_right(json.loads(outcome.out), truth)


def test_a_left_handed_scan_is_turned_as_it_is_read(
    arm: Path, scan: Path, truth: State, tmp_path: Path, pwralign: Call
) -> None:
    """What else is told of it is of the turned scan."""
    unity = tmp_path / "unity.xyz"
    np.savetxt(unity, Scan.load(scan).points * [-1.0, 1.0, 1.0])
    base = truth.T_scan_base[:3, 3]
    outcome = pwralign("estimate", arm, unity, "--json", "--left-handed", "--crop", *(base - 1.0), *(base + 1.0))
    assert outcome.code == 0, outcome.err
    _assert_right(json.loads(outcome.out), truth)


def test_crop_leaves_out_what_is_outside_the_box(
    arm: Path, scan: Path, truth: State, tmp_path: Path, pwralign: Call
) -> None:
    points = Scan.load(scan).points
    low, high = points.min(axis=0) - 0.01, points.max(axis=0) + 0.01
    beside = points + 1.5 * np.ptp(points, axis=0)
    np.save(tmp_path / "two.npy", np.concatenate([beside, points]))
    answer = _answer(pwralign("estimate", arm, tmp_path / "two.npy", "--json", "--crop", *low, *high))
    _assert_right(answer, truth)


def test_only_the_region_is_searched_in_the_unit_of_the_scan(
    arm: Path, scan: Path, truth: State, tmp_path: Path, pwralign: Call
) -> None:
    points = Scan.load(scan).points
    away = np.array([3.0, 0.0, 0.0])
    np.save(tmp_path / "twice.npy", 1e3 * np.concatenate([points, points + away]))
    low, high = 1e3 * (points.min(axis=0) + away - 0.01), 1e3 * (points.max(axis=0) + away + 0.01)
    answer = _answer(
        pwralign("estimate", arm, tmp_path / "twice.npy", "--json", "--units", "mm", "--region", *low, *high)
    )
    moved = truth.T_scan_base.copy()
    moved[:3, 3] += away
    _assert_right(answer, State(moved, truth.joints))


def test_low_confidence_has_its_own_exit_code(arm: Path, tmp_path: Path, pwralign: Call) -> None:
    np.save(tmp_path / "noise.npy", np.random.default_rng(3).uniform(-0.6, 0.6, (2000, 3)))
    outcome = pwralign("estimate", arm, tmp_path / "noise.npy", "--json")
    assert outcome.code == 3
    assert outcome.err.startswith("pwralign: warning: low confidence")
    assert json.loads(outcome.out)["confidence"] < 0.5


def test_correspondences_from_outside(
    arm: Path, scan: Path, truth: State, tmp_path: Path, pwralign: Call, write_arm: Callable[..., Path]
) -> None:
    source = np.random.default_rng(1).uniform([-0.25, -0.2, 0.05], [0.25, 0.2, 0.05], (60, 3))
    target = se3.transform(truth.T_scan_base, source)
    np.savez(tmp_path / "pairs.npz", source=source, target=target, weight=np.ones(60))
    answer = _answer(pwralign("estimate", arm, scan, "--json", "--correspondences", tmp_path / "pairs.npz"))
    _assert_right(answer, truth)


def test_finds_the_pose_in_a_depth_image(arm: Path, tmp_path: Path, pwralign: Call) -> None:
    (frame,) = simulate_sequence(ArticulatedModel.from_urdf(arm), 1, seed=3)
    image = frame.images[0]
    Image.fromarray(np.rint(1e4 * np.nan_to_num(image.depth)).astype(np.uint16)).save(tmp_path / "depth.png")
    K = image.intrinsics
    camera = ["--intrinsics", K[0, 0], K[1, 1], K[0, 2], K[1, 2], "--depth-scale", 1e-4]
    pose = image.T_scan_camera
    camera += ["--camera", *pose[:3, 3], *se3.quaternion_xyzw(pose)]
    _assert_right(_answer(pwralign("estimate", arm, tmp_path / "depth.png", "--json", *camera)), frame.state)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ((), "(intrinsics / --intrinsics)"),
        (("--intrinsics", 1, 1, 1, 1, "--sensor-origin", 0, 0, 0), "--camera says"),
        (("--intrinsics", 1, 1, 1, 1, "--left-handed"), "never left-handed"),
    ],
)
def test_a_depth_image_needs_its_camera(
    arm: Path, tmp_path: Path, pwralign: Call, options: tuple[object, ...], message: str
) -> None:
    Image.fromarray(np.full((10, 10), 1000, dtype=np.uint16)).save(tmp_path / "depth.png")
    outcome = pwralign("estimate", arm, tmp_path / "depth.png", *options)
    assert outcome.code in (1, 2)
    assert message in outcome.error()
