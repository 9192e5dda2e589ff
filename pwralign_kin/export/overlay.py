"""A picture of the aligned model over the scan, with what a reader needs to judge it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pwralign_kin import files
from pwralign_kin.estimation.result import Estimate
from pwralign_kin.render import POINT_FAR, POINT_NEAR, PosedMesh, View, default_views, draw
from pwralign_kin.scan import Scan
from pwralign_kin.se3 import Array

if TYPE_CHECKING:
    from PIL.ImageDraw import ImageDraw

WIDTH = 1600
_HIGH, _LOW = 820, 480

_INK, _PALE = (38, 40, 48), (140, 142, 150)
_MARGIN, _ROW = 36, 30
_HEADER = 104


def write_overlay(path: Path, name: str, estimate: Estimate, mesh: PosedMesh, scan: Scan, up: Array) -> None:
    """Write a PNG: two views of the posed model and the scan points, figures, and the parts' colours.

    `name` is the heading; `up` (3,) points upwards in the pictures, scan frame.
    """
    from PIL import Image, ImageDraw

    sizes = _panel_sizes(mesh, default_views(mesh, scan, size=(500, 500), up=up))
    views = [default_views(mesh, scan, size=size, up=up)[number] for number, size in enumerate(sizes)]
    panels = [draw(mesh, view, scan, size=size) for view, size in zip(views, sizes, strict=True)]
    picture = np.concatenate(panels, axis=0 if sizes[0][0] == WIDTH else 1)
    entries = _legend(estimate, mesh)
    rows = _flow(entries)
    height = _HEADER + len(picture) + _ROW * len(rows) + _MARGIN
    canvas = Image.new("RGB", (WIDTH, height), "white")
    canvas.paste(Image.fromarray(picture), (0, _HEADER))
    pen = ImageDraw.Draw(canvas)
    _write(pen, (_MARGIN, 28), name, 30, _INK)
    _write(pen, (_MARGIN, 68), _figures(estimate, scan), 19, _PALE)
    for number, row in enumerate(rows):
        for left, (text, colour, dot, ink) in row:
            top = _HEADER + len(picture) + _ROW * number + 6
            box = (left + 5, top + 4, left + 13, top + 12) if dot else (left, top, left + 17, top + 17)
            if dot:
                pen.ellipse(box, fill=colour)
            else:
                pen.rounded_rectangle(box, radius=4, fill=colour)
            _write(pen, (left + 25, top - 1), text, 16, ink)
    with files.atomic_write(path) as temporary:
        canvas.save(temporary, format="PNG")


Entry = tuple[str, tuple[int, ...], bool, tuple[int, int, int]]


def _legend(estimate: Estimate, mesh: PosedMesh) -> list[Entry]:
    """Return text, colour, whether it is a dot, and ink of every entry: parts with geometry, then dots."""
    shown = np.bincount(mesh.face_part, minlength=len(mesh.parts)) > 0
    entries: list[Entry] = []
    for name, colour in zip(np.array(mesh.parts)[shown], mesh.colours[shown], strict=True):
        part = estimate.parts.get(str(name))
        seen = part is not None and part.points > 0
        entries.append((str(name) if seen else f"{name} (no points)", _bytes(colour), False, _INK if seen else _PALE))
    entries.append(("scan point on the model", _bytes(POINT_NEAR), True, _INK))
    entries.append(("scan point off it", _bytes(POINT_FAR), True, _INK))
    return entries


def _flow(entries: list[Entry]) -> list[list[tuple[int, Entry]]]:
    """Return the entries with their left edges, in rows of even columns as wide as the longest entry."""
    from PIL import ImageFont

    font = ImageFont.load_default(16)
    widest = max(font.getlength(text) for text, *_ in entries)
    columns = max(1, int((WIDTH - 2 * _MARGIN) // (widest + 54)))
    step = (WIDTH - 2 * _MARGIN) // columns
    return [
        [(_MARGIN + step * column, entry) for column, entry in enumerate(entries[start : start + columns])]
        for start in range(0, len(entries), columns)
    ]


def _figures(estimate: Estimate, scan: Scan) -> str:
    figures = [
        f"confidence {estimate.confidence:.2f}",
        f"explains {estimate.scan_coverage:.1%} of {len(scan.points)} scan points",
    ]
    if np.isfinite(estimate.inlier_rmse):
        figures.append(f"inlier RMSE {1e3 * estimate.inlier_rmse:.2f} mm")
    if scan.sensor_origin is not None and np.ndim(scan.sensor_origin) == 1:
        figures.append("first picture: seen from the sensor")
    return "   ·   ".join(figures)


def _panel_sizes(mesh: PosedMesh, views: tuple[View, View]) -> list[tuple[int, int]]:
    """Return the sizes of the panels: one above the other if both views are wide, else side by side."""
    shapes = []
    for view in views:
        in_axes = (mesh.outline - view.eye) @ view.axes().T
        wide, high = np.ptp(in_axes[:, :2] / in_axes[:, 2:], axis=0)
        shapes.append(wide / max(high, 1e-9))
    if min(shapes) > 1.5:
        return [(WIDTH, _LOW), (WIDTH, _LOW)]
    first, second = np.sqrt(shapes)
    width = round(WIDTH * float(np.clip(first / (first + second), 0.35, 0.65)))
    return [(width, _HIGH), (WIDTH - width, _HIGH)]


def _write(pen: ImageDraw, place: tuple[int, int], text: str, size: int, ink: tuple[int, int, int]) -> None:
    from PIL import ImageFont

    pen.text(place, text, fill=ink, font=ImageFont.load_default(size))


def _bytes(colour: Array) -> tuple[int, ...]:
    return tuple(np.rint(255.0 * colour).astype(int).tolist())
