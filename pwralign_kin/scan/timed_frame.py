"""A frame of a stream, and what its file does not tell."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from pwralign_kin.checked_options import CheckedOptions, Positive
from pwralign_kin.scan.depth import MILLIMETRES, DepthFrame
from pwralign_kin.scan.scan import Scan
from pwralign_kin.se3 import Array

TimedFrame = tuple[float, Scan | DepthFrame | Array]
"""A time (s) and what was seen then; a cloud of too few points to make a scan as bare points."""


@dataclass(frozen=True)
class FrameOptions(CheckedOptions):
    """What files do not tell of themselves. Raises `OptionError` for values out of range."""

    rate: Positive = 30.0
    """Frames per second of files whose names and contents tell no times."""
    sensor_origin: ArrayLike | None = None
    """(3,) where point clouds were seen from, in their unit."""
    intrinsics: ArrayLike | None = None
    """(3, 3), or (fx, fy, cx, cy), pixels, of depth images."""
    depth_scale: Positive = MILLIMETRES
    """m per unit of integer depth images."""
    T_scan_camera: Array = field(default_factory=lambda: np.eye(4))
    """(4, 4) placement of the camera of depth images in the scan frame, m."""
    topic: str | None = None
    """Of a bag: the topic with PointCloud2 or depth Image messages; None: the only one."""
