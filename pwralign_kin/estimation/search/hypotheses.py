"""Parts placed on their own, in the search's units."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pwralign_kin.se3 import Array


@dataclass(frozen=True)
class Hypotheses:
    """Parts placed on their own, with scores."""

    parts: NDArray[np.int32]
    """(m,) part indices."""
    placements: Array
    """(m, 4, 4) placements of the part frames."""
    scores: NDArray[np.float32]
    """(m,) higher is better."""

    def take(self, index: Any) -> Hypotheses:
        """Return the hypotheses of an index array, mask or slice."""
        return Hypotheses(
            np.ascontiguousarray(self.parts[index]),
            np.ascontiguousarray(self.placements[index]),
            self.scores[index],
        )

    @staticmethod
    def nothing() -> Hypotheses:
        """Return the empty set."""
        return Hypotheses(np.zeros(0, np.int32), np.zeros((0, 4, 4)), np.zeros(0, np.float32))

    @staticmethod
    def concatenate(several: Sequence[Hypotheses]) -> Hypotheses:
        """Return all hypotheses of several sets."""
        return Hypotheses(
            np.concatenate([h.parts for h in several]),
            np.concatenate([h.placements for h in several]),
            np.concatenate([h.scores for h in several]),
        )
