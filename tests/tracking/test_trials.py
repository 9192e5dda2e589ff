"""Trials of joints that come back after they were hidden."""

from __future__ import annotations

from dataclasses import replace
from itertools import chain, repeat
from types import SimpleNamespace

import numpy as np
import pytest
from hidden_forearm import Frames, elbow_back, errors, forearm_hidden

import pwralign_kin as pk
from pwralign_kin.simulation import simulate_sequence
from pwralign_kin.tracking import trials as module
from pwralign_kin.tracking.fit import Usual
from pwralign_kin.tracking.frame_fitting import FrameFitting
from pwralign_kin.tracking.joints import Joints
from pwralign_kin.tracking.trials import TRIALS, Trials


def test_a_joint_that_comes_back_is_doubted_until_it_is_tried(arm: pk.ArticulatedModel, moving: Frames) -> None:
    tracker = pk.Tracker(arm, initial=moving[0].state)
    tracker.update(moving[0].images[0], 0.0)
    for frame in moving[1:15]:
        hidden = tracker.update(forearm_hidden(arm, frame), frame.time)
    assert "elbow" in hidden.undetermined
    back = [tracker.update(frame.images[0], frame.time) for frame in moving[15:]]
    assert "elbow" in back[0].undetermined and back[0].std["elbow"] > np.radians(5.0)
    assert "elbow" not in back[-1].undetermined and back[-1].std["elbow"] < np.radians(2.5)


def test_a_joint_that_is_hidden_again_stays_on_trial(arm: pk.ArticulatedModel, moving: Frames) -> None:
    tracker, _ = elbow_back(arm, moving)
    hidden = tracker.update(forearm_hidden(arm, moving[16]), moving[16].time)
    assert "elbow" in hidden.undetermined and hidden.std["elbow"] > np.radians(10.0)


def test_a_search_ends_all_trials(arm: pk.ArticulatedModel, moving: Frames) -> None:
    tracker, back = elbow_back(arm, moving)
    (elsewhere,) = simulate_sequence(arm, 1, size=(160, 120), seed=1)
    for number in range(1, 40):
        found = tracker.update(elsewhere.images[0], back.time + 0.1 * number)
        if found.searched and not found.lost:
            break
    assert found.searched and not found.lost and "elbow" not in found.undetermined


def wrong_while_hidden(arm: pk.ArticulatedModel, moving: Frames, off: float) -> pk.Tracker:
    """A tracker whose elbow was hidden for 14 frames, and is believed to be so far `off` (rad)."""
    tracker = pk.Tracker(arm, initial=moving[0].state)
    tracker.update(moving[0].images[0], 0.0)
    for frame in moving[1:15]:
        tracker.update(forearm_hidden(arm, frame), frame.time)
    assert tracker._motion is not None
    tracker._motion = replace(tracker._motion, values=tracker._motion.values + np.array([0.0, off]))
    return tracker


def test_a_joint_that_moved_far_while_it_was_hidden_is_found(arm: pk.ArticulatedModel, moving: Frames) -> None:
    tracker = wrong_while_hidden(arm, moving, 0.8)
    for frame in moving[15:18]:
        tracked = tracker.update(frame.images[0], frame.time)
    assert errors(arm, tracked.state, moving[17].state)[0] < 2.0


def test_a_hidden_joint_is_not_held_where_it_would_be_seen(arm: pk.ArticulatedModel, moving: Frames) -> None:
    tracker = wrong_while_hidden(arm, moving, 1.2)
    for frame in moving[15:18]:
        tracked = tracker.update(forearm_hidden(arm, frame), frame.time)
    assert tracked.model_support > 0.9 and "elbow" in tracked.undetermined


def test_after_a_pause_joints_are_doubted_until_other_values_are_tried(
    arm: pk.ArticulatedModel, moving: Frames
) -> None:
    tracker = pk.Tracker(arm, initial=moving[0].state)
    tracker.update(moving[0].images[0], 0.0)
    back = [tracker.update(frame.images[0], 1.0 + frame.time) for frame in moving[1:8]]
    assert set(back[0].undetermined) == set(arm.joint_names) and not back[-1].undetermined


def test_all_chains_that_are_due_are_tried(
    arm: pk.ArticulatedModel, moving: Frames, monkeypatch: pytest.MonkeyPatch
) -> None:
    tracker = pk.Tracker(arm, initial=moving[0].state)
    tracker.update(moving[0].images[0], 0.0)
    tracker._trials._spread[:], tracker._trials._waited[:] = 0.5, 64
    tried = []
    monkeypatch.setattr(Joints, "chains", lambda *_: [np.array([True, False]), np.array([False, True])])
    monkeypatch.setattr(Trials, "_best", lambda _, fit, expected, chain, *__: (tried.append(chain.tolist()), fit)[1])
    tracker.update(moving[1].images[0], moving[1].time)
    assert tried == [[True, False], [False, True]]


def test_a_joint_that_stays_hidden_is_tried_ever_less(
    arm: pk.ArticulatedModel, moving: Frames, monkeypatch: pytest.MonkeyPatch
) -> None:
    tracker, _ = elbow_back(arm, moving)
    tracker.update(forearm_hidden(arm, moving[16]), moving[16].time)
    tracker._trials._passed[:], tracker._trials._waited[:] = 64, 0
    monkeypatch.setattr(Usual, "doubts", lambda *_: False)
    monkeypatch.setattr(Trials, "_best", lambda *_: pytest.fail("tried again at once"))
    tracker.update(forearm_hidden(arm, moving[17]), moving[17].time)
    assert tracker._trials.active


def test_nothing_is_left_of_trials_that_have_ended(
    arm: pk.ArticulatedModel, moving: Frames, monkeypatch: pytest.MonkeyPatch
) -> None:
    tracker, _ = elbow_back(arm, moving)
    monkeypatch.setattr(module, "EVIDENT", 20.0)  # values a little apart fit as well
    trials = tracker._trials
    trials._passed[1], trials._waited[1] = TRIALS - 1, 64
    tracked = tracker.update(moving[16].images[0], moving[16].time)
    assert not trials.active and (trials.apart == 0.0).all()
    assert tracked.std["elbow"] < np.radians(0.5)


def test_trials_go_on_while_other_values_fit_as_well(arm: pk.ArticulatedModel) -> None:
    trials = pk.Tracker(arm)._trials
    elbow = np.array([False, True])
    trials._spread[elbow], trials._passed[elbow] = 1.0, TRIALS
    for alike, goes_on in ((0.5, True), (0.01, False)):
        trials._note(np.array([0.0, alike]), elbow, elbow, doubted=False)
        assert trials.active == goes_on


@pytest.mark.parametrize(("rounds", "drawn"), [(0, 0), (1, 64), (3, 96)])
def test_a_trial_that_the_time_limit_cuts_short_does_not_count(
    arm: pk.ArticulatedModel, moving: Frames, monkeypatch: pytest.MonkeyPatch, rounds: int, drawn: int
) -> None:
    tracker, _ = elbow_back(arm, moving, pk.TrackerOptions(time_limit=60.0))
    trials = tracker._trials
    trials._waited[1] = 64
    passed, before = trials._passed.copy(), trials.sequence.drawn
    times = chain(repeat(0.0, rounds), repeat(np.inf))
    monkeypatch.setattr(module, "clock", SimpleNamespace(perf_counter=lambda: next(times)))
    tracker.update(moving[16].images[0], moving[16].time)
    assert trials.sequence.drawn == before + drawn
    assert trials._waited[1] == 65 and (trials._passed == passed).all()


def test_values_that_nothing_tells_apart_are_drawn_once(
    arm: pk.ArticulatedModel, moving: Frames, monkeypatch: pytest.MonkeyPatch
) -> None:
    tracker, _ = elbow_back(arm, moving)
    monkeypatch.setattr(FrameFitting, "weighed", lambda _, __, values, *___: np.zeros(len(values)))
    drawn = tracker._trials.sequence.drawn
    tracker._trials._waited[1] = 64
    tracked = tracker.update(moving[16].images[0], moving[16].time)
    assert tracker._trials.sequence.drawn == drawn + 64 and "elbow" in tracked.undetermined
