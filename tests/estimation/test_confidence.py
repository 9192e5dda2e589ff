"""What confidence is computed from, and that it tells right answers from wrong ones."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import pwralign_kin as pk
from pwralign_kin.estimation.candidates import Candidates
from pwralign_kin.estimation.confidence import confidence
from pwralign_kin.estimation.evidence import Evidence, gathered
from pwralign_kin.estimation.tree_search import TreeSearch
from pwralign_kin.simulation import TIERS, SimulatedScan

GOOD = Evidence(nearby=0.0, lacking=0.0, uneven=1.1, margin=0.05, noise=0.002, borne_out=0.6, strange=0.0)


def evidence(search: TreeSearch, arm: pk.ArticulatedModel, state: pk.State, units: np.ndarray) -> Evidence:
    base = search.observation.to_search(arm.root_placement(state))
    final = Candidates(base[None], (arm.values(state.joints) / units)[None], np.zeros(1, np.float32))
    return gathered(search, final, final)


def test_the_truth_has_all_evidence_for_it(
    search: TreeSearch, arm: pk.ArticulatedModel, full_scan: SimulatedScan, units: np.ndarray
) -> None:
    found = evidence(search, arm, full_scan.state, units)
    assert found.nearby < 0.01
    assert found.lacking == 0.0
    assert found.uneven < 1.5
    assert found.margin > 0.02
    assert confidence(found) > 0.9


def test_a_wrong_limb_leaves_points_a_part_without_any_and_a_better_rival(
    search: TreeSearch, arm: pk.ArticulatedModel, full_scan: SimulatedScan, units: np.ndarray
) -> None:
    true = full_scan.state
    elbow = true.joints["elbow"]
    wrong = dataclasses.replace(true, joints={**true.joints, "elbow": elbow - 1.5 * np.sign(elbow)})
    found = evidence(search, arm, wrong, units)
    assert found.nearby > 0.01
    assert found.lacking > 0.1
    assert found.margin < 0.0
    assert confidence(found) < 0.2


@pytest.mark.parametrize(
    "worse",
    [
        {"nearby": 0.05},
        {"lacking": 0.3},
        {"uneven": 3.0},
        {"margin": -0.01},
        {"noise": 0.03},
        {"borne_out": 0.15},
        {"borne_out": 0.3, "strange": 0.3},
    ],
    ids=lambda worse: " ".join(worse),
)
def test_every_doubt_lowers_the_confidence(worse: dict[str, float]) -> None:
    assert confidence(GOOD) > 0.9
    assert confidence(dataclasses.replace(GOOD, **worse)) < confidence(GOOD) - 0.01


def test_what_else_the_scan_holds_does_not_count_against_the_answer(arm: pk.ArticulatedModel) -> None:
    cluttered = pk.simulate(arm, sensor=TIERS["clutter"], seed=4)
    estimate = pk.estimate(arm, cluttered.scan)
    assert estimate.scan_coverage < 0.7
    assert estimate.confidence > 0.7
    assert estimate.to_dict()["evidence"]["margin"] == estimate.evidence.margin


@pytest.mark.parametrize("size", [0.15, 0.3])
def test_a_box_is_hardly_taken_for_an_arm(arm: pk.ArticulatedModel, size: float) -> None:
    random = np.random.default_rng(0)
    points = random.uniform(-1.0, 1.0, (4000, 3))
    side = random.integers(3, size=len(points))
    points[np.arange(len(points)), side] = np.sign(points[np.arange(len(points)), side])
    estimate = pk.estimate(arm, pk.Scan(size * points * (1.0, 0.7, 0.5)))
    assert estimate.confidence < 0.2


def test_an_answer_that_explains_nothing_has_no_evidence_for_it(
    search: TreeSearch, arm: pk.ArticulatedModel, full_scan: SimulatedScan, units: np.ndarray
) -> None:
    away = full_scan.state.T_scan_base.copy()
    away[:3, 3] += 100.0 * arm.diagonal
    found = evidence(search, arm, dataclasses.replace(full_scan.state, T_scan_base=away), units)
    assert found.lacking == 1.0
    assert found.borne_out == 0.0
    assert confidence(found) < 0.05
