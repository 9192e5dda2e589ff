"""A picture of the aligned model over the scan, with what a reader needs to judge it."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pwralign_kin import files
from pwralign_kin.estimation.result import Estimate
from pwralign_kin.model import ArticulatedModel
from pwralign_kin.render import (
    POINT_FAR,
    POINT_NEAR,
    Drawing,
    PosedMesh,
    View,
    default_views,
    drawable,
    drawing,
    frame_of,
    overview,
    refitted,
    splat,
    stripes,
)
from pwralign_kin.scan import Scan
from pwralign_kin.se3 import Array

if TYPE_CHECKING:
    from PIL.Image import Image as Picture
    from PIL.ImageDraw import ImageDraw

WIDTH = 1600
_HIGHEST, _LOWEST = 900, 360

_INK, _PALE, _HAIR, _BOX = (38, 40, 48), (140, 142, 150), (222, 223, 228), (205, 32, 31)
_MARGIN, _ROW = 36, 30
_HEADER = 104
_INSET = (224, 164)
_DOT = 1.2

SCENE = 0.5
"""A scan of which the model takes a smaller share is a scene: an inset shows all of it."""


def write_overlay(
    path: Path, model: ArticulatedModel, estimate: Estimate, mesh: PosedMesh, scan: Scan, up: Array
) -> None:
    """Write a PNG: two views of the posed model and the scan points, figures, and the parts' colours.

    Parts whose joint the scan does not tell are hatched; where most of the scan is of other things, a small
    picture shows all of it. The first view is from the sensor, if the estimate believes where that was. `up` (3,)
    points upwards in the pictures, scan frame.
    """
    from PIL import Image

    scan = scan if estimate.viewpoint_known else scan.without_sensor_origin()
    points = drawable(scan, mesh)
    views = default_views(mesh, points, size=(500, 500), up=up)
    sizes = _panel_sizes(mesh, views)
    fitted = [refitted(view, mesh, size) for view, size in zip(views, sizes, strict=True)]
    unsure = _undetermined_parts(model, estimate)
    panels = [
        drawing(mesh, view, points, size=size, striped=unsure, dot=_DOT)
        for view, size in zip(fitted, sizes, strict=True)
    ]
    picture = np.concatenate([panel.image for panel in panels], axis=0 if sizes[0][0] == WIDTH else 1)
    entries = _legend(estimate, mesh, panels, unsure)
    rows = _flow(entries)
    header = _HEADER + (_INSET[1] - 54 if estimate.scan_coverage < SCENE else 0)
    height = header + len(picture) + _MARGIN // 2 + _ROW * len(rows) + _MARGIN
    canvas = Image.new("RGB", (WIDTH, height), "white")
    canvas.paste(Image.fromarray(picture), (0, header))
    pen = _pen(canvas)
    right, bottom = sizes[0]
    beside = right < WIDTH
    edge = (right, 0, right, bottom) if beside else (_MARGIN, bottom, WIDTH - _MARGIN, bottom)
    pen.line((edge[0], header + edge[1], edge[2], header + edge[3]), fill=_HAIR)
    _write(pen, (_MARGIN, 28), model.name, 30, _INK)
    _write(pen, (_MARGIN, 68), _figures(estimate, scan), 19, _PALE)
    if estimate.scan_coverage < SCENE:
        _paste_inset(canvas, pen, mesh, points, fitted[0])
    for number, row in enumerate(rows):
        top = header + len(picture) + _MARGIN // 2 + _ROW * number
        for left, entry in row:
            _write_entry(canvas, pen, left, top, entry)
    with files.atomic_write(path) as temporary:
        canvas.save(temporary, format="PNG", compress_level=4)


@dataclass(frozen=True)
class Entry:
    """A line of the legend."""

    text: str
    colour: Array
    dot: bool = False
    hatched: bool = False
    pale: bool = False


def _undetermined_parts(model: ArticulatedModel, estimate: Estimate) -> set[int]:
    """Return the parts that the scan does not place beside what carries them: a joint between is undetermined.

    Parts without geometry only stand between two joints of one place.
    """
    unknown = {model.joint_names.index(name) for name in estimate.undetermined}
    unsure: set[int] = set()
    for index, part in enumerate(model.parts):
        if part.joint is None:
            continue
        carried = part.parent in unsure and not len(model.parts[part.parent].faces)
        if carried or part.joint.actuated in unknown:
            unsure.add(index)
    return unsure


def _paste_inset(canvas: Picture, pen: ImageDraw, mesh: PosedMesh, scan: Scan, view: View) -> None:
    """Show the whole scan in the upper right corner, with a box around the model."""
    from PIL import Image

    left, top = WIDTH - _MARGIN - _INSET[0], 24
    whole = overview(scan.points, view, _INSET)
    canvas.paste(Image.fromarray(splat(scan.points, whole, _INSET)), (left, top))
    pen.rounded_rectangle((left - 1, top - 1, left + _INSET[0], top + _INSET[1]), radius=6, outline=_PALE)
    west, north, east, south = frame_of(mesh, whole, _INSET)
    box = (
        left + max(west - 4, 1), top + max(north - 4, 1),
        left + min(east + 4, _INSET[0] - 2), top + min(south + 4, _INSET[1] - 2),
    )  # fmt: skip
    if box[0] < box[2] and box[1] < box[3]:
        pen.rectangle(box, outline=_BOX, width=2)
    _write(pen, (left, top + _INSET[1] + 4), "the whole scan", 15, _PALE)


def _write_entry(canvas: Picture, pen: ImageDraw, left: int, top: int, entry: Entry) -> None:
    from PIL import Image

    if entry.dot:
        pen.ellipse((left + 5, top + 4, left + 13, top + 12), fill=_bytes(entry.colour))
    elif entry.hatched:
        side = np.arange(18, dtype=np.float32)
        share = stripes(np.stack(np.meshgrid(side, side), axis=-1))[..., None]
        swatch = np.rint(255.0 * (entry.colour + share * (1.0 - entry.colour))).astype(np.uint8)
        mask = Image.new("L", (18, 18), 0)
        _pen(mask).rounded_rectangle((0, 0, 17, 17), radius=4, fill=255)
        canvas.paste(Image.fromarray(swatch), (left, top), mask)
    else:
        pen.rounded_rectangle((left, top, left + 17, top + 17), radius=4, fill=_bytes(entry.colour))
    _write(pen, (left + 25, top - 1), entry.text, 16, _PALE if entry.pale else _INK)


def _legend(estimate: Estimate, mesh: PosedMesh, panels: Sequence[Drawing], unsure: Collection[int]) -> list[Entry]:
    """Return the entries: parts with geometry, and the dots that there are."""
    exists = np.bincount(mesh.face_part, minlength=len(mesh.parts)) > 0
    shown = np.any([panel.shown for panel in panels], axis=0)
    entries = []
    for index in np.flatnonzero(exists):
        name = mesh.parts[index]
        part = estimate.parts.get(name)
        remarks = [] if part is not None and part.points > 0 else ["no points"]
        remarks += ["joint undetermined"] if index in unsure else []
        remarks += [] if shown[index] else ["hidden here"]
        text = f"{name} ({', '.join(remarks)})" if remarks else name
        entries.append(Entry(text, mesh.colours[index], hatched=index in unsure, pale=bool(remarks)))
    if any(panel.near for panel in panels):
        entries.append(Entry("scan point on the model", POINT_NEAR, dot=True))
    if any(panel.far for panel in panels):
        entries.append(Entry("scan point off it", POINT_FAR, dot=True))
    return entries


def _flow(entries: list[Entry]) -> list[list[tuple[int, Entry]]]:
    """Return the entries with their left edges, in rows of even columns as wide as the longest entry."""
    from PIL import ImageFont

    font = ImageFont.load_default(16)
    widest = max(font.getlength(entry.text) for entry in entries)
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


def _panel_sizes(mesh: PosedMesh, views: Sequence[View]) -> list[tuple[int, int]]:
    """Return the sizes of the panels, as high as what they show: one above the other if both are wide, else beside."""
    shapes = []
    for view in views:
        left, top, right, bottom = frame_of(mesh, view, (500, 500))
        shapes.append(float(np.clip((right - left) / max(bottom - top, 1e-9), 0.3, 10.0)))
    if min(shapes) > 1.8:
        return [(WIDTH, _height(WIDTH / shape)) for shape in shapes]
    width = round(WIDTH * float(np.clip(shapes[0] / sum(shapes), 0.3, 0.7)))
    height = _height(max(width / shapes[0], (WIDTH - width) / shapes[1]))
    return [(width, height), (WIDTH - width, height)]


def _height(wanted: float) -> int:
    return round(float(np.clip(wanted, _LOWEST, _HIGHEST)))


def _pen(image: Picture) -> ImageDraw:
    from PIL import ImageDraw

    return ImageDraw.Draw(image)


def _write(pen: ImageDraw, place: tuple[int, int], text: str, size: int, ink: tuple[int, int, int]) -> None:
    from PIL import ImageFont

    pen.text(place, text, fill=ink, font=ImageFont.load_default(size))


def _bytes(colour: Array) -> tuple[int, ...]:
    return tuple(np.rint(255.0 * colour).astype(int).tolist())
