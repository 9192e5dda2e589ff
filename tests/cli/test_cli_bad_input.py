"""Bad input gets one clear line and exit code 1: no traceback, nothing half-written, no empty result."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from command_line import LIMIT, Call

from pwralign_kin.cli import messages
from pwralign_kin.scan import Scan

POINTS = np.random.default_rng(0).uniform(-0.3, 0.3, (500, 3))


@pytest.fixture
def cloud(tmp_path: Path) -> Path:
    np.save(tmp_path / "cloud.npy", POINTS)
    return tmp_path / "cloud.npy"


@pytest.fixture
def refused(pwralign: Call, tmp_path: Path) -> Callable[..., str]:
    """Estimate with --out, expect exit code 1 and no trace of the output, and return the error."""

    def call(*arguments: object) -> str:
        before = sorted(tmp_path.iterdir())
        outcome = pwralign("estimate", *arguments, "--out", tmp_path / "result")
        assert outcome.code == 1
        assert sorted(tmp_path.iterdir()) == before
        return outcome.error()

    return call


def test_missing_files(arm: Path, cloud: Path, tmp_path: Path, refused: Callable[..., str]) -> None:
    assert "none.urdf" in refused(tmp_path / "none.urdf", cloud)
    assert "none.ply" in refused(arm, tmp_path / "none.ply")
    assert "none.json" in refused(arm, cloud, "--initial", tmp_path / "none.json")
    assert "none.npz" in refused(arm, cloud, "--correspondences", tmp_path / "none.npz")


def test_folders_in_the_place_of_files(arm: Path, cloud: Path, tmp_path: Path, refused: Callable[..., str]) -> None:
    for name in ("folder.urdf", "folder.ply", "folder.json"):
        (tmp_path / name).mkdir()
    assert "folder.urdf" in refused(tmp_path / "folder.urdf", cloud)
    assert "folder.ply" in refused(arm, tmp_path / "folder.ply")
    assert "folder.json" in refused(arm, cloud, "--initial", tmp_path / "folder.json")


@pytest.mark.parametrize("name", ["x.ply", "x.pcd", "x.xyz", "x.npy", "x.npz", "x.stl", "x.obj", "x.glb", "x.foo"])
@pytest.mark.parametrize("content", [b"", b"\x00\xff\xfe garbage \n\x01" * 9], ids=["empty", "garbage"])
def test_scan_files_that_are_none(
    name: str, content: bytes, arm: Path, tmp_path: Path, refused: Callable[..., str]
) -> None:
    (tmp_path / name).write_bytes(content)
    assert name in refused(arm, tmp_path / name)


@pytest.mark.parametrize("content", [b"", b"\x00\xff", b"<robot", b"<robot name='a'/>", b"<sdf/>", b"{}"])
def test_urdf_files_that_are_none(content: bytes, cloud: Path, tmp_path: Path, refused: Callable[..., str]) -> None:
    (tmp_path / "x.urdf").write_bytes(content)
    assert "x.urdf" in refused(tmp_path / "x.urdf", cloud)


def test_xacro_arguments_reach_the_xacro(arm: Path, tmp_path: Path, pwralign: Call) -> None:
    pytest.importorskip("xacrodoc", reason="the xacro extra is not installed")
    text = arm.read_text().replace('name="arm">', 'name="$(arg name)" xmlns:xacro="http://www.ros.org/wiki/xacro">', 1)
    xacro = tmp_path / "arm.urdf.xacro"
    xacro.write_text(text.replace("<link", '<xacro:arg name="name"/><link', 1))
    assert "--xacro-arg name=VALUE" in pwralign("inspect", xacro).error()
    for given in ("name=left", "name:=left"):
        outcome = pwralign("inspect", xacro, "--xacro-arg", given)
        assert outcome.code == 0 and outcome.out.startswith("left: 3 parts"), outcome.err
    assert "name=value" in pwralign("inspect", xacro, "--xacro-arg", "left").error()
    assert "no such folder" in pwralign("inspect", arm, "--package-dir", tmp_path / "none").error()


def test_missing_meshes_are_named(write_arm: Callable[..., Path], cloud: Path, refused: Callable[..., str]) -> None:
    link = '<link name="{0}"><visual><geometry><mesh filename="{1}"/></geometry></visual></link>'
    joint = '<joint name="j{0}" type="fixed"><parent link="base"/><child link="{0}"/></joint>'
    more = "".join(
        link.format(name, mesh) + joint.format(name)
        for name, mesh in (("a", "hand.stl"), ("b", "package://nowhere/foot.dae"))
    )
    error = refused(write_arm(more=more), cloud)
    assert "hand.stl" in error
    assert "package://nowhere/foot.dae" in error
    assert "--package-dir" in error


def test_inspect_lists_where_missing_meshes_were_looked_for(
    write_arm: Callable[..., Path], tmp_path: Path, pwralign: Call
) -> None:
    urdf = write_arm(
        more='<link name="a"><visual><geometry><mesh filename="hand.stl"/></geometry></visual></link>'
        '<joint name="j" type="fixed"><parent link="base"/><child link="a"/></joint>'
    )
    outcome = pwralign("inspect", urdf)
    assert outcome.code == 1
    assert str(tmp_path / "hand.stl") in outcome.out
    assert "hand.stl" in outcome.err


def test_a_model_without_geometry(tmp_path: Path, cloud: Path, refused: Callable[..., str]) -> None:
    (tmp_path / "x.urdf").write_text('<robot name="a"><link name="b"/></robot>')
    assert "geometry" in refused(tmp_path / "x.urdf", cloud)


@pytest.mark.parametrize(
    ("head", "limit"),
    [("<robot>", LIMIT), ('<robot name="arm">', "")],
    ids=["no name", "no limits"],
)
def test_small_faults_of_a_urdf_are_mended_with_a_warning(
    head: str, limit: str, write_arm: Callable[..., Path], scan: Path, pwralign: Call
) -> None:
    outcome = pwralign("estimate", write_arm(head=head, shoulder_limit=limit), scan)
    assert outcome.code == 0, outcome.err
    assert outcome.err.startswith("pwralign: warning: ")
    assert "shoulder" in outcome.out


def test_degenerate_triangles_do_no_harm(
    write_arm: Callable[..., Path], tmp_path: Path, scan: Path, pwralign: Call
) -> None:
    (tmp_path / "mesh.obj").write_text(
        "v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nv 0 0 0.1\nv 0.05 0 0\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\nf 1 5 2\nf 1 1 1\n"
    )
    urdf = write_arm(
        more='<link name="a"><visual><geometry><mesh filename="mesh.obj"/></geometry></visual></link>'
        '<joint name="j" type="fixed"><parent link="base"/><child link="a"/></joint>'
    )
    outcome = pwralign("estimate", urdf, scan)
    assert outcome.code == 0, outcome.err
    assert "nan" not in outcome.out


def test_a_mesh_of_nothing_but_degenerate_triangles(tmp_path: Path, cloud: Path, refused: Callable[..., str]) -> None:
    (tmp_path / "flat.obj").write_text("v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n")
    (tmp_path / "x.urdf").write_text(
        '<robot name="a"><link name="b"><visual><geometry>'
        '<mesh filename="flat.obj"/></geometry></visual></link></robot>'
    )
    refused(tmp_path / "x.urdf", cloud)


@pytest.mark.parametrize(
    ("points", "fault"),
    [
        (np.empty((0, 3)), "no points"),
        (np.full((100, 3), np.nan), "finite"),
        (np.ones((100, 3)), "distinct"),
        (np.zeros((100, 2)), "shape"),
    ],
    ids=["empty", "all NaN", "one place", "flat"],
)
def test_scans_without_content(
    points: np.ndarray, fault: str, arm: Path, tmp_path: Path, refused: Callable[..., str]
) -> None:
    np.save(tmp_path / "x.npy", points)
    assert fault in refused(arm, tmp_path / "x.npy")


def test_dropped_points_are_counted(arm: Path, scan: Path, tmp_path: Path, pwralign: Call) -> None:
    points = Scan.load(scan).points
    np.save(tmp_path / "x.npy", np.concatenate([points, points[:7], np.full((5, 3), np.nan)]))
    outcome = pwralign("estimate", arm, tmp_path / "x.npy")
    assert outcome.code == 0
    assert "5 non-finite and 7 duplicate" in outcome.err


@pytest.mark.parametrize("content", ["truncated", "array", "scalar"])
def test_correspondences_that_are_none(
    content: str, arm: Path, cloud: Path, tmp_path: Path, refused: Callable[..., str]
) -> None:
    file = tmp_path / "pairs.npz"
    np.savez(file, source=1.0 if content == "scalar" else POINTS, target=POINTS)
    if content == "truncated":
        file.write_bytes(file.read_bytes()[:-200])
    if content == "array":
        with file.open("wb") as stream:
            np.save(stream, POINTS)
    assert "pairs.npz" in refused(arm, cloud, "--correspondences", file)


def test_a_state_whose_base_link_is_no_name(
    arm: Path, cloud: Path, tmp_path: Path, refused: Callable[..., str]
) -> None:
    (tmp_path / "s.json").write_text(json.dumps({"T_scan_base": np.eye(4).tolist(), "base_link": ["base"]}))
    assert "base_link" in refused(arm, cloud, "--initial", tmp_path / "s.json")


def test_hints_that_lead_away_from_the_scan(arm: Path, cloud: Path, refused: Callable[..., str]) -> None:
    assert "50" in refused(arm, cloud, "--near", 50, 50, 50)
    assert "no point is in the region" in refused(arm, cloud, "--region", 5, 5, 5, 6, 6, 6)


def test_arguments_mixed_up(arm: Path, cloud: Path, pwralign: Call) -> None:
    swapped = pwralign("estimate", cloud, arm)
    assert swapped.code == 2 and "the URDF comes first" in swapped.error()
    assert "--joint elbow=1" in pwralign("estimate", arm, cloud, "--lock", "elbow=1").error()


def test_a_joint_with_two_values(arm: Path, cloud: Path, pwralign: Call) -> None:
    twice = pwralign("estimate", arm, cloud, "--joint", "elbow=0.5", "--joint", "elbow=0.6")
    assert twice.code == 2 and "elbow is given twice, as 0.5 and 0.6" in twice.error()


@pytest.mark.parametrize("option", [("--camera", 0, 0, 1, 0, 0, 0, 1), ("--intrinsics", 500, 500, 320, 240)])
def test_a_camera_for_a_scan_that_is_no_depth_image(
    option: tuple[object, ...], arm: Path, cloud: Path, pwralign: Call
) -> None:
    for verb in ("estimate", "inspect"):
        outcome = pwralign(verb, arm, cloud, *option)
        assert outcome.code == 2 and "is no depth image" in outcome.err


def test_poses_beyond_the_limits_are_not_simulated(arm: Path, tmp_path: Path, pwralign: Call) -> None:
    outcome = pwralign("simulate", arm, "--joint", "elbow=9", "--out", tmp_path / "out")
    assert outcome.code == 1 and "limits" in outcome.error() and not (tmp_path / "out").exists()


def test_boxes_and_numbers_out_of_range(arm: Path, cloud: Path, refused: Callable[..., str]) -> None:
    assert "least and a greatest corner" in refused(arm, cloud, "--region", 1, 0, 0, 0, 1, 1)
    assert "near" in refused(arm, cloud, "--near", "nan", 0, 0)


def test_millimetres_are_told_and_the_option_named(
    arm: Path, scan: Path, tmp_path: Path, refused: Callable[..., str]
) -> None:
    np.save(tmp_path / "mm.npy", 1e3 * Scan.load(scan).points)
    assert "--units mm" in refused(arm, tmp_path / "mm.npy")


def test_a_scan_far_smaller_than_the_model(arm: Path, tmp_path: Path, pwralign: Call) -> None:
    np.save(tmp_path / "x.npy", 1e-3 * POINTS)
    outcome = pwralign("estimate", arm, tmp_path / "x.npy")
    assert outcome.code == 1 and "at its scale" in outcome.error()


def test_names_that_do_not_exist(arm: Path, cloud: Path, tmp_path: Path, refused: Callable[..., str]) -> None:
    assert "'shoulder'" in refused(arm, cloud, "--joint", "sholder=1")
    assert "'elbow'" in refused(arm, cloud, "--lock", "elbo")
    (tmp_path / "guess.json").write_text(
        '{"T_scan_base": [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]], "joints": {"x": 1}}'
    )
    assert "'x'" in refused(arm, cloud, "--initial", tmp_path / "guess.json")


@pytest.mark.parametrize(
    "content",
    ["", "[]", "{}", '{"T_scan_base": 3}', '{"T_scan_base": [[1,2],[3,4]]}', '{"T_scan_base": null}'],
)
def test_malformed_states(content: str, arm: Path, cloud: Path, tmp_path: Path, refused: Callable[..., str]) -> None:
    (tmp_path / "guess.json").write_text(content)
    assert "guess.json" in refused(arm, cloud, "--initial", tmp_path / "guess.json")


def test_impossible_numbers(arm: Path, cloud: Path, refused: Callable[..., str]) -> None:
    assert "quaternion" in refused(arm, cloud, "--base", 0, 0, 0, 0, 0, 0, 0)
    assert "finite" in refused(arm, cloud, "--base", "nan", 0, 0, 0, 0, 0, 1)
    assert "crop" in refused(arm, cloud, "--crop", 1, 1, 1, 0, 0, 0)
    assert "crop" in refused(arm, cloud, "--crop", 5, 5, 5, 6, 6, 6)
    assert "finite" in refused(arm, cloud, "--sensor-origin", 0, 0, "inf")


def test_output_that_cannot_be_written(arm: Path, cloud: Path, tmp_path: Path, pwralign: Call) -> None:
    for place in (cloud, cloud / "below"):
        outcome = pwralign("estimate", arm, cloud, "--out", place)
        assert outcome.code == 1
        assert str(place) in outcome.error()
    assert np.array_equal(np.load(cloud), POINTS)


def test_output_that_is_in_the_way_is_found_before_the_search(
    arm: Path, cloud: Path, tmp_path: Path, pwralign: Call, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("pwralign_kin.estimation.estimate", lambda *_, **__: pytest.fail("searched in vain"))
    (tmp_path / "link").symlink_to(tmp_path / "nowhere")
    outcome = pwralign("estimate", arm, cloud, "--out", tmp_path / "link")
    assert outcome.code == 1 and "a link to nothing" in outcome.error()
    (tmp_path / "out" / "state.json").mkdir(parents=True)
    outcome = pwralign("estimate", arm, cloud, "--out", tmp_path / "out")
    assert outcome.code == 1 and "cannot write state.json: a folder has that name" in outcome.error()


def test_a_full_disk_leaves_the_earlier_result_as_it_was(
    arm: Path, scan: Path, tmp_path: Path, pwralign: Call, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "result"
    folder.mkdir()
    (folder / "state.json").write_text("earlier")

    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("pwralign_kin.export.deviation.write_deviation_table", full)
    outcome = pwralign("estimate", arm, scan, "--out", folder)
    assert outcome.code == 1
    assert "result: cannot write: No space left on device" in outcome.err.splitlines()[-1]
    assert (folder / "state.json").read_text() == "earlier"
    assert [path.name for path in folder.iterdir()] == ["state.json"]
    assert not [path for path in tmp_path.iterdir() if path.name.startswith(".")]


def test_simulate_refuses_what_it_cannot_do(arm: Path, tmp_path: Path, pwralign: Call) -> None:
    for arguments, fault in (
        (("--points", 0), "points"),
        (("--noise", -1), "noise"),
        (("--missing-part", "uper"), "'upper'"),
        (("--joint", "x=1"), "'x'"),
        (("--state", tmp_path / "none.json"), "none.json"),
    ):
        outcome = pwralign("simulate", arm, "--out", tmp_path / "sim", *arguments)
        assert outcome.code == 1
        assert fault in outcome.error()
    assert not (tmp_path / "sim").exists()


def test_as_a_process_of_its_own(arm: Path, tmp_path: Path) -> None:
    """No interpreter noise around the line either."""
    command = Path(sys.executable).parent / "pwralign"
    done = subprocess.run(
        [command, "estimate", arm, tmp_path / "none.ply"], capture_output=True, text=True, check=False
    )
    assert done.returncode == 1
    assert done.stdout == ""
    assert done.stderr.count("\n") == 1
    assert done.stderr.startswith("pwralign: error: ")


def test_numbers_that_are_no_direction_or_placement(arm: Path, cloud: Path, pwralign: Call) -> None:
    for gravity in ((0, 0, 0), ("nan", 0, 1)):
        outcome = pwralign("estimate", arm, cloud, "--gravity", *gravity)
        assert outcome.code == 2 and "--gravity" in outcome.error()
    error = pwralign("estimate", arm, cloud, "--base", "nan", 0, 0, 0, 0, 0, 1).error()
    assert "finite" in error and "shape" not in error


def test_a_scan_that_nothing_can_be_placed_in(arm: Path, tmp_path: Path, pwralign: Call) -> None:
    np.save(tmp_path / "line.npy", np.linspace((0, 0, 0), (0.5, 0, 0), 500))
    error = pwralign("estimate", arm, tmp_path / "line.npy").error()
    assert "a line" in error and "pairs" not in error


def test_a_scan_in_metres_that_is_said_to_be_in_millimetres(arm: Path, cloud: Path, pwralign: Call) -> None:
    assert "use units='m' / --units m" in pwralign("estimate", arm, cloud, "--units", "mm").error()


def test_usage_errors_name_the_verb(arm: Path, pwralign: Call) -> None:
    for arguments, words in (
        (("estimate", arm, "--no-such"), "pwralign estimate --help"),
        (("calibrate", arm), "pwralign calibrate --help"),
        (("no-such",), "pwralign --help"),
    ):
        outcome = pwralign(*arguments)
        assert outcome.code == 2 and words in outcome.error()


def test_little_confidence_is_not_rounded_up(capfd: pytest.CaptureFixture[str]) -> None:
    assert messages.outcome(0.4999, "result") == 3
    assert "low confidence, below 0.5: look at the result" in capfd.readouterr().err


def test_inspect_tells_extents_with_their_unit(arm: Path, tmp_path: Path, pwralign: Call) -> None:
    """In the unit that is likely; of a scan in feet, that in feet it would be of the model alone."""
    corners = np.random.default_rng(0).random((3000, 3)).round(1) * 0.5
    for factor, words in ((1.0, "0.5 x 0.5 x 0.5 m"), (1e3, "500 x 500 x 500 mm"), (3.3, "in feet: use --units ft")):
        np.save(tmp_path / "scan.npy", factor * corners)
        assert words in pwralign("inspect", arm, tmp_path / "scan.npy").out
