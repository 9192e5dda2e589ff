"""The outline of a model against that of a scan."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from pwralign_kin.estimation.sensing.silhouette import dilated


@pytest.mark.parametrize("shape", [(60, 90), (3, 50), (40, 2)])
@pytest.mark.parametrize("radius", [0.0, 0.5, 1.0, 2.0, 2.9, 3.5, 7.3, 70.0])
def test_dilated_is_what_the_distance_transform_tells(shape: tuple[int, int], radius: float) -> None:
    mask = np.random.default_rng(0).uniform(size=shape) < 0.02
    mask[0, 0] = True
    np.testing.assert_array_equal(dilated(mask, radius), ndimage.distance_transform_edt(~mask) <= radius)
