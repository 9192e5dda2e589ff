"""How scans are read, and where in them the model is looked for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter
from cyclopts.validators import Number

from pwralign_kin.cli.arguments import SCAN, Box, Pose, Triple, placement
from pwralign_kin.cli.codes import UsageError
from pwralign_kin.lengths import METRES, Units

if TYPE_CHECKING:
    from pwralign_kin.scan import DepthFrame, Scan
    from pwralign_kin.se3 import Array

ScanPath = Annotated[
    Path,
    Parameter(help="The scan: PLY, PCD, XYZ/PTS/TXT/CSV, NPY/NPZ, a mesh (OBJ, STL, GLB) or a 16-bit PNG depth image."),
]

_STILL = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)


@Parameter(name="*", group=SCAN)
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
        return placement(self.camera or _STILL)

    def read(self, path: Path) -> DepthFrame:
        """Return the depth image of a file."""
        from pwralign_kin.scan import DepthFrame

        return DepthFrame.load(path, self.intrinsics, self.placement, self.depth_scale)


CAMERA_OPTIONS = CameraOptions()


@Parameter(name="*", group=SCAN)
@dataclass(frozen=True)
class ScanOptions:
    """What scan files do not tell of themselves, and hints where the model is."""

    units: Annotated[
        Units, Parameter(help="Unit of the scan file; auto: another one where m makes no sense beside the model.")
    ] = "m"
    left_handed: Annotated[
        bool,
        Parameter(
            help="The scan file's coordinates are left-handed, as Unity's are: the sign of x is turned as it is read; "
            "all other coordinates, given and found, are of the turned scan.",
            negative=(),
            show_default=False,
        ),
    ] = False
    sensor_origin: Annotated[
        Triple | None, Parameter(help="x y z: where the scan was seen from; unit of the scan.", negative=())
    ] = None
    depth: CameraOptions = CAMERA_OPTIONS
    crop: Annotated[
        Box | None,
        Parameter(help="xmin ymin zmin xmax ymax zmax: use only these points; unit of the scan.", negative=()),
    ] = None
    near: Annotated[
        Triple | None,
        Parameter(help="x y z: a point on the object, to find it in a scene; unit of the scan.", negative=()),
    ] = None
    region: Annotated[
        Box | None,
        Parameter(
            help="xmin ymin zmin xmax ymax zmax: a box that the object is in; unlike with --crop, what is outside "
            "still tells hidden from free space.",
            negative=(),
        ),
    ] = None

    def read(self, path: Path) -> Scan:
        """Return the scan, cropped, in the unit of its file; of a depth image in m."""
        from pwralign_kin.scan import Scan

        refuse_urdf(path)
        if path.suffix.lower() != ".png":
            if self.depth != CAMERA_OPTIONS:
                given = "--intrinsics, --depth-scale and --camera are of depth images, 16-bit PNG"
                raise UsageError(f"{path} is no depth image: {given}.")
            scan = Scan.load(path, sensor_origin=self.sensor_origin, units=None)
            if self.left_handed:
                scan = scan.mirrored("x")
                scan = scan if self.sensor_origin is None else scan.with_sensor_origin(self.sensor_origin)
        elif self.left_handed:
            raise UsageError(f"{path} is a depth image: these are never left-handed.")
        elif self.units not in ("m", "auto"):
            raise UsageError(f"{path} is a depth image: --depth-scale says what its numbers are in, not --units.")
        elif self.sensor_origin is None:
            scan = self.depth.read(path).to_scan()
        else:
            raise UsageError(f"{path} is a depth image: --camera says where it was seen from, not --sensor-origin.")
        return scan if self.crop is None else scan.cropped(self.crop[:3], self.crop[3:])

    def in_metres(self, scans: Sequence[Scan], diagonal: float) -> tuple[list[Scan], dict[str, Any]]:
        """Return the scans in m, and the hints of `EstimatorOptions` in m, which are given in the unit of the scans.

        Raises `UsageError` for hints where the scans differ in their units, and what `in_metres` raises.
        """
        from pwralign_kin.scan import check_named_unit

        if self.units != "auto":
            for scan in scans:
                check_named_unit(scan, diagonal, self.units)
        converted = [in_metres(scan, self.units, diagonal) for scan in scans]
        unit = converted[0][1]
        if (self.near or self.region) and any(own != unit for _, own in converted):
            raise UsageError("--near and --region have no unit where those of the scans differ: give --units.")
        hints: dict[str, Any] = {}
        if self.near is not None:
            hints["near"] = tuple(unit * value for value in self.near)
        if self.region is not None:
            corners = [unit * value for value in self.region]
            hints["region"] = (tuple(corners[:3]), tuple(corners[3:]))
        return [scan for scan, _ in converted], hints


SCAN_OPTIONS = ScanOptions()


def refuse_urdf(path: Path) -> None:
    """Raise `UsageError` where the file of a scan is a URDF."""
    if path.suffix.lower() in (".urdf", ".xacro"):
        raise UsageError(f"{path} is a URDF where a scan is expected: the URDF comes first.")


def in_metres(scan: Scan, units: Units, diagonal: float) -> tuple[Scan, float]:
    """Return the scan in m, and the length of its unit in m.

    Raises `UnitError` when `units` cannot be true beside a model of `diagonal` m.
    """
    from pwralign_kin.scan import check_units, likely_unit

    check_units(scan, diagonal, units)
    unit = likely_unit(scan, diagonal) if units == "auto" else units
    return scan if unit == "m" else scan.scaled(METRES[unit]), METRES[unit]
