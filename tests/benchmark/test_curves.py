"""Curves: every level is measured with every method, and drawn."""

from __future__ import annotations

from dataclasses import replace

import pytest

from pwralign_kin.benchmark import curves
from pwralign_kin.benchmark.curves import BASELINE, CURVES, GUIDED, OURS, Point
from pwralign_kin.model import ArticulatedModel


def test_every_method_meets_every_level(twins: ArticulatedModel, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(curves, "CURVES", {"points": replace(CURVES["points"], levels=(400, 3))})
    lines: list[str] = []
    points = curves.measure([("twins", twins)], 1, 2, lines.append)
    assert [(point.level, point.method) for point in points] == [
        (level, method) for level in (400, 3) for method in (OURS, BASELINE, GUIDED)
    ]
    assert len(lines) == 6
    assert points[0].overlay and points[0].parts == 1.0 and points[0].gap == 0.0
    assert not any(point.fault for point in points[:3])
    assert all(point.fault.startswith("ScanError: ") and not point.overlay for point in points[3:])


def test_points_per_part_count_the_parts() -> None:
    curve = CURVES["points"]
    assert [curve.sensor(level, 7).points for level in curve.levels] == [7 * level for level in curve.levels]
    assert CURVES["missing"].sensor(0.4, 7).missing_share == 0.4
    assert CURVES["stray"].sensor(0.8, 7).stray == 0.8


def test_tables_and_pictures_show_all_points() -> None:
    points = [
        Point(model, "noise", level, 0, method, method == OURS, 1.0 if method == OURS else 0.5, 0.1, 1.0)
        for model in ("a", "b")
        for level in CURVES["noise"].levels
        for method in (OURS, BASELINE, GUIDED)
    ]
    table = curves.curves_table(points)
    assert "| noise (standard deviation) | 0.25% | 100% (2/2) | 100% | 0% (0/2) | 50% |" in table
    assert "| b | part-wise rigid | 0% (0/7) | 50% | 10.0% D | 1.00 s | 0 |" in curves.methods_table(points)
    pictures = curves.curve_pictures(points)
    assert set(pictures) == {"curves_noise.png"}
    assert pictures["curves_noise.png"].startswith(b"\x89PNG")
