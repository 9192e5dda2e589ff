"""How scans are prepared: cleaning, normals, noise, tables, scales."""

from __future__ import annotations

import numpy as np
import pytest

import pwralign_kin as pk
from pwralign_kin.estimation.sensing.observation import Observation, ObservationOptions
from pwralign_kin.estimation.sensing.preparation import observe
from pwralign_kin.exceptions import ScanError
from pwralign_kin.simulation import SimulatedScan

RNG = np.random.default_rng(0)


def sphere(count: int, noise: float = 0.0) -> np.ndarray:
    outward = RNG.normal(size=(count, 3))
    outward /= np.linalg.norm(outward, axis=1)[:, None]
    return (0.4 + noise * RNG.normal(size=(count, 1))) * outward


def scan_lines(noise: float) -> tuple[np.ndarray, np.ndarray]:
    """Points on the half of a sphere that a spinning sensor sees, 0.006 apart along lines that are 0.06 apart, and
    where it was."""
    sensor = np.array([2.4, 0.0, 0.0])
    up, round_ = (slopes.ravel() for slopes in np.meshgrid(np.arange(-0.2, 0.2, 0.025), np.arange(-0.2, 0.2, 0.0025)))
    rays = np.column_stack([-np.cos(up) * np.cos(round_), np.cos(up) * np.sin(round_), np.sin(up)])
    along = -(rays @ sensor)
    rays, along = (values[along**2 - sensor @ sensor + 0.4**2 > 0.01] for values in (rays, along))
    ranges = along - np.sqrt(along**2 - sensor @ sensor + 0.4**2)
    return sensor + (ranges + noise * RNG.normal(size=len(ranges)))[:, None] * rays, sensor


def prepared(points: np.ndarray, sensor_origin: np.ndarray | None = None, **options: object) -> Observation:
    return observe(pk.Scan(points, sensor_origin=sensor_origin), 1.0, ObservationOptions(**options), 2)  # type: ignore[arg-type]


@pytest.mark.parametrize("noise", [0.002, 0.005, 0.01])
def test_the_noise_is_found(noise: float) -> None:
    assert prepared(sphere(8000, noise)).noise == pytest.approx(noise, rel=0.4)


@pytest.mark.parametrize("noise", [0.002, 0.004, 0.008])
def test_the_noise_of_scan_lines_is_found_although_each_is_in_a_plane_without_any(noise: float) -> None:
    assert prepared(scan_lines(noise)[0]).noise == pytest.approx(noise, rel=0.4)


def test_normals_of_scan_lines_are_of_the_surface_between_them() -> None:
    points, sensor = scan_lines(0.004)
    observation = prepared(points, sensor)
    assert len(observation.points) > 0.75 * len(prepared(points).points)
    outward = observation.points + observation.centre
    outward /= np.linalg.norm(outward, axis=1)[:, None]
    assert np.median(np.einsum("ij,ij->i", outward, observation.normals)) > 0.95


def test_sparse_points_are_on_no_scan_lines() -> None:
    wall = np.column_stack([RNG.uniform(-2, 2, (4000, 2)), np.full(4000, -3.0)]) + 0.002 * RNG.normal(size=(4000, 3))
    both = np.concatenate([sphere(8000, 0.002), wall])
    assert prepared(both, stray_distance=9.0, remove_planes=False).depth_pixel == ObservationOptions().depth_pixel
    assert prepared(scan_lines(0.002)[0]).depth_pixel > 0.014


def test_details_do_not_count_as_noise() -> None:
    rods = np.concatenate([sphere(2000) * [0.02, 0.02, 1] + [0.05 * k, 0, 0] for k in range(4)])
    assert prepared(rods).noise < 0.002


def test_normals_point_outwards_without_a_sensor_origin() -> None:
    observation = prepared(sphere(6000, 0.001))
    outward = observation.points + observation.centre
    assert (np.einsum("ij,ij->i", outward, observation.normals) > 0).mean() > 0.98


def test_normals_point_to_the_sensor() -> None:
    points = sphere(6000)
    origin = np.array([3.0, 0.0, 0.0])
    observation = prepared(points[points[:, 0] > 0], origin)
    assert observation.single_view
    towards = observation.sensor_origin - observation.points
    assert (np.einsum("ij,ij->i", towards, observation.normals) > 0).all()


def test_strays_are_dropped() -> None:
    strays = RNG.uniform(-2, 2, (40, 3))
    observation = prepared(np.concatenate([sphere(6000), strays]))
    radius = np.linalg.norm(observation.points + observation.centre, axis=1)
    assert (np.abs(radius - 0.4) > 0.1).mean() < 0.002
    given = np.linalg.norm(observation.given + observation.centre, axis=1)
    assert (np.abs(given - 0.4) > 0.1).mean() < 0.002


def test_mixed_pixels_between_an_edge_and_what_lies_behind_are_dropped() -> None:
    sensor = np.array([0.0, 0.0, 2.0])
    front = np.column_stack([RNG.uniform(-0.2, 0.2, (6000, 2)), np.full(6000, 0.2)])
    behind = np.column_stack([RNG.uniform(-0.5, 0.5, (20000, 2)), np.full(20000, -0.2)])
    share = np.concatenate([RNG.uniform(0.2, 1.0, (400, 1)), np.ones((1, 1))])
    edge = np.column_stack([np.full(401, 0.2), RNG.uniform(-0.2, 0.2, 401), np.full(401, 0.2)])
    mixed = (sensor + (edge - sensor) * (1.0 + 0.28 * share))[:400]
    observation = prepared(np.concatenate([front, behind, mixed]), sensor)
    for points in (observation.points, observation.given):
        height = points[:, 2] + observation.centre[2]
        assert (np.abs(height) < 0.12).sum() < 0.2 * 400 * len(points) / 26400
        assert (height > 0.15).any() and (height < -0.15).any()


def test_a_table_goes_and_a_face_stays() -> None:
    side = RNG.uniform(-0.9, 0.9, (12000, 2))
    table = np.column_stack([side, np.full(len(side), -0.4)])
    without = prepared(np.concatenate([sphere(6000), table]))
    assert len(without.points) < 1.2 * len(prepared(sphere(6000)).points)
    face = np.column_stack([RNG.uniform(-0.3, 0.3, (6000, 2)), np.zeros(6000)])
    assert np.ptp(prepared(face).points, axis=0)[:2].min() > 0.55


def test_every_bit_of_surface_counts_alike_however_densely_it_was_seen() -> None:
    points = sphere(4000)
    dense = np.concatenate([points, *[points[points[:, 0] > 0] + 1e-4 * k for k in range(1, 6)]])
    observation = prepared(dense, given_per_cell=1)
    assert 0.45 < (observation.given[:, 0] + observation.centre[0] > 0).mean() < 0.55


def test_the_field_names_points_within_reach_only() -> None:
    ready = prepared(sphere(4000))
    beside = np.ascontiguousarray(ready.points + 0.02 * ready.normals)
    nearest = ready.field.nearest(beside, 0.04)
    assert (np.linalg.norm(ready.points[nearest] - beside, axis=1) < 0.04).all()
    assert (nearest >= 0).all()
    assert (ready.field.nearest(beside, 0.015) == -1).all()
    assert (ready.field.nearest(beside) >= 0).all()


def test_placements_convert_back_and_forth() -> None:
    observation = prepared(sphere(3000) + np.array([5.0, 6.0, 7.0]))
    T = np.eye(4)
    T[:3, 3] = [1, 2, 3]
    np.testing.assert_allclose(observation.to_scan(observation.to_search(T)), T, atol=1e-12)


def test_a_hall_around_a_small_model_asks_for_a_crop() -> None:
    hall = RNG.uniform(-30, 30, (200000, 3))
    with pytest.raises(ScanError, match="crop"):
        prepared(hall)


def test_a_point_without_depth_at_the_origin_of_a_far_map_changes_nothing(
    arm: pk.ArticulatedModel, full_scan: SimulatedScan
) -> None:
    far = full_scan.scan.points[::3] + np.array([1e4, -2e4, 300.0])
    right = pk.estimate(arm, pk.Scan(far))
    estimate = pk.estimate(arm, pk.Scan(np.concatenate([far, np.zeros((1, 3))])))
    assert (estimate.state.T_scan_base == right.state.T_scan_base).all()
    assert estimate.scan_labels[-1] == -1
