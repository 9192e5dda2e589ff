"""Which answer is kept where a scan is looked at again."""

from __future__ import annotations

import logging
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest import mock

import numpy as np
import pytest

import pwralign_kin as pk
from pwralign_kin.estimation import second_looks
from pwralign_kin.estimation.estimator import Estimator
from pwralign_kin.estimation.stages import Suppositions
from pwralign_kin.exceptions import CorrespondenceError
from pwralign_kin.simulation import TIERS, SimulatedScan, random_state
from pwralign_kin.simulation.raycasting import World, looking_at
from pwralign_kin.simulation.simulator import posed_parts


def _answer(scan: pk.Scan, sound: float, confidence: float) -> Any:
    """An estimate that explains no point, as far as a second look asks it."""
    evidence = SimpleNamespace(strange=1.0, sound=sound)
    return SimpleNamespace(evidence=evidence, confidence=confidence, scan_labels=np.full(scan.n_input, -1))


@pytest.mark.parametrize(
    ("sound", "confidence", "taken"),
    [(0.3, 0.6, True), (0.3, 0.59, False), (0.2, 0.9, False)],
    ids=["sounder", "sounder but less confident", "no sounder"],
)
def test_a_second_look_beside_surroundings_must_be_sounder_and_no_less_confident(
    sound: float,
    confidence: float,
    taken: bool,
    arm: pk.ArticulatedModel,
    single_scan: SimulatedScan,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scan, estimator = single_scan.scan, Estimator(arm, pk.EstimatorOptions())
    first, second = _answer(scan, 0.2, 0.6), _answer(scan, sound, confidence)
    monkeypatch.setattr(second_looks, "soundness", lambda evidence: evidence.sound)
    monkeypatch.setattr(second_looks, "was_prepared", lambda observation, points, options: np.ones(len(points), bool))
    monkeypatch.setattr(second_looks, "surroundings_of", lambda near, left, *rest: left)
    monkeypatch.setattr(estimator, "searched", mock.Mock())
    monkeypatch.setattr(estimator, "finished", lambda _: second)
    searched = mock.Mock(scan=scan)
    searched.solver.comparison.observation.scene = False
    answer = second_looks._beside_surroundings(estimator, searched, first)[1]
    assert answer is (second if taken else first)
    assert estimator.searched.call_args.args[4].surroundings.all()  # what the first answer left unexplained


@pytest.mark.parametrize(("sound", "looked"), [(0.05, True), (0.2, False)], ids=["blind", "not blind"])
def test_an_answer_that_is_no_good_may_lie_in_the_floor(
    sound: float,
    looked: bool,
    arm: pk.ArticulatedModel,
    single_scan: SimulatedScan,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A model laid in the floor that most of a crop shows left none of it unexplained."""
    scan, estimator = single_scan.scan, Estimator(arm, pk.EstimatorOptions())
    first = _answer(scan, sound, 0.1)
    first.evidence.strange, first.scan_labels = 0.0, np.zeros(scan.n_input, int)
    monkeypatch.setattr(second_looks, "soundness", lambda evidence: evidence.sound)
    monkeypatch.setattr(second_looks, "was_prepared", lambda observation, points, options: np.ones(len(points), bool))
    monkeypatch.setattr(second_looks, "surroundings_of", lambda near, left, *rest: left)
    monkeypatch.setattr(estimator, "searched", mock.Mock())
    monkeypatch.setattr(estimator, "finished", lambda _: _answer(scan, 0.6, 0.6))
    searched = mock.Mock(scan=scan)
    searched.solver.comparison.observation.scene = False
    second_looks._beside_surroundings(estimator, searched, first)
    assert estimator.searched.called == looked
    assert not looked or estimator.searched.call_args.args[4].surroundings.all()


def _found(score: float) -> Any:
    """A search whose answer has this score."""
    searched = mock.MagicMock(name=f"search of score {score}")
    searched.finished.scores = np.array([score])
    return searched


@pytest.mark.parametrize(
    ("from_answer", "anew", "kept"),
    [
        (_found(1.0), None, None),
        (_found(1.5), _found(1.4), "anew"),
        (_found(1.5), _found(0.9), "from answer"),
        (_found(1.5), CorrespondenceError("scan", "no part fits"), "from answer"),
    ],
    ids=["no better", "a search finds it too", "a search finds a worse one", "a search finds nothing"],
)
def test_points_are_turned_where_the_answer_gets_better_by_it(
    from_answer: Any, anew: Any, kept: str | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    estimator = mock.Mock()
    estimator.searched = mock.Mock(side_effect=[from_answer, anew])
    monkeypatch.setattr(second_looks, "state_of", mock.Mock())
    found = second_looks._with_turned(estimator, np.ones(3, bool), _found(1.0))
    assert found is {None: None, "anew": anew, "from answer": from_answer}[kept]


def test_an_answer_to_search_about_is_no_prior(arm: pk.ArticulatedModel, single_scan: SimulatedScan) -> None:
    """A look at a cut view took the first answer for what was known, and left the user's bounds by it."""
    name = arm.joint_names[0]
    prior = single_scan.state.joints[name] + 0.05
    estimator = Estimator(arm, pk.EstimatorOptions(prior={name: prior}, prior_std={name: 0.05}, threads=2))
    found = estimator.searched(single_scan.scan, None, None, supposed=Suppositions(start=single_scan.state))
    assert found.initial is None
    assert found.prior[0] * arm.joint_scales[0] == pytest.approx(prior)
    assert np.all(found.solver.upper[0] * arm.joint_scales[0] - prior < 0.3)


@pytest.mark.parametrize(
    ("effort", "sound", "efforts"),
    [
        ("default", 0.05, ["fast"]),
        ("default", 0.3, ["fast", "default"]),
        ("default", 0.6, ["fast"]),
        ("fast", 0.3, ["fast"]),
        ("thorough", 0.05, ["fast"]),
        ("thorough", 0.6, ["fast", "thorough"]),
    ],
)
def test_a_short_search_from_elsewhere_tells_whether_a_longer_one_is_worth_it(
    effort: Any,
    sound: float,
    efforts: list[str],
    arm: pk.ArticulatedModel,
    single_scan: SimulatedScan,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    made = []

    def searched(own: Estimator, *_: Any) -> Any:
        made.append(own.options.effort)
        return _found(1.0)

    monkeypatch.setattr(Estimator, "searched", searched)
    monkeypatch.setattr(Estimator, "finished", lambda *_: _answer(single_scan.scan, sound, 0.5))
    monkeypatch.setattr(second_looks, "gathered", lambda *_: None)
    monkeypatch.setattr(second_looks, "soundness", lambda _: sound)
    found = second_looks._sighted(Estimator(arm, pk.EstimatorOptions(effort=effort)), _found(1.0), single_scan.scan)
    assert made == efforts
    assert (found is not None) == (sound > 0.5)


def test_the_mirror_image_is_of_the_scan_as_it_was_taken_to_be(
    arm: pk.ArticulatedModel, single_scan: SimulatedScan, monkeypatch: pytest.MonkeyPatch
) -> None:
    """After a look without the sensor origin, the image had it again."""
    scan, held_against = single_scan.scan, []

    def without_origin(estimator: Estimator, searched: Any, estimate: pk.Estimate) -> Any:
        return estimator.searched(searched.scan.without_sensor_origin(), None, None), estimate

    def against(estimator: Estimator, searched: Any, estimate: pk.Estimate) -> pk.Estimate:
        held_against.append(searched.scan.sensor_origin)
        return estimate

    monkeypatch.setattr(second_looks, "_without_sensor_origin", without_origin)
    monkeypatch.setattr(second_looks, "_against_mirror_image", against)
    pk.estimate(arm, scan)
    assert scan.sensor_origin is not None
    assert held_against == [None]


def test_what_is_out_of_the_picture_is_not_in_sight(excavator: pk.ArticulatedModel) -> None:
    """A camera sees half of an excavator: nothing of the other half is missed."""
    truth = random_state(excavator, 2)
    world = World(posed_parts(excavator, truth))
    origin = world.centre + 2.5 * world.radius * np.array([0.6, 0.8, 0.0])
    axes = looking_at(world.centre - origin)
    image = world.camera_image(origin, axes, 300.0, (200, 240))
    image.distance[:, :100] = np.inf
    seen = np.isfinite(image.distance)
    estimate = pk.estimate(excavator, pk.Scan(image.points[seen], sensor_origin=origin))
    off = estimate.state.T_scan_base - truth.T_scan_base
    assert np.linalg.norm(off[:3, 3]) < 0.01 * excavator.diagonal
    assert estimate.evidence.in_sight > 0.8
    assert estimate.confidence > 0.7


def test_the_floor_about_a_model_is_not_strange_to_it(
    excavator: pk.ArticulatedModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The floor that a crop leaves begins beside the model, and cost right answers their confidence."""
    made, random = pk.simulate(excavator, sensor=TIERS["full"], seed=5), np.random.default_rng(0)
    T_scan_base, diagonal = made.state.T_scan_base, excavator.diagonal
    own = (made.scan.points - T_scan_base[:3, 3]) @ T_scan_base[:3, :3]
    across = own[:, :2].mean(axis=0) + random.uniform(-0.35, 0.35, (4000, 2)) * diagonal
    floor = np.column_stack([across, own[:, 2].min() + random.normal(0.0, 0.001 * diagonal, 4000)])
    scan = pk.Scan(np.concatenate([made.scan.points, floor @ T_scan_base[:3, :3].T + T_scan_base[:3, 3]]))
    estimate = pk.estimate(excavator, scan)
    monkeypatch.setattr(second_looks, "_apart_from_surroundings", lambda estimator, searched, estimate: estimate)
    before = pk.estimate(excavator, scan)
    assert estimate.evidence.strange < 0.02 < 0.08 < before.evidence.strange
    assert estimate.evidence.explained > 0.95 > before.evidence.explained
    assert estimate.confidence > 0.9 > before.confidence


def test_a_doubtful_answer_in_what_may_be_the_model_in_feet_is_noted(
    repository: Path, caplog: pytest.LogCaptureFixture
) -> None:
    model = pk.ArticulatedModel.from_urdf(repository / "robots/laptop/laptop.urdf")
    metric = pk.Scan.load(repository / "robots/laptop/scans/single.ply")
    assert metric.sensor_origin is not None
    scan = pk.Scan(metric.points / 0.3048, sensor_origin=metric.sensor_origin / 0.3048)
    with caplog.at_level(logging.INFO, logger="pwralign_kin"):
        estimate = pk.estimate(model, scan, options=pk.EstimatorOptions(effort="fast"))
    assert estimate.confidence < 0.7 and "--units ft" in caplog.text
