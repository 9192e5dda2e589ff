"""Flat faces of a surface, each with the rectangle around it: where it ends tells where on a plane it lies."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pwralign_kin import kernels
from pwralign_kin.arrays import Indices, Singles
from pwralign_kin.se3 import Array

TRIALS = 100
"""Planes through a random point and its normal that each face is chosen from."""
FACING = 0.9
"""Least cosine between the normals of a face and of its points."""
MOST_FACES, FEWEST_POINTS = 12, 8
"""Faces of a part at most, and samples on each at least."""
TURNS = 45
"""Directions within a right angle in which the least rectangle is looked for."""


@dataclass(frozen=True)
class FlatFaces:
    """Flat pieces of a surface, the largest first."""

    frames: Array
    """(f, 4, 4) frames of the rectangles around them: origin in the middle, x along the longer side, z outwards."""
    sizes: Array
    """(f, 2) lengths of the longer and the shorter side."""
    areas: Array
    """(f,)."""

    def __len__(self) -> int:
        """Return the number of faces."""
        return len(self.areas)


def flat_faces(
    points: Singles, normals: Singles, area: Array, link: float, tolerance: float, least_area: float
) -> FlatFaces:
    """Return the connected flat pieces of at least `least_area` among points (n, 3) with unit normals (n, 3).

    Each point stands for an `area` (n,). Points within `tolerance` of a plane belong to it, those within `link` of each
    other to one piece.
    """
    frames: list[Array] = []
    sizes: list[Array] = []
    areas: list[float] = []
    left = np.arange(len(points))
    while len(left) >= FEWEST_POINTS and len(areas) < MOST_FACES:
        own, own_normals = np.ascontiguousarray(points[left]), np.ascontiguousarray(normals[left])
        piece = _largest_piece(own, own_normals, link, tolerance)
        if len(piece) < FEWEST_POINTS or area[left[piece]].sum() < least_area:
            break
        frame, size = _rectangle(own[piece].astype(float), own_normals[piece].mean(axis=0))
        frames.append(frame)
        sizes.append(size)
        areas.append(float(area[left[piece]].sum()))
        left = np.delete(left, piece)
    order = np.argsort(-np.array(areas), kind="stable")
    return FlatFaces(
        np.array(frames).reshape(-1, 4, 4)[order], np.array(sizes).reshape(-1, 2)[order], np.array(areas)[order]
    )


def _largest_piece(points: Singles, normals: Singles, link: float, tolerance: float) -> Indices:
    """Return the points of the largest connected piece of the plane that holds most points."""
    x, y, z, offset, _ = kernels.dominant_plane(points, normals, tolerance, TRIALS, 0)
    normal = np.array([x, y, z], np.float32)
    for _ in range(2):
        on = np.flatnonzero((np.abs(points @ normal - offset) < tolerance) & (normals @ normal > FACING))
        if len(on) < 3:
            return on
        centre = points[on].mean(axis=0)
        scatter = np.linalg.eigh(np.cov((points[on] - centre).T.astype(float)))[1][:, 0].astype(np.float32)
        normal = scatter if scatter @ normal > 0 else -scatter
        offset = float(normal @ centre)
    label = kernels.components(np.ascontiguousarray(points[on]), link)
    return np.asarray(on[label == np.bincount(label).argmax()])


def _rectangle(points: Array, normal: Singles) -> tuple[Array, Array]:
    """Return the frame and the sides of the least rectangle around points (n, 3) of a plane with this normal."""
    middle = points.mean(axis=0)
    axes = np.linalg.svd(points - middle, full_matrices=False)[2]
    z = axes[2] if axes[2] @ normal > 0 else -axes[2]
    x, y = axes[0], np.cross(z, axes[0])
    angles = np.arange(TURNS) * (np.pi / 2 / TURNS)
    along = np.stack([np.cos(angles), np.sin(angles)])
    across = np.stack([-np.sin(angles), np.cos(angles)])
    flat = (points - middle) @ np.stack([x, y], axis=1)
    low = np.stack([(flat @ axis).min(axis=0) for axis in (along, across)])
    high = np.stack([(flat @ axis).max(axis=0) for axis in (along, across)])
    best = int(np.argmin((high - low).prod(axis=0)))
    u = along[0, best] * x + along[1, best] * y
    v = np.cross(z, u)
    size, centre = (high - low)[:, best], (high + low)[:, best] / 2
    frame = np.eye(4)
    frame[:3, 3] = middle + centre[0] * u + centre[1] * v
    if size[0] < size[1]:
        u, v, size = v, -u, size[::-1]
    frame[:3, :3] = np.stack([u, v, z], axis=1)
    return frame, size
