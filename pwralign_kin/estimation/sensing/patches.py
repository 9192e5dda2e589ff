"""Patches of surface, within which the errors of a sensor or of the model that noise does not explain are alike."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

SIDE = 0.2
"""Of the cells (model diagonals) that a part is divided into."""


def patches(points: NDArray[np.float32], parts: NDArray[np.int32]) -> NDArray[np.int64]:
    """Return the number (n,) of the patch that each of the points (n, 3) on `parts` (n,; -1: on none) lies in; some may
    be empty."""
    number = parts.astype(np.int64) + 1
    for coordinate in points.T:
        cell = np.floor(coordinate / SIDE).astype(np.int64)
        cell -= cell.min(initial=0)
        number = number * (cell.max(initial=0) + 1) + cell
    return number
