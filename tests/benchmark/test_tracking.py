"""What the tables of tracking measure."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pwralign_kin import se3
from pwralign_kin.benchmark import tracking
from pwralign_kin.model import ArticulatedModel
from pwralign_kin.simulation import simulate_sequence, smooth_motion
from pwralign_kin.simulation.sequences import Motion
from pwralign_kin.state import State


def test_displacement_is_the_mean_motion_of_the_surface(twins: ArticulatedModel, truth: State) -> None:
    assert tracking.displacement(twins, truth, truth) == pytest.approx(0.0, abs=1e-9)
    shifted = State(
        se3.from_twist(np.array([0, 0, 0, 0.03, 0, 0.04])) @ truth.T_scan_base, truth.joints, truth.base_link
    )
    assert tracking.displacement(twins, shifted, truth) == pytest.approx(0.05)


def test_guesses_are_off_by_what_they_should_be(twins: ArticulatedModel) -> None:
    truth = smooth_motion(twins, 1, Motion(), seed=3)[0]
    guess = tracking.guess_off(twins, truth, (10.0, 0.04, 0.2), 5)
    apart = se3.inverse(truth.T_scan_base) @ guess.T_scan_base
    assert np.degrees(se3.rotation_angle(apart[:3, :3])) == pytest.approx(10.0)
    assert np.linalg.norm((guess.T_scan_base - truth.T_scan_base)[:3, 3]) == pytest.approx(0.04)
    assert abs(guess.joints["spin"] - truth.joints["spin"]) == pytest.approx(0.2)


def test_a_short_track_beside_a_rigid_alignment(twins: ArticulatedModel) -> None:
    pytest.importorskip("small_gicp", reason="the benchmark extra is not installed")
    frames = simulate_sequence(twins, 10, cameras=2, size=(80, 60), seed=1)
    track = tracking.followed("twins", twins, "rig", frames, 30.0)
    assert track.frames == 10 and track.lost == 0 and track.wrong == 0
    assert track.sure_rmse <= track.joint_rmse + 1e-9 and 0.0 <= track.undetermined <= 1.0
    assert track.base_rmse < 3.0
    assert len(track.seconds) == len(track.rigid_seconds) == len(track.rigid_prepared_seconds) == 2
    steady = replace(track, seconds=(0.002, 0.002), rigid_seconds=(0.004, 0.001), rigid_prepared_seconds=(0.01, 0.01))
    assert "| 1.25 (0.57 to 1.92) |" in tracking.tracks_table([steady])
    assert "never" in tracking.recoveries_table([tracking.Recovery("twins", "rig", True, None, 1.0)])
    refined = tracking.Guessed("twins", tracking.GUESSES[0], 0.05, 0.001, 0.01, False)
    assert "100% (1/1)" in tracking.guesses_table([refined])
