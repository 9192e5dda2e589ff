"""The outer-visible surface of a part, as the search and the kernels take it, and what parts weigh by it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pwralign_kin.arrays import Singles
from pwralign_kin.se3 import Array

LEAST_WEIGHT = 0.02
"""Small parts count at least this share, ..."""
SMALL_PARTS_WEIGHT = 0.5
"""... but if all were small, together no more than this: a hand of many parts is still a hand."""


@dataclass(frozen=True)
class Surface:
    """The visible surface of one part, lengths in model diagonals, in the part frame."""

    samples: Singles
    """(m, 3) coarse samples in farthest-point order, so that any prefix is a coarse set; empty: no surface."""
    normals: Singles
    """(m, 3) outward unit normals of the coarse samples, as scans tell them."""
    weights: Singles
    """(m,) share of the visible surface that each coarse sample stands for, weighted by how often it is seen."""
    dense: Singles
    """(d, 3) samples for closest-point queries."""
    dense_normals: Singles
    """(d, 3) outward unit normals of the dense samples."""
    apparent_normals: Singles
    """(d, 3) the same as scans tell them, whose normals are of neighbourhoods and mix the faces of what is fine."""
    grid: NDArray[np.uint16]
    """(x, y, z) index of the closest dense sample per cell, 65535 beyond the band."""
    origin: Singles
    """(3,) lower corner of the grid."""
    centre: Singles
    """(3,) centre of the bounding sphere."""
    faces: Array
    """(f, 4, 4) frames of the rectangles around flat faces (`flat_faces.FlatFaces`), ..."""
    face_sizes: Array
    """... and (f, 2) their sides."""
    scalars: Singles
    """(5,) `cell`, `spacing`, `radius`, `size` and `area`, as they are kept in the cache."""

    @property
    def exists(self) -> bool:
        """Whether the part has any visible surface."""
        return len(self.samples) > 0

    @property
    def cell(self) -> float:
        """Size of the grid's cells."""
        return float(self.scalars[0])

    @property
    def spacing(self) -> float:
        """Spacing of the dense samples."""
        return float(self.scalars[1])

    @property
    def radius(self) -> float:
        """Radius of the bounding sphere."""
        return float(self.scalars[2])

    @property
    def size(self) -> float:
        """Diagonal of the part's bounding box."""
        return float(self.scalars[3])

    @property
    def area(self) -> float:
        """Visible area, in squared model diagonals."""
        return float(self.scalars[4])


def part_weights(surfaces: Sequence[Surface]) -> Singles:
    """Return the weight (n,) of every part in the score: its share of the visible area, but never negligible."""
    areas = np.array([s.area for s in surfaces])
    exists = np.array([s.exists for s in surfaces])
    weights = np.maximum(areas / areas.sum(), min(LEAST_WEIGHT, SMALL_PARTS_WEIGHT / exists.sum())) * exists
    return np.asarray(weights / weights.sum(), np.float32)


def total_area(surfaces: Sequence[Surface]) -> float:
    """Return the visible area of all parts, in squared model diagonals."""
    return float(sum(s.area for s in surfaces))


def triple(v: NDArray[Any]) -> tuple[float, float, float]:
    """Return a vector (3,) as the kernels take it."""
    return float(v[0]), float(v[1]), float(v[2])
