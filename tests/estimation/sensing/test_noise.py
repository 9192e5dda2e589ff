"""How far points scatter about the surface that they were taken from."""

from __future__ import annotations

import numpy as np
import pytest

from pwralign_kin.estimation.sensing.noise import NEIGHBOURS, noise_of


def curved(count: int, radius: float, noise: float) -> np.ndarray:
    """Points of a unit square bent to a cylinder."""
    rng = np.random.default_rng(0)
    along, angle = rng.random(count), rng.random(count) / radius
    out = radius + noise * rng.normal(size=count)
    return np.column_stack([along, out * np.cos(angle), out * np.sin(angle)]).astype(np.float32)


@pytest.mark.parametrize("radius", [0.3, 1.0, 1e3])
@pytest.mark.parametrize("noise", [0.002, 0.006])
def test_curvature_is_no_noise(radius: float, noise: float) -> None:
    assert noise_of(curved(6000, radius, noise), 1) == pytest.approx(noise, rel=0.3)


def test_it_is_told_of_dense_points_as_of_sparse_ones() -> None:
    sparse, dense = (noise_of(curved(count, 1.0, 0.005), 1) for count in (5000, 200_000))
    assert sparse == pytest.approx(0.005, rel=0.3) and dense == pytest.approx(0.005, rel=0.3)


def test_too_few_points_tell_none() -> None:
    assert noise_of(curved(2 * NEIGHBOURS.max() - 1, 0.5, 0.01), 1) == 0.0


def test_it_does_not_depend_on_the_threads() -> None:
    points = curved(5000, 0.5, 0.004)
    assert noise_of(points, 1) == noise_of(points, 2)
