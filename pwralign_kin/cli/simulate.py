"""`pwralign simulate`: scans with truth."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Parameter

from pwralign_kin.cli import arguments, messages
from pwralign_kin.cli.arguments import Joints, Seed
from pwralign_kin.cli.codes import UsageError
from pwralign_kin.cli.model_options import MODEL_OPTIONS, ModelOptions, Urdf


def simulate(
    urdf: Urdf,
    /,
    *,
    out: Annotated[Path, Parameter(help="Folder for scan.ply, truth.json and labels.npz.")],
    tier: Annotated[
        Literal["full", "single", "hololens", "sparse", "missing", "clutter", "warm"] | None,
        Parameter(help="What the scan is like, by default full; the options below change one thing each."),
    ] = None,
    views: Annotated[int | None, Parameter(help="Depth images to fuse, from all sides.")] = None,
    points: Annotated[int | None, Parameter(help="Points to keep.")] = None,
    noise: Annotated[float | None, Parameter(help="Standard deviation, in model diagonals.")] = None,
    outliers: Annotated[float | None, Parameter(help="Stray points to add, share of --points.")] = None,
    missing_part: Annotated[
        list[str] | None, Parameter(help="A part to leave out; may be repeated.", negative=())
    ] = None,
    known_origin: Annotated[
        bool | None, Parameter(help="Whether truth.json tells where the (single) view was taken from.")
    ] = None,
    scene: Annotated[
        bool,
        Parameter(help="A whole room seen by one depth camera, with the model upright in it, instead.", negative=()),
    ] = False,
    furniture: Annotated[int | None, Parameter(help="With --scene: boxes and cylinders apart from the model.")] = None,
    contacts: Annotated[int | None, Parameter(help="With --scene: things pushed against the model.")] = None,
    occluders: Annotated[int | None, Parameter(help="With --scene: things between camera and model.")] = None,
    second_copy: Annotated[
        bool | None, Parameter(help="With --scene: another copy of the model in another pose.", negative=())
    ] = None,
    table: Annotated[bool | None, Parameter(help="With --scene: whether the model stands on a table.")] = None,
    state: Annotated[Path | None, Parameter(help="A state.json of the model's pose; else random.")] = None,
    joint: Annotated[Joints, Parameter(help="name=value, rad or m; may be repeated.")] = None,
    seed: Seed = 0,
    model_options: ModelOptions = MODEL_OPTIONS,
) -> None:
    """Scan a model in software, alone or in a room: points with the truth beside them.

    In a room the model stands upright; of a --state it takes the joint values.
    """
    values = arguments.joint_values(joint)
    seen: dict[str, Any] = {
        "views": views,
        "points": points,
        "stray": outliers,
        "missing_parts": tuple(missing_part) if missing_part else None,
        "known_origin": known_origin,
    }
    around: dict[str, Any] = {
        "furniture": furniture,
        "contacts": contacts,
        "occluders": occluders,
        "second_copy": second_copy,
        "table": table,
    }
    if scene and _given(tier=tier, **seen):
        raise UsageError("--scene is seen by one depth camera: of the options of a scan it takes --noise only.")
    if not scene and _given(**around):
        raise UsageError("what stands around the model needs --scene.")
    arguments.check_folder(out)
    with messages.progress() as show:
        from pwralign_kin.simulation import TIERS, Room, random_state, simulate_scene
        from pwralign_kin.simulation.simulator import simulate as scanned
        from pwralign_kin.state import State

        room = Room(**_given(**around, noise=noise)) if scene else None
        sensor = dataclasses.replace(TIERS[tier or "full"], **_given(**seen, noise=noise))
        given_pose = None if state is None else State.load(state)
        show("reading the model")
        model = model_options.read(urdf)
        model.check_limits(values)
        show("scanning")
        pose = given_pose or random_state(model, seed)
        pose = State(pose.T_scan_base, {**pose.joints, **values}, pose.base_link)
        result = scanned(model, pose, sensor, seed) if room is None else simulate_scene(model, pose, room, seed)
        result.save(out)
    own = result.labels[result.labels >= 0]
    points_seen = f"{len(result.scan)} points, {len(own)} of them" if scene else f"{len(result.scan)} points"
    parts_seen = f"{len(set(own.tolist()))} of {len(model.parts)} parts"
    messages.answer(f"{points_seen} on {parts_seen} of {model.name}, in {out}")


def _given(**options: Any) -> dict[str, Any]:
    return {name: value for name, value in options.items() if value is not None}
