"""The posed model as binary glTF 2.0: one node per link, in the tree of the joints."""

from __future__ import annotations

import json
import struct
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pwralign_kin import files, se3
from pwralign_kin.export.axes import up_vector
from pwralign_kin.export.source import end_link
from pwralign_kin.model import ArticulatedModel, Visual
from pwralign_kin.render import corner_normals, distinct_rows, to_linear
from pwralign_kin.se3 import Array
from pwralign_kin.state import State

_ARRAY_BUFFER, _ELEMENT_ARRAY_BUFFER = 34962, 34963
_FLOAT, _UNSIGNED_INT = 5126, 5125


def write_glb(path: Path, model: ArticulatedModel, state: State, up: str = "z") -> None:
    """Write the model in `state` as GLB.

    The top node `scan` turns the scan's axis `up` (x, y, z, -x, -y or -z) to glTF's +y. Below it hangs one
    node per link, named after it and placed relative to its parent link. The node below a joint tells about
    it in its extras: name, type, axis (in the link's frame), value, unit and, where they exist, limits and
    what it mimics. Raises `UnknownNameError` for another `up`.
    """
    T_scan_root = model.root_placement(state)
    placements = model.link_placements(model.values(state.joints))
    joints = _joints(model, state)
    document = _Document()
    scan = document.node("scan", _turn_up(up))
    nodes: dict[str, int] = {}
    visuals: dict[str, list[Visual]] = {}
    for visual in (visual for part in model.parts for visual in part.visuals):
        visuals.setdefault(visual.link, []).append(visual)
    for link in placements:
        joint = joints.get(link)
        if joint is None:
            T, extras = T_scan_root, None
        else:
            T = se3.inverse(placements[joint["parent"]]) @ placements[link]
            extras = {"joint": joint["extras"]}
        nodes[link] = document.node(link, T, extras, document.mesh(link, visuals.get(link, [])))
    for link, index in nodes.items():
        document.hang(index, nodes[joints[link]["parent"]] if link in joints else scan)
    with files.atomic_write(path) as temporary:
        temporary.write_bytes(document.binary())


def _joints(model: ArticulatedModel, state: State) -> dict[str, dict[str, Any]]:
    """Return by child link: the parent link and what the node tells about the joint."""
    from lxml import etree

    values = model.values(state.joints)
    moving = {part.joint.name: part.joint for part in model.parts if part.joint is not None}
    joints: dict[str, dict[str, Any]] = {}
    for element in etree.fromstring(model.normalised_urdf).iterfind("joint"):
        name, kind = str(element.get("name")), str(element.get("type"))
        extras: dict[str, Any] = {"name": name, "type": kind}
        if name in moving:
            joint = moving[name]
            extras["axis"] = joint.axis.tolist()
            extras["value"] = float(joint.multiplier * values[joint.actuated] + joint.offset)
            extras["unit"] = "m" if kind == "prismatic" else "rad"
            limit, mimic = element.find("limit"), element.find("mimic")
            if limit is not None:
                extras["limits"] = [float(limit.get(end, "nan")) for end in ("lower", "upper")]
            if mimic is not None:
                leader = model.joint_names[joint.actuated]
                extras["mimic"] = {"joint": leader, "multiplier": joint.multiplier, "offset": joint.offset}
        joints[end_link(element, "child")] = {"parent": end_link(element, "parent"), "extras": extras}
    return joints


def _turn_up(up: str) -> Array:
    """Return the rotation (4, 4) that takes the axis named `up` to +y."""
    upward, y = up_vector(up), np.array([0.0, 1.0, 0.0])
    T = np.eye(4)
    if upward @ y < -0.5:
        T[:3, :3] = np.diag([1.0, -1.0, -1.0])
    elif upward @ y < 0.5:
        T[:3, :3] = np.rint(se3.rotation_about(np.cross(upward, y), np.pi / 2.0))
    return T


@dataclass
class _Document:
    """A glTF document in the making; field names of the JSON as in the glTF 2.0 specification."""

    nodes: list[dict[str, Any]] = field(default_factory=list)
    meshes: list[dict[str, Any]] = field(default_factory=list)
    materials: dict[tuple[float, ...], int] = field(default_factory=dict)
    accessors: list[dict[str, Any]] = field(default_factory=list)
    views: list[dict[str, Any]] = field(default_factory=list)
    chunks: list[bytes] = field(default_factory=list)
    length: int = 0

    def node(self, name: str, T: Array, extras: dict[str, Any] | None = None, mesh: int | None = None) -> int:
        """Add a node with the local placement `T` and return its index."""
        node: dict[str, Any] = {"name": name}
        if not np.array_equal(T, np.eye(4)):
            node |= {"translation": T[:3, 3].tolist(), "rotation": se3.quaternion_xyzw(T).tolist()}
        if mesh is not None:
            node["mesh"] = mesh
        if extras is not None:
            node["extras"] = extras
        self.nodes.append(node)
        return len(self.nodes) - 1

    def hang(self, child: int, parent: int) -> None:
        """Put the node `child` below the node `parent`."""
        self.nodes[parent].setdefault("children", []).append(child)

    def mesh(self, name: str, visuals: list[Visual]) -> int | None:
        """Add one mesh with a primitive per visual; return its index, None without triangles."""
        primitives = [self._primitive(visual) for visual in visuals if len(visual.faces)]
        if not primitives:
            return None
        self.meshes.append({"name": name, "primitives": primitives})
        return len(self.meshes) - 1

    def binary(self) -> bytes:
        """Return the GLB container: header, JSON chunk, binary chunk."""
        document: dict[str, Any] = {
            "asset": {"version": "2.0", "generator": "pwralign-kin"},
            "scene": 0,
            "scenes": [{"nodes": [0]}],
            "nodes": self.nodes,
            "meshes": self.meshes,
            "materials": [_material(rgba) for rgba in self.materials],
            "accessors": self.accessors,
            "bufferViews": self.views,
            "buffers": [{"byteLength": self.length}],
        }
        text = json.dumps(document, separators=(",", ":"), allow_nan=False).encode()
        text += b" " * (-len(text) % 4)
        body = b"".join(self.chunks)
        size = 12 + 8 + len(text) + 8 + len(body)
        return b"".join(
            [b"glTF", struct.pack("<II", 2, size), struct.pack("<I", len(text)), b"JSON", text,
             struct.pack("<I", len(body)), b"BIN\0", body]
        )  # fmt: skip

    def _primitive(self, visual: Visual) -> dict[str, Any]:
        """Add the triangles of `visual` in its link's frame, with a vertex per distinct place and normal."""
        placed = se3.transform(visual.T_link_visual, visual.vertices)
        corners = np.concatenate([placed[visual.faces], corner_normals(placed, visual.faces)], axis=2)
        rows = np.ascontiguousarray(corners.reshape(-1, 6).astype("<f4") + np.float32(0.0))
        first, index = distinct_rows(rows.view(np.uint64))  # two numbers at a time
        vertices = rows[first]
        rgba = tuple(np.clip(visual.rgba, 0.0, 1.0).tolist())
        return {
            "attributes": {
                "POSITION": self._vectors(vertices[:, :3], bounds=True),
                "NORMAL": self._vectors(vertices[:, 3:]),
            },
            "indices": self._indices(index),
            "material": self.materials.setdefault(rgba, len(self.materials)),
        }

    def _vectors(self, rows: NDArray[np.float32], bounds: bool = False) -> int:
        limits = {"min": rows.min(axis=0).tolist(), "max": rows.max(axis=0).tolist()} if bounds else {}
        form = {"componentType": _FLOAT, "count": len(rows), "type": "VEC3", **limits}
        return self._accessor(rows.tobytes(), _ARRAY_BUFFER, form)

    def _indices(self, index: NDArray[np.int64]) -> int:
        form = {"componentType": _UNSIGNED_INT, "count": len(index), "type": "SCALAR"}
        return self._accessor(index.astype("<u4").tobytes(), _ELEMENT_ARRAY_BUFFER, form)

    def _accessor(self, data: bytes, target: int, form: dict[str, Any]) -> int:
        """Append `data`, whose length is a multiple of four, and return the index of the accessor to it."""
        self.views.append({"buffer": 0, "byteOffset": self.length, "byteLength": len(data), "target": target})
        self.chunks.append(data)
        self.length += len(data)
        self.accessors.append({"bufferView": len(self.views) - 1, **form})
        return len(self.accessors) - 1


def _material(rgba: tuple[float, ...]) -> dict[str, Any]:
    """Return a matt material, shown from both sides because the winding of CAD faces is not to be trusted."""
    linear = to_linear(np.array(rgba[:3])).tolist()
    material: dict[str, Any] = {
        "pbrMetallicRoughness": {
            "baseColorFactor": [*linear, rgba[3]],
            "metallicFactor": 0.0,
            "roughnessFactor": 0.6,
        },
        "doubleSided": True,
    }
    if rgba[3] < 1.0:
        material["alphaMode"] = "BLEND"
    return material
