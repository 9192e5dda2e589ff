"""The posed model as GLB and PLY, read back by trimesh."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import numpy as np
import pytest
import trimesh
from boxbot import BOT_VALUES

from pwralign_kin.exceptions import UnknownNameError
from pwralign_kin.export.axes import UP_AXES, up_vector
from pwralign_kin.export.glb import write_glb
from pwralign_kin.export.mesh import write_model_ply
from pwralign_kin.model import ArticulatedModel
from pwralign_kin.render import posed_mesh
from pwralign_kin.se3 import transform
from pwralign_kin.state import State


def links(model: ArticulatedModel, state: State) -> dict[str, np.ndarray]:
    placements = model.link_placements(model.values(state.joints))
    return {name: model.root_placement(state) @ T for name, T in placements.items()}


@pytest.mark.parametrize("up", UP_AXES)
def test_every_link_is_a_node_at_its_place(bot: ArticulatedModel, bot_state: State, tmp_path: Path, up: str) -> None:
    write_glb(tmp_path / "model.glb", bot, bot_state, up)
    graph = trimesh.load_scene(tmp_path / "model.glb").graph
    turn, _ = graph.get("scan")
    assert np.allclose(turn[:3, :3] @ up_vector(up), [0.0, 1.0, 0.0])
    assert np.linalg.det(turn[:3, :3]) == pytest.approx(1.0)
    assert np.allclose(turn[:3, 3], 0.0)
    for name, T_scan_link in links(bot, bot_state).items():
        assert np.allclose(graph.get(name)[0], turn @ T_scan_link, atol=1e-12), name


def test_nodes_hang_as_the_links_do(bot: ArticulatedModel, bot_state: State, tmp_path: Path) -> None:
    write_glb(tmp_path / "model.glb", bot, bot_state)
    parents = trimesh.load_scene(tmp_path / "model.glb").graph.transforms.parents
    expected = {
        "base": "scan",
        "flange": "base",
        "arm": "flange",
        "slide": "arm",
        "left": "slide",
        "right": "slide",
    }
    assert {name: parents[name] for name in expected} == expected


def test_nodes_tell_about_their_joints(bot: ArticulatedModel, bot_state: State, tmp_path: Path) -> None:
    write_glb(tmp_path / "model.glb", bot, bot_state)
    data = (tmp_path / "model.glb").read_bytes()
    (length,) = struct.unpack("<I", data[12:16])
    nodes = {node["name"]: node for node in json.loads(data[20 : 20 + length])["nodes"]}
    assert "extras" not in nodes["base"]
    assert nodes["flange"]["extras"]["joint"] == {"name": "mount", "type": "fixed"}
    assert nodes["arm"]["extras"]["joint"] == {
        "name": "shoulder", "type": "revolute", "axis": [0.0, 0.6, 0.8],
        "limits": [-2.0, 2.0], "value": 0.7, "unit": "rad",
    }  # fmt: skip
    assert "limits" not in nodes["slide"]["extras"]["joint"]
    thumb = nodes["right"]["extras"]["joint"]
    assert thumb["value"] == pytest.approx(BOT_VALUES["thumb"])
    assert thumb["unit"] == "m"
    assert thumb["mimic"] == {"joint": "finger", "multiplier": 2.0, "offset": 0.01}


def test_surfaces_and_colours_are_those_of_the_model(bot: ArticulatedModel, bot_state: State, tmp_path: Path) -> None:
    write_glb(tmp_path / "model.glb", bot, bot_state, up="y")
    scene = trimesh.load_scene(tmp_path / "model.glb")
    mesh = posed_mesh(bot, bot_state)
    truth = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    assert scene.to_mesh().area == pytest.approx(truth.area, rel=1e-5)
    assert scene.bounds == pytest.approx(truth.bounds, abs=1e-6)
    base = scene.geometry[scene.graph.get("base")[1]]
    assert base.visual.material.baseColorFactor[:3] == pytest.approx(255.0 * np.array([0.8, 0.4, 0.2]) ** 2.2, abs=3.0)
    # A box keeps its edges sharp: every corner has one normal per side.
    assert np.allclose(np.abs(base.vertex_normals).max(axis=1), 1.0)
    outward = np.einsum("ni,ni->n", base.vertices, base.vertex_normals)
    assert (outward > 0.0).all()


def test_the_same_state_gives_the_same_bytes(bot: ArticulatedModel, bot_state: State, tmp_path: Path) -> None:
    for name in ("one", "two"):
        write_glb(tmp_path / f"{name}.glb", bot, bot_state)
    assert (tmp_path / "one.glb").read_bytes() == (tmp_path / "two.glb").read_bytes()


def test_an_unknown_up_axis_is_refused(bot: ArticulatedModel, bot_state: State, tmp_path: Path) -> None:
    with pytest.raises(UnknownNameError, match="did you mean 'z'"):
        write_glb(tmp_path / "model.glb", bot, bot_state, up="zz")
    assert not list(tmp_path.iterdir())


def test_ply_is_the_model_in_the_scan_frame(bot: ArticulatedModel, bot_state: State, tmp_path: Path) -> None:
    write_model_ply(tmp_path / "model.ply", bot, bot_state)
    ply = trimesh.load_mesh(tmp_path / "model.ply", process=False)
    mesh = posed_mesh(bot, bot_state)
    assert np.allclose(ply.vertices, mesh.vertices, atol=1e-12)
    assert np.array_equal(ply.faces, mesh.faces)
    on_base = len(bot.parts[0].visuals[0].vertices)
    assert (ply.visual.vertex_colors[:on_base, :3] == [204, 102, 51]).all()
    corners = transform(bot_state.T_scan_base, np.array([[0.2, 0.15, 0.05], [-0.2, -0.15, -0.05]]))
    for corner in corners:
        assert np.linalg.norm(ply.vertices[:on_base] - corner, axis=1).min() < 1e-12
