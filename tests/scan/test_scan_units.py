"""In which unit a scan is."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
import pytest

from pwralign_kin.exceptions import ScanError, UnitError
from pwralign_kin.scan import Scan, check_named_unit, check_units, likely_unit, note_of_unit, units_of_it_alone

DIAGONAL = 0.8
"""Diagonal of the imagined model, m."""


def surface(size: float, count: int, seed: int = 0) -> np.ndarray:
    """Points on the faces of a box whose diagonal is `size`."""
    rng = np.random.default_rng(seed)
    points = rng.random((count, 3))
    points[np.arange(count), rng.integers(0, 3, count)] = rng.integers(0, 2, count)
    return points * size / np.sqrt(3.0)


@pytest.mark.parametrize("count", [600, 8000, 200_000])
@pytest.mark.parametrize("share", [0.3, 1.0, 20.0])
def test_millimetres_raise_and_name_the_switch(count: int, share: float) -> None:
    scan = Scan(surface(1000.0 * share * DIAGONAL, count), source="scan.ply")
    with pytest.raises(UnitError, match=r"scan\.ply: the scan is .* times as large as the model.*--units mm") as caught:
        check_units(scan, DIAGONAL, "m")
    assert caught.value.scale == 1e-3


def test_the_scale_of_a_depth_image_in_metres_is_told() -> None:
    image = np.full((48, 64), 900.0)
    scan = Scan.from_depth(image, (60.0, 60.0, 31.5, 23.5))
    with pytest.raises(UnitError, match=r"0\.001 times .*--depth-scale") as caught:
        check_units(scan, 1.0)
    assert "--units" not in str(caught.value)


def test_auto_rescales_and_warns(caplog: pytest.LogCaptureFixture) -> None:
    metres = surface(DIAGONAL, 2000)
    scan = Scan(1000.0 * metres, sensor_origin=[1000.0, 0.0, 0.0])
    with caplog.at_level(logging.WARNING, logger="pwralign_kin"):
        checked = check_units(scan, DIAGONAL, "auto")
    assert np.allclose(checked.points, metres)
    assert checked.sensor_origin is not None and np.allclose(checked.sensor_origin, [1.0, 0.0, 0.0])
    assert "taken as millimetres" in caplog.text


@pytest.mark.parametrize(
    ("share", "count"),
    [
        (0.2, 300),  # a small part of the model
        (1.0, 600),
        (12.0, 60_000),  # an unsegmented room
        (50.0, 200_000),
    ],
)
def test_metric_scans_pass_unchanged(share: float, count: int) -> None:
    scan = Scan(surface(share * DIAGONAL, count))
    assert check_units(scan, DIAGONAL, "m") is scan
    assert check_units(scan, DIAGONAL, "auto") is scan


def test_a_hall_around_a_small_object_is_as_large_as_millimetres_but_dense() -> None:
    floor = np.random.default_rng(0).random((400_000, 3)) * [92.0, 92.0, 0.01]
    scan = Scan(floor)
    assert scan.diagonal > 150.0 * DIAGONAL
    assert check_units(scan, DIAGONAL) is scan


def test_far_stray_points_do_not_make_millimetres() -> None:
    points = surface(DIAGONAL, 5000)
    points[:20] *= 5000.0
    scan = Scan(points)
    assert check_units(scan, DIAGONAL) is scan


def test_millimetres_converted_on_loading_are_not_questioned(tmp_path) -> None:  # type: ignore[no-untyped-def]
    metres = surface(DIAGONAL, 2000)
    np.save(tmp_path / "scan.npy", 1000.0 * metres)
    scan = Scan.load(tmp_path / "scan.npy", units="mm", sensor_origin=[500.0, 0.0, 0.0])
    assert np.allclose(scan.points, metres)
    assert scan.sensor_origin is not None and np.allclose(scan.sensor_origin, [0.5, 0.0, 0.0])
    assert check_units(scan, DIAGONAL, "mm") is scan
    as_they_are = Scan.load(tmp_path / "scan.npy", units=None)
    assert np.allclose(check_units(as_they_are, DIAGONAL, "auto").points, metres)


def test_a_model_without_size_raises() -> None:
    with pytest.raises(ScanError, match=r"size 0\.0 m"):
        check_units(Scan(surface(1.0, 100)), 0.0)


def test_an_unknown_unit_raises(tmp_path) -> None:  # type: ignore[no-untyped-def]
    np.save(tmp_path / "scan.npy", surface(1.0, 100))
    with pytest.raises(ScanError, match="unknown unit 'inch'; valid: m, cm, mm, in, ft, None to keep the numbers"):
        Scan.load(tmp_path / "scan.npy", units="inch")  # type: ignore[arg-type]


@pytest.mark.parametrize(("unit", "metres"), [("cm", 0.01), ("in", 0.0254)])
def test_other_units_are_told_too(unit: str, metres: float, tmp_path: Path) -> None:
    np.save(tmp_path / "scan.npy", surface(DIAGONAL / metres, 2000))
    scan = Scan.load(tmp_path / "scan.npy", units=None)
    assert likely_unit(scan, DIAGONAL) == unit
    with pytest.raises(UnitError, match=f"--units {unit}"):
        check_units(scan, DIAGONAL)
    assert Scan.load(tmp_path / "scan.npy", units=unit).diagonal == pytest.approx(DIAGONAL, rel=0.01)  # type: ignore[arg-type]


def test_feet_are_taken_where_they_are_named(tmp_path: Path) -> None:
    """A scan in feet is three times as large as it should be, as many a room about the model is."""
    np.save(tmp_path / "scan.npy", surface(DIAGONAL / 0.3048, 2000))
    assert likely_unit(Scan.load(tmp_path / "scan.npy"), DIAGONAL) == "m"
    assert Scan.load(tmp_path / "scan.npy", units="ft").diagonal == pytest.approx(DIAGONAL, rel=0.01)


def test_a_scan_that_cannot_be_in_the_unit_named() -> None:
    scan = Scan(surface(DIAGONAL, 600))
    with pytest.raises(UnitError, match=r"--units m$") as caught:
        check_named_unit(scan, DIAGONAL, "mm")
    assert caught.value.scale == 1.0
    check_named_unit(scan, DIAGONAL, "m")
    check_named_unit(Scan(surface(30.0 * DIAGONAL, 600)), DIAGONAL, "mm")


@pytest.mark.parametrize(
    ("ratio", "units"), [(1.0, ()), (3.28, ("ft",)), (39.4, ("in",)), (100.0, ("cm",)), (1e3, ("mm",))]
)
def test_the_units_in_which_a_scan_is_of_the_model_alone(ratio: float, units: tuple[str, ...]) -> None:
    assert units_of_it_alone(Scan(surface(ratio * DIAGONAL, 600)), DIAGONAL)[:1] == units


def test_feet_are_read_and_noted_but_not_taken_for_granted(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    np.save(tmp_path / "scan.npy", surface(DIAGONAL / 0.3048, 2000))
    scan = Scan.load(tmp_path / "scan.npy")
    assert check_units(scan, DIAGONAL) is scan  # many a metric scene is as large
    with caplog.at_level(logging.INFO, logger="pwralign_kin"):
        note_of_unit(scan, DIAGONAL)
    assert "3.3 times as large as the model" in caplog.text and "--units ft" in caplog.text
    assert Scan.load(tmp_path / "scan.npy", units="ft").diagonal == pytest.approx(DIAGONAL, rel=0.01)


def test_nothing_is_noted_of_a_depth_image_or_where_no_other_unit_fits(caplog: pytest.LogCaptureFixture) -> None:
    image = Scan.from_depth(np.full((48, 64), 2.6), (60.0, 60.0, 31.5, 23.5))
    assert units_of_it_alone(image, DIAGONAL)
    with caplog.at_level(logging.INFO, logger="pwralign_kin"):
        note_of_unit(image, DIAGONAL)
        note_of_unit(Scan(surface(12.0 * DIAGONAL, 600)), DIAGONAL)
    assert not caplog.text


def test_no_other_unit_is_noted_of_a_scan_whose_unit_was_told(caplog: pytest.LogCaptureFixture) -> None:
    scan = Scan(surface(3300.0 * DIAGONAL, 5000)).scaled(1e-3)
    assert units_of_it_alone(scan, DIAGONAL)
    with caplog.at_level(logging.INFO, logger="pwralign_kin"):
        note_of_unit(scan, DIAGONAL)
        note_of_unit(scan.cropped([-1e9] * 3, [1e9] * 3), DIAGONAL)
    assert not caplog.text
