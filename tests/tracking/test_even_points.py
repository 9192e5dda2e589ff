"""Points that fill a cube evenly."""

from __future__ import annotations

import numpy as np
import pytest

from pwralign_kin.tracking.even_points import EvenPoints


@pytest.mark.parametrize("size", [1, 2, 4])
def test_points_are_even_over_several_draws(size: int) -> None:
    points = EvenPoints()
    drawn = np.concatenate([points.draw(24, size), points.draw(40, size)])
    assert points.drawn == 64
    assert drawn.shape == (64, size) and (drawn >= 0.0).all() and (drawn < 1.0).all()
    for column in drawn.T:
        assert (np.histogram(column, 8, (0.0, 1.0))[0] >= 5).all()
    corners = (drawn[:, :2] > 0.5).astype(int) @ (2 ** np.arange(min(size, 2)))
    assert (np.bincount(corners) >= 10).all()
