"""The page for people: it tells what the files tell, and stands by itself."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from boxbot import estimate_from, scan_of

from pwralign_kin.cli.codes import ENOUGH_CONFIDENCE
from pwralign_kin.estimation.result import Alternative, Estimate
from pwralign_kin.export.deviation import part_figures
from pwralign_kin.export.report import DOUBTFUL, write_report
from pwralign_kin.model import ArticulatedModel
from pwralign_kin.scan import Scan
from pwralign_kin.state import State


@pytest.fixture
def picture(tmp_path: Path) -> Path:
    (tmp_path / "overlay.png").write_bytes(b"a picture")
    return tmp_path / "overlay.png"


def _report(model: ArticulatedModel, estimate: Estimate, scan: Scan, picture: Path) -> str:
    labels = estimate.scan_labels[scan.source_index]
    figures = part_figures(np.full(len(scan), 0.00125), labels, len(model.parts))
    write_report(picture.with_name("report.html"), model, estimate, scan, figures, picture)
    return picture.with_name("report.html").read_text(encoding="utf-8")


def _rows(page: str) -> dict[str, list[str]]:
    """The text of the cells of each row, by the first."""
    rows = [re.findall(r"<td[^>]*>(.*?)</td>", row) for row in page.split("<tr>")]
    return {row[0]: row[1:] for row in rows if row}


def test_joints_and_distances_are_told_in_degrees_and_mm(
    bot: ArticulatedModel, bot_state: State, picture: Path
) -> None:
    scan, labels = scan_of(bot, bot_state)
    estimate = estimate_from(bot, bot_state, labels)
    rows = _rows(_report(bot, estimate, scan, picture))
    assert set(bot.joint_names) <= set(rows)
    for name, value in bot_state.joints.items():
        scale, unit = (180.0 / np.pi, "°") if estimate.units[name] == "rad" else (1e3, " mm")
        assert f"{scale * value:.2f}{unit}" in rows[name][0]
        assert ("pale" in rows[name][0]) == (name in estimate.undetermined)
        assert (rows[name][1] == "undetermined") == (name in estimate.undetermined)
    assert rows["arm"][1:] == ["1.25 mm"] * 4


def test_the_page_loads_nothing_and_names_are_no_markup(bot: ArticulatedModel, bot_state: State, picture: Path) -> None:
    scan, labels = scan_of(bot, bot_state)
    named = Scan(scan.points, source="<script>.ply")
    page = _report(bot, estimate_from(bot, bot_state, labels[scan.source_index]), named, picture)
    assert "<script" not in page and "&lt;script&gt;.ply" in page
    assert re.findall(r'(?:src|href)="([^"]{,21})', page) == ["data:image/png;base64"]
    assert "://" not in page


def test_doubt_is_told(bot: ArticulatedModel, bot_state: State, picture: Path) -> None:
    scan, labels = scan_of(bot, bot_state)
    estimate = estimate_from(bot, bot_state, labels)
    assert "Do not rely" not in _report(bot, estimate, scan, picture)
    other = Alternative(bot_state, estimate.cost, equal=True)
    doubtful = replace(estimate, confidence=DOUBTFUL - 0.01, undetermined=("wrist",), alternatives=(other,))
    page = _report(bot, doubtful, scan, picture)
    assert "Do not rely" in page and "does not tell wrist" in page and "One other answer" in page
    assert DOUBTFUL == ENOUGH_CONFIDENCE
