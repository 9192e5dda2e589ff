"""Usage errors, help, version, unexpected errors, and the other verbs."""

from __future__ import annotations

import builtins
import importlib.metadata
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any, get_args, get_type_hints

import numpy as np
import pytest
from command_line import Call

from pwralign_kin import State, dependencies
from pwralign_kin.cli import EXAMPLES, VERBS, _app
from pwralign_kin.cli.simulate import SensorOptions
from pwralign_kin.exceptions import DependencyError
from pwralign_kin.model import ArticulatedModel
from pwralign_kin.simulation import TIERS


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["estimat"], "estimate"),
        (["estimate"], "URDF"),
        (["estimate", "a"], "SCAN"),
        (["estimate", "a", "b", "c", "--correspondences", "d"], "--correspondences"),
        (["estimate", "a", "b", "--jiont", "x=1"], "--joint"),
        (["estimate", "a", "b", "--joint", "x"], "name=value"),
        (["estimate", "a", "b", "--joint", "x=fast"], "x=fast"),
        (["estimate", "a", "b", "--joint", "x=nan"], "x=nan"),
        (["estimate", "a", "b", "--joint", "=1"], "name=value"),
        (["estimate", "a", "b", "--base", "1", "2", "3"], "--base"),
        (["estimate", "a", "b", "--base", "0", "0", "0", "0", "0", "x", "1"], "--base"),
        (["estimate", "a", "b", "--initial", "s", "--base", *"0000001"], "--initial"),
        (["estimate", "a", "b", "--units", "km"], "--units"),
        (["estimate", "a", "b", "--up", "w"], "--up"),
        (["estimate", "a", "b", "--bundle"], "--out"),
        (["estimate", "a", "b", "--up", "y"], "--gravity"),
        (["estimate", "a", "b", "--seed", "-1"], "--seed"),
        (["estimate", "a", "b", "--threads", "-2"], "--threads"),
        (["simulate", "a"], "--out"),
        (["simulate", "a", "--out", "b", "--tier", "best"], "--tier"),
        (["simulate", "a", "--out", "b", "--contacts", "1"], "--scene"),
        (["simulate", "a", "--out", "b", "--scene", "--views", "2"], "--scene"),
    ],
    ids=" ".join,
)
def test_usage_errors(arguments: list[str], named: str, pwralign: Call) -> None:
    outcome = pwralign(*arguments)
    assert outcome.code == 2
    assert named in outcome.error()
    assert len(outcome.err.splitlines()) == 1


def test_help_and_version(pwralign: Call) -> None:
    assert pwralign("--version").out.strip() == importlib.metadata.version("pwralign-kin")
    top = pwralign("--help")
    assert top.code == 0
    assert all(verb in top.out for verb in VERBS)
    assert pwralign().out == top.out
    for verb in VERBS:
        usage, *_ = pwralign(verb, "--help").out.splitlines()
        assert f"pwralign {verb}" in usage and "ARGS" not in usage


def test_the_help_of_estimate_groups_its_options_and_shows_examples(pwralign: Call) -> None:
    text = pwralign("estimate", "--help").out
    titles = ("Output", "Guess and knowledge", "Scan", "Model", "Search")
    places = [text.index(f"─ {title} ─") for title in titles]
    assert places == sorted(places) and "─ Parameters ─" not in text
    for option, before in (("--out", 1), ("--gravity", 2), ("--near", 3), ("--xacro-arg", 4)):
        assert places[before - 1] < text.index(f"│ {option} ") < places[before]
    assert all(f"Example: {example}" in text for example in EXAMPLES["estimate"])


@pytest.mark.parametrize("verb", EXAMPLES)
def test_examples_of_the_help_are_commands_that_there_are(verb: str) -> None:
    for example in EXAMPLES[verb]:
        program, *tokens = example.split()
        command, bound, _ = _app().parse_args(tokens, exit_on_error=False, print_error=False)
        assert program == "pwralign" and command.__name__ == verb and bound.arguments


def test_help_comes_at_once() -> None:
    def seconds() -> float:
        """Of the processor: other work on the machine makes it wait, but is not its fault."""
        before = os.times()
        subprocess.run([Path(sys.executable).parent / "pwralign", "--help"], check=True, capture_output=True)
        after = os.times()
        return after.children_user + after.children_system - before.children_user - before.children_system

    assert 0.0 < min(seconds() for _ in range(3)) < 1.0


def test_help_loads_no_heavy_library() -> None:
    script = "import sys; from pwralign_kin.cli import main; main(['--help']);sys.stderr.write(' '.join(sys.modules))"
    loaded = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stderr.split()
    assert "cyclopts" in loaded
    assert not {"numpy", "scipy", "open3d", "pinocchio", "casadi", "trimesh", "pwralign_kin.kernels"} & set(loaded)


def test_an_unexpected_error_leaves_a_traceback_in_a_file(
    arm: Path, pwralign: Call, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: object, **__: object) -> None:
        raise ValueError("first line\nsecond line")

    monkeypatch.setattr(ArticulatedModel, "from_urdf", broken)
    outcome = pwralign("inspect", arm)
    assert outcome.code == 70
    error = outcome.error()
    assert "ValueError: first line second line" in error
    report = Path(error.split()[-1].rstrip(")"))
    assert "Traceback" in report.read_text()


@pytest.mark.parametrize("code", [0, 1])
def test_a_library_that_ends_the_process_is_no_success(
    code: int, arm: Path, pwralign: Call, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ArticulatedModel, "from_urdf", lambda *_, **__: sys.exit(code))
    outcome = pwralign("inspect", arm)
    assert outcome.code == 70 and "SystemExit" in outcome.error()


@pytest.mark.parametrize("error", [ImportError, OSError])
def test_a_system_library_that_does_not_load_gets_its_install_line(
    error: type[ImportError | OSError], arm: Path, pwralign: Call, monkeypatch: pytest.MonkeyPatch
) -> None:
    def unloadable(*_: object, **__: object) -> None:
        raise error("libGL.so.1: cannot open shared object file: No such file or directory")

    monkeypatch.setattr(ArticulatedModel, "from_urdf", unloadable)
    outcome = pwralign("inspect", arm)
    assert outcome.code == 1
    assert "apt-get install -y libgl1" in outcome.error()


def test_a_missing_module_gets_its_install_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "open3d", None)
    with pytest.raises(DependencyError, match="pip install open3d-cpu"):
        dependencies.open3d()


def test_an_interrupted_import_is_no_broken_library(monkeypatch: pytest.MonkeyPatch) -> None:
    def stopped(module: str) -> None:
        raise ImportError("initialization failed") from KeyboardInterrupt()

    monkeypatch.setattr(dependencies, "import_module", stopped)
    with pytest.raises(KeyboardInterrupt):
        dependencies.open3d()


@pytest.mark.parametrize("verb", ["estimate", "track", "calibrate", "simulate"])
@pytest.mark.parametrize("json_too", [False, True])
def test_a_reader_who_has_gone_changes_neither_files_nor_exit_code(
    verb: str, json_too: bool, arm: Path, scan: Path, tmp_path: Path
) -> None:
    if verb == "simulate" and json_too:
        pytest.skip("simulate has no --json")
    np.save(tmp_path / "noise.npy", np.random.default_rng(3).uniform(-0.6, 0.6, (2000, 3)))
    noise, out = tmp_path / "noise.npy", tmp_path / "out"
    arguments, code, written = {
        "estimate": ([arm, noise, "--out", out], 3, out / "estimate.json"),
        "track": ([arm, scan, "--out", out], 0, out / "track.json"),
        "calibrate": ([arm, f"{noise}={scan.with_name('truth.json')}", "--out", out], 3, out),
        "simulate": ([arm, "--out", out], 0, out / "scan.ply"),
    }[verb]
    reader, writer = os.pipe()
    os.close(reader)
    done = subprocess.run(
        [Path(sys.executable).parent / "pwralign", verb, *arguments, *["--json"] * json_too],
        stdout=writer, stderr=subprocess.PIPE, text=True, check=False,
    )  # fmt: skip
    os.close(writer)
    assert done.returncode == code, done.stderr
    assert written.stat().st_size > 0
    assert "error" not in done.stderr


def test_help_that_nobody_reads_to_its_end_is_no_error() -> None:
    reader, writer = os.pipe()
    os.close(reader)
    done = subprocess.run(
        [Path(sys.executable).parent / "pwralign", "estimate", "--help"],
        stdout=writer, stderr=subprocess.PIPE, text=True, check=False,
    )  # fmt: skip
    os.close(writer)
    assert (done.returncode, done.stderr) == (0, "")


def test_bad_input_is_an_error_whether_or_not_there_is_a_reader(arm: Path) -> None:
    reader, writer = os.pipe()
    os.close(reader)
    done = subprocess.run(
        [Path(sys.executable).parent / "pwralign", "inspect", arm, "nowhere.ply"],
        stdout=writer, stderr=subprocess.PIPE, text=True, check=False,
    )  # fmt: skip
    os.close(writer)
    assert done.returncode == 1
    assert "nowhere.ply: no such file" in done.stderr


def test_inspect_shows_parts_and_joints(arm: Path, pwralign: Call) -> None:
    outcome = pwralign("inspect", arm)
    assert outcome.code == 0, outcome.err
    lines = outcome.out.splitlines()
    assert lines[0].startswith("arm: 3 parts, 2 joints")
    rows = [line.split() for line in lines]
    assert ["elbow", "revolute", "-57.3", "deg", "57.3", "deg"] in rows
    assert next(row for row in rows if row[:1] == ["lower"])[-1] == "elbow"


@pytest.mark.parametrize("scale", [1.0, 1e3])
def test_inspect_guesses_the_unit_of_a_scan(
    scale: float, arm: Path, scan: Path, tmp_path: Path, pwralign: Call
) -> None:
    from pwralign_kin.scan import Scan

    np.save(tmp_path / "x.npy", scale * Scan.load(scan).points)
    outcome = pwralign("inspect", arm, tmp_path / "x.npy")
    assert outcome.code == 0, outcome.err
    assert ("--units mm" in outcome.out) == (scale == 1e3)
    assert "3000" in outcome.out


def test_inspect_tells_the_scale_of_a_depth_image(arm: Path, tmp_path: Path, pwralign: Call) -> None:
    from PIL import Image

    depth = np.full((60, 80), 1000, np.uint16)
    depth[20:40, 30:50] = 1300
    Image.fromarray(depth).save(tmp_path / "x.png")
    for scale, words in (
        ("1", "its --depth-scale is 0.001 times"),
        ("0.008", "depth in another unit: give --depth-scale"),
    ):
        camera = ["--intrinsics", "60", "60", "39.5", "29.5", "--depth-scale", scale]
        outcome = pwralign("inspect", arm, tmp_path / "x.png", *camera)
        assert words in outcome.out and "--units" not in outcome.out, outcome.out


def test_simulate_poses_the_model_as_asked(arm: Path, tmp_path: Path, pwralign: Call) -> None:
    state = State(joints={"shoulder": 0.1, "elbow": 0.2})
    state.save(tmp_path / "state.json")
    outcome = pwralign(
        "simulate", arm, "--out", tmp_path / "sim", "--state", tmp_path / "state.json",
        "--joint", "elbow=-0.5", "--tier", "single", "--points", 400, "--noise", 0,
        "--outliers", 0.1, "--missing-part", "lower",
    )  # fmt: skip
    assert outcome.code == 0, outcome.err
    truth = State.load(tmp_path / "sim" / "truth.json")
    assert truth.joints == {"shoulder": 0.1, "elbow": -0.5}
    assert truth.T_scan_base.tolist() == state.T_scan_base.tolist()
    assert json.loads((tmp_path / "sim" / "truth.json").read_text())["sensor_origin"] is not None
    assert " points on 2 of 3 parts of arm" in outcome.out


def test_simulate_puts_the_model_in_a_room(arm: Path, tmp_path: Path, pwralign: Call) -> None:
    outcome = pwralign(
        "simulate", arm, "--out", tmp_path, "--scene", "--second-copy", "--occluders", 1, "--furniture", 1,
        "--no-table", "--joint", "elbow=-0.5", "--seed", 3,
    )  # fmt: skip
    assert outcome.code == 0, outcome.err
    truth = json.loads((tmp_path / "truth.json").read_text())
    assert truth["joints"]["elbow"] == -0.5 and truth["sensor_origin"] == [0.0, 0.0, 0.0]
    labels = np.load(tmp_path / "labels.npz")
    own = int((labels["part"] >= 0).sum())
    assert f"{len(labels['part'])} points, {own} of them on 3 of 3 parts of arm" in outcome.out
    assert len(truth["copies"]) == len(labels["copies"]) == 1
    assert labels["copies"].shape == (1, len(labels["part"])) and (labels["copies"] >= 0).any()


def test_simulate_offers_every_tier() -> None:
    tiers, none = get_args(get_type_hints(SensorOptions, include_extras=False)["tier"])
    assert set(get_args(tiers)) == set(TIERS) and none is type(None)


def test_doctor_on_a_sound_machine(pwralign: Call) -> None:
    outcome = pwralign("doctor")
    assert outcome.code == 0, outcome.out
    assert outcome.out.endswith("all well\n")


def test_doctor_names_missing_system_libraries(pwralign: Call, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dependencies, "missing_system_libraries", lambda: ("libegl1", "libgomp1"))
    outcome = pwralign("doctor")
    assert outcome.code == 1
    assert "apt-get install -y libegl1 libgomp1" in outcome.out


def test_doctor_finds_two_open3d(pwralign: Call, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.metadata, "version", lambda name: "1.0")
    outcome = pwralign("doctor")
    assert outcome.code == 1
    assert "pip uninstall -y open3d open3d-cpu" in outcome.out


def test_doctor_tries_to_write_the_cache(pwralign: Call, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setenv("PWRALIGN_CACHE_DIR", str(tmp_path / "file" / "cache"))
    outcome = pwralign("doctor")
    assert outcome.code == 1
    assert "PWRALIGN_CACHE_DIR" in outcome.out


def test_an_interruption_while_libraries_load_is_one(monkeypatch: pytest.MonkeyPatch, pwralign: Call) -> None:
    real = builtins.__import__

    def interrupted(name: str, *rest: Any, **more: Any) -> Any:
        if name == "cyclopts":
            raise KeyboardInterrupt
        return real(name, *rest, **more)

    with monkeypatch.context() as patched:
        patched.setattr(builtins, "__import__", interrupted)
        outcome = pwralign("doctor")
    assert outcome.code == 130 and outcome.error() == "interrupted"
