"""The sample scans lie on the models in the states that their truths tell."""

from __future__ import annotations

import json
import subprocess
import sys

import numpy as np
import pytest
from sample_robot import NAMES, REPOSITORY, ROBOTS, Sample

from pwralign_kin.scan import Scan
from pwralign_kin.state import State

SCANS = [(name, tier) for name in NAMES for tier in ("full", "single")]


def load(folder, tier):
    return Scan.load(folder / "scans" / f"{tier}.ply"), State.load(folder / "scans" / f"{tier}_truth.json")


def posed_surface(sample, state):
    """Return a ray-casting scene of the model in the scan frame."""
    import open3d

    sample.pose(dict(state.joints))
    scene = open3d.t.geometry.RaycastingScene()
    for link in sample.urdf.robot.links:
        for vertices, faces in sample.meshes(link.name):
            placed = vertices @ state.T_scan_base[:3, :3].T + state.T_scan_base[:3, 3]
            scene.add_triangles(placed.astype(np.float32), faces.astype(np.uint32))
    return scene


@pytest.mark.parametrize(("name", "tier"), SCANS)
def test_scan_lies_on_the_model_in_its_true_state(name, tier):
    sample = Sample(name)
    scan, state = load(ROBOTS / name, tier)
    diagonal = np.linalg.norm(
        np.ptp(
            np.vstack([sample.vertices(link.name) for link in sample.urdf.robot.links if link.visuals]),
            axis=0,
        )
    )
    assert 6000 <= len(scan.points) <= 8000
    assert state.base_link == sample.urdf.base_link
    assert set(state.joints) == set(sample.urdf.actuated_joint_names)
    for joint, value in state.joints.items():
        limit = sample.joints[joint].limit
        assert sample.joints[joint].type == "continuous" or limit.lower <= value <= limit.upper
    distance = posed_surface(sample, state).compute_distance(scan.points.astype(np.float32)).numpy()
    assert np.median(distance) < 0.003 * diagonal
    assert np.mean(distance < 0.01 * diagonal) > 0.97


@pytest.mark.parametrize("name", NAMES)
def test_single_view_is_seen_from_the_sensor(name):
    """Nearly every ray from the sensor ends at its point, not before."""
    scan, state = load(ROBOTS / name, "single")
    origin = np.array(json.loads((ROBOTS / name / "scans/single_truth.json").read_text())["sensor_origin"])
    sample = Sample(name)
    rays = np.hstack([np.broadcast_to(origin, scan.points.shape), scan.points - origin]).astype(np.float32)
    reached = posed_surface(sample, state).cast_rays(rays)["t_hit"].numpy()
    assert np.mean(reached > 0.99) > 0.95


@pytest.mark.parametrize("name", [name for name in NAMES if name != "cubebot"])
def test_models_of_the_room_stand_upright_on_the_ground(name):
    for tier in ("full", "single"):
        scan, state = load(ROBOTS / name, tier)
        assert state.T_scan_base[2, :3] == pytest.approx([0, 0, 1], abs=1e-12)
        height = scan.points[:, 2] - state.T_scan_base[2, 3]
        assert np.quantile(height, 0.002) > -0.02


def test_scans_are_built_the_same_again(tmp_path):
    subprocess.run(
        [sys.executable, str(REPOSITORY / "scripts/build_robots.py"), "laptop", "--out", str(tmp_path)],
        check=True, capture_output=True,
    )  # fmt: skip
    for tier in ("full", "single"):
        built, truth = load(tmp_path / "laptop", tier)
        committed, committed_truth = load(ROBOTS / "laptop", tier)
        assert truth.to_dict() == committed_truth.to_dict()
        # Ray casting may round the last bit differently on another processor.
        assert built.points == pytest.approx(committed.points, abs=1e-6)
