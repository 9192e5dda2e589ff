"""Samples of every part's outer-visible surface, with normals and weights, and closest-sample grids.

CAD visuals hold inner surfaces that no sensor sees. Samples are therefore kept, weighted and oriented by how often
rays leave them freely over random configurations. Everything here is in units of the model's diagonal, in part frames.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pwralign_kin import kernels
from pwralign_kin.arrays import Indices, Singles
from pwralign_kin.dependencies import open3d
from pwralign_kin.directions import fibonacci_directions
from pwralign_kin.model.cache import load_or_build
from pwralign_kin.model.flat_faces import FlatFaces, flat_faces
from pwralign_kin.model.surface import Surface, triple
from pwralign_kin.se3 import Array

Mesh = tuple[NDArray[Any], NDArray[Any]]
"""Vertices (v, 3) in model diagonals, and faces (f, 3), of one part."""

VERSION = 11
"""Part of the cache key: raise it when the preparation changes."""
COARSE_SAMPLES = 160
"""Of a part, the first of its samples: spread over all of it."""
PROBE_SPACING, LEAST_PROBES = 0.012, 400
"""Spacing of the points (model diagonals) that are looked at from outside; small parts are probed more closely, ..."""
DENSE_SPACING, LEAST_DENSE_SAMPLES = 0.004, 800
"""... and sampled more closely, ..."""
MOST_DENSE_SAMPLES = 30000
"""... by at most so many: what the closest of points of a scan is told from."""
NORMAL_RADIUS = 0.025
"""About that of the neighbourhoods (model diagonals) that normals of scans are of."""
GRID_CELLS, FINEST_CELL = 600_000, 0.004
"""Cells of a part's grid, about, and their least size (model diagonals): they must tell the two faces of a thin panel
apart."""
GRID_BAND = 0.07
"""How far around a part (model diagonals) the grid tells its closest sample."""
CONFIGURATIONS, DIRECTIONS = 12, 14
"""Random configurations in which each sample is looked at, from so many sides."""
SEEN_SHARE = 0.15
"""Share of the configurations in which a sample must be seen to count as outer surface."""
LEAST_SAMPLES = 12
"""Parts with fewer visible samples have no surface."""
FACE_TOLERANCE, LEAST_FACE = 0.004, 0.01
"""Thickness (model diagonals) and area of what counts as a flat face."""
SAME_SIDE = 0.3
"""Cosine between the normals of two points near each other, from which they are on one side of a wall."""

ARRAYS = tuple(Surface.__dataclass_fields__)


def sample_surfaces(
    content_key: str, meshes: Callable[[], Sequence[Mesh]], random_placements: Callable[[np.random.Generator], Array]
) -> tuple[Surface, ...]:
    """Return the surface of every part, from the user's cache where the model of this key was prepared before.

    `random_placements` returns (n, 4, 4) placements of the n parts at random joint values, lengths in model diagonals.
    """

    def build() -> dict[str, NDArray[Any]]:
        surfaces = build_surfaces(meshes(), random_placements)
        return {f"{i}/{name}": getattr(s, name) for i, s in enumerate(surfaces) for name in ARRAYS}

    arrays = load_or_build(f"surface-{VERSION}-{content_key}", build)
    return tuple(Surface(**{name: arrays[f"{i}/{name}"] for name in ARRAYS}) for i in range(len(arrays) // len(ARRAYS)))


def build_surfaces(
    meshes: Sequence[Mesh], random_placements: Callable[[np.random.Generator], Array]
) -> tuple[Surface, ...]:
    """Sample every part, find what is visible from outside, and build the grids (seeded: always the same)."""
    random = np.random.default_rng(0)
    candidates = [_evenly_spaced(vertices, faces, random) for vertices, faces in meshes]
    probes = [
        kernels.thin(points, min(PROBE_SPACING, _spacing(area, LEAST_PROBES))) if len(points) else np.zeros(0, np.int32)
        for points, _, _, area in candidates
    ]
    probe_points = [points[kept] for (points, *_), kept in zip(candidates, probes, strict=True)]
    probe_normals = [normals[kept] for (_, normals, *_), kept in zip(candidates, probes, strict=True)]
    seen, facing = _visibility(meshes, random_placements, probe_points, probe_normals, random)
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        vertices = [vertices for vertices, _ in meshes]
        return tuple(pool.map(_surface, vertices, candidates, probe_points, probe_normals, seen, facing))


def _evenly_spaced(
    vertices: NDArray[Any], faces: NDArray[Any], random: np.random.Generator
) -> tuple[Singles, Singles, float, float]:
    """Return evenly spaced points (m, 3) on the triangles, their face normals (m, 3), the spacing and the area."""
    if len(faces) == 0:
        return np.zeros((0, 3), np.float32), np.zeros((0, 3), np.float32), DENSE_SPACING, 0.0
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    cross = np.cross(b - a, c - a)
    twice_area = np.linalg.norm(cross, axis=1)
    area = float(twice_area.sum() / 2)
    spacing = max(min(DENSE_SPACING, _spacing(area, LEAST_DENSE_SAMPLES)), _spacing(area, MOST_DENSE_SAMPLES))
    count = int(np.clip(5 * area / spacing**2, 2000, 6 * MOST_DENSE_SAMPLES))
    face = np.searchsorted(np.cumsum(twice_area), random.random(count) * twice_area.sum(), side="right")
    face = np.minimum(face, len(faces) - 1)
    u, v = random.random((2, count))
    outside = u + v > 1
    u[outside], v[outside] = 1 - u[outside], 1 - v[outside]
    points = a[face] + u[:, None] * (b - a)[face] + v[:, None] * (c - a)[face]
    normals = cross[face] / twice_area[face, None]
    points32 = np.ascontiguousarray(points, np.float32)
    kept = kernels.thin(points32, spacing)
    return points32[kept], np.ascontiguousarray(normals[kept], np.float32), spacing, area


def _spacing(area: float, count: int) -> float:
    """Return the spacing at which dart throwing keeps about `count` points on `area`."""
    return float(np.sqrt(0.8 * area / count))


def _visibility(
    meshes: Sequence[Mesh],
    random_placements: Callable[[np.random.Generator], Array],
    points: Sequence[Singles],
    normals: Sequence[Singles],
    random: np.random.Generator,
) -> tuple[list[Singles], list[Singles]]:
    """Return per part how often each point is seen over random configurations, and on which side of its normal."""
    o3d = open3d()

    seen = [np.zeros(len(p), np.float32) for p in points]
    facing = [np.zeros(len(p), np.float32) for p in points]
    directions = fibonacci_directions(DIRECTIONS)
    for _ in range(CONFIGURATIONS):
        placements = random_placements(random)
        turned = directions @ _random_rotation(random).T
        scene = o3d.t.geometry.RaycastingScene()
        for (vertices, faces), T in zip(meshes, placements, strict=True):
            if len(faces):
                posed = np.ascontiguousarray(vertices @ T[:3, :3].T + T[:3, 3], np.float32)
                scene.add_triangles(o3d.core.Tensor(posed), o3d.core.Tensor(np.ascontiguousarray(faces, np.uint32)))
        for i, T in enumerate(placements):
            if len(points[i]) == 0:
                continue
            world = points[i] @ T[:3, :3].T + T[:3, 3]
            cosine = (normals[i] @ T[:3, :3].T) @ turned.T
            starts = world[:, None] + 1.5e-3 * turned[None]
            rays = np.concatenate([starts, np.broadcast_to(turned, starts.shape)], axis=-1).astype(np.float32)
            free = ~scene.test_occlusions(o3d.core.Tensor(np.ascontiguousarray(rays))).numpy()
            seen[i] += free.any(axis=1)
            facing[i] += (free * np.sign(cosine) * np.abs(cosine)).sum(axis=1)
    return [np.asarray(s / CONFIGURATIONS, np.float32) for s in seen], facing


def _surface(
    vertices: NDArray[Any],
    candidates: tuple[Singles, Singles, float, float],
    probes: Singles,
    probe_normals: Singles,
    seen: Singles,
    facing: Singles,
) -> Surface:
    """Build one part's surface from its points (`_evenly_spaced`) and the visibility of its probes."""
    from scipy.spatial import cKDTree

    dense, dense_normals, spacing, area = candidates
    visible = seen > SEEN_SHARE
    if visible.sum() < LEAST_SAMPLES:
        return _no_surface()
    probe = _probes_of(dense, dense_normals, probes, probe_normals)
    dense_normals = _outward(dense_normals, facing[probe])
    shown, apparent = visible[probe], dense_normals.copy()
    apparent[shown] = kernels.apparent_normals(dense[shown], dense_normals[shown], NORMAL_RADIUS, 1)
    outer, frequency = np.ascontiguousarray(probes[visible]), seen[visible]
    coarse = kernels.farthest_points(outer, COARSE_SAMPLES)
    owner = cKDTree(outer[coarse]).query(outer)[1]
    weights = np.bincount(owner, weights=frequency, minlength=len(coarse))
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    grid, origin, cell = _closest_samples(dense, low, high)
    flat = _flat(outer, _outward(probe_normals, facing)[visible], area / len(probes))
    centre = (low + high) / 2
    radius = np.linalg.norm(vertices - centre, axis=1).max()
    visible_area = area * frequency.sum() / len(probes)
    return Surface(
        samples=np.ascontiguousarray(outer[coarse], np.float32),
        normals=apparent[cKDTree(dense).query(outer[coarse])[1]],
        weights=np.asarray(weights / weights.sum(), np.float32),
        dense=dense,
        dense_normals=dense_normals,
        apparent_normals=apparent,
        grid=grid,
        origin=np.asarray(origin, np.float32),
        centre=np.asarray(centre, np.float32),
        faces=flat.frames,
        face_sizes=flat.sizes,
        scalars=np.array([cell, spacing, radius, np.linalg.norm(high - low), visible_area], np.float32),
    )


def _probes_of(dense: Singles, dense_normals: Singles, probes: Singles, probe_normals: Singles) -> Indices:
    """Return the probe that each dense sample is as visible as: the nearest on its own side of the wall."""
    from scipy.spatial import cKDTree

    near = cKDTree(probes).query(dense, k=min(6, len(probes)))[1]
    same_side = np.einsum("mkd,md->mk", probe_normals[near], dense_normals) > SAME_SIDE
    return np.asarray(near[np.arange(len(dense)), np.argmax(same_side, axis=1)], np.int64)


def _outward(normals: Singles, facing: Singles) -> Singles:
    """Return normals turned to the side from which they are seen."""
    return np.ascontiguousarray(normals * np.where(facing < 0, -1, 1)[:, None], np.float32)


def _closest_samples(dense: Singles, low: Array, high: Array) -> tuple[NDArray[np.uint16], Array, float]:
    """Return the grid (x, y, z) of the closest dense sample about a part between two corners, the grid's own lower
    corner, and the size of its cells."""
    origin, extent = low - GRID_BAND, high - low + 2 * GRID_BAND
    cell = max(FINEST_CELL, float(np.cbrt(extent.prod() / GRID_CELLS)))
    nx, ny, nz = (int(np.ceil(e / cell)) + 1 for e in extent)
    dims = nx, ny, nz
    return kernels.closest_sample_grid(dense, triple(origin), cell, dims, GRID_BAND).reshape(dims), origin, cell


def _flat(points: Singles, normals: Singles, area_per_point: float) -> FlatFaces:
    """Return the flat faces of the visible probes of one part."""
    spacing = float(np.sqrt(area_per_point))
    area = np.full(len(points), area_per_point)
    return flat_faces(points, normals, area, 2.5 * spacing, FACE_TOLERANCE, LEAST_FACE)


def _no_surface() -> Surface:
    none = np.zeros((0, 3), np.float32)
    return Surface(
        none, none, np.zeros(0, np.float32), none, none, none, np.zeros((0, 0, 0), np.uint16),
        np.zeros(3, np.float32), np.zeros(3, np.float32), np.zeros((0, 4, 4)), np.zeros((0, 2)),
        np.array([1, 0, 0, 0, 0], np.float32),
    )  # fmt: skip


def _random_rotation(random: np.random.Generator) -> NDArray[np.float64]:
    from scipy.spatial.transform import Rotation

    q = random.normal(size=4)
    return np.asarray(Rotation.from_quat(q / np.linalg.norm(q)).as_matrix())
