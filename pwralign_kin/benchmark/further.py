"""Further robots, drawn by lot from all that the wheel holds, so that nobody chose them."""

from __future__ import annotations

import random
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from pwralign_kin.benchmark.cases import ROBOTS, load_robot, wheel_robots
from pwralign_kin.benchmark.table import figure, markdown
from pwralign_kin.exceptions import ModelError
from pwralign_kin.model import ArticulatedModel
from pwralign_kin.se3 import Array

COUNT = 20
SEED = 0

ALIKE = 1e-3
"""Two robots are the same when they have as many parts with geometry, and diagonals and part sizes that agree
to this share of the diagonal."""


@dataclass(frozen=True)
class Draw:
    """One robot drawn."""

    name: str
    urdf: str
    """Path below the wheel's folder of robots."""

    refused: str
    """Why it does not take part; empty where it does."""

    parts: int = 0
    joints: int = 0
    diagonal: float = float("nan")
    """m."""

    def __str__(self) -> str:
        """Return one line for the progress display."""
        return f"{self.name}: {self.refused or f'{self.parts} parts, {self.joints} joints'}"


def draws(count: int = COUNT, seed: int = SEED) -> Iterator[Draw]:
    """Yield robots in random order, refused ones too, until `count` are accepted or none is left.

    Of `ROBOTS` none takes part. Refused is what cannot be read, what no scan can tell a joint of, and what is the
    same (see `ALIKE`) as one of `ROBOTS` or one drawn before.
    """
    names = wheel_robots()
    order = [name for name in sorted(names) if name not in ROBOTS]
    random.Random(seed).shuffle(order)
    known = {name: _sizes(load_robot(name)) for name in ROBOTS}
    for name in order:
        if len(known) == len(ROBOTS) + count:
            return
        try:
            model = load_robot(name)
        except ModelError as error:
            yield Draw(name, names[name], f"cannot be read: {_shortened(error)}")
            continue
        sizes = _sizes(model)
        twin = next((other for other, others in known.items() if _alike(sizes, others)), None)
        if len(model.unobservable) == len(model.joint_names):
            refused = "has no joint with geometry on both sides"
        elif twin is not None:
            refused = f"the same as {twin}"
        else:
            refused = ""
            known[name] = sizes
        yield Draw(name, names[name], refused, len(model.parts), len(model.joint_names), model.diagonal)


def accepted(drawn: list[Draw]) -> tuple[str, ...]:
    """Return the names of the robots that take part."""
    return tuple(own.name for own in drawn if not own.refused)


def draws_table(drawn: list[Draw]) -> str:
    """Return every draw in order."""
    heads = ["draw", "robot", "URDF", " parts", " joints", " D", "refused because it"]
    rows = []
    for number, own in enumerate(drawn, 1):
        size = ("", "", "") if not own.parts else (str(own.parts), str(own.joints), figure(own.diagonal, " m"))
        rows.append([str(number), own.name, own.urdf, *size, own.refused])
    return markdown(heads, rows)


def _sizes(model: ArticulatedModel) -> Array:
    """Return the diagonal and the sizes of the parts with geometry in order, m."""
    return np.array([model.diagonal, *sorted(part.size for part in model.parts if len(part.faces))])


def _alike(sizes: Array, others: Array) -> bool:
    return len(sizes) == len(others) and bool(np.allclose(sizes, others, rtol=0, atol=ALIKE * sizes[0]))


def _shortened(error: ModelError, most: int = 160) -> str:
    """Return the faults without the folders of this machine."""
    fault = str(error).removeprefix(f"{error.path}: ")
    root = str(error.path).partition("/robots/")[0]
    fault = fault.replace(f"{root}/robots/", "")
    return fault if len(fault) <= most else f"{fault[:most].rstrip()}…"
