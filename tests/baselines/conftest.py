"""A knobbly body that no turn maps onto itself, as points, and an arm of two parts."""

from __future__ import annotations

import numpy as np
import pytest

from pwralign_kin import se3
from pwralign_kin.baselines import coherent_point_drift, non_rigid_icp
from pwralign_kin.model import ArticulatedModel

Body = tuple[se3.Array, np.ndarray]


def box(centre: tuple[float, ...], size: tuple[float, ...], cells: int = 4) -> Body:
    """Vertices and faces of a box, its sides divided into `cells` squared."""
    import trimesh

    mesh = trimesh.creation.box(extents=size)
    while len(mesh.faces) < 12 * cells**2:
        mesh = mesh.subdivide()
    return np.asarray(mesh.vertices) + centre, np.asarray(mesh.faces, np.int64)


@pytest.fixture(scope="package")
def bodies() -> list[Body]:
    """Three boxes that touch, about 1 m across together."""
    return [
        box((0.0, 0.0, 0.0), (0.8, 0.3, 0.2)),
        box((0.3, 0.1, 0.25), (0.12, 0.1, 0.3)),
        box((-0.3, 0.2, 0.0), (0.1, 0.3, 0.12)),
    ]


@pytest.fixture(scope="package")
def cloud(bodies: list[Body]) -> tuple[se3.Array, se3.Array]:
    """Points (6000, 3) on the boxes' surface, those within another box left out, and their outward normals."""
    import trimesh

    points, normals = [], []
    for index, (vertices, faces) in enumerate(bodies):
        mesh = trimesh.Trimesh(vertices, faces, process=False)
        own, face = trimesh.sample.sample_surface(mesh, 3000, seed=index)
        outside = np.ones(len(own), bool)
        for other, (corners, _) in enumerate(bodies):
            if other != index:
                low, high = corners.min(axis=0), corners.max(axis=0)
                outside &= ~((own > low - 1e-9) & (own < high + 1e-9)).all(axis=1)
        points.append(own[outside])
        normals.append(mesh.face_normals[face[outside]])
    kept = np.random.default_rng(0).permutation(sum(map(len, points)))[:6000]
    return np.concatenate(points)[kept], np.concatenate(normals)[kept]


@pytest.fixture(scope="package")
def arm(tmp_path_factory: pytest.TempPathFactory, turning_arm: str) -> ArticulatedModel:
    path = tmp_path_factory.mktemp("arm") / "arm.urdf"
    path.write_text(turning_arm)
    return ArticulatedModel.from_urdf(path)


@pytest.fixture(autouse=True)
def _small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fewer samples and triangles than in the comparison, which take as many times longer."""
    monkeypatch.setattr(coherent_point_drift, "SAMPLES", 300)
    monkeypatch.setattr(non_rigid_icp, "TRIANGLES", 800)
