"""Scans with known truth, by ray casting a posed model; nothing of the estimation is used here."""

from pwralign_kin.simulation.scenes import Room, simulate_scene
from pwralign_kin.simulation.sensor import FULL, TIERS, GuessOffset, Sensor
from pwralign_kin.simulation.sequences import Motion, SimulatedFrame, simulate_sequence, smooth_motion
from pwralign_kin.simulation.simulator import SimulatedCopy, SimulatedScan, random_state, simulate

__all__ = [
    "FULL",
    "TIERS",
    "GuessOffset",
    "Motion",
    "Room",
    "Sensor",
    "SimulatedCopy",
    "SimulatedFrame",
    "SimulatedScan",
    "random_state",
    "simulate",
    "simulate_scene",
    "simulate_sequence",
    "smooth_motion",
]
