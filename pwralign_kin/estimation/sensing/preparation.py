"""A scan made ready for the search: downsampled, cleaned of strays and tables, with oriented normals and its field."""

from __future__ import annotations

import numpy as np

from pwralign_kin import kernels
from pwralign_kin.arrays import Bools, Ints, Singles
from pwralign_kin.estimation.sensing.field import PreparedPoints, SeenSpace, field_of
from pwralign_kin.estimation.sensing.noise import noise_of
from pwralign_kin.estimation.sensing.normals import facing, normals_of, oriented_normals
from pwralign_kin.estimation.sensing.observation import LEAST_POINTS, NO_BORDERS, Observation, ObservationOptions
from pwralign_kin.estimation.sensing.planes import wide_plane
from pwralign_kin.estimation.sensing.points import at_most, median, sixth_neighbour
from pwralign_kin.estimation.sensing.viewpoints import common_origin, origins_of
from pwralign_kin.exceptions import ScanError
from pwralign_kin.scan import Scan, check_units
from pwralign_kin.se3 import Array

LINE_PIXEL = 0.72
"""Pixel of the depth image that leaves no space between scan lines empty, as a share of their distance."""
LEAST_BESIDE = 0.02
"""Share of the cells beside a wide plane below which a scan is of the plane alone, and the rest its noise."""
MOST_EXTENT = 1000.0
"""Model diagonals beyond which a scan is not looked at."""
MOST_CELLS = 1.5e8
"""Cells of the field that memory allows."""
BULK, BULK_SAMPLE = (0.03, 0.97), 20000
"""Quantiles of each coordinate between which the bulk of a scan lies, told by about so many of its points."""
PLANE_TOLERANCES, PLANE_NOISES = 1.2, 3.0
"""How far from a wide plane points are taken for its own: so many tolerances, or standard deviations of the noise."""
LEAST_NEIGHBOURED, LEAST_KEPT = 8, 50
"""Points from which strays are looked for, and that must be left without them."""


def observe(
    scan: Scan,
    diagonal: float,
    options: ObservationOptions,
    threads: int,
    turned: Bools | None = None,
    borders: Singles | None = None,
) -> Observation:
    """Prepare `scan` for a model of the given `diagonal` (m). Raises `ScanError` when too little is left.

    Without a sensor origin the normals of prepared points that are to be `turned` (m,) are those of their other side.
    Of what is beyond the `borders` (b, 3) of its picture a view tells nothing.
    """
    centre = np.array([coordinate.mean() for coordinate in scan.points.T])
    raw = np.ascontiguousarray((scan.points - centre) / diagonal, np.float32)
    points, cell = _cells(scan, raw, diagonal, options)
    origin = common_origin(scan, centre, diagonal)
    if options.remove_planes and origin is None:
        plane = wide_plane(raw, options, options.plane_spread, threads)
        if plane is not None:
            raw = _beside(raw, *plane, options, threads)
            points, cell = _cells_beside(scan, raw, len(points), options)
    points, spacing = _without_strays(points, options, threads)
    noise = noise_of(at_most(raw, options.most_raw), threads)
    normals, gap = normals_of(points, noise, spacing, options, threads)
    origins = origins_of(points, scan, centre, diagonal, threads)
    normals = oriented_normals(points, normals, origins, spacing, threads)
    if origin is not None:
        faced = facing(points, normals, origin, options)
        points, normals = np.ascontiguousarray(points[faced]), np.ascontiguousarray(normals[faced])
    elif turned is not None:
        normals = np.where(turned[:, None], -normals, normals)
    prepared = PreparedPoints.all_alike(points, normals)
    seen = SeenSpace(raw, origin, depth_pixel(gap, options), NO_BORDERS if borders is None else borders)
    field = field_of(prepared, seen, options, threads)
    given, given_normals = as_given(raw, cell, field, normals, options)
    return Observation(
        points=points,
        normals=normals,
        raw=at_most(raw, options.most_raw),
        given=given,
        given_normals=given_normals,
        weights=prepared.weights,
        areas=prepared.areas,
        regions=prepared.regions,
        scene=False,
        spacing=spacing,
        noise=noise,
        depth_pixel=seen.pixel,
        sensor_origin=origin,
        field=field,
        centre=centre,
        diagonal=diagonal,
        borders=seen.borders,
    )


def bulk(scan: Scan) -> tuple[Array, Array]:
    """Return the corners (3,) of the box, m, that most points of a scan lie in: strays do not widen it."""
    low, high = np.quantile(scan.points[:: max(1, len(scan.points) // BULK_SAMPLE)], BULK, axis=0)
    return low, high


def without_far_points(scan: Scan, reach: float) -> Scan:
    """Return a scan of the model without what is farther from its bulk than the model reaches (m).

    One point without depth, put where the sensor or the origin of the map is, would widen the scan beyond all bounds.
    """
    if (scan.extent <= reach).all():
        return scan
    low, high = bulk(scan)
    if ((scan.points >= low - reach) & (scan.points <= high + reach)).all():
        return scan
    return scan.cropped(low - reach, high + reach)


def depth_pixel(gap: float, options: ObservationOptions) -> float:
    """Return the pixel of the depth image of points on scan lines so far apart: each point covers those within one of
    it. Where points are sparse but on no lines, small pixels tell more."""
    return max(options.depth_pixel, LINE_PIXEL * gap)


def _cells(scan: Scan, raw: Singles, diagonal: float, options: ObservationOptions) -> tuple[Singles, Ints]:
    """Return the mean of each cell of the downsampling, and the cell of each point.

    Raises `ScanError` for a scan far smaller or far larger than the model (`UnitError` if it is in millimetres).
    """
    extent = scan.extent / diagonal
    means, cell = np.zeros((0, 3), np.float32), np.zeros(0, np.int32)
    if extent.max() < MOST_EXTENT:
        means, _, cell = kernels.voxel_means(raw, options.voxel)
    if 0 < len(means) < LEAST_POINTS:
        raise ScanError(
            scan.source,
            f"it fills only {len(means)} cells of {100 * options.voxel:g}% of the model, which is {diagonal:.3g} m "
            "across: is the scan of this model and at its scale?",
        )
    if len(means) == 0 or np.prod(extent / options.field_cell + 10) > MOST_CELLS:
        check_units(scan, diagonal)
        raise ScanError(
            scan.source,
            f"it spans {extent.max():.3g} times the model, which is {diagonal:.3g} m across: "
            "crop it to the surroundings of the model (Scan.cropped / --crop)",
        )
    return means, cell


def as_given(
    raw: Singles, cell: Ints, field: kernels.ScanField, normals: Singles, options: ObservationOptions
) -> tuple[Singles, Singles]:
    """Return raw points, few of each `cell`, with the `normals` of the prepared points that `field` finds near.

    Every bit of surface then counts alike, however near it was to the sensor. Strays and mixed pixels have no prepared
    point of their own cell or the next.
    """
    order = np.random.default_rng(0).permutation(len(raw)).astype(np.int32)
    given = raw[kernels.first_of_cells(cell, order, options.given_per_cell)]
    if len(given):
        given = given[kernels.along_curve(given)]  # neighbours next to each other are looked up together
    nearest = field.nearest(given, _nearby(options))
    near = nearest >= 0
    return np.ascontiguousarray(given[near]), np.ascontiguousarray(normals[nearest[near]])


def was_prepared(observation: Observation, points: Array, options: ObservationOptions) -> Bools:
    """Return which points (n, 3) of the scan (m) have a prepared point near: strays and a removed plane have none."""
    return np.asarray(observation.field.nearest(observation.scaled(points), _nearby(options)) >= 0)


def _nearby(options: ObservationOptions) -> float:
    """Return within what distance a prepared point is of a given one's cell or the next."""
    return 2 * options.voxel


def _beside(points: Singles, centre: Singles, normal: Singles, options: ObservationOptions, threads: int) -> Singles:
    """Return the points that are not of the plane with this centre (3,) and unit normal (3,), however noisy it is."""
    noise = noise_of(at_most(points, options.most_raw), threads)
    thickness = max(PLANE_TOLERANCES * options.plane_tolerance, PLANE_NOISES * noise)
    return np.ascontiguousarray(points[np.abs((points - centre) @ normal) > thickness])


def _cells_beside(scan: Scan, raw: Singles, whole: int, options: ObservationOptions) -> tuple[Singles, Ints]:
    """Return the `_cells` of what is left of a scan beside a wide plane; `whole` is how many they were with it.

    Raises `ScanError` for a scan of the plane alone.
    """
    points, _, cell = kernels.voxel_means(raw, options.voxel)
    if len(points) < max(LEAST_POINTS, LEAST_BESIDE * whole):
        few = f"{len(points)} of {whole} cells of {100 * options.voxel:g}% of the model"
        raise ScanError(scan.source, f"it is of a plane wider than the model, and beside that fills only {few}")
    return points, cell


def _without_strays(points: Singles, options: ObservationOptions, threads: int) -> tuple[Singles, float]:
    """Return the points that have neighbours, and the median distance to the sixth."""
    if len(points) < LEAST_NEIGHBOURED:
        return points, options.voxel
    sixth = sixth_neighbour(points, threads)
    kept = sixth < max(options.stray_distance, options.stray_spacings * median(sixth))
    if kept.sum() > LEAST_KEPT:
        points, sixth = points[kept], sixth[kept]
    return np.ascontiguousarray(points), median(sixth)
