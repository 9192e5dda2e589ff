"""The signed distances of all scan points to the model, as a coloured cloud and as a table per part."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
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


def write_deviation_table(path: Path, distances: Array, labels: Indices, parts: Sequence[str]) -> None:
    """Write a CSV with a row per part: number, name, and the signed distances (m) of its scan points."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["part", "name", "points", "mean", "rms", "max_abs", "p95_abs"])
    for index, name in enumerate(parts):
        own = distances[labels == index]
        cells = [f"{figure:.6g}" for figure in _figures(own)] if len(own) else [""] * 4
        writer.writerow([index, name, len(own), *cells])
    files.write_text(path, text.getvalue())


def _figures(distances: Array) -> tuple[float, float, float, float]:
    """Return mean, root mean square, largest and 95th percentile of absolute values."""
    size = np.abs(distances)
    return (
        float(distances.mean()),
        float(np.sqrt(np.mean(size**2))),
        float(size.max()),
        float(np.percentile(size, 95)),
    )
