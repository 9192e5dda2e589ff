"""`pwralign simulate`: scans with truth."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Parameter

from pwralign_kin.cli import arguments, messages
from pwralign_kin.cli.arguments import GeometryChoice, Joints, PackageDirs, Seed, Urdf


def simulate(
    urdf: Urdf,
    /,
    *,
    out: Annotated[Path, Parameter(help="Folder for scan.ply, truth.json and labels.npz.")],
    tier: Annotated[
        Literal["full", "single", "hololens", "sparse", "missing", "clutter", "warm"],
        Parameter(help="What the scan is like; the options below change one thing each."),
    ] = "full",
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
    state: Annotated[Path | None, Parameter(help="A state.json of the model's pose; else random.")] = None,
    joint: Annotated[Joints, Parameter(help="name=value, rad or m; may be repeated.")] = None,
    seed: Seed = 0,
    package_dir: PackageDirs = None,
    geometry: GeometryChoice = "visual",
) -> None:
    """Scan a model in software: points with the truth beside them."""
    values = arguments.joint_values(joint)
    arguments.check_folder(out)
    with messages.progress() as show:
        from pwralign_kin.model import ArticulatedModel
        from pwralign_kin.simulation import TIERS, random_state
        from pwralign_kin.simulation.simulator import simulate as scanned
        from pwralign_kin.state import State

        changes: dict[str, Any] = {
            "views": views,
            "points": points,
            "noise": noise,
            "stray": outliers,
            "missing_parts": tuple(missing_part) if missing_part else None,
            "known_origin": known_origin,
        }
        given = {name: value for name, value in changes.items() if value is not None}
        sensor = dataclasses.replace(TIERS[tier], **given)
        given_pose = None if state is None else State.load(state)
        show("reading the model")
        model = ArticulatedModel.from_urdf(urdf, package_dirs=package_dir or (), geometry=geometry)
        show("scanning")
        pose = given_pose or random_state(model, seed)
        pose = State(pose.T_scan_base, {**pose.joints, **values}, pose.base_link)
        result = scanned(model, pose, sensor, seed)
        result.save(out)
    seen = len(set(result.labels.tolist()) - {-1})
    print(f"{len(result.scan)} points on {seen} of {len(model.parts)} parts of {model.name}, in {out}")
