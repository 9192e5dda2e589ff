"""Every error a user can cause: one base class, subclasses that carry the offending value and the way out.

The command line turns a `PwralignError` into one line on stderr; anything else is a defect of the library.
"""

from __future__ import annotations

import copyreg
from collections.abc import Iterable
from difflib import get_close_matches
from pathlib import Path
from typing import Any


class PwralignError(Exception):
    """Base of all errors raised on purpose by this package."""

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle text and attributes: the usual way calls the class with the text alone, where it takes more."""
        return copyreg.__newobj__, (type(self), *self.args), self.__dict__  # type: ignore[attr-defined]


class ModelError(PwralignError):
    """The URDF cannot be used. `path` is the file; `faults` lists every fault found, not only the first."""

    def __init__(self, path: Path | str, faults: str | Iterable[str]) -> None:
        self.path = Path(path)
        self.faults = (faults,) if isinstance(faults, str) else tuple(faults)
        super().__init__(f"{self.path}: " + "; ".join(self.faults))


class MissingMeshError(ModelError):
    """Meshes named by the URDF are not found. `meshes` maps the name in the URDF to the paths tried."""

    def __init__(self, path: Path | str, meshes: dict[str, list[Path]]) -> None:
        self.meshes = meshes
        names = ", ".join(meshes)
        tried = next(iter(meshes.values()))
        it, its = ("the first", "the first's") if len(meshes) > 1 else ("it", "its")
        where = f"looked for {it} at {' or '.join(map(str, tried))}" if tried else f"no package of {its} name"
        remedy = "name the folders that contain its packages with package_dirs / --package-dir"
        if not any(name.startswith("package://") for name in meshes):
            remedy = "are they where the URDF says, as seen from its own folder?"
        if any("$(" in name or "${" in name for name in meshes):
            remedy = "names with $ are expressions of xacro: read the .xacro that this URDF is a piece of"
        super().__init__(path, f"{len(meshes)} missing mesh{'es' * (len(meshes) > 1)}: {names} ({where}); {remedy}")


class ScanError(PwralignError):
    """The scan cannot be used. `source` is the file or a word for the array."""

    def __init__(self, source: Path | str, fault: str) -> None:
        self.source = source
        self.fault = fault
        super().__init__(f"{source}: {fault}")


class EmptyScanError(ScanError):
    """The scan has no points, or fewer than an estimate can start from."""


class UnitError(ScanError):
    """The scan seems to be in another unit than metres. `scale` converts it to metres."""

    def __init__(self, source: Path | str, fault: str, scale: float) -> None:
        self.scale = scale
        super().__init__(source, fault)


class StateError(PwralignError):
    """A state (placement and joint values) is malformed or does not fit the model."""


class OptionError(PwralignError):
    """An option has a value that it cannot have. `name` is the option, `valid` says which values it can have."""

    def __init__(self, name: str, value: object, valid: str) -> None:
        self.name = name
        self.value = value
        self.valid = valid
        super().__init__(f"{name} must be {valid}, not {value!r}")


class ArgumentError(PwralignError):
    """An argument is of a kind that makes no sense here. `expected` says what would, `got` what was given."""

    def __init__(self, what: str, expected: str, got: str) -> None:
        self.what = what
        self.expected = expected
        self.got = got
        super().__init__(f"{what}: expected {expected}, got {got}")


class UnknownNameError(PwralignError):
    """A name does not exist. `kind` says of what (a joint, a link, an option's choice), `name` is the offender, `valid`
    what would have been right."""

    def __init__(self, kind: str, name: str, valid: Iterable[str]) -> None:
        self.kind = kind
        self.name = name
        self.valid = tuple(valid)
        close = get_close_matches(str(name), self.valid, n=1, cutoff=0.65)
        hint = f"did you mean {close[0]!r}?" if close else "valid: " + (", ".join(self.valid) or "none")
        super().__init__(f"no {kind} named {name!r}; {hint}")


class CorrespondenceError(PwralignError):
    """Correspondences from outside are malformed."""

    def __init__(self, source: Path | str, fault: str) -> None:
        self.source = source
        self.fault = fault
        super().__init__(f"{source}: {fault}")


class ExportError(PwralignError):
    """An output cannot be written. `path` is the file or folder."""

    def __init__(self, path: Path | str, fault: str) -> None:
        self.path = Path(path)
        self.fault = fault
        super().__init__(f"{path}: {fault}")


class DependencyError(PwralignError):
    """A library that is needed here is not installed or does not load. `remedy` is the command that mends it."""

    def __init__(self, what: str, remedy: str) -> None:
        self.what = what
        self.remedy = remedy
        super().__init__(f"{what}; run: {remedy}")
