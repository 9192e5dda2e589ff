"""Where the points of a scan were seen from."""

from __future__ import annotations

import numpy as np

import pwralign_kin as pk
from pwralign_kin.estimation.sensing.viewpoints import common_origin, origins_of

POINTS = np.random.default_rng(0).random((500, 3))
CENTRE, DIAGONAL = POINTS.mean(axis=0), 2.0


def prepared() -> np.ndarray:
    return ((POINTS[::5] - CENTRE) / DIAGONAL).astype(np.float32)


def test_one_origin_is_told_in_the_units_of_the_search() -> None:
    seen = np.array([3.0, 1.0, 0.0])
    for origin in (seen, np.tile(seen, (500, 1))):
        scan = pk.Scan(POINTS, sensor_origin=origin)
        np.testing.assert_allclose(common_origin(scan, CENTRE, DIAGONAL), (seen - CENTRE) / DIAGONAL, rtol=1e-6)
        assert origins_of(prepared(), scan, CENTRE, DIAGONAL, 1).shape == (3,)


def test_of_several_each_point_has_that_of_the_given_point_nearest_to_it() -> None:
    origins = np.where(POINTS[:, :1] < 0.5, [[-3.0, 0.0, 0.0]], [[3.0, 0.0, 0.0]])
    scan = pk.Scan(POINTS, sensor_origin=origins)
    assert common_origin(scan, CENTRE, DIAGONAL) is None
    found = origins_of(prepared(), scan, CENTRE, DIAGONAL, 1)
    np.testing.assert_allclose(found, (origins[::5] - CENTRE) / DIAGONAL, rtol=1e-6)


def test_a_sensor_that_hardly_moved_was_in_one_place() -> None:
    shaken = np.random.default_rng(1).uniform(0.0, 1e-3, (500, 3))
    assert common_origin(pk.Scan(POINTS, sensor_origin=shaken), CENTRE, DIAGONAL) is not None
    assert common_origin(pk.Scan(POINTS, sensor_origin=10.0 * shaken), CENTRE, DIAGONAL) is None


def test_an_unknown_origin_stays_unknown() -> None:
    scan = pk.Scan(POINTS)
    assert common_origin(scan, CENTRE, DIAGONAL) is None
    assert origins_of(prepared(), scan, CENTRE, DIAGONAL, 1) is None
