"""How far every scan point lies from the model, in front of its surface or behind."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pwralign_kin import files
from pwralign_kin.render import PosedMesh
from pwralign_kin.scan import write_ply
from pwralign_kin.se3 import Array

COLOUR_RANGE = 0.01
"""Distance at which the colours saturate, relative to the model's diagonal."""

INSIDE, ON, OUTSIDE = np.array([[33, 102, 220], [222, 222, 218], [205, 32, 31]], dtype=np.float64)
"""Colours of points behind, on and in front of the surface."""

NOT_OF_THE_MODEL = np.array([90, 90, 90], dtype=np.float64)

_DIRECTIONS = 64
_STEP = 1e-4  # of the diagonal: how far off the surface its two sides are looked at
_SEEN = 0.05  # a place is seen from outside where more of its half sphere is free
_EVEN = 0.1  # difference in openness up to which neither side counts as the outer one
_ROUNDS = 4
_CHUNK = 50_000


def signed_distances(mesh: PosedMesh, points: Array) -> Array:
    """Return the distance (n,) of every point (n, 3) to the visible surface of the posed model, m, positive outside.

    Neither closed meshes nor consistent normals are needed. On the line through a point and its closest place on the
    surface, rays go out from just before and just behind that place: the side where more of them leave the model is
    the outer one. Where none do on either side (walls and fittings within a hollow link) the place cannot have been
    scanned, and the closest place on the rest of the model counts instead. The sign of a sheet without thickness, open
    on both sides, follows its face normals.
    """
    local = np.asarray(points, dtype=np.float64) - mesh.centre
    return np.concatenate(
        [np.empty(0), *(_signed(mesh, local[start : start + _CHUNK]) for start in range(0, len(local), _CHUNK))]
    )


def write_deviation_ply(path: Path, points: Array, distances: Array, labels: NDArray[np.int64], mesh: PosedMesh) -> None:
    """Write the scan points with the properties `distance` (m), `part` (-1: not the model's) and a colour.

    Colours run from blue (behind the surface) over light grey to red (in front of it) and saturate at 1% of the
    model's diagonal; points that are not the model's are dark grey.
    """
    share = np.clip(distances / (COLOUR_RANGE * mesh.diagonal), -1.0, 1.0)[:, None]
    colours = ON + np.where(share > 0.0, share * (OUTSIDE - ON), -share * (INSIDE - ON))
    colours[labels < 0] = NOT_OF_THE_MODEL
    red, green, blue = np.rint(colours).astype(np.uint8).T
    properties: Mapping[str, NDArray[Any]] = {
        "distance": distances.astype(np.float32),
        "part": labels,
        "red": red,
        "green": green,
        "blue": blue,
    }
    write_ply(path, points, properties)


def write_deviation_table(path: Path, distances: Array, labels: NDArray[np.int64], parts: Sequence[str]) -> None:
    """Write a CSV with one row per part: its number and name, its scan points and their signed distances (m)."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["part", "name", "points", "mean", "rms", "max_abs", "p95_abs"])
    for index, name in enumerate(parts):
        own = distances[labels == index]
        figures = [own.mean(), np.sqrt(np.mean(own**2)), np.abs(own).max(), np.percentile(np.abs(own), 95)] if len(own) else []
        cells = [f"{figure:.6g}" for figure in figures] or [""] * 4
        writer.writerow([index, name, len(own), *cells])
    files.write_text(path, text.getvalue())


def _signed(mesh: PosedMesh, local: Array) -> Array:
    """Return the signed distances of points (n, 3) given relative to the centre of the mesh."""
    closest, normals, _ = _closest(mesh.scene, local)
    face_left = np.ones(len(mesh.faces), dtype=bool)
    front, back = _open_sides(mesh, local, closest, normals)
    pending = np.flatnonzero(np.maximum(front, back) < _SEEN)
    nearest_faces = _closest(mesh.scene, local[pending])[2] if len(pending) else np.empty(0, dtype=np.int64)
    for _ in range(_ROUNDS):
        face_left[nearest_faces] = False
        if not len(pending) or not face_left.any():
            break
        rest = PosedMesh(mesh.vertices, mesh.faces[face_left], mesh.face_part[face_left], mesh.parts, mesh.diagonal)
        there, their_normals, nearest = _closest(rest.scene, local[pending])
        their_front, their_back = _open_sides(mesh, local[pending], there, their_normals)
        seen = np.maximum(their_front, their_back) >= _SEEN
        chosen = pending[seen]
        closest[chosen], normals[chosen] = there[seen], their_normals[seen]
        front[chosen], back[chosen] = their_front[seen], their_back[seen]
        pending, nearest_faces = pending[~seen], np.flatnonzero(face_left)[nearest[~seen]]

    offsets = local - closest
    by_normal = np.where(np.einsum("ni,ni->n", offsets, normals) < 0.0, -1.0, 1.0)
    sign = np.where(np.abs(front - back) <= _EVEN, by_normal, np.where(front > back, 1.0, -1.0))
    return np.asarray(sign * np.linalg.norm(offsets, axis=1))


def _closest(scene: Any, local: Array) -> tuple[Array, Array, NDArray[np.int64]]:
    """Return the closest places (n, 3), the normals (n, 3) and the indices (n,) of their faces."""
    import open3d as o3d

    answer = scene.compute_closest_points(o3d.core.Tensor(local.astype(np.float32)))
    return (
        answer["points"].numpy().astype(np.float64),
        answer["primitive_normals"].numpy().astype(np.float64),
        answer["primitive_ids"].numpy().astype(np.int64),
    )


def _open_sides(mesh: PosedMesh, local: Array, closest: Array, normals: Array) -> tuple[Array, Array]:
    """Return how open the surface is at each closest place (n,), on the point's side and on the other."""
    import open3d as o3d

    offsets = local - closest
    length = np.linalg.norm(offsets, axis=1, keepdims=True)
    far_enough = length > 1e-6 * mesh.diagonal
    towards = np.where(far_enough, offsets / np.where(far_enough, length, 1.0), normals)
    directions = _sphere(_DIRECTIONS)
    ahead = np.einsum("ni,ki->nk", towards, directions) > 0.0
    step = np.where(ahead, 1.0, -1.0)[..., None] * (_STEP * mesh.diagonal * towards)[:, None]
    rays = np.empty((len(local), _DIRECTIONS, 6), dtype=np.float32)
    rays[..., :3] = closest[:, None] + step
    rays[..., 3:] = directions
    free = ~mesh.scene.test_occlusions(o3d.core.Tensor(rays)).numpy()
    front = (free & ahead).sum(axis=1) / np.maximum(ahead.sum(axis=1), 1)
    back = (free & ~ahead).sum(axis=1) / np.maximum((~ahead).sum(axis=1), 1)
    return front, back


def _sphere(count: int) -> Array:
    """Return (count, 3) unit directions, evenly spread along a golden-angle spiral."""
    z = 1.0 - (2.0 * np.arange(count) + 1.0) / count
    turn = 2.39996322972865332 * np.arange(count)
    radius = np.sqrt(1.0 - z**2)
    return np.stack([radius * np.cos(turn), radius * np.sin(turn), z], axis=1)
