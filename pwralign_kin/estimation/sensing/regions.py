"""The pieces of a scene that are searched: what lies close enough together to show the model, and hangs together."""

from __future__ import annotations

import numpy as np

from pwralign_kin import kernels
from pwralign_kin.arrays import Bools, Indices, Singles
from pwralign_kin.estimation.sensing.by_range import usual_at_range
from pwralign_kin.estimation.sensing.observation import ONE_SIDE
from pwralign_kin.estimation.sensing.points import area_of_point
from pwralign_kin.estimation.sensing.scene_options import SceneOptions

STRAYING, LEAST_STRAYING = 1.6, 0.03
"""Distance to the sixth neighbour, as a multiple of what is searched by median and at least, of points that are."""
LARGEST_SPACING = 0.1
"""Distance to the sixth neighbour (model diagonals) beyond which a point stands for no more surface."""


def areas_of(spacing: Singles) -> Singles:
    """Return the surface that each point stands for, by its distance to its sixth neighbour."""
    return area_of_point(np.minimum(spacing, LARGEST_SPACING))


def near_enough(
    points: Singles, spacing: Singles, area: Singles, origin: Singles | None, model_area: float, options: SceneOptions
) -> Bools:
    """Return which points lie close enough together to show the model."""
    usual = usual_at_range(spacing, points, origin, options)
    order = np.argsort(usual, kind="stable")
    enough = np.searchsorted(np.cumsum(area[order], dtype=float), options.enough * ONE_SIDE * model_area)
    holding = float(usual[order[min(int(enough), len(order) - 1)]])
    # Beyond what is dense lie walls more often than the model, unless the limit leaves it no room to be farther.
    sparse = max(options.spacing, min(options.spacing_more * holding, options.spacing_most))
    limit = options.spacing if options.spacing_room * holding < options.spacing else sparse
    return np.asarray((usual < limit) & (spacing < max(STRAYING * limit, LEAST_STRAYING)))


def regions_of(points: Singles, spacing: Singles, searched: Bools, model_area: float, options: SceneOptions) -> Indices:
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
    areas = np.bincount(label, weights=areas_of(spacing[chosen]))
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


def with_surroundings(points: Singles, searched: Bools, margin: float) -> Bools:
    """Return what is searched and what lies near it."""
    from scipy.spatial import cKDTree

    kept = searched.copy()
    others = np.flatnonzero(~searched)
    low, high = points[searched].min(axis=0) - margin, points[searched].max(axis=0) + margin
    others = others[((points[others] > low) & (points[others] < high)).all(axis=1)]
    coarse = kernels.voxel_means(np.ascontiguousarray(points[searched]), margin / 4)[0]
    kept[others] = np.isfinite(cKDTree(coarse).query(points[others], distance_upper_bound=margin)[0])
    return kept
