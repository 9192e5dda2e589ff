"""Which way the surface faces at the points of a scan."""

from __future__ import annotations

import numpy as np

from pwralign_kin.estimation.sensing.normals import facing, normals_of, oriented_normals
from pwralign_kin.estimation.sensing.observation import ObservationOptions

OPTIONS = ObservationOptions()
RNG = np.random.default_rng(0)
SPHERE = RNG.normal(size=(6000, 3)).astype(np.float32)
SPHERE *= 0.4 / np.linalg.norm(SPHERE, axis=1, keepdims=True)
OUTWARD = SPHERE / 0.4


def cosines(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    return np.einsum("ij,ij->i", one, other)


def test_normals_are_at_right_angles_to_the_surface_in_noise_too() -> None:
    for noise in (0.0, 0.005):
        noisy = (SPHERE + noise * RNG.normal(size=SPHERE.shape)).astype(np.float32)
        normals, gap = normals_of(noisy, noise, 0.015, OPTIONS, 1)
        assert gap == 0.0
        np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, rtol=1e-4)
        assert np.median(np.abs(cosines(normals, OUTWARD))) > 0.97


def test_normals_turn_to_one_sensor_to_one_each_or_to_the_open_side() -> None:
    flipped = (OUTWARD * RNG.choice([-1.0, 1.0], (6000, 1))).astype(np.float32)
    sensor = np.array([3.0, 0.0, 0.0], np.float32)
    for origins in (sensor, 3.0 * OUTWARD, None):
        turned = oriented_normals(SPHERE, flipped, origins, 0.015, 1)
        expected = sensor - SPHERE if origins is sensor else OUTWARD
        assert (cosines(turned, expected) > 0.0).mean() > 0.99
        np.testing.assert_allclose(np.abs(cosines(turned, flipped)), 1.0, rtol=1e-4)


def test_points_seen_at_a_grazing_angle_do_not_face_the_sensor() -> None:
    sensor = np.array([3.0, 0.0, 0.0], np.float32)
    front = OUTWARD[:, 0] > 0.25
    points, normals = SPHERE[front], OUTWARD[front].copy()
    mixed = RNG.random(len(points)) < 0.1
    rays = sensor - points
    normals[mixed] = np.cross(rays[mixed], [0.0, 0.0, 1.0])
    normals[mixed] /= np.linalg.norm(normals[mixed], axis=1, keepdims=True)
    np.testing.assert_array_equal(facing(points, normals, sensor, OPTIONS), ~mixed)


def test_normals_that_would_leave_few_points_are_not_trusted() -> None:
    sensor = np.array([3.0, 0.0, 0.0], np.float32)
    assert facing(SPHERE, -OUTWARD * np.sign(OUTWARD[:, :1]), sensor, OPTIONS).all()
