"""Signed distances to closed, hollow, open and wrongly wound surfaces, and the files that hold them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import open3d
import pytest
import trimesh

from pwralign_kin.export.deviation import part_figures, write_deviation_ply, write_deviation_table
from pwralign_kin.export.signed_distances import signed_distances
from pwralign_kin.render import PosedMesh, RayScene

OFFSET = np.array([10.0, -20.0, 30.0])
"""A scan frame far from the model: single precision must not be spent on it."""


def posed(*meshes: trimesh.Trimesh, at: np.ndarray = OFFSET) -> PosedMesh:
    whole = trimesh.util.concatenate(meshes)
    part = np.repeat(np.arange(len(meshes)), [len(mesh.faces) for mesh in meshes])
    names = tuple(f"part{index}" for index in range(len(meshes)))
    return PosedMesh(whole.vertices + at, whole.faces, part, names, float(np.linalg.norm(whole.extents)))


def flipped(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    return trimesh.Trimesh(mesh.vertices, mesh.faces[:, ::-1], process=False)


def directions(count: int, seed: int = 0) -> np.ndarray:
    vectors = np.random.default_rng(seed).normal(size=(count, 3))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


@pytest.mark.parametrize("wound", [lambda mesh: mesh, flipped], ids=["outwards", "inwards"])
def test_outside_is_positive_whichever_way_faces_are_wound(
    wound: Callable[[trimesh.Trimesh], trimesh.Trimesh],
) -> None:
    ball = wound(trimesh.creation.icosphere(subdivisions=4, radius=0.5))
    for shift in (-0.02, -0.001, 0.001, 0.02, 0.4):
        points = OFFSET + (0.5 + shift) * directions(300)
        assert np.allclose(signed_distances(posed(ball), points), shift, atol=1e-3)


def test_the_inner_wall_of_a_hollow_part_does_not_count() -> None:
    outer = trimesh.creation.icosphere(subdivisions=4, radius=0.5)
    inner = flipped(trimesh.creation.icosphere(subdivisions=4, radius=0.49))
    points = OFFSET + 0.491 * directions(300)
    assert np.allclose(signed_distances(posed(outer, inner), points), -0.009, atol=1e-3)


def test_walls_within_other_parts_do_not_count() -> None:
    body, plug = trimesh.creation.box((1.0, 1.0, 1.0)), trimesh.creation.box((0.2, 0.2, 0.2))
    plug.apply_translation([0.38, 0.0, 0.0])  # ends 2 cm below the surface of the body
    points = OFFSET + np.array([[0.485, 0.0, 0.0], [0.515, 0.0, 0.0]])
    assert np.allclose(signed_distances(posed(body, plug), points), [-0.015, 0.015], atol=1e-5)


def test_signs_hold_at_sharp_edges_and_corners() -> None:
    wedge = trimesh.convex.convex_hull([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [0, 0, 0.2], [0, 1, 0.2]])
    rng = np.random.default_rng(1)
    points = rng.uniform([-0.1, -0.1, -0.1], [1.1, 1.1, 0.3], (2000, 3))
    truth = -trimesh.proximity.signed_distance(wedge, points)
    clear = np.abs(truth) > 1e-4
    assert np.allclose(signed_distances(posed(wedge), points + OFFSET)[clear], truth[clear], atol=1e-4)


def test_a_bottomless_shell_still_has_an_inside() -> None:
    shell = trimesh.creation.box((1.0, 1.0, 1.0))
    shell.update_faces(shell.face_normals[:, 2] > -0.5)
    points = OFFSET + np.array([[0.49, 0.0, 0.1], [0.51, 0.0, 0.1], [0.0, 0.1, 0.49], [0.0, 0.1, 0.52]])
    assert np.allclose(signed_distances(posed(shell), points), [-0.01, 0.01, -0.01, 0.02], atol=1e-5)


def test_a_sheet_follows_its_normals() -> None:
    sheet = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]])
    points = OFFSET + np.array([[0.5, 0.4, 0.03], [0.5, 0.4, -0.03]])
    assert np.allclose(signed_distances(posed(sheet), points), [0.03, -0.03], atol=1e-6)
    assert np.allclose(signed_distances(posed(flipped(sheet)), points), [-0.03, 0.03], atol=1e-6)


def test_what_many_points_cost_goes_with_the_surface(monkeypatch: pytest.MonkeyPatch) -> None:
    rays = 0
    blocked = RayScene.blocked

    def counting(scene: RayScene, asked: np.ndarray, reach: float = np.inf) -> np.ndarray:
        nonlocal rays
        rays += asked.size // 6
        return blocked(scene, asked, reach)

    monkeypatch.setattr(RayScene, "blocked", counting)
    ball = posed(trimesh.creation.icosphere(subdivisions=2, radius=0.5))
    cost = []
    for count in (100_000, 400_000):
        rays = 0
        shift = np.random.default_rng(count).normal(scale=0.002, size=(count, 1))
        distances = signed_distances(ball, OFFSET + (0.5 + shift) * directions(count))
        assert (distances[shift[:, 0] > 0.0] > 0.0).all()
        cost.append(rays)
    assert cost[1] < 2 * cost[0]


def test_points_far_away_are_about_as_far_as_they_are() -> None:
    ball = posed(trimesh.creation.icosphere(subdivisions=4, radius=0.5))
    points = np.random.default_rng(3).uniform(-4.0, 4.0, (20_000, 3))
    truth = np.linalg.norm(points, axis=1) - 0.5
    error = signed_distances(ball, OFFSET + points) - truth
    assert np.abs(error).max() < 0.03 * ball.diagonal
    assert np.abs(error[truth < 0.15 * ball.diagonal]).max() < 2e-3  # of the ball's facets


def test_no_points_give_no_distances() -> None:
    assert signed_distances(posed(trimesh.creation.box()), np.empty((0, 3))).shape == (0,)


def test_ply_holds_distance_part_and_colour(tmp_path: Path) -> None:
    mesh = posed(trimesh.creation.box((1.0, 1.0, 1.0)))
    points = OFFSET + np.array([[0.6, 0.0, 0.0], [0.4, 0.0, 0.0], [0.5, 0.1, 0.0], [2.0, 0.0, 0.0]])
    distances, labels = signed_distances(mesh, points), np.array([0, 0, 0, -1])
    write_deviation_ply(tmp_path / "deviation.ply", points, distances, labels, mesh)
    cloud = open3d.t.io.read_point_cloud(str(tmp_path / "deviation.ply"))
    assert np.array_equal(cloud.point.positions.numpy(), points.astype(np.float32))
    assert cloud.point.distance.numpy()[:, 0] == pytest.approx([0.1, -0.1, 0.0, 1.5], abs=1e-6)
    assert cloud.point.part.numpy()[:, 0].tolist() == [0, 0, 0, -1]
    red, blue = cloud.point.colors.numpy()[:, [0, 2]].astype(int).T
    assert red[0] > blue[0] + 100
    assert blue[1] > red[1] + 100
    assert abs(red[2] - blue[2]) < 10
    assert red[3] == blue[3] < 100


def test_ply_keeps_the_coordinates_of_a_survey(tmp_path: Path) -> None:
    at = np.array([4.5e5, 5.4e6, 300.0])
    mesh, points = posed(trimesh.creation.box(), at=at), at + np.array([[0.60001, 0.0, 0.0], [0.4, 0.1, 0.0]])
    write_deviation_ply(tmp_path / "deviation.ply", points, np.zeros(2), np.zeros(2, dtype=np.int64), mesh)
    cloud = open3d.t.io.read_point_cloud(str(tmp_path / "deviation.ply"))
    assert np.array_equal(cloud.point.positions.numpy(), points)


def test_table_has_a_row_per_part(tmp_path: Path) -> None:
    distances = np.array([0.001, -0.003, 0.002, 7.0])
    figures_by_part = part_figures(distances, np.array([1, 1, 1, -1]), 2)
    write_deviation_table(tmp_path / "t.csv", figures_by_part, ("base", "arm, left"))
    header, base, arm = (tmp_path / "t.csv").read_text().splitlines()
    assert header == "part,name,points,mean,rms,max_abs,p95_abs"
    assert base == "0,base,0,,,,"
    name = '1,"arm, left",3,'
    assert arm.startswith(name)
    figures = [float(cell) for cell in arm.removeprefix(name).split(",")]
    assert figures == pytest.approx([0.0, np.sqrt(14e-6 / 3), 0.003, 0.0029], abs=1e-8)
