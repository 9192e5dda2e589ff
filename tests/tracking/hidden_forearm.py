"""The small arm with its forearm hidden and seen again, and how far a track of it is off."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.ndimage import binary_dilation
from scipy.spatial import cKDTree

import pwralign_kin as pk
from pwralign_kin.se3 import transform
from pwralign_kin.simulation import SimulatedFrame

Frames = list[SimulatedFrame]


def errors(arm: pk.ArticulatedModel, found: pk.State, true: pk.State) -> tuple[float, float]:
    """Largest joint error (degrees) and base error (share of the diagonal)."""
    joints = np.abs(arm.values(found.joints) - arm.values(true.joints)).max()
    shift = np.linalg.norm((found.T_scan_base - true.T_scan_base)[:3, 3])
    return float(np.degrees(joints)), float(shift / arm.diagonal)


def forearm_hidden(arm: pk.ArticulatedModel, frame: SimulatedFrame) -> pk.DepthFrame:
    """The image with something in front of all pixels that show the part beyond the elbow, and some around them."""
    image = frame.images[0]
    scan = image.to_scan()
    placed = arm.root_placement(frame.state) @ arm.part_placements(arm.values(frame.state.joints))
    distances = []
    for T, surface in zip(placed, arm.surfaces, strict=True):
        samples = transform(T, surface.dense.astype(float) * arm.diagonal)
        distances.append(cKDTree(samples).query(scan.points)[0])
    shown = np.zeros(image.depth.shape, bool)
    shown[image.depth > 0.0] = np.argmin(distances, axis=0) == len(distances) - 1
    covered = binary_dilation(shown, iterations=12)
    return replace(image, depth=np.where(covered, 0.5 * image.depth[shown].min(), image.depth))


def elbow_back(
    arm: pk.ArticulatedModel, moving: Frames, options: pk.TrackerOptions | None = None
) -> tuple[pk.Tracker, pk.TrackedFrame]:
    """Return a tracker of an elbow that was hidden for 14 frames, and the frame in which it is seen again."""
    tracker = pk.Tracker(arm, options, moving[0].state)
    tracker.update(moving[0].images[0], 0.0)
    for frame in moving[1:15]:
        tracker.update(forearm_hidden(arm, frame), frame.time)
    return tracker, tracker.update(moving[15].images[0], moving[15].time)
