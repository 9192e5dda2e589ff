"""Arguments that several verbs share, and what they turn into."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Group, Parameter
from cyclopts.validators import Number

from pwralign_kin.checked_options import SEED_LIMIT
from pwralign_kin.cli.codes import UsageError
from pwralign_kin.exceptions import ExportError

if TYPE_CHECKING:
    from pwralign_kin.se3 import Array

OUTPUT, GUESS, SCAN, MODEL, SEARCH = (
    Group(name, sort_key=place)
    for place, name in enumerate(("Output", "Guess and knowledge", "Scan", "Model", "Search"), start=1)
)
"""Under which options stand in the help of a verb."""

Seed = Annotated[
    int,
    Parameter(
        help="The same seed gives the same result; a whole number below 2**32.",
        validator=Number(gte=0, lt=SEED_LIMIT),
        group=SEARCH,
    ),
]

EffortChoice = Annotated[
    Literal["fast", "default", "thorough"], Parameter(help="How long answers are looked for.", group=SEARCH)
]

AsJson = Annotated[
    bool, Parameter(help="Print JSON, and nothing else, on stdout.", negative=(), show_default=False, group=OUTPUT)
]

Threads = Annotated[int, Parameter(help="Threads; 0 for one per core.", validator=Number(gte=0), group=SEARCH)]

Triple = tuple[float, float, float]
Box = tuple[float, float, float, float, float, float]
Pose = tuple[float, float, float, float, float, float, float]

Joints = Annotated[
    list[str] | None,
    Parameter(
        "--joint",
        help="name=value, rad or m: what a joint is where the scan does not tell; may be repeated.",
        negative=(),
        group=GUESS,
    ),
]


def joint_values(assignments: Iterable[str] | None) -> dict[str, float]:
    """Return {name: value} of arguments `name=value`; raises `UsageError` for one of another form."""
    values: dict[str, float] = {}
    for text in assignments or ():
        name, equals, number = text.rpartition("=")
        try:
            value = float(number)
        except ValueError:
            value = math.nan
        if not name or not equals or not math.isfinite(value):
            raise UsageError(f"--joint takes name=value with a number in rad or m, not {text!r}.")
        if name in values:
            raise UsageError(f"--joint {name} is given twice, as {values[name]:g} and {value:g}.")
        values[name] = value
    return values


def read_joints(path: Path) -> dict[str, float]:
    """Return {name: value} of a JSON or YAML file in any form that this program or ROS writes joint values in.

    That is an object of names and values, by itself or as "joints" (a state.json) or "initial_positions", or a
    sensor_msgs/JointState. Raises `StateError` naming the file and what is wrong.
    """
    import yaml

    from pwralign_kin.exceptions import StateError
    from pwralign_kin.state import State

    try:
        content = _first_document(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise StateError(f"{path}: cannot read: {error.strerror}") from None
    except (ValueError, RecursionError, yaml.YAMLError) as error:
        raise StateError(f"{path}: neither JSON nor YAML: {' '.join(str(error).split())}") from None
    if isinstance(content, dict):
        if {"name", "position"} <= content.keys():
            content = _of_message(content["name"], content["position"])
        else:
            content = content.get("joints", content.get("initial_positions", content))
    if not isinstance(content, dict) or not content:
        raise StateError(f"{path}: expected JSON or YAML of names and values (elbow: 1.2), or a sensor_msgs/JointState")
    try:
        return dict(State(joints=content).joints)
    except StateError as error:
        raise StateError(f"{path}: {error}") from None


def _first_document(text: str) -> Any:
    """Return what a JSON text holds (YAML takes no tabs), or the first document of a YAML one: messages may follow."""
    import json

    import yaml

    try:
        return json.loads(text)
    except ValueError:
        return next(yaml.safe_load_all(text), None)


def _of_message(names: Any, positions: Any) -> dict[str, float] | None:
    """Return the values by name of a JointState; None where it is none."""
    paired = isinstance(names, list) and isinstance(positions, list)
    paired = paired and len(names) == len(positions) == len(set(map(str, names)))
    return dict(zip(map(str, names), positions, strict=True)) if paired else None


def known_names(kind: str, text: str | None, valid: Iterable[str]) -> tuple[str, ...]:
    """Return the names in a list with commas, none for None; raises `UnknownNameError` for one that is not valid."""
    from pwralign_kin.exceptions import UnknownNameError

    names = () if text is None else tuple(name.strip() for name in text.split(",") if name.strip())
    valid = tuple(valid)
    for name in names:
        if name not in valid:
            raise UnknownNameError(kind, name, valid)
    return names


def placement(pose: Pose) -> Array:
    """Return the (4, 4) placement of x y z qx qy qz qw; raises `StateError` for a quaternion that is none."""
    import numpy as np

    from pwralign_kin import se3

    return se3.from_quaternion(np.array(pose[:3]), np.array(pose[3:]))


def check_folder(folder: Path, names: Iterable[str] = ()) -> None:
    """Raise `ExportError` when the files `names` cannot be written into `folder`, before anything that takes time."""
    place = folder.absolute()
    while not place.exists() and place != place.parent:
        if place.is_symlink():
            raise ExportError(folder, f"cannot write here: {place} is a link to nothing")
        place = place.parent
    if not place.is_dir():
        raise ExportError(folder, f"cannot write here: {place} is not a folder")
    try:
        with tempfile.TemporaryFile(dir=place):
            pass
    except OSError as error:
        raise ExportError(folder, f"cannot write here: {error.strerror} ({place})") from None
    blocked = [name for name in names if (folder / name).is_dir()]
    if blocked:
        raise ExportError(folder, f"cannot write {blocked[0]}: a folder has that name")
