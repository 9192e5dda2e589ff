"""The estimate at its public surface, on a small arm with known truth."""

from __future__ import annotations

import contextlib
import dataclasses
import json
from typing import Any, Literal

import numpy as np
import pytest

import pwralign_kin as pk
from pwralign_kin.estimation import Correspondences, second_looks
from pwralign_kin.estimation.answers.answer_search import AnswerSearch, Found
from pwralign_kin.exceptions import (
    ArgumentError,
    CorrespondenceError,
    ScanError,
    StateError,
    UnitError,
    UnknownNameError,
)
from pwralign_kin.se3 import from_twist
from pwralign_kin.simulation import TIERS, SimulatedScan


def worst_joint(model: pk.ArticulatedModel, estimate: pk.Estimate, truth: pk.State) -> float:
    """Largest error of a joint: rad, or m over the model's diagonal."""
    errors = []
    for name in model.joint_names:
        error = abs(estimate.state.joints[name] - truth.joints[name])
        errors.append(error if model.units[name] == "rad" else error / model.diagonal)
    return max(errors)


def base_shift(model: pk.ArticulatedModel, estimate: pk.Estimate, truth: pk.State) -> float:
    """Distance of the base's origin to its true place, in model diagonals."""
    return float(np.linalg.norm((estimate.state.T_scan_base - truth.T_scan_base)[:3, 3]) / model.diagonal)


@pytest.fixture(scope="module")
def full(arm: pk.ArticulatedModel, full_scan: SimulatedScan) -> pk.Estimate:
    return pk.estimate(arm, full_scan.scan)


def test_full_scan_without_a_guess(arm: pk.ArticulatedModel, full_scan: SimulatedScan, full: pk.Estimate) -> None:
    assert worst_joint(arm, full, full_scan.state) < np.radians(1)
    assert base_shift(arm, full, full_scan.state) < 0.005
    assert full.converged
    assert full.confidence > 0.8
    assert full.scan_coverage > 0.95
    assert full.inlier_rmse < 0.01 * arm.diagonal
    assert full.undetermined == ()


def test_single_view_without_a_guess(arm: pk.ArticulatedModel, single_scan: SimulatedScan) -> None:
    estimate = pk.estimate(arm, single_scan.scan)
    told = [name for name in arm.joint_names if name not in estimate.undetermined]
    assert len(told) >= 2
    for name in told:
        unit = arm.diagonal if arm.units[name] == "m" else 1.0
        assert abs(estimate.state.joints[name] - single_scan.state.joints[name]) / unit < np.radians(2)


def test_labels_name_the_part_of_every_point_given(
    arm: pk.ArticulatedModel, full_scan: SimulatedScan, full: pk.Estimate
) -> None:
    right = full.scan_labels == full_scan.labels
    assert right.mean() > 0.95
    points = np.concatenate([full_scan.scan.points, [[np.nan, 0, 0]], full_scan.scan.points[:1]])
    again = pk.estimate(arm, pk.Scan(points))
    assert len(again.scan_labels) == len(points)
    assert again.scan_labels[-1] == again.scan_labels[-2] == -1


def test_parts_hang_together_and_follow_the_state(arm: pk.ArticulatedModel, full: pk.Estimate) -> None:
    placements = full.state.T_scan_base @ arm.part_placements(arm.values(full.state.joints))
    for part, placement in zip(full.parts.values(), placements, strict=True):
        assert np.abs(part.T_scan_part - placement).max() < 1e-9
    assert sum(part.points for part in full.parts.values()) == (full.scan_labels >= 0).sum()


def test_values_stay_within_the_limits(arm: pk.ArticulatedModel, full: pk.Estimate) -> None:
    values = np.array(list(full.state.joints.values()))
    assert (values >= arm.lower).all()
    assert (values <= arm.upper).all()


def test_the_same_seed_gives_the_same_bits_at_any_thread_count(
    arm: pk.ArticulatedModel, single_scan: SimulatedScan
) -> None:
    results = [
        pk.estimate(arm, single_scan.scan, options=pk.EstimatorOptions(seed=5, threads=threads))
        for threads in (1, 2, 2)
    ]
    for other in results[1:]:
        assert other.state.T_scan_base.tobytes() == results[0].state.T_scan_base.tobytes()
        assert other.state.joints == results[0].state.joints
        assert other.confidence == results[0].confidence


@pytest.mark.parametrize(("effort", "searches"), [("fast", 1), ("default", 1), ("thorough", 2)])
def test_effort_says_how_often_is_searched(
    arm: pk.ArticulatedModel, full_scan: SimulatedScan, effort: Literal["fast", "default", "thorough"], searches: int
) -> None:
    stages: list[str] = []
    estimate = pk.estimate(arm, full_scan.scan, options=pk.EstimatorOptions(effort=effort), progress=stages.append)
    assert stages.count("hypotheses") == searches
    assert worst_joint(arm, estimate, full_scan.state) < np.radians(2)


def test_an_unknown_effort_is_refused(arm: pk.ArticulatedModel, full_scan: SimulatedScan) -> None:
    with pytest.raises(UnknownNameError, match="thorough"):
        pk.estimate(arm, full_scan.scan, options=pk.EstimatorOptions(effort="most"))  # type: ignore[arg-type]


def test_a_guess_is_refined(arm: pk.ArticulatedModel, single_scan: SimulatedScan) -> None:
    truth = single_scan.state
    T = truth.T_scan_base.copy()
    T[:3, 3] += 0.04 * arm.diagonal
    off = {name: value + (0.15 if arm.units[name] == "rad" else 0.0) for name, value in truth.joints.items()}
    estimate = pk.estimate(arm, single_scan.scan, initial=pk.State(T, off))
    assert abs(estimate.state.joints["shoulder"] - truth.joints["shoulder"]) < np.radians(2)
    assert base_shift(arm, estimate, truth) < 0.01


def test_a_guess_that_leads_to_a_plain_answer_is_not_repaired(
    arm: pk.ArticulatedModel, single_scan: SimulatedScan
) -> None:
    estimate = pk.estimate(arm, single_scan.scan, initial=single_scan.state)
    assert "repair" not in estimate.timings
    assert base_shift(arm, estimate, single_scan.state) < 0.01


def test_a_guess_that_one_joint_keeps_from_the_answer_is_not_repaired(
    arm: pk.ArticulatedModel, single_scan: SimulatedScan
) -> None:
    off = {**single_scan.state.joints, "elbow": single_scan.state.joints["elbow"] + 1.2}
    estimate = pk.estimate(arm, single_scan.scan, initial=pk.State(single_scan.state.T_scan_base, off))
    assert "repair" not in estimate.timings
    assert estimate.state.joints["elbow"] == pytest.approx(single_scan.state.joints["elbow"], abs=0.02)


def test_a_bad_guess_is_searched_away(arm: pk.ArticulatedModel, full_scan: SimulatedScan) -> None:
    estimate = pk.estimate(arm, full_scan.scan, initial=pk.State(np.eye(4), {"shoulder": 0.0}))
    assert "repair" in estimate.timings
    assert worst_joint(arm, estimate, full_scan.state) < np.radians(2)


def test_locked_joints_keep_their_prior_exactly(arm: pk.ArticulatedModel, full_scan: SimulatedScan) -> None:
    value = full_scan.state.joints["elbow"]
    options = pk.EstimatorOptions(locked=("elbow",), prior={"elbow": value})
    estimate = pk.estimate(arm, full_scan.scan, options=options)
    assert estimate.state.joints["elbow"] == pytest.approx(value, abs=1e-12)
    assert worst_joint(arm, estimate, full_scan.state) < np.radians(1)


def test_an_unseen_part_leaves_its_joint_undetermined_at_its_prior(
    arm: pk.ArticulatedModel, full_scan: SimulatedScan
) -> None:
    jaw = [part.name for part in arm.parts].index("jaw")
    seen = pk.Scan(full_scan.scan.points[full_scan.labels != jaw])
    estimate = pk.estimate(arm, seen, options=pk.EstimatorOptions(prior={"grip": 0.04}))
    assert estimate.undetermined == ("grip",)
    assert estimate.state.joints["grip"] == pytest.approx(0.04)
    assert not np.isfinite(estimate.std["grip"])
    assert abs(estimate.state.joints["elbow"] - full_scan.state.joints["elbow"]) < np.radians(1.5)


def test_correspondences_with_most_pairs_wrong_suffice(arm: pk.ArticulatedModel, full_scan: SimulatedScan) -> None:
    rng = np.random.default_rng(0)
    truth = full_scan.state
    zero = arm.part_placements(np.zeros(len(arm.joint_names)))
    posed = truth.T_scan_base @ arm.part_placements(arm.values(truth.joints))
    sources, targets = [], []
    for part, surface in enumerate(arm.surfaces):
        local = surface.samples * arm.diagonal
        sources.append(local @ zero[part, :3, :3].T + zero[part, :3, 3])
        targets.append(local @ posed[part, :3, :3].T + posed[part, :3, 3])
    source, target = np.concatenate(sources), np.concatenate(targets)
    wrong = rng.random(len(target)) < 0.6
    target[wrong] = rng.permutation(full_scan.scan.points)[: wrong.sum()]
    pairs = Correspondences(source, target, np.ones(len(source)))
    estimate = pk.estimate(arm, full_scan.scan, correspondences=pairs, options=pk.EstimatorOptions(sources=()))
    assert worst_joint(arm, estimate, truth) < np.radians(1)


def test_features_alone_make_hypotheses(arm: pk.ArticulatedModel, full_scan: SimulatedScan) -> None:
    estimate = pk.estimate(arm, full_scan.scan, options=pk.EstimatorOptions(sources=("fpfh",)))
    assert base_shift(arm, estimate, full_scan.state) < 0.01


def test_each_part_of_the_pipeline_can_be_switched_off(arm: pk.ArticulatedModel, full_scan: SimulatedScan) -> None:
    base = pk.EstimatorOptions()
    for stage, change in (
        ("repair", {"rounds": 0}),
        ("search", {"two_way": False}),
        ("least_squares", {"enabled": False}),
        ("least_squares", {"bounds": False}),
    ):
        options = dataclasses.replace(base, **{stage: dataclasses.replace(getattr(base, stage), **change)})
        estimate = pk.estimate(arm, full_scan.scan, options=options)
        assert np.isfinite(estimate.cost)
        assert estimate.options == {stage: change}


def test_progress_names_the_stages(arm: pk.ArticulatedModel, full_scan: SimulatedScan) -> None:
    stages: list[str] = []
    estimate = pk.estimate(arm, full_scan.scan, progress=stages.append)
    assert set(stages) == set(estimate.timings)


def test_the_printed_estimate_names_joints_and_parts(full: pk.Estimate) -> None:
    text = str(full)
    for word in ("shoulder", "elbow", "grip", "mm", "deg", "confidence", "jaw", "converged"):
        assert word in text


def test_the_summary_is_json(full: pk.Estimate) -> None:
    content = json.loads(json.dumps(full.to_dict(), allow_nan=False))
    assert content["base_link"] == "base"
    assert content["joints"] == dict(full.state.joints)


def test_unknown_joints_are_named() -> None:
    with pytest.raises(UnknownNameError, match="did you mean 'elbow'"):
        raise UnknownNameError("joint", "elbov", ["elbow"])


@pytest.mark.parametrize(
    ("wrong", "fault"),
    [
        ({"near": (0.0, 0.0)}, "near"),
        ({"region": ((1.0, 0.0, 0.0), (0.0, 1.0, 1.0))}, "corner"),
        ({"region": (0.0, 0.0, 0.0, 1.0, 1.0)}, "region"),
        ({"seed": -1}, "seed"),
        ({"seed": 1.5}, "seed"),
        ({"seed": 2**64}, "seed"),
        ({"threads": -2}, "threads"),
        ({"threads": 1.5}, "threads"),
        ({"prior": {"elbow": "a"}}, "elbow"),
        ({"prior": [1.0]}, "prior must map"),
        ({"prior_std": {"elbow": None}}, "elbow"),
        ({"prior_std": {"elbow": 0.1}}, "prior={'elbow': ...}"),
        ({"prior_std": {"elbow": 0.1}, "prior": {"wrist": 0.1}}, "give the value of 'elbow' too"),
        ({"locked": "elbow"}, "several names"),
        ({"sources": "pairs"}, "several names"),
        ({"search": None}, "SearchOptions"),
        ({"sources": ("pair",)}, "did you mean 'pairs'"),
    ],
)
def test_options_out_of_range_are_refused(wrong: dict[str, Any], fault: str) -> None:
    with pytest.raises(pk.PwralignError, match=fault):
        pk.EstimatorOptions(**wrong)


def test_points_are_no_scan(arm: pk.ArticulatedModel, full_scan: SimulatedScan) -> None:
    with pytest.raises(ArgumentError, match=r"Scan\(points\)"):
        pk.estimate(arm, full_scan.scan.points)  # type: ignore[call-overload]
    with pytest.raises(ArgumentError, match="ndarray"):
        pk.estimate(arm, full_scan.scan, initial=np.eye(4))  # type: ignore[call-overload]


def test_a_path_is_no_model(full_scan: SimulatedScan) -> None:
    with pytest.raises(ArgumentError, match="from_urdf"):
        pk.estimate("arm.urdf", full_scan.scan)  # type: ignore[call-overload]


def test_one_scan_and_one_set_of_joints_are_no_calibration(arm: pk.ArticulatedModel, full_scan: SimulatedScan) -> None:
    with pytest.raises(ArgumentError, match="sequence of scans"):
        pk.calibrate(arm, full_scan.scan, [full_scan.state])  # type: ignore[arg-type]
    with pytest.raises(ArgumentError, match="sequence of scans"):
        pk.calibrate(arm, [full_scan.scan], full_scan.state)  # type: ignore[arg-type]


def test_a_state_is_made_of_names_and_numbers() -> None:
    with pytest.raises(StateError, match="base_link"):
        pk.State(base_link=["a"])  # type: ignore[arg-type]
    with pytest.raises(StateError, match="joints"):
        pk.State(joints=[1.0, 2.0])  # type: ignore[arg-type]


@pytest.mark.parametrize("options", [pk.EstimatorOptions(locked=("elbov",)), pk.EstimatorOptions(prior={"elbov": 0})])
def test_options_that_do_not_fit_the_model_are_refused(
    arm: pk.ArticulatedModel, full_scan: SimulatedScan, options: pk.EstimatorOptions
) -> None:
    with pytest.raises(UnknownNameError, match="elbow"):
        pk.estimate(arm, full_scan.scan, options=options)


def test_a_scan_of_nothing_at_the_models_scale_is_refused(arm: pk.ArticulatedModel) -> None:
    tiny = 1e-6 * np.random.default_rng(0).random((500, 3))
    with pytest.raises(ScanError, match="scale"):
        pk.estimate(arm, pk.Scan(tiny))


def test_a_scan_in_millimetres_is_named_as_such(arm: pk.ArticulatedModel, full_scan: SimulatedScan) -> None:
    with pytest.raises(UnitError, match="--units mm"):
        pk.estimate(arm, pk.Scan(1e3 * full_scan.scan.points))


def test_a_prior_beyond_the_limits_is_refused(arm: pk.ArticulatedModel, full_scan: SimulatedScan) -> None:
    with pytest.raises(StateError, match="limits"):
        pk.estimate(arm, full_scan.scan, options=pk.EstimatorOptions(prior={"elbow": 9.0}))


def test_no_source_of_hypotheses_is_refused(arm: pk.ArticulatedModel, full_scan: SimulatedScan) -> None:
    with pytest.raises(CorrespondenceError, match="sources"):
        pk.estimate(arm, full_scan.scan, options=pk.EstimatorOptions(sources=()))


def test_correspondences_elsewhere_are_refused(arm: pk.ArticulatedModel, full_scan: SimulatedScan) -> None:
    far = Correspondences(np.full((5, 3), 99.0), np.full((5, 3), 99.0), np.ones(5))
    with pytest.raises(CorrespondenceError, match="not on the model"):
        pk.estimate(arm, full_scan.scan, correspondences=far)


@pytest.fixture(scope="module")
def stone(tmp_path_factory: pytest.TempPathFactory) -> pk.ArticulatedModel:
    """Two links over a fixed joint: one part, nothing moves."""
    path = tmp_path_factory.mktemp("stone") / "stone.urdf"
    path.write_text(
        '<robot name="stone"><link name="block"><visual><geometry><box size="0.3 0.2 0.1"/></geometry></visual></link>'
        '<link name="knob"><visual><geometry><cylinder radius="0.03" length="0.1"/></geometry></visual></link>'
        '<joint name="weld" type="fixed"><parent link="block"/><child link="knob"/><origin xyz="0.1 0.05 0.08"/>'
        "</joint></robot>"
    )
    return pk.ArticulatedModel.from_urdf(path)


@pytest.mark.parametrize("guessed", [False, True])
def test_a_model_without_joints_is_found(stone: pk.ArticulatedModel, guessed: bool) -> None:
    T = from_twist(np.array([0.3, -0.5, 1.0, 0.2, 0.1, 0.7]))
    simulated = pk.simulate(stone, pk.State(T), seed=1)
    found = pk.estimate(stone, simulated.scan, initial=simulated.state if guessed else None)
    np.testing.assert_allclose(found.state.T_scan_base, T, atol=0.005)
    assert not found.state.joints and found.confidence > 0.9
    shared = pk.calibrate(stone, [simulated.scan, simulated.scan], [{}, {}])
    np.testing.assert_allclose(shared.T_scan_base, T, atol=0.005)


def test_something_else_than_a_model_without_joints(stone: pk.ArticulatedModel) -> None:
    points = np.random.default_rng(0).uniform(-0.2, 0.2, (3000, 3))
    assert pk.estimate(stone, pk.Scan(points)).state.joints == {}


@pytest.mark.parametrize("noise", [0.0, 0.0075])
def test_a_bare_table_is_refused(arm: pk.ArticulatedModel, noise: float) -> None:
    random = np.random.default_rng(3)
    points = random.uniform(-arm.diagonal, arm.diagonal, (6000, 3)) * [1.0, 1.0, 0.0]
    points[:, 2] += noise * arm.diagonal * random.normal(size=6000)
    with pytest.raises(ScanError, match="plane"):
        pk.estimate(arm, pk.Scan(points))


def test_a_part_that_the_scan_lacks_is_called_unseen(arm: pk.ArticulatedModel, single_scan: SimulatedScan) -> None:
    lacking = pk.simulate(arm, single_scan.state, dataclasses.replace(TIERS["full"], missing_parts=("lower",)), seed=3)
    estimate = pk.estimate(arm, lacking.scan)
    assert [name for name, part in estimate.parts.items() if not part.seen] == ["lower"]
    assert "hardly seen" in str(estimate) or "not seen" in str(estimate)
    assert "of the whole model" in str(estimate)


def scan_lines(scan: pk.Scan, apart: float, thick: float) -> pk.Scan:
    """Return the points of a view (3,) whose elevation is within `thick` of lines (rad) as far `apart`."""
    assert scan.sensor_origin is not None
    ahead = scan.points.mean(axis=0) - scan.sensor_origin
    across = np.cross(ahead, [0.3, -0.5, 0.8])
    rays = scan.points - scan.sensor_origin
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    elevation = np.arcsin(rays @ across / np.linalg.norm(across))
    on_line = np.abs((elevation / apart) % 1.0 - 0.5) < thick / apart
    return pk.Scan(scan.points[on_line], sensor_origin=scan.sensor_origin)


@pytest.mark.parametrize("origin", [True, False])
def test_scan_lines_of_a_spinning_sensor_suffice(arm: pk.ArticulatedModel, origin: bool) -> None:
    sensor = pk.Sensor(views=1, points=60000, noise=0.006, noise_along_ray=True, known_origin=True, distance=(2.5, 2.5))
    simulated = pk.simulate(arm, sensor=sensor, seed=3)
    lines = scan_lines(simulated.scan, 0.02, 0.0002)
    assert 100 < len(lines) < 3000
    estimate = pk.estimate(arm, lines if origin else lines.without_sensor_origin())
    assert estimate.evidence.noise == pytest.approx(0.006, rel=0.4)
    assert worst_joint(arm, estimate, simulated.state) < 0.12
    assert estimate.confidence > 0.6


@pytest.mark.parametrize("where", ["side", "behind"])
def test_a_wrong_sensor_origin_is_dropped(
    arm: pk.ArticulatedModel, single_scan: SimulatedScan, where: str, caplog: pytest.LogCaptureFixture
) -> None:
    points = single_scan.scan.points
    middle = points.mean(axis=0)
    seen_from = single_scan.view_origins[0] - middle
    wrong = middle + (np.cross(seen_from, [0.3, -0.5, 0.8]) if where == "side" else -seen_from)
    estimate = pk.estimate(arm, pk.Scan(points, sensor_origin=wrong))
    assert "sensor origin is not used" in caplog.text
    assert not estimate.viewpoint_known
    assert worst_joint(arm, estimate, single_scan.state) < 0.02
    assert estimate.confidence > 0.5


def test_a_right_sensor_origin_is_kept(
    arm: pk.ArticulatedModel, single_scan: SimulatedScan, caplog: pytest.LogCaptureFixture
) -> None:
    assert pk.estimate(arm, single_scan.scan).viewpoint_known
    assert "sensor origin" not in caplog.text


def test_single_precision_far_from_the_origin_is_named(
    arm: pk.ArticulatedModel, full_scan: SimulatedScan, caplog: pytest.LogCaptureFixture
) -> None:
    """Coordinates of a map are metres, and half a metre apart where single precision holds them."""
    far = full_scan.scan.points + np.array([4.5e5, 5.4e6, 300.0])
    assert pk.estimate(arm, pk.Scan(far)).confidence > 0.5
    assert "rounded" not in caplog.text
    coarse = pk.Scan(far.astype(np.float32))
    with contextlib.suppress(CorrespondenceError):
        assert pk.estimate(arm, coarse).confidence < 0.5
    assert "rounded to 0.5 m" in caplog.text
    assert "single precision" in caplog.text
    caplog.clear()
    with contextlib.suppress(CorrespondenceError):
        pk.estimate(arm, [coarse])
    assert "single precision" in caplog.text


@pytest.mark.parametrize("own_frame", [True, False])
def test_an_untold_sensor_origin_is_that_of_a_cameras_own_frame(
    arm: pk.ArticulatedModel, single_scan: SimulatedScan, own_frame: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    scan, without_guess = single_scan.scan, AnswerSearch.without_guess
    assert scan.sensor_origin is not None

    def misled(search: AnswerSearch) -> Found:
        found = without_guess(search)
        if not search.search.observation.single_view:
            found.solutions.bases[:, :3, 3] += 0.3
        return found

    monkeypatch.setattr(AnswerSearch, "without_guess", misled)
    origin = scan.sensor_origin if own_frame else scan.points.mean(axis=0)
    estimate = pk.estimate(arm, pk.Scan(scan.points - origin))
    assert estimate.viewpoint_known == own_frame
    assert (worst_joint(arm, estimate, single_scan.state) < 0.02) == own_frame


def test_a_scan_of_all_sides_is_not_taken_for_a_cameras_own_frame(
    arm: pk.ArticulatedModel, full_scan: SimulatedScan, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Slender robots in clutter were searched once more, in vain, for twice the time of all the rest."""
    views, without_guess = [], AnswerSearch.without_guess

    def misled(search: AnswerSearch) -> Found:
        found = without_guess(search)
        views.append(search.search.observation.single_view)
        found.solutions.bases[:, :3, 3] += 0.3
        return found

    monkeypatch.setattr(AnswerSearch, "without_guess", misled)
    monkeypatch.setattr(second_looks, "contradicting", lambda *_: 0.0)
    away = full_scan.scan.points - full_scan.scan.points.mean(axis=0) + np.array([2.0 * arm.diagonal, 0.0, 0.0])
    pk.estimate(arm, pk.Scan(away))
    assert views
    assert not any(views)


def test_an_answer_stands_where_nothing_is_found_without_the_sensor_origin(
    arm: pk.ArticulatedModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    ball = np.random.default_rng(0).normal(size=(2000, 3))
    ball *= 0.4 * arm.diagonal / np.linalg.norm(ball, axis=1)[:, None]
    seen = pk.Scan(ball[ball[:, 2] > 0.1 * arm.diagonal], sensor_origin=[0.0, 0.0, 4.0 * arm.diagonal])
    searched = []
    without_guess = AnswerSearch.without_guess

    def blind(search: AnswerSearch) -> Found:
        searched.append(search.search.observation.single_view)
        if not searched[-1]:
            raise CorrespondenceError("scan", "nothing placed")
        return without_guess(search)

    monkeypatch.setattr(AnswerSearch, "without_guess", blind)
    assert pk.estimate(arm, seen).viewpoint_known
    assert searched == [True, False]


@pytest.mark.parametrize(("seed", "known"), [(3, False), (9, True), (21, False)])
def test_a_few_points_of_anything_have_an_answer(arm: pk.ArticulatedModel, seed: int, known: bool) -> None:
    """Of some, nothing was near the answers or the fit of greatest likelihood had no step to take."""
    rng = np.random.default_rng(seed)
    count, length = int(rng.integers(21, 45)), rng.uniform(0.5, 1.2) * arm.diagonal
    points = rng.uniform(-0.5, 0.5, (count, 3)) * [length, 0.3 * length, 0.02 * arm.diagonal]
    estimate = pk.estimate(arm, pk.Scan(points, sensor_origin=[0, 0, 3 * arm.diagonal] if known else None))
    assert estimate.confidence < 0.5


def test_a_joint_that_much_noise_hides_is_weighed_all_the_same(arm: pk.ArticulatedModel) -> None:
    """Beyond 2% noise, what lies on the model was farther than the kernels look, and points of no part were counted."""
    simulated = pk.simulate(arm, sensor=pk.Sensor(points=400, noise=0.03, stray=0.3), seed=4)
    estimate = pk.estimate(arm, simulated.scan)
    assert estimate.evidence.noise > 0.02
    assert estimate.evidence.strange > 0.0


def test_a_view_of_which_a_mask_cuts_most_away_is_answered_with_confidence(excavator: pk.ArticulatedModel) -> None:
    made = pk.simulate(excavator, sensor=TIERS["single"], seed=1)
    scan, origin = made.scan, np.asarray(made.scan.sensor_origin)
    forward = scan.points.mean(axis=0) - origin
    across = np.cross(forward, np.random.default_rng(1).normal(size=3))
    image = (scan.points - origin) @ across / ((scan.points - origin) @ forward)
    cut = pk.Scan(scan.points[image > np.quantile(image, 0.6)], sensor_origin=origin)
    estimate = pk.estimate(excavator, cut)
    assert base_shift(excavator, estimate, made.state) < 0.01
    assert estimate.confidence > 0.8


@pytest.mark.parametrize("count", [10, 200])
def test_a_view_far_smaller_than_the_model_is_refused_by_name(arm: pk.ArticulatedModel, count: int) -> None:
    """A view that one cell holds has no plane: it ended in an IndexError."""
    speck = 0.005 * np.random.default_rng(0).normal(size=(count, 3)) * arm.diagonal
    with pytest.raises(pk.PwralignError):
        pk.estimate(arm, pk.Scan(speck + np.array([0, 0, 1.0]), sensor_origin=(0, 0, 0)))
