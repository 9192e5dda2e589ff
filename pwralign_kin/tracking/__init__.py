"""A model followed through a stream of frames."""

from pwralign_kin.tracking.frame_fitting import Frame
from pwralign_kin.tracking.options import TrackerOptions
from pwralign_kin.tracking.tracked_frame import TrackedFrame
from pwralign_kin.tracking.tracker import Tracker

__all__ = ["Frame", "TrackedFrame", "Tracker", "TrackerOptions"]
