"""The state of an articulated model: where its base is and what every joint's value is."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from pwralign_kin import files
from pwralign_kin.exceptions import ExportError, StateError
from pwralign_kin.read_only import ReadOnly
from pwralign_kin.se3 import Array, checked_placement, placement_text


def checked_joints(joints: Mapping[str, float], what: str) -> dict[str, float]:
    """Return values by joint name as plain floats; raises `StateError` for what is none or not finite."""
    if not isinstance(joints, Mapping):
        raise StateError(f"{what} must map names to values, got {type(joints).__name__}")
    checked: dict[str, float] = {}
    for name, value in joints.items():
        try:
            checked[str(name)] = float(value)
        except (TypeError, ValueError):
            raise StateError(f"joint {name!r} has no number as its value: {value!r}") from None
        if not np.isfinite(checked[str(name)]):
            raise StateError(f"joint {name!r} has a value that is not finite: {value!r}")
    return checked


@dataclass(frozen=True, eq=False)
class State(ReadOnly):
    """Base placement and joint values by name.

    The same type is the initial guess, the truth of a simulated scan, and one frame of a track. States are equal whose
    numbers and base link are.
    Raises `StateError` for a placement that is not rigid or a joint value that is not a finite number.
    """

    T_scan_base: Array = field(default_factory=lambda: np.eye(4))
    """(4, 4) placement of `base_link` in the scan frame, translation in m."""

    joints: Mapping[str, float] = field(default_factory=dict)
    """Value of each actuated joint by name, rad or m."""

    base_link: str | None = None
    """The link that `T_scan_base` places; None means the root link of the URDF."""

    def __post_init__(self) -> None:
        """Check and copy the fields, so that a state never changes."""
        T = checked_placement(self.T_scan_base, "T_scan_base")
        object.__setattr__(self, "T_scan_base", T)
        if not isinstance(self.base_link, str | None):
            raise StateError(f"base_link must be the name of a link or None, not {self.base_link!r}")
        object.__setattr__(self, "joints", checked_joints(self.joints, "joints"))
        super().__post_init__()

    def __eq__(self, other: object) -> bool:
        """Whether placement, joint values and base link are the same numbers and names."""
        if not isinstance(other, State):
            return NotImplemented
        same_names = (self.joints, self.base_link) == (other.joints, other.base_link)
        return same_names and np.array_equal(self.T_scan_base, other.T_scan_base)

    def __hash__(self) -> int:
        """Equal states have equal hashes."""
        return hash((tuple(self.T_scan_base.ravel().tolist()), frozenset(self.joints.items()), self.base_link))

    def __repr__(self) -> str:
        """Return one line: the base and every joint's value, rounded."""
        joints = ", ".join(f"{name} {value:.4f}" for name, value in self.joints.items())
        return f"State({self.base_link or 'root link'}: {placement_text(self.T_scan_base, 4)}; {joints or 'no joints'})"

    def to_dict(self) -> dict[str, Any]:
        """Return the content of `state.json`."""
        return {
            "base_link": self.base_link,
            "T_scan_base": self.T_scan_base.tolist(),
            "joints": dict(self.joints),
        }

    @classmethod
    def from_dict(cls, content: Any, source: str = "state") -> State:
        """Read the content of a `state.json`; raises `StateError` naming `source` and what is wrong."""
        if not isinstance(content, dict) or "T_scan_base" not in content:
            raise StateError(f"{source}: expected an object with base_link, T_scan_base and joints")
        try:
            return cls(content["T_scan_base"], content.get("joints", {}), content.get("base_link"))
        except StateError as error:
            raise StateError(f"{source}: {error}") from None

    @classmethod
    def load(cls, path: Path | str) -> State:
        """Read a `state.json`; raises `StateError` when it is missing, unreadable or malformed."""
        files.check_path(path, StateError)
        try:
            content = json.loads(Path(path).read_text(encoding="utf-8"))
        except OSError as error:
            raise StateError(f"{path}: cannot read: {error.strerror}") from None
        except ValueError as error:
            raise StateError(f"{path}: not JSON: {error}") from None
        return cls.from_dict(content, str(path))

    def save(self, path: Path | str) -> None:
        """Write a `state.json`, whole or not at all; raises `ExportError`."""
        files.check_path(path, partial(ExportError, "state"))
        files.write_text(path, json.dumps(self.to_dict(), indent=2) + "\n")
