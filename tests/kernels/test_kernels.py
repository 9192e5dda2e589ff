"""The compiled kernels against brute force and Pinocchio."""

from __future__ import annotations

import time

import numpy as np
import pytest
from scipy.spatial import cKDTree

from pwralign_kin import kernels, se3


def cloud(count: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).random((count, 3)).astype(np.float32)


def test_thinned_points_keep_their_distance_and_cover_the_rest() -> None:
    points, radius = cloud(3000), 0.07
    kept = points[kernels.thin(points, radius)]
    apart = np.linalg.norm(kept[:, None] - kept[None], axis=2)
    assert apart[~np.eye(len(kept), dtype=bool)].min() > radius
    assert np.linalg.norm(points[:, None] - kept[None], axis=2).min(axis=1).max() <= radius


def test_every_prefix_of_farthest_points_spreads_out() -> None:
    points = cloud(2000)
    order = kernels.farthest_points(points, 64)
    assert len(set(order.tolist())) == 64
    for count in (4, 16, 63):
        chosen = points[order[:count]]
        distance = np.linalg.norm(points[:, None] - chosen[None], axis=2).min(axis=1)
        assert distance[order[count]] == pytest.approx(distance.max(), abs=1e-6)


def test_more_farthest_points_than_there_are_gives_all() -> None:
    assert sorted(kernels.farthest_points(cloud(7), 20).tolist()) == list(range(7))


def test_closest_sample_grid_matches_brute_force() -> None:
    samples, cell, dims, band = cloud(300, seed=1), 0.05, (24, 24, 24), 0.2
    origin = (-0.1, -0.1, -0.1)
    grid = kernels.closest_sample_grid(samples, origin, cell, dims, band).reshape(dims)
    index = np.stack(np.meshgrid(*map(np.arange, dims), indexing="ij"), axis=-1).reshape(-1, 3)
    centres = np.array(origin) + (index + 0.5) * cell
    distance = np.linalg.norm(centres[:, None] - samples[None], axis=2)
    found = grid.reshape(-1)
    inside = distance.min(axis=1) < band - 1e-3
    assert (found[distance.min(axis=1) > band + 1e-3] == 65535).all()
    gap = distance[np.arange(len(found)), np.minimum(found, 299)][inside] - distance.min(axis=1)[inside]
    assert gap.max() < 0.3 * cell  # vector propagation is nearly exact ...
    assert (gap < 1e-6).mean() > 0.98  # ... and almost everywhere quite


def test_a_curve_leads_through_all_points_by_way_of_neighbours() -> None:
    points = cloud(2000)
    order = kernels.along_curve(points)
    assert sorted(order.tolist()) == list(range(2000))
    steps, random = (np.linalg.norm(np.diff(p, axis=0), axis=1).mean() for p in (points[order], points))
    assert steps < 0.25 * random


def test_the_first_points_of_each_cell_are_chosen_in_the_given_order() -> None:
    random = np.random.default_rng(0)
    cell, order = random.integers(0, 300, 1000).astype(np.int32), random.permutation(1000).astype(np.int32)
    expected = [[i for i in order if cell[i] == own][:2] for own in range(300)]
    assert kernels.first_of_cells(cell, order, 2).tolist() == [i for own in expected for i in own]
    assert len(kernels.first_of_cells(cell[:0], order[:0], 2)) == 0
    with pytest.raises(ValueError, match="count from 0"):
        kernels.first_of_cells(cell - 1, order, 2)


def test_voxel_means_are_the_means_of_their_points() -> None:
    points = cloud(500, seed=2)
    means, counts, cell = kernels.voxel_means(points, 0.2)
    assert counts.sum() == len(points)
    for i in range(len(means)):
        np.testing.assert_allclose(means[i], points[cell == i].mean(axis=0), atol=1e-5)


def test_neighbourhood_variances_are_eigenvalues_of_the_scatter() -> None:
    flat = cloud(300, seed=5) * np.array([1.0, 0.5, 1e-3], np.float32)
    line = np.outer(np.arange(40, dtype=np.float32), [1.0, 0.0, 0.0]) + np.float32(50.0)
    points = np.concatenate([flat, line]).astype(np.float32)
    sizes = [6, 9]
    found = kernels.neighbourhood_variances(points, points, sizes, 1)
    order = np.argsort(np.linalg.norm(points[:, None] - points[None], axis=2), axis=1, kind="stable")
    for row, size in zip(found, sizes, strict=True):
        near = points[order[: len(flat), :size]].astype(float)  # on the line many are equally far
        off = near - near.mean(axis=1, keepdims=True)
        expected = np.linalg.eigvalsh(np.swapaxes(off, 1, 2) @ off / (size - 3))
        np.testing.assert_allclose(row[:, : len(flat)].T, expected, rtol=1e-5, atol=1e-12)
        assert (row[:2, len(flat) :] < 1e-6).all()


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize(("count", "asked", "each"), [(4000, 500, 7), (300, 300, 24), (5, 40, 9)])
def test_nearest_neighbours_match_brute_force(count: int, asked: int, each: int, threads: int) -> None:
    points, queries = cloud(count, seed=3), cloud(asked, seed=4)
    points[:, 2] *= 0.05  # a sheet, more crowded on one side, and strays far from it
    points[: count // 2, 0] *= 0.2
    points[:2] += 30.0
    queries[:3] -= 5.0
    distance, index = kernels.nearest_neighbours(points, queries, each, threads)
    apart = np.linalg.norm(queries[:, None].astype(float) - points[None], axis=2)
    assert index.shape == (asked, min(each, count))
    np.testing.assert_allclose(distance, np.sort(apart, axis=1)[:, :each], rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose(np.take_along_axis(apart, index.astype(int), axis=1), distance, rtol=1e-4, atol=1e-6)


def test_nearest_neighbours_are_as_fast_where_points_are_dense_in_places() -> None:
    """A depth image of things near and far: some points have neighbours a thousand times as far as others."""
    random = np.random.default_rng(0)
    dense, sparse = 0.1 * random.random((20_000, 3)), 10.0 * random.random((20_000, 3))
    points = np.concatenate([dense, sparse]).astype(np.float32)

    start = time.process_time()
    distance = kernels.nearest_neighbours(points, points, 7, 1)[0]
    seconds = time.process_time() - start

    assert distance == pytest.approx(cKDTree(points).query(points, 7)[0], abs=1e-5)
    assert seconds < 3.0


@pytest.mark.parametrize("threads", [1, 2])
def test_local_planes_find_normal_and_thickness_of_a_noisy_plane(threads: int) -> None:
    rng = np.random.default_rng(3)
    points = np.column_stack([rng.random((4000, 2)), 0.01 * rng.normal(size=4000)]).astype(np.float32)
    normals, means, variances, neighbours = kernels.local_planes(points, 0.15, threads)
    inner = (np.abs(points[:, :2] - 0.5) < 0.3).all(axis=1)
    assert np.abs(normals[inner, 2]).min() > 0.98
    assert np.abs(means[inner, 2]).max() < 0.006
    assert np.sqrt(np.median(variances[inner, 0])) == pytest.approx(0.01, rel=0.1)
    assert neighbours[inner].min() > 100


def test_local_planes_are_those_of_the_least_eigenvalue() -> None:
    points = (np.random.default_rng(7).random((300, 3)) * [1.0, 0.7, 0.1]).astype(np.float32)
    normals, _, variances, neighbours = kernels.local_planes(points, 0.25, 1)
    for i in np.flatnonzero(neighbours >= 6):
        near = points[np.linalg.norm(points - points[i], axis=1) <= 0.25].astype(float)
        values, vectors = np.linalg.eigh(np.cov(near.T, bias=True))
        assert variances[i] == pytest.approx(values, rel=1e-3, abs=1e-8)
        if values[1] > 1.2 * values[0]:
            assert abs(normals[i] @ vectors[:, 0]) == pytest.approx(1.0, abs=1e-4)


def test_points_of_a_line_have_normals_across_it() -> None:
    along = np.array([2.0, -1.0, 3.0]) / np.sqrt(14.0)
    points = np.ascontiguousarray(np.linspace(0.0, 1.0, 40)[:, None] * along, np.float32)
    for some in (points, points[:2], points[:1]):
        normals = kernels.local_planes(some, 0.2, 1)[0]
        np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-6)
        if len(some) > 1:
            np.testing.assert_allclose(normals @ along, 0.0, atol=1e-2)


@pytest.mark.parametrize("threads", [1, 2])
def test_apparent_normals_of_fine_ribs_are_those_of_the_whole(threads: int) -> None:
    x, y = np.random.default_rng(8).random((2, 6000))
    points = np.column_stack([x, y, np.abs(x % 0.04 - 0.02)]).astype(np.float32)
    slope = np.sign(x % 0.04 - 0.02)
    normals = np.column_stack([-slope, np.zeros(6000), np.ones(6000)]).astype(np.float32) / np.float32(np.sqrt(2))
    apparent = kernels.apparent_normals(points, normals, 0.1, threads)
    inner = (np.abs(points[:, :2] - 0.5) < 0.35).all(axis=1)
    assert apparent[inner, 2].min() > 0.98
    np.testing.assert_allclose(np.linalg.norm(apparent, axis=1), 1.0, atol=1e-5)


def test_apparent_normals_keep_the_two_faces_of_a_plate_apart() -> None:
    face = np.random.default_rng(9).random((2000, 2))
    points = np.column_stack([np.tile(face, (2, 1)), np.repeat([0.0, 0.01], 2000)]).astype(np.float32)
    normals = np.repeat(np.float32([[0, 0, -1], [0, 0, 1]]), 2000, axis=0)
    np.testing.assert_allclose(kernels.apparent_normals(points, normals, 0.1, 1), normals, atol=1e-3)
    # A point on its own lies on no plane but its own.
    np.testing.assert_array_equal(kernels.apparent_normals(points[:1], normals[:1], 0.1, 1), normals[:1])


def test_apparent_normals_of_what_is_no_surface_keep_to_their_side() -> None:
    rng = np.random.default_rng(10)
    points = rng.random((500, 3)).astype(np.float32)
    normals = np.float32([0, 0, 1]) * rng.choice([-1, 1], (500, 1)).astype(np.float32)
    apparent = kernels.apparent_normals(points, normals, 0.2, 1)
    np.testing.assert_allclose(np.linalg.norm(apparent, axis=1), 1.0, atol=1e-5)
    assert (np.einsum("ij,ij->i", apparent, normals) > 0).all()


def test_steps_around_points_are_even_and_along_the_surface() -> None:
    points, normals = cloud(50), cloud(50, seed=1) - 0.5
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    normals[:3] = np.eye(3)
    steps = kernels.steps_around(points, normals, 0.2, 6).reshape(50, 6, 3) - points[:, None]
    np.testing.assert_allclose(np.linalg.norm(steps, axis=2), 0.2, rtol=1e-5)
    np.testing.assert_allclose(steps @ normals[:, :, None], 0.0, atol=1e-6)
    # Of six steps all around, each is as far from the next as from the point.
    np.testing.assert_allclose(np.linalg.norm(steps - np.roll(steps, 1, axis=1), axis=2), 0.2, rtol=1e-5)


def test_placements_are_moved_by_twists_about_their_own_origin() -> None:
    random = np.random.default_rng(0)
    for size in (0.0, 1e-13, 0.1, 3.0):
        placement = se3.from_twist(random.normal(size=6))
        turn = random.normal(size=3)
        twist = np.append(size * turn / np.linalg.norm(turn), random.normal(size=3))
        expected = se3.from_twist(twist)
        expected[:3, :3] = expected[:3, :3] @ placement[:3, :3]
        expected[:3, 3] += placement[:3, 3]
        np.testing.assert_allclose(kernels.retracted(placement, twist), expected, atol=1e-12)


def test_openness_tells_the_outside_of_a_sphere() -> None:
    rng = np.random.default_rng(4)
    outward = rng.normal(size=(4000, 3))
    outward = (outward / np.linalg.norm(outward, axis=1)[:, None]).astype(np.float32)
    points = np.ascontiguousarray(0.4 * outward)
    assert (kernels.openness(points, outward, 0.03, 2) > 0).mean() > 0.99
    assert (kernels.openness(points, np.ascontiguousarray(-outward), 0.03, 2) < 0).mean() > 0.99


def test_dominant_plane_is_found_among_clutter() -> None:
    rng = np.random.default_rng(5)
    plane = np.column_stack([rng.random((600, 2)), np.full(600, 0.3)])
    points = np.concatenate([plane, rng.random((600, 3))]).astype(np.float32)
    normals = np.tile(np.float32([0, 0, 1]), (1200, 1))
    x, y, z, offset, inliers = kernels.dominant_plane(points, normals, 0.01, 100, 0)
    assert (abs(z), abs(offset)) == (pytest.approx(1), pytest.approx(0.3, abs=0.01))
    assert inliers >= 600
    assert abs(x) + abs(y) < 1e-6


@pytest.mark.parametrize("threads", [1, 2])
def test_closest_places_on_meshes_are_those_of_brute_force(threads: int) -> None:
    import trimesh

    random = np.random.default_rng(7)
    # More than are looked at together, and one without a triangle.
    shapes = [trimesh.creation.icosphere(subdivisions=1, radius=0.15), trimesh.creation.box([0.3, 0.1, 0.05])]
    solids = [shapes[i % 2] for i in range(10)]
    placements = se3.from_twist(random.uniform(-0.6, 0.6, (11, 6)))
    points = random.uniform(-0.9, 0.9, (500, 3)).astype(np.float32)
    points[250:] = points[np.linspace(0, 40, 250).astype(int)] + random.normal(0, 0.02, (250, 3))  # neighbours in a row
    nothing = kernels.TriangleMesh(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.int32))
    meshes = [
        kernels.TriangleMesh(np.ascontiguousarray(m.vertices, np.float32), np.ascontiguousarray(m.faces, np.int32))
        for m in solids
    ]
    closest, mesh = kernels.closest_on_meshes([*meshes, nothing], placements, points, 0.25, threads)
    each = [
        trimesh.triangles.closest_point(
            np.repeat(m.triangles @ T[:3, :3].T + T[:3, 3], len(points), axis=0), np.tile(points, (len(m.triangles), 1))
        ).reshape(len(m.triangles), len(points), 3)
        for m, T in zip(solids, placements, strict=False)
    ]
    distance = np.array([np.linalg.norm(found - points, axis=2).min(axis=0) for found in each])
    nearest = np.where(distance.min(axis=0) < 0.25, distance.argmin(axis=0), -1)
    assert 0 < (nearest < 0).sum() < len(points)
    np.testing.assert_array_equal(mesh, nearest)
    found = np.linalg.norm(closest - points, axis=1)[nearest >= 0]
    np.testing.assert_allclose(found, distance.min(axis=0)[nearest >= 0], atol=1e-6)
    with pytest.raises(ValueError, match="vertex"):
        kernels.TriangleMesh(points[:2].copy(), np.array([[0, 1, 2]], np.int32))


def test_wrong_shapes_and_names_are_refused() -> None:
    points = cloud(10)
    with pytest.raises(ValueError, match="differ in length"):
        kernels.openness(points, points[:5].copy(), 0.1, 1)
    with pytest.raises(TypeError):
        kernels.thin(points[:, :2].copy(), 0.1)
    with pytest.raises(ValueError, match="parents"):
        kernels.Articulated(
            np.array([-1, 1], np.int32), np.zeros(2, np.int32), np.tile(np.eye(4), (2, 1, 1)), np.ones((2, 3)),
            np.zeros(2, np.uint8), np.ones(2), np.zeros(2), np.zeros(1), np.ones(1), np.zeros(1, np.uint8),
        )  # fmt: skip


@pytest.mark.parametrize("point", [np.nan, np.inf, 1e30])
def test_points_that_no_cell_holds_are_refused(point: float) -> None:
    points = np.zeros((50, 3), np.float32)
    points[7, 1] = point
    normals = np.tile(np.float32([0, 0, 1]), (50, 1))
    for call in (
        lambda: kernels.openness(points, normals, 0.01, 1),
        lambda: kernels.local_planes(points, 0.01, 1),
        lambda: kernels.components(points, 0.01),
    ):
        with pytest.raises(ValueError, match="finite"):
            call()
    with pytest.raises(ValueError, match="positive"):
        kernels.openness(np.zeros((50, 3), np.float32), normals, 0.0, 1)


def test_what_would_lead_out_of_memory_is_refused() -> None:
    points, origin = cloud(10), (0.0, 0.0, 0.0)
    faces, at = np.array([[0, 1, 2]], np.int32), np.eye(4)[None]
    beyond = points.copy()
    beyond[3, 1] = np.nan
    for call, fault in (
        (lambda: kernels.first_of_cells(np.array([2**31 - 1], np.int32), np.zeros(1, np.int32), 1), "count from 0"),
        (lambda: kernels.closest_on_meshes([None], at, points, 1.0, 1), "no mesh"),
        (lambda: kernels.TriangleMesh(beyond, faces), "finite"),
        (lambda: kernels.nearest_neighbours(points, points, -1, 1), "at least one"),
        (lambda: kernels.voxel_means(points, 0.0), "positive"),
        (lambda: kernels.closest_sample_grid(points, origin, 0.1, (-1, 2, 2), 0.1), "positive"),
        (lambda: kernels.closest_sample_grid(points, origin, 0.0, (2, 2, 2), 0.1), "positive"),
    ):
        with pytest.raises(ValueError, match=fault):
            call()


def test_more_threads_than_there_can_be_are_no_error() -> None:
    points = np.random.default_rng(0).normal(size=(2000, 3)).astype(np.float32)
    for one, many in zip(kernels.local_planes(points, 0.3, 1), kernels.local_planes(points, 0.3, 500), strict=True):
        np.testing.assert_array_equal(one, many)
