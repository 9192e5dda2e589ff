"""Reads scanned meshes: OBJ, STL, GLB. PLY meshes are read by the PLY reader."""

from __future__ import annotations

import io
import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pwralign_kin.exceptions import ScanError
from pwralign_kin.scan.content import FileContent, fans
from pwralign_kin.se3 import Array

_STL_RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])

_STL_VERTEX = re.compile(rb"\bvertex\s+(\S+)\s+(\S+)\s+(\S+)")

BENT = (12.0, 65.0)
"""Angle between neighbouring triangles, degrees, from which they are chords of a curved surface, and beyond which they
meet at an edge of it."""

_OBJ_ATTRIBUTES = re.compile(r"/\S*|\s*#.*")
"""What follows the vertex index of a corner, and comments."""


def read_stl(data: bytes, path: Path) -> FileContent:
    """Return the triangles of the binary or text STL content `data`; raises `ScanError` naming `path`."""
    count = int.from_bytes(data[80:84], "little")
    size = 84 + count * _STL_RECORD.itemsize
    if data.lstrip().startswith(b"solid") and len(data) != size:
        points = _stl_text_corners(data, path)
    elif len(data) < max(size, 84):
        raise ScanError(path, f"truncated or not an STL file: {len(data)} bytes where {max(size, 84)} are announced")
    else:
        points = np.frombuffer(data, _STL_RECORD, count, 84)["corners"].reshape(-1, 3).astype(np.float64)
    if len(points) == 0:
        raise ScanError(path, "the STL file has no triangles")
    return FileContent(points=points, faces=np.arange(len(points)).reshape(-1, 3))


def _stl_text_corners(data: bytes, path: Path) -> Array:
    if b"endsolid" not in data[-2000:]:
        raise ScanError(path, "truncated: the STL text has no end")
    try:
        corners = np.array(_STL_VERTEX.findall(data), dtype=bytes).astype(np.float64).reshape(-1, 3)
    except ValueError as error:
        raise ScanError(path, f"malformed STL vertex: {error}") from None
    if len(corners) % 3:
        raise ScanError(path, f"malformed STL: {len(corners)} vertices make no whole triangles")
    return corners


def read_obj(data: bytes, path: Path) -> FileContent:
    """Return the vertices and triangulated faces of the OBJ content `data`; raises `ScanError` naming
    `path`."""
    lines = data.decode("utf-8", errors="replace").splitlines()
    vertex_rows = [line for line in lines if _keyword(line) == "v"]
    if not vertex_rows:
        raise ScanError(path, "the OBJ file has no vertices")
    try:
        vertices = np.loadtxt(vertex_rows, usecols=(1, 2, 3), comments="#", ndmin=2)
        faces = _obj_faces(lines)
    except ValueError as error:
        raise ScanError(path, f"malformed OBJ: {error}") from None
    return FileContent(points=vertices, faces=_checked_faces(faces, len(vertices), path))


def _keyword(line: str) -> str:
    return line.split(None, 1)[0] if line[:1] in "vf" and line.strip() else ""


def _obj_faces(lines: list[str]) -> NDArray[np.int64]:
    """Return the triangulated polygons; a corner such as 7/1/3 counts from 1, or back from the last vertex so
    far."""
    is_vertex = np.fromiter((_keyword(line) == "v" for line in lines), dtype=bool, count=len(lines))
    at = np.array([number for number, line in enumerate(lines) if _keyword(line) == "f"], dtype=np.int64)
    known = np.cumsum(is_vertex)[at]
    rows = _OBJ_ATTRIBUTES.sub("", "\n".join(lines[number] for number in at)).splitlines()
    sizes = np.array([len(row.split()) - 1 for row in rows], dtype=np.int64)
    faces = [np.empty((0, 3), dtype=np.int64)]
    for size in np.unique(sizes):
        chosen = np.flatnonzero(sizes == size)
        columns = range(1, int(size) + 1)
        polygons = np.loadtxt([rows[i] for i in chosen], dtype=np.int64, comments=None, usecols=columns, ndmin=2)
        faces.append(fans(np.where(polygons > 0, polygons - 1, known[chosen, None] + polygons)))
    return np.concatenate(faces)


def read_glb(data: bytes, path: Path) -> FileContent:
    """Return all geometry of the GLB content `data`, placed by its nodes; raises `ScanError` naming `path`.

    The axes are the file's own: Y is up by glTF's convention. trimesh parses the file in Python and NumPy;
    materials are not looked at.
    """
    import trimesh

    if not data.startswith(b"glTF") or len(data) < 12:
        raise ScanError(path, "not a GLB file")
    announced = int.from_bytes(data[8:12], "little")
    if len(data) < announced:
        raise ScanError(path, f"truncated: {len(data)} of {announced} bytes")
    points, faces = [np.empty((0, 3))], [np.empty((0, 3), dtype=np.int64)]
    count = 0
    try:
        scene = trimesh.load_scene(io.BytesIO(data), file_type="glb", skip_materials=True)
        for node in scene.graph.nodes_geometry:
            T, name = scene.graph[node]
            geometry = scene.geometry[name]
            vertices = np.asarray(geometry.vertices, dtype=np.float64).reshape(-1, 3)
            points.append(vertices @ T[:3, :3].T + T[:3, 3])
            faces.append(np.asarray(getattr(geometry, "faces", ()), dtype=np.int64).reshape(-1, 3) + count)
            count += len(vertices)
    except Exception as error:  # a parser of foreign bytes may raise anything; all of it means the same to the user
        reason = " ".join(str(error).split())[:200]
        raise ScanError(path, f"malformed GLB: {type(error).__name__}: {reason}") from None
    if count == 0:
        raise ScanError(path, "the GLB file has no geometry")
    return FileContent(points=np.concatenate(points), faces=_checked_faces(np.concatenate(faces), count, path))


def _checked_faces(faces: NDArray[np.int64], count: int, path: Path) -> NDArray[np.int64] | None:
    """Return `faces`, or None when there are none; raises `ScanError` where they name no vertex."""
    if len(faces) == 0:
        return None
    if faces.min() < 0 or faces.max() >= count:
        raise ScanError(path, f"faces name vertices that do not exist; there are {count}")
    return faces


def bent_share(vertices: Array, faces: NDArray[np.int64]) -> float:
    """Return the share of a mesh's area in triangles that lie `BENT` against a neighbour.

    Vertices at one place are one, be they repeated for every triangle. Triangles may be turned over.
    """
    _, same = np.unique(vertices, axis=0, return_inverse=True)
    corners = same.reshape(-1)[faces]
    normals = np.cross(vertices[faces[:, 1]] - vertices[faces[:, 0]], vertices[faces[:, 2]] - vertices[faces[:, 0]])
    areas = np.linalg.norm(normals, axis=1)
    edges = np.sort(np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]]), axis=1)
    key = edges[:, 0] * len(vertices) + edges[:, 1]
    order = np.argsort(key, kind="stable")
    shared = np.flatnonzero(key[order][1:] == key[order][:-1])
    one, other = order[shared] % len(faces), order[shared + 1] % len(faces)
    with np.errstate(divide="ignore", invalid="ignore"):
        cosine = np.abs(np.einsum("ij,ij->i", normals[one], normals[other])) / (areas[one] * areas[other])
    most, least = np.cos(np.radians(BENT))
    is_bent = (cosine < most) & (cosine > least)
    bent = np.zeros(len(faces), bool)
    bent[one[is_bent]] = bent[other[is_bent]] = True
    areas = np.where(np.isfinite(areas), areas, 0.0)
    return float(areas[bent].sum() / max(areas.sum(), 1e-300))
