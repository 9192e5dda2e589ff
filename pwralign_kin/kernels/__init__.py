"""Compiled kernels: everything that touches points.

Flat arrays in and out; lengths in units of the model's diagonal.
"""

from pwralign_kin.kernels._native import (
    Articulated,
    ScanField,
    Search,
    SearchOptions,
    SurfaceMixture,
    Tracking,
    TriangleMesh,
    apparent_normals,
    closest_on_meshes,
    closest_sample_grid,
    components,
    dominant_plane,
    explained_within,
    farthest_points,
    local_planes,
    nearest_neighbours,
    neighbourhood_variances,
    openness,
    thin,
    voxel_means,
)

__all__ = [
    "Articulated",
    "ScanField",
    "Search",
    "SearchOptions",
    "SurfaceMixture",
    "Tracking",
    "TriangleMesh",
    "apparent_normals",
    "closest_on_meshes",
    "closest_sample_grid",
    "components",
    "dominant_plane",
    "explained_within",
    "farthest_points",
    "local_planes",
    "nearest_neighbours",
    "neighbourhood_variances",
    "openness",
    "thin",
    "voxel_means",
]
