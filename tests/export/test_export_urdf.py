"""The aligned URDF, read back by Pinocchio and yourdfpy, which know nothing of this package."""

from __future__ import annotations

import logging
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import trimesh
import yourdfpy
from boxbot import BOT_VALUES, estimate_from, placement, read_quickly
from lxml import etree

from pwralign_kin import se3
from pwralign_kin.export.joints import joint_values
from pwralign_kin.export.urdf import write_aligned_urdf
from pwralign_kin.model import ArticulatedModel
from pwralign_kin.state import State

BOX = '<visual><geometry><box size="0.2 0.3 0.4"/></geometry></visual>'
LIMIT = '<limit lower="-1" upper="1" effort="1" velocity="1"/>'


def link(name: str, content: str = BOX) -> str:
    return f'<link name="{name}">{content}</link>'


def joint(name: str, parent: str, child: str, kind: str = "revolute", content: str = LIMIT) -> str:
    ends = f'<parent link="{parent}"/><child link="{child}"/>'
    return f'<joint name="{name}" type="{kind}">{ends}{content}</joint>'


def robot(*body: str, head: str = '<robot name="robot">') -> str:
    return f"{head}{''.join(body)}</robot>"


def written(model: ArticulatedModel, state: State, folder: Path) -> Path:
    folder.mkdir(exist_ok=True)
    write_aligned_urdf(folder / "aligned.urdf", model, state, folder)
    return folder / "aligned.urdf"


def by_pinocchio(path: Path, values: Mapping[str, float]) -> dict[str, np.ndarray]:
    """Placement of every link in the root of the URDF."""
    model = pin.buildModelFromUrdf(str(path))
    q = pin.neutral(model)
    for name, value in values.items():
        one = model.joints[model.getJointId(name)]
        q[one.idx_q : one.idx_q + one.nq] = [value] if one.nq == 1 else [np.cos(value), np.sin(value)]
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    return {
        frame.name: data.oMf[index].homogeneous
        for index, frame in enumerate(model.frames)
        if frame.type == pin.FrameType.BODY
    }


def by_yourdfpy(path: Path, values: Mapping[str, float]) -> tuple[dict[str, np.ndarray], yourdfpy.URDF]:
    urdf = yourdfpy.URDF.load(str(path), load_meshes=False, build_scene_graph=True)
    urdf.update_cfg({name: values[name] for name in urdf.actuated_joint_names})
    return {name: urdf.get_transform(name) for name in urdf.link_map}, urdf


def joint_gap(urdf: yourdfpy.URDF, values: Mapping[str, float]) -> float:
    """Largest distance between a joint's child frame and parent @ origin @ motion."""
    gaps = [0.0]
    for one in urdf.joint_map.values():
        motion = np.eye(4)
        axis = np.asarray(one.axis, dtype=float)
        if one.type == "prismatic":
            motion[:3, 3] = values[one.name] * axis / np.linalg.norm(axis)
        elif one.type != "fixed":
            motion[:3, :3] = se3.rotation_about(axis / np.linalg.norm(axis), values[one.name])
        origin = np.eye(4) if one.origin is None else one.origin
        expected = urdf.get_transform(one.parent) @ origin @ motion
        gaps.append(float(np.abs(expected - urdf.get_transform(one.child)).max()))
    return max(gaps)


def assert_placed(model: ArticulatedModel, state: State, folder: Path, scan_link: str = "world") -> None:
    """Check the URDF written for `state` against the model's own kinematics, joint gaps included."""
    path = written(model, state, folder)
    values = joint_values(model, state).single
    truth = {
        name: model.root_placement(state) @ T
        for name, T in model.link_placements(model.values(state.joints)).items()
        if name != scan_link
    }
    estimate = estimate_from(model, state, np.zeros(0, dtype=np.int64))
    from_yourdfpy, urdf = by_yourdfpy(path, values)
    assert urdf.base_link == scan_link
    assert joint_gap(urdf, values) < 1e-9
    for placements in (by_pinocchio(path, values), from_yourdfpy):
        assert np.allclose(placements[scan_link], np.eye(4), rtol=0.0, atol=1e-12)
        for name, T in truth.items():
            assert np.abs(placements[name] - T).max() < 1e-9, name
        for name, part in estimate.parts.items():
            if name != scan_link:
                assert np.abs(placements[name] - part.T_scan_part).max() < 1e-9, name


def random_tree(rng: np.random.Generator, count: int) -> str:
    """A robot of `count` links with random origins, axes, joint types and mimics."""
    body, leaders = [link("l0")], []
    for index in range(1, count):
        kind = rng.choice(["revolute", "continuous", "prismatic", "fixed"])
        xyz, rpy, axis = rng.normal(size=(3, 3))
        content = f'<origin xyz="{" ".join(map(repr, xyz.tolist()))}" rpy="{" ".join(map(repr, rpy.tolist()))}"/>'
        if kind != "fixed":
            content += f'<axis xyz="{" ".join(map(repr, axis.tolist()))}"/>' + LIMIT
            if leaders and rng.random() < 0.3:
                content += f'<mimic joint="{rng.choice(leaders)}" multiplier="-0.5" offset="0.1"/>'
            else:
                leaders.append(f"j{index}")
        body += [
            link(f"l{index}"),
            joint(f"j{index}", f"l{rng.integers(index)}", f"l{index}", str(kind), content),
        ]
    return robot(*body)


def test_bot_is_placed_without_joint_gaps(bot: ArticulatedModel, bot_state: State, tmp_path: Path) -> None:
    assert joint_values(bot, bot_state).single == pytest.approx(BOT_VALUES)
    assert_placed(bot, bot_state, tmp_path)


def test_meshes_of_package_folders_are_found_again(tmp_path: Path) -> None:
    (tmp_path / "elsewhere").mkdir()
    trimesh.creation.box((1, 1, 1)).export(tmp_path / "elsewhere" / "box.stl")
    (tmp_path / "robot.urdf").write_text(
        robot(link("a", '<visual><geometry><mesh filename="box.stl"/></geometry></visual>'))
    )
    model = read_quickly(tmp_path / "robot.urdf", package_dirs=[tmp_path / "elsewhere"])
    path = written(model, State(), tmp_path / "out")
    mesh = etree.parse(str(path)).find(".//mesh")
    assert mesh is not None and (path.parent / mesh.get("filename", "")).is_file()


def test_what_was_forgiven_on_reading_is_forgiven_on_writing(tmp_path: Path) -> None:
    body = link("a"), link("b"), joint("j", "a", "b")
    (tmp_path / "robot.urdf").write_text(robot(*body, "<sim:plugin/>", head='<?xml version="0.0" ?><robot name="r">'))
    model = read_quickly(tmp_path / "robot.urdf")
    path = written(model, State(np.eye(4), {"j": 0.5}), tmp_path / "out")
    assert set(by_pinocchio(path, {"j": 0.5})) == {"world", "a", "b"}


@pytest.mark.parametrize("name", ["panda_description/urdf/panda.urdf", "xarm_description/urdf/xarm7.urdf"])
def test_real_robots_are_placed_without_joint_gaps(wheel_folder: Path, name: str, tmp_path: Path) -> None:
    model = read_quickly(wheel_folder / name)
    values = np.random.default_rng(2).uniform(model.lower, model.upper)
    state = State(placement(3), dict(zip(model.joint_names, values.tolist(), strict=True)), model.root_link)
    assert_placed(model, state, tmp_path)


@pytest.mark.parametrize("seed", range(8))
def test_random_trees_are_placed_without_joint_gaps(
    seed: int, read: Callable[[str], ArticulatedModel], tmp_path: Path
) -> None:
    rng = np.random.default_rng(seed)
    model = read(random_tree(rng, int(rng.integers(2, 12))))
    values = rng.uniform(model.lower, model.upper)
    base = model.parts[rng.integers(len(model.parts))].links[-1]
    assert_placed(model, State(placement(seed), dict(zip(model.joint_names, values, strict=True)), base), tmp_path)


def test_planar_and_floating_joints_stand_where_they_are(
    read: Callable[[str], ArticulatedModel], tmp_path: Path
) -> None:
    origin = '<origin xyz="0.1 0.2 0.3" rpy="0.4 0.5 0.6"/>'
    model = read(
        robot(
            link("a"), link("b"), link("c"), link("d"),
            joint("table", "a", "b", "planar", f'{origin}<axis xyz="0 0 1"/>'),
            joint("fly", "b", "c", "floating", origin),
            joint("hinge", "c", "d"),
        )
    )  # fmt: skip
    values = dict(
        zip(model.joint_names, np.random.default_rng(4).uniform(-0.4, 0.4, len(model.joint_names)), strict=True)
    )
    path = written(model, State(placement(4), values, "a"), tmp_path)
    placements = by_pinocchio(path, {"hinge": values["hinge"]})
    for name, T in model.link_placements(model.values(values)).items():
        if name in placements:  # the links between their components are ours alone
            assert np.abs(placements[name] - placement(4) @ T).max() < 1e-9, name
    assert {"a", "b", "c", "d"} <= placements.keys()


@pytest.mark.parametrize("pitch", [np.pi / 2, -np.pi / 2, np.pi / 2 - 1e-8, -np.pi / 2 + 3e-8, np.pi / 2 - 1e-5])
def test_a_placement_at_gimbal_lock_keeps_its_precision(
    pitch: float, bot: ArticulatedModel, bot_state: State, tmp_path: Path
) -> None:
    T = np.eye(4)
    for axis, angle in ((2, 0.8), (1, pitch), (0, -0.3)):
        T[:3, :3] = T[:3, :3] @ se3.rotation_about(np.eye(3)[axis], angle)
    path = written(bot, State(T, bot_state.joints, "base"), tmp_path)
    assert np.abs(by_pinocchio(path, BOT_VALUES)["base"] - T).max() < 1e-14


def test_everything_else_in_the_text_is_kept(
    bot: ArticulatedModel, bot_path: Path, bot_state: State, tmp_path: Path
) -> None:
    text = written(bot, bot_state, tmp_path).read_text()
    before = bot_path.read_text().splitlines()
    kept = [line for line in before if line in text.splitlines()]
    changed = [line for line in before if line not in kept]
    assert [line.strip() for line in changed] == [
        '<?xml version="1.0"?>',
        # an XML writer may put attributes in another order
        '<robot name="bot" xmlns:xacro="http://www.ros.org/wiki/xacro">',
        '<geometry><mesh filename="meshes/wedge.stl"/></geometry>',
    ]
    assert "<!-- made by hand -->" in text
    assert text.count('xmlns:xacro="http://www.ros.org/wiki/xacro"') == 1


def test_relative_names_resolve_from_the_new_place_and_others_stay(
    read: Callable[[str], ArticulatedModel],
    bot: ArticulatedModel,
    bot_path: Path,
    bot_state: State,
    tmp_path: Path,
) -> None:
    path = written(bot, bot_state, tmp_path)
    (name,) = (mesh.get("filename") for mesh in etree.parse(path).iter("mesh"))
    assert not Path(name).is_absolute()
    assert (path.parent / name).resolve() == (bot_path.parent / "meshes/wedge.stl").resolve()

    wedge = bot_path.parent / "meshes/wedge.stl"
    (tmp_path / "pkg").mkdir()
    (tmp_path / "pkg/wedge.stl").write_bytes(wedge.read_bytes())
    names = ["package://pkg/wedge.stl", f"file://{wedge}", str(wedge)]
    shapes = "".join(f'<visual><geometry><mesh filename="{name}"/></geometry></visual>' for name in names)
    model = read(robot(link("base", shapes)))
    path = written(model, State(), tmp_path / "out")
    assert [mesh.get("filename") for mesh in etree.parse(path).iter("mesh")] == names


def test_a_bundle_can_be_carried_elsewhere(tmp_path: Path) -> None:
    meshes, textures = tmp_path / "pkg" / "meshes", tmp_path / "pkg" / "textures"
    for folder in (meshes / "visual", meshes / "collision", textures):
        folder.mkdir(parents=True)
    box = trimesh.creation.box((1, 1, 1))
    obj = "\n".join(f"v {x} {y} {z}" for x, y, z in box.vertices) + "\n"
    obj += "\n".join(f"f {a} {b} {c}" for a, b, c in box.faces + 1) + "\n"
    (meshes / "visual" / "lid.obj").write_text(f"mtllib lid.mtl\n{obj}")
    (meshes / "visual" / "lid.mtl").write_text(
        "newmtl a\nKd 1 0 0\nmap_Kd -s 1 1 1 ../../textures/wood.png\nbump ../secret.txt\n"
    )
    (meshes / "secret.txt").write_text("mine")
    (textures / "wood.png").write_bytes(b"png")
    box.export(meshes / "collision" / "lid.stl")
    urdf = tmp_path / "elsewhere" / "robot.urdf"
    urdf.parent.mkdir()
    shapes = (
        '<visual><geometry><mesh filename="package://pkg/meshes/visual/lid.obj"/></geometry></visual>'
        f'<collision><geometry><mesh filename="{meshes / "collision" / "lid.stl"}"/></geometry></collision>'
    )
    urdf.write_text(robot(link("a", shapes)))
    model = read_quickly(urdf, package_dirs=[tmp_path])
    (tmp_path / "out").mkdir()
    write_aligned_urdf(tmp_path / "out" / "aligned.urdf", model, State(), tmp_path / "out", bundle=True)
    shutil.move(tmp_path / "out", tmp_path / "moved")
    shutil.rmtree(tmp_path / "pkg")
    names = [mesh.get("filename") for mesh in etree.parse(str(tmp_path / "moved" / "aligned.urdf")).iter("mesh")]
    assert names == ["meshes/meshes/visual/lid.obj", "meshes/meshes/collision/lid.stl"]
    again = read_quickly(tmp_path / "moved" / "aligned.urdf")
    assert again.diagonal == pytest.approx(model.diagonal)
    assert (tmp_path / "moved" / "meshes" / "textures" / "wood.png").read_bytes() == b"png"
    assert not list((tmp_path / "moved").rglob("secret.txt"))
    assert (tmp_path / "moved" / "meshes" / "meshes" / "visual" / "lid.mtl").is_file()


def test_a_world_with_fixed_joints_is_reused(read: Callable[[str], ArticulatedModel], tmp_path: Path) -> None:
    text = robot(
        '<link name="world"/>', link("base"), link("pillar"), link("arm"),
        joint("anchor", "world", "base", "fixed", '<origin xyz="1 2 3" rpy="0.1 0.2 0.3"/>'),
        joint("other", "world", "pillar", "fixed", ""),
        joint("elbow", "base", "arm"),
    )  # fmt: skip
    model = read(text)
    assert_placed(model, State(placement(4), {"elbow": 0.4}, "world"), tmp_path)
    tree = etree.parse(tmp_path / "aligned.urdf")
    assert len(tree.findall("link")) == 4
    assert len(tree.findall("joint")) == 3


@pytest.mark.parametrize(
    "body",
    [
        ('<link name="world"/>', link("base"), joint("lift", "world", "base", "prismatic")),
        (link("world"), link("base"), joint("anchor", "world", "base", "fixed", "")),
        (link("base"), link("world"), joint("anchor", "base", "world")),
        (link("base"), link("world"), link("scan"), joint("a", "base", "world"), joint("b", "base", "scan")),
    ],
    ids=["moving world", "world with geometry", "world as a part", "scan is taken too"],
)
def test_a_world_that_is_not_the_scan_keeps_its_place(
    body: tuple[str, ...],
    read: Callable[[str], ArticulatedModel],
    tmp_path: Path,
    caplog: pytest.LogCaptureFixture,
) -> None:
    model = read(robot(*body))
    name = "scan_2" if link("scan") in body else "scan"
    with caplog.at_level(logging.WARNING, "pwralign_kin"):
        assert_placed(model, State(placement(5), {}, model.root_link), tmp_path, scan_link=name)
    assert f"the scan frame is the new link '{name}'" in caplog.text


def test_axes_of_another_length_are_normalised(read: Callable[[str], ArticulatedModel], tmp_path: Path) -> None:
    content = '<axis xyz="0 0 2"/><limit lower="-1" upper="1" effort="1" velocity="1"/>'
    model = read(robot(link("base"), link("arm"), joint("lift", "base", "arm", "prismatic", content)))
    assert_placed(model, State(placement(8), {"lift": 0.3}), tmp_path)


def test_names_that_are_taken_are_avoided(read: Callable[[str], ArticulatedModel], tmp_path: Path) -> None:
    model = read(robot(link("base"), link("arm"), joint("world_to_base", "base", "arm")))
    assert_placed(model, State(placement(6), {"world_to_base": 0.3}), tmp_path)


def test_what_strict_readers_demand_is_filled_in(read: Callable[[str], ArticulatedModel], tmp_path: Path) -> None:
    model = read(
        robot(
            *(link(f"l{index}") for index in range(5)),
            joint("a", "l0", "l1", "revolute", ""),
            joint("b", "l1", "l2", "revolute", '<limit lower="-1" upper="1"/>'),
            joint("c", "l2", "l3", "prismatic", ""),
            joint("d", "l3", "l4", "continuous", "<limit/>"),
            head="<robot>",
        )
    )
    assert_placed(model, State(placement(7), {"a": 0.1, "b": 0.2, "c": 0.3, "d": 0.4}), tmp_path)
    tree = etree.parse(tmp_path / "aligned.urdf").getroot()
    assert tree.get("name") == "robot"
    limits = {
        one.get("name"): dict(one.find("limit").attrib) for one in tree.findall("joint") if one.get("name") in "abcd"
    }
    assert limits["b"] == {"lower": "-1", "upper": "1", "effort": "0.0", "velocity": "0.0"}
    assert set(limits["a"]) == set(limits["c"]) == set(limits["b"])
    assert set(limits["d"]) == {"effort", "velocity"}


def test_a_urdf_that_is_gone_since_is_still_written(read: Callable[[str], ArticulatedModel], tmp_path: Path) -> None:
    model = read(robot(link("base")))
    model.urdf_path.unlink()
    written(model, State(), tmp_path / "out")
    assert (tmp_path / "out").exists()
