"""Close looks at the leading configurations of a scene, and when it is searched on."""

from __future__ import annotations

import numpy as np
import pytest
from searched_scenes import observed, searching, true_and_moved

import pwralign_kin as pk
from pwralign_kin.estimation.answers.answer_search import AnswerSearch
from pwralign_kin.estimation.search.candidates import Candidates, Hypotheses
from pwralign_kin.estimation.search.face_hypotheses import FaceOptions
from pwralign_kin.estimation.search.scene_search import RegionSearch, SceneSearchOptions, unlike
from pwralign_kin.estimation.stopwatch import Stopwatch
from pwralign_kin.simulation import SimulatedScan

pytest.importorskip("open3d", reason="ray casting needs Open3D and its system libraries", exc_type=ImportError)


def test_a_scene_is_searched_on_while_its_answer_has_no_confidence(
    excavator: pk.ArticulatedModel, scene: SimulatedScan, monkeypatch: pytest.MonkeyPatch
) -> None:
    searches = []
    candidates = RegionSearch.candidates

    def counted(own: RegionSearch, seed: int, outside: Hypotheses, *, further: bool) -> Candidates | None:
        searches.append(further)
        return candidates(own, seed, outside, further=further)

    monkeypatch.setattr(RegionSearch, "candidates", counted)
    pk.estimate(excavator, scene.scan)
    assert searches == [False]
    monkeypatch.setattr("pwralign_kin.estimation.answers.answer_search.confidence", lambda _: 0.0)
    pk.estimate(excavator, scene.scan)
    assert searches == [False, False, True]


def test_limbs_are_found_that_the_search_of_the_whole_scene_leaves_wrong(
    excavator: pk.ArticulatedModel, scene: SimulatedScan
) -> None:
    ready = observed(excavator, scene.scan)
    search = searching(excavator, ready)
    astray = true_and_moved(excavator, scene, ready).take([0])
    astray.values[0] = excavator.within_limits(excavator.values({})) / excavator.joint_scales
    answers = AnswerSearch(excavator, search, pk.EstimatorOptions(threads=2), None, Stopwatch())

    closely = answers._closely(search.about(astray, SceneSearchOptions().focus))
    looked = closely._found(0, closely.search, astray)
    found = closely._narrowly_repaired(closely.search, looked, turn=True)

    true = search.probe_positions(true_and_moved(excavator, scene, ready).take([0]))
    errors = np.linalg.norm(search.probe_positions(found) - true, axis=-1).mean(axis=1)
    assert errors.min() < 0.01 < 0.03 < np.linalg.norm(search.probe_positions(astray) - true, axis=-1).mean()


def test_an_answer_that_is_doubted_is_looked_at_again_before_another_search(
    excavator: pk.ArticulatedModel, scene: SimulatedScan, monkeypatch: pytest.MonkeyPatch
) -> None:
    told: list[str] = []
    looked, candidates = AnswerSearch._looked_at_again, RegionSearch.candidates

    def look(own: AnswerSearch, seed: int, answer: Candidates) -> Candidates:
        told.append("look")
        return looked(own, seed, answer)

    def search(own: RegionSearch, seed: int, outside: Hypotheses, *, further: bool) -> Candidates | None:
        told.append("search")
        return candidates(own, seed, outside, further=further)

    monkeypatch.setattr(AnswerSearch, "_looked_at_again", look)
    monkeypatch.setattr(RegionSearch, "candidates", search)
    options = SceneSearchOptions()
    doubted = 0.5 * (options.confident + options.sure)
    monkeypatch.setattr("pwralign_kin.estimation.answers.answer_search.confidence", lambda _: doubted)
    pk.estimate(excavator, scene.scan)
    assert told == ["search", "look"]


def test_another_look_at_an_answer_finds_the_limbs_that_are_wrong(
    excavator: pk.ArticulatedModel, scene: SimulatedScan
) -> None:
    ready = observed(excavator, scene.scan)
    search = searching(excavator, ready)
    true, astray = (true_and_moved(excavator, scene, ready).take([0]) for _ in range(2))
    astray.values[0] = excavator.within_limits(excavator.values({})) / excavator.joint_scales
    answers = AnswerSearch(excavator, search, pk.EstimatorOptions(threads=2), None, Stopwatch())

    found = answers._looked_at_again(0, search.scored(astray)[0]).take([0])

    def error(own: Candidates) -> float:
        return float(np.linalg.norm(search.probe_positions(own) - search.probe_positions(true), axis=-1).mean())

    assert error(found) < 0.01 < 0.03 < error(astray)


def test_another_search_looks_at_other_configurations(excavator: pk.ArticulatedModel, scene: SimulatedScan) -> None:
    search = searching(excavator, observed(excavator, scene.scan))
    options = pk.EstimatorOptions(threads=2)
    answers = AnswerSearch(excavator, search, options, None, Stopwatch())
    regions = RegionSearch(search, options.scene_search, None, pairs=True, faces=FaceOptions())
    candidates = regions.candidates(0, Hypotheses.nothing(), further=False)
    assert candidates is not None
    looked: list[Candidates] = []
    for seed in (0, 1):
        before = list(looked)
        assert list(answers._looks(seed, candidates, looked))
        leader = looked[len(before)]
        assert len(unlike(search, leader, before, options.scene_search.apart)) == 1
