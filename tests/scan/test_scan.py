"""Cleaning, cropping, scaling and depth images."""

from __future__ import annotations

import logging
import time

import numpy as np
import pytest

from pwralign_kin.exceptions import ScanError, StateError
from pwralign_kin.scan import Scan
from pwralign_kin.se3 import rotation_about


def cloud(count: int = 100, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(count, 3))


def test_clean_points_are_kept_in_order_and_never_change() -> None:
    points = cloud()
    scan = Scan(points.astype(np.float32))
    assert scan.points.dtype == np.float64
    assert np.array_equal(scan.points, points.astype(np.float32).astype(np.float64))
    assert scan.n_input == 100
    assert np.array_equal(scan.source_index, np.arange(100))
    for array in (scan.points, scan.source_index):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0


def test_the_input_array_is_left_alone() -> None:
    points = cloud()
    scan = Scan(points)
    points[0] = 7.0
    assert not (scan.points[0] == 7.0).any()


def test_non_finite_and_duplicate_points_are_dropped_counted_and_logged(
    caplog: pytest.LogCaptureFixture,
) -> None:
    points = cloud(50)
    points[3, 1] = np.nan
    points[4, 2] = np.inf
    points[10] = points[9]
    points[11] = points[9]
    points[20] = [0.0, 1.0, 2.0]
    points[21] = [-0.0, 1.0, 2.0]
    origins = np.arange(150.0).reshape(50, 3)
    with caplog.at_level(logging.INFO, logger="pwralign_kin"):
        scan = Scan(points, sensor_origin=origins, normals=np.tile([0.0, 0.0, 2.0], (50, 1)), source="cloud")
    assert scan.dropped == {"non_finite": 2, "duplicate": 3}
    assert scan.n_input == 50
    assert len(scan) == 45
    expected = np.delete(np.arange(50), [3, 4, 10, 11, 21])
    assert np.array_equal(scan.source_index, expected)
    assert np.array_equal(scan.points, points[expected])
    assert scan.sensor_origin is not None and np.array_equal(scan.sensor_origin, origins[expected])
    assert scan.normals is not None and np.array_equal(scan.normals, np.tile([0.0, 0.0, 1.0], (45, 1)))
    assert caplog.messages == ["cloud: dropped 2 non-finite and 3 duplicate points of 50"]


def test_only_what_is_dropped_is_told(caplog: pytest.LogCaptureFixture) -> None:
    points = cloud()
    points[3] = np.nan
    with caplog.at_level(logging.INFO, logger="pwralign_kin"):
        Scan(points, source="cloud")
    assert caplog.messages == ["cloud: dropped 1 non-finite points of 100"]


def test_near_duplicates_are_kept() -> None:
    points = cloud()
    points[1] = np.nextafter(points[0], 1.0)
    assert len(Scan(points)) == 100


def test_the_step_of_rounded_coordinates_is_told() -> None:
    points = cloud(5000)
    assert Scan(points).rounding() < 1e-6
    assert Scan(points.astype(np.float32)).rounding() < 1e-6
    assert Scan(np.round(points, 2)).rounding() == pytest.approx(0.01)
    assert Scan((points + np.array([5.4e6, 0.0, 0.0])).astype(np.float32)).rounding() == 0.5
    assert Scan((0.1 * points + np.array([5.4e6, 0.0, 0.0])).astype(np.float32)).rounding() == 0.5
    assert Scan(points * [1.0, 1.0, 0.0]).rounding() < 1e-6
    layers = np.column_stack([points[:, :2], 0.1 * (np.arange(5000) % 8)])
    assert Scan(layers).rounding() < 1e-6


def test_a_few_values_are_not_taken_for_rounded_ones() -> None:
    """The corners of boxes stand a few coarse steps apart."""
    corners = np.stack(np.meshgrid([0.0, 0.3, 0.5, 1.0], [0.0, 1.0], [0.0, 2.0]), axis=-1).reshape(-1, 3)
    assert Scan(corners).rounding() < 1e-6


def test_duplicates_are_found_exactly_as_by_sorting() -> None:
    lattice = np.random.default_rng(1).integers(0, 12, size=(5000, 3)) / 7.0
    scan = Scan(lattice)
    _, first = np.unique(lattice, axis=0, return_index=True)
    assert np.array_equal(scan.source_index, np.sort(first))


def test_a_million_points_are_cleaned_in_about_half_a_second() -> None:
    points = cloud(1_000_000)
    points[::10] = points[1::10]
    start = time.perf_counter()
    scan = Scan(points)
    assert time.perf_counter() - start < 2.0  # 0.35 s on two idle cores; the rest is for busy machines
    assert scan.dropped["duplicate"] == 100_000


@pytest.mark.parametrize(
    ("points", "fault"),
    [
        (np.empty((0, 3)), "no points"),
        (np.full((20, 3), np.nan), "none of the 20 points is finite"),
        (np.ones((500, 3)), "only 1 distinct point;"),
        (cloud(9), "only 9 distinct points"),
        (cloud(30)[:, :2], r"shape \(n, 3\), got \(30, 2\)"),
        (cloud(30).ravel(), r"shape \(n, 3\), got \(90,\)"),
        ([["a", "b", "c"]] * 20, "not an array of numbers"),
        ([[1.0, 2.0, 3.0], [1.0, 2.0]], "not an array of numbers"),
    ],
)
def test_useless_points_raise(points: np.ndarray, fault: str) -> None:
    with pytest.raises(ScanError, match=fault):
        Scan(points, source="cloud")


@pytest.mark.parametrize("origin", [[0.0, 0.0], np.zeros((99, 3)), [0.0, np.nan, 0.0], "here"])
def test_a_malformed_sensor_origin_raises(origin: object) -> None:
    with pytest.raises(ScanError, match=r"sensor_origin|sensor origins"):
        Scan(cloud(), sensor_origin=origin)  # type: ignore[arg-type]


def test_one_sensor_origin_serves_all_points() -> None:
    scan = Scan(cloud(), sensor_origin=[1, 2, 3])
    assert scan.sensor_origin is not None and scan.sensor_origin.tolist() == [1.0, 2.0, 3.0]


def test_normals_with_holes_are_discarded_as_a_whole(caplog: pytest.LogCaptureFixture) -> None:
    normals = np.ones((100, 3))
    normals[5] = 0.0
    with caplog.at_level(logging.INFO, logger="pwralign_kin"):
        assert Scan(cloud(), normals=normals).normals is None
    assert "normals discarded" in caplog.text
    with pytest.raises(ScanError, match="normals must have the shape"):
        Scan(cloud(), normals=normals[:-1])


def test_size() -> None:
    points = cloud()
    points[:, 0] *= 3.0
    scan = Scan(points)
    assert scan.extent == pytest.approx(points.max(axis=0) - points.min(axis=0))
    assert scan.diagonal == pytest.approx(np.linalg.norm(scan.extent))
    assert "100 points" in repr(scan)


def test_scaled_scales_points_and_origin() -> None:
    scan = Scan(cloud(), sensor_origin=[1.0, 2.0, 3.0], source="cloud").scaled(1e-3)
    assert np.allclose(scan.points, 1e-3 * cloud())
    assert scan.sensor_origin is not None and np.allclose(scan.sensor_origin, [1e-3, 2e-3, 3e-3])
    assert scan.source == "cloud"


def test_mirrored_turns_the_sign_of_z_throughout() -> None:
    normals = np.tile([0.0, 0.6, 0.8], (100, 1))
    scan = Scan(cloud(), sensor_origin=[1.0, 2.0, 3.0], normals=normals).mirrored()
    assert np.allclose(scan.points, cloud() * [1.0, 1.0, -1.0])
    assert scan.sensor_origin is not None and np.allclose(scan.sensor_origin, [1.0, 2.0, -3.0])
    assert scan.normals is not None and np.allclose(scan.normals, [0.0, 0.6, -0.8])


def test_mirrored_turns_the_axis_that_is_named() -> None:
    assert np.allclose(Scan(cloud()).mirrored("x").points, cloud() * [-1.0, 1.0, 1.0])
    with pytest.raises(ScanError, match="mirrored along x, y or z, not 'X'"):
        Scan(cloud()).mirrored("X")  # type: ignore[arg-type]


def test_cropped_keeps_the_points_in_the_box_and_their_indices() -> None:
    points = cloud(500)
    points[7] = np.nan
    origins = np.arange(1500.0).reshape(500, 3)
    scan = Scan(points, sensor_origin=origins).cropped([-1, -1, 0], [1, 1, 5])
    inside = (points >= [-1, -1, 0]).all(axis=1) & (points <= [1, 1, 5]).all(axis=1)
    assert np.array_equal(scan.source_index, np.flatnonzero(inside))
    assert np.array_equal(scan.points, points[inside])
    assert scan.sensor_origin is not None and np.array_equal(scan.sensor_origin, origins[inside])
    assert scan.n_input == 500
    assert scan.dropped == {"non_finite": 1, "duplicate": 0, "cropped": 499 - int(inside.sum())}


@pytest.mark.parametrize(
    ("lower", "upper", "fault"),
    [
        ([0, 0, 0], [1, -1, 1], "no box to crop to"),
        ([0, 0], [1, 1], "no box to crop to"),
        ([50, 50, 50], [51, 51, 51], "only 0 points lie in the crop box.*the scan spans"),
    ],
)
def test_a_useless_crop_raises(lower: list[float], upper: list[float], fault: str) -> None:
    with pytest.raises(ScanError, match=fault):
        Scan(cloud()).cropped(lower, upper)


FX, FY, CX, CY = 110.0, 100.0, 31.5, 23.5
WIDTH, HEIGHT = 64, 48


def plane_depth(normal: np.ndarray, offset: float) -> np.ndarray:
    """Depth image (m) of the plane normal . p = offset in camera coordinates."""
    u, v = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    rays = np.stack([(u - CX) / FX, (v - CY) / FY, np.ones(u.shape)], axis=-1)
    return offset / (rays @ normal)


def test_a_depth_image_of_a_plane_gives_points_on_the_plane() -> None:
    normal = np.array([0.3, -0.2, 1.0])
    T = np.eye(4)
    T[:3, :3] = rotation_about(np.array([0.0, 0.6, 0.8]), 0.7)
    T[:3, 3] = [1.0, -2.0, 0.5]
    scan = Scan.from_depth(plane_depth(normal, 1.5), (FX, FY, CX, CY), T)
    in_camera = (scan.points - T[:3, 3]) @ T[:3, :3]
    assert np.allclose(in_camera @ normal, 1.5, atol=1e-12)
    assert np.allclose(in_camera[:, 0] / in_camera[:, 2] * FX + CX, np.tile(np.arange(WIDTH), HEIGHT))
    assert np.allclose(in_camera[:, 1] / in_camera[:, 2] * FY + CY, np.repeat(np.arange(HEIGHT), WIDTH))
    assert scan.sensor_origin is not None and np.allclose(scan.sensor_origin, T[:3, 3])
    assert scan.camera is not None
    assert (scan.camera.width, scan.camera.height) == (WIDTH, HEIGHT)
    assert np.allclose(scan.camera.T_scan_camera, T)


def test_integer_depth_needs_its_scale_and_then_agrees_with_metres() -> None:
    depth = plane_depth(np.array([0.0, 0.1, 1.0]), 1.5)
    millimetres = np.round(1000.0 * depth).astype(np.uint16)
    K = np.array([[FX, 0.0, CX], [0.0, FY, CY], [0.0, 0.0, 1.0]])
    with pytest.raises(ScanError, match="integer depth needs depth_scale"):
        Scan.from_depth(millimetres, K)
    scan = Scan.from_depth(millimetres, K, depth_scale=0.001)
    assert np.allclose(scan.points, Scan.from_depth(depth, (FX, FY, CX, CY)).points, atol=1e-3)


def test_pixels_without_depth_or_outside_the_mask_are_no_points() -> None:
    depth = plane_depth(np.array([0.0, 0.0, 1.0]), 2.0)
    depth[0, 0], depth[0, 1], depth[0, 2], depth[0, 3] = 0.0, np.nan, np.inf, -1.0
    mask = np.zeros(depth.shape, dtype=bool)
    mask[:10] = True
    scan = Scan.from_depth(depth, (FX, FY, CX, CY), mask=mask)
    assert scan.n_input == depth.size
    assert np.array_equal(scan.source_index, np.arange(4, 10 * WIDTH))


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        ({"depth": np.ones((4, 5, 3))}, "depth must be a numeric image"),
        ({"depth": np.full((4, 5), "x")}, "depth must be a numeric image"),
        ({"depth": np.zeros((40, 50))}, "no pixel in use has a depth"),
        ({"intrinsics": (1.0, 2.0, 3.0)}, "intrinsics must be"),
        ({"intrinsics": (-1.0, 2.0, 3.0, 4.0)}, "intrinsics must be"),
        ({"intrinsics": np.zeros((3, 3))}, "intrinsics must be"),
        ({"mask": np.ones((3, 3), dtype=bool)}, "mask has the shape"),
        ({"depth_scale": 0.0}, "depth_scale must be positive"),
    ],
)
def test_malformed_depth_raises(change: dict[str, object], fault: str) -> None:
    arguments: dict[str, object] = {"depth": np.ones((40, 50)), "intrinsics": (FX, FY, CX, CY)}
    with pytest.raises(ScanError, match=fault):
        Scan.from_depth(**{**arguments, **change})  # type: ignore[arg-type]


def test_a_camera_placement_that_is_not_rigid_raises() -> None:
    with pytest.raises(StateError, match="T_scan_camera"):
        Scan.from_depth(np.ones((40, 50)), (FX, FY, CX, CY), np.diag([2.0, 1.0, 1.0, 1.0]))


def test_a_scan_can_be_said_to_be_seen_from_somewhere() -> None:
    points = np.random.default_rng(0).normal(size=(50, 3))
    scan = Scan(points).with_sensor_origin(np.array([0.0, 0.0, 5.0]))
    assert np.array_equal(np.asarray(scan.sensor_origin), [0.0, 0.0, 5.0])
    assert np.array_equal(scan.points, points)


def test_a_new_sensor_origin_is_checked() -> None:
    scan = Scan(np.random.default_rng(0).random((50, 3)))
    assert np.array_equal(scan.with_sensor_origin((1, 2, 3)).sensor_origin, [1.0, 2.0, 3.0])
    for wrong in ((1.0, 2.0), (np.nan, 0.0, 0.0), "here", np.zeros((4, 3))):
        with pytest.raises(ScanError, match=r"sensor.origin"):
            scan.with_sensor_origin(wrong)  # type: ignore[arg-type]
