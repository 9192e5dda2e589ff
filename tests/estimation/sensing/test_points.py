"""Plain figures of points, and samples of them."""

from __future__ import annotations

import numpy as np
import pytest

from pwralign_kin.estimation.sensing.points import area_of_point, at_most, median, medians, sixth_neighbour


@pytest.mark.parametrize("count", [1, 2, 7, 4000])
def test_the_median_is_that_of_numpy(count: int) -> None:
    values = np.random.default_rng(count).random(count).astype(np.float32)
    assert median(values) == pytest.approx(float(np.median(values)), rel=1e-6)


def test_medians_are_of_rows() -> None:
    values = np.random.default_rng(0).random((3, 4, 10))
    np.testing.assert_allclose(medians(values), np.median(values, axis=-1))


def test_a_sample_is_of_all_and_keeps_their_order() -> None:
    """What is next to each other is looked up together: in any order, that takes twice as long."""
    points = np.repeat(np.arange(10000, dtype=np.float32)[:, None], 3, axis=1)
    sample = at_most(points, 1000)[:, 0]
    assert len(sample) == 1000 and (np.diff(sample) > 0).all()
    assert abs(sample.mean() - 5000.0) < 300.0
    assert at_most(points, 10000) is points


def test_points_stand_for_most_of_a_plane_whatever_their_density() -> None:
    rng = np.random.default_rng(0)
    for count in (500, 8000):
        flat = np.column_stack([rng.random((count, 2)), np.zeros(count)]).astype(np.float32)
        inner = (np.abs(flat[:, :2] - 0.5) < 0.35).all(axis=1)
        areas = area_of_point(sixth_neighbour(flat, 1))[inner]
        # Of points at random, the sixth neighbour is as far as six discs of the area of one are wide, not seven.
        assert areas.sum() == pytest.approx(6 / 7 * 0.49, rel=0.1)
