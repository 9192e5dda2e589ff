"""A whole scene made ready for the search: the model is a small share of a room, on or among other things.

Wide planes (walls, floors, tables) are told from the rest and stay as known surroundings; what is left is split into
connected regions, each searched with its own share of hypotheses, so that a large bench cannot crowd out a small arm.
Only ranges at which the points lie close enough to show the model are searched. Lengths in model diagonals.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pwralign_kin import kernels
from pwralign_kin.arrays import Bools, Indices, Ints, Singles
from pwralign_kin.checked_options import Cell, CheckedOptions, Count, Natural, NotNegative, Positive, Share, Threshold
from pwralign_kin.estimation.sensing import observation as preparation
from pwralign_kin.estimation.sensing.observation import ONE_SIDE, Observation, ObservationOptions
from pwralign_kin.exceptions import ScanError
from pwralign_kin.model.surface import Surface, total_area
from pwralign_kin.scan import Scan, check_units
from pwralign_kin.se3 import Array

MOST_EXTENT = 200.0
"""Model diagonals beyond which a scene is not looked at."""
LARGEST_FIELD = 5e7
"""Cells of the field of a scene; larger scenes get larger cells."""
RAY_PIXEL, RAYS = 0.75, 2000
"""Least size of the pixels of a scene's depth image, as a share of the distance of a ray to the sixth next, told about
so many: between sparse rays there would be pixels that none came back from."""
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


@dataclass(frozen=True)
class SceneOptions(CheckedOptions):
    """How the model is found among other things. Lengths in model diagonals."""

    reaches: Threshold = 1.3
    """A scan wider than this many times the model's largest extent (strays aside) is a scene."""
    reaches_unseen: Threshold = 3.0
    """The same for scans without a sensor origin, which tell less of what is in the way of what."""
    plane_unlike: Threshold = 0.22
    """A scan with a sensor origin is a scene too if it holds a plane that spreads this far (standard deviation along
    its shorter axis): the largest square in a box of diagonal 1 has 0.2."""
    normal_radius: Cell = 0.045
    """Neighbourhood of the normals that planes are found by."""
    planes: Natural = 12
    plane_trials: Count = 200
    plane_sample: Count = 3000
    plane_tolerance: Positive = 0.012
    plane_noises: NotNegative = 2.5
    plane_most: NotNegative = 0.06
    """A point lies on a plane within the tolerance, or so many times the noise at its range, at most this far."""
    plane_cell: Cell = 0.04
    """Pieces of a plane farther apart than this are looked at one by one."""
    plane_wider: NotNegative = 1.5
    """A piece of a plane is background if it spreads so many times wider than any part of the model, ..."""
    plane_least: NotNegative = 0.09
    """... this far (standard deviation along its shorter axis) ..."""
    plane_area: NotNegative = 0.3
    """... and has more than this share of the largest part's area."""
    patch_wider: NotNegative = 1.25
    """A piece of a plane that an answer leaves unexplained is background if it is so many times larger and spreads so
    many times wider than any flat face of the model, ..."""
    patch_least: NotNegative = 0.05
    """... or than one that spreads this far."""
    range_bin: Cell = 0.25
    spacing: Positive = 0.026
    """Median distance to the sixth neighbour up to which a range is searched, if all these hold enough; ..."""
    spacing_more: Positive = 1.5
    """... else so many times that up to which they do: the model may be a little farther, ..."""
    spacing_most: Positive = 0.09
    """... but no more than this."""
    enough: NotNegative = 1.5
    """How many times the visible area of the model is enough."""
    link: Positive = 0.03
    link_spacings: NotNegative = 1.1
    """Points nearer than this, or so many of their usual distances to the sixth neighbour, belong to one region: fewer
    than 0.87 would leave even points of one surface apart."""
    region_area: NotNegative = 0.015
    region_points: Count = 25
    """Regions with less than this share of the visible area of the model, or fewer points, are fragments."""
    margin: NotNegative = 0.35
    """Fragments and surroundings this near to a region are kept."""
    plane_weight: Share = 0.35
    """How much a point of a background plane speaks for the model, ..."""
    other_weight: Share = 0.5
    """... and one of what else is not searched."""
    most_noise: NotNegative = 0.012
    unreturned: Share = 0.5
    """How far space counts as seen to be free where no ray of a sensor came back: dark, shiny and slanted surface sends
    none back, and out of the image there are none."""


@dataclass(frozen=True)
class SceneSetup:
    """The model that scenes are prepared for, and how."""

    surfaces: Sequence[Surface]
    diagonal: float
    """Of the model, m."""
    reach: float
    """What the model is never wider than, m."""
    preparing: ObservationOptions
    options: SceneOptions
    threads: int


def is_scene(scan: Scan, setup: SceneSetup) -> bool:
    """Return whether the scan is mostly of other things than the model."""
    options, diagonal = setup.options, setup.diagonal
    origin = preparation.common_origin(scan, np.zeros(3), diagonal)
    low, high = scan.box
    widest = (options.reaches_unseen if origin is None else options.reaches) * setup.reach
    if np.linalg.norm(high - low) > widest and np.linalg.norm(np.subtract(*preparation.bulk(scan))) > widest:
        return True
    if origin is None:
        return False
    points = np.ascontiguousarray((scan.points - low) / diagonal, np.float32)
    return preparation.wide_plane(points, setup.preparing, options.plane_unlike, setup.threads) is not None


def surroundings_of(scan: Scan, left: Bools, setup: SceneSetup) -> Bools:
    """Return which points of `scan` (n,), among those that an answer has `left` unexplained (n,), are of a plane wider
    than any flat face of the model: a patch of floor, table or wall, which a crop leaves about a model."""
    surfaces, diagonal, options, threads = setup.surfaces, setup.diagonal, setup.options, setup.threads
    found = np.zeros(len(left), bool)
    if left.sum() < options.region_points:
        return found
    low, _ = preparation.bulk(scan)
    raw = np.ascontiguousarray((scan.points[left] - low) / diagonal, np.float32)
    points, _, cell = kernels.voxel_means(raw, setup.preparing.voxel)
    if len(points) < options.region_points:
        return found
    origin = preparation.common_origin(scan, low, diagonal)
    cloud = _Cloud.of(points, _areas(preparation.sixth_neighbour(points, threads)), origin, options, threads)
    shorter = max(float(s.face_sizes[:, 1].max(initial=0.0)) for s in surfaces)
    largest = max(float(s.face_sizes.prod(axis=1).max(initial=0.0)) for s in surfaces)
    spread = options.patch_wider * max(shorter / np.sqrt(12), options.patch_least)
    found[left] = _wide_planes(cloud, _Size(spread, options.patch_wider * largest), options)[cell]
    return found


def observe_scene(
    scan: Scan, setup: SceneSetup, box: tuple[Array, Array], surroundings: Bools | None = None
) -> Observation:
    """Prepare a scene for the model, to be searched between the corners of `box` (m).

    Points that are known to be of the `surroundings` (n,) count as wide planes do. Raises `ScanError` where nothing can
    be searched.
    """
    diagonal, options, model_area = setup.diagonal, setup.options, total_area(setup.surfaces)
    if surroundings is None and scan.diagonal > MOST_EXTENT * diagonal:
        scan = preparation.without_far_points(scan, MOST_EXTENT / 8 * diagonal)
    if scan.diagonal > MOST_EXTENT * diagonal:
        check_units(scan, diagonal)
        raise ScanError(
            scan.source, f"it spans {scan.diagonal / diagonal:.3g} times the model, which is {diagonal:.3g} m across"
        )
    cells = _Cells.of(scan, diagonal, setup.preparing, setup.threads)
    planes = _background(cells, setup)
    if surroundings is not None:
        planes[cells.of_point[surroundings]] = True
    low, high = ((corner - cells.centre) / diagonal for corner in box)
    near = _near_enough(cells.points, cells.spacing, cells.areas, cells.origin, model_area, options)
    near &= ((cells.points >= low) & (cells.points <= high)).all(axis=1)
    region = _regions(cells.points, cells.spacing, near & ~planes, model_area, options)
    if (region < 0).all():
        where = "what is to be searched" if np.isfinite(box[0]).any() else "the scene"
        size = f"it is {scan.diagonal / diagonal:.3g} times as large as the model: is it at its scale?"
        raise ScanError(scan.source, f"nothing in {where} has points close enough together to show the model; {size}")
    return _observed(cells, region, planes, setup)


def close_up(
    scene: Observation, chosen: Bools, preparing: ObservationOptions, options: SceneOptions, threads: int
) -> Observation:
    """Return the `chosen` points (m,) of a scene as a scan of the model alone, of which the scene still tells hidden
    from free space."""
    points, normals = np.ascontiguousarray(scene.points[chosen]), np.ascontiguousarray(scene.normals[chosen])
    count = len(points)
    kept = _Kept(points, normals, np.ones(count, np.float32), np.ones(count, np.float32), np.zeros(count, np.int32))
    seen = _Seen(scene.raw, scene.sensor_origin, scene.depth_pixel)
    field = _field(kept, seen, preparing, options, threads)
    field = field.with_unreturned(scene.field.unreturned)
    nearest = scene.field.nearest(scene.given)
    mine = (nearest >= 0) & chosen[nearest]
    return replace(
        scene, points=points, normals=normals, given=scene.given[mine], given_normals=scene.given_normals[mine],
        weights=kept.weights, areas=kept.areas, regions=kept.regions, scene=False, cut_out=True, field=field,
        spacing=float(np.median(preparation.sixth_neighbour(points, threads))),
    )  # fmt: skip


@dataclass(frozen=True)
class _Cells:
    """A downsampled scene, in model diagonals about its centre."""

    scan: Scan
    centre: Array
    """(3,) in the scan frame, m."""
    diagonal: float
    """The unit of length, m."""
    origin: Singles | None
    """(3,) where the scene was seen from, else None."""
    raw: Singles
    """(n, 3) all points of the scan."""
    of_point: Ints
    """(n,) the cell that each of them lies in."""
    points: Singles
    """(c, 3) their means in each cell."""
    spacing: Singles
    """(c,) distance to the sixth neighbour."""
    areas: Singles
    """(c,) surface that each cell stands for."""

    @classmethod
    def of(cls, scan: Scan, diagonal: float, preparing: ObservationOptions, threads: int) -> _Cells:
        """Downsample a scan (m)."""
        centre = np.asarray(np.median(scan.points, axis=0))
        origin = preparation.common_origin(scan, centre, diagonal)
        raw = np.ascontiguousarray((scan.points - centre) / diagonal, np.float32)
        points, _, of_point = kernels.voxel_means(raw, preparing.voxel)
        spacing = preparation.sixth_neighbour(points, threads)
        return cls(scan, centre, diagonal, origin, raw, of_point, points, spacing, _areas(spacing))


def _background(cells: _Cells, setup: SceneSetup) -> Bools:
    """Return which cells lie on planes wider than any part of the model."""
    surfaces, options = setup.surfaces, setup.options
    spread = max(
        float(np.linalg.svd(s.samples - s.samples.mean(axis=0), compute_uv=False)[1]) / np.sqrt(len(s.samples))
        for s in surfaces
        if s.exists
    )
    least_area = options.plane_area * max(s.area for s in surfaces)
    least = _Size(max(options.plane_wider * spread, options.plane_least), least_area)
    cloud = _Cloud.of(cells.points, cells.areas, cells.origin, options, setup.threads)
    return _wide_planes(cloud, least, options)


def _observed(cells: _Cells, region: Indices, planes: Bools, setup: SceneSetup) -> Observation:
    """Give what is searched, by the `region` (c,) of each cell, and what lies near it their normals and their field."""
    preparing, options, threads = setup.preparing, setup.options, setup.threads
    kept = np.flatnonzero(_surroundings(cells.points, region >= 0, options.margin))
    # Of the cells that are kept, not of those that turn out to face away.
    spacing = float(np.median(cells.spacing[kept][region[kept] >= 0]))
    noise = min(preparation.noise_of(cells.raw[(region >= 0)[cells.of_point]], threads), options.most_noise)
    points = np.ascontiguousarray(cells.points[kept])
    normals, gap = preparation.normals_of(points, noise, spacing, preparing, threads)
    origins = preparation.origins_of(points, cells.scan, cells.centre, cells.diagonal, threads)
    normals = preparation.oriented_normals(points, normals, origins, spacing, threads)
    if cells.origin is not None:
        faced = preparation.facing(points, normals, cells.origin, preparing) | (region[kept] < 0)
        kept, points, normals = kept[faced], np.ascontiguousarray(points[faced]), np.ascontiguousarray(normals[faced])
    regions, areas = region[kept].astype(np.int32), cells.areas[kept]
    other = np.where(planes[kept], options.plane_weight, options.other_weight)
    weights = np.where(regions >= 0, 1.0, other).astype(np.float32)
    pixel = preparation.depth_pixel(gap, preparing)
    if cells.origin is not None:
        pixel = max(pixel, _ray_pixel(cells.raw, points[regions >= 0], cells.origin, threads))
    seen = _Seen(cells.raw, cells.origin, pixel)
    field = _field(_Kept(points, normals, weights, areas, regions), seen, preparing, options, threads)
    of_model = np.zeros(len(cells.points), bool)
    of_model[kept[~planes[kept]]] = True
    mine = of_model[cells.of_point]
    given, given_normals = preparation.as_given(cells.raw[mine], cells.of_point[mine], field, normals, preparing)
    return Observation(
        points=points,
        normals=normals,
        raw=preparation.at_most(cells.raw, preparing.most_raw),
        given=given,
        given_normals=given_normals,
        weights=weights,
        areas=areas,
        regions=regions,
        scene=True,
        spacing=spacing,
        noise=noise,
        depth_pixel=pixel,
        sensor_origin=cells.origin,
        field=field,
        centre=cells.centre,
        diagonal=cells.diagonal,
    )


@dataclass(frozen=True)
class _Kept:
    """The points of a scene that are kept, as `Observation` holds them."""

    points: Singles
    normals: Singles
    weights: Singles
    areas: Singles
    regions: Ints


@dataclass(frozen=True)
class _Seen:
    """All that was seen of a scene: it tells free from hidden space."""

    points: Singles
    """(n, 3)"""
    origin: Singles | None
    """(3,) where from, else None."""
    pixel: float
    """`Observation.depth_pixel`"""


def _field(
    kept: _Kept, seen: _Seen, preparing: ObservationOptions, options: SceneOptions, threads: int
) -> kernels.ScanField:
    """Return the field of the points that are kept, in what was seen."""
    cell, pixel = preparing.field_cell, seen.pixel
    while np.prod(np.ptp(kept.points, axis=0) / cell + 80) > LARGEST_FIELD:
        cell *= 1.2
    if seen.origin is not None:
        # The pixels of the depth image are stated at the mean range of all points, but matter where the search is.
        searched = float(np.median(np.linalg.norm(kept.points[kept.regions >= 0] - seen.origin, axis=1)))
        pixel *= float(np.linalg.norm(seen.points.mean(axis=0) - seen.origin)) / searched
    return kernels.ScanField(
        points=kept.points,
        normals=kept.normals,
        weights=kept.weights,
        areas=kept.areas,
        regions=kept.regions,
        cell=cell,
        truncation=preparing.field_truncation,
        sensor_origin=[] if seen.origin is None else [float(v) for v in seen.origin],
        depth_points=seen.points if seen.origin is not None else np.zeros((0, 3), np.float32),
        borders=preparation.NO_BORDERS,
        pixel=pixel,
        tolerance=preparing.depth_tolerance,
        shadow=preparing.shadow,
        unreturned=options.unreturned,
        threads=threads,
    )


def _ray_pixel(seen: Singles, searched: Singles, origin: Singles, threads: int) -> float:
    """Return the least pixel of a depth image of all points `seen` (n, 3), at the median range of those `searched`."""
    rays, ranges = _rays(searched[:: max(1, len(searched) // RAYS)], origin)
    middle = preparation.median(ranges)
    sixth = kernels.nearest_neighbours(_rays(seen, origin)[0] * middle, rays * middle, 7, threads)[0][:, -1]
    return RAY_PIXEL * preparation.median(sixth)


def _rays(points: Singles, origin: Singles) -> tuple[Singles, Singles]:
    """Return directions (n, 3) and ranges (n,) of points seen from an origin."""
    away = points - origin
    ranges = np.maximum(np.linalg.norm(away, axis=1), 1e-9).astype(np.float32)
    return np.ascontiguousarray(away / ranges[:, None], np.float32), ranges


def _areas(spacing: Singles) -> Singles:
    """Return the surface that each point stands for, by its distance to its sixth neighbour."""
    return np.asarray(np.pi * np.minimum(spacing, 0.1) ** 2 / 7, np.float32)


def _range_bins(points: Singles, origin: Singles | None, options: SceneOptions) -> Indices:
    """Return the bin of each point: by range, or without a sensor origin by place."""
    if origin is None:
        return np.asarray(kernels.voxel_means(points, 2 * options.range_bin)[2], np.int64)
    distance = np.linalg.norm(points - origin, axis=1)
    return np.asarray(np.minimum(distance / options.range_bin, 400), np.int64)


def _binned_median(values: Singles, bins: Indices) -> Singles:
    """Return for each point the median of its bin."""
    order = np.lexsort((values, bins))
    first = np.flatnonzero(np.diff(bins[order], prepend=-1))
    counts = np.diff(np.append(first, len(order)))
    medians = np.zeros(int(bins.max()) + 1, np.float32)
    medians[bins[order][first]] = values[order][first + counts // 2]
    return np.asarray(medians[bins])


def _near_enough(
    points: Singles, spacing: Singles, area: Singles, origin: Singles | None, model_area: float, options: SceneOptions
) -> Bools:
    """Return which points lie close enough together to show the model."""
    usual = _binned_median(spacing, _range_bins(points, origin, options))
    order = np.argsort(usual, kind="stable")
    enough = np.searchsorted(np.cumsum(area[order], dtype=float), options.enough * ONE_SIDE * model_area)
    holding = float(usual[order[min(int(enough), len(order) - 1)]])
    sparse = min(options.spacing_more * holding, options.spacing_most)
    limit = options.spacing if holding < options.spacing else sparse
    return np.asarray((usual < limit) & (spacing < max(1.6 * limit, 0.03)))


@dataclass(frozen=True)
class _Cloud:
    """Points that planes are found among."""

    points: Singles
    """(n, 3)"""
    normals: Singles
    """(n, 3), of either sign."""
    areas: Singles
    """(n,) surface that each point stands for."""
    tolerances: Singles
    """(n,) how far from a plane each may lie and be of it."""

    @classmethod
    def of(cls, points: Singles, areas: Singles, origin: Singles | None, options: SceneOptions, threads: int) -> _Cloud:
        """Take points seen from an `origin`, if one is known; the farther the noisier they may be."""
        normals, _, variances, _ = kernels.local_planes(points, options.normal_radius, threads)
        noise = _binned_median(np.sqrt(np.maximum(variances[:, 0], 0)), _range_bins(points, origin, options))
        tolerances = np.clip(options.plane_noises * noise, options.plane_tolerance, options.plane_most)
        return cls(points, normals, areas, np.asarray(tolerances))

    def off(self, plane: _Plane) -> Singles:
        """Return how far each point is from a plane, (n,)."""
        return np.asarray(np.abs((self.points - plane.centre) @ plane.normal))

    def along(self, plane: _Plane) -> Singles:
        """Return how much the surface at each point is turned as a plane is, (n,), 1 at most."""
        return np.asarray(np.abs(self.normals @ plane.normal))


@dataclass(frozen=True)
class _Plane:
    """A plane through a point."""

    centre: Singles
    """(3,)"""
    normal: Singles
    """(3,)"""


@dataclass(frozen=True)
class _Size:
    """How wide and how large a piece of a plane is at least."""

    spread: float
    """Standard deviation along its shorter axis."""
    area: float


def _wide_planes(cloud: _Cloud, least: _Size, options: SceneOptions) -> Bools:
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
        plane, inliers = _fitted(cloud, left, _Plane(points[best], normals[best]))
        left[best] = False
        if len(inliers) < LEAST_ON_PLANE:
            continue
        left[inliers] = False
        background |= _wide_pieces(cloud, inliers, plane, least, options)
        left &= ~background
    return background


def _fitted(cloud: _Cloud, left: Bools, plane: _Plane) -> tuple[_Plane, Indices]:
    """Fit a plane to those points that are `left` and lie on it; return it and them."""
    inliers = np.zeros(0, np.int64)
    for _ in range(3):
        inliers = np.flatnonzero(left & (cloud.off(plane) < cloud.tolerances) & (cloud.along(plane) > FITTED_ALONG))
        if len(inliers) < LEAST_ON_PLANE:
            break
        centre = cloud.points[inliers].mean(axis=0)
        scatter = (cloud.points[inliers] - centre).T @ (cloud.points[inliers] - centre)
        plane = _Plane(centre, np.linalg.eigh(scatter)[1][:, 0].astype(np.float32))
    return plane, inliers


def _wide_pieces(cloud: _Cloud, inliers: Indices, plane: _Plane, least: _Size, options: SceneOptions) -> Bools:
    """Return which points lie on the wide connected pieces of one plane, that the `inliers` (indices) show."""
    from scipy import ndimage

    axes = np.linalg.svd(plane.normal[None].astype(float))[2][1:]
    flat = (cloud.points - plane.centre) @ axes.T
    low = flat[inliers].min(axis=0) - 1.5 * options.plane_cell  # a cell to spare for what is covered beside them
    at = np.floor((flat - low) / options.plane_cell).astype(np.int64)
    shape = at[inliers].max(axis=0) + 2
    footprint = np.zeros(shape, bool)
    footprint[tuple(at[inliers].T)] = True
    label, count = ndimage.label(footprint, np.ones((3, 3)))
    piece = label[tuple(at[inliers].T)]
    wide = np.zeros(count + 1, bool)
    for index in range(1, count + 1):
        own = inliers[piece == index]
        if len(own) < LEAST_ON_PIECE or cloud.areas[own].sum() < least.area:
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


def _regions(points: Singles, spacing: Singles, searched: Bools, model_area: float, options: SceneOptions) -> Indices:
    """Return the connected region of each point, largest first; -1 for what is not searched.

    Fragments too small to be searched on their own belong to the region that they are near to: bits of thin parts.
    """
    from scipy.spatial import cKDTree

    region = np.full(len(points), -1, np.int64)
    chosen = np.flatnonzero(searched)
    if len(chosen) == 0:
        return region
    link = max(options.link, options.link_spacings * float(np.median(spacing[chosen])))
    label = kernels.components(np.ascontiguousarray(points[chosen]), link)
    areas = np.bincount(label, weights=_areas(spacing[chosen]))
    large = (areas > options.region_area * ONE_SIDE * model_area) & (np.bincount(label) > options.region_points)
    rank = np.full(len(areas), -1, np.int64)
    order = np.argsort(-areas, kind="stable")
    order = order[large[order]]
    rank[order] = np.arange(len(order))
    region[chosen] = rank[label]
    if not large.any():
        return region
    fragments, others = chosen[~large[label]], chosen[large[label]]
    distance, nearest = cKDTree(points[others]).query(points[fragments], distance_upper_bound=options.margin)
    near = np.isfinite(distance)
    region[fragments[near]] = region[others[nearest[near]]]
    return region


def _surroundings(points: Singles, searched: Bools, margin: float) -> Bools:
    """Return what is searched and what lies near it."""
    from scipy.spatial import cKDTree

    kept = searched.copy()
    others = np.flatnonzero(~searched)
    low, high = points[searched].min(axis=0) - margin, points[searched].max(axis=0) + margin
    others = others[((points[others] > low) & (points[others] < high)).all(axis=1)]
    coarse = kernels.voxel_means(np.ascontiguousarray(points[searched]), margin / 4)[0]
    kept[others] = np.isfinite(cKDTree(coarse).query(points[others], distance_upper_bound=margin)[0])
    return kept
