"""Correspondences with a known share of wrong ones, failures that count, and one real run."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pwralign_kin.benchmark import methods
from pwralign_kin.benchmark.cases import simulated_case
from pwralign_kin.benchmark.methods import ABLATIONS, DEFAULT, outside_pairs, with_outside_pairs
from pwralign_kin.benchmark.metrics import Ruler
from pwralign_kin.benchmark.runs import evaluate, tier_cases
from pwralign_kin.model import ArticulatedModel
from pwralign_kin.se3 import inverse, transform


@pytest.mark.parametrize(("wrong", "least", "most"), [(0.0, 0.0, 0.0), (0.6, 0.5, 0.6), (1.0, 0.85, 1.0)])
def test_the_wrong_share_of_outside_pairs(ruler: Ruler, wrong: float, least: float, most: float) -> None:
    """Some torn pairs come out right by chance."""
    model = ruler.model
    case = simulated_case(model, "twins", "full", 0)
    reference = ruler.reference(case.truth, case.labels)
    pairs = outside_pairs(case, ruler, reference, 500, wrong)
    at_zero = model.part_placements(np.zeros(len(model.joint_names)))
    motions = reference.placements @ inverse(at_zero)
    offsets = [transform(T, pairs.source) - pairs.target for T in motions]
    distance = np.linalg.norm(offsets, axis=2).min(axis=0)
    assert len(pairs.source) == 500
    assert least <= np.mean(distance > 0.01 * model.diagonal) <= most


def test_outside_pairs_repeat(ruler: Ruler) -> None:
    case = simulated_case(ruler.model, "twins", "full", 0)
    reference = ruler.reference(case.truth, case.labels)
    first, again = (outside_pairs(case, ruler, reference, 50, 0.6) for _ in range(2))
    assert np.array_equal(first.target, again.target) and np.array_equal(first.source, again.source)


def test_a_failure_is_an_answer_that_is_wrong(
    ruler: Ruler, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def failing(*arguments: Any) -> None:
        raise RuntimeError("out of luck")

    monkeypatch.setattr(methods, "estimate", failing)
    lines: list[str] = []
    cases = tier_cases([("twins", ruler.model)], ["sparse"], 1)
    (outcome,) = evaluate(cases, {"default": DEFAULT}, 1, lines.append)
    assert not outcome.score.overlay
    assert outcome.confidence == 0 and outcome.joints == ()
    assert outcome.fault == "RuntimeError: out of luck"
    assert "MISSED RuntimeError: out of luck" in lines[0]
    assert "out of luck" in caplog.text


def test_every_ablation_changes_one_thing() -> None:
    usual = DEFAULT.options
    for name, method in ABLATIONS.items():
        changed = [field for field in vars(usual) if getattr(method.options, field) != getattr(usual, field)]
        assert len(changed) == {"default": 0, "fpfh-no-repair": 2}.get(name, 1), name


def test_estimates_are_scored(twins: ArticulatedModel) -> None:
    chosen = {"default": DEFAULT, "outside": with_outside_pairs(200, 0.6)}
    lines: list[str] = []
    outcomes = evaluate(tier_cases([("twins", twins)], ["sparse"], 1), chosen, 1, lines.append)
    assert [outcome.method for outcome in outcomes] == ["default", "outside"]
    assert all(outcome.score.overlay for outcome in outcomes)
    assert len(lines) == 2
    assert outcomes[0].evidence["points"] == 600
    assert all(np.isfinite(figure) for figure in outcomes[0].evidence.values())
    assert [joint.name for joint in outcomes[0].joints] == list(twins.joint_names)
    assert {joint.name for joint in outcomes[0].joints if joint.told} == set(outcomes[0].told)
