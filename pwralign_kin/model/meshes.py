"""Geometry of the links: primitives and mesh files -> coloured triangles, read once and cached by content."""

from __future__ import annotations

import importlib.metadata
import io
import json
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal
from urllib.parse import unquote

import numpy as np

from pwralign_kin import se3
from pwralign_kin.arrays import Indices
from pwralign_kin.exceptions import MissingMeshError, ModelError
from pwralign_kin.model import cache
from pwralign_kin.model.description import Description, Shape
from pwralign_kin.model.packages import NO_FOLDERS, PackageFolders
from pwralign_kin.model.part_graph import Visual
from pwralign_kin.se3 import Array

MeshUnits = Literal["ignore", "apply"]

MESH_FORMATS = ("stl", "obj", "dae", "glb", "gltf", "ply", "off")

GREY = (0.7, 0.7, 0.7, 1.0)
"""Colour of geometry that names none."""

_READER = "geometry-3"
"""Part of the cache key: changes whenever the reading of meshes does."""


@dataclass(frozen=True, eq=False)
class Geometry:
    """The geometry of all links."""

    visuals: Mapping[str, tuple[Visual, ...]]
    """By link name; links without geometry are absent."""

    warnings: tuple[str, ...]
    key: str
    """Content key of everything that it was read from."""


@dataclass(frozen=True, eq=False)
class Body:
    """Triangles of one colour."""

    vertices: Array
    faces: Indices
    rgba: tuple[float, ...] | None
    """The mesh's own colour; None where it has none."""


def read_geometry(
    description: Description,
    path: Path,
    packages: PackageFolders = NO_FOLDERS,
    mesh_units: MeshUnits = "ignore",
) -> Geometry:
    """Read the geometry of every link of the URDF at `path`.

    `packages` are folders with packages. `mesh_units` says whether the `<unit>` of a DAE scales
    it ("apply") or not ("ignore", as yourdfpy and trimesh do; then a unit other than the metre is warned
    about).

    Raises `MissingMeshError` naming every mesh that is not found, `ModelError` for meshes that cannot be read
    or a model without any geometry.
    """
    shapes = {link.name: link.shapes for link in description.links if link.shapes}
    if not shapes:
        raise ModelError(path, "it has no geometry, neither visual nor collision: nothing to align")
    contents = _read_files(shapes, path, packages)
    sources: list[str | bytes] = [_READER, importlib.metadata.version("trimesh"), mesh_units, repr(shapes)]
    for name, content in contents.items():
        sources += [name, content.path.suffix, *content.files.values()]
    key = cache.content_key(*sources)
    arrays = cache.load_or_build(key, lambda: _build(shapes, contents, path, mesh_units))
    return Geometry(_unpack(arrays), tuple(json.loads(arrays["warnings"].tobytes())), key)


# ---- mesh files


@dataclass(frozen=True)
class _Content:
    """A mesh file and the files that it refers to."""

    path: Path
    files: dict[str, bytes]
    """By the name that the mesh gives them; the mesh itself under its own file name."""


def find_mesh(filename: str, urdf: Path, packages: PackageFolders = NO_FOLDERS) -> tuple[Path | None, list[Path]]:
    """Return the file that `filename` in the URDF means (None: not found), and the paths tried.

    Packages are looked for in `packages`, the folders above the URDF, and those that ROS names; of those only the
    ones that hold a folder of the package's name count as tried. Last they are looked for deeper in `packages`.
    A relative name is looked for beside the URDF, in `packages`, and last from the folders above.
    """
    tried: list[Path] = []
    for candidate in _candidates(unquote(filename) if "://" in filename else filename, urdf, packages):
        if candidate not in tried:
            tried.append(candidate)
            if candidate.is_file():
                return candidate, tried
    return None, tried


def _candidates(filename: str, urdf: Path, packages: PackageFolders) -> Iterator[Path]:
    folders = [urdf.absolute().parent, urdf.resolve().parent]  # a linked URDF may stand beside linked meshes
    above = dict.fromkeys(parent for folder in folders for parent in (folder, *folder.parents))
    filename = filename.replace("\\", "/")
    scheme, separator, rest = filename.partition("://")
    if separator and scheme in ("package", "model"):
        package, _, inside = rest.partition("/")
        for base in (*packages, *above, *_ros_folders()):
            if (base / package).is_dir():
                yield base / package / inside
            if base.name == package:
                yield base / inside
        # a URDF that was copied out of its package, meshes beside it
        yield from (base / inside for base in above if (base / inside).is_file())
        if package in packages.below:
            yield packages.below[package] / inside
    elif separator:
        yield folders[0] / rest.removeprefix("localhost")  # an absolute path replaces the folder
    else:
        yield from (base / filename for base in (*folders, *packages))
        # exporters and simulators also write names relative to the package, or to their data folder
        yield from (base / filename for base in above if (base / filename).is_file())


def _ros_folders() -> list[Path]:
    ros = os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep)
    ament = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    return [Path(entry) for entry in ros if entry] + [Path(entry) / "share" for entry in ament if entry]


def _read_files(shapes: Mapping[str, Sequence[Shape]], urdf: Path, packages: PackageFolders) -> dict[str, _Content]:
    """The bytes of every mesh, by its name in the URDF."""
    names = dict.fromkeys(shape.filename for own in shapes.values() for shape in own if shape.kind == "mesh")
    faults, missing, contents = [], dict[str, list[Path]](), {}
    for name in names:
        if re.match(r"(https?|ftp):", name):
            faults.append(f"mesh {name!r} is on the network: nothing is fetched, store it beside the URDF")
            continue
        found, tried = find_mesh(name, urdf, packages)
        if found is None:
            missing[name] = tried
        elif found.suffix.lower().removeprefix(".") not in MESH_FORMATS:
            faults.append(f"mesh {name!r} has an unknown format; valid: {', '.join(MESH_FORMATS)}")
        else:
            try:
                contents[name] = _Content(found, _with_companions(found))
            except OSError as error:
                faults.append(f"mesh {found} cannot be read: {error.strerror}")
    if missing and not faults:
        raise MissingMeshError(urdf, missing)
    if faults:
        raise ModelError(urdf, faults + [f"mesh {name!r} is missing" for name in missing])
    return contents


def _with_companions(path: Path) -> dict[str, bytes]:
    """The mesh's bytes and those of the material and buffer files that it names; never its textures."""
    data = path.read_bytes()
    names: list[str] = []
    if path.suffix.lower() == ".obj":
        names = [
            name.decode("utf-8", "replace").strip() for name in re.findall(rb"^\s*mtllib\s+(.+)$", data, re.MULTILINE)
        ]
    elif path.suffix.lower() == ".gltf":
        uris = re.findall(rb'"uri"\s*:\s*"([^"]+)"', data)
        names = [uri.decode("utf-8", "replace") for uri in uris if uri.lower().endswith(b".bin")]
    files = {path.name: data}
    for name in names:
        companion = path.parent / unquote(name)
        if companion.is_file():
            files[name] = companion.read_bytes()
    return files


# ---- triangles


def _build(
    shapes: Mapping[str, Sequence[Shape]], contents: Mapping[str, _Content], urdf: Path, mesh_units: MeshUnits
) -> cache.Arrays:
    """Read every mesh once and lay all pieces out as flat arrays."""
    report = _Report()
    meshes: dict[str, list[Body]] = {}
    for name, content in contents.items():
        try:
            with np.errstate(all="ignore"):  # absurd vertices give inf or NaN, which are dropped
                meshes[name] = load_mesh(content.path, content.files, mesh_units, report)
        except Exception as error:  # parsers of foreign formats raise anything
            reason = " ".join(f"{type(error).__name__}: {error}".split())
            report.faults.append(f"mesh {content.path} cannot be read ({reason})")
    if report.faults:
        raise ModelError(urdf, report.faults)

    bodies: list[Body] = []
    placed: dict[tuple[str, tuple[float, ...], str], range] = {}
    pieces = []
    for link, own in shapes.items():
        for shape in own:
            identity = (shape.kind, shape.size, shape.filename)
            if identity not in placed:
                new = _scaled(meshes[shape.filename], shape.size) if shape.kind == "mesh" else [primitive(shape)]
                placed[identity] = range(len(bodies), len(bodies) + len(new))
                bodies += new
            T = shape.origin.matrix
            pieces += [(link, index, T, bodies[index].rgba or shape.rgba or GREY) for index in placed[identity]]
    if not any(len(body.faces) for body in bodies):
        raise ModelError(urdf, "its geometry holds no triangles: nothing to align")
    links = list(shapes)
    return {
        "vertices": np.concatenate([body.vertices for body in bodies]),
        "faces": np.concatenate([body.faces for body in bodies]).astype(np.int32),
        "vertex_start": np.cumsum([0, *(len(body.vertices) for body in bodies)]),
        "face_start": np.cumsum([0, *(len(body.faces) for body in bodies)]),
        "piece_body": np.array([index for _, index, _, _ in pieces]),
        "piece_link": np.array([links.index(link) for link, _, _, _ in pieces]),
        "piece_T": np.array([T for _, _, T, _ in pieces]),
        "piece_rgba": np.array([rgba for _, _, _, rgba in pieces]),
        "links": np.frombuffer(json.dumps(links).encode(), np.uint8),
        "warnings": np.frombuffer(json.dumps(report.lines()).encode(), np.uint8),
    }


def _unpack(arrays: cache.Arrays) -> dict[str, tuple[Visual, ...]]:
    links = json.loads(arrays["links"].tobytes())
    faces = arrays["faces"].astype(np.int64)
    faces.flags.writeable = False
    visuals: dict[str, list[Visual]] = {}
    for body, link, T, rgba in zip(
        arrays["piece_body"], arrays["piece_link"], arrays["piece_T"], arrays["piece_rgba"], strict=True
    ):
        own_vertices = slice(arrays["vertex_start"][body], arrays["vertex_start"][body + 1])
        own_faces = slice(arrays["face_start"][body], arrays["face_start"][body + 1])
        visuals.setdefault(links[link], []).append(
            Visual(links[link], T, arrays["vertices"][own_vertices], faces[own_faces], rgba)
        )
    return {link: tuple(own) for link, own in visuals.items()}


class _Report:
    """Counts what reading dropped, so that a model gets one line and not one a mesh."""

    def __init__(self) -> None:
        self.faults: list[str] = []
        self.degenerate: dict[str, int] = {}
        self.units: dict[str, float] = {}

    def lines(self) -> list[str]:
        """The warnings."""
        lines = []
        if self.degenerate:
            count, where = sum(self.degenerate.values()), ", ".join(self.degenerate)
            lines.append(f"{count} degenerate triangle{'s' * (count > 1)} dropped in {where}")
        for unit in sorted(set(self.units.values())):
            names = [name for name, own in self.units.items() if own == unit]
            lines.append(
                f"{', '.join(names)}: the file's unit is {unit:g} m, which is ignored as most readers do; "
                'if the model comes out too large or small, use mesh_units="apply" / --mesh-units apply'
            )
        return lines


def load_mesh(path: Path, files: Mapping[str, bytes], mesh_units: MeshUnits, report: _Report) -> list[Body]:
    """Read one mesh file into bodies of one colour each, its scene flattened.

    `files` holds its bytes and those of its companions by name. Raises whatever the parser raises.
    """
    import trimesh

    scene = _scene(path, files)
    unit = _dae_unit(files[path.name]) if path.suffix.lower() == ".dae" else 1.0
    if mesh_units == "ignore" and abs(unit - 1.0) > 1e-9:
        report.units[path.name] = unit
        unit = 1.0
    by_color: dict[tuple[float, ...] | None, list[tuple[Array, Indices]]] = {}
    dropped = 0
    for node in scene.graph.nodes_geometry:
        T, name = scene.graph[node]
        piece = scene.geometry[name]
        if not isinstance(piece, trimesh.Trimesh) or len(piece.faces) == 0:
            continue
        vertices = se3.transform(np.asarray(T), np.asarray(piece.vertices, dtype=np.float64)) * unit
        faces = np.asarray(piece.faces, dtype=np.int64)
        if np.linalg.det(np.asarray(T)[:3, :3]) < 0.0:
            faces = faces[:, ::-1]
        vertices, faces, lost = _clean(vertices, faces)
        dropped += lost
        by_color.setdefault(_color(piece.visual), []).append((vertices, faces))
    if not by_color:
        raise ValueError("it holds no triangles")
    if dropped:
        report.degenerate[path.name] = report.degenerate.get(path.name, 0) + dropped
    bodies = [_joined(pieces, color) for color, pieces in by_color.items()]
    return [body for body in bodies if len(body.faces)]


def _scene(path: Path, files: Mapping[str, bytes]) -> Any:
    """The file as a trimesh scene; what a DAE shows in a material that is broken comes without its colours."""
    import trimesh

    def read(data: bytes) -> Any:
        return trimesh.load_scene(
            io.BytesIO(data),
            file_type=path.suffix.lower().removeprefix("."),
            resolver=files,  # no other file is opened: no texture, nothing outside
            process=False,
            ignore_broken=True,
        )

    data = files[path.name]
    scene = read(data)
    if path.suffix.lower() == ".dae":
        shown = re.findall(rb"<instance_geometry\b[^>]*\burl\s*=\s*[\"']#([^\"']+)", data)
        if not all(any(name.startswith(one.decode(errors="replace")) for name in scene.geometry) for one in shown):
            plain = read(re.sub(rb"<bind_material\b.*?</bind_material\s*>", b"", data, flags=re.DOTALL))
            return plain if len(plain.geometry) > len(scene.geometry) else scene
    return scene


def _dae_unit(data: bytes) -> float:
    match = re.search(rb"<unit\b[^>]*\bmeter\s*=\s*[\"']([^\"']+)[\"']", data)
    try:
        unit = float(match[1]) if match else 1.0
    except ValueError:
        return 1.0
    return unit if np.isfinite(unit) and unit > 0.0 else 1.0


def _color(visual: Any) -> tuple[float, ...] | None:
    """The mesh's own main colour, or None. Nearly clear ones are opaque: exporters invert transparency."""
    if not visual.defined:
        return None
    main = visual.material.main_color if visual.kind == "texture" else visual.main_color
    rgba = [float(value) / 255.0 for value in main]
    return (*rgba[:3], rgba[3] if rgba[3] > 0.1 else 1.0)


def _clean(vertices: Array, faces: Indices) -> tuple[Array, Indices, int]:
    """Merge equal vertices and drop triangles without area or with vertices that are not finite."""
    kept = faces[((faces >= 0) & (faces < len(vertices))).all(axis=1)]
    a, b, c = (vertices[kept[:, corner]] for corner in range(3))
    doubled_area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    longest_squared = np.maximum.reduce([((p - q) ** 2).sum(axis=1) for p, q in ((a, b), (b, c), (c, a))])
    kept = kept[(doubled_area > 1e-7 * longest_squared) & (doubled_area < np.inf)]  # NaN passes neither
    return *_merged(vertices, kept), len(faces) - len(kept)


def _merged(vertices: Array, faces: Indices) -> tuple[Array, Indices]:
    """Return only the vertices in use, equal ones (to the bit) once."""
    words = (np.ascontiguousarray(vertices) + 0.0).view(np.uint64).reshape(-1, 3)  # + 0.0: one zero
    codes = np.zeros(len(words), np.uint64)
    for column in words.T:
        for factor in (0xFF51AFD7ED558CCD, 0xC4CEB9FE1A85EC53):
            codes = (codes ^ column) * np.uint64(factor)
            codes ^= codes >> np.uint64(32)
    _, first, inverse = np.unique(codes, return_index=True, return_inverse=True)
    if not np.array_equal(words[first[inverse]], words):  # two vertices share a code: leave them as they are
        first = inverse = np.arange(len(vertices))
    used, compact = np.unique(inverse[faces], return_inverse=True)
    return vertices[first[used]], compact.reshape(faces.shape).astype(np.int64)


def _joined(pieces: Sequence[tuple[Array, Indices]], rgba: tuple[float, ...] | None) -> Body:
    starts = np.cumsum([0, *(len(vertices) for vertices, _ in pieces)])
    faces = [own + start for (_, own), start in zip(pieces, starts, strict=False)]
    return Body(np.concatenate([vertices for vertices, _ in pieces]), np.concatenate(faces), rgba)


def _scaled(bodies: Sequence[Body], scale: Sequence[float]) -> list[Body]:
    """Scale bodies; a mirror turns the triangles round, so that they keep facing outwards."""
    mirrored = np.prod(scale) < 0.0
    return [
        Body(body.vertices * np.array(scale), body.faces[:, ::-1] if mirrored else body.faces, body.rgba)
        for body in bodies
    ]


def primitive(shape: Shape) -> Body:
    """Return the triangles of a box, cylinder, sphere or capsule, centred, its axis along z."""
    from trimesh import creation

    if shape.kind == "box":
        mesh = creation.box(extents=shape.size)
    elif shape.kind == "sphere":
        mesh = creation.icosphere(subdivisions=3, radius=shape.size[0])
    elif shape.kind == "cylinder":
        mesh = creation.cylinder(radius=shape.size[0], height=shape.size[1])
    else:
        mesh = creation.capsule(radius=shape.size[0], height=shape.size[1])
    vertices, faces, _ = _clean(np.asarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.faces, dtype=np.int64))
    return Body(vertices, faces, None)
