"""A model followed through a stream of frames."""

from pwralign_kin.tracking.options import TrackerOptions
from pwralign_kin.tracking.tracker import Frame, TrackedFrame, Tracker

__all__ = ["Frame", "TrackedFrame", "Tracker", "TrackerOptions"]
