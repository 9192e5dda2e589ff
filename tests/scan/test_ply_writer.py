"""The PLY writer, read back by independent readers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pwralign_kin.exceptions import ExportError
from pwralign_kin.scan import Scan, write_ply


def test_points_come_back_bit_for_bit(tmp_path: Path) -> None:
    points = np.random.default_rng(0).normal(size=(50, 3))
    write_ply(tmp_path / "double.ply", points)
    write_ply(tmp_path / "float.ply", points.astype(np.float32))
    assert np.array_equal(Scan.load(tmp_path / "double.ply").points, points)
    assert np.array_equal(Scan.load(tmp_path / "float.ply").points, points.astype(np.float32))


def test_trimesh_reads_properties_and_faces(tmp_path: Path) -> None:
    import trimesh

    box = trimesh.creation.box([1.0, 2.0, 3.0])
    colours = {"red": 255, "green": 7, "blue": 0}
    properties = {name: np.full(8, value, dtype=np.uint8) for name, value in colours.items()}
    properties["part"] = np.arange(8)
    properties["seen"] = np.arange(8) % 2 == 0
    write_ply(tmp_path / "box.ply", box.vertices, properties, faces=box.faces)
    mesh = trimesh.load_mesh(tmp_path / "box.ply", process=False)
    assert np.array_equal(mesh.vertices, box.vertices)
    assert np.array_equal(mesh.faces, box.faces)
    assert mesh.visual.vertex_colors[0, :3].tolist() == [255, 7, 0]
    vertex = mesh.metadata["_ply_raw"]["vertex"]["data"]
    assert vertex["part"].tolist() == list(range(8))
    assert vertex["seen"].tolist() == [1, 0] * 4


def test_open3d_reads_points_and_normals(tmp_path: Path) -> None:
    open3d = pytest.importorskip("open3d", exc_type=ImportError)
    rng = np.random.default_rng(0)
    points = rng.normal(size=(50, 3))
    normals = points / np.linalg.norm(points, axis=1, keepdims=True)
    write_ply(tmp_path / "cloud.ply", points, dict(zip(("nx", "ny", "nz"), normals.T, strict=True)))
    read = open3d.io.read_point_cloud(str(tmp_path / "cloud.ply"))
    assert np.array_equal(np.asarray(read.points), points)
    assert np.array_equal(np.asarray(read.normals), normals)
    ours = Scan.load(tmp_path / "cloud.ply").normals
    assert ours is not None and np.allclose(ours, normals)


@pytest.mark.parametrize(
    ("properties", "faces", "fault"),
    [
        ({"part": np.zeros(9)}, None, "property part must have the shape"),
        ({"x": np.zeros(10)}, None, "'x' is taken"),
        ({"two words": np.zeros(10)}, None, "not one plain word"),
        ({"part": np.full(10, 2**40)}, None, "beyond 32 bits"),
        ({"part": np.zeros(10, dtype=complex)}, None, "PLY cannot hold"),
        ({}, [[0, 1, 10]], "outside 0..9"),
        ({}, [[0, 1]], "faces must be integers"),
    ],
)
def test_what_does_not_fit_raises_and_leaves_no_file(
    tmp_path: Path, properties: dict[str, np.ndarray], faces: list[list[int]] | None, fault: str
) -> None:
    with pytest.raises(ExportError, match=fault):
        write_ply(tmp_path / "cloud.ply", np.zeros((10, 3)), properties, faces)
    assert list(tmp_path.iterdir()) == []


def test_points_of_a_wrong_shape_raise(tmp_path: Path) -> None:
    with pytest.raises(ExportError, match=r"shape \(n, 3\)"):
        write_ply(tmp_path / "cloud.ply", np.zeros((10, 2)))
