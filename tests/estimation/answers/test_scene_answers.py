"""Close looks at the leading configurations of a scene, and when it is searched on."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from searched_scenes import comparing, observed, true_and_moved

import pwralign_kin as pk
from pwralign_kin.estimation.answers.answer_search import AnswerSearch, Found
from pwralign_kin.estimation.answers.contest import contested
from pwralign_kin.estimation.answers.scene_answers import SceneAnswerSearch
from pwralign_kin.estimation.comparison.candidates import Candidates
from pwralign_kin.estimation.comparison.ranking import better_ranked
from pwralign_kin.estimation.comparison.scan_comparison import ScanComparison
from pwralign_kin.estimation.refinement.joint_least_squares import JointLeastSquares
from pwralign_kin.estimation.search.face_hypotheses import FaceOptions
from pwralign_kin.estimation.search.hypotheses import Hypotheses
from pwralign_kin.estimation.search.repair import RepairOptions
from pwralign_kin.estimation.search.scene_search import RegionSearch, SceneSearchOptions, unlike
from pwralign_kin.estimation.search.tree_search import TreeSearch
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
    monkeypatch.setattr("pwralign_kin.estimation.answers.scene_answers.confidence", lambda _: 0.0)
    pk.estimate(excavator, scene.scan)
    assert searches == [False, False, True]


def test_limbs_are_found_that_the_search_of_the_whole_scene_leaves_wrong(
    excavator: pk.ArticulatedModel, scene: SimulatedScan
) -> None:
    ready = observed(excavator, scene.scan)
    comparison = comparing(excavator, ready)
    astray = true_and_moved(excavator, scene, ready).take([0])
    astray.values[0] = excavator.within_limits(excavator.values({})) / excavator.joint_scales
    answers = SceneAnswerSearch(excavator, TreeSearch(comparison), pk.EstimatorOptions(threads=2), None, Stopwatch())

    closely = answers._closely(comparison.about(astray, SceneSearchOptions().focus))
    found = closely.repaired(closely.grown_beside(astray, 0))

    true = comparison.probe_positions(true_and_moved(excavator, scene, ready).take([0]))
    errors = np.linalg.norm(comparison.probe_positions(found) - true, axis=-1).mean(axis=1)
    assert errors.min() < 0.01 < 0.03 < np.linalg.norm(comparison.probe_positions(astray) - true, axis=-1).mean()


def test_an_answer_that_is_doubted_is_looked_at_again_before_another_search(
    excavator: pk.ArticulatedModel, scene: SimulatedScan, monkeypatch: pytest.MonkeyPatch
) -> None:
    told: list[str] = []
    looked, candidates = SceneAnswerSearch._looked_at_again, RegionSearch.candidates

    def look(own: SceneAnswerSearch, seed: int, answer: Candidates) -> Candidates:
        told.append("look")
        return looked(own, seed, answer)

    def search(own: RegionSearch, seed: int, outside: Hypotheses, *, further: bool) -> Candidates | None:
        told.append("search")
        return candidates(own, seed, outside, further=further)

    monkeypatch.setattr(SceneAnswerSearch, "_looked_at_again", look)
    monkeypatch.setattr(RegionSearch, "candidates", search)
    chances = iter([0.0])  # of the answer at first; another look makes it sure
    monkeypatch.setattr("pwralign_kin.estimation.answers.scene_answers.confidence", lambda _: next(chances, 1.0))
    pk.estimate(excavator, scene.scan)
    assert told == ["search", "look"]


@pytest.mark.parametrize(("located", "searches"), [(0.0, 1), (9.0, 2)])
def test_an_answer_that_is_not_sound_but_explains_much_is_not_looked_for_elsewhere(
    excavator: pk.ArticulatedModel,
    scene: SimulatedScan,
    monkeypatch: pytest.MonkeyPatch,
    located: float,
    searches: int,
) -> None:
    searched, repaired = [], []
    candidates, repair = RegionSearch.candidates, SceneAnswerSearch._repaired_in_scene

    def counted(own: RegionSearch, seed: int, outside: Hypotheses, *, further: bool) -> Candidates | None:
        searched.append(further)
        return candidates(own, seed, outside, further=further)

    def repairing(own: SceneAnswerSearch, look: Any) -> Candidates:
        repaired.append(len(searched))
        return repair(own, look)

    monkeypatch.setattr(RegionSearch, "candidates", counted)
    monkeypatch.setattr(SceneAnswerSearch, "_repaired_in_scene", repairing)
    monkeypatch.setattr(SceneAnswerSearch, "_looked_at_again", lambda own, seed, answer: answer)
    monkeypatch.setattr("pwralign_kin.estimation.answers.scene_answers.soundness", lambda _: 0.0)
    options = pk.EstimatorOptions(scene_search=SceneSearchOptions(located=located), threads=2)
    pk.estimate(excavator, scene.scan, options=options)
    assert len(searched) == searches
    assert repaired.count(2) <= 1  # of a further search only the best look is repaired


def test_what_is_near_an_answer_is_searched_from_fewer_places(
    excavator: pk.ArticulatedModel, scene: SimulatedScan
) -> None:
    ready = observed(excavator, scene.scan)
    comparison = comparing(excavator, ready)
    true = true_and_moved(excavator, scene, ready).take([0])
    answers = SceneAnswerSearch(excavator, TreeSearch(comparison), pk.EstimatorOptions(threads=2), None, Stopwatch())
    closely = answers._closely(comparison.about(true, SceneSearchOptions().focus)).search
    several = Hypotheses(np.zeros(500, np.int32), np.tile(np.eye(4), (500, 1, 1)), np.zeros(500, np.float32))
    usual = len(TreeSearch(comparison).promising(several).parts)
    assert len(closely.promising(several).parts) == round(usual * comparison.options.roots_close_up) < usual


def test_another_look_at_an_answer_finds_the_limbs_that_are_wrong(
    excavator: pk.ArticulatedModel, scene: SimulatedScan
) -> None:
    ready = observed(excavator, scene.scan)
    comparison = comparing(excavator, ready)
    true, astray = (true_and_moved(excavator, scene, ready).take([0]) for _ in range(2))
    astray.values[0] = excavator.within_limits(excavator.values({})) / excavator.joint_scales
    answers = SceneAnswerSearch(excavator, TreeSearch(comparison), pk.EstimatorOptions(threads=2), None, Stopwatch())

    found = answers._looked_at_again(0, comparison.scored(astray)[0]).take([0])

    def error(own: Candidates) -> float:
        return float(np.linalg.norm(comparison.probe_positions(own) - comparison.probe_positions(true), axis=-1).mean())

    assert error(found) < 0.01 < 0.03 < error(astray)


def test_of_near_ties_an_answer_that_explains_more_and_is_clearly_likelier_comes_first(
    excavator: pk.ArticulatedModel, scene: SimulatedScan, monkeypatch: pytest.MonkeyPatch
) -> None:
    comparison = comparing(excavator, (ready := observed(excavator, scene.scan)))
    true, aside = (true_and_moved(excavator, scene, ready).take([i]) for i in range(2))
    options = pk.EstimatorOptions(threads=2)

    def first(one: Candidates, other: Candidates, likelier: float) -> Candidates:
        tied = Candidates.concatenate([one, other])
        monkeypatch.setattr(AnswerSearch, "finished", lambda *_: tied)
        chosen = replace(options, scene_search=SceneSearchOptions(likelier=likelier))
        answers = SceneAnswerSearch(excavator, TreeSearch(comparison), chosen, None, Stopwatch())
        finished = answers.finished(Found(tied, comparison))
        assert len(finished) == 2
        return finished.take([0])

    np.testing.assert_array_equal(first(aside, true, 0.2).bases, true.bases)
    np.testing.assert_array_equal(first(true, aside, 0.2).bases, true.bases)
    np.testing.assert_array_equal(first(aside, true, 1.0).bases, aside.bases)  # not clearly
    # What explains less stays behind however likely it is.
    comparison.coverage = lambda candidates, points=None: -np.arange(len(candidates))  # type: ignore[method-assign]
    np.testing.assert_array_equal(first(aside, true, 0.2).bases, aside.bases)


@pytest.mark.parametrize("solutions", [1, 4])
def test_the_best_answer_elsewhere_is_kept_beside_many_at_one_place(
    excavator: pk.ArticulatedModel, scene: SimulatedScan, solutions: int
) -> None:
    comparison = comparing(excavator, (ready := observed(excavator, scene.scan)))
    true, aside = (true_and_moved(excavator, scene, ready).take([i]) for i in range(2))
    options = pk.EstimatorOptions(threads=2, repair=RepairOptions(solutions=solutions))
    answers = SceneAnswerSearch(excavator, TreeSearch(comparison), options, None, Stopwatch())
    many = aside.take([0, 0, 0, 0])
    many.bases[:, 0, 3] += 1.2 * comparison.options.distinct * np.array([0, 1, -1, 2])
    many.scores[:], true.scores[:] = 1.0, 0.5
    true.bases[0, 0, 3] -= 0.1  # no matter how right it is

    kept = answers._distinct([many, true])

    assert len(kept) == max(2, solutions) and kept.scores[0] == 1.0
    assert (kept.bases == true.bases).all(axis=(1, 2)).any()


def test_another_search_looks_at_other_configurations(excavator: pk.ArticulatedModel, scene: SimulatedScan) -> None:
    comparison = comparing(excavator, observed(excavator, scene.scan))
    options = pk.EstimatorOptions(threads=2)
    answers = SceneAnswerSearch(excavator, TreeSearch(comparison), options, None, Stopwatch())
    regions = RegionSearch(TreeSearch(comparison), options.scene_search, None, pairs=True, faces=FaceOptions())
    candidates = regions.candidates(0, Hypotheses.nothing(), further=False)
    assert candidates is not None
    looked: list[Candidates] = []
    for seed in (0, 1):
        before = list(looked)
        assert list(answers._looks(seed, candidates, looked))
        leader = looked[len(before)]
        assert len(unlike(comparison, leader, before, options.scene_search.apart)) == 1


def test_refinement_of_answers_is_kept_where_they_rank_higher_by_it(
    excavator: pk.ArticulatedModel, scene: SimulatedScan
) -> None:
    ready = observed(excavator, scene.scan)
    both = true_and_moved(excavator, scene, ready)
    kept = better_ranked(comparing(excavator, ready), both, both.take([1, 0]))
    np.testing.assert_array_equal(kept.bases, both.take([0, 0]).bases)


def last_word(model: pk.ArticulatedModel, comparison: ScanComparison, final: Candidates) -> Candidates | None:
    options = pk.EstimatorOptions(threads=2)
    solver = JointLeastSquares(model, comparison, *model.kernel_model.limits, options.least_squares)
    return contested(solver, final, comparison.scored(final)[0], options)


def test_the_last_word_on_a_scene_mends_limbs_and_whole_answers_that_lack_points(
    excavator: pk.ArticulatedModel, scene: SimulatedScan
) -> None:
    ready = observed(excavator, scene.scan)
    comparison = comparing(excavator, ready)
    true, aside = (true_and_moved(excavator, scene, ready).take([i]) for i in range(2))
    wrong = Candidates(true.bases, true.values.copy(), true.scores)
    wrong.values[0, -1] = excavator.kernel_model.limits[0][-1]
    assert np.linalg.norm(comparison.probe_positions(wrong) - comparison.probe_positions(true), axis=-1).max() > 0.05

    for start in (wrong, aside):
        mended = last_word(excavator, comparison, start)
        assert mended is not None
        off = comparison.probe_positions(mended)[0] - comparison.probe_positions(true)[0]
        assert np.linalg.norm(off, axis=-1).max() < 0.01


def test_the_last_word_on_a_scene_goes_elsewhere_only_for_a_clear_gain(
    excavator: pk.ArticulatedModel, scene: SimulatedScan, monkeypatch: pytest.MonkeyPatch
) -> None:
    ready = observed(excavator, scene.scan)
    comparison, aside = comparing(excavator, ready), true_and_moved(excavator, scene, ready).take([1])
    monkeypatch.setattr("pwralign_kin.estimation.answers.contest.CLEARLY", 10.0)
    elsewhere = last_word(excavator, comparison, aside)
    if elsewhere is not None:
        moved = np.linalg.norm(comparison.probe_positions(elsewhere)[0] - comparison.probe_positions(aside)[0], axis=-1)
        assert np.median(moved) < 0.015
