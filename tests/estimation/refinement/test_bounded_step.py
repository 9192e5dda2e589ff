"""Steps within bounds."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from pwralign_kin.estimation.refinement.bounded_step import bounded_step


@pytest.mark.parametrize("broken", [-np.eye(7), np.full((7, 7), np.nan)])
def test_a_step_that_has_no_solution_is_an_error(broken: NDArray[np.float64]) -> None:
    with pytest.raises(np.linalg.LinAlgError):
        bounded_step(broken, np.ones(7), np.full(7, -0.1), np.full(7, 0.1), 1e-6)
