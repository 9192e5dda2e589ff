"""Patches of surface, within which the errors of a sensor or of the model that noise does not explain are alike."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

SIDE = 0.2
"""Of the cells (model diagonals) that a part is divided into."""


def patches(points: NDArray[np.float32], parts: NDArray[np.int32]) -> NDArray[np.int64]:
    """Return the number (n,) of the patch that each of the points (n, 3) on `parts` (n,; -1: on none) lies in; some may
    be empty."""
    cells = np.floor(points / SIDE).astype(np.int64)
    cells -= cells.min(axis=0, initial=0)
    x, y, z = cells.T
    sides = cells.max(axis=0, initial=0) + 1
    return np.asarray((((parts + 1) * sides[0] + x) * sides[1] + y) * sides[2] + z, np.int64)
