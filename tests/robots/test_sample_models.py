"""What holds for every sample model: it loads everywhere, its meshes are sound, and its sides differ."""

from __future__ import annotations

import numpy as np
import pytest
from lxml import etree
from sample_robot import NAMES, ROBOTS, Sample

STL_RECORD = [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")]


def test_every_model_has_its_folder_and_names_its_joints_and_sources(sample):
    assert sorted(path.name for path in ROBOTS.iterdir() if path.is_dir()) == sorted(NAMES)
    readme = (sample.path.parent / "README.md").read_text()
    assert "## Joint tree" in readme and "## Sources" in readme
    assert f"{triangle_count(sample)} triangles" in readme


def triangle_count(sample):
    return sum(len(faces) for link in sample.urdf.robot.links for _, faces in sample.meshes(link.name))


def test_models_are_small(sample):
    files = [path for path in sample.path.parent.rglob("*") if path.is_file()]
    assert sum(path.stat().st_size for path in files) < 1.5e6
    assert triangle_count(sample) < 20_000


def test_urdf_is_complete(sample):
    robot = etree.parse(str(sample.path)).getroot()
    assert robot.get("name") == sample.path.stem
    for joint in robot.iter("joint"):
        if joint.get("type") != "fixed":
            limit = joint.find("limit")
            assert float(limit.get("effort")) > 0 and float(limit.get("velocity")) > 0
            if joint.get("type") != "continuous":
                assert float(limit.get("lower")) < float(limit.get("upper"))
    for mesh in robot.iter("mesh"):
        assert mesh.get("filename").startswith("meshes/")
        assert (sample.path.parent / mesh.get("filename")).is_file()


def test_no_mesh_file_is_left_over(sample):
    used = {mesh.get("filename") for mesh in etree.parse(str(sample.path)).getroot().iter("mesh")}
    assert {f"meshes/{path.name}" for path in (sample.path.parent / "meshes").iterdir()} == used


def test_model_loads_in_pinocchio(sample):
    import pinocchio

    model = pinocchio.buildModelFromUrdf(str(sample.path))
    moving = [name for name, joint in sample.joints.items() if joint.type != "fixed"]
    assert sorted(list(model.names)[1:]) == sorted(moving)


def test_meshes_are_closed_and_face_outwards(sample):
    """Every edge is walked as often one way as the other, and every connected piece encloses a volume."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    for path in sorted((sample.path.parent / "meshes").iterdir()):
        record = np.frombuffer(path.read_bytes()[84:], dtype=STL_RECORD)
        corners = record["corners"].astype(float)
        areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
        assert areas.min() > 1e-9, path.name
        points, faces = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)
        faces = faces.reshape(-1, 3)
        edges = np.vstack([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
        net = coo_matrix((np.ones(len(edges)), edges.T), shape=(len(points), len(points))).tocsr()
        assert abs(net - net.T).max() == 0, path.name
        count, piece = connected_components(net, directed=False)
        volumes = np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6
        totals = np.bincount(piece[faces[:, 0]], weights=volumes, minlength=count)
        assert totals.min() > 0, path.name


@pytest.mark.parametrize("name", [name for name in NAMES if name != "cubebot"])
def test_model_can_be_told_from_itself_turned_round(name):
    """Turned by half (the lander also by a third) about its middle, the model lies well beside itself."""
    from scipy.spatial import cKDTree
    from scipy.spatial.transform import Rotation

    sample = Sample(name)
    joints = {joint: sample.joints[joint] for joint in sample.urdf.actuated_joint_names}
    sample.pose({
        joint: 0.45 * (value.limit.lower + value.limit.upper) if value.type != "continuous" else 0.0
        for joint, value in joints.items()
    })  # fmt: skip
    points = surface_points(sample)
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    diagonal = np.linalg.norm(np.ptp(points, axis=0))
    tree = cKDTree(points)
    turns = [np.pi * np.eye(3)[k] for k in range(3)] + [np.array([0, 0, k * 2 * np.pi / 3]) for k in (1, 2)]
    for turn in turns:
        turned = (points - middle) @ Rotation.from_rotvec(turn).as_matrix().T + middle
        distance = tree.query(turned)[0].mean()
        assert distance > 0.02 * diagonal, (turn, distance / diagonal)


def surface_points(sample):
    """Return about 4000 points on all visuals, spread evenly by area."""
    corners = np.vstack(
        [vertices[faces] for link in sample.urdf.robot.links for vertices, faces in sample.meshes(link.name)]
    )
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    generator = np.random.default_rng(3)
    chosen = corners[generator.choice(len(corners), 4000, p=areas / areas.sum())]
    u, v = generator.random((2, len(chosen), 1))
    u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
    return chosen[:, 0] + u * (chosen[:, 1] - chosen[:, 0]) + v * (chosen[:, 2] - chosen[:, 0])
