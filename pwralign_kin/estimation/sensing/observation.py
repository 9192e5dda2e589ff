"""A scan made ready for the search: downsampled, cleaned of strays and tables, with oriented normals and its field.

Lengths are in units of the model's diagonal, about the centre of the scan, in which all scales of the search are
stated. `Observation.to_scan` and `to_search` convert placements.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pwralign_kin import kernels
from pwralign_kin.arrays import Bools, Indices, Ints, Singles
from pwralign_kin.checked_options import Cell, CheckedOptions, Count, NotNegative, Positive, Share
from pwralign_kin.exceptions import ScanError
from pwralign_kin.scan import Scan, check_units
from pwralign_kin.se3 import Array

NO_BORDERS: Singles = np.zeros((0, 3), np.float32)

NEIGHBOURHOODS = 1000
"""Points about which noise is measured."""
NEIGHBOURS = np.array([6, 7, 8, 10, 12])
"""Counts of neighbours that it is measured with; twice as many where the fewest lie in a blob, ..."""
FLAT = 1.9
"""... not this much wider (rms) than thick, and then half of the points, ..."""
FEWEST = 2000
"""... down to this many: noise that hides the surface from the nearest neighbours reaches further than they do."""
SLENDER, FLAT_LINE = 0.3, 0.1
"""The nearest neighbours lie on a scan line if they spread so little across it, against along it, and so little across
a plane through it, against across the line (variances)."""
ON_LINE, LINE_POINTS = 0.12, 4
"""A neighbourhood of at least so many points is of one scan line if, noise aside, its variance across the line is less
than this share of that along it."""
LINES = 0.25
"""Share of neighbourhoods of one scan line from which all are widened until they hold several, ..."""
WIDER, WIDENINGS = 1.5, 5
"""... each time by so much, so often at most."""
LINE_PIXEL = 0.72
"""Pixel of the depth image that leaves no space between scan lines empty, as a share of their distance."""
LEAST_FACING = 0.5
"""Share of points that face the sensor below which their normals are not to be trusted."""
LEAST_POINTS = 20
"""Occupied cells of the downsampling below which a scan cannot be of the model."""
LEAST_BESIDE = 0.02
"""Share of the cells beside a wide plane below which a scan is of the plane alone, and the rest its noise."""
MOST_EXTENT = 1000.0
"""Model diagonals beyond which a scan is not looked at."""
MOST_CELLS = 1.5e8
"""Cells of the field that memory allows."""


ONE_SIDE, ALL_SIDES = 0.42, 0.85
"""Share of a model's visible surface that one view, and views from all around, usually show."""


@dataclass(frozen=True)
class ObservationOptions(CheckedOptions):
    """How a scan is prepared. Lengths in model diagonals."""

    most_raw: Count = 60000
    """Points that are kept undownsampled, for the outline and to tell the noise by."""
    given_per_cell: Count = 2
    """Points of each cell of the downsampling that are kept as given, for the joint least squares."""
    voxel: Cell = 0.01
    """Cell of the downsampling."""
    normal_radius: Positive = 0.012
    """Neighbourhood of a normal without noise; `normal_noises` times the noise is added, ..."""
    normal_noises: NotNegative = 4.0
    neighbour_spacings: NotNegative = 1.6
    """... and it is widened to this many point spacings where the scan is sparse."""
    grazing: Share = 0.05
    """Cosine between ray and normal below which a sensor does not measure the surface that is there."""
    stray_distance: NotNegative = 0.06
    """A point whose sixth neighbour is farther than this, and than `stray_spacings` spacings, is a stray."""
    stray_spacings: NotNegative = 4.0
    remove_planes: bool = True
    """Whether a plane wider than the model (a table, a floor) is removed; scans with a sensor origin keep theirs."""
    plane_tolerance: Positive = 0.015
    plane_share: Share = 0.15
    """Least share of the scan that such a plane holds."""
    plane_spread: NotNegative = 0.3
    """Least standard deviation of its points along both of its directions: no face of the model is that wide."""
    field_cell: Cell = 0.0125
    field_truncation: Cell = 0.06
    shadow: NotNegative = 0.45
    """How far behind a seen surface space counts as occluded."""
    depth_pixel: Cell = 0.011
    depth_tolerance: Positive = 0.02


@dataclass(frozen=True)
class Observation:
    """A prepared scan."""

    points: Singles
    """(m, 3) downsampled points."""
    normals: Singles
    """(m, 3) unit normals, towards the sensor or the open side."""
    raw: Singles
    """(n, 3) all points, without wide planes; at most `ObservationOptions.most_raw`."""
    given: Singles
    """(r, 3) points as given, `ObservationOptions.given_per_cell` a cell: noisy, but not displaced by any smoothing."""
    given_normals: Singles
    """(r, 3) normals of the nearest prepared points."""
    weights: Singles
    """(m,) how much each point speaks for a part that lies on it: 1, and less for known surroundings."""
    areas: Singles
    """(m,) surface that each point stands for, relative to the others'."""
    regions: Ints
    """(m,) the region of a scene that each point belongs to, -1 for known surroundings; otherwise all 0."""
    scene: bool
    """Whether the scan is mostly of other things than the model."""
    spacing: float
    """Median distance of a point to its sixth neighbour."""
    noise: float
    """Standard deviation of the given points from their local planes."""
    depth_pixel: float
    """Pixel of the depth image, at the mean range of what was seen."""
    sensor_origin: Singles | None
    """(3,) where the whole scan was seen from one place, else None."""
    field: kernels.ScanField
    """Distances to what was seen, and what is free and hidden."""
    centre: Array
    """(3,) in the scan frame, m."""
    diagonal: float
    """The unit of length, m."""
    borders: Singles = dataclasses.field(default_factory=lambda: NO_BORDERS)
    """(b, 3) outward unit normals of planes through the sensor beyond which it looked at nothing."""
    cut_out: bool = False
    """Whether it is what lies near one answer to a scene: other things may be among it."""

    @property
    def single_view(self) -> bool:
        """Whether free and occluded space are known."""
        return self.sensor_origin is not None

    @property
    def area_per_point(self) -> float:
        """Surface area that one point stands for: a disc of its sixth neighbour's radius holds seven points."""
        return float(np.pi * self.spacing**2 / 7)

    def to_search(self, T: Array) -> Array:
        """Convert placements (..., 4, 4) of the scan frame (m) to the search's centred, scaled frame."""
        out = np.array(T, dtype=np.float64)
        out[..., :3, 3] = (out[..., :3, 3] - self.centre) / self.diagonal
        return out

    def to_scan(self, T: Array) -> Array:
        """Convert placements (..., 4, 4) of the search's frame to the scan frame (m)."""
        out = np.array(T, dtype=np.float64)
        out[..., :3, 3] = out[..., :3, 3] * self.diagonal + self.centre
        return out

    def scaled(self, points: Array) -> Singles:
        """Convert points (n, 3) of the scan frame (m) to the search's frame."""
        return np.ascontiguousarray((points - self.centre) / self.diagonal, np.float32)


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
    plane = (
        wide_plane(raw, options, options.plane_spread, threads) if options.remove_planes and origin is None else None
    )
    if plane is not None:
        cells, noise = len(points), noise_of(at_most(raw, options.most_raw), threads)
        raw = _without_plane(raw, *plane, max(1.2 * options.plane_tolerance, 3.0 * noise))
        points, _, cell = kernels.voxel_means(raw, options.voxel)
        if len(points) < max(LEAST_POINTS, LEAST_BESIDE * cells):
            few = f"{len(points)} of {cells} cells of {100 * options.voxel:g}% of the model"
            raise ScanError(scan.source, f"it is of a plane wider than the model, and beside that fills only {few}")
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
    count = len(points)
    weights, areas, regions = np.ones(count, np.float32), np.ones(count, np.float32), np.zeros(count, np.int32)
    pixel = depth_pixel(gap, options)
    borders = NO_BORDERS if borders is None else borders
    field = kernels.ScanField(
        points=points,
        normals=normals,
        weights=weights,
        areas=areas,
        regions=regions,
        cell=options.field_cell,
        truncation=options.field_truncation,
        sensor_origin=[] if origin is None else [float(v) for v in origin],
        depth_points=raw if origin is not None else np.zeros((0, 3), np.float32),
        borders=borders,
        pixel=pixel,
        tolerance=options.depth_tolerance,
        shadow=options.shadow,
        unreturned=1.0,
        threads=threads,
    )
    given, given_normals = as_given(raw, cell, field, normals, options)
    return Observation(
        points=points,
        normals=normals,
        raw=at_most(raw, options.most_raw),
        given=given,
        given_normals=given_normals,
        weights=weights,
        areas=areas,
        regions=regions,
        scene=False,
        spacing=spacing,
        noise=noise,
        depth_pixel=pixel,
        sensor_origin=origin,
        field=field,
        centre=centre,
        diagonal=diagonal,
        borders=borders,
    )


def bulk(scan: Scan) -> tuple[Array, Array]:
    """Return the corners (3,) of the box, m, that most points of a scan lie in: strays do not widen it."""
    low, high = np.quantile(scan.points[:: max(1, len(scan.points) // 20000)], [0.03, 0.97], axis=0)
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


def median(values: NDArray[Any]) -> float:
    """Return the median of finite numbers, in half of the time that NumPy's own takes, which looks for NaNs first."""
    return float(medians(values))


def medians(values: NDArray[Any]) -> Array:
    """Return the medians (...) of finite numbers (..., n)."""
    count, middle = values.shape[-1], values.shape[-1] // 2
    ordered = np.partition(values, middle, axis=-1)
    below = ordered[..., middle] if count % 2 else ordered[..., :middle].max(axis=-1)
    return np.asarray((below + ordered[..., middle]) / 2.0)


def normals_of(
    points: Singles, noise: float, spacing: float, options: ObservationOptions, threads: int
) -> tuple[Singles, float]:
    """Return unit normals of either sign, from neighbourhoods that are wide against noise and spacing; and how far
    apart scan lines are, where a spinning sensor leaves many points' spacings between them, else 0."""
    radius = max(options.normal_radius + options.normal_noises * noise, options.neighbour_spacings * spacing)
    normals, _, variances, neighbours = kernels.local_planes(points, radius, threads)
    on_line, gap = _on_line(variances, neighbours, noise), 0.0
    for _ in range(WIDENINGS):
        if on_line.mean() < LINES:
            break
        radius *= WIDER
        gap = radius / options.neighbour_spacings
        wider, _, variances, neighbours = kernels.local_planes(points, radius, threads)
        told = on_line & ~_on_line(variances, neighbours, noise)
        normals[told] = wider[told]
        on_line &= ~told
    return np.asarray(normals), gap


def _on_line(variances: Singles, neighbours: Ints, noise: float) -> Bools:
    """Return which neighbourhoods with these `variances` (n, 3) are of one scan line, which noise widens; few points
    always lie on some line."""
    return np.asarray((neighbours >= LINE_POINTS) & (variances[:, 1] - noise**2 < ON_LINE * variances[:, 2]))


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


def at_most(points: Singles, most: int) -> Singles:
    """Return a fair sample of the points, in their order: of given points, neighbours stay next to each other."""
    if len(points) <= most:
        return points
    chosen = np.random.default_rng(0).choice(len(points), most, replace=False)
    return np.ascontiguousarray(points[np.sort(chosen)])


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


def noise_of(points: Singles, threads: int) -> float:
    """Return the standard deviation of the points about the surface they were taken from.

    The scatter about planes through the k nearest neighbours is that of the noise, and of the surface's curvature,
    which grows with the square of the neighbourhood's area: a line through the variances over k squared tells the two
    apart, down to scans so sparse that no neighbourhood is flat. Neighbours of one scan line tell nothing about planes
    through it, which hold the rays of a spinning sensor, but the same about the line.
    """
    if len(points) < 2 * NEIGHBOURS.max():
        return 0.0
    while True:
        chosen = np.random.default_rng(0).choice(len(points), min(NEIGHBOURHOODS, len(points)), replace=False)
        for counts in (NEIGHBOURS, 2 * NEIGHBOURS):
            across, along, slender = _variances(points, np.ascontiguousarray(points[chosen]), counts, threads)
            if slender < SLENDER and across[0] < FLAT_LINE * along[0]:
                return _without_curvature(counts, along, 4)
            if along[0] > FLAT**2 * across[0]:
                return _without_curvature(counts, across, 2)
        if len(points) < 2 * FEWEST:
            return _without_curvature(counts, across, 2)
        # Where the nearest neighbours lie within the noise, fewer points show the surface.
        points = at_most(points, len(points) // 2)


def _without_curvature(counts: Indices, across: Array, power: int) -> float:
    """Return the standard deviation that variances across planes or lines through `counts` neighbours tend to at none,
    as curvature grows with a `power` of the counts."""
    # A line by least squares, each variance known to the same relative accuracy.
    constant = 1.0 / np.maximum(across, 1e-18)
    growing = counts**power * constant
    apart = constant - (constant @ growing) / (growing @ growing) * growing
    return float(np.sqrt(max(apart.sum() / (apart @ constant), 0.0)))


def _variances(points: Singles, chosen: Singles, counts: Indices, threads: int) -> tuple[Array, Array, float]:
    """Return per count of neighbours the median variances across and along planes through so many about `chosen`, and
    the median share of the latter, of the fewest, in the variance at right angles to both."""
    variances = kernels.neighbourhood_variances(points, chosen, counts.tolist(), threads)
    thin, wide = medians(variances[:, :2]).T
    slender = median(variances[0, 1] / np.maximum(variances[0, 2], 1e-18))
    # The median of a chi-square distribution lies below its mean (Wilson and Hilferty's approximation).
    return thin / (1 - 2 / (9 * (counts - 3))) ** 3, wide, slender


def common_origin(scan: Scan, centre: Array, diagonal: float) -> Singles | None:
    """Return the sensor origin in search units if all points share it."""
    origin = scan.sensor_origin
    if origin is None:
        return None
    origins = np.atleast_2d(origin)
    if np.ptp(origins, axis=0).max() > 1e-3 * diagonal:
        return None
    return np.asarray((origins[0] - centre) / diagonal, np.float32)


def origins_of(points: Singles, scan: Scan, centre: Array, diagonal: float, threads: int) -> Singles | Array | None:
    """Return where prepared points were seen from, in search units: (3,) if all of the scan was from one place, else of
    each (n, 3) where the given point nearest to it was; None where that is unknown."""
    origin = common_origin(scan, centre, diagonal)
    if origin is not None or scan.sensor_origin is None:
        return origin
    given = np.ascontiguousarray((scan.points - centre) / diagonal, np.float32)
    near = kernels.nearest_neighbours(given, points, 1, threads)[1][:, 0]
    return np.asarray((np.asarray(scan.sensor_origin)[near] - centre) / diagonal)


def _without_plane(points: Singles, centre: Singles, normal: Singles, distance: float) -> Singles:
    """Remove what is no farther than `distance` from a plane."""
    return np.ascontiguousarray(points[np.abs((points - centre) @ normal) > distance])


def wide_plane(
    points: Singles, options: ObservationOptions, least_spread: float, threads: int
) -> tuple[Singles, Singles] | None:
    """Return centre and normal of the dominant plane, if it holds enough of the points and is wide enough.

    It is if their standard deviation is `least_spread` along both of its directions.
    """
    coarse, _, _ = kernels.voxel_means(points, 2 * options.voxel)
    normals = kernels.local_planes(coarse, 6 * options.voxel, threads)[0]
    x, y, z, offset, inliers = kernels.dominant_plane(coarse, normals, options.plane_tolerance, 300, 0)
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


def facing(points: Singles, normals: Singles, origin: Singles, options: ObservationOptions) -> Bools:
    """Return which points face the sensor; the others are mostly mixed pixels between an edge and what lies behind.

    If it seems to be most of them, the scan is too sparse for normals, and all are kept.
    """
    rays = origin - points
    along = np.einsum("ij,ij->i", normals, rays)
    faced = along > options.grazing * np.linalg.norm(rays, axis=1)
    return np.asarray(faced | (faced.mean() < LEAST_FACING))


def sixth_neighbour(points: Singles, threads: int) -> Singles:
    """Return the distance of each point to its sixth neighbour, or the farthest of fewer."""
    return np.asarray(kernels.nearest_neighbours(points, points, 7, threads)[0][:, -1])


def _without_strays(points: Singles, options: ObservationOptions, threads: int) -> tuple[Singles, float]:
    """Return the points that have neighbours, and the median distance to the sixth."""
    if len(points) < 8:
        return points, options.voxel
    sixth = sixth_neighbour(points, threads)
    kept = sixth < max(options.stray_distance, options.stray_spacings * median(sixth))
    if kept.sum() > 50:
        points, sixth = points[kept], sixth[kept]
    return np.ascontiguousarray(points), median(sixth)


def oriented_normals(
    points: Singles, normals: Singles, origins: Singles | Array | None, spacing: float, threads: int
) -> Singles:
    """Turn normals towards the sensor origins, (3,) or one a point (n, 3), or without any towards the open side."""
    if origins is None:
        cell = max(0.025, 0.9 * spacing)
        towards = kernels.openness(points, np.ascontiguousarray(normals, np.float32), cell, threads)
    else:
        towards = np.einsum("ij,ij->i", normals, origins - points)
    return np.ascontiguousarray(normals * np.where(towards < 0, -1, 1)[:, None], np.float32)
