"""Arguments that several verbs share, and what they turn into."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Parameter
from cyclopts.validators import Number

from pwralign_kin.cli.codes import UsageError
from pwralign_kin.exceptions import ExportError

if TYPE_CHECKING:
    from pwralign_kin.model import ArticulatedModel
    from pwralign_kin.scan import Scan
    from pwralign_kin.se3 import Array

Urdf = Annotated[Path, Parameter(help="The model: a URDF file (or a xacro, with the xacro extra).")]

ScanPath = Annotated[
    Path,
    Parameter(help="The scan: PLY, PCD, XYZ/PTS/TXT/CSV, NPY/NPZ, a mesh (OBJ, STL, GLB) or a 16-bit PNG depth image."),
]

PackageDirs = Annotated[
    list[Path] | None,
    Parameter(help="A folder that contains packages of the URDF; may be repeated.", negative=()),
]

GeometryChoice = Annotated[
    Literal["visual", "collision"], Parameter(help="Which elements of the URDF give the links their shape.")
]

MeshUnitsChoice = Annotated[
    Literal["ignore", "apply"],
    Parameter(help="Whether the unit that a DAE mesh names scales it; most readers ignore it."),
]

Units = Annotated[
    Literal["m", "cm", "mm", "in", "auto"],
    Parameter(help="Unit of the scan file; auto: another one where m makes no sense beside the model."),
]

Seed = Annotated[int, Parameter(help="The same seed gives the same result.", validator=Number(gte=0, lt=2**32))]

EffortChoice = Annotated[Literal["fast", "default", "thorough"], Parameter(help="How long answers are looked for.")]

AsJson = Annotated[bool, Parameter(help="Print JSON, and nothing else, on stdout.", negative=(), show_default=False)]

Threads = Annotated[int, Parameter(help="Threads; 0 for one per core.", validator=Number(gte=0))]

Triple = tuple[float, float, float]
Box = tuple[float, float, float, float, float, float]
Pose = tuple[float, float, float, float, float, float, float]

Gravity = Annotated[
    Triple | None,
    Parameter(help="x y z: the direction in the scan in which things fall, against the model's z.", negative=()),
]

Near = Annotated[
    Triple | None, Parameter(help="x y z: a point on the object, to find it in a scene; unit of the scan.", negative=())
]

Region = Annotated[
    Box | None,
    Parameter(
        help="xmin ymin zmin xmax ymax zmax: a box that the object is in; unlike with --crop, what is outside still "
        "tells hidden from free space.",
        negative=(),
    ),
]

Crop = Annotated[
    Box | None, Parameter(help="xmin ymin zmin xmax ymax zmax: use only these points; unit of the scan.", negative=())
]


@dataclass(frozen=True)
class CameraOptions:
    """The camera of depth images."""

    intrinsics: Annotated[
        tuple[float, float, float, float] | None,
        Parameter(help="fx fy cx cy: the camera of depth images, pixels.", negative=()),
    ] = None
    depth_scale: Annotated[float, Parameter(help="m per unit of depth images.", validator=Number(gt=0))] = 0.001
    camera: Annotated[
        Pose | None,
        Parameter(help="x y z qx qy qz qw: the camera of depth images in the scan frame, m.", negative=()),
    ] = None

    @property
    def placement(self) -> Array:
        """(4, 4) T_scan_camera; raises `StateError` for a quaternion that is none."""
        return placement((0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0) if self.camera is None else self.camera)


Camera = Annotated[CameraOptions, Parameter(name="*")]
NO_CAMERA = CameraOptions()

Joints = Annotated[list[str] | None, Parameter("--joint", negative=())]


def upwards(gravity: Triple | None) -> Triple | None:
    """Return the direction that is up, of any length."""
    return None if gravity is None else (-gravity[0], -gravity[1], -gravity[2])


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
        values[name] = value
    return values


def locked_names(names: Iterable[str] | None) -> tuple[str, ...]:
    """Return the names of joints to lock; raises `UsageError` for name=value."""
    for name in names or ():
        if "=" in name:
            raise UsageError(f"--lock takes the name of a joint alone; its value comes with --joint {name}.")
    return tuple(names or ())


def read_joints(path: Path) -> dict[str, float]:
    """Return {name: value} of a JSON file: a state.json, or an object of names and values.

    Raises `StateError` naming the file and what is wrong.
    """
    import json

    from pwralign_kin.exceptions import StateError
    from pwralign_kin.state import State

    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise StateError(f"{path}: cannot read: {error.strerror}") from None
    except ValueError as error:
        raise StateError(f"{path}: not JSON: {error}") from None
    joints = content.get("joints", content) if isinstance(content, dict) else content
    if not isinstance(joints, dict) or not joints:
        raise StateError(f"{path}: expected an object of joint names and values")
    try:
        return dict(State(joints=joints).joints)
    except StateError as error:
        raise StateError(f"{path}: {error}") from None


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


def check_folder(folder: Path) -> None:
    """Raise `ExportError` when `folder` cannot be written, before anything that takes time is done for it."""
    place = folder.absolute()
    while not place.exists() and place != place.parent:
        place = place.parent
    if not place.is_dir():
        raise ExportError(folder, f"cannot write here: {place} is not a folder")
    try:
        with tempfile.TemporaryFile(dir=place):
            pass
    except OSError as error:
        raise ExportError(folder, f"cannot write here: {error.strerror} ({place})") from None


def read_scan(
    path: Path,
    camera: CameraOptions,
    sensor_origin: tuple[float, ...] | None = None,
    crop: tuple[float, ...] | None = None,
) -> Scan:
    """Return the scan in the unit of its file, in which `sensor_origin` and the box `crop` are given too.

    A depth image, seen by `camera`, is in m and tells its sensor origin itself.
    """
    from pwralign_kin.scan import DepthFrame, Scan

    if path.suffix.lower() in (".urdf", ".xacro"):
        raise UsageError(f"{path} is a URDF where a scan is expected: the URDF comes first.")
    if path.suffix.lower() == ".png":
        if sensor_origin is not None:
            raise UsageError(f"{path} is a depth image: --camera says where it was seen from, not --sensor-origin.")
        scan = DepthFrame.load(path, camera.intrinsics, camera.placement, camera.depth_scale).to_scan()
    else:
        scan = Scan.load(path, sensor_origin=sensor_origin, units="auto")
    return scan if crop is None else scan.cropped(crop[:3], crop[3:])


def in_metres(scan: Scan, units: Units, diagonal: float) -> tuple[Scan, float]:
    """Return the scan in m, and the length of its unit in m.

    Raises `UnitError` when `units` cannot be true beside a model of `diagonal` m.
    """
    from pwralign_kin.scan import METRES, check_units, likely_unit

    check_units(scan, diagonal, units)
    unit = likely_unit(scan, diagonal) if units == "auto" else units
    return scan if unit == "m" else scan.scaled(METRES[unit]), METRES[unit]


def read_model(
    urdf: Path,
    package_dirs: Sequence[Path] | None,
    geometry: Literal["visual", "collision"],
    mesh_units: Literal["ignore", "apply"],
) -> ArticulatedModel:
    """Return the model as the options that all verbs share ask for it."""
    from pwralign_kin.model import ArticulatedModel

    return ArticulatedModel.from_urdf(urdf, package_dirs=package_dirs or (), geometry=geometry, mesh_units=mesh_units)


def all_in_metres(
    scans: Sequence[Scan], units: Units, diagonal: float, near: Triple | None, region: Box | None
) -> tuple[list[Scan], dict[str, Any]]:
    """Return the scans in m, and the hints of `EstimatorOptions` in m that are given in the unit of the scans.

    Raises `UsageError` for hints where the scans differ in their units, and what `in_metres` raises.
    """
    converted = [in_metres(scan, units, diagonal) for scan in scans]
    unit = converted[0][1]
    if (near or region) and any(own != unit for _, own in converted):
        raise UsageError("--near and --region have no unit where those of the scans differ: give --units.")
    hints: dict[str, Any] = {}
    if near is not None:
        hints["near"] = tuple(unit * value for value in near)
    if region is not None:
        corners = [unit * value for value in region]
        hints["region"] = (tuple(corners[:3]), tuple(corners[3:]))
    return [scan for scan, _ in converted], hints
