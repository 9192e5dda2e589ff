"""Planes wider than the model: the floor, walls and tables that it stands among. Lengths in model diagonals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pwralign_kin import kernels
from pwralign_kin.arrays import Bools, Indices, Singles
from pwralign_kin.estimation.sensing.by_range import usual_at_range
from pwralign_kin.estimation.sensing.noise import noise_of
from pwralign_kin.estimation.sensing.normals import planes_across_lines
from pwralign_kin.estimation.sensing.observation import ObservationOptions
from pwralign_kin.estimation.sensing.scene_options import SceneOptions

DOMINANT_TRIALS = 300
"""Points and their normals that the dominant plane is looked for by."""
LEAST_ON_PLANE = 30
"""Points that a plane holds at least, ..."""
LEAST_LEFT = 0.02
"""... and share of the points drawn that are not on a plane yet, from which on another is looked for."""
SEEDED_ALONG, FITTED_ALONG, HELD_ALONG = 0.9, 0.85, 0.8
"""Cosine of the angle between the normals of a point and of the plane that it lies on: when one of its points stands
for the plane, when it is fitted, and when what it holds is taken for background, ..."""
LOOSE, CLOSE = 1.5, 0.7
"""... which it holds to so many times the tolerance, and whatever their normals within that share of it."""
LEAST_ON_PIECE = 20
"""Points that a piece of a plane holds at least."""
LESS_WIDE, LONG = 0.6, 3.0
"""A piece is wide too if it spreads this share of what it should, but lengthwise so many times that."""


def wide_plane(
    points: Singles, options: ObservationOptions, least_spread: float, threads: int
) -> tuple[Singles, Singles] | None:
    """Return centre and normal of the dominant plane, if it holds enough of the points and is wide enough.

    It is if their standard deviation is `least_spread` along both of its directions.
    """
    coarse, _, _ = kernels.voxel_means(points, 2 * options.voxel)
    normals = kernels.local_planes(coarse, 6 * options.voxel, threads)[0]
    x, y, z, offset, inliers = kernels.dominant_plane(coarse, normals, options.plane_tolerance, DOMINANT_TRIALS, 0)
    if inliers < options.plane_share * len(coarse):
        return None
    normal = np.array([x, y, z], np.float32)
    on_plane = coarse[np.abs(coarse @ normal - offset) < options.plane_tolerance]
    if len(on_plane) < 3:
        return None
    # A least-squares plane through the inliers of the minimal sample, which is only as good as one normal.
    centre = on_plane.mean(axis=0)
    _, singular, axes = np.linalg.svd(on_plane - centre, full_matrices=False)
    return (centre, axes[2]) if singular[1] / np.sqrt(len(on_plane)) >= least_spread else None


@dataclass(frozen=True)
class Cloud:
    """Points that planes are found among."""

    points: Singles
    """(n, 3)"""
    normals: Singles
    """(n, 3), of either sign."""
    areas: Singles
    """(n,) surface that each point stands for."""
    tolerances: Singles
    """(n,) how far from a plane each may lie and be of it."""
    across: float
    """How wide neighbourhoods are that hold points of several scan lines; 0 where points lie on none."""

    @classmethod
    def of(cls, points: Singles, areas: Singles, origin: Singles | None, options: SceneOptions, threads: int) -> Cloud:
        """Take points seen from an `origin`, if one is known; the farther the noisier they may be."""
        blur = noise_of(points, threads)
        normals, variances, widened = planes_across_lines(points, options.normal_radius, blur, threads)
        noise = usual_at_range(np.sqrt(np.maximum(variances[:, 0], 0)), points, origin, options)
        tolerances = np.clip(options.plane_noises * noise, options.plane_tolerance, options.plane_most)
        return cls(points, normals, areas, np.asarray(tolerances), widened)

    def off(self, plane: Plane) -> Singles:
        """Return how far each point is from a plane, (n,)."""
        return np.asarray(np.abs((self.points - plane.centre) @ plane.normal))

    def along(self, plane: Plane) -> Singles:
        """Return how much the surface at each point is turned as a plane is, (n,), 1 at most."""
        return np.asarray(np.abs(self.normals @ plane.normal))


@dataclass(frozen=True)
class Plane:
    """A plane through a point."""

    centre: Singles
    """(3,)"""
    normal: Singles
    """(3,)"""


@dataclass(frozen=True)
class Size:
    """How wide and how large a piece of a plane is at least."""

    spread: float
    """Standard deviation along its shorter axis."""
    area: float


def wide_planes(cloud: Cloud, least: Size, options: SceneOptions) -> Bools:
    """Return which points lie on pieces of planes of at `least` some size (RANSAC, by area)."""
    points, normals, count = cloud.points, cloud.normals, len(cloud.points)
    random = np.random.default_rng(0)
    # Drawn by area, samples near and far count by the surface that they stand for.
    sample = random.choice(count, min(options.plane_sample, count), p=cloud.areas / cloud.areas.sum())
    left, background = np.ones(count, bool), np.zeros(count, bool)
    for _ in range(options.planes):
        remaining = sample[left[sample]]
        if len(remaining) < LEAST_LEFT * len(sample):
            break
        seeds = random.choice(remaining, options.plane_trials)
        offset = np.einsum("ij,ij->i", points[seeds], normals[seeds])
        on = np.abs(points[remaining] @ normals[seeds].T - offset) < cloud.tolerances[remaining, None]
        on &= np.abs(normals[remaining] @ normals[seeds].T) > SEEDED_ALONG
        best = seeds[int(np.argmax(on.sum(axis=0)))]
        plane, inliers = _fitted(cloud, left, Plane(points[best], normals[best]))
        left[best] = False
        if len(inliers) < LEAST_ON_PLANE:
            continue
        left[inliers] = False
        background |= _wide_pieces(cloud, inliers, plane, least, options)
        left &= ~background
    return background


def _fitted(cloud: Cloud, left: Bools, plane: Plane) -> tuple[Plane, Indices]:
    """Fit a plane to those points that are `left` and lie on it; return it and them."""
    inliers = np.zeros(0, np.int64)
    for _ in range(3):
        inliers = np.flatnonzero(left & (cloud.off(plane) < cloud.tolerances) & (cloud.along(plane) > FITTED_ALONG))
        if len(inliers) < LEAST_ON_PLANE:
            break
        centre = cloud.points[inliers].mean(axis=0)
        scatter = (cloud.points[inliers] - centre).T @ (cloud.points[inliers] - centre)
        plane = Plane(centre, np.linalg.eigh(scatter)[1][:, 0].astype(np.float32))
    return plane, inliers


def _wide_pieces(cloud: Cloud, inliers: Indices, plane: Plane, least: Size, options: SceneOptions) -> Bools:
    """Return which points lie on the wide connected pieces of one plane, that the `inliers` (indices) show."""
    from scipy import ndimage

    axes = np.linalg.svd(plane.normal[None].astype(float))[2][1:]
    flat = (cloud.points - plane.centre) @ axes.T
    cell = max(options.plane_cell, cloud.across)
    low = flat[inliers].min(axis=0) - 1.5 * cell  # a cell to spare for what is covered beside them
    at = np.floor((flat - low) / cell).astype(np.int64)
    shape = at[inliers].max(axis=0) + 2
    footprint = np.zeros(shape, bool)
    footprint[tuple(at[inliers].T)] = True
    label, count = ndimage.label(footprint, np.ones((3, 3)))
    piece = label[tuple(at[inliers].T)]
    wide = np.zeros(count + 1, bool)
    for index in range(1, count + 1):
        own = inliers[piece == index]
        # Points on scan lines stand for more surface than their nearest neighbours show.
        area = (label == index).sum() * cell**2 if cloud.across else cloud.areas[own].sum()
        if len(own) < LEAST_ON_PIECE or area < least.area:
            continue
        spread = np.sqrt(np.linalg.eigvalsh(np.cov(flat[own].T)))
        wide[index] = spread[0] > least.spread or (
            spread[0] > LESS_WIDE * least.spread and spread[1] > LONG * least.spread
        )
    if not wide.any():
        return np.zeros(len(cloud.points), bool)
    covered = ndimage.binary_dilation(wide[label], np.ones((3, 3)))
    inside = ((at >= 0) & (at < shape)).all(axis=1)
    inside[inside] = covered[tuple(at[inside].T)]
    off = cloud.off(plane)
    along = (cloud.along(plane) > HELD_ALONG) | (off < CLOSE * cloud.tolerances)
    return np.asarray(inside & (off < LOOSE * cloud.tolerances) & along)
