"""What is usual among points as far from the sensor."""

from __future__ import annotations

import numpy as np

from pwralign_kin import kernels
from pwralign_kin.arrays import Indices, Singles
from pwralign_kin.estimation.sensing.scene_options import SceneOptions

MOST_BINS = 400
"""Bins of the range, the last of all that is farther."""


def usual_at_range(values: Singles, points: Singles, origin: Singles | None, options: SceneOptions) -> Singles:
    """Return for each of the points (n, 3) the median of the `values` (n,) at its range."""
    return _binned_median(values, _range_bins(points, origin, options))


def _range_bins(points: Singles, origin: Singles | None, options: SceneOptions) -> Indices:
    """Return the bin of each point: by range, or without a sensor origin by place."""
    if origin is None:
        return np.asarray(kernels.voxel_means(points, 2 * options.range_bin)[2], np.int64)
    distance = np.linalg.norm(points - origin, axis=1)
    return np.asarray(np.minimum(distance / options.range_bin, MOST_BINS), np.int64)


def _binned_median(values: Singles, bins: Indices) -> Singles:
    """Return for each point the median of its bin."""
    order = np.lexsort((values, bins))
    first = np.flatnonzero(np.diff(bins[order], prepend=-1))
    counts = np.diff(np.append(first, len(order)))
    medians = np.zeros(int(bins.max()) + 1, np.float32)
    medians[bins[order][first]] = values[order][first + counts // 2]
    return np.asarray(medians[bins])
