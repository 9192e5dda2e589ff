"""Scans that the model is not in."""

from __future__ import annotations

import pytest

import pwralign_kin as pk
from pwralign_kin.benchmark import foreign
from pwralign_kin.estimation.evidence.confidence import confidence
from pwralign_kin.estimation.evidence.evidence import Evidence


def test_every_scan_is_of_something_else_and_about_as_large_as_the_model(twins: pk.ArticulatedModel) -> None:
    made = {case.tier: case for case in foreign.cases("twins", twins, [("twins", twins)])}
    whats = {*foreign.SOLIDS, *foreign.WRONG_SIZES, "clutter alone", "room alone"}
    assert {name.partition(",")[0] for name in made} == whats
    for tier, case in made.items():
        assert case.robot == "twins" and case.guess is None
        if "alone" not in tier:
            assert 0.1 * twins.diagonal < case.scan.diagonal < 3.0 * twins.diagonal


def test_answers_to_them_count_as_wrong(twins: pk.ArticulatedModel, monkeypatch: pytest.MonkeyPatch) -> None:
    ball = next(case for case in foreign.cases("twins", twins, [("twins", twins)]) if case.tier == "ball, sparse")
    monkeypatch.setattr(foreign, "cases", lambda *_: iter([ball]))
    [outcome] = foreign.measure([("twins", twins)], 1, lambda _: None)
    assert not outcome.score.overlay
    assert outcome.confidence < 0.3
    kept = Evidence(**{name: outcome.evidence[name] for name in Evidence.__dataclass_fields__})
    assert confidence(kept) == outcome.confidence
