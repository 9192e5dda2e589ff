"""Reads PLY (ascii, binary little- and big-endian) with every count checked against the file's length."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pwralign_kin.exceptions import ScanError
from pwralign_kin.scan.content import FileContent, fans
from pwralign_kin.se3 import Array

_TYPES = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2",
    "int": "i4", "uint": "u4", "float": "f4", "double": "f8",
    "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4",
    "float32": "f4", "float64": "f8",
}  # fmt: skip

_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}


ORIGIN_COMMENT = "sensor_origin"
"""First word of the comment that tells where the points were seen from; x, y and z follow."""


@dataclass(frozen=True)
class _Property:
    name: str
    kind: str
    """NumPy code of the value."""
    counted_by: str | None
    """NumPy code of the length of a list; None for a scalar."""


@dataclass(frozen=True)
class _Element:
    name: str
    count: int
    properties: tuple[_Property, ...]

    @property
    def has_lists(self) -> bool:
        return any(prop.counted_by for prop in self.properties)


_MAX_LIST = 1_000_000
"""No polygon has more corners; keeps a corrupt length from becoming a huge record type."""

Column = NDArray[np.generic] | list[NDArray[np.generic]]
"""Values of a property: (n,) scalars, (n, k) lists of equal length k, or n lists of unequal length."""


def read_ply(data: bytes, path: Path) -> FileContent:
    """Return the vertices of the PLY file content `data`, with normals, triangulated faces and a sensor origin where it
    has them.

    Raises `ScanError` naming `path` for a malformed header, an unknown type, or less data than announced.
    """
    order, elements, offset, origin = _header(data, path)
    if order:
        columns = _binary_elements(data, offset, order, elements, path)
    else:
        columns = _ascii_elements(data[offset:], elements, path)
    if "vertex" not in columns:
        raise ScanError(path, "the PLY file has no element vertex")
    vertex = columns["vertex"]
    points = _stacked(vertex, ("x", "y", "z"))
    if points is None:
        raise ScanError(path, "the PLY vertices have no x, y, z")
    face = columns.get("face", {})
    corners = face.get("vertex_indices", face.get("vertex_index"))
    faces = None if corners is None or len(corners) == 0 else _triangles(corners, len(points), path)
    return FileContent(points=points, normals=_stacked(vertex, ("nx", "ny", "nz")), faces=faces, sensor_origin=origin)


def _header(data: bytes, path: Path) -> tuple[str, list[_Element], int, Array | None]:
    """Return the byte order ("" for ascii), the elements, where the body begins, and the sensor origin (3,)."""
    if not data.startswith((b"ply\n", b"ply\r")):
        raise ScanError(path, "not a PLY file: it does not begin with the line ply")
    end = data.find(b"\nend_header")
    newline = data.find(b"\n", end + 1)
    if end < 0 or newline < 0:
        raise ScanError(path, "truncated: the PLY header has no end")
    order: str | None = None
    elements: list[_Element] = []
    origin: Array | None = None
    for line in data[:end].decode("ascii", errors="replace").splitlines()[1:]:
        words = line.split()
        match words:
            case ["comment", word, *numbers] if word == ORIGIN_COMMENT and len(numbers) == 3:
                try:
                    origin = np.array(numbers, np.float64)
                except ValueError:
                    raise ScanError(path, f"PLY header line not understood: {line.strip()[:80]!r}") from None
            case [] | ["comment" | "obj_info", *_]:
                continue
            case ["format", form, _] if form in _ORDERS:
                order = _ORDERS[form]
            case ["element", name, count] if count.isdigit():
                elements.append(_Element(name, int(count), ()))
            case ["property", "list", counter, kind, name] if (
                elements and _TYPES.get(counter, "f")[0] != "f" and kind in _TYPES
            ):
                _append(elements, _Property(name, _TYPES[kind], _TYPES[counter]))
            case ["property", kind, name] if elements and kind in _TYPES:
                _append(elements, _Property(name, _TYPES[kind], None))
            case _:
                raise ScanError(path, f"PLY header line not understood: {line.strip()[:80]!r}")
    if order is None:
        raise ScanError(path, "the PLY header names no format")
    bare = [element.name for element in elements if not element.properties]
    if bare:
        raise ScanError(path, f"the PLY element {bare[0]!r} has no properties")
    return order, elements, newline + 1, origin


def _append(elements: list[_Element], prop: _Property) -> None:
    last = elements[-1]
    elements[-1] = _Element(last.name, last.count, (*last.properties, prop))


def _truncated(element: _Element, path: Path) -> ScanError:
    return ScanError(
        path, f"truncated: fewer than the {element.count} elements {element.name!r} that the header announces"
    )


def _binary_elements(
    data: bytes, offset: int, order: str, elements: list[_Element], path: Path
) -> dict[str, dict[str, Column]]:
    columns: dict[str, dict[str, Column]] = {}
    for element in elements:
        lengths = _first_lengths(data, offset, order, element, path)
        record = _record_type(order, element, lengths)
        size = element.count * record.itemsize
        fits = offset + size <= len(data)
        if not fits and not element.has_lists:
            raise _truncated(element, path)
        records = np.frombuffer(data, record, element.count, offset) if fits else np.empty(0, record)
        if fits and all((records[f"count {i}"] == length).all() for i, length in lengths.items()):
            columns[element.name] = {prop.name: records[f"value {i}"] for i, prop in enumerate(element.properties)}
            offset += size
        else:
            columns[element.name], offset = _ragged_records(data, offset, order, element, path)
    return columns


def _first_lengths(data: bytes, offset: int, order: str, element: _Element, path: Path) -> dict[int, int]:
    """Return the length of every list property in the first record, by the property's index."""
    lengths: dict[int, int] = {}
    if element.count == 0:
        return {index: 0 for index, prop in enumerate(element.properties) if prop.counted_by}
    for index, prop in enumerate(element.properties):
        if prop.counted_by:
            lengths[index], offset = _list_length(data, offset, order + prop.counted_by, element, path)
        offset += lengths.get(index, 1) * np.dtype(prop.kind).itemsize
    return lengths


def _list_length(data: bytes, offset: int, counter: str, element: _Element, path: Path) -> tuple[int, int]:
    """Return the list length stored at `offset`, and the offset behind it."""
    kind = np.dtype(counter)
    if offset + kind.itemsize > len(data):
        raise _truncated(element, path)
    length = int(np.frombuffer(data, kind, 1, offset)[0])
    if not 0 <= length <= _MAX_LIST:
        raise ScanError(path, f"a list in element {element.name!r} has the impossible length {length}")
    return length, offset + kind.itemsize


def _record_type(order: str, element: _Element, lengths: dict[int, int]) -> np.dtype[np.void]:
    fields: list[tuple[str, str] | tuple[str, str, tuple[int]]] = []
    for index, prop in enumerate(element.properties):
        if prop.counted_by:
            fields += [
                (f"count {index}", order + prop.counted_by),
                (f"value {index}", order + prop.kind, (lengths[index],)),
            ]
        else:
            fields.append((f"value {index}", order + prop.kind))
    return np.dtype(fields)


def _ragged_records(
    data: bytes, offset: int, order: str, element: _Element, path: Path
) -> tuple[dict[str, Column], int]:
    """Read records whose lists differ in length, one by one."""
    values: dict[str, list[NDArray[np.generic]]] = {prop.name: [] for prop in element.properties}
    for _ in range(element.count):
        for prop in element.properties:
            length = 1
            if prop.counted_by:
                length, offset = _list_length(data, offset, order + prop.counted_by, element, path)
            kind = np.dtype(order + prop.kind)
            if offset + length * kind.itemsize > len(data):
                raise _truncated(element, path)
            values[prop.name].append(np.frombuffer(data, kind, length, offset))
            offset += length * kind.itemsize
    return _joined(element, values), offset


def _ascii_elements(body: bytes, elements: list[_Element], path: Path) -> dict[str, dict[str, Column]]:
    lines = [line for line in body.decode("ascii", errors="replace").splitlines() if line.strip()]
    columns: dict[str, dict[str, Column]] = {}
    start = 0
    for element in elements:
        rows = lines[start : start + element.count]
        if len(rows) < element.count:
            raise _truncated(element, path)
        start += element.count
        try:
            columns[element.name] = _ascii_rows(element, rows)
        except (ValueError, IndexError) as error:
            raise ScanError(path, f"malformed row in element {element.name!r}: {error}") from None
    return columns


def _ascii_rows(element: _Element, rows: list[str]) -> dict[str, Column]:
    if not element.has_lists:
        width = len(element.properties)
        table = np.loadtxt(rows, ndmin=2, comments=None) if rows else np.empty((0, width))
        if table.shape[1] != width:
            raise ValueError(f"{table.shape[1]} values where {width} are announced")
        return {prop.name: table[:, index] for index, prop in enumerate(element.properties)}
    values: dict[str, list[NDArray[np.generic]]] = {prop.name: [] for prop in element.properties}
    for row in rows:
        words = iter(row.split())
        for prop in element.properties:
            length = int(next(words, "missing")) if prop.counted_by else 1
            numbers = [float(next(words, "missing")) for _ in range(length)]
            values[prop.name].append(np.array(numbers))
    return _joined(element, values)


def _joined(element: _Element, values: dict[str, list[NDArray[np.generic]]]) -> dict[str, Column]:
    return {
        prop.name: values[prop.name] if prop.counted_by else np.concatenate([np.empty(0), *values[prop.name]])
        for prop in element.properties
    }


def _stacked(vertex: dict[str, Column], names: tuple[str, str, str]) -> Array | None:
    if any(name not in vertex or isinstance(vertex[name], list) for name in names):
        return None
    return np.stack([np.asarray(vertex[name], dtype=np.float64) for name in names], axis=-1)


def _triangles(corners: Column, count: int, path: Path) -> NDArray[np.int64]:
    """Return the polygons `corners` as fans of triangles."""
    if isinstance(corners, list):
        triangles = [polygon[[0, i, i + 1]] for polygon in corners for i in range(1, len(polygon) - 1)]
        indices = np.array(triangles, dtype=np.float64).reshape(-1, 3)
    else:
        if corners.ndim != 2:
            raise ScanError(path, "the PLY faces are no lists of vertex indices")
        indices = fans(corners.astype(np.float64))
    if not ((indices >= 0) & (indices < count)).all():
        raise ScanError(path, f"faces name vertices outside 0..{count - 1}")
    return indices.astype(np.int64)
