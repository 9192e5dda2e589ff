"""Writes points or a mesh as a binary PLY."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pwralign_kin import files
from pwralign_kin.exceptions import ExportError
from pwralign_kin.scan.ply import ORIGIN_COMMENT

_PLY_TYPES = {
    "i1": "char", "u1": "uchar", "i2": "short", "u2": "ushort",
    "i4": "int", "u4": "uint", "f4": "float", "f8": "double",
}  # fmt: skip


def write_ply(
    path: Path | str,
    points: ArrayLike,
    properties: Mapping[str, ArrayLike] | None = None,
    faces: ArrayLike | None = None,
    sensor_origin: ArrayLike | None = None,
) -> None:
    """Write a binary little-endian PLY, whole or not at all.

    `points` (n, 3) are stored as float where they come as float32, else as double. `properties` maps names to
    one value per point (n,), stored in their own type; booleans become uchar and 64-bit integers int, PLY
    having no wider. Viewers know the names nx, ny, nz (normals) and red, green, blue (uchar). `faces` (f, 3)
    are point indices. `sensor_origin` (3,) is where the points were seen from, a comment that `Scan.load` reads.

    Raises `ExportError` for arrays that do not fit together and when the file cannot be written.
    """
    xyz = np.asarray(points)
    if xyz.ndim != 2 or xyz.shape[1] != 3:
        raise ExportError(path, f"points must have the shape (n, 3), got {xyz.shape}")
    if xyz.dtype != np.float32:
        xyz = xyz.astype(np.float64)
    columns: dict[str, NDArray[np.generic]] = dict(zip("xyz", xyz.T, strict=True))
    for name, values in (properties or {}).items():
        column = _storable(np.asarray(values), name, path)
        if column.shape != (len(xyz),):
            raise ExportError(path, f"property {name} must have the shape ({len(xyz)},), got {column.shape}")
        if name in columns or not name.isidentifier():
            raise ExportError(path, f"property name {name!r} is taken or not one plain word")
        columns[name] = column

    vertices = np.empty(len(xyz), dtype=[(name, column.dtype.newbyteorder("<")) for name, column in columns.items()])
    for name, column in columns.items():
        vertices[name] = column
    header = ["ply", "format binary_little_endian 1.0"]
    if sensor_origin is not None:
        header.append(" ".join(["comment", ORIGIN_COMMENT, *map(repr, np.asarray(sensor_origin, float).tolist())]))
    header.append(f"element vertex {len(xyz)}")
    header += [f"property {_PLY_TYPES[column.dtype.str[1:]]} {name}" for name, column in columns.items()]
    records = [vertices]
    if faces is not None:
        header += [f"element face {len(np.asarray(faces))}", "property list uchar int vertex_indices"]
        records.append(_face_records(np.asarray(faces), len(xyz), path))
    header.append("end_header\n")
    with files.atomic_write(path) as temporary, temporary.open("wb") as file:
        file.write("\n".join(header).encode("ascii"))
        for rows in records:
            file.write(rows.data)


def _storable(column: NDArray[np.generic], name: str, path: Path | str) -> NDArray[np.generic]:
    if column.dtype.kind == "b":
        return column.astype(np.uint8)
    if column.dtype.kind in "iu" and column.dtype.itemsize == 8:
        if column.size and not (int(column.min()) >= -(2**31) and int(column.max()) < 2**31):
            raise ExportError(path, f"property {name} has integers beyond 32 bits")
        return column.astype(np.int32)
    if column.dtype.str[1:] not in _PLY_TYPES:
        raise ExportError(path, f"property {name} has the type {column.dtype}, which PLY cannot hold")
    return column


def _face_records(faces: NDArray[np.generic], count: int, path: Path | str) -> NDArray[np.void]:
    if faces.ndim != 2 or faces.shape[1] != 3 or faces.dtype.kind not in "iu":
        raise ExportError(path, f"faces must be integers of shape (f, 3), got {faces.dtype} of shape {faces.shape}")
    if faces.size and not (int(faces.min()) >= 0 and int(faces.max()) < count):
        raise ExportError(path, f"faces name points outside 0..{count - 1}")
    records = np.empty(len(faces), dtype=[("corners", "u1"), ("indices", "<i4", 3)])
    records["corners"] = 3
    records["indices"] = faces
    return records
