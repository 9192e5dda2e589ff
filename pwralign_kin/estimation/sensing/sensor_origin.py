"""Whether a scan was seen from its sensor origin, by the points that hide each other."""

from __future__ import annotations

import numpy as np

from pwralign_kin import kernels
from pwralign_kin.arrays import Bools, Ints, Singles
from pwralign_kin.estimation.sensing.points import at_most, median, sixth_neighbour
from pwralign_kin.estimation.sensing.viewpoints import common_origin
from pwralign_kin.scan import Scan
from pwralign_kin.se3 import Array

SEEN_THROUGH = 0.25
"""Share of points that others hide from the sensor origin from which the scan was not seen from there: up to 0.23 where
every pixel at a depth edge mixes both sides, 0.28 and more where the origin is another's, or one of several."""
FINELY_SEEN_THROUGH, BY_NOISE = 0.07, 12.0
"""The same in pixels as fine as the points are dense, where the scan is of the model and nobody told its origin; or so
many times the noise (model diagonals), where that is more."""
HIDING_SAMPLE, HIDING_PIXEL, HIDING_DEPTH, LEAST_HIDING_RANGE = 20000, 0.02, 0.06, 0.2
"""Whether points hide each other is told of so many of them: those in one pixel, this wide at their median range (or at
the last of these, if that is more), that lie so much behind the nearest. Lengths in model diagonals."""
LEAST_GAPPED = 0.03
"""Share of points behind a gap so deep in the depths of their pixel below which points at many depths are of surface
that is seen edge-on: a door in line with the sensor has 0.3 of its points behind others, and 0.01 behind gaps."""
FINE_DEPTH, FINE_NOISE = 3.0, 4.0
"""How far one point lies behind another that hides it in a pixel as fine as the points are dense: so many of its widths
(surface that is seen edge-on rises less), and so many standard deviations of the noise more."""
WIDEST_VIEW, OUT_OF_VIEW = float(np.radians(70.0)), 0.005
"""Angle from the middle of what a camera sees beyond which no more than this share of its points are: strays."""
LEAST_PIXEL = 1e-6
"""Where most points lie behind each other."""


def contradicting(scan: Scan, diagonal: float) -> float:
    """Return the share of points that contradict the one sensor origin of a scan, 0 where no more do than views have:
    others hide them from there."""
    hidden = seen_through(scan, diagonal)
    return hidden if hidden >= SEEN_THROUGH and not edge_on(scan, diagonal) else 0.0


def is_of_all_sides(scan: Scan, diagonal: float, noise: float, threads: int) -> bool:
    """Return whether a scan of a model alone cannot be a view from its sensor origin; `noise` in model diagonals."""
    return finely_seen_through(scan, diagonal, noise, threads) >= max(FINELY_SEEN_THROUGH, BY_NOISE * noise)


def seen_through(scan: Scan, diagonal: float) -> float:
    """Return the share of points that others hide from the scan's sensor origin, if all share one.

    At depth edges, where pixels see both sides or mix them, some always are.
    """
    origin = common_origin(scan, np.zeros(3), diagonal)
    if origin is None or scan.camera is not None:
        return 0.0
    ranges, directions = _rays(scan, origin, diagonal)
    return float(_hidden(ranges, _pixels(ranges, directions, HIDING_PIXEL), HIDING_DEPTH).mean())


def finely_seen_through(scan: Scan, diagonal: float, noise: float, threads: int) -> float:
    """Return the share of points that others hide from the one sensor origin of the scan, in pixels as fine as its
    points are dense; `noise` in model diagonals.

    Even slender parts hide their far sides: 0.09 and more where a scan is of all sides, 0.07 and less where it is of
    one; but half of the pixels of a whole room may mix what is near and far.
    """
    origin = common_origin(scan, np.zeros(3), diagonal)
    if origin is None:
        return 0.0
    ranges, directions = _rays(scan, origin, diagonal)
    seen = np.ascontiguousarray(directions * _middle_range(ranges), np.float32)
    width = max(median(sixth_neighbour(seen, threads)), LEAST_PIXEL)
    return float(_hidden(ranges, _pixels(ranges, directions, width), FINE_DEPTH * width + FINE_NOISE * noise).mean())


def edge_on(scan: Scan, diagonal: float) -> bool:
    """Return whether points that others hide from the sensor origin are of surface in line with it: in their pixels
    depth follows depth without a gap."""
    origin = common_origin(scan, np.zeros(3), diagonal)
    if origin is None:
        return False
    ranges, directions = _rays(scan, origin, diagonal)
    pixel = _pixels(ranges, directions, HIDING_PIXEL)
    order = np.lexsort((ranges, pixel))
    ranges, pixel = ranges[order], pixel[order]
    first = np.diff(pixel, prepend=-1) != 0
    gaps = np.cumsum((np.diff(ranges, prepend=0.0) > HIDING_DEPTH) & ~first)
    return float((gaps > gaps[first][pixel]).mean()) < LEAST_GAPPED


def _rays(scan: Scan, origin: Singles, diagonal: float) -> tuple[Array, Array]:
    """Return ranges (n,) and directions (n, 3) of a sample of the points, seen from the `origin` (in search units)."""
    rays = at_most(np.ascontiguousarray(scan.points / diagonal, np.float64), HIDING_SAMPLE) - origin
    ranges = np.sqrt(np.einsum("ij,ij->i", rays, rays))
    return ranges, rays / np.maximum(ranges, 1e-9)[:, None]


def _middle_range(ranges: Array) -> float:
    """Return the range at which pixels are as wide as they are said to be."""
    return max(median(ranges), LEAST_HIDING_RANGE)


def _pixels(ranges: Array, directions: Array, width: float) -> Ints:
    """Return the pixel (n,) of each direction, so wide (model diagonals) at the median range."""
    angle = width / _middle_range(ranges)
    return kernels.voxel_means(np.ascontiguousarray(directions / angle, np.float32), 1.0)[2]


def _hidden(ranges: Array, pixel: Ints, depth: float) -> Bools:
    """Return which points lie farther than this behind the nearest of their pixel."""
    nearest = np.full(pixel.max() + 1, np.inf)
    np.minimum.at(nearest, pixel, ranges)
    return np.asarray(ranges > nearest[pixel] + depth)


def is_view(scan: Scan) -> bool:
    """Return whether the scan has one sensor origin, and a camera there can see all points."""
    if scan.sensor_origin is None or scan.sensor_origin.ndim != 1:
        return False
    rays = scan.points - scan.sensor_origin
    rays /= np.maximum(np.linalg.norm(rays, axis=1, keepdims=True), 1e-9)
    middle = rays.mean(axis=0)
    cosines = rays @ middle / max(float(np.linalg.norm(middle)), 1e-9)
    return float((cosines < np.cos(WIDEST_VIEW)).mean()) < OUT_OF_VIEW
