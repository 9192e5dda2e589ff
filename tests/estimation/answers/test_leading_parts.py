"""When the hypotheses of the largest parts are enough, and when all parts are searched."""

from __future__ import annotations

from dataclasses import replace
from unittest import mock

import numpy as np
import pytest

import pwralign_kin as pk
from pwralign_kin.estimation.answers.answer_search import FOREMOST, LEADING, AnswerSearch
from pwralign_kin.estimation.comparison.scan_comparison import ScanComparison, Sought
from pwralign_kin.estimation.comparison.search_options import SearchOptions
from pwralign_kin.estimation.knowledge.prior import SearchPrior
from pwralign_kin.estimation.search.hypotheses import Hypotheses
from pwralign_kin.estimation.search.tree_search import TreeSearch
from pwralign_kin.estimation.sensing.observation import ObservationOptions
from pwralign_kin.estimation.sensing.preparation import observe
from pwralign_kin.estimation.stopwatch import Stopwatch
from pwralign_kin.simulation import TIERS, SimulatedScan


def searching(
    model: pk.ArticulatedModel, search: TreeSearch, options: pk.EstimatorOptions | None = None
) -> AnswerSearch:
    return AnswerSearch(model, search, options or pk.EstimatorOptions(threads=2), None, Stopwatch())


def searching_scan(model: pk.ArticulatedModel, scan: pk.Scan, units: np.ndarray) -> AnswerSearch:
    sought = Sought(model.kernel_model, model.surfaces, SearchOptions(), 2)
    known = SearchPrior.nothing(model.values({}) / units)
    return searching(
        model, TreeSearch(ScanComparison(sought, observe(scan, model.diagonal, ObservationOptions(), 2), known))
    )


def test_largest_parts_lead_to_the_answer_of_all_parts(arm: pk.ArticulatedModel, search: TreeSearch) -> None:
    answers = searching(arm, search)
    with mock.patch.object(AnswerSearch, "_hypotheses", side_effect=AssertionError("all parts were searched")):
        led = answers._first_search(0)
    with mock.patch.object(AnswerSearch, "_leading", return_value=None):
        searched = answers._first_search(0)
    apart = search.comparison.probe_positions(led.take([0])) - search.comparison.probe_positions(searched.take([0]))
    assert np.linalg.norm(apart, axis=-1).max() < 0.002
    assert led.scores[0] > searched.scores[0] - 0.001


def test_all_parts_are_searched_where_the_leading_ones_explain_too_little(
    arm: pk.ArticulatedModel, search: TreeSearch
) -> None:
    answers = searching(arm, search)
    leading = answers._leading(0)
    assert leading is not None
    assert set(leading.parts) == set(search.root_parts[:LEADING])
    aside = leading.placements.copy()
    aside[:, :3, 3] += 0.3
    assert answers._led_to(leading) is not None
    assert answers._led_to(replace(leading, placements=aside)) is None
    assert answers._led_to(Hypotheses.nothing()) is None


def test_all_parts_are_searched_where_the_scan_lacks_some(
    arm: pk.ArticulatedModel, search: TreeSearch, full_scan: SimulatedScan, units: np.ndarray
) -> None:
    """What is left, one part at most, is explained wherever the others are put."""
    largest = int(search.root_parts[0])
    seen = np.flatnonzero(full_scan.labels == largest)
    answers = searching_scan(arm, pk.Scan(full_scan.scan.points[seen]), units)
    leading = answers._leading(0)
    assert leading is not None
    assert answers._led_to(leading) is None


def test_hypotheses_of_leading_parts_are_those_of_a_search_of_all(arm: pk.ArticulatedModel, search: TreeSearch) -> None:
    """They are not made twice, and nothing changes by that."""
    answers = searching(arm, search)
    apart, together = answers._hypotheses(0, search, answers._leading(0)), answers._hypotheses(0, search)
    assert np.array_equal(apart.parts, together.parts)
    assert np.array_equal(apart.placements, together.placements)


def test_views_noisy_scans_and_other_knowledge_are_searched_with_all_parts(
    arm: pk.ArticulatedModel,
    search: TreeSearch,
    single_scan: SimulatedScan,
    full_scan: SimulatedScan,
    units: np.ndarray,
) -> None:
    noisy = pk.simulate(arm, full_scan.state, TIERS["hololens"], 0)
    assert searching_scan(arm, single_scan.scan, units)._leading(0) is None
    assert searching_scan(arm, noisy.scan, units)._leading(0) is None
    for sources in (("faces",), ("pairs", "fpfh")):
        assert searching(arm, search, pk.EstimatorOptions(threads=2, sources=sources))._leading(0) is None


def test_what_may_lead_to_another_answer_is_grown_beside_what_explains_the_scan(
    arm: pk.ArticulatedModel, search: TreeSearch, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A leading part that fits elsewhere as well is grown from there, too."""
    answers = searching(arm, search)
    leading = answers._leading(0)
    assert leading is not None
    elsewhere = leading.placements[:1].copy()
    elsewhere[:, :3, 3] += 0.1
    worst = np.array([leading.scores.min() - 0.01], np.float32)
    twin = Hypotheses(leading.parts[:1], elsewhere, worst)
    grown: list[int] = []
    grow = TreeSearch.grow
    monkeypatch.setattr(
        TreeSearch, "grow", lambda own, roots, keep: grown.append(len(roots.parts)) or grow(own, roots, keep)
    )
    monkeypatch.setattr(TreeSearch, "rivalling", lambda own, roots, answer, margin: roots.scores == worst[0])
    answers._led_to(Hypotheses.concatenate([leading, twin]))
    assert grown == [FOREMOST, 1]
