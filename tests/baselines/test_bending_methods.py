"""Methods that bend the model come nearer to a bent scan than a rigid body can, and carry other points along."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from pwralign_kin.baselines.coherent_point_drift import deformable_drift
from pwralign_kin.baselines.non_rigid_icp import carried, disjoint_mesh, fused_mesh, non_rigid_icp
from pwralign_kin.exceptions import ScanError
from pwralign_kin.se3 import Array

Body = tuple[Array, np.ndarray]


def bent(points: Array) -> Array:
    """The body bent up at its ends."""
    return np.asarray(points + np.stack([0 * points[:, 0], 0 * points[:, 0], 0.8 * points[:, 0] ** 2], axis=1))


def off(points: Array, where: Array) -> float:
    """Mean distance of points to the nearest of others."""
    return float(cKDTree(where).query(points)[0].mean())


@pytest.mark.parametrize("kind", ["disjoint", "fused"])
def test_non_rigid_icp_bends_a_mesh(bodies: list[Body], cloud: tuple[Array, Array], kind: str) -> None:
    points = cloud[0]
    vertices, faces = disjoint_mesh(bodies) if kind == "disjoint" else fused_mesh(*cloud)
    moved = carried(points, vertices, faces, non_rigid_icp(vertices, faces, bent(points)))
    assert off(moved, bent(points)) < 0.6 * off(points, bent(points))


@pytest.mark.parametrize("answer", [RuntimeError("Factor is exactly singular"), np.full((294, 3), np.nan)])
def test_a_singular_problem_is_an_error(
    bodies: list[Body], cloud: tuple[Array, Array], monkeypatch: pytest.MonkeyPatch, answer: RuntimeError | Array
) -> None:
    def solve(*arguments: object, **named: object) -> Array:
        if isinstance(answer, RuntimeError):
            raise answer
        return answer

    monkeypatch.setattr("trimesh.registration.nricp_amberg", solve)
    with pytest.raises(ScanError, match="undetermined"):
        non_rigid_icp(*disjoint_mesh(bodies), cloud[0])


def test_fused_mesh_is_one_piece(cloud: tuple[Array, Array]) -> None:
    import trimesh

    mesh = trimesh.Trimesh(*fused_mesh(*cloud), process=False)
    assert len(mesh.split(only_watertight=False)) == 1
    np.testing.assert_allclose(mesh.bounds, [cloud[0].min(axis=0), cloud[0].max(axis=0)], atol=0.05)


def test_points_are_carried_by_their_triangle() -> None:
    vertices, faces = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array([[0, 1, 2]])
    moved = vertices + np.array([[0.0, 0, 0], [0, 0, 1], [0, 0, 2]])
    where = carried(np.array([[0.25, 0.5, 0.1]]), vertices, faces, moved)
    np.testing.assert_allclose(where, [[0.25, 0.5, 0.1 + 0.25 * 1 + 0.5 * 2]], atol=1e-6)


def test_deformable_drift_bends_and_carries(cloud: tuple[Array, Array]) -> None:
    pytest.importorskip("pycpd", reason="the benchmark extra is not installed")
    points = cloud[0][:1500] + 3.0
    target = bent(cloud[0][1500:3000]) + 3.0
    field = deformable_drift(points, target)
    others = cloud[0][3000:]
    assert off(field(others + 3.0), bent(others) + 3.0) < 0.75 * off(others, bent(others))
