"""The field of what was seen: how far from its surface, free or hidden each place is."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from pwralign_kin import kernels
from pwralign_kin.arrays import Ints, Singles
from pwralign_kin.estimation.sensing.observation import NO_BORDERS, ObservationOptions


@dataclass(frozen=True)
class PreparedPoints:
    """The points that a model is held against, as `Observation` holds them."""

    points: Singles
    normals: Singles
    weights: Singles
    areas: Singles
    regions: Ints

    @classmethod
    def all_alike(cls, points: Singles, normals: Singles) -> PreparedPoints:
        """Take points (m, 3) and their normals (m, 3) for those of the model alone."""
        count = len(points)
        ones = np.ones(count, np.float32)
        return cls(points, normals, ones, ones.copy(), np.zeros(count, np.int32))


@dataclass(frozen=True)
class SeenSpace:
    """All that was seen, whether a model is held against it or not: it tells free from hidden space."""

    points: Singles
    """(n, 3)"""
    origin: Singles | None
    """(3,) where from; None: it tells nothing."""
    pixel: float
    """`Observation.depth_pixel`"""
    borders: Singles = field(default_factory=lambda: NO_BORDERS)
    """`Observation.borders`"""


def field_of(
    prepared: PreparedPoints,
    seen: SeenSpace,
    options: ObservationOptions,
    threads: int,
    *,
    cell: float | None = None,
    unreturned: float = 1.0,
) -> kernels.ScanField:
    """Return the field of the prepared points in what was seen.

    Its cells have the size of the options, unless told; space is seen to be free by `unreturned` (a share) where no ray
    came back.
    """
    looked = seen.origin is not None
    return kernels.ScanField(
        points=prepared.points,
        normals=prepared.normals,
        weights=prepared.weights,
        areas=prepared.areas,
        regions=prepared.regions,
        cell=options.field_cell if cell is None else cell,
        truncation=options.field_truncation,
        sensor_origin=[] if seen.origin is None else [float(v) for v in seen.origin],
        depth_points=seen.points if looked else np.zeros((0, 3), np.float32),
        borders=seen.borders,
        pixel=seen.pixel,
        tolerance=options.depth_tolerance,
        shadow=options.shadow,
        unreturned=unreturned,
        threads=threads,
    )
