"""From files, arrays and depth images to a clean `Scan`."""

from pwralign_kin.scan.depth import DepthFrame
from pwralign_kin.scan.frames import read_frames
from pwralign_kin.scan.pinhole import DepthCamera
from pwralign_kin.scan.scan import Scan
from pwralign_kin.scan.timed_frame import FrameOptions
from pwralign_kin.scan.units import (
    check_named_unit,
    check_units,
    likely_unit,
    note_of_unit,
    units_of_it_alone,
    warn_of_rounding,
)
from pwralign_kin.scan.writers import write_ply

__all__ = [
    "DepthCamera",
    "DepthFrame",
    "FrameOptions",
    "Scan",
    "check_named_unit",
    "check_units",
    "likely_unit",
    "note_of_unit",
    "read_frames",
    "units_of_it_alone",
    "warn_of_rounding",
    "write_ply",
]
