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


def test_of_pixels_at_a_depth_edge_those_between_both_surfaces_are_left_out(
    arm: pk.ArticulatedModel, moving: Frames
) -> None:
    image, options = moving[0].images[0], pk.TrackerOptions(cell=1e-4, points=50000)
    tracker = pk.Tracker(arm, options, moving[0].state)
    tracker.update(image, 0.0)
    assert tracker._motion is not None
    rows, columns = (int(np.median(of)) for of in np.nonzero(image.depth))
    near, steps = float(np.median(image.depth[image.depth > 0.0])), np.zeros((20, 20))
    steps[:, 10:] = 0.08
    sloped, mixed = steps + 0.012 * np.arange(20), steps.copy()
    mixed[:, 10] = 0.04
    for nothing in (0.0, np.inf):
        for step, kept in ((steps, 400), (sloped, 400), (mixed, 380), (mixed.T, 380)):
            depth = np.full(image.depth.shape, nothing, np.float32)
            depth[rows - 10 : rows + 10, columns - 10 : columns + 10] = near + (step - 0.08) * arm.diagonal
            tracker._fitting.look(replace(image, depth=depth), tracker._motion)
            assert tracker._fitting.native.points == kept


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
