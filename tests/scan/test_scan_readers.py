"""Every format, every way in which a file can be wrong."""

from __future__ import annotations

import io
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh

from pwralign_kin.exceptions import PwralignError, ScanError
from pwralign_kin.scan import Scan, write_ply

POINTS = np.random.default_rng(0).normal(size=(60, 3)).astype(np.float32).astype(np.float64)
NORMALS = POINTS / np.linalg.norm(POINTS, axis=1, keepdims=True)


def text_rows(points: np.ndarray, separator: str = " ") -> str:
    return "\n".join(separator.join(f"{value:.9g}" for value in row) for row in points) + "\n"


# PLY


def ply_header(form: str, *lines: str) -> bytes:
    return "\n".join(["ply", f"format {form} 1.0", "comment made by a test", *lines, "end_header", ""]).encode()


def ply_ascii(points: np.ndarray) -> bytes:
    header = ply_header("ascii", f"element vertex {len(points)}", *(f"property float {name}" for name in "xyz"))
    return header + text_rows(points).encode()


def ply_binary(order: str) -> bytes:
    """Points with another element before them, an extra property between, and normals."""
    record = np.dtype([(name, order + kind) for name, kind in zip(["x", "y", "red", "z"], "ffBf", strict=True)])
    record = np.dtype([*record.descr, *((name, order + "f8") for name in ("nx", "ny", "nz"))])
    vertices = np.zeros(len(POINTS), dtype=record)
    for name, column in zip(("x", "y", "z", "nx", "ny", "nz"), np.hstack([POINTS, NORMALS]).T, strict=True):
        vertices[name] = column
    lists = b"".join(struct.pack(f"{order}B{count}h", count, *range(count)) for count in (2, 0, 3))
    form = "binary_little_endian" if order == "<" else "binary_big_endian"
    header = ply_header(
        form, "element camera 3", "property list uchar short key", f"element vertex {len(POINTS)}",
        "property float x", "property float y", "property uchar red", "property float z",
        "property double nx", "property double ny", "property double nz",
    )  # fmt: skip
    return header + lists + vertices.tobytes()


@pytest.mark.parametrize("order", ["<", ">"])
def test_binary_ply_with_foreign_elements_and_properties(tmp_path: Path, order: str) -> None:
    (tmp_path / "scan.ply").write_bytes(ply_binary(order))
    scan = Scan.load(tmp_path / "scan.ply")
    assert np.array_equal(scan.points, POINTS)
    assert scan.normals is not None and np.allclose(scan.normals, NORMALS)


def test_ascii_ply_with_blank_lines_and_windows_line_ends(tmp_path: Path) -> None:
    (tmp_path / "scan.PLY").write_bytes(
        ply_ascii(POINTS).replace(b"end_header\n", b"end_header\n\n").replace(b"\n", b"\r\n")
    )
    assert np.allclose(Scan.load(tmp_path / "scan.PLY").points, POINTS)


def test_ply_of_open3d(tmp_path: Path) -> None:
    open3d = pytest.importorskip("open3d", exc_type=ImportError)
    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(POINTS))
    for name, ascii_form in (("text.ply", True), ("binary.ply", False)):
        open3d.io.write_point_cloud(str(tmp_path / name), cloud, write_ascii=ascii_form)
        assert np.allclose(Scan.load(tmp_path / name).points, POINTS)


def polygon_ply(form: str) -> bytes:
    """A unit cube as quadrilaterals, one of them split into triangles, so that the lists differ in length."""
    box = trimesh.creation.box()
    corners = np.array([[(i >> 2) & 1, (i >> 1) & 1, i & 1] for i in range(8)], dtype=float)
    quads = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7], [1, 7, 3]]
    assert box.area == pytest.approx(6.0)
    header = ply_header(
        form, "element vertex 8", "property double x", "property double y", "property double z",
        f"element face {len(quads)}", "property list uchar int vertex_indices",
    )  # fmt: skip
    if form == "ascii":
        return header + (text_rows(corners) + "\n".join(" ".join(map(str, [len(q), *q])) for q in quads)).encode()
    order = "<" if "little" in form else ">"
    body = corners.astype(order + "f8").tobytes()
    return header + body + b"".join(struct.pack(f"{order}B{len(q)}i", len(q), *q) for q in quads)


@pytest.mark.parametrize("form", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_ply_with_polygons_is_sampled_uniformly_by_area(tmp_path: Path, form: str) -> None:
    (tmp_path / "mesh.ply").write_bytes(polygon_ply(form))
    scan = Scan.load(tmp_path / "mesh.ply")
    assert len(scan) == 50_000
    on_faces = [np.isclose(scan.points[:, axis], side) for axis in range(3) for side in (0.0, 1.0)]
    assert np.any(on_faces, axis=0).all()
    assert [face.mean() for face in on_faces] == pytest.approx([1 / 6] * 6, abs=0.01)
    assert np.array_equal(scan.points, Scan.load(tmp_path / "mesh.ply").points)


# PCD


def pcd_header(storage: str, count: int) -> bytes:
    return (
        "# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS x y z intensity label\n"
        f"SIZE 4 4 4 8 2\nTYPE F F F F U\nCOUNT 1 1 1 2 1\nWIDTH {count}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\n"
        f"POINTS {count}\nDATA {storage}\n"
    ).encode()


def pcd_records(points: np.ndarray) -> np.ndarray:
    record = np.dtype([("xyz", "<f4", 3), ("intensity", "<f8", 2), ("label", "<u2")])
    records = np.zeros(len(points), dtype=record)
    records["xyz"] = points
    records["intensity"] = 5.0
    return records


def pcd_ascii() -> bytes:
    rows = np.hstack([POINTS, np.full((len(POINTS), 2), 5.0), np.zeros((len(POINTS), 1))])
    return pcd_header("ascii", len(POINTS)) + text_rows(rows).encode()


def pcd_binary() -> bytes:
    return pcd_header("binary", len(POINTS)) + pcd_records(POINTS).tobytes()


def lzf(plain: bytes) -> bytes:
    """Compress in the LZF format: repeats of three bytes and more, found greedily by a table of last
    positions."""
    packed, literals, last, position = bytearray(), bytearray(), {}, 0

    def flush() -> None:
        for start in range(0, len(literals), 32):
            run = literals[start : start + 32]
            packed.append(len(run) - 1)
            packed.extend(run)
        literals.clear()

    while position < len(plain):
        key = plain[position : position + 3]
        found = last.get(key, -1) if len(key) == 3 else -1
        last[key] = position
        if found < 0 or position - found > 8192:
            literals.append(plain[position])
            position += 1
            continue
        length = 3
        while length < 264 and position + length < len(plain) and plain[found + length] == plain[position + length]:
            length += 1
        flush()
        distance = position - found - 1
        short = min(length - 2, 7)
        packed.append((short << 5) | (distance >> 8))
        if short == 7:
            packed.append(length - 9)
        packed.append(distance & 255)
        position += length
    flush()
    return bytes(packed)


def pcd_compressed(points: np.ndarray = POINTS) -> bytes:
    records = pcd_records(points)
    columns = [records["xyz"][:, i] for i in range(3)] + [records["intensity"], records["label"]]
    plain = b"".join(np.ascontiguousarray(column).tobytes() for column in columns)
    packed = lzf(plain)
    return pcd_header("binary_compressed", len(points)) + struct.pack("<II", len(packed), len(plain)) + packed


@pytest.mark.parametrize("content", [pcd_ascii, pcd_binary, pcd_compressed])
def test_pcd(tmp_path: Path, content: Callable[[], bytes]) -> None:
    (tmp_path / "scan.pcd").write_bytes(content())
    assert np.allclose(Scan.load(tmp_path / "scan.pcd").points, POINTS, rtol=1e-6)


@pytest.mark.parametrize("options", [{"write_ascii": True}, {}, {"compressed": True}])
def test_pcd_of_open3d_with_normals_and_nan(tmp_path: Path, options: dict[str, bool]) -> None:
    open3d = pytest.importorskip("open3d", exc_type=ImportError)
    points = np.vstack([POINTS, [[np.nan] * 3], np.tile(POINTS[:1], (300, 1))])
    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points))
    cloud.normals = open3d.utility.Vector3dVector(np.vstack([NORMALS, np.tile(NORMALS[:1], (301, 1))]))
    open3d.io.write_point_cloud(str(tmp_path / "scan.pcd"), cloud, **options)
    scan = Scan.load(tmp_path / "scan.pcd")
    assert np.allclose(scan.points, POINTS, rtol=1e-5)
    assert scan.normals is not None and np.allclose(scan.normals, NORMALS, atol=1e-5)
    assert scan.dropped == {"non_finite": 1, "duplicate": 300}


def test_old_pcd_without_points_and_count_lines(tmp_path: Path) -> None:
    header = f"FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nWIDTH {len(POINTS) // 2}\nHEIGHT 2\nDATA ascii\n"
    (tmp_path / "scan.pcd").write_text(header + text_rows(POINTS))
    assert np.allclose(Scan.load(tmp_path / "scan.pcd").points, POINTS)


# text


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("plain.xyz", text_rows(POINTS)),
        ("commas.csv", text_rows(POINTS, ",")),
        ("spaced.csv", text_rows(POINTS, ", ")),
        ("semicolons.txt", text_rows(POINTS, ";")),
        ("tabs.asc", text_rows(POINTS, "\t")),
        ("count.pts", f"{len(POINTS)}\n" + text_rows(np.hstack([POINTS, 200 * NORMALS]))),
        ("comments.txt", "# made by hand\n// x y z\n\n" + text_rows(POINTS).replace("\n", "  # a point\n\n")),
        ("mark.txt", "\ufeff" + text_rows(POINTS)),
        ("heading.csv", "X,Y,Z\n" + text_rows(POINTS, ",")),
        (
            "order.csv",
            '"id","z","x","y"\n' + text_rows(np.hstack([NORMALS[:, :1], POINTS[:, [2, 0, 1]]]), ","),
        ),
        (
            "names.csv",
            "label,x,y,z\n" + "".join(f"part,{row}\n" for row in text_rows(POINTS, ",").splitlines()),
        ),
    ],
)
def test_text(tmp_path: Path, name: str, content: str) -> None:
    (tmp_path / name).write_text(content, encoding="utf-8")
    assert np.allclose(Scan.load(tmp_path / name).points, POINTS, rtol=1e-6)


def test_nan_in_text_is_dropped(tmp_path: Path) -> None:
    (tmp_path / "scan.xyz").write_text(text_rows(POINTS) + "nan nan nan\n")
    assert Scan.load(tmp_path / "scan.xyz").dropped["non_finite"] == 1


# NumPy


def test_npy_with_further_columns(tmp_path: Path) -> None:
    np.save(tmp_path / "scan.npy", np.hstack([POINTS, NORMALS]))
    assert np.array_equal(Scan.load(tmp_path / "scan.npy").points, POINTS)


def test_npz_with_origin_and_normals(tmp_path: Path) -> None:
    np.savez(tmp_path / "scan.npz", points=POINTS, sensor_origin=-POINTS, normals=NORMALS, other=np.zeros(2))
    scan = Scan.load(tmp_path / "scan.npz")
    assert np.array_equal(scan.points, POINTS)
    assert scan.sensor_origin is not None and np.array_equal(scan.sensor_origin, -POINTS)
    assert scan.normals is not None and np.allclose(scan.normals, NORMALS)
    overridden = Scan.load(tmp_path / "scan.npz", sensor_origin=[1.0, 2.0, 3.0])
    assert overridden.sensor_origin is not None and overridden.sensor_origin.tolist() == [1.0, 2.0, 3.0]


# meshes


def mesh_bytes(suffix: str) -> bytes:
    """A sphere of radius 0.5 about (1, 2, 3); in GLB placed there by its node."""
    sphere = trimesh.creation.icosphere(subdivisions=3, radius=0.5)
    T = np.eye(4)
    T[:3, 3] = [1.0, 2.0, 3.0]
    scene = trimesh.Scene()
    scene.add_geometry(sphere, transform=T)
    if suffix != ".glb":
        sphere.apply_transform(T)
    file_type = {".stl": "stl", ".obj": "obj", ".glb": "glb", ".ply": "ply", "ascii": "stl_ascii"}[suffix]
    content = scene.export(file_type="glb") if suffix == ".glb" else sphere.export(file_type=file_type)
    return content.encode() if isinstance(content, str) else bytes(content)


@pytest.mark.parametrize("suffix", [".stl", ".obj", ".glb", ".ply", "ascii"])
def test_meshes_are_sampled(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"mesh{suffix if suffix != 'ascii' else '.stl'}"
    path.write_bytes(mesh_bytes(suffix))
    scan = Scan.load(path)
    assert len(scan) == 50_000
    radius = np.linalg.norm(scan.points - [1.0, 2.0, 3.0], axis=1)
    assert radius.min() > 0.49 and radius.max() < 0.5 + 1e-6
    assert scan.points.mean(axis=0) == pytest.approx([1.0, 2.0, 3.0], abs=0.01)


@pytest.mark.parametrize("suffix", [".stl", ".obj"])
@pytest.mark.parametrize(("steps", "vertices"), [(3, None), (14, 338), (40, None)])
def test_coarse_meshes_give_their_vertices(tmp_path: Path, suffix: str, steps: int, vertices: int | None) -> None:
    """Of spheres: too few vertices to do without samples, triangles that are chords, and such as are nearly flat."""
    sphere = trimesh.creation.uv_sphere(count=[steps, steps])
    content = sphere.export(file_type=suffix[1:])
    (tmp_path / f"mesh{suffix}").write_bytes(content if isinstance(content, bytes) else content.encode())
    scan = Scan.load(tmp_path / f"mesh{suffix}")
    if vertices is None:
        assert len(scan) == 50_000
    else:
        assert len(scan) == vertices
        assert np.linalg.norm(scan.points, axis=1) == pytest.approx(np.ones(len(scan)), abs=1e-6)


def test_a_fine_mesh_that_noise_bends_is_sampled(tmp_path: Path) -> None:
    sphere = trimesh.creation.icosphere(subdivisions=6)
    noise = 0.2 * sphere.edges_unique_length.mean() * np.random.default_rng(0).normal(size=sphere.vertices.shape)
    trimesh.Trimesh(sphere.vertices + noise, sphere.faces, process=False).export(tmp_path / "fine.stl")
    assert len(Scan.load(tmp_path / "fine.stl")) == 50_000


def test_meshes_of_flat_faces_are_sampled_however_few_or_many_triangles_they_have(tmp_path: Path) -> None:
    box = trimesh.creation.box().subdivide().subdivide()
    box.export(tmp_path / "box.obj")
    assert len(box.vertices) > 90
    assert len(Scan.load(tmp_path / "box.obj")) == 50_000


@pytest.mark.parametrize("space", [" ", "\t"])
def test_an_obj_without_faces_gives_its_vertices(space: str, tmp_path: Path) -> None:
    (tmp_path / "cloud.obj").write_text("".join(f"v{space}{row}\n" for row in text_rows(POINTS).splitlines()))
    assert np.allclose(Scan.load(tmp_path / "cloud.obj").points, POINTS, rtol=1e-6)


def test_an_organised_cloud_is_taken_as_its_points(tmp_path: Path) -> None:
    np.save(tmp_path / "image.npy", POINTS[:20].reshape(4, 5, 3))
    assert np.array_equal(Scan.load(tmp_path / "image.npy").points, POINTS[:20])


def test_a_depth_image_is_no_scan_and_the_way_is_named(tmp_path: Path) -> None:
    (tmp_path / "depth.png").write_bytes(b"")
    with pytest.raises(ScanError, match="--intrinsics"):
        Scan.load(tmp_path / "depth.png")


# what can be wrong

HEADER_XYZ = ("property float x", "property float y", "property float z")

FAULTS: dict[str, tuple[str, bytes, str]] = {
    "unknown suffix": ("scan.las", b"x", r"unknown suffix '\.las'; valid: \.ply \.pcd \.xyz .*\.glb"),
    "no suffix": ("scan", b"x", "unknown suffix ''"),
    "ply: not one": ("scan.ply", b"solid", "not a PLY file"),
    "ply: header cut": ("scan.ply", ply_ascii(POINTS)[:40], "header has no end"),
    "ply: rows cut": ("scan.ply", ply_ascii(POINTS)[:-200], "truncated: fewer than the 60 elements 'vertex'"),
    "ply: last row cut": (
        "scan.ply",
        b"\n".join(ply_ascii(POINTS).split(b"\n")[:-2]) + b"\n1 2\n",
        "malformed row",
    ),
    "ply: word": (
        "scan.ply",
        ply_ascii(POINTS).replace(b"end_header\n", b"end_header\n1 2 three\n"),
        "three",
    ),
    "ply: binary cut": ("scan.ply", ply_binary("<")[:-1], "truncated: fewer than the 60 elements 'vertex'"),
    "ply: list cut": (
        "scan.ply",
        polygon_ply("binary_big_endian")[:-3],
        "truncated: fewer than the 7 elements 'face'",
    ),
    "ply: huge count": (
        "scan.ply",
        ply_header("binary_little_endian", "element vertex 99999999999999", *HEADER_XYZ) + bytes(100),
        "truncated",
    ),
    "ply: huge list": (
        "scan.ply",
        ply_header("binary_little_endian", "element face 1", "property list uint int vertex_indices") + b"\xff" * 4,
        "impossible length",
    ),
    "ply: bad index": ("scan.ply", polygon_ply("ascii").replace(b"3 1 7 3", b"3 1 7 8"), r"outside 0\.\.7"),
    "ply: no vertex": (
        "scan.ply",
        ply_header("ascii", "element face 0", "property int a"),
        "no element vertex",
    ),
    "ply: no z": ("scan.ply", ply_header("ascii", "element vertex 0", *HEADER_XYZ[:2]), "no x, y, z"),
    "ply: no points": (
        "scan.ply",
        ply_header("ascii", "element vertex 0", *HEADER_XYZ),
        "the scan has no points",
    ),
    "ply: no format": ("scan.ply", b"ply\nelement vertex 0\nproperty int x\nend_header\n", "names no format"),
    "ply: odd type": (
        "scan.ply",
        ply_header("ascii", "element vertex 1", "property quad x"),
        "'property quad x'",
    ),
    "ply: bare": ("scan.ply", ply_header("ascii", "element vertex 1"), "'vertex' has no properties"),
    "pcd: not one": ("scan.pcd", b"garbage", "no line DATA"),
    "pcd: header": ("scan.pcd", pcd_binary().replace(b"SIZE 4 4 4 8 2", b"SIZE 4 4 4"), "do not match"),
    "pcd: type": ("scan.pcd", pcd_binary().replace(b"TYPE F", b"TYPE Q"), "field x of type Q"),
    "pcd: count": (
        "scan.pcd",
        pcd_binary().replace(b"POINTS 60", b"").replace(b"WIDTH 60", b""),
        "no number of points",
    ),
    "pcd: storage": (
        "scan.pcd",
        pcd_binary().replace(b"DATA binary", b"DATA zip"),
        "unknown PCD storage 'zip'",
    ),
    "pcd: no z": ("scan.pcd", pcd_binary().replace(b"x y z", b"x y w"), "no fields x, y, z, only x, y, w"),
    "pcd: ascii cut": ("scan.pcd", pcd_ascii()[:-300], "truncated: fewer than the 60 points"),
    "pcd: ascii word": ("scan.pcd", pcd_ascii()[:-30] + b"one", "malformed row"),
    "pcd: binary cut": ("scan.pcd", pcd_binary()[:-1], "truncated: fewer than the 60 points"),
    "pcd: compressed cut": ("scan.pcd", pcd_compressed()[:-1], "truncated: fewer than the 60 points"),
    "pcd: no sizes": ("scan.pcd", pcd_header("binary_compressed", 60) + b"\0", "truncated"),
    "pcd: sizes": (
        "scan.pcd",
        pcd_header("binary_compressed", 60) + struct.pack("<II", 4, 4) + bytes(4),
        "malformed: 4 bytes",
    ),
    "pcd: corrupt": (
        "scan.pcd",
        pcd_header("binary_compressed", 60) + struct.pack("<II", 3, 60 * 30) + b"\xff\xff\xff",
        "do not unpack",
    ),
    "text: empty": ("scan.xyz", b"", "the file is empty"),
    "text: blank": ("scan.xyz", b" \n \n", "the file is empty"),
    "text: comments": ("scan.xyz", b"# nothing\n", "the file has no points"),
    "text: count only": ("scan.pts", b"100\n", "the file has no points"),
    "text: word": ("scan.txt", b"# a\n1 2 3\n4 five 6\n", "line 3: 'five' is not a number"),
    "text: first word": ("scan.csv", b"a,b,c\n1,2,3\n", "line 1: 'a' is not a number"),
    "text: two columns": ("scan.csv", b"1,2,3\n1,2\n", "line 2: 2 columns where at least 3"),
    "text: cut": (
        "scan.pts",
        b"100\n" + text_rows(POINTS).encode(),
        "truncated: the first line announces 100 points, 60",
    ),
    "text: more": ("scan.pts", b"10\n" + text_rows(POINTS).encode(), "announces 10 points, 60 follow"),
    "text: decimal commas": ("scan.txt", b"1,5;2,5;3,5\n", "'1,5' is not a number"),
    "text: binary": ("scan.xyz", b"1 2 3\n\0\1\2", "binary data"),
    "npy: not one": ("scan.npy", b"1 2 3", "not a NumPy .npy file"),
    "npz: not one": ("scan.npz", b"\x93NUMPY", "not a NumPy .npz file"),
    "obj: nothing": ("mesh.obj", b"garbage", "no vertices"),
    "obj: bad index": (
        "mesh.obj",
        b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n",
        "faces name vertices that do not exist; there are 3",
    ),
    "obj: word": ("mesh.obj", b"v 0 0 0\nv 1 zero 0\n", "malformed OBJ: .*'zero'"),
    "obj: short": ("mesh.obj", b"v 0 0\n", "malformed OBJ: .*column"),
    "stl: text word": ("mesh.stl", b"solid a facet vertex 1 2 c\nendsolid", "malformed STL vertex"),
    "stl: text corner": (
        "mesh.stl",
        b"solid a facet vertex 1 2 3\nendsolid",
        "1 vertices make no whole triangles",
    ),
    "stl: not one": ("mesh.stl", b"garbage", "truncated or not an STL file"),
    "stl: cut": ("mesh.stl", mesh_bytes(".stl")[:-10], "truncated or not an STL file"),
    "stl: text cut": ("mesh.stl", mesh_bytes("ascii")[:-100], "truncated: the STL text has no end"),
    "stl: no faces": ("mesh.stl", bytes(84), "no triangles"),
    "glb: not one": ("mesh.glb", b"garbage", "not a GLB file"),
    "glb: cut": ("mesh.glb", mesh_bytes(".glb")[:-10], "truncated: .* of .* bytes"),
    "glb: corrupt": ("mesh.glb", mesh_bytes(".glb").replace(b'"accessors"', b'"axcessors"'), "malformed GLB"),
    "mesh: flat": ("mesh.obj", b"v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n", "no surface"),
}


@pytest.mark.parametrize(("name", "content", "fault"), FAULTS.values(), ids=FAULTS.keys())
def test_a_wrong_file_raises_one_error_with_file_and_cause(
    tmp_path: Path, name: str, content: bytes, fault: str
) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(ScanError, match=fault) as caught:
        Scan.load(tmp_path / name)
    assert str(caught.value).startswith(f"{tmp_path / name}: ")
    assert "\n" not in str(caught.value)


def npy(array: np.ndarray) -> bytes:
    buffer = io.BytesIO()
    np.save(buffer, array, allow_pickle=True)
    return buffer.getvalue()


def npz(**arrays: np.ndarray) -> bytes:
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)
    return buffer.getvalue()


def zipped(name: str, content: bytes) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        archive.writestr(name, content)
    return buffer.getvalue()


@pytest.mark.parametrize(
    ("name", "content", "fault"),
    [
        ("scan.npy", npy(POINTS)[:-5], "truncated or malformed"),
        ("scan.npy", npy(np.array([{"a": 1}])), "truncated or malformed: .*pickle"),
        ("scan.npy", npy(POINTS[:, :2]), "must have the shape"),
        ("scan.npy", npy(POINTS.astype(str)), "not numeric"),
        ("scan.npy", npy(np.zeros((4, 3), dtype=complex)), "not numeric"),
        ("scan.npy", npy(POINTS).replace(b"(60, 3)", b"(10**9, 3)"), "truncated or malformed"),
        ("scan.npz", npz(points=POINTS)[:-5], "truncated or malformed"),
        ("scan.npz", npz(cloud=POINTS[:, :2]), "no array named points.*the file has cloud"),
        ("scan.npz", npz(points=POINTS, sensor_origin=np.zeros(2)), "sensor_origin must have the shape"),
        ("scan.npz", zipped("points.npy", b"1 2 3"), "must have the shape"),
        ("scan.npz", npz(points=np.array([{"a": 1}])), "truncated or malformed: .*pickle"),
    ],
)
def test_a_wrong_numpy_file_raises(tmp_path: Path, name: str, content: bytes, fault: str) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(ScanError, match=fault):
        Scan.load(tmp_path / name)


def test_missing_files_and_folders_raise(tmp_path: Path) -> None:
    with pytest.raises(ScanError, match=r"nowhere\.ply: no such file"):
        Scan.load(tmp_path / "nowhere.ply")
    (tmp_path / "folder.ply").mkdir()
    with pytest.raises(ScanError, match="this is a folder"):
        Scan.load(tmp_path / "folder.ply")


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("scan.ply", ply_ascii(POINTS)),
        ("scan.ply", ply_binary("<")),
        ("scan.ply", polygon_ply("ascii")),
        ("scan.ply", polygon_ply("binary_little_endian")),
        ("scan.pcd", pcd_ascii()),
        ("scan.pcd", pcd_binary()),
        ("scan.pcd", pcd_compressed()),
        ("scan.csv", text_rows(POINTS, ",").encode()),
        ("scan.npy", npy(POINTS)),
        ("scan.npz", npz(points=POINTS)),
        ("mesh.obj", mesh_bytes(".obj")[:3000]),
        ("mesh.stl", mesh_bytes(".stl")),
        ("mesh.glb", mesh_bytes(".glb")),
    ],
)
def test_corrupt_files_raise_nothing_but_the_package_errors(tmp_path: Path, name: str, content: bytes) -> None:
    rng = np.random.default_rng(0)
    path = tmp_path / name
    for _ in range(40):
        broken = bytearray(content)
        for position in rng.integers(0, min(len(broken), int(rng.choice([300, 100_000]))), size=rng.integers(1, 4)):
            broken[position] = rng.integers(0, 256)
        path.write_bytes(broken[: rng.integers(len(broken) // 2, len(broken) + 1)] if rng.random() < 0.3 else broken)
        try:
            scan = Scan.load(path)
        except PwralignError as error:
            assert str(error).startswith(f"{path}: ")
        else:
            assert np.isfinite(scan.points).all() and len(scan) >= 10


def test_written_scans_come_back(tmp_path: Path) -> None:
    write_ply(tmp_path / "scan.ply", POINTS, {"intensity": np.arange(60)})
    assert np.array_equal(Scan.load(tmp_path / "scan.ply").points, POINTS)


def test_points_in_columns_are_refused(tmp_path: Path) -> None:
    columns = np.random.default_rng(0).random((3, 500))
    np.save(tmp_path / "columns.npy", columns)
    np.savez(tmp_path / "columns.npz", points=columns)
    for name in ("columns.npy", "columns.npz"):
        with pytest.raises(ScanError, match="transpose"):
            Scan.load(tmp_path / name)
    with pytest.raises(ScanError, match="transpose"):
        Scan(columns)


def test_points_of_an_archive_by_any_name(tmp_path: Path) -> None:
    cloud = np.random.default_rng(0).random((50, 3))
    np.savez(tmp_path / "cloud.npz", pcd=cloud, T=np.eye(3), colour=np.zeros((50, 4)), sensor_origin=[1.0, 2.0, 3.0])
    scan = Scan.load(tmp_path / "cloud.npz")
    assert np.array_equal(scan.points, cloud) and scan.sensor_origin is not None
    np.savez(tmp_path / "two.npz", left=cloud, right=cloud)
    with pytest.raises(ScanError, match=r"left \(50, 3\), right \(50, 3\)"):
        Scan.load(tmp_path / "two.npz")


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("a.las", "PDAL"),
        ("a.LAZ", "PDAL"),
        ("a.e57", "CloudCompare"),
        ("a.off", "trimesh"),
        ("a.mcap", "pwralign track"),
        ("a.bag", "rosbags-convert"),
        ("a.fls", "export the points as PLY"),
    ],
)
def test_other_formats_say_what_converts_them(tmp_path: Path, name: str, words: str) -> None:
    (tmp_path / name).write_bytes(b"any")
    with pytest.raises(ScanError, match=words):
        Scan.load(tmp_path / name)


def test_the_folder_of_a_bag_is_no_scan_and_the_way_is_named(tmp_path: Path) -> None:
    (tmp_path / "metadata.yaml").touch()
    with pytest.raises(ScanError, match=r"folder.*pwralign track"):
        Scan.load(tmp_path)


@pytest.mark.parametrize("heading", ["Points:0,Points:1,Points:2", "id,easting,northing,height"])
def test_a_heading_without_x_y_z_is_told(heading: str, tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(f"{heading}\n" + "1,2,3,4\n" * 20)
    with pytest.raises(ScanError, match=r"line 1: .* is not a number: a heading must call three columns x, y and z"):
        Scan.load(tmp_path / "a.csv")


def test_a_sequence_of_frames_is_no_scan(tmp_path: Path) -> None:
    cloud = np.random.default_rng(0).random((50, 3))
    np.savez(tmp_path / "sequence.npz", points=cloud, counts=[20, 30])
    with pytest.raises(ScanError, match="pwralign track"):
        Scan.load(tmp_path / "sequence.npz")


@pytest.mark.parametrize("row", ["0,1 0,2 0,3", "0,1\t-0,2\t-0,3", "-10,5 20,5 30,5 255 255 255"])
def test_decimal_commas_between_spaces_are_named(row: str, tmp_path: Path) -> None:
    (tmp_path / "a.xyz").write_text(f"{row}\n" * 20)
    with pytest.raises(ScanError, match=r"line 1: .*: write decimal points, not commas"):
        Scan.load(tmp_path / "a.xyz")


def test_decimal_commas_are_named(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("0,1;0,2;0,3\n" * 20)
    with pytest.raises(ScanError, match="line 1: '0,1' is not a number: write decimal points"):
        Scan.load(tmp_path / "a.csv")
