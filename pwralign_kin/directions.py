"""Directions to look in."""

from __future__ import annotations

import numpy as np

from pwralign_kin.se3 import Array


def fibonacci_directions(count: int) -> Array:
    """Return unit vectors (count, 3) spread evenly over the sphere (spherical Fibonacci lattice)."""
    k = np.arange(count)
    z = 1 - 2 * (k + 0.5) / count
    angle = np.pi * (3 - np.sqrt(5)) * k
    r = np.sqrt(1 - z * z)
    return np.column_stack([r * np.cos(angle), r * np.sin(angle), z])
