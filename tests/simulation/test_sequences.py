"""Simulated motion keeps limits and speeds, and images show the truth."""

from __future__ import annotations

import numpy as np
import pytest

import pwralign_kin as pk
from pwralign_kin.exceptions import OptionError
from pwralign_kin.simulation import Motion, simulate_sequence, smooth_motion


def test_motion_keeps_limits_and_speeds(crane: pk.ArticulatedModel) -> None:
    motion = Motion(joint_speed=0.8, base_speed=0.1, rate=50.0)
    states = smooth_motion(crane, 200, motion, seed=1)
    values = np.array([crane.values(state.joints) for state in states])
    assert (values >= crane.lower).all() and (values <= crane.upper).all()
    most = np.array([0.8 if crane.units[name] == "rad" else 0.16 * crane.diagonal for name in crane.joint_names])
    speeds = np.abs(np.diff(values, axis=0)) * motion.rate
    assert (speeds <= most + 1e-9).all()
    assert speeds.max() > 0.2
    places = np.array([state.T_scan_base[:3, 3] for state in states])
    assert (np.abs(np.diff(places, axis=0)) * motion.rate <= 0.1 * crane.diagonal + 1e-9).all()


def test_images_show_the_model_where_it_is(crane: pk.ArticulatedModel) -> None:
    frames = list(simulate_sequence(crane, 3, cameras=2, size=(80, 60), noise=0.0, seed=2))
    again = list(simulate_sequence(crane, 3, cameras=2, size=(80, 60), noise=0.0, seed=2))
    for frame, same in zip(frames, again, strict=True):
        for image, copy in zip(frame.images, same.images, strict=True):
            assert np.array_equal(image.depth, copy.depth)
            placements = frame.state.T_scan_base @ crane.part_placements(crane.values(frame.state.joints))
            distances = [_to_surface(crane, T, image.to_scan().points, i) for i, T in enumerate(placements)]
            assert np.min(distances, axis=0).max() < 1e-4 * crane.diagonal


def _to_surface(crane: pk.ArticulatedModel, T: np.ndarray, points: np.ndarray, part: int) -> np.ndarray:
    from pwralign_kin.render import RayScene

    if len(crane.parts[part].faces) == 0:
        return np.full(len(points), np.inf)
    local = (points - T[:3, 3]) @ T[:3, :3]
    closest, _, _ = RayScene(crane.parts[part].vertices, crane.parts[part].faces).closest(local)
    return np.asarray(np.linalg.norm(local - closest, axis=1))


def test_a_board_hides_everything_for_a_while(crane: pk.ArticulatedModel) -> None:
    frames = list(simulate_sequence(crane, 6, size=(40, 30), occluded=(0.05, 0.15), seed=2))
    hidden = [len(np.unique(frame.images[0].depth)) == 1 for frame in frames]
    assert hidden == [False, False, True, True, True, False]


def test_faults(crane: pk.ArticulatedModel) -> None:
    with pytest.raises(OptionError, match="rate"):
        Motion(rate=0.0)
    with pytest.raises(OptionError, match="seed"):
        smooth_motion(crane, 3, Motion(), seed=-1)
