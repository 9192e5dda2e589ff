"""Non-rigid ICP (Amberg, Romdhani and Vetter, CVPR 2007) by trimesh, from a rigid start.

`trimesh.registration.nricp_amberg` with the steps of its example
(https://github.com/mikedh/trimesh/blob/main/examples/nricp.py), without landmarks, for nobody has any, and its default
for the farthest pair. The mesh is made small first: every vertex has twelve unknowns of its own. A piece that meets no
point within that distance is not determined; trimesh then fails with a singular matrix.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pwralign_kin.arrays import Indices
from pwralign_kin.dependencies import open3d
from pwralign_kin.exceptions import ScanError
from pwralign_kin.se3 import Array

TRIANGLES = 3000
"""Of the mesh that is registered."""

STEPS = ((0.02, 0.0, 0.5, 10), (0.007, 0.0, 0.5, 10), (0.002, 0.0, 0.5, 10))
"""Smoothness, weight of landmarks, weight of normals, and most iterations of each step."""

FUSED_DEPTH = 6
"""Depth of the octree of the surface that joins all parts."""


def non_rigid_icp(vertices: Array, faces: Indices, target: Array) -> Array:
    """Return the vertices (n, 3), m, of a mesh that lies about right already, registered to points (m, 3), m.

    Raises `ScanError` where the points leave a piece of the mesh undetermined.
    """
    from trimesh import Trimesh
    from trimesh.registration import nricp_amberg

    mesh = Trimesh(vertices, faces, process=False)
    try:
        moved = np.asarray(nricp_amberg(mesh, target, steps=STEPS, use_faces=False))
    except RuntimeError:  # of SciPy's sparse solver: the matrix is singular
        moved = np.full_like(vertices, np.nan)
    if not np.isfinite(moved).all():
        raise ScanError("scan", "it leaves a piece of the mesh undetermined to non-rigid ICP")
    return moved


def disjoint_mesh(bodies: Sequence[tuple[Array, Indices]]) -> tuple[Array, Indices]:
    """Return one mesh of the `bodies`' vertices (n, 3) and faces (f, 3), simplified one by one, not connected."""
    total = sum(len(faces) for _, faces in bodies)
    share = min(1.0, TRIANGLES / max(total, 1))
    pieces = [_simplified(vertices, faces, max(50, round(share * len(faces)))) for vertices, faces in bodies]
    starts = np.cumsum([0, *(len(vertices) for vertices, _ in pieces)])
    shifted = [faces + start for (_, faces), start in zip(pieces, starts, strict=False)]
    return np.concatenate([vertices for vertices, _ in pieces]), np.concatenate(shifted)


def fused_mesh(points: Array, normals: Array) -> tuple[Array, Indices]:
    """Return one connected mesh through all points (n, 3) with outward normals (n, 3), simplified.

    By Poisson reconstruction (Kazhdan et al., SGP 2006) on an octree so coarse that neighbouring parts merge at their
    joints; of what stays apart the largest piece is taken.
    """
    o3d = open3d()
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
    cloud.normals = o3d.utility.Vector3dVector(normals)
    mesh, _ = o3d.geometry.TriangleMesh.create_from_point_cloud_poisson(cloud, depth=FUSED_DEPTH, n_threads=1)
    clusters, sizes, _ = mesh.cluster_connected_triangles()
    mesh.remove_triangles_by_mask(np.asarray(clusters) != int(np.argmax(sizes)))
    mesh.remove_unreferenced_vertices()
    return _simplified(np.asarray(mesh.vertices), np.asarray(mesh.triangles, np.int64), TRIANGLES)


def _simplified(vertices: Array, faces: Indices, count: int) -> tuple[Array, Indices]:
    """Return the mesh with at most `count` triangles, its equal vertices merged."""
    o3d = open3d()
    mesh = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(vertices), o3d.utility.Vector3iVector(faces.astype(np.int32))
    )
    mesh.remove_duplicated_vertices()
    if len(faces) > count:
        mesh = mesh.simplify_quadric_decimation(count)
    mesh.remove_degenerate_triangles()
    mesh.remove_unreferenced_vertices()
    return np.array(mesh.vertices), np.array(mesh.triangles, np.int64)


def carried(points: Array, vertices: Array, faces: Indices, moved: Array) -> Array:
    """Return where points (m, 3) beside a mesh go when its `vertices` (n, 3) become `moved` (n, 3).

    Each keeps its place in the nearest triangle, and its offset from it.
    """
    o3d = open3d()
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(
        o3d.core.Tensor(np.ascontiguousarray(vertices, np.float32)),
        o3d.core.Tensor(np.ascontiguousarray(faces, np.uint32)),
    )
    found = scene.compute_closest_points(o3d.core.Tensor(np.ascontiguousarray(points, np.float32)))
    u, v = found["primitive_uvs"].numpy().T.astype(float)
    corners = faces[found["primitive_ids"].numpy()]
    motion = np.stack([1.0 - u - v, u, v], axis=1)[:, :, None] * (moved - vertices)[corners]
    return np.asarray(points + motion.sum(axis=1))
