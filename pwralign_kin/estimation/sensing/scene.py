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
from pwralign_kin.estimation.sensing.field import PreparedPoints, SeenSpace, field_of
from pwralign_kin.estimation.sensing.noise import noise_of
from pwralign_kin.estimation.sensing.normals import facing, normals_of, oriented_normals
from pwralign_kin.estimation.sensing.observation import Observation, ObservationOptions
from pwralign_kin.estimation.sensing.planes import Cloud, Size, wide_plane, wide_planes
from pwralign_kin.estimation.sensing.points import at_most, median, sixth_neighbour
from pwralign_kin.estimation.sensing.preparation import as_given, bulk, depth_pixel, without_far_points
from pwralign_kin.estimation.sensing.regions import areas_of, near_enough, regions_of, with_surroundings
from pwralign_kin.estimation.sensing.scene_options import SceneOptions
from pwralign_kin.estimation.sensing.viewpoints import common_origin, origins_of
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
    origin = common_origin(scan, np.zeros(3), diagonal)
    low, high = scan.box
    widest = (options.reaches_unseen if origin is None else options.reaches) * setup.reach
    if np.linalg.norm(high - low) > widest and np.linalg.norm(np.subtract(*bulk(scan))) > widest:
        return True
    if origin is None:
        return False
    near = without_far_points(scan, setup.reach)
    points = np.ascontiguousarray((near.points - near.box[0]) / diagonal, np.float32)
    return wide_plane(points, setup.preparing, options.plane_unlike, setup.threads) is not None


def surroundings_of(scan: Scan, left: Bools, setup: SceneSetup) -> Bools:
    """Return which points of `scan` (n,), among those that an answer has `left` unexplained (n,), are of a plane wider
    than any flat face of the model: a patch of floor, table or wall, which a crop leaves about a model."""
    found = np.zeros(len(left), bool)
    if not left.any():
        return found
    low, _ = bulk(scan)
    raw = np.ascontiguousarray((scan.points[left] - low) / setup.diagonal, np.float32)
    points, _, cell = kernels.voxel_means(raw, setup.preparing.voxel)
    found[left] = wide_patches(points, common_origin(scan, low, setup.diagonal), setup)[cell]
    return found


def wide_patches(points: Singles, origin: Singles | None, setup: SceneSetup) -> Bools:
    """Return which downsampled `points` (n, 3), seen from an `origin` if one is known, are of a plane wider than any
    flat face of the model."""
    surfaces, options, threads = setup.surfaces, setup.options, setup.threads
    if len(points) < options.region_points:
        return np.zeros(len(points), bool)
    cloud = Cloud.of(points, areas_of(sixth_neighbour(points, threads)), origin, options, threads)
    shorter = max(float(s.face_sizes[:, 1].max(initial=0.0)) for s in surfaces)
    largest = max(float(s.face_sizes.prod(axis=1).max(initial=0.0)) for s in surfaces)
    spread = options.patch_wider * max(shorter / np.sqrt(12), options.patch_least)
    return wide_planes(cloud, Size(spread, options.patch_wider * largest), options)


def observe_scene(
    scan: Scan, setup: SceneSetup, box: tuple[Array, Array], surroundings: Bools | None = None
) -> Observation:
    """Prepare a scene for the model, to be searched between the corners of `box` (m).

    Points that are known to be of the `surroundings` (n,) count as wide planes do. Raises `ScanError` where nothing can
    be searched (`UnitError` where that may be for the scan's unit).
    """
    diagonal, options, model_area = setup.diagonal, setup.options, total_area(setup.surfaces)
    if surroundings is None and scan.diagonal > MOST_EXTENT * diagonal:
        scan = without_far_points(scan, MOST_EXTENT / 8 * diagonal)
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
    near = near_enough(cells.points, cells.spacing, cells.areas, cells.origin, model_area, options)
    near &= ((cells.points >= low) & (cells.points <= high)).all(axis=1)
    region = regions_of(cells.points, cells.spacing, near & ~planes, model_area, options)
    if (region < 0).all():
        check_units(scan, diagonal)
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
    kept = PreparedPoints.all_alike(points, normals)
    seen = SeenSpace(scene.raw, scene.sensor_origin, scene.depth_pixel)
    field = _field(kept, seen, preparing, options, threads)
    nearest = scene.field.nearest(scene.given)
    mine = (nearest >= 0) & chosen[nearest]
    return replace(
        scene, points=points, normals=normals, given=scene.given[mine], given_normals=scene.given_normals[mine],
        weights=kept.weights, areas=kept.areas, regions=kept.regions, scene=False, cut_out=True, field=field,
        spacing=float(np.median(sixth_neighbour(points, threads))),
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
        origin = common_origin(scan, centre, diagonal)
        raw = np.ascontiguousarray((scan.points - centre) / diagonal, np.float32)
        points, _, of_point = kernels.voxel_means(raw, preparing.voxel)
        spacing = sixth_neighbour(points, threads)
        return cls(scan, centre, diagonal, origin, raw, of_point, points, spacing, areas_of(spacing))


def _background(cells: _Cells, setup: SceneSetup) -> Bools:
    """Return which cells lie on planes wider than any part of the model."""
    surfaces, options = setup.surfaces, setup.options
    spread = max(
        float(np.linalg.svd(s.samples - s.samples.mean(axis=0), compute_uv=False)[1]) / np.sqrt(len(s.samples))
        for s in surfaces
        if s.exists
    )
    least_area = options.plane_area * max(s.area for s in surfaces)
    least = Size(max(options.plane_wider * spread, options.plane_least), least_area)
    cloud = Cloud.of(cells.points, cells.areas, cells.origin, options, setup.threads)
    return wide_planes(cloud, least, options)


def _observed(cells: _Cells, region: Indices, planes: Bools, setup: SceneSetup) -> Observation:
    """Give what is searched, by the `region` (c,) of each cell, and what lies near it their normals and their field."""
    preparing, options, threads = setup.preparing, setup.options, setup.threads
    kept = np.flatnonzero(with_surroundings(cells.points, region >= 0, options.margin))
    # Of the cells that are kept, not of those that turn out to face away.
    spacing = float(np.median(cells.spacing[kept][region[kept] >= 0]))
    noise = min(noise_of(cells.raw[(region >= 0)[cells.of_point]], threads), options.most_noise)
    points = np.ascontiguousarray(cells.points[kept])
    normals, gap = normals_of(points, noise, spacing, preparing, threads)
    origins = origins_of(points, cells.scan, cells.centre, cells.diagonal, threads)
    normals = oriented_normals(points, normals, origins, spacing, threads)
    if cells.origin is not None:
        faced = facing(points, normals, cells.origin, preparing) | (region[kept] < 0)
        kept, points, normals = kept[faced], np.ascontiguousarray(points[faced]), np.ascontiguousarray(normals[faced])
    regions, areas = region[kept].astype(np.int32), cells.areas[kept]
    other = np.where(planes[kept], options.plane_weight, options.other_weight)
    weights = np.where(regions >= 0, 1.0, other).astype(np.float32)
    pixel = depth_pixel(gap, preparing)
    if cells.origin is not None:
        pixel = max(pixel, _ray_pixel(cells.raw, points[regions >= 0], cells.origin, threads))
    seen = SeenSpace(cells.raw, cells.origin, pixel)
    field = _field(PreparedPoints(points, normals, weights, areas, regions), seen, preparing, options, threads)
    of_model = np.zeros(len(cells.points), bool)
    of_model[kept[~planes[kept]]] = True
    mine = of_model[cells.of_point]
    given, given_normals = as_given(cells.raw[mine], cells.of_point[mine], field, normals, preparing)
    return Observation(
        points=points,
        normals=normals,
        raw=at_most(cells.raw, preparing.most_raw),
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


def _field(
    kept: PreparedPoints, seen: SeenSpace, preparing: ObservationOptions, options: SceneOptions, threads: int
) -> kernels.ScanField:
    """Return the field of the points that are kept, in what was seen."""
    cell, pixel = preparing.field_cell, seen.pixel
    while np.prod(np.ptp(kept.points, axis=0) / cell + 80) > LARGEST_FIELD:
        cell *= 1.2
    if seen.origin is not None:
        # The pixels of the depth image are stated at the mean range of all points, but matter where the search is.
        searched = float(np.median(np.linalg.norm(kept.points[kept.regions >= 0] - seen.origin, axis=1)))
        pixel *= float(np.linalg.norm(seen.points.mean(axis=0) - seen.origin)) / searched
    where_searched = replace(seen, pixel=pixel)
    return field_of(kept, where_searched, preparing, threads, cell=cell, unreturned=options.unreturned)


def _ray_pixel(seen: Singles, searched: Singles, origin: Singles, threads: int) -> float:
    """Return the least pixel of a depth image of all points `seen` (n, 3), at the median range of those `searched`."""
    rays, ranges = _rays(searched[:: max(1, len(searched) // RAYS)], origin)
    middle = median(ranges)
    sixth = kernels.nearest_neighbours(_rays(seen, origin)[0] * middle, rays * middle, 7, threads)[0][:, -1]
    return RAY_PIXEL * median(sixth)


def _rays(points: Singles, origin: Singles) -> tuple[Singles, Singles]:
    """Return directions (n, 3) and ranges (n,) of points seen from an origin."""
    away = points - origin
    ranges = np.maximum(np.linalg.norm(away, axis=1), 1e-9).astype(np.float32)
    return np.ascontiguousarray(away / ranges[:, None], np.float32), ranges
