"""Whole configurations that are compared, in the search's units."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pwralign_kin.se3 import Array


@dataclass(frozen=True)
class Candidates:
    """Configurations with scores."""

    bases: Array
    """(m, 4, 4) placements of the root part."""
    values: Array
    """(m, k) actuated joint values; slides in model diagonals."""
    scores: NDArray[np.float32]
    """(m,) higher is better."""

    def __len__(self) -> int:
        """Return the number of configurations."""
        return len(self.scores)

    def take(self, index: Any) -> Candidates:
        """Return the configurations of an index array, mask or slice."""
        return Candidates(
            np.ascontiguousarray(self.bases[index]),
            np.ascontiguousarray(self.values[index]),
            self.scores[index],
        )

    def with_scores(self, scores: NDArray[np.float32]) -> Candidates:
        """Return the same configurations with other scores (m,)."""
        return replace(self, scores=scores)

    def best_first(self) -> Candidates:
        """Return all, best score first; ties keep their order."""
        return self.take(np.argsort(-self.scores, kind="stable"))

    @staticmethod
    def single(base: Array, values: Array, score: float = 0.0) -> Candidates:
        """Return one configuration: its base (4, 4) and its values (k,)."""
        return Candidates(base[None], values[None], np.full(1, score, np.float32))

    @staticmethod
    def concatenate(several: Sequence[Candidates]) -> Candidates:
        """Return all configurations of several sets."""
        return Candidates(
            np.concatenate([c.bases for c in several]),
            np.concatenate([c.values for c in several]),
            np.concatenate([c.scores for c in several]),
        )
