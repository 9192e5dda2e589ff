"""Which way the surface faces at the points of a scan."""

from __future__ import annotations

import numpy as np

from pwralign_kin import kernels
from pwralign_kin.arrays import Bools, Ints, Singles
from pwralign_kin.estimation.sensing.observation import ObservationOptions
from pwralign_kin.se3 import Array

ON_LINE, LINE_POINTS = 0.12, 4
"""A neighbourhood of at least so many points is of one scan line if, noise aside, its variance across the line is less
than this share of that along it."""
LINES = 0.25
"""Share of neighbourhoods of one scan line from which all are widened until they hold several, ..."""
WIDER, WIDENINGS = 1.5, 5
"""... each time by so much, so often at most."""
OPEN_CELL, OPEN_SPACINGS = 0.025, 0.9
"""Least cell (model diagonals) in which the open side of a surface is told, and how many spacings wide it is."""
LEAST_FACING = 0.5
"""Share of points that face the sensor below which their normals are not to be trusted."""


def normals_of(
    points: Singles, noise: float, spacing: float, options: ObservationOptions, threads: int
) -> tuple[Singles, float]:
    """Return unit normals of either sign, from neighbourhoods that are wide against noise and spacing; and how far
    apart scan lines are, where a spinning sensor leaves many points' spacings between them, else 0."""
    radius = max(options.normal_radius + options.normal_noises * noise, options.neighbour_spacings * spacing)
    normals, _, widened = planes_across_lines(points, radius, noise, threads)
    return normals, widened / options.neighbour_spacings


def planes_across_lines(points: Singles, radius: float, noise: float, threads: int) -> tuple[Singles, Singles, float]:
    """Return unit normals of either sign and variances (n, 3) of the neighbourhoods within `radius` of points, which
    are widened where a spinning sensor leaves them on one scan line; and how wide they then are, else 0."""
    normals, _, variances, neighbours = kernels.local_planes(points, radius, threads)
    on_line, widened = _on_line(variances, neighbours, noise), 0.0
    for _ in range(WIDENINGS):
        if on_line.mean() < LINES:
            break
        widened = radius = radius * WIDER
        wider, _, more, neighbours = kernels.local_planes(points, radius, threads)
        told = on_line & ~_on_line(more, neighbours, noise)
        normals[told], variances[told] = wider[told], more[told]
        on_line &= ~told
    return np.asarray(normals), np.asarray(variances), widened


def _on_line(variances: Singles, neighbours: Ints, noise: float) -> Bools:
    """Return which neighbourhoods with these `variances` (n, 3) are of one scan line, which noise widens; few points
    always lie on some line."""
    return np.asarray((neighbours >= LINE_POINTS) & (variances[:, 1] - noise**2 < ON_LINE * variances[:, 2]))


def oriented_normals(
    points: Singles, normals: Singles, origins: Singles | Array | None, spacing: float, threads: int
) -> Singles:
    """Turn normals towards the sensor origins, (3,) or one a point (n, 3), or without any towards the open side."""
    if origins is None:
        cell = max(OPEN_CELL, OPEN_SPACINGS * spacing)
        towards = kernels.openness(points, np.ascontiguousarray(normals, np.float32), cell, threads)
    else:
        towards = np.einsum("ij,ij->i", normals, origins - points)
    return np.ascontiguousarray(normals * np.where(towards < 0, -1, 1)[:, None], np.float32)


def facing(points: Singles, normals: Singles, origin: Singles, options: ObservationOptions) -> Bools:
    """Return which points face the sensor; the others are mostly mixed pixels between an edge and what lies behind.

    If it seems to be most of them, the scan is too sparse for normals, and all are kept.
    """
    rays = origin - points
    along = np.einsum("ij,ij->i", normals, rays)
    faced = along > options.grazing * np.linalg.norm(rays, axis=1)
    return np.asarray(faced | (faced.mean() < LEAST_FACING))
