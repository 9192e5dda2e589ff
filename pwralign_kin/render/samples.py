"""What the rays through a picture meet."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from pwralign_kin.arrays import Bools, Indices, Singles
from pwralign_kin.render.camera import View, tangents
from pwralign_kin.render.mesh import PosedMesh

SAMPLES_PER_PIXEL = 2
"""Side of the square of rays that are averaged into a pixel that an edge or an outline crosses."""


@dataclass(frozen=True)
class Samples:
    """What rays of a view met; all arrays (..., as said)."""

    places: Singles  # (2) column and row in the picture, pixels
    directions: Singles  # (3) unit, scan frame
    depth: Singles  # along the forward axis, m; infinite where nothing is met
    face: Indices  # -1 where nothing is met
    part: Indices  # -1 where nothing is met
    normal: Singles  # (3) of the face met, towards the camera
    barycentric: Singles  # (2) of the corners 1 and 2 of the face

    def at(self, chosen: Any) -> Samples:
        """Return the samples that an index or a mask chooses."""
        return Samples(*(getattr(self, name)[chosen] for name in self.__dataclass_fields__))


def middles(size: tuple[int, int]) -> Singles:
    """Return (height, width, 2) the middle of every pixel."""
    columns, rows = np.meshgrid(np.arange(size[0], dtype=np.float32), np.arange(size[1], dtype=np.float32))
    return np.stack([columns, rows], axis=-1) + np.float32(0.5)


def middles_within(chosen: Bools) -> Singles:
    """Return (n, s, 2) the middles of the squares that the chosen pixels are divided into, row by row."""
    rows, columns = np.nonzero(chosen)
    inner = middles((SAMPLES_PER_PIXEL, SAMPLES_PER_PIXEL)).reshape(-1, 2) / SAMPLES_PER_PIXEL
    return (np.stack([columns, rows], axis=-1)[:, None] + inner).astype(np.float32)


def cast(mesh: PosedMesh, view: View, size: tuple[int, int], places: Singles) -> Samples:
    """Cast a ray through each of `places` (..., 2) of the picture."""
    axes = view.axes().astype(np.float32)
    slopes = ((2.0 * places / np.array(size, dtype=np.float32) - 1.0) * tangents(size, view.fov)).astype(np.float32)
    rays = np.empty((*places.shape[:-1], 6), dtype=np.float32)
    rays[..., :3] = view.eye - mesh.centre
    directions = rays[..., 3:]
    directions[:] = slopes @ axes[:2] + axes[2]
    directions /= np.sqrt(np.einsum("...i,...i->...", directions, directions))[..., None]
    hits = mesh.scene.cast(rays)
    away = np.einsum("...i,...i->...", hits.normal, directions) > 0.0
    return Samples(
        places=places,
        directions=directions,
        depth=hits.distance * (directions @ axes[2]),
        face=hits.face,
        part=np.where(hits.face < 0, -1, mesh.face_part[hits.face]),
        normal=np.where(away[..., None], -hits.normal, hits.normal),
        barycentric=hits.barycentric,
    )
