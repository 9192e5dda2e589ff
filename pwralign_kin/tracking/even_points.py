"""Points that fill a cube evenly."""

from __future__ import annotations

import numpy as np

from pwralign_kin.se3 import Array


class EvenPoints:
    """A sequence of points that fills the unit cube evenly, however many of them are drawn.

    M. Roberts, The Unreasonable Effectiveness of Quasirandom Sequences, 2018.
    """

    def __init__(self) -> None:
        """Begin with the first point."""
        self.drawn = 0

    def draw(self, count: int, size: int) -> Array:
        """Return the next points (count, size)."""
        ratio = 2.0
        for _ in range(32):  # to the root of ratio**(size + 1) = 1 + ratio
            ratio = (1.0 + ratio) ** (1.0 / (size + 1))
        numbers = np.arange(self.drawn, self.drawn + count)[:, None]
        self.drawn += count
        return np.asarray((0.5 + numbers * ratio ** -np.arange(1.0, size + 1)) % 1.0)
