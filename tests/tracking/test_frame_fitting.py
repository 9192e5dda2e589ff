"""Single configurations beside a frame."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from hidden_forearm import Frames, forearm_hidden

import pwralign_kin as pk
from pwralign_kin import kernels
from pwralign_kin.simulation import SimulatedFrame
from pwralign_kin.tracking.fit import Usual
from pwralign_kin.tracking.frame_fitting import FrameFitting
from pwralign_kin.tracking.motion import LONGEST, BelievedMotion


def fitted_to(
    arm: pk.ArticulatedModel, frame: SimulatedFrame, options: pk.TrackerOptions | None = None
) -> tuple[FrameFitting, BelievedMotion, Usual]:
    """The fitting that has looked at a frame from its true state, what it makes believed of the model, and usual."""
    options = options or pk.TrackerOptions()
    native = kernels.Tracking(arm.kernel_model, options.points, options.cell)
    fitting = FrameFitting(native, arm.diagonal, options)
    placement, values = arm.root_placement(frame.state), arm.values(frame.state.joints) / arm.joint_scales
    start = BelievedMotion.at_rest(0.0, placement, values, -LONGEST)
    fitting.look(frame.images[0], start)
    fit = fitting.fitted(start, None, np.inf, wide=True)
    settled = BelievedMotion.at_rest(0.0, fit.T_scan_base, fit.values, 0.0)
    return fitting, replace(settled, covariance=fit.covariance), Usual.of(fit, 1.0)


def test_many_values_are_weighed_as_each_is_judged(arm: pk.ArticulatedModel, moving: Frames) -> None:
    fitting, motion, _ = fitted_to(arm, moving[0])
    native, base = fitting.native, fitting.inward(motion.T_scan_base)[None]
    for varied in ([0, 1], [1, 1]):
        rows = motion.values + np.linspace(-0.6, 0.6, 7)[:, None] * varied
        judged = [native.judge(base, row, 0.01) for row in rows]
        weighed = native.weigh(base, rows, np.array(varied, np.uint8), 0.01)
        np.testing.assert_allclose(weighed, [own.cost + 1.0 - own.supported for own in judged], atol=1e-3)
        assert np.argmin(weighed) == 3


def test_of_pixels_at_a_depth_edge_those_between_both_surfaces_are_left_out(
    arm: pk.ArticulatedModel, moving: Frames
) -> None:
    image = moving[0].images[0]
    fitting, motion, _ = fitted_to(arm, moving[0], pk.TrackerOptions(cell=1e-4, points=50000))
    rows, columns = (int(np.median(of)) for of in np.nonzero(image.depth))
    near, steps = float(np.median(image.depth[image.depth > 0.0])), np.zeros((20, 20))
    steps[:, 10:] = 0.08
    sloped, mixed = steps + 0.012 * np.arange(20), steps.copy()
    mixed[:, 10] = 0.04
    for nothing in (0.0, np.inf):
        for step, kept in ((steps, 400), (sloped, 400), (mixed, 380), (mixed.T, 380)):
            depth = np.full(image.depth.shape, nothing, np.float32)
            depth[rows - 10 : rows + 10, columns - 10 : columns + 10] = near + (step - 0.08) * arm.diagonal
            fitting.look(replace(image, depth=depth), motion)
            assert fitting.native.points == kept


def test_what_a_frame_does_not_tell_is_no_less_sure_than_expected(arm: pk.ArticulatedModel, moving: Frames) -> None:
    fitting, motion, usual = fitted_to(arm, moving[0])
    expected = motion.predicted(moving[1].time)
    fitting.look(forearm_hidden(arm, moving[1]), expected)
    for doubt in (None, np.array([0.0, 1.0])):
        fit = fitting.fitted(expected, usual, np.inf, wide=doubt is None, doubt=doubt)
        assert (np.diag(fit.covariance) < 1.001 * np.diag(expected.covariance)).all()


def test_values_in_doubt_may_be_far_from_the_expected(arm: pk.ArticulatedModel, moving: Frames) -> None:
    fitting, motion, usual = fitted_to(arm, moving[0])
    expected = replace(motion, values=motion.values + np.array([0.0, 0.1]), covariance=1e-12 * np.eye(8))
    fitting.look(moving[0].images[0], expected)
    sure, doubtful = (
        fitting.fitted(expected, usual, np.inf, doubt=doubt).values - motion.values
        for doubt in (None, np.array([0.0, 0.3]))
    )
    assert abs(sure[1]) > 0.09 and abs(doubtful[1]) < 0.01
