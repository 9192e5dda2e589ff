"""The URDF placed in the scan: a copy of its text in which the link `world` is the scan frame."""

from __future__ import annotations

import logging
import math
import os
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from pwralign_kin import files, se3
from pwralign_kin.export.bundle import bundle as bundled
from pwralign_kin.export.source import end_link, source_tree
from pwralign_kin.model import ArticulatedModel
from pwralign_kin.model.meshes import find_mesh
from pwralign_kin.se3 import Array
from pwralign_kin.state import State

if TYPE_CHECKING:
    from lxml.etree import _Element as Element

logger = logging.getLogger(__name__)

WORLD = "world"


def write_aligned_urdf(path: Path, model: ArticulatedModel, state: State, folder: Path, *, bundle: bool = False) -> str:
    """Write a copy of the URDF, comments and all, placed as in `state`; return the link that is the scan.

    A link `world` becomes the root, joined to the old root by a fixed joint at T_scan_base. If the root
    already is an empty link `world` with fixed joints only, it is reused and their origins change; any other
    link of that name stays as it is and the new root gets another name. Planar and floating joints have the
    place that the state gives them as their origin, for nothing else tells viewers their values. File names
    relative to the URDF are rewritten relative to `folder`, where the file will be read; `package://` names stay.
    With `bundle` meshes and textures are copied beside `path` instead and named by their copies.
    What strict readers demand and the URDF lacks (the robot's name, limits, effort and velocity, axes of unit
    length) is mended.

    Raises `ModelError` when the URDF is gone since the model was read.
    """
    from lxml import etree

    robot = source_tree(model)
    _place_free_joints(robot, model, state)
    world = _place_root(robot, model, state)
    _mend(robot, model)
    named = {element: element.get("filename", "").strip() for element in robot.iter("mesh", "texture")}
    found = {
        element: find_mesh(name, model.urdf_path, model.package_dirs)[0] for element, name in named.items() if name
    }
    copies = bundled((file for file in found.values() if file is not None), path.parent) if bundle else {}
    for element, file in found.items():
        copy = None if file is None else copies.get(file.resolve())
        elsewhere = _seen_from(folder, named[element], file, model)
        element.set("filename", elsewhere if copy is None else copy.as_posix())
    # What stands outside the root element (comments, processing instructions) is kept, each on its own line.
    nodes = [*reversed(list(robot.itersiblings(preceding=True))), robot, *robot.itersiblings()]
    lines = [
        '<?xml version="1.0" encoding="utf-8"?>',
        *(etree.tostring(node, encoding="unicode", with_tail=False) for node in nodes),
    ]
    files.write_text(path, "\n".join(lines) + "\n")
    return world


def _place_free_joints(robot: Element, model: ArticulatedModel, state: State) -> None:
    """Put the values of planar and floating joints into their origins."""
    placements = model.link_placements(model.values(state.joints))
    for joint in robot.iterfind("joint"):
        if joint.get("type") in ("planar", "floating"):
            parent, child = (placements[end_link(joint, end)] for end in ("parent", "child"))
            _set_origin(joint, se3.inverse(parent) @ child)


def _place_root(robot: Element, model: ArticulatedModel, state: State) -> str:
    """Make the root of the tree the scan frame and return its name."""
    root = model.root_link
    T_scan_root = model.root_placement(state)
    links = {link.get("name"): link for link in robot.iterfind("link")}
    hanging = [joint for joint in robot.iterfind("joint") if end_link(joint, "parent") == root]
    empty = next(links[root].iterchildren("visual", "collision", "inertial"), None) is None
    if root == WORLD and empty and all(joint.get("type") == "fixed" for joint in hanging):
        placements = model.link_placements(model.values(state.joints))
        for joint in hanging:
            _set_origin(joint, T_scan_root @ placements[end_link(joint, "child")])
        return WORLD

    world = _unused(WORLD if WORLD not in links else "scan", links)
    if world != WORLD:
        logger.warning(
            "%s: its link %r moves or has content of its own; the scan frame is the new link %r",
            model.urdf_path, WORLD, world,
        )  # fmt: skip
    from lxml import etree

    joints = [joint.get("name") for joint in robot.iterfind("joint")]
    link = etree.Element("link", name=world)
    joint = etree.Element("joint", name=_unused(f"{world}_to_{root}", joints), type="fixed")
    etree.SubElement(joint, "parent", link=world)
    etree.SubElement(joint, "child", link=root)
    _set_origin(joint, T_scan_root)
    indent = robot.text if robot.text and not robot.text.strip() else "\n  "
    etree.indent(joint, space=indent.rpartition("\n")[2], level=1)
    comment = etree.Comment(f" {world} is the scan frame; the joint below is the estimated placement in it ")
    for position, element in enumerate((comment, link, joint)):
        element.tail = indent
        robot.insert(position, element)
    robot.text = indent
    return world


def _mend(robot: Element, model: ArticulatedModel) -> None:
    """Fill in what strict readers demand and the URDF lacks, with the values that the model was read with."""
    from lxml import etree

    if not robot.get("name", "").strip():
        robot.set("name", model.name)
    mended = {joint.get("name"): joint for joint in etree.fromstring(model.normalised_urdf).iterfind("joint")}
    for joint in robot.iterfind("joint"):
        if joint.get("type") not in ("revolute", "prismatic", "continuous"):
            continue
        as_read = mended[joint.get("name")]
        axis, unit_axis = joint.find("axis"), as_read.find("axis")
        if axis is not None and unit_axis is not None and math.dist(_numbers(axis), _numbers(unit_axis)) > 1e-12:
            axis.set("xyz", unit_axis.get("xyz", ""))  # readers differ in what a longer axis means
        limit, known = joint.find("limit"), as_read.find("limit")
        if limit is None and known is not None:
            limit = etree.SubElement(joint, "limit")
        if limit is None:  # a continuous joint needs none
            continue
        for key in ("lower", "upper", "effort", "velocity"):
            value = known.get(key) if known is not None else "0.0" if key in ("effort", "velocity") else None
            if limit.get(key) is None and value is not None:
                limit.set(key, value)


def _seen_from(folder: Path, filename: str, found: Path | None, model: ArticulatedModel) -> str:
    """Return the name by which the file that is `filename` in the model's URDF is found from a URDF in `folder`."""
    plain = filename.removeprefix("file://")
    if "://" in plain or Path(plain).is_absolute():
        return filename
    target = (model.urdf_path.parent / plain if found is None else found).resolve()
    try:
        return Path(os.path.relpath(target, folder.resolve())).as_posix()
    except ValueError:  # on another drive
        return target.as_posix()


def _set_origin(joint: Element, T: Array) -> None:
    """Write the placement `T` as the joint's origin, so exactly that reading it back gives `T` to 1e-15."""
    from lxml import etree

    origin = joint.find("origin")
    if origin is None:
        origin = etree.SubElement(joint, "origin")
    origin.attrib.clear()
    origin.set("xyz", _text(T[:3, 3]))
    origin.set("rpy", _text(se3.roll_pitch_yaw(T)))


def _numbers(axis: Element) -> list[float]:
    return [float(word) for word in axis.get("xyz", "").replace(",", " ").split()]


def _text(numbers: Iterable[float]) -> str:
    return " ".join(f"{number + 0.0:.17g}" for number in numbers)


def _unused(name: str, taken: Iterable[str | None]) -> str:
    """Return `name`, with a number where it is taken."""
    names = set(taken)
    candidate, number = name, 1
    while candidate in names:
        number += 1
        candidate = f"{name}_{number}"
    return candidate
