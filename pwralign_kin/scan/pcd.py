"""Reads PCD (ascii, binary, binary_compressed) with every size checked before the data is touched."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pwralign_kin.exceptions import ScanError
from pwralign_kin.scan.content import FileContent
from pwralign_kin.se3 import Array

_TYPES = {
    ("I", "1"): "<i1", ("I", "2"): "<i2", ("I", "4"): "<i4", ("I", "8"): "<i8",
    ("U", "1"): "<u1", ("U", "2"): "<u2", ("U", "4"): "<u4", ("U", "8"): "<u8",
    ("F", "4"): "<f4", ("F", "8"): "<f8",
}  # fmt: skip

_MAX_COUNT = 1_000_000
"""No field has more values per point; keeps a corrupt COUNT from becoming a huge record type."""


@dataclass(frozen=True)
class _Field:
    name: str
    kind: str
    """NumPy code of a value."""
    count: int
    """Values per point."""

    @property
    def size(self) -> int:
        """Bytes per point."""
        return self.count * np.dtype(self.kind).itemsize


def read_pcd(data: bytes, path: Path) -> FileContent:
    """Return the points of the PCD file content `data`, with normals where it has them.

    VIEWPOINT is not taken for a sensor origin: nearly every writer leaves its default, also on fused clouds.
    Raises `ScanError` naming `path` for a malformed header or less data than announced.
    """
    fields, count, storage, offset = _header(data, path)
    names = [field.name for field in fields]
    if any(name not in names for name in "xyz"):
        raise ScanError(path, f"the PCD file has no fields x, y, z, only {', '.join(names)}")
    body = memoryview(data)[offset:]
    match storage:
        case "ascii":
            columns = _ascii_columns(bytes(body), fields, count, path)
        case "binary":
            columns = _interleaved_columns(body, fields, count, path)
        case _:
            columns = _compressed_columns(body, fields, count, path)
    points = np.stack([columns[name] for name in "xyz"], axis=-1)
    directions = ("normal_x", "normal_y", "normal_z")
    has_normals = all(name in columns for name in directions)
    normals = np.stack([columns[name] for name in directions], axis=-1) if has_normals else None
    return FileContent(points=points, normals=normals)


def _header(data: bytes, path: Path) -> tuple[list[_Field], int, str, int]:
    """Return the fields, the number of points, the storage, and where the body begins."""
    entries: dict[str, list[str]] = {}
    offset = 0
    while "DATA" not in entries:
        newline = data.find(b"\n", offset)
        if newline < 0:
            raise ScanError(path, "truncated or not a PCD file: no line DATA")
        words = data[offset:newline].decode("ascii", errors="replace").split()
        offset = newline + 1
        if words and not words[0].startswith("#"):
            entries[words[0]] = words[1:]
    names, sizes, types = (entries.get(key, []) for key in ("FIELDS", "SIZE", "TYPE"))
    counts = entries.get("COUNT", ["1"] * len(names))
    if not names or not len(names) == len(sizes) == len(types) == len(counts):
        raise ScanError(path, "malformed PCD header: FIELDS, SIZE, TYPE and COUNT do not match")
    fields = []
    for name, size, kind, count in zip(names, sizes, types, counts, strict=True):
        if (kind, size) not in _TYPES or not count.isdigit() or not 1 <= int(count) <= _MAX_COUNT:
            raise ScanError(path, f"malformed PCD header: field {name} of type {kind}, size {size}, count {count}")
        fields.append(_Field(name, _TYPES[kind, size], int(count)))
    storage = " ".join(entries["DATA"])
    if storage not in ("ascii", "binary", "binary_compressed"):
        raise ScanError(path, f"unknown PCD storage {storage!r}; valid: ascii, binary, binary_compressed")
    return fields, _point_count(entries, path), storage, offset


def _point_count(entries: dict[str, list[str]], path: Path) -> int:
    """Return the number of points: POINTS, or WIDTH times HEIGHT in old files."""
    numbers = {key: "".join(entries.get(key, [])) for key in ("POINTS", "WIDTH", "HEIGHT")}
    if numbers["POINTS"].isdigit():
        return int(numbers["POINTS"])
    if numbers["WIDTH"].isdigit() and numbers["HEIGHT"].isdigit():
        return int(numbers["WIDTH"]) * int(numbers["HEIGHT"])
    raise ScanError(path, "malformed PCD header: no number of points")


def _truncated(count: int, path: Path) -> ScanError:
    return ScanError(path, f"truncated: fewer than the {count} points that the header announces")


def _ascii_columns(body: bytes, fields: list[_Field], count: int, path: Path) -> dict[str, Array]:
    lines = [line for line in body.decode("ascii", errors="replace").splitlines() if line.strip()][:count]
    if len(lines) < count:
        raise _truncated(count, path)
    first = np.cumsum([0, *(field.count for field in fields)]).tolist()
    columns = [(field.name, start) for field, start in zip(fields, first, strict=False) if field.count == 1]
    try:
        table = np.loadtxt(lines, ndmin=2, comments=None, usecols=[start for _, start in columns])
    except ValueError as error:
        raise ScanError(path, f"malformed row: {error}") from None
    return {name: table[:, index] for index, (name, _) in enumerate(columns)}


def _interleaved_columns(body: memoryview, fields: list[_Field], count: int, path: Path) -> dict[str, Array]:
    record = np.dtype([(str(index), field.kind, (field.count,)) for index, field in enumerate(fields)])
    if count * record.itemsize > len(body):
        raise _truncated(count, path)
    records = np.frombuffer(body, record, count)
    return {field.name: records[str(index)][:, 0].astype(np.float64) for index, field in enumerate(fields)}


def _compressed_columns(body: memoryview, fields: list[_Field], count: int, path: Path) -> dict[str, Array]:
    """Return the columns of a body compressed by LZF, in which the fields follow each other, not the
    points."""
    if len(body) < 8:
        raise _truncated(count, path)
    packed_size, size = (int(number) for number in np.frombuffer(body, "<u4", 2))
    expected = count * sum(field.size for field in fields)
    if size != expected:
        raise ScanError(path, f"malformed: {size} bytes of points where the header announces {expected}")
    if len(body) < 8 + packed_size:
        raise _truncated(count, path)
    plain = _decompressed(bytes(body[8 : 8 + packed_size]), size)
    if plain is None:
        raise ScanError(path, "malformed: the compressed points do not unpack")
    columns: dict[str, Array] = {}
    offset = 0
    for field in fields:
        values: NDArray[np.generic] = np.frombuffer(plain, field.kind, count * field.count, offset)
        columns[field.name] = values.reshape(count, field.count)[:, 0].astype(np.float64)
        offset += count * field.size
    return columns


def _decompressed(packed: bytes, size: int) -> bytes | None:
    """Return the `size` bytes that `packed` holds in the LZF format, None when it does not hold them.

    A control byte below 32 announces a literal run one longer than itself; else its upper three bits give the
    length of a repeat less two (7: one more byte is added), its lower five and the next byte the distance
    less one.
    """
    plain = bytearray()
    position = 0
    try:
        while position < len(packed):
            control = packed[position]
            position += 1
            if control < 32:
                plain += packed[position : position + control + 1]
                position += control + 1
                continue
            length = (control >> 5) + 2
            if length == 9:
                length += packed[position]
                position += 1
            start = len(plain) - 1 - (((control & 31) << 8) | packed[position])
            position += 1
            if start < 0 or len(plain) > size:
                return None
            repeated = plain[start : start + length]
            plain += (repeated * (length // len(repeated) + 1))[:length] if len(repeated) < length else repeated
    except IndexError:
        return None
    return bytes(plain) if len(plain) == size else None
