"""Plain figures of points, and samples of them."""

from __future__ import annotations

from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from pwralign_kin import kernels
from pwralign_kin.arrays import Singles
from pwralign_kin.se3 import Array

Radius = TypeVar("Radius", float, Singles)


def median(values: NDArray[Any]) -> float:
    """Return the median of finite numbers, in half of the time that NumPy's own takes, which looks for NaNs first."""
    return float(medians(values))


def medians(values: NDArray[Any]) -> Array:
    """Return the medians (...) of finite numbers (..., n)."""
    count, middle = values.shape[-1], values.shape[-1] // 2
    ordered = np.partition(values, middle, axis=-1)
    below = ordered[..., middle] if count % 2 else ordered[..., :middle].max(axis=-1)
    return np.asarray((below + ordered[..., middle]) / 2.0)


def at_most(points: Singles, most: int) -> Singles:
    """Return a fair sample of the points, in their order: of given points, neighbours stay next to each other."""
    if len(points) <= most:
        return points
    chosen = np.random.default_rng(0).choice(len(points), most, replace=False)
    return np.ascontiguousarray(points[np.sort(chosen)])


def sixth_neighbour(points: Singles, threads: int) -> Singles:
    """Return the distance of each point to its sixth neighbour, or the farthest of fewer."""
    return np.asarray(kernels.nearest_neighbours(points, points, 7, threads)[0][:, -1])


def area_of_point(sixth: Radius) -> Radius:
    """Return the surface that a point stands for whose sixth neighbour is so far: a disc so wide holds seven points."""
    area: Any = np.pi * sixth**2  # whose type NumPy takes for double precision
    share: Radius = area / 7
    return share
