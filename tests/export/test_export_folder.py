"""The whole folder: which files there are, and that they are written together or not at all."""

from __future__ import annotations

import csv
import json
import re
import shlex
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from boxbot import BOT_JOINTS, BOT_VALUES, estimate_from, scan_of
from PIL import Image

from pwralign_kin.estimation.result import Estimate
from pwralign_kin.exceptions import ExportError, UnknownNameError
from pwralign_kin.export import FILES as ALL_FILES
from pwralign_kin.export import export, overlay
from pwralign_kin.model import ArticulatedModel
from pwralign_kin.render import posed_mesh
from pwralign_kin.scan import Scan
from pwralign_kin.state import State

FILES = {
    "aligned.urdf", "deviation.csv", "deviation.ply", "estimate.json", "initial_positions.yaml",
    "joint_state.yaml", "model.glb", "model.ply", "model.srdf", "overlay.png", "report.html", "state.json",
}  # fmt: skip


@pytest.fixture(scope="module")
def case(bot: ArticulatedModel, bot_state: State) -> tuple[Estimate, Scan, np.ndarray]:
    scan, labels = scan_of(bot, bot_state)
    return estimate_from(bot, bot_state, labels), scan, labels


@pytest.fixture(scope="module")
def folder(
    bot: ArticulatedModel, case: tuple[Estimate, Scan, np.ndarray], tmp_path_factory: pytest.TempPathFactory
) -> Path:
    folder = tmp_path_factory.mktemp("out") / "deep" / "result"
    written = export(case[0], bot, case[1], folder)
    assert {path.name for path in written} == FILES == set(ALL_FILES)
    assert all(path.parent == folder and path.stat().st_size for path in written)
    return folder


@pytest.fixture
def no_picture(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave out the picture, which takes most of the time."""
    monkeypatch.setattr(overlay, "write_overlay", lambda path, *rest: path.write_bytes(b"png"))


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


def test_the_folder_holds_the_files_and_nothing_is_left_beside_it(folder: Path) -> None:
    assert names(folder) == FILES
    assert names(folder.parent) == {folder.name}


def test_state_reads_back_exactly(folder: Path, bot_state: State) -> None:
    state = State.load(folder / "state.json")
    assert np.allclose(state.T_scan_base, bot_state.T_scan_base, rtol=0.0, atol=1e-15)
    assert state.joints == bot_state.joints
    assert state.base_link == "base"


def test_estimate_is_strict_json_with_the_summary(folder: Path) -> None:
    def refuse(constant: str) -> None:
        raise AssertionError(constant)

    summary = json.loads((folder / "estimate.json").read_text(), parse_constant=refuse)
    assert summary["joints"] == BOT_JOINTS
    assert summary["confidence"] == 0.9
    assert summary["std"]["wrist"] is None
    assert summary["base_covariance"] == np.diag(np.arange(1.0, 7.0)).tolist()


def test_joint_state_is_a_ros_message_with_mimicking_joints(folder: Path) -> None:
    message = yaml.safe_load((folder / "joint_state.yaml").read_text())
    assert dict(zip(message["name"], message["position"], strict=True)) == pytest.approx(BOT_VALUES, abs=1e-15)
    assert message["velocity"] == message["effort"] == []
    assert message["header"] == {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""}


def test_the_joint_state_that_the_documents_publish_is_of_now(folder: Path, repository: Path) -> None:
    """The state publisher of ROS passes over states of time 0."""
    told = (repository / "docs" / "outputs.md").read_text(encoding="utf-8")
    command = re.search(r"\$\((sed .* joint_state\.yaml)\)", told)
    assert command is not None
    sent = subprocess.run(shlex.split(command[1]), cwd=folder, capture_output=True, text=True, check=True).stdout
    written = yaml.safe_load((folder / "joint_state.yaml").read_text())
    assert yaml.safe_load(sent) == {**written, "header": {"stamp": "now", "frame_id": ""}}


def test_initial_positions_name_the_actuated_joints(folder: Path) -> None:
    assert yaml.safe_load((folder / "initial_positions.yaml").read_text()) == {"initial_positions": BOT_JOINTS}


def test_deviation_table_describes_the_points_of_each_part(
    folder: Path, bot: ArticulatedModel, case: tuple[Estimate, Scan, np.ndarray]
) -> None:
    _, scan, labels = case
    with (folder / "deviation.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["name"] for row in rows] == [part.name for part in bot.parts]
    kept = labels[scan.source_index]
    assert [int(row["points"]) for row in rows] == [np.count_nonzero(kept == index) for index in range(len(rows))]
    for row in rows:
        if int(row["points"]):
            assert float(row["rms"]) < 2e-3  # the noise of the scan is 1 mm in each direction
            assert abs(float(row["mean"])) <= float(row["rms"]) <= float(row["max_abs"])


def test_overlay_is_a_picture_with_colour(folder: Path) -> None:
    picture = np.asarray(Image.open(folder / "overlay.png").convert("RGB")).astype(int)
    assert picture.shape[1] == overlay.WIDTH
    assert np.ptp(picture, axis=2).max() > 60
    assert (picture == 255).all(axis=2).mean() > 0.3


@pytest.fixture
def written(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The texts that are written into a picture, which is small."""
    texts: list[str] = []
    write = overlay._write

    def note(pen: Any, place: tuple[int, int], text: str, size: int, ink: tuple[int, int, int]) -> None:
        texts.append(text)
        write(pen, place, text, size, ink)

    monkeypatch.setattr(overlay, "_write", note)
    monkeypatch.setattr(overlay, "WIDTH", 640)
    return texts


def test_the_legend_names_what_there_is_and_doubts(
    bot: ArticulatedModel, case: tuple[Estimate, Scan, np.ndarray], tmp_path: Path, written: list[str]
) -> None:
    found, scan, labels = case
    near = Scan(scan.points[labels[scan.source_index] >= 0])
    mesh = posed_mesh(bot, found.state)
    up = np.array([0.0, 0.0, 1.0])
    overlay.write_overlay(tmp_path / "a.png", bot, replace(found, undetermined=("wrist",)), mesh, near, up)
    assert "scan point on the model" in written
    assert "scan point off it" not in written
    moved = {part.name for part in bot.parts if part.joint is not None and part.joint.name == "wrist"}
    doubted = {text.partition(" (")[0] for text in written if "joint undetermined" in text}
    assert doubted == moved


@pytest.mark.parametrize("believed", [True, False])
def test_a_view_is_from_the_sensor_only_where_the_estimate_believes_in_its_place(
    bot: ArticulatedModel, case: tuple[Estimate, Scan, np.ndarray], tmp_path: Path, written: list[str], believed: bool
) -> None:
    found, scan, _ = case
    seen = scan.with_sensor_origin(scan.box[1] + 2.0 * scan.diagonal)
    mesh, up = posed_mesh(bot, found.state), np.array([0.0, 0.0, 1.0])
    overlay.write_overlay(tmp_path / "a.png", bot, replace(found, viewpoint_known=believed), mesh, seen, up)
    assert any("seen from the sensor" in text for text in written) == believed


def test_an_inset_shows_the_whole_scan_of_a_scene(
    bot: ArticulatedModel, case: tuple[Estimate, Scan, np.ndarray], tmp_path: Path, written: list[str]
) -> None:
    found, scan, _ = case
    mesh = posed_mesh(bot, found.state)
    up = np.array([0.0, 0.0, 1.0])
    rng = np.random.default_rng(0)
    room = Scan(np.concatenate([scan.points, mesh.centre + 5.0 * mesh.diagonal * rng.uniform(-1.0, 1.0, (4000, 3))]))
    boxed = []
    for share, points in ((0.9, scan), (0.1, room)):
        path = tmp_path / f"{share}.png"
        overlay.write_overlay(path, bot, replace(found, scan_coverage=share), mesh, points, up)
        picture = np.asarray(Image.open(path).convert("RGB"))
        boxed.append(bool((picture == overlay._BOX).all(axis=2).any()))
    assert boxed == [False, True]
    assert written.count("the whole scan") == 1


def test_a_note_names_the_joints_that_ros_files_leave_out(
    tmp_path: Path, no_picture: None, caplog: pytest.LogCaptureFixture
) -> None:
    box = '<visual><geometry><box size="0.2 0.3 0.4"/></geometry></visual>'
    (tmp_path / "free.urdf").write_text(
        f'<robot name="free"><link name="a">{box}</link><link name="b">{box}</link>'
        '<joint name="table" type="planar"><parent link="a"/><child link="b"/><axis xyz="0 0 1"/></joint></robot>'
    )
    model = ArticulatedModel.from_urdf(tmp_path / "free.urdf")
    state = State(joints={"table.x": 0.1, "table.y": 0.6, "table.yaw": 0.2})
    scan, labels = scan_of(model, state)
    caplog.set_level("INFO", "pwralign_kin")
    export(estimate_from(model, state, labels), model, scan, tmp_path / "out")
    (note,) = [record.getMessage() for record in caplog.records if "joint_state.yaml" in record.getMessage()]
    assert "table" in note


def test_other_files_stay_and_old_ones_are_replaced(
    bot: ArticulatedModel, case: tuple[Estimate, Scan, np.ndarray], tmp_path: Path, no_picture: None
) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    (tmp_path / "state.json").write_text("old")
    export(case[0], bot, case[1], tmp_path)
    assert names(tmp_path) == FILES | {"notes.txt"}
    assert (tmp_path / "notes.txt").read_text() == "mine"
    assert State.load(tmp_path / "state.json").joints == BOT_JOINTS


def test_a_failure_leaves_the_folder_as_it_was(
    bot: ArticulatedModel,
    case: tuple[Estimate, Scan, np.ndarray],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def fail(*arguments: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(overlay, "write_overlay", fail)
    out = tmp_path / "out"
    with pytest.raises(ExportError, match="No space left"):
        export(case[0], bot, case[1], out)
    assert names(tmp_path) == set()

    out.mkdir()
    (out / "state.json").write_text("old")
    with pytest.raises(ExportError):
        export(case[0], bot, case[1], out)
    assert names(tmp_path) == {"out"}
    assert names(out) == {"state.json"}
    assert (out / "state.json").read_text() == "old"


def test_targets_that_cannot_be_written_are_named(
    bot: ArticulatedModel, case: tuple[Estimate, Scan, np.ndarray], tmp_path: Path, no_picture: None
) -> None:
    (tmp_path / "file").write_text("not a folder")
    for target in (tmp_path / "file", tmp_path / "file" / "below"):
        with pytest.raises(ExportError, match="file"):
            export(case[0], bot, case[1], target)
    (tmp_path / "out" / "model.glb").mkdir(parents=True)
    with pytest.raises(ExportError, match=r"model\.glb"):
        export(case[0], bot, case[1], tmp_path / "out")
    assert names(tmp_path / "out") == {"model.glb"}


def test_an_estimate_of_another_scan_is_refused(
    bot: ArticulatedModel, case: tuple[Estimate, Scan, np.ndarray], tmp_path: Path
) -> None:
    with pytest.raises(ExportError, match=r"402 scan points, this scan has 50"):
        export(case[0], bot, Scan(case[1].points[:50]), tmp_path / "out")
    assert names(tmp_path) == set()


def test_an_unknown_up_axis_is_refused(
    bot: ArticulatedModel, case: tuple[Estimate, Scan, np.ndarray], tmp_path: Path
) -> None:
    with pytest.raises(UnknownNameError, match="valid: x, y, z, -x, -y, -z"):
        export(case[0], bot, case[1], tmp_path / "out", up="upwards")
