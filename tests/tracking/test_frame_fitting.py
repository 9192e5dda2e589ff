"""Single configurations beside a frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from hidden_forearm import Frames, forearm_hidden

import pwralign_kin as pk


def test_many_values_are_weighed_as_each_is_judged(arm: pk.ArticulatedModel, moving: Frames) -> None:
    tracker = pk.Tracker(arm, initial=moving[0].state)
    tracker.update(moving[0].images[0], 0.0)
    native, motion = tracker._fitting.native, tracker._motion
    assert motion is not None
    base = tracker._fitting.inward(motion.T_scan_base)[None]
    for varied in ([0, 1], [1, 1]):
        rows = motion.values + np.linspace(-0.6, 0.6, 7)[:, None] * varied
        judged = [native.judge(base, row, 0.01) for row in rows]
        weighed = native.weigh(base, rows, np.array(varied, np.uint8), 0.01)
        np.testing.assert_allclose(weighed, [own.cost + 1.0 - own.supported for own in judged], atol=1e-3)
        assert np.argmin(weighed) == 3


def test_a_part_has_no_points_of_its_own_where_others_are(arm: pk.ArticulatedModel, moving: Frames) -> None:
    tracker = pk.Tracker(arm, initial=moving[0].state)
    tracker.update(moving[0].images[0], 0.0)
    for frame, shown in ((moving[1].images[0], True), (forearm_hidden(arm, moving[2]), False)):
        tracker.update(frame, 0.1 if shown else 0.2)
        assert tracker._motion is not None
        base = tracker._fitting.inward(tracker._motion.T_scan_base)[None]
        own = tracker._fitting.native.own(base, tracker._motion.values, 0.01)
        assert own[0] > 20.0 and (own[1] > 20.0) == shown and own[0] >= own[1]


def test_what_a_frame_does_not_tell_is_no_less_sure_than_expected(arm: pk.ArticulatedModel, moving: Frames) -> None:
    tracker = pk.Tracker(arm, initial=moving[0].state)
    tracker.update(moving[0].images[0], 0.0)
    assert tracker._motion is not None
    expected = tracker._motion.predicted(moving[1].time)
    tracker._fitting.look(forearm_hidden(arm, moving[1]), expected)
    for doubt in (None, np.array([0.0, 1.0])):
        fit = tracker._fitting.fitted(expected, tracker._usual, np.inf, wide=doubt is None, doubt=doubt)
        assert (np.diag(fit.covariance) < 1.001 * np.diag(expected.covariance)).all()


def test_values_in_doubt_may_be_far_from_the_expected(arm: pk.ArticulatedModel, moving: Frames) -> None:
    tracker = pk.Tracker(arm, initial=moving[0].state)
    tracker.update(moving[0].images[0], 0.0)
    motion = tracker._motion
    assert motion is not None
    expected = replace(motion, values=motion.values + np.array([0.0, 0.1]), covariance=1e-12 * np.eye(8))
    tracker._fitting.look(moving[0].images[0], expected)
    sure, doubtful = (
        tracker._fitting.fitted(expected, tracker._usual, np.inf, doubt=doubt).values - motion.values
        for doubt in (None, np.array([0.0, 0.3]))
    )
    assert abs(sure[1]) > 0.09 and abs(doubtful[1]) < 0.01
