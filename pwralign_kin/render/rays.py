"""Triangles that rays meet."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pwralign_kin.arrays import Bools, Indices, Singles
from pwralign_kin.dependencies import open3d
from pwralign_kin.se3 import Array


@dataclass(frozen=True)
class Hits:
    """What rays (...) met."""

    distance: Singles
    """(...) along the ray, m; infinite where nothing is met."""

    face: Indices
    """(...) index of the face; -1 where nothing is met."""

    normal: Singles
    """(..., 3) unit normal of the face by its winding."""

    barycentric: Singles
    """(..., 2) weights of the corners 1 and 2 of the face."""


class RayScene:
    """Triangles that rays and closest-place queries meet: Open3D's `RaycastingScene`, in single precision."""

    def __init__(self, vertices: Array, faces: Indices) -> None:
        """Take over `vertices` (v, 3), m, and `faces` (f, 3). Raises `DependencyError` without Open3D."""
        library = open3d()
        self._tensor = library.core.Tensor
        self._scene = library.t.geometry.RaycastingScene()
        self._scene.add_triangles(self._tensor(vertices.astype(np.float32)), self._tensor(faces.astype(np.uint32)))

    def cast(self, rays: Singles) -> Hits:
        """Return the first hit of each of `rays` (..., 6): origin and direction."""
        answer = self._scene.cast_rays(self._tensor(rays))
        distance = answer["t_hit"].numpy()
        face = np.where(np.isinf(distance), -1, answer["primitive_ids"].numpy().astype(np.int64))
        return Hits(distance, face, answer["primitive_normals"].numpy(), answer["primitive_uvs"].numpy())

    def blocked(self, rays: Singles, reach: float = np.inf) -> Bools:
        """Return (...) whether `rays` (..., 6) of unit direction meet anything within `reach`, m."""
        answer = self._scene.test_occlusions(self._tensor(rays), tnear=0.0, tfar=reach)
        return np.asarray(answer.numpy())

    def closest(self, places: Array | Singles) -> tuple[Array, Array, Indices]:
        """Return what is closest to `places` (n, 3): places (n, 3), their faces' normals and indices (n,)."""
        answer = self._scene.compute_closest_points(self._tensor(places.astype(np.float32)))
        return (
            answer["points"].numpy().astype(np.float64),
            answer["primitive_normals"].numpy().astype(np.float64),
            answer["primitive_ids"].numpy().astype(np.int64),
        )
