"""The outline of a model against that of a scan."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy import ndimage

from pwralign_kin.estimation.sensing.observation import NO_BORDERS
from pwralign_kin.estimation.sensing.silhouette import Silhouette, dilated


@pytest.mark.parametrize("shape", [(60, 90), (3, 50), (40, 2)])
@pytest.mark.parametrize("radius", [0.0, 0.5, 1.0, 2.0, 2.9, 3.5, 7.3, 70.0])
def test_dilated_is_what_the_distance_transform_tells(shape: tuple[int, int], radius: float) -> None:
    mask = np.random.default_rng(0).uniform(size=shape) < 0.02
    mask[0, 0] = True
    np.testing.assert_array_equal(dilated(mask, radius), ndimage.distance_transform_edt(~mask) <= radius)


def test_residuals_follow_the_model_by_less_than_a_pixel() -> None:
    def disc(spacing: float) -> np.ndarray:
        x, y = np.mgrid[-0.2:0.2:spacing, -0.2:0.2:spacing].reshape(2, -1)
        return np.stack([x, y, np.ones_like(x)], axis=1)[np.hypot(x, y) < 0.15]

    points = disc(0.004).astype(np.float32)
    observation: Any = SimpleNamespace(sensor_origin=np.zeros(3, np.float32), borders=NO_BORDERS)
    silhouette = Silhouette(observation, points, np.ones(len(points), bool))
    model, parts = disc(0.005), np.zeros(len(disc(0.005)), np.int64)
    here = silhouette.residuals(parts, model, 0.005, 0.05)
    aside = 0.1 * silhouette.pixel * np.array([1.0, 0.0, 0.0])
    there = silhouette.residuals(parts, model + aside, 0.005, 0.05)
    np.testing.assert_allclose(there.points - here.points, np.broadcast_to(aside, here.points.shape))
    expected = here.directions @ aside
    assert np.corrcoef(there.residuals - here.residuals, expected)[0, 1] > 0.8
    assert np.abs(there.residuals - here.residuals).max() < 0.25 * silhouette.pixel
