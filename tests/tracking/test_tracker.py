"""Following a model through a stream: accuracy, loss and recovery, the same bits again."""

from __future__ import annotations

import time
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hidden_forearm import Frames, errors, forearm_hidden

import pwralign_kin as pk
from pwralign_kin.exceptions import ArgumentError, OptionError, ScanError, UnknownNameError
from pwralign_kin.se3 import from_twist, inverse, rotation_angle
from pwralign_kin.simulation import SimulatedFrame, simulate_sequence
from pwralign_kin.simulation.sequences import Motion
from pwralign_kin.tracking import Frame
from pwralign_kin.tracking.fit import Usual
from pwralign_kin.tracking.motion import BelievedMotion
from pwralign_kin.tracking.tracker import PATIENCE


def _blank(frame: SimulatedFrame) -> pk.DepthFrame:
    image = frame.images[0]
    return replace(image, depth=np.zeros_like(image.depth))


def test_follows_a_moving_model_from_a_known_start(arm: pk.ArticulatedModel, moving: Frames) -> None:
    tracker = pk.Tracker(arm, initial=moving[0].state)
    for frame in moving:
        tracked = tracker.update(frame.images[0], frame.time)
        joints, base = errors(arm, tracked.state, frame.state)
        assert joints < 1.5 and base < 0.005
        assert not tracked.lost and not tracked.searched and tracked.confidence > 0.7
        assert 100 < tracked.points <= tracker.options.points and tracked.seconds > 0.0


def test_scans_and_bare_points_serve_as_frames(arm: pk.ArticulatedModel, moving: Frames) -> None:
    def frame_of(kind: str, image: pk.DepthFrame) -> Frame:
        scan = image.to_scan()
        return scan if kind == "scan" else scan.points.astype(np.float32 if kind == "single" else np.float64)

    for kind in ("scan", "single", "double"):
        tracker = pk.Tracker(arm, initial=moving[0].state)
        for frame in moving[:6]:
            tracked = tracker.update(frame_of(kind, frame.images[0]), frame.time)
        assert errors(arm, tracked.state, frame.state)[0] < 2.0, kind
        assert not tracked.lost


def test_integer_depth_is_the_same_as_metres(arm: pk.ArticulatedModel, moving: Frames) -> None:
    image = moving[0].images[0]
    integer = replace(image, depth=np.round(image.depth * 10_000).astype(np.uint16), depth_scale=1e-4)
    states = [pk.Tracker(arm, initial=moving[0].state).update(one, 0.0).state for one in (image, integer)]
    np.testing.assert_allclose(states[0].T_scan_base, states[1].T_scan_base, atol=1e-3)


def test_is_found_without_a_guess_and_again_after_it_was_hidden(arm: pk.ArticulatedModel, moving: Frames) -> None:
    tracker = pk.Tracker(arm)
    first = tracker.update(moving[0].images[0], 0.0)
    assert first.searched and not first.lost and errors(arm, first.state, moving[0].state)[0] < 3.0
    seen = [tracker.update(frame.images[0], frame.time) for frame in moving[1:8]]
    hidden = [tracker.update(_blank(frame), frame.time) for frame in moving[8:22]]
    assert [frame.lost for frame in hidden] == [index + 1 >= PATIENCE for index in range(len(hidden))]
    assert all(frame.confidence == 0.0 and frame.points == 0 for frame in hidden)
    # It goes on a little, and comes to rest.
    moves = [errors(arm, one.state, other.state)[0] for one, other in pairwise(hidden)]
    assert moves[-1] < 0.1 and errors(arm, hidden[-1].state, seen[-1].state)[0] < 20.0
    again = [tracker.update(frame.images[0], frame.time) for frame in moving[22:]]
    assert not again[-1].lost
    assert errors(arm, again[-1].state, moving[-1].state)[0] < 2.0


def test_other_things_in_view_are_not_the_model(arm: pk.ArticulatedModel, moving: Frames) -> None:
    tracker = pk.Tracker(arm, initial=moving[0].state)
    tracker.update(moving[0].images[0], 0.0)
    board = replace(moving[0].images[0], depth=np.full_like(moving[0].images[0].depth, 0.4))
    for index in range(1, 1 + PATIENCE):
        tracked = tracker.update(board, index / 30)
    assert tracked.lost and tracker.lost


def test_the_same_frames_give_the_same_bits_at_any_number_of_threads(arm: pk.ArticulatedModel, moving: Frames) -> None:
    tracks = []
    for threads in (1, 2):
        tracker = pk.Tracker(arm, pk.TrackerOptions(estimator=pk.EstimatorOptions(threads=threads)))
        tracks.append([tracker.update(frame.images[0], frame.time).state for frame in moving[:4]])
    for one, other in zip(*tracks, strict=True):
        assert one.joints == other.joints
        assert np.array_equal(one.T_scan_base, other.T_scan_base)


def test_with_a_time_limit_a_lost_model_is_searched_for_beside_the_frames(
    arm: pk.ArticulatedModel, moving: Frames
) -> None:
    tracker = pk.Tracker(arm, pk.TrackerOptions(time_limit=0.05))
    image = moving[0].images[0]
    for index in range(2000):
        tracked = tracker.update(image, 0.01 * index)
        if not tracked.lost:
            break
        time.sleep(0.01)
    assert tracked.searched and errors(arm, tracked.state, moving[0].state)[0] < 3.0


def test_locked_joints_and_limits_are_kept(arm: pk.ArticulatedModel, moving: Frames) -> None:
    options = pk.TrackerOptions(estimator=pk.EstimatorOptions(locked=("elbow",)))
    start = moving[0].state
    tracker = pk.Tracker(arm, options, start)
    for frame in moving[:5]:
        tracked = tracker.update(frame.images[0], frame.time)
    assert tracked.state.joints["elbow"] == pytest.approx(start.joints["elbow"], abs=1e-12)
    beyond = pk.State(start.T_scan_base, {**start.joints, "shoulder": 5.0})
    shoulder = pk.Tracker(arm, initial=beyond).update(moving[0].images[0], 0.0).state.joints["shoulder"]
    assert shoulder <= arm.upper[0]


def test_covariance_tells_what_the_frame_does_not(arm: pk.ArticulatedModel, moving: Frames) -> None:
    tracker = pk.Tracker(arm, pk.TrackerOptions(covariance=True), moving[0].state)
    covariance = tracker.update(moving[0].images[0], 0.0).covariance
    assert covariance is not None and covariance.shape == (8, 8)
    std = np.sqrt(np.diag(covariance))
    assert (std[:3] < 0.02).all() and (std[3:6] < 0.01 * arm.diagonal).all() and (std[6:] < 0.05).all()
    assert tracker.update(_blank(moving[1]), 0.1).covariance is None


def test_faults(arm: pk.ArticulatedModel, moving: Frames) -> None:
    with pytest.raises(OptionError, match="time_limit"):
        pk.TrackerOptions(time_limit=0.0)
    for points in (3, 10**9, 1000.5):
        with pytest.raises(OptionError, match="points must be a whole number from 100"):
            pk.TrackerOptions(points=points)  # type: ignore[arg-type]
    with pytest.raises(UnknownNameError, match="elbow"):
        pk.Tracker(arm, pk.TrackerOptions(estimator=pk.EstimatorOptions(locked=("elbov",))))
    with pytest.raises(UnknownNameError):
        pk.Tracker(arm, initial=pk.State(joints={"wrist": 1.0}))
    tracker = pk.Tracker(arm, initial=moving[0].state)
    tracker.update(moving[0].images[0], 1.0)
    with pytest.raises(ScanError, match="not later"):
        tracker.update(moving[1].images[0], 1.0)
    for no_time in ("now", float("nan"), None):
        with pytest.raises(ScanError, match="finite number of seconds"):
            tracker.update(moving[1].images[0], no_time)
    with pytest.raises(ScanError, match=r"points \(n, 3\)"):
        tracker.update(np.zeros((5, 2)), 2.0)
    with pytest.raises(ScanError, match="int64"):
        tracker.update(np.zeros((5, 3), np.int64), 2.0)


def test_motion_goes_on_as_fast_as_it_went() -> None:
    twist, speeds = np.array([0.3, -0.2, 0.5, 0.1, 0.2, -0.1]), np.array([0.7, -0.4])
    motion = BelievedMotion.at_rest(0.0, np.eye(4), np.zeros(2), 0.0)
    for index in range(1, 40):
        expected = motion.predicted(index / 30)
        told = (1e-6 * np.eye(8), np.zeros(2, bool))
        true = from_twist(index / 30 * twist)
        motion = expected.corrected(true, index / 30 * speeds, *told, np.full(2, np.inf), motion)
    np.testing.assert_allclose(motion.speeds, speeds, atol=1e-3)
    np.testing.assert_allclose(motion.twist, twist, atol=1e-2)
    ahead = motion.predicted(motion.time + 0.1)
    moved = from_twist(0.1 * twist)[:3, :3]
    assert rotation_angle(inverse(ahead.T_scan_base)[:3, :3] @ moved @ motion.T_scan_base[:3, :3]) < 1e-3


def test_no_speed_goes_on_through_a_pause(arm: pk.ArticulatedModel, moving: Frames) -> None:
    tracker = pk.Tracker(arm, initial=moving[0].state)
    for frame in moving[:10]:
        tracker.update(frame.images[0], frame.time)
    assert tracker._motion is not None
    moved = tracker._motion.predicted(moving[9].time + 3600.0)
    assert np.abs(moved.values - tracker._motion.values).max() < 0.6
    tracked = tracker.update(moving[10].images[0], moving[9].time + 3600.0)
    assert not tracked.lost and errors(arm, tracked.state, moving[10].state)[0] < 2.0


def _seen_at(motion: BelievedMotion, time: float, value: float, deviation: float) -> BelievedMotion:
    """The motion once a frame has shown a base that rests and the value of its one joint."""
    expected = motion.predicted(time)
    covariance = deviation**2 * np.eye(7)
    return expected.corrected(np.eye(4), np.array([value]), covariance, np.zeros(1, bool), np.full(1, np.inf), motion)


def test_speeds_follow_few_frames_at_once_and_many_or_unsure_ones_slowly() -> None:
    def taken(rate: float, deviation: float) -> float:
        """Share of a new speed that one frame tells."""
        motion = BelievedMotion.at_rest(0.0, np.eye(4), np.zeros(1), 0.0)
        for index in range(1, 5):
            motion = _seen_at(motion, index / rate, 0.0, deviation)
        return float(_seen_at(motion, 5 / rate, 1.0 / rate, deviation).speeds[0])

    assert taken(5.0, 0.005) > 0.95
    assert 0.3 < taken(30.0, 0.003) < 0.7
    assert taken(30.0, 0.01) < 0.1
    assert taken(5.0, 0.1) < 0.5


def test_a_short_slide_that_is_hidden_is_undetermined(tmp_path: Path) -> None:
    link = '<link name="{}"><visual><geometry><box size="{}"/></geometry></visual></link>'
    slide = '<joint name="slide" type="prismatic"><parent link="a"/><child link="b"/><origin xyz="0 0 0.3"/>'
    limit = '<limit lower="0" upper="0.02" effort="1" velocity="1"/></joint>'
    (tmp_path / "slider.urdf").write_text(
        f'<robot name="r">{link.format("a", "0.5 0.3 0.2")}{link.format("b", "0.1 0.1 0.1")}{slide}{limit}</robot>'
    )
    model = pk.ArticulatedModel.from_urdf(tmp_path / "slider.urdf")
    made = pk.simulate(model, sensor=pk.Sensor(views=6, points=4000, noise=0.001), seed=1)
    for hidden in (False, True):
        tracker = pk.Tracker(model, initial=made.state)
        tracked = [tracker.update(made.scan.points[made.labels < 2 - hidden], 0.1 * index) for index in range(4)]
        assert tracked[-1].undetermined == (("slide",) if hidden else ())


def test_a_joint_that_is_hidden_is_held_and_called_undetermined(arm: pk.ArticulatedModel, moving: Frames) -> None:
    tracker = pk.Tracker(arm, initial=moving[0].state)
    tracked = [tracker.update(moving[0].images[0], 0.0)]
    assert "elbow" not in tracked[0].undetermined
    tracked += [tracker.update(forearm_hidden(arm, frame), frame.time) for frame in moving[1:15]]
    assert all("elbow" in frame.undetermined for frame in tracked[3:])
    moves = [abs(one.state.joints["elbow"] - other.state.joints["elbow"]) for one, other in pairwise(tracked[8:])]
    assert max(moves) < np.radians(1.0)
    assert tracked[-1].std["elbow"] > tracked[3].std["elbow"] > tracked[0].std["elbow"]
    assert not tracked[-1].lost
    again = [tracker.update(frame.images[0], frame.time) for frame in moving[15:]]
    assert "elbow" not in again[-1].undetermined
    assert errors(arm, again[-1].state, moving[-1].state)[0] < 2.0


def test_few_frames_of_a_fast_motion_are_followed(arm: pk.ArticulatedModel) -> None:
    frames = simulate_sequence(arm, 16, Motion(joint_speed=1.5, rate=5.0), size=(160, 120), seed=5)
    tracker: pk.Tracker | None = None
    for frame in frames:
        tracker = tracker or pk.Tracker(arm, initial=frame.state)
        tracked = tracker.update(frame.images[0], frame.time)
        assert not tracked.lost
        joints, base = errors(arm, tracked.state, frame.state)
        assert joints < 8.0 and base < 0.005


def _left_part(image: pk.DepthFrame, columns: int) -> pk.DepthFrame:
    """What a smaller sensor behind the same lens would have seen."""
    return replace(image, depth=np.ascontiguousarray(image.depth[:, :columns]))


def test_what_is_outside_the_image_is_not_missing(arm: pk.ArticulatedModel, moving: Frames) -> None:
    tracker = pk.Tracker(arm, initial=moving[0].state)
    tracker.update(moving[0].images[0], moving[0].time)
    columns = np.flatnonzero((moving[1].images[0].depth > 0.0).any(axis=0))
    half = int(np.median(columns))
    blanked = moving[1].images[0].depth.copy()
    blanked[:, half:] = 0.0
    cut = tracker.update(_left_part(moving[1].images[0], half), moving[1].time)
    missing = tracker.update(replace(moving[2].images[0], depth=blanked), moving[2].time)
    assert cut.model_support > 0.9 > missing.model_support


def test_an_image_of_few_pixels_is_looked_at_whole(arm: pk.ArticulatedModel, moving: Frames) -> None:
    frame = next(iter(simulate_sequence(arm, 1, size=(320, 240), seed=5)))
    tracker = pk.Tracker(arm, pk.TrackerOptions(cell=1e-4, points=50000), initial=frame.state)
    assert tracker.update(frame.images[0], 0.0).points > 0.9 * (frame.images[0].depth > 0.0).sum()


def test_few_points_are_thinned_less(arm: pk.ArticulatedModel, moving: Frames) -> None:
    image = moving[0].images[0]
    wide, narrow = (
        pk.Tracker(arm, pk.TrackerOptions(points=points), initial=moving[0].state).update(image, 0.0).points
        for points in (2000, 200)
    )
    assert wide > 0.9 * (image.depth > 0.0).sum() and narrow == 200


def test_a_round_base_does_not_slip_against_the_joint_on_it(tmp_path: Path) -> None:
    def visual(xyz: str, shape: str) -> str:
        return f'<visual><origin xyz="{xyz}"/><geometry>{shape}</geometry></visual>'

    drum = visual("0 0 0.15", '<cylinder radius="0.1" length="0.3"/>')
    base = drum + visual("0.1 0 0.15", '<box size="0.02 0.03 0.3"/>')
    turret = drum + visual("0 0.1 0.15", '<box size="0.03 0.02 0.3"/>') + visual("0 0 0.4", '<box size="0.3 0.1 0.1"/>')
    joint = (
        '<joint name="turn" type="revolute"><parent link="base"/><child link="turret"/><origin xyz="0 0 0.32"/>'
        '<axis xyz="0 0 1"/><limit lower="-3" upper="3" effort="1" velocity="1"/></joint>'
    )
    links = f'<link name="base">{base}</link><link name="turret">{turret}</link>'
    (tmp_path / "round.urdf").write_text(f'<robot name="round">{links}{joint}</robot>')
    model = pk.ArticulatedModel.from_urdf(tmp_path / "round.urdf")
    tracker, errors = None, []
    for frame in simulate_sequence(model, 60, size=(160, 120), seed=2):
        tracker = tracker or pk.Tracker(model, initial=frame.state)
        tracked = tracker.update(frame.images[0], frame.time)
        errors.append(tracked.state.joints["turn"] - frame.state.joints["turn"])
    assert np.degrees(np.sqrt(np.mean(np.square(errors)))) < 2.0


def test_what_noise_is_usual_is_not_forgotten(arm: pk.ArticulatedModel, moving: Frames) -> None:
    tracker = pk.Tracker(arm, initial=moving[0].state)
    shown = []
    for frame in moving:
        tracker.update(frame.images[0], frame.time)
        assert tracker._usual is not None
        shown.append(tracker._usual.noise)
    assert shown[-1] > 0.8 * shown[0] > 0.0004


def test_the_covariance_of_a_frame_is_as_large_as_its_errors(arm: pk.ArticulatedModel, moving: Frames) -> None:
    tracker = pk.Tracker(arm, pk.TrackerOptions(covariance=True), initial=moving[0].state)
    ratios = []
    for frame in moving:
        tracked = tracker.update(frame.images[0], frame.time)
        assert tracked.covariance is not None
        apart = arm.values(tracked.state.joints) - arm.values(frame.state.joints)
        ratios.append(apart / np.sqrt(np.diag(tracked.covariance)[6:]))
    assert 0.4 < np.sqrt(np.mean(np.square(ratios))) < 2.0


def test_what_was_never_found_is_not_known(arm: pk.ArticulatedModel, moving: Frames) -> None:
    tracked = pk.Tracker(arm).update(_blank(moving[0]), 0.0)
    assert tracked.lost and tracked.confidence == 0.0
    assert set(tracked.undetermined) == set(arm.joint_names)
    half = (arm.upper - arm.lower) / 4.0
    assert all(tracked.std[name] > own for name, own in zip(arm.joint_names, half, strict=True))


def test_arguments_of_other_kinds_are_refused(arm: pk.ArticulatedModel, moving: Frames) -> None:
    with pytest.raises(ArgumentError, match="State"):
        pk.Tracker(arm, initial="state.json")  # type: ignore[arg-type]
    with pytest.raises(ScanError, match="'a'"):
        pk.Tracker(arm).update(moving[0].images[0], "a")  # type: ignore[arg-type]


def test_a_fit_that_has_not_settled_goes_on(arm: pk.ArticulatedModel) -> None:
    frames = simulate_sequence(arm, 12, Motion(joint_speed=1.5, rate=5.0), size=(160, 120), seed=5)
    worst, tracker = 0.0, None
    for frame in frames:
        tracker = tracker or pk.Tracker(arm, pk.TrackerOptions(iterations=6), initial=frame.state)
        worst = max(worst, errors(arm, tracker.update(frame.images[0], frame.time).state, frame.state)[0])
    assert worst < 3.0


@pytest.mark.filterwarnings("error")
def test_a_plate_that_fills_the_image_takes_nothing_away_from_what_is_known(tmp_path: Path) -> None:
    visual = '<visual><origin xyz="{}"/><geometry><box size="{}"/></geometry></visual>'
    plate, behind = visual.format("0 0 0", "2 2 0.02"), visual.format("0.1 0 0.1", "0.2 0.05 0.05")
    (tmp_path / "plate.urdf").write_text(
        f'<robot name="r"><link name="a">{plate}</link><link name="b">{behind}</link>'
        '<joint name="turn" type="revolute"><parent link="a"/><child link="b"/><axis xyz="0 0 1"/>'
        '<limit lower="-3" upper="3" effort="1" velocity="1"/></joint></robot>'
    )
    model = pk.ArticulatedModel.from_urdf(tmp_path / "plate.urdf")
    T = from_twist(np.array([0.6, 0.0, 0.0, 0.0, 0.0, 0.0]))
    T[:3, 3] = [0.1, 0.0, 1.0]
    columns, rows = np.meshgrid(np.arange(160), np.arange(120))
    rays = np.stack([(columns - 79.5) / 160.0, (rows - 59.5) / 160.0, np.ones(rows.shape)], axis=-1)
    front = T[:3, 3] - 0.01 * T[:3, 2]
    depth = ((T[:3, 2] @ front) / (rays @ T[:3, 2])).astype(np.float32)
    image = pk.DepthFrame(depth, intrinsics=(160.0, 160.0, 79.5, 59.5))
    tracker = pk.Tracker(model, pk.TrackerOptions(covariance=True), pk.State(T, {"turn": 0.3}))
    for index in range(400):
        tracked = tracker.update(image, 0.2 * index)
        assert tracked.covariance is not None and np.linalg.eigvalsh(tracked.covariance)[0] > 0.0
    assert tracked.undetermined == ("turn",)


def test_iterations_are_those_of_a_fit_and_where_it_goes_on_of_both_its_runs(
    arm: pk.ArticulatedModel, moving: Frames, monkeypatch: pytest.MonkeyPatch
) -> None:
    tracker = pk.Tracker(arm, pk.TrackerOptions(iterations=1), moving[0].state)
    tracker.update(moving[0].images[0], 0.0)
    for doubted in (False, True):
        monkeypatch.setattr(Usual, "doubts", lambda *_, doubted=doubted: doubted)
        assert tracker.update(moving[0].images[0], 1.0 + doubted).iterations == 1 + doubted
