"""What size costs: measured in processes of its own, the slope of a power recovered."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pwralign_kin.benchmark import cost
from pwralign_kin.benchmark.chains import chain, knobbly
from pwralign_kin.model import ArticulatedModel


def test_small_sizes_are_measured() -> None:
    sizes = {"parts": replace(cost.SIZES["parts"], sizes=(2,))}
    lines: list[str] = []
    measured = cost.measure(1, lines.append, sizes)
    (own,) = measured["parts"]
    assert own.size == 2 and own.seconds["whole"] >= own.seconds["search"] > 0
    assert 50 < own.idle <= own.peak < 3000
    assert len(lines) == 1 and "parts 2:" in lines[0]
    assert "| 2 |" in cost.tables(measured)


def test_slope_and_the_large_scan() -> None:
    def own(size: int) -> cost.Cost:
        seconds = {"cleaning": 1e-6 * size, "search": 0.01 * size**0.5, "whole": 0.01 * size**0.5}
        return cost.Cost(size, seconds, 100.0, 200.0)

    costs = [own(size) for size in (1000, cost.USUAL, cost.LARGE)]
    assert cost.slope(costs, "cleaning") == pytest.approx(1.0)
    assert cost.slope(costs, "search") == pytest.approx(0.5)
    text = cost.tables({"points": costs})
    assert "| slope | 1.00 | 0.50 | 0.50 |" in text and "| slope, upper half | 1.00 | 0.50 | 0.50 |" in text
    assert "7.07 times" in text
    assert cost.pictures({"points": costs})["cost_points.png"].startswith(b"\x89PNG")


def test_memory_is_that_of_this_process() -> None:
    before = cost.memory()
    block = np.ones(25_000_000)  # 200 MB
    assert cost.memory() > before + 150 and cost.peak_memory() >= cost.memory() - 1
    del block


def test_chains(tmp_path: Path) -> None:
    (tmp_path / "chain.urdf").write_text(chain(5))
    model = ArticulatedModel.from_urdf(tmp_path / "chain.urdf")
    assert len(model.parts) == 5 and len(model.joint_names) == 4
    assert len(knobbly(5000, 0).faces) == pytest.approx(5000, rel=0.1)
