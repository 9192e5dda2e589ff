"""Files -> arrays: one reader a format, chosen by the suffix; every failure is a `ScanError` with file and
cause.

Only Python and NumPy parse the bytes; no native parser sees a file.
"""

from __future__ import annotations

import io
import re
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pwralign_kin.exceptions import EmptyScanError, ScanError
from pwralign_kin.files import check_path
from pwralign_kin.scan.content import FileContent
from pwralign_kin.scan.meshes import bent_share, read_glb, read_obj, read_stl
from pwralign_kin.scan.pcd import read_pcd
from pwralign_kin.scan.ply import read_ply
from pwralign_kin.se3 import Array

MESH_SAMPLES = 50_000
"""Points drawn from a scanned mesh: about 1% of the diagonal apart on a surface of the size of its box."""

CHORDS, LEAST_VERTICES = 0.5, 50
"""Share of a scanned mesh's area in triangles that are chords of a curved surface from which only its vertices, if they
are so many, are on that surface."""

_COMMENTS = ("#", "//")


def read(path: Path | str) -> FileContent:
    """Return the points of a scan file, in the file's unit and frame; meshes come sampled, never with faces.

    Formats by suffix: .ply, .pcd, .xyz .pts .txt .asc .csv, .npy .npz, .obj, .stl, .glb. Text has x, y, z in
    its first three columns or under a heading that names them, an optional leading count, comments after # or
    //. NPZ has the key `points` (or one array (n, 3) alone) and optionally `sensor_origin` and `normals`.
    Meshes are sampled uniformly by area, 50,000 points, always the same; a mesh file without faces gives its
    vertices, and so does one whose triangles are coarse against what they show: between its vertices it cuts corners.

    Raises `ScanError` for a file that is missing, a folder, unreadable, of an unknown suffix, empty,
    truncated, malformed or not numeric.
    """
    check_path(path, partial(ScanError, "scan"))
    path = Path(path)
    if path.is_dir():
        raise ScanError(path, f"this is a folder, not a scan file{_BAG if (path / 'metadata.yaml').exists() else ''}")
    if not path.exists():
        raise ScanError(path, "no such file")
    reader = _READERS.get(path.suffix.lower())
    if reader is None:
        way_out = _WAYS_OUT.get(path.suffix.lower(), _ANY)
        raise ScanError(path, f"unknown suffix {path.suffix!r}; valid: {' '.join(_READERS)}{way_out}")
    try:
        data = path.read_bytes()
    except OSError as error:
        raise ScanError(path, f"cannot read: {error.strerror}") from None
    if not data.strip():
        raise ScanError(path, "the file is empty")
    with np.errstate(invalid="ignore", over="ignore"):  # of corrupt numbers; the points they give are dropped later
        content = reader(data, path)
        if content.faces is None:
            return content
        if len(content.faces) < MESH_SAMPLES and bent_share(content.points, content.faces) >= CHORDS:
            corners = np.unique(content.points[np.unique(content.faces)], axis=0)
            if len(corners) >= LEAST_VERTICES:
                return FileContent(points=corners)
        return FileContent(points=_sampled(content.points, content.faces, path))


def _sampled(vertices: Array, faces: NDArray[np.int64], path: Path) -> Array:
    """Return `MESH_SAMPLES` points spread uniformly by area over the triangles (Osada et al. 2002, eq. 1)."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    areas = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2.0
    areas[~np.isfinite(areas)] = 0.0
    if not areas.sum() > 0.0:
        raise ScanError(path, "the mesh has no surface: all its triangles are degenerate")
    rng = np.random.default_rng(0)
    chosen = rng.choice(len(faces), MESH_SAMPLES, p=areas / areas.sum())
    root, share = np.sqrt(rng.random((MESH_SAMPLES, 1))), rng.random((MESH_SAMPLES, 1))
    return np.asarray((1.0 - root) * a[chosen] + root * (1.0 - share) * b[chosen] + root * share * c[chosen])


def _read_text(data: bytes, path: Path) -> FileContent:
    if b"\0" in data[:4096]:
        raise ScanError(path, "binary data where text with numbers is expected")
    lines = data.decode("utf-8-sig", errors="replace").splitlines()
    rows = ((number, _words(line)) for number, line in enumerate(lines))
    first, words = next(((number, words) for number, words in rows if words), (0, []))
    announced = None
    if len(words) == 1 and words[0].isdigit():
        announced = int(words[0])
        first, words = next(((number, words) for number, words in rows if words), (0, []))
    columns = _heading_columns(words)
    if columns is not None:
        first, words = next(((number, words) for number, words in rows if words), (0, []))
    if not words:
        raise EmptyScanError(path, "the file has no points")
    columns = columns or (0, 1, 2)
    try:
        points = np.loadtxt(
            lines[first:], delimiter=_delimiter(lines[first]), comments=_COMMENTS, usecols=columns, ndmin=2
        )
    except ValueError as error:
        raise ScanError(path, _text_fault(lines, first, columns) or str(error)) from None
    if announced is not None and announced != len(points):
        word = "truncated: " if len(points) < announced else ""
        raise ScanError(path, f"{word}the first line announces {announced} points, {len(points)} follow")
    return FileContent(points=points)


def _delimiter(line: str) -> str | None:
    return next((mark for mark in ";," if mark in line), None)


def _words(line: str) -> list[str]:
    """Return the columns of a line, none for a blank line or a comment."""
    for mark in _COMMENTS:
        line = line.split(mark, 1)[0]
    return [word.strip() for word in line.split(_delimiter(line))] if line.strip() else []


def _heading_columns(words: list[str]) -> tuple[int, int, int] | None:
    """Return where x, y, z stand when `words` is a heading that names them."""
    names = [word.strip("\"'").lower() for word in words]
    return (names.index("x"), names.index("y"), names.index("z")) if {"x", "y", "z"} <= set(names) else None


_DECIMAL_COMMA = re.compile(r"\d,\d+\s+-?\d+,\d|;.*\d,\d")
"""A comma within a number: spaces or semicolons part the columns."""


def _text_fault(lines: list[str], first: int, columns: tuple[int, int, int]) -> str | None:
    """Return what is wrong with the first line that does not hold three numbers."""
    for number, line in enumerate(lines[first:], start=first + 1):
        words = _words(line)
        if not words:
            continue
        remedy = ": write decimal points, not commas" if _DECIMAL_COMMA.search(line) else ""
        if len(words) <= max(columns):
            return f"line {number}: {len(words)} columns where at least {max(columns) + 1} are expected{remedy}"
        for column in columns:
            if not _is_number(words[column]):
                if not remedy and number == first + 1 and not any(map(_is_number, words)):
                    remedy = ": a heading must call three columns x, y and z"
                return f"line {number}: {words[column][:40]!r} is not a number{remedy}"
    return None


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def _read_npy(data: bytes, path: Path) -> FileContent:
    return FileContent(points=_columns_xyz(numpy_content(data, path, b"\x93NUMPY"), path, "points"))


def _read_npz(data: bytes, path: Path) -> FileContent:
    archive = numpy_content(data, path, b"PK")
    if is_sequence(archive):
        raise ScanError(path, f"a sequence of several frames, not one scan{_SEQUENCE}")
    known = ("points", "sensor_origin", "normals")
    arrays = {name: member(archive, name, path) for name in known if name in archive.files}
    if "points" not in arrays:
        arrays["points"] = _only_points(archive, path)
    return FileContent(
        points=_columns_xyz(arrays["points"], path, "points"),
        normals=_columns_xyz(arrays["normals"], path, "normals") if "normals" in arrays else None,
        sensor_origin=_numeric(arrays["sensor_origin"], path, "sensor_origin") if "sensor_origin" in arrays else None,
    )


def _only_points(archive: Any, path: Path) -> NDArray[Any]:
    """Return the one array (n, 3) of an archive that calls its points something else."""
    own = {name: member(archive, name, path) for name in archive.files if name not in ("sensor_origin", "normals")}
    clouds = [array for array in own.values() if array.ndim == 2 and array.shape[1] == 3 and len(array) != 3]
    if len(clouds) != 1:
        listed = ", ".join(f"{name} {array.shape}" for name, array in own.items()) or "none"
        raise ScanError(path, f"no array named points, and not one alone of the shape (n, 3); the file has {listed}")
    return clouds[0]


def is_sequence(archive: Any) -> bool:
    """Return whether an opened .npz holds the frames of a sequence (see `read_frames`), not one scan."""
    return bool({"counts", "depth"} & set(archive.files))


def member(archive: Any, name: str, path: Path) -> NDArray[Any]:
    """Return an array of an opened .npz; raises `ScanError` where it is corrupt."""
    try:
        return np.asarray(archive[name])
    except Exception as error:  # a corrupt archive raises anything: zlib.error, struct.error, KeyError
        raise ScanError(path, f"truncated or malformed: {_one_line(error)}") from None


def numpy_content(data: bytes, path: Path, magic: bytes) -> Any:
    """Return what a NumPy file that begins with `magic` holds; raises `ScanError` where it is none."""
    if not data.startswith(magic):
        raise ScanError(path, f"not a NumPy {path.suffix.lower()} file")
    try:
        return np.load(io.BytesIO(data), allow_pickle=False)
    except Exception as error:  # a corrupt header raises anything: NumPy parses it as a Python literal
        raise ScanError(path, f"truncated or malformed: {_one_line(error)}") from None


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())[:200]


def _numeric(array: NDArray[np.generic], path: Path, name: str) -> Array:
    if array.dtype.kind not in "fiu":
        raise ScanError(path, f"the array {name} is not numeric but {array.dtype}")
    return array.astype(np.float64)


def _columns_xyz(array: NDArray[np.generic], path: Path, name: str) -> Array:
    """Return x, y, z (n, 3) of an array (n, 3) or of an organised cloud (height, width, 3), with any more columns."""
    if array.ndim not in (2, 3) or array.shape[-1] < 3:
        raise ScanError(path, f"the array {name} must have the shape (n, 3) or (height, width, 3), got {array.shape}")
    if array.ndim == 2 and len(array) == 3 < array.shape[1]:
        raise ScanError(path, f"the array {name} has its points in columns, {array.shape}: transpose it to (n, 3)")
    return _numeric(array, path, name).reshape(-1, array.shape[-1])[:, :3]


_ANY = "; export the points as PLY, or as text with x y z in each line"
_IMAGE = "; a 16-bit PNG depth image is read with its camera's intrinsics (--intrinsics, or `DepthFrame.load`)"
_SEQUENCE = "; `pwralign track` follows a model through it (`read_frames` reads it)"
_BAG = f"; a ROS 2 bag is no single scan{_SEQUENCE}"
_OLD_BAG = "; convert a ROS 1 bag to ROS 2: rosbags-convert --src SCAN --dst recording"
_SURVEY = "; convert it to PLY, with CloudCompare or PDAL: pdal translate SCAN scan.ply"
_MESH = "; convert it to PLY or GLB, with MeshLab, Blender or trimesh: trimesh.load(SCAN).export('scan.ply')"

_WAYS_OUT = {
    **dict.fromkeys((".png", ".tif", ".tiff", ".jpg", ".jpeg", ".exr"), _IMAGE),
    **dict.fromkeys((".mcap", ".db3"), _BAG),
    ".bag": _OLD_BAG,
    **dict.fromkeys((".las", ".laz", ".e57", ".ptx"), _SURVEY),
    **dict.fromkeys((".off", ".gltf", ".dae", ".fbx", ".3mf"), _MESH),
}
"""What to do with files of other formats."""


_READERS: dict[str, Callable[[bytes, Path], FileContent]] = {
    ".ply": read_ply,
    ".pcd": read_pcd,
    ".xyz": _read_text,
    ".pts": _read_text,
    ".txt": _read_text,
    ".asc": _read_text,
    ".csv": _read_text,
    ".npy": _read_npy,
    ".npz": _read_npz,
    ".obj": read_obj,
    ".stl": read_stl,
    ".glb": read_glb,
}

SUFFIXES = tuple(_READERS)
"""Suffixes of scan files."""
