"""Where the picture of a depth camera ends: what lies beyond was not looked at, so nothing tells that it is free.

A depth image tells its own borders. Of points from one place they are found, where all pixels of an image are given: a
row of them that ends what was seen, whose depths are those of no straight edge of a thing.
"""

from __future__ import annotations

import numpy as np

from pwralign_kin import kernels
from pwralign_kin.arrays import Singles
from pwralign_kin.estimation.sensing.observation import NO_BORDERS, Observation
from pwralign_kin.scan import Scan
from pwralign_kin.scan.pinhole import DepthCamera
from pwralign_kin.se3 import Array, axes_across

TOUCHED = 1.5
"""Pixels from the border of a depth image within which a point is at it."""
SAMPLE = 500
"""Points about which the width of a pixel is measured, by the third neighbour."""
WIDEST = float(np.cos(np.radians(70.0)))
"""Cosine of the angle from the middle within which all points of a picture are."""
LONGEST = 12
"""Edges of the convex outline that are looked at, the longest first."""
BIN = 3.0
"""Pixels of a border that one point shows to be reached, ..."""
LEAST_BINS, LEAST_LENGTH = 10, 0.06
"""... how many such pieces of it must be, and how long (model diagonals) all of them together."""
ROW = 0.8
"""Points within half a pixel of a border, over the pixels of it that they reach: one row, or column, of the image lies
along it, and crosses other edges."""
LEAST_SPREAD, SPREAD_NOISES = 0.01, 4.0
"""Median distance of its points from a straight line in their own plane (model diagonals, and times the noise) that
tells a border from a straight edge of a thing."""
ROUNDS, AROUND = 3, 4.0
"""How often a line is drawn anew through the points on it, of those within so many pixels of the first."""


def borders_of(scan: Scan, observation: Observation, threads: int) -> Singles:
    """Return the outward unit normals (b, 3) of the planes through the sensor at which the picture of a view ends and
    cuts what was seen."""
    assert observation.sensor_origin is not None
    rays = observation.raw.astype(float) - observation.sensor_origin.astype(float)
    if scan.camera is not None:
        return _touched_borders(scan.camera, rays)
    middle = rays.mean(axis=0)
    middle /= max(float(np.linalg.norm(middle)), 1e-9)
    depth = rays @ middle
    if len(rays) < LEAST_BINS or (depth <= WIDEST * np.linalg.norm(rays, axis=1)).any():
        return NO_BORDERS
    axes = axes_across(middle)
    image = rays @ axes.T / depth[:, None]
    pixel = _pixel(image, threads)
    scale = float(np.median(depth))
    found: list[Array] = []
    for normal, offset in _edges(image, pixel):
        on_border = image @ normal > offset - 0.5 * pixel
        along = image[on_border] @ np.array([-normal[1], normal[0]])
        bins = len(np.unique(np.floor(along / (BIN * pixel))))
        if bins < LEAST_BINS or bins * BIN * pixel * scale < LEAST_LENGTH or len(along) < ROW * BIN * bins:
            continue
        if _off_line(along, depth[on_border]) < max(LEAST_SPREAD, SPREAD_NOISES * observation.noise):
            continue
        plane = normal @ axes - (offset + 0.5 * pixel) * middle
        found.append(plane / np.linalg.norm(plane))
    return np.array(found, np.float32).reshape(-1, 3)


def _touched_borders(camera: DepthCamera, rays: Array) -> Singles:
    (fx, skew, cx), (_, fy, cy), _ = camera.intrinsics
    left, right, top, bottom = -0.5, camera.width - 0.5, -0.5, camera.height - 0.5
    normals = np.array(
        [
            [-fx, -skew, left - cx],
            [fx, skew, cx - right],
            [0.0, -fy, top - cy],
            [0.0, fy, cy - bottom],
        ]
    )
    normals = normals @ camera.T_scan_camera[:3, :3].T
    pixels = rays @ normals.T / (rays @ camera.T_scan_camera[:3, 2])[:, None]
    touched = (pixels > -TOUCHED).sum(axis=0) >= BIN * LEAST_BINS
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return np.ascontiguousarray(normals[touched], np.float32)


def _pixel(image: Array, threads: int) -> float:
    """Return how far apart pixels are, if the points in the image (n, 2) are pixels or a random sample of them."""
    flat = np.ascontiguousarray(np.pad(image, ((0, 0), (0, 1))), np.float32)
    chosen = np.ascontiguousarray(flat[:: max(1, len(flat) // SAMPLE)])
    return max(float(np.median(kernels.nearest_neighbours(flat, chosen, 4, threads)[0][:, -1])), 1e-6)


def _edges(image: Array, pixel: float) -> list[tuple[Array, float]]:
    """Return lines along the longest edges of the convex outline of points (n, 2), no two alike: unit normals (2,), out
    of the outline, and offsets along them."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        outline = image[ConvexHull(image).vertices]
    except QhullError:  # all on one line
        return []
    sides = np.roll(outline, -1, axis=0) - outline
    lengths = np.linalg.norm(sides, axis=1)
    lines: list[tuple[Array, float]] = []
    for index in np.argsort(-lengths)[:LONGEST]:
        if lengths[index] < LEAST_BINS * pixel:
            break
        normal = np.array([sides[index, 1], -sides[index, 0]]) / max(lengths[index], 1e-12)
        heights = image @ normal
        beside = image[heights > heights.max() - AROUND * pixel]
        for _ in range(ROUNDS):
            heights = beside @ normal
            near = beside[heights > heights.max() - 1.5 * pixel]
            drawn = np.linalg.svd(near - near.mean(axis=0), full_matrices=False)[2][1]
            normal = drawn if drawn @ normal > 0 else -drawn
        if all(normal @ other < np.cos(np.radians(2.0)) for other, _ in lines):
            lines.append((normal, float((image @ normal).max())))
    return lines


def _off_line(along: Array, depth: Array) -> float:
    """Return how far (median, in units of the depth) points of one plane through the sensor lie off a straight line.

    The inverse depth along the image of a line is linear. The line is Theil's and Sen's: mixed pixels do not bend it.
    """
    inverse = 1.0 / depth
    order = np.argsort(along, kind="stable")
    half = len(order) // 2
    first, second = order[:half], order[len(order) - half :]
    slopes = (inverse[second] - inverse[first]) / np.maximum(along[second] - along[first], 1e-9)
    rest = inverse - float(np.median(slopes)) * along
    off = np.abs(rest - np.median(rest))
    return float(np.median(off)) * float(np.median(depth)) ** 2
