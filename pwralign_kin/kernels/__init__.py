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
    along_curve,
    apparent_normals,
    closest_on_meshes,
    closest_sample_grid,
    components,
    dominant_plane,
    explained_within,
    farthest_points,
    first_of_cells,
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
    "along_curve",
    "apparent_normals",
    "closest_on_meshes",
    "closest_sample_grid",
    "components",
    "dominant_plane",
    "explained_within",
    "farthest_points",
    "first_of_cells",
    "local_planes",
    "nearest_neighbours",
    "neighbourhood_variances",
    "openness",
    "thin",
    "voxel_means",
]
