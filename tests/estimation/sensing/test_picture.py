"""Where the picture of a view ends."""

from __future__ import annotations

import numpy as np
import pytest

import pwralign_kin as pk
from pwralign_kin.estimation.sensing.observation import ObservationOptions
from pwralign_kin.estimation.sensing.picture import borders_of
from pwralign_kin.estimation.sensing.preparation import observe
from pwralign_kin.se3 import Array

WIDTH, HEIGHT, FOCAL = 160, 120, 150.0


def rays() -> Array:
    """(HEIGHT, WIDTH, 3) of a camera that looks along z, of depth 1."""
    columns, rows = np.meshgrid(np.arange(WIDTH) - (WIDTH - 1) / 2.0, np.arange(HEIGHT) - (HEIGHT - 1) / 2.0)
    return np.stack([columns / FOCAL, rows / FOCAL, np.ones_like(rows)], axis=-1)


def sphere(x: float) -> Array:
    """Depths (HEIGHT, WIDTH), m, of a sphere of 0.3 m two metres away and so far to the right; 0 where it is not."""
    towards, centre = rays(), np.array([x, 0.0, 2.0])
    along, length = towards @ centre, np.einsum("ijk,ijk->ij", towards, towards)
    root = along**2 - length * (centre @ centre - 0.3**2)
    return np.where(root > 0.0, (along - np.sqrt(np.maximum(root, 0.0))) / length, 0.0)


def wall(left: float, right: float) -> Array:
    """Depths of a wall that leans back, between two columns."""
    depth = 2.0 / (1.0 + 0.3 * rays()[..., 1])
    columns = np.arange(WIDTH)
    return np.where((columns >= left) & (columns < right) & (np.abs(rays()[..., 1]) < 0.2), depth, 0.0)


def borders(scan: pk.Scan) -> Array:
    observation = observe(scan, 1.0, ObservationOptions(), 1)
    return np.asarray(borders_of(scan, observation, 1), float)


def as_points(depth: Array) -> pk.Scan:
    seen = depth > 0.0
    return pk.Scan(rays()[seen] * depth[seen][:, None], sensor_origin=np.zeros(3))


def test_the_border_that_cuts_a_sphere_is_found() -> None:
    (normal,) = borders(as_points(sphere(1.0)))
    expected = np.array([FOCAL, 0.0, -WIDTH / 2.0])
    assert normal @ expected / np.linalg.norm(expected) == pytest.approx(1.0, abs=1e-5)


@pytest.mark.parametrize("depth", [sphere(0.2), wall(30, 130), wall(30, WIDTH)], ids=["whole", "wall", "cut wall"])
def test_edges_of_things_are_no_borders(depth: Array) -> None:
    """A plane that the border cuts looks like one that ends there."""
    assert len(borders(as_points(depth))) == 0


@pytest.mark.parametrize(("x", "count"), [(0.2, 0), (1.0, 1)])
def test_a_depth_image_tells_its_borders(x: float, count: int) -> None:
    turn = np.array([[0.0, 0.0, 1.0, 0.5], [-1.0, 0.0, 0.0, 0.0], [0.0, -1.0, 0.0, 0.2], [0.0, 0.0, 0.0, 1.0]])
    K = (FOCAL, FOCAL, (WIDTH - 1) / 2.0, (HEIGHT - 1) / 2.0)
    scan = pk.Scan.from_depth(sphere(x).astype(np.float32), K, turn)
    found = borders(scan)
    assert len(found) == count
    expected = turn[:3, :3] @ np.array([FOCAL, 0.0, -WIDTH / 2.0])
    assert found @ expected / np.linalg.norm(expected) == pytest.approx(np.ones(count), abs=1e-5)
