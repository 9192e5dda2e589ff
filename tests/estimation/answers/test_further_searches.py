"""When a further search of a scan of the model goes on, and when what the first found is enough."""

from __future__ import annotations

from unittest import mock

import numpy as np
import pytest

import pwralign_kin as pk
from pwralign_kin.estimation.answers.answer_search import AnswerSearch
from pwralign_kin.estimation.comparison.candidates import Candidates
from pwralign_kin.estimation.comparison.scan_comparison import ScanComparison, Sought
from pwralign_kin.estimation.comparison.search_options import SearchOptions
from pwralign_kin.estimation.knowledge.prior import SearchPrior
from pwralign_kin.estimation.search.tree_search import TreeSearch
from pwralign_kin.estimation.sensing.observation import ObservationOptions
from pwralign_kin.estimation.sensing.preparation import observe
from pwralign_kin.estimation.stopwatch import Stopwatch
from pwralign_kin.simulation import SimulatedScan


def first_searched(
    arm: pk.ArticulatedModel, scan: pk.Scan, units: np.ndarray, *, wrong: bool
) -> tuple[AnswerSearch, Candidates]:
    """A search of the scan, and the answers that it finds first; `wrong`: moved aside."""
    observation = observe(scan, arm.diagonal, ObservationOptions(), 2)
    search = TreeSearch(
        ScanComparison(
            Sought(arm.kernel_model, arm.surfaces, SearchOptions(), 2),
            observation,
            SearchPrior.nothing(arm.values({}) / units),
        )
    )
    answers = AnswerSearch(arm, search, pk.EstimatorOptions(threads=2), None, Stopwatch())
    before = answers._first_search(0)
    if wrong:
        before.bases[:, :3, 3] += 0.2
    return answers, before


def searched_again(
    arm: pk.ArticulatedModel, scan: pk.Scan, units: np.ndarray, *, wrong: bool, monkeypatch: pytest.MonkeyPatch
) -> tuple[bool, bool]:
    """Whether a second search returns what was found before it, the answer of the first or a `wrong` one, and whether
    it looks at pieces of the scan."""
    answers, before = first_searched(arm, scan, units, wrong=wrong)
    looked = []
    piecewise = TreeSearch.piecewise_hypotheses
    monkeypatch.setattr(
        TreeSearch, "piecewise_hypotheses", lambda own, seed: looked.append(seed) or piecewise(own, seed)
    )
    return answers._further_search(1, answers.search, before) is before, bool(looked)


def test_an_answer_that_all_of_the_scan_leads_to_again_ends_the_search(
    arm: pk.ArticulatedModel, full_scan: SimulatedScan, units: np.ndarray, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Repair and pieces took more time than all before, and found it once more."""
    assert searched_again(arm, full_scan.scan, units, wrong=False, monkeypatch=monkeypatch) == (True, False)


def test_pieces_are_looked_at_where_other_samples_lead_elsewhere(
    arm: pk.ArticulatedModel, full_scan: SimulatedScan, units: np.ndarray, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert searched_again(arm, full_scan.scan, units, wrong=True, monkeypatch=monkeypatch) == (False, True)


def test_pieces_of_views_are_looked_at_however_sure_the_answer(
    arm: pk.ArticulatedModel, single_scan: SimulatedScan, units: np.ndarray, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where pieces are cut away, all that is left leads to one wrong answer again."""
    assert searched_again(arm, single_scan.scan, units, wrong=False, monkeypatch=monkeypatch) == (False, True)


@pytest.mark.parametrize(
    ("soundness", "unexplained", "settled"), [(0.1, 0.2, False), (0.1, 0.01, True), (0.5, 0.2, True)]
)
def test_what_is_hardly_sound_and_leaves_much_unexplained_is_searched_on(
    search: TreeSearch,
    arm: pk.ArticulatedModel,
    soundness: float,
    unexplained: float,
    settled: bool,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """In clutter a humanoid was answered wrong, though all of its parts explained enough."""
    answers = AnswerSearch(arm, search, pk.EstimatorOptions(threads=2), None, Stopwatch())
    found = answers._first_search(0).best_first()
    assert answers._is_settled(found, [found])
    monkeypatch.setattr(AnswerSearch, "_soundness", lambda *_: soundness)
    monkeypatch.setattr(ScanComparison, "unexplained", lambda *_: unexplained)
    assert answers._is_settled(found, [found]) == settled


@pytest.mark.parametrize("wrong", [False, True])
def test_a_further_search_of_a_view_ends_where_it_comes_to_the_known_answer(
    arm: pk.ArticulatedModel,
    single_scan: SimulatedScan,
    units: np.ndarray,
    wrong: bool,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    answers, before = first_searched(arm, single_scan.scan, units, wrong=wrong)
    read = mock.Mock(side_effect=lambda search, solutions: solutions)
    monkeypatch.setattr(answers, "_reinterpreted", read)
    found = answers._further_search(1, answers.search, before)
    assert read.called == wrong
    assert np.array_equal(found.bases[0], before.bases[0]) != wrong
