"""Primitives, mesh formats, scale, colours, degenerate triangles, and where meshes are looked for."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh
from urdf_text import BOX, LIMIT, joint, link

from pwralign_kin.exceptions import MissingMeshError, ModelError
from pwralign_kin.model import ArticulatedModel, Part
from pwralign_kin.model.meshes import GREY

Read = Callable[..., ArticulatedModel]
WriteUrdf = Callable[..., Path]


def visual(form: str, before: str = "", after: str = "") -> str:
    return f"<visual>{before}<geometry>{form}</geometry>{after}</visual>"


def mesh_link(filename: str, attributes: str = "", after: str = "") -> str:
    return link("a", visual(f'<mesh filename="{filename}" {attributes}/>', after=after))


def as_trimesh(part: Part) -> trimesh.Trimesh:
    return trimesh.Trimesh(part.vertices, part.faces, process=False)


def wedge() -> trimesh.Trimesh:
    """A closed solid without any symmetry, volume 1."""
    return trimesh.Trimesh(
        [[0, 0, 0], [1, 0, 0], [0, 2, 0], [0, 0, 3]],
        [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]],
        process=False,
    )


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """The folder of the URDF, with a mesh in it."""
    wedge().export(tmp_path / "wedge.stl")
    return tmp_path


# ---- primitives


@pytest.mark.parametrize(
    ("form", "extent", "volume"),
    [
        ('<box size="0.2 0.3 0.4"/>', (0.2, 0.3, 0.4), 0.024),
        ('<box size="0.2, 0.3, 0.4"/>', (0.2, 0.3, 0.4), 0.024),
        ('<cylinder radius="0.1" length="0.5"/>', (0.2, 0.2, 0.5), math.pi * 0.01 * 0.5),
        ('<sphere radius="0.3"/>', (0.6, 0.6, 0.6), math.pi * 4 / 3 * 0.027),
        ('<capsule radius="0.1" length="0.5"/>', (0.2, 0.2, 0.7), math.pi * (0.01 * 0.5 + 4 / 3 * 0.001)),
    ],
)
def test_primitives(read: Read, form: str, extent: tuple[float, ...], volume: float) -> None:
    solid = as_trimesh(read(link("a", visual(form))).parts[0])
    assert solid.is_watertight and solid.volume == pytest.approx(volume, rel=0.03)
    assert np.ptp(solid.vertices, axis=0) == pytest.approx(extent, rel=0.01)
    assert solid.bounds.mean(axis=0) == pytest.approx(np.zeros(3), abs=1e-9)


def test_a_visual_origin_places_its_shape(read: Read) -> None:
    part = read(link("a", visual('<box size="2 4 6"/>', '<origin xyz="1 2 3" rpy="0 0 1.5707963267948966"/>'))).parts[0]
    assert part.vertices.min(axis=0) == pytest.approx([-1, 1, 0]) and part.vertices.max(axis=0) == pytest.approx(
        [3, 3, 6]
    )
    assert part.size == pytest.approx(math.sqrt(16 + 4 + 36))


@pytest.mark.parametrize("form", ['<sphere radius="0"/>', '<box size="0 0 0"/>', '<cylinder radius="0.1" length="0"/>'])
def test_shapes_without_extent_are_left_out(read: Read, form: str) -> None:
    model = read(link("a", BOX + visual(form)))
    assert len(model.parts[0].visuals) == 1 and "without extent" in model.warnings[0]


def test_only_shapes_without_extent_is_no_geometry(read: Read) -> None:
    with pytest.raises(ModelError, match="no geometry"):
        read(link("a", visual('<sphere radius="0"/>')))


# ---- visual and collision


def test_geometry_option(read: Read) -> None:
    body = link("a", BOX + visual('<sphere radius="1"/>').replace("visual", "collision"))
    assert read(body).diagonal < 1 < read(body, geometry="collision").diagonal
    assert read(body).content_key != read(body, geometry="collision").content_key


def test_the_other_kind_serves_the_whole_model_only(read: Read) -> None:
    hull = visual('<sphere radius="1"/>').replace("visual", "collision")
    alone = read(link("a", hull))
    assert len(alone.parts[0].faces) and "collision geometry is used" in alone.warnings[0]
    mixed = read(link("a", BOX) + link("b", hull) + joint("j", "a", "b"))
    assert len(mixed.parts[1].faces) == 0 and mixed.parts[1].size == 0.0 and mixed.unobservable == ("j",)


# ---- mesh files


@pytest.mark.parametrize("suffix", ["stl", "obj", "dae", "glb", "gltf", "ply", "off", "STL"])
def test_formats(read: Read, tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"wedge.{suffix}"
    if suffix == "gltf":
        for name, data in trimesh.Scene(wedge()).export(file_type="gltf").items():
            (tmp_path / ("wedge.gltf" if name == "model.gltf" else name)).write_bytes(data)
    else:
        wedge().export(path, file_type=suffix.lower())
    solid = as_trimesh(read(mesh_link(path.name)).parts[0])
    assert solid.is_watertight and solid.volume == pytest.approx(1.0)
    assert np.ptp(solid.vertices, axis=0) == pytest.approx([1, 2, 3])
    assert len(solid.vertices) == 4 and len(solid.faces) == 4


@pytest.mark.parametrize("suffix", ["glb", "dae"])
def test_scenes_are_flattened_with_their_transforms(read: Read, tmp_path: Path, suffix: str) -> None:
    scene = trimesh.Scene()
    scene.add_geometry(wedge(), transform=trimesh.transformations.translation_matrix([10, 0, 0]))
    scene.add_geometry(wedge())
    if suffix == "glb":
        scene.export(tmp_path / "two.glb")
    else:
        trimesh.exchange.export.export_mesh(scene.to_geometry(), tmp_path / "two.dae", file_type="dae")
    solid = as_trimesh(read(mesh_link(f"two.{suffix}")).parts[0])
    assert solid.volume == pytest.approx(2.0) and np.ptp(solid.vertices[:, 0]) == pytest.approx(11)


@pytest.mark.parametrize("scale", ["2 3 4", "-2 3 4", "-2 -3 -4", "2,3,4", "2 -3 -4"])
def test_scale_and_mirror_keep_the_outside_outside(read: Read, folder: Path, scale: str) -> None:
    solid = as_trimesh(read(mesh_link("wedge.stl", f'scale="{scale}"')).parts[0])
    assert solid.volume == pytest.approx(24.0)
    signs = np.sign([float(word) for word in scale.replace(",", " ").split()])
    assert solid.bounds.mean(axis=0) == pytest.approx(signs * [1, 3, 6])


def test_one_number_scales_all_axes(read: Read, folder: Path) -> None:
    assert as_trimesh(read(mesh_link("wedge.stl", 'scale="0.1"')).parts[0]).volume == pytest.approx(1e-3)


def test_zero_scale_is_a_fault(read: Read, folder: Path) -> None:
    with pytest.raises(ModelError, match="scale of zero"):
        read(mesh_link("wedge.stl", 'scale="1 1 0"'))


def test_a_mesh_used_twice_is_stored_once(read: Read, folder: Path) -> None:
    model = read(mesh_link("wedge.stl") + mesh_link("wedge.stl").replace('"a"', '"b"') + joint("j", "a", "b"))
    first, second = (part.visuals[0] for part in model.parts)
    assert np.shares_memory(first.vertices, second.vertices)
    assert (first.link, second.link) == ("a", "b")


def test_degenerate_triangles_are_dropped_and_counted(read: Read, tmp_path: Path) -> None:
    solid = wedge()
    vertices = np.vstack([solid.vertices, [[2, 0, 0], [np.nan, 0, 0], [0.5, 0, 0]]])
    faces = np.vstack([solid.faces, [[0, 1, 4], [0, 0, 1], [0, 1, 5], [0, 6, 1]]])
    trimesh.Trimesh(vertices, faces, process=False).export(tmp_path / "bad.ply")
    model = read(mesh_link("bad.ply"))
    assert as_trimesh(model.parts[0]).volume == pytest.approx(1.0) and len(model.parts[0].faces) == 4
    assert model.warnings == ("4 degenerate triangles dropped in bad.ply",)
    assert read(mesh_link("bad.ply")).warnings == model.warnings  # from the cache as well


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("junk.stl", b"solid junk", "junk.stl"),
        ("junk.dae", b"<COLLADA><asset>", "junk.dae"),
        ("junk.obj", b"v 0 0 0\n", "junk.obj"),
        ("junk.glb", b"\x00" * 100, "junk.glb"),
        (
            "junk.ply",
            b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n0\n",
            "junk.ply",
        ),
        ("empty.stl", b"", "empty.stl"),
        ("mesh.xyzzy", b"", "unknown format"),
    ],
)
def test_unreadable_meshes_are_named(read: Read, tmp_path: Path, name: str, content: bytes, words: str) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(ModelError, match=words) as caught:
        read(mesh_link(name))
    assert "\n" not in str(caught.value)


def test_all_unreadable_meshes_at_once(read: Read, tmp_path: Path) -> None:
    for name in ("one.stl", "two.obj"):
        (tmp_path / name).write_bytes(b"?")
    with pytest.raises(ModelError) as caught:
        read(mesh_link("one.stl") + mesh_link("two.obj").replace('"a"', '"b"') + joint("j", "a", "b"))
    assert len(caught.value.faults) == 2


def test_a_mesh_of_degenerate_triangles_only(read: Read, tmp_path: Path) -> None:
    trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [2, 0, 0]], [[0, 1, 2]], process=False).export(tmp_path / "line.ply")
    with pytest.raises(ModelError, match="no triangles"):
        read(mesh_link("line.ply"))


def test_broken_materials_of_dae_files_cost_their_colours_only(read: Read, tmp_path: Path) -> None:
    wedge().export(tmp_path / "wedge.dae")
    text = (tmp_path / "wedge.dae").read_text()
    broken = re.sub(r'(<instance_material\b[^>]*\btarget=")#', r"\1#lost-", text)
    assert broken != text
    (tmp_path / "wedge.dae").write_text(broken)
    assert as_trimesh(read(mesh_link("wedge.dae")).parts[0]).volume == pytest.approx(1.0)


def test_lines_in_a_dae_file_cost_no_colours(read: Read, tmp_path: Path) -> None:
    red = wedge()
    red.visual = trimesh.visual.TextureVisuals(
        material=trimesh.visual.material.PBRMaterial(baseColorFactor=[255, 0, 0, 255])
    )
    red.export(tmp_path / "wedge.dae")
    text = (tmp_path / "wedge.dae").read_text()
    text = text.replace("</library_geometries>", '<geometry id="rim"><mesh/></geometry></library_geometries>')
    text = text.replace("<instance_geometry", '<instance_geometry url="#rim"/><instance_geometry', 1)
    assert text.count("rim") == 2
    (tmp_path / "wedge.dae").write_text(text)
    (body,) = read(mesh_link("wedge.dae")).parts[0].visuals
    assert body.rgba is not None and body.rgba[:3] == pytest.approx((1, 0, 0), abs=0.01)


# ---- units of DAE files


def test_dae_units(read: Read, tmp_path: Path) -> None:
    wedge().export(tmp_path / "wedge.dae")
    text = (tmp_path / "wedge.dae").read_text()
    assert "<asset>" in text
    text = text.replace("<unit", "<was").replace("<asset>", '<asset><unit name="millimeter" meter="0.001"/>')
    (tmp_path / "wedge.dae").write_text(text)
    ignored, applied = read(mesh_link("wedge.dae")), read(mesh_link("wedge.dae"), mesh_units="apply")
    assert ignored.diagonal == pytest.approx(math.sqrt(14)) and "wedge.dae" in ignored.warnings[0]
    assert applied.diagonal == pytest.approx(math.sqrt(14) / 1000) and applied.warnings == ()


def test_a_model_in_millimetres_is_suspected(read: Read, folder: Path) -> None:
    assert "millimetres" in read(mesh_link("wedge.stl", 'scale="1000 1000 1000"')).warnings[0]


# ---- colours


def the_color(model: ArticulatedModel) -> list[float]:
    (piece,) = model.parts[0].visuals
    return piece.rgba.tolist()


def test_urdf_materials(read: Read) -> None:
    red = '<material name="red"><color rgba="1 0 0 0.5"/></material>'
    assert the_color(read(link("a", visual('<sphere radius="1"/>', after=red)))) == [1, 0, 0, 0.5]
    by_name = visual('<sphere radius="1"/>', after='<material name="red"/>')
    assert the_color(read(red + link("a", by_name))) == [1, 0, 0, 0.5]
    assert the_color(read(link("a", by_name))) == list(GREY)
    malformed = red.replace("1 0 0 0.5", "one")
    assert the_color(read(link("a", visual('<sphere radius="1"/>', after=malformed)))) == list(GREY)


def test_the_mesh_names_its_own_colors(read: Read, tmp_path: Path) -> None:
    (tmp_path / "two.mtl").write_text("newmtl red\nKd 1 0 0\nnewmtl blue\nKd 0 0 1\n")
    (tmp_path / "two.obj").write_text(
        "mtllib two.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nusemtl red\nf 1 2 3\nusemtl blue\nf 1 2 4\nf 1 3 4\n"
    )
    model = read(mesh_link("two.obj", after='<material name="g"><color rgba="0 1 0 1"/></material>'))
    colors = {tuple(np.round(piece.rgba, 2)): len(piece.faces) for piece in model.parts[0].visuals}
    assert colors == {(1, 0, 0, 1): 1, (0, 0, 1, 1): 2}
    (tmp_path / "two.mtl").write_text("newmtl red\nKd 1 1 0\nnewmtl blue\nKd 0 0 1\n")
    again = read(mesh_link("two.obj"))
    assert (1, 1, 0, 1) in {tuple(np.round(piece.rgba, 2)) for piece in again.parts[0].visuals}


def test_an_uncolored_mesh_takes_the_urdf_color(read: Read, folder: Path) -> None:
    green = '<material name="g"><color rgba="0 1 0 1"/></material>'
    assert the_color(read(mesh_link("wedge.stl", after=green))) == [0, 1, 0, 1]
    assert the_color(read(mesh_link("wedge.stl"))) == list(GREY)


# ---- where meshes are looked for


def place(folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    wedge().export(folder / "wedge.stl")


@pytest.mark.parametrize(
    ("filename", "where"),
    [
        ("wedge.stl", "ws/robot/urdf"),
        ("./meshes/../wedge.stl", "ws/robot/urdf"),
        ("../meshes/wedge.stl", "ws/robot/meshes"),
        ("..\\meshes\\wedge.stl", "ws/robot/meshes"),
        ("package://robot/meshes/wedge.stl", "ws/robot/meshes"),
        ("package://other/meshes/wedge.stl", "ws/other/meshes"),
        ("package://ws/robot/wedge.stl", "ws/robot"),
        ("model://robot/meshes/wedge.stl", "ws/robot/meshes"),
        ("package://renamed/meshes/wedge.stl", "ws/robot/meshes"),
        ("package://renamed/meshes/wedge.stl", "ws/robot/urdf/meshes"),
        ("package://far/wedge.stl", "packages/far"),
        ("package://packages/wedge.stl", "packages"),
        ("wedge.stl", "packages"),
        ("meshes/wedge.stl", "ws/robot/meshes"),
        ("robot/meshes/wedge.stl", "ws/robot/meshes"),
        ("package://rosy/wedge.stl", "ros/rosy"),
        ("package://amenty/wedge.stl", "ament/share/amenty"),
        ("package://robot/my%20meshes/wedge.stl", "ws/robot/my meshes"),
        ("file://ABSOLUTE/any/wedge.stl", "any"),
        ("ABSOLUTE/any/wedge.stl", "any"),
    ],
)
def test_places(
    write_urdf: WriteUrdf, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, filename: str, where: str
) -> None:
    place(tmp_path / where)
    for folder in ("ws/robot/urdf/meshes", "packages"):
        (tmp_path / folder).mkdir(parents=True, exist_ok=True)
    monkeypatch.setenv("ROS_PACKAGE_PATH", f"/nowhere:{tmp_path / 'ros'}")
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path / "ament"))
    path = write_urdf(mesh_link(filename.replace("ABSOLUTE", str(tmp_path))), "ws/robot/urdf/bot.urdf")
    model = ArticulatedModel.from_urdf(path, package_dirs=[tmp_path / "packages"])
    assert as_trimesh(model.parts[0]).volume == pytest.approx(1.0)


def test_package_dirs_come_first(write_urdf: WriteUrdf, tmp_path: Path) -> None:
    place(tmp_path / "ws/robot")
    (tmp_path / "mine/robot").mkdir(parents=True)
    wedge().apply_scale(2).export(tmp_path / "mine/robot/wedge.stl")
    path = write_urdf(mesh_link("package://robot/wedge.stl"), "ws/robot/bot.urdf")
    assert as_trimesh(ArticulatedModel.from_urdf(path).parts[0]).volume == pytest.approx(1)
    assert as_trimesh(
        ArticulatedModel.from_urdf(path, package_dirs=[str(tmp_path / "mine")]).parts[0]
    ).volume == pytest.approx(8)


def test_packages_of_a_workspace(write_urdf: WriteUrdf, tmp_path: Path) -> None:
    """By the name in their package.xml or by their folder's; where today's rules find one, it comes first."""
    for place_in, name in (("src/vendor/Robot-ROS2", "robot"), ("install/tool/share/tool", "tool")):
        place(tmp_path / "ws" / place_in / "meshes")
        (tmp_path / "ws" / place_in / "package.xml").write_text(f"<package><name>{name}</name></package>")
    for package in ("robot", "tool", "Robot-ROS2"):
        path = write_urdf(mesh_link(f"package://{package}/meshes/wedge.stl"), f"far/{package}.urdf")
        with pytest.raises(MissingMeshError, match="no package of its name"):
            ArticulatedModel.from_urdf(path)
        model = ArticulatedModel.from_urdf(path, package_dirs=[tmp_path / "ws"])
        assert as_trimesh(model.parts[0]).volume == pytest.approx(1)
    (tmp_path / "far/robot/meshes").mkdir(parents=True)
    wedge().apply_scale(2).export(tmp_path / "far/robot/meshes/wedge.stl")
    model = ArticulatedModel.from_urdf(tmp_path / "far/robot.urdf", package_dirs=[tmp_path / "ws"])
    assert as_trimesh(model.parts[0]).volume == pytest.approx(8)


def test_package_folders_that_are_none(write_urdf: WriteUrdf, tmp_path: Path) -> None:
    path = write_urdf(link("a", BOX))
    with pytest.raises(ModelError, match="there is no such folder") as caught:
        ArticulatedModel.from_urdf(path, package_dirs=[tmp_path / "none", path])
    assert len(caught.value.faults) == 2 and "it is a file" in caught.value.faults[1]
    for nonsense in (3, [3], None):
        with pytest.raises(ModelError, match="package_dirs"):
            ArticulatedModel.from_urdf(path, package_dirs=nonsense)  # type: ignore[arg-type]
    assert ArticulatedModel.from_urdf(path, package_dirs=str(tmp_path)).package_dirs == (tmp_path,)


def test_a_relative_urdf_path(write_urdf: WriteUrdf, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    place(tmp_path / "robot")
    write_urdf(mesh_link("package://robot/wedge.stl"), "robot/urdf/bot.urdf")
    monkeypatch.chdir(tmp_path / "robot/urdf")
    assert len(ArticulatedModel.from_urdf("bot.urdf").parts[0].faces) == 4


def test_missing_meshes_are_all_named(read: Read, folder: Path) -> None:
    body = link(
        "a",
        "".join(visual(f'<mesh filename="{name}"/>') for name in ("wedge.stl", "gone.stl", "package://lost/x.dae")),
    )
    with pytest.raises(MissingMeshError) as caught:
        read(body)
    assert list(caught.value.meshes) == ["gone.stl", "package://lost/x.dae"]
    assert folder / "gone.stl" in caught.value.meshes["gone.stl"]
    assert "2 missing meshes: gone.stl, package://lost/x.dae" in str(caught.value)
    assert "--package-dir" in str(caught.value)
    assert caught.value.meshes["package://lost/x.dae"] == []


def test_packages_are_not_asked_for_where_none_is_named(read: Read, folder: Path) -> None:
    with pytest.raises(MissingMeshError) as caught:
        read(link("a", visual('<mesh filename="gone.stl"/>')))
    assert str(folder / "gone.stl") in str(caught.value)
    assert "--package-dir" not in str(caught.value)


def test_names_that_only_xacro_can_read_are_said_to_be_so(read: Read) -> None:
    with pytest.raises(MissingMeshError, match="expressions of xacro"):
        read(link("a", visual('<mesh filename="$(arg meshes)/gone.stl"/>')))


def test_a_mesh_missing_from_its_package(write_urdf: WriteUrdf, tmp_path: Path) -> None:
    (tmp_path / "ws/robot/meshes").mkdir(parents=True)
    path = write_urdf(mesh_link("package://robot/meshes/gone.stl"), "ws/robot/urdf/bot.urdf")
    with pytest.raises(MissingMeshError) as caught:
        ArticulatedModel.from_urdf(path)
    assert caught.value.meshes == {"package://robot/meshes/gone.stl": [tmp_path / "ws/robot/meshes/gone.stl"]}


def test_meshes_of_the_unused_kind_may_be_missing(read: Read) -> None:
    hull = visual('<mesh filename="gone.stl"/>').replace("visual", "collision")
    assert read(link("a", BOX + hull)).warnings == ()


def test_nothing_is_fetched(read: Read) -> None:
    with pytest.raises(ModelError, match="network"):
        read(mesh_link("https://localhost/wedge.stl"))


def test_missing_companions(read: Read, tmp_path: Path) -> None:
    """Without its materials an OBJ is grey; without its buffer a glTF cannot be read."""
    text = wedge().export(file_type="obj", include_color=False)
    (tmp_path / "wedge.obj").write_text(f"mtllib gone.mtl\nusemtl red\n{text}")
    model = read(mesh_link("wedge.obj"))
    assert as_trimesh(model.parts[0]).volume == pytest.approx(1.0) and the_color(model) == list(GREY)
    (tmp_path / "wedge.gltf").write_bytes(trimesh.Scene(wedge()).export(file_type="gltf")["model.gltf"])
    with pytest.raises(ModelError, match=r"wedge\.gltf"):
        read(mesh_link("wedge.gltf"))


def test_textures_are_not_needed(read: Read, tmp_path: Path) -> None:
    (tmp_path / "wedge.mtl").write_text("newmtl skin\nKd 0 1 0\nmap_Kd gone.png\n")
    text = "mtllib wedge.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nusemtl skin\nf 1/1 2/1 3/1\n"
    (tmp_path / "wedge.obj").write_text(text)
    assert the_color(read(mesh_link("wedge.obj"))) == [0, 1, 0, 1]


# ---- the cache


def test_the_second_reading_comes_from_the_cache(read: Read, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = read(mesh_link("wedge.stl", 'scale="1 1 7"') + link("b") + joint("j", "a", "b"))
    monkeypatch.setattr(trimesh, "load_scene", lambda *args, **kwargs: pytest.fail("read again"))
    second = read(
        mesh_link("wedge.stl", 'scale="1 1 7"')
        + link("b")
        + joint("j", "a", "b", content=LIMIT + "<axis xyz='0 1 0'/>")
    )
    assert np.array_equal(first.parts[0].vertices, second.parts[0].vertices)
    assert np.array_equal(first.parts[0].faces, second.parts[0].faces) and second.parts[0].faces.dtype == np.int64


def test_a_changed_mesh_is_read_anew(read: Read, folder: Path) -> None:
    first = read(mesh_link("wedge.stl"))
    wedge().apply_scale(2).export(folder / "wedge.stl")
    second = read(mesh_link("wedge.stl"))
    assert second.diagonal == pytest.approx(2 * first.diagonal) and second.content_key != first.content_key
