"""Products and inverses in pieces."""

from __future__ import annotations

import numpy as np
import pytest

from pwralign_kin.estimation.refinement.matrices import INVERTED_WHOLE, inverse_of


@pytest.mark.parametrize("size", [7, INVERTED_WHOLE + 1, 3 * INVERTED_WHOLE])
def test_the_inverse_of_few_and_of_many_unknowns(size: int) -> None:
    A = np.random.default_rng(size).normal(size=(size, size))
    H = A @ A.T + size * np.eye(size)
    assert inverse_of(H) @ H == pytest.approx(np.eye(size), abs=1e-9)
