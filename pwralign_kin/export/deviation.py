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
from pwralign_kin.render import PosedMesh, RayScene
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
_SPACING = 0.02  # of the diagonal: large faces are looked at in as many places
_MOST_PLACES = 50  # per face
_CHUNK = 20_000


def signed_distances(mesh: PosedMesh, points: Array) -> Array:
    """Return the distance (n,) of points (n, 3) to the posed model's visible surface, m, positive outside.

    Neither closed meshes nor consistent normals are needed; rays tell what is outside. Faces from which hardly
    any ray leaves the model on either side (walls and fittings within a hollow link) cannot have been scanned
    and do not count. On the line through a point and its closest place on the other faces, rays go out from
    just before and just behind that place, and the side where more of them leave is the outer one. A sheet
    without thickness, as open on one side as on the other, takes the sign from its face normals.
    """
    visible = _visible_faces(mesh)
    surface = RayScene(mesh.vertices - mesh.centre, mesh.faces[visible]) if visible.any() else mesh.scene
    local = np.asarray(points, dtype=np.float64) - mesh.centre
    distances = np.empty(len(local))
    for rows in _chunks(len(local)):
        closest, normals, _ = surface.closest(local[rows])
        offsets = local[rows] - closest
        length = np.linalg.norm(offsets, axis=1)
        off_surface = length > 1e-6 * mesh.diagonal
        towards = np.where(
            off_surface[:, None], offsets / np.where(off_surface, length, 1.0)[:, None], normals
        )
        front, back = _open_sides(mesh, closest, towards)
        by_normal = np.where(np.einsum("ni,ni->n", towards, normals) < 0.0, -1.0, 1.0)
        sign = np.where(np.abs(front - back) <= _EVEN, by_normal, np.where(front > back, 1.0, -1.0))
        distances[rows] = sign * length
    return distances


def write_deviation_ply(
    path: Path, points: Array, distances: Array, labels: NDArray[np.int64], mesh: PosedMesh
) -> None:
    """Write the scan points with the properties `distance` (m), `part` (-1: not the model's) and a colour.

    Colours run from blue (behind the surface) over light grey to red (in front of it) and saturate at 1% of
    the model's diagonal; points that are not the model's are dark grey.
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


def write_deviation_table(
    path: Path, distances: Array, labels: NDArray[np.int64], parts: Sequence[str]
) -> None:
    """Write a CSV with a row per part: number, name, and the signed distances (m) of its scan points."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["part", "name", "points", "mean", "rms", "max_abs", "p95_abs"])
    for index, name in enumerate(parts):
        own = distances[labels == index]
        cells = [f"{figure:.6g}" for figure in _figures(own)] if len(own) else [""] * 4
        writer.writerow([index, name, len(own), *cells])
    files.write_text(path, text.getvalue())


def _figures(distances: Array) -> tuple[float, float, float, float]:
    """Return mean, root mean square, largest and 95th percentile of absolute values."""
    size = np.abs(distances)
    return (
        float(distances.mean()),
        float(np.sqrt(np.mean(size**2))),
        float(size.max()),
        float(np.percentile(size, 95)),
    )


def _visible_faces(mesh: PosedMesh) -> NDArray[np.bool_]:
    """Return which faces (f,) are seen from outside the posed model in at least one of several places."""
    corners = mesh.vertices[mesh.faces] - mesh.centre
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    double_area = np.linalg.norm(normals, axis=1)
    normals /= np.where(double_area > 0.0, double_area, 1.0)[:, None]
    counts = np.clip(np.ceil(double_area / (_SPACING * mesh.diagonal) ** 2), 1, _MOST_PLACES).astype(np.int64)
    face = np.repeat(np.arange(len(counts)), counts)
    number = np.arange(len(face)) - np.repeat(np.cumsum(counts) - counts, counts)
    # The centroid, then the sequence of the plastic number, folded into the triangle.
    weights = (1.0 / 3.0 + number[:, None] * [0.7548776662466927, 0.5698402909980532]) % 1.0
    weights = np.where(weights.sum(axis=1, keepdims=True) > 1.0, 1.0 - weights, weights)
    visible = np.zeros(len(counts), dtype=bool)
    for rows in _chunks(len(face)):
        own, along = corners[face[rows]], weights[rows, :, None]
        places = own[:, 0] + (along * (own[:, 1:] - own[:, :1])).sum(axis=1)
        seen = np.maximum(*_open_sides(mesh, places, normals[face[rows]])) >= _SEEN
        visible[face[rows][seen]] = True
    return visible


def _open_sides(mesh: PosedMesh, places: Array, towards: Array) -> tuple[Array, Array]:
    """Return which share of rays leaves the model freely from places (n, 3) on its surface.

    The first (n,) is of the half sphere around `towards` (n, 3), the second of the other; places are given
    relative to the centre of the mesh.
    """
    directions = _sphere(_DIRECTIONS)
    ahead = np.einsum("ni,ki->nk", towards, directions) > 0.0
    step = _STEP * mesh.diagonal * towards
    rays = np.empty((len(places), _DIRECTIONS, 6), dtype=np.float32)
    rays[..., :3] = np.where(ahead[..., None], (places + step)[:, None], (places - step)[:, None])
    rays[..., 3:] = directions
    free = ~mesh.scene.blocked(rays)
    front = (free & ahead).sum(axis=1) / np.maximum(ahead.sum(axis=1), 1)
    back = (free & ~ahead).sum(axis=1) / np.maximum((~ahead).sum(axis=1), 1)
    return front, back


def _chunks(count: int) -> list[slice]:
    """Return slices of bounded length that cover `count` rows."""
    return [slice(start, min(start + _CHUNK, count)) for start in range(0, count, _CHUNK)]


def _sphere(count: int) -> Array:
    """Return (count, 3) unit directions, evenly spread along a golden-angle spiral."""
    z = 1.0 - (2.0 * np.arange(count) + 1.0) / count
    turn = 2.39996322972865332 * np.arange(count)
    radius = np.sqrt(1.0 - z**2)
    return np.stack([radius * np.cos(turn), radius * np.sin(turn), z], axis=1)
