"""`pwralign inspect`: what a URDF, and a scan beside it, hold."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from pwralign_kin.cli import messages
from pwralign_kin.cli.model_options import MODEL_OPTIONS, ModelOptions, Urdf
from pwralign_kin.cli.scan_options import CAMERA_OPTIONS, CameraOptions, ScanOptions, ScanPath
from pwralign_kin.cli.table import table
from pwralign_kin.exceptions import MissingMeshError
from pwralign_kin.lengths import METRES, PLURALS

if TYPE_CHECKING:
    from pwralign_kin.model import ArticulatedModel, MovingJoint
    from pwralign_kin.scan import Scan


SCENE = 2.0
"""A scan so many times as large as the model shows more than the model."""


def inspect(
    urdf: Urdf,
    scan: ScanPath | None = None,
    /,
    *,
    camera: CameraOptions = CAMERA_OPTIONS,
    model_options: ModelOptions = MODEL_OPTIONS,
) -> None:
    """Show the parts and joints of a URDF, what is missing or was mended, and what a scan holds."""
    with messages.progress() as show:
        show("reading the model")
        try:
            model = model_options.read(urdf)
        except MissingMeshError as error:
            messages.answer(_missing(error))
            raise
    messages.answer(_described(model))
    if scan is not None:
        messages.answer(f"\n{_compared(ScanOptions(depth=camera).read(scan), model)}")


def _missing(error: MissingMeshError) -> str:
    rows = [
        (mesh if place == 0 else "", str(path))
        for mesh, paths in error.meshes.items()
        for place, path in enumerate(paths or ["no package of this name is found"])
    ]
    return table(("missing mesh", "looked for at"), rows)


def _described(model: ArticulatedModel) -> str:
    pieces = [
        f"{model.name}: {_count(model.parts, 'part')}, {_count(model.joint_names, 'joint')}, "
        f"{_length(model.diagonal)} across, root link {model.root_link}",
        _parts(model),
    ]
    if model.joint_names:
        pieces.append(_joints(model))
    if model.unobservable:
        pieces.append(f"no scan can tell, all geometry is on one side: {', '.join(model.unobservable)}")
    if model.warnings:
        pieces.append("\n".join(["mended or worth a look:", *(f"  {warning}" for warning in model.warnings)]))
    return "\n\n".join(pieces)


def _parts(model: ArticulatedModel) -> str:
    """Return the part graph as an indented tree, each part with the joint that it hangs on."""
    depth: list[int] = []
    rows = []
    for part in model.parts:
        depth.append(depth[part.parent] + 1 if part.parent >= 0 else 0)
        size, triangles = (_length(part.size), str(len(part.faces))) if len(part.faces) else ("-", "-")
        hinge = "" if part.joint is None else part.joint.name
        rows.append(("  " * depth[-1] + part.name, size, triangles, str(len(part.links)), hinge))
    return table(("part", " size", " triangles", " links", "hangs on joint"), rows)


def _joints(model: ArticulatedModel) -> str:
    own = {part.joint.name: part.joint for part in model.parts if part.joint is not None}
    followers: dict[str, list[str]] = {}
    for joint in own.values():
        leader = model.joint_names[joint.actuated]
        if joint.name != leader:
            followers.setdefault(leader, []).append(_relation(joint))
    rows = []
    for index, name in enumerate(model.joint_names):
        turns = bool(model.continuous[index])
        limits = [_value(limits[index], model.units[name]) for limits in (model.lower, model.upper)]
        kind = "continuous" if turns else own[name].kind
        rows.append((name, kind, *limits, ", ".join(followers.get(name, ()))))
    return table(("joint", "kind", " from", " to", "mimicked by"), rows)


def _relation(joint: MovingJoint) -> str:
    offset = f" {joint.offset:+g}" if joint.offset else ""
    return f"{joint.name} = {joint.multiplier:g} x{offset}"


def _compared(scan: Scan, model: ArticulatedModel) -> str:
    """Return what the scan holds and which unit makes sense beside the model."""
    from pwralign_kin.scan import likely_unit, units_of_it_alone

    origin = {None: "unknown", 1: "one", 2: "one per point"}[
        None if scan.sensor_origin is None else scan.sensor_origin.ndim
    ]
    dropped = ", ".join(f"{count} {why.replace('_', '-')}" for why, count in scan.dropped.items() if count)
    unit = likely_unit(scan, model.diagonal)
    ratio = METRES[unit] * scan.diagonal / model.diagonal
    rows = [
        ("points", str(len(scan))),
        ("dropped", dropped or "none"),
        ("likely unit", _in_words(unit, ratio, units_of_it_alone(scan, model.diagonal), image=scan.camera is not None)),
        ("extent", f"{' x '.join(f'{length:.4g}' for length in scan.extent)} {unit}"),
        ("beside the model", f"in {unit} {ratio:.3g} times as large"),
        ("sensor origin", origin),
        ("normals", "none" if scan.normals is None else "given"),
    ]
    return table(("scan", scan.source), rows)


def _in_words(unit: str, ratio: float, alone: Sequence[str], *, image: bool) -> str:
    """Return the likely unit and what to do about it, of a scan or depth `image` that is `ratio` models large in it.

    In the units of `alone` it would be of the model alone.
    """
    scale = f"its --depth-scale is {METRES[unit]:g} times the one in use" if image else f"use --units {unit}"
    if unit != "m":
        return f"{unit}: {scale}"
    if ratio <= SCENE:
        return unit
    other = "depth in another unit: give --depth-scale" if image else "in a unit that is not read: scale it to m"
    if alone and not image:
        other = f"in {PLURALS[alone[0]]}: use --units {alone[0]}"
    return f"{unit}, if it shows more than the model; else it is {other}"


def _count(things: Sequence[object], name: str) -> str:
    return f"{len(things)} {name}{'' if len(things) == 1 else 's'}"


def _length(metres: float) -> str:
    return f"{metres:.3g} m" if metres >= 1.0 else f"{1e3 * metres:.3g} mm"


def _value(value: float, unit: str) -> str:
    return f"{math.degrees(value):.1f} deg" if unit == "rad" else f"{1e3 * value:.1f} mm"
