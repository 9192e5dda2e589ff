"""A model's geometry in one state."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pwralign_kin.arrays import Indices, Singles
from pwralign_kin.exceptions import ModelError
from pwralign_kin.model import ArticulatedModel
from pwralign_kin.render.colours import part_colours
from pwralign_kin.render.rays import RayScene
from pwralign_kin.se3 import Array, transform
from pwralign_kin.state import State

_CREASE = np.cos(np.radians(40.0))


@dataclass(frozen=True)
class PosedMesh:
    """All geometry of a model in one state."""

    vertices: Array
    """(v, 3) in the scan frame, m."""

    faces: Indices
    """(f, 3) vertex indices."""

    face_part: Indices
    """(f,) index of the part that each face belongs to."""

    parts: tuple[str, ...]
    """Names of the parts."""

    diagonal: float
    """The model's diagonal, m."""

    @cached_property
    def centre(self) -> Array:
        """Middle (3,) of the axis-aligned bounding box, m."""
        return np.asarray((self.vertices.min(axis=0) + self.vertices.max(axis=0)) / 2.0)

    @cached_property
    def colours(self) -> Array:
        """sRGB colours (p, 3) of the parts, in [0, 1]; white for parts without geometry."""
        shown = np.bincount(self.face_part, minlength=len(self.parts)) > 0
        colours = np.ones((len(self.parts), 3))
        colours[shown] = part_colours(int(np.count_nonzero(shown)))
        return colours

    @cached_property
    def outline(self) -> Array:
        """Vertices (h, 3) of the convex hull: as far as the mesh reaches in any picture."""
        from scipy.spatial import ConvexHull, QhullError

        try:
            return np.asarray(self.vertices[ConvexHull(self.vertices - self.centre).vertices])
        except QhullError:  # a flat mesh has no hull
            return self.vertices

    @cached_property
    def scene(self) -> RayScene:
        """The mesh for casting rays, moved by minus `centre`, so that single precision is fine enough."""
        return RayScene(self.vertices - self.centre, self.faces)

    @cached_property
    def corner_normals(self) -> Singles:
        """Normals for shading, (f, 3, 3); see `corner_normals`."""
        return corner_normals(self.vertices, self.faces).astype(np.float32)


def posed_mesh(model: ArticulatedModel, state: State) -> PosedMesh:
    """Return the geometry of every part of `model` placed by `state`.

    Raises `UnknownNameError` for joints that the model lacks and `ModelError` for a model without geometry.
    """
    T_scan_base = model.root_placement(state)
    vertices, faces, face_part = [], [], []
    count = 0
    placements = model.part_placements(model.values(state.joints))
    for index, (part, T_base_part) in enumerate(zip(model.parts, placements, strict=True)):
        vertices.append(transform(T_scan_base @ T_base_part, part.vertices))
        faces.append(part.faces + count)
        face_part.append(np.full(len(part.faces), index, dtype=np.int64))
        count += len(part.vertices)
    if not sum(map(len, faces)):
        raise ModelError(model.urdf_path, "the model has no geometry to show")
    return PosedMesh(
        np.concatenate(vertices),
        np.concatenate(faces),
        np.concatenate(face_part),
        tuple(part.name for part in model.parts),
        model.diagonal,
    )


def corner_normals(vertices: Array, faces: Indices) -> Array:
    """Return unit normals (f, 3, 3) at the corners of `faces` (f, 3), smooth over edges under 40 degrees.

    Around a vertex, faces joined by smooth edges share the sum of their area-weighted normals. Vertices at
    the same place count as one. A face without area has the normal zero.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    corners = vertices[faces]
    area_normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(area_normal, axis=1)
    unit = area_normal / np.where(length > 0.0, length, 1.0)[:, None]

    place = distinct_rows(vertices)[1][faces]
    # Half-edge `k` of a face runs from its corner k to its corner k + 1.
    start, end = place.reshape(-1), np.roll(place, -1, axis=1).reshape(-1)
    low, high = np.minimum(start, end), np.maximum(start, end)
    order = np.lexsort((high, low))
    one, two = order[:-1], order[1:]
    shared = (low[one] == low[two]) & (high[one] == high[two])
    one, two = one[shared], two[shared]
    smooth = np.einsum("ij,ij->i", unit[one // 3], unit[two // 3]) > _CREASE
    one, two = one[smooth], two[smooth]

    def following(half_edge: Indices) -> Indices:
        return half_edge - half_edge % 3 + (half_edge + 1) % 3

    same_way = start[one] == start[two]
    linked_two_start = np.where(same_way, two, following(two))
    linked_two_end = np.where(same_way, following(two), two)
    rows = np.concatenate([one, following(one)])
    columns = np.concatenate([linked_two_start, linked_two_end])
    size = 3 * len(faces)
    _, group = connected_components(coo_array((np.ones(len(rows), dtype=bool), (rows, columns)), shape=(size, size)))
    per_corner = np.repeat(area_normal, 3, axis=0)
    total = np.stack([np.bincount(group, per_corner[:, axis]) for axis in range(3)], axis=1)
    total_length = np.linalg.norm(total, axis=1, keepdims=True)
    return np.asarray((total / np.where(total_length > 0.0, total_length, 1.0))[group].reshape(-1, 3, 3))


def distinct_rows(rows: NDArray[Any]) -> tuple[Indices, Indices]:
    """Return indices of one of each of the different `rows` (n, k), and (n,) which of those each row is like."""
    order = np.lexsort(rows.T)
    new = np.ones(len(rows), dtype=bool)
    new[1:] = (rows[order[1:]] != rows[order[:-1]]).any(axis=1)
    index = np.empty(len(rows), dtype=np.int64)
    index[order] = np.cumsum(new) - 1
    return order[new], index
