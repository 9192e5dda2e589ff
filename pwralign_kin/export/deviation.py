"""The signed distances of all scan points to the model, as a coloured cloud and as a table per part."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pwralign_kin import files
from pwralign_kin.arrays import Indices
from pwralign_kin.render import PosedMesh
from pwralign_kin.scan import write_ply
from pwralign_kin.se3 import Array

COLOUR_RANGE = 0.01
"""Distance at which the colours saturate, relative to the model's diagonal."""
INSIDE, ON, OUTSIDE = np.array([[33, 102, 220], [222, 222, 218], [205, 32, 31]], dtype=np.float64)
"""Colours of points behind, on and in front of the surface."""
NOT_OF_THE_MODEL = np.array([90, 90, 90], dtype=np.float64)
_LEVELS = 255
"""Of colour, on either side."""


def write_deviation_ply(path: Path, points: Array, distances: Array, labels: Indices, mesh: PosedMesh) -> None:
    """Write the scan points with the properties `distance` (m), `part` (-1: not the model's) and a colour.

    Colours run from blue (behind the surface) over light grey to red (in front of it) and saturate at 1% of
    the model's diagonal; points that are not the model's are dark grey. Coordinates are single precision where
    that rounds them by less than a thousandth of this range.
    """
    share = np.linspace(-1.0, 1.0, 2 * _LEVELS + 1)[:, None]
    colours = ON + np.where(share > 0.0, share * (OUTSIDE - ON), -share * (INSIDE - ON))
    table = np.rint(np.concatenate([colours, NOT_OF_THE_MODEL[None]])).astype(np.uint8)
    level = np.rint(_LEVELS * np.clip(distances / (COLOUR_RANGE * mesh.diagonal), -1.0, 1.0)).astype(np.int64) + _LEVELS
    level[labels < 0] = len(table) - 1
    properties: Mapping[str, NDArray[Any]] = {
        "distance": distances.astype(np.float32),
        "part": labels,
        **dict(zip(("red", "green", "blue"), table.T[:, level], strict=True)),
    }
    rounded = np.abs(points).max(initial=0.0) * np.finfo(np.float32).eps / 2.0
    single = rounded < 1e-3 * COLOUR_RANGE * mesh.diagonal
    write_ply(path, points.astype(np.float32) if single else points, properties)


@dataclass(frozen=True)
class Figures:
    """The signed distances (m) of the scan points of one part."""

    points: int
    mean: float
    rms: float
    max_abs: float
    """The largest without its sign."""
    p95_abs: float
    """The 95th percentile of them without their signs."""


def part_figures(distances: Array, labels: Indices, count: int) -> list[Figures | None]:
    """Return the figures of each of `count` parts, None where no point is on it."""
    several = (distances[labels == index] for index in range(count))
    return [_figures(own) if len(own) else None for own in several]


def write_deviation_table(path: Path, figures: Sequence[Figures | None], parts: Sequence[str]) -> None:
    """Write a CSV with a row per part: number, name, and the signed distances (m) of its scan points."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["part", "name", "points", "mean", "rms", "max_abs", "p95_abs"])
    for index, (name, own) in enumerate(zip(parts, figures, strict=True)):
        lengths = () if own is None else (own.mean, own.rms, own.max_abs, own.p95_abs)
        cells = [f"{length:.6g}" for length in lengths] or [""] * 4
        writer.writerow([index, name, 0 if own is None else own.points, *cells])
    files.write_text(path, text.getvalue())


def _figures(distances: Array) -> Figures:
    size = np.abs(distances)
    return Figures(
        points=len(size),
        mean=float(distances.mean()),
        rms=float(np.sqrt(np.mean(size**2))),
        max_abs=float(size.max()),
        p95_abs=float(np.percentile(size, 95)),
    )
