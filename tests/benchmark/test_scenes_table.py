"""The table of unsegmented scenes: either copy is right, and points are held against the copy that was found."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from pwralign_kin.benchmark import methods, scenes
from pwralign_kin.benchmark.metrics import Ruler
from pwralign_kin.estimation import Estimate
from pwralign_kin.estimation.evidence.evidence import Evidence
from pwralign_kin.model import ArticulatedModel
from pwralign_kin.simulation import SimulatedScan
from pwralign_kin.state import State

pytest.importorskip("open3d", reason="ray casting needs Open3D and its system libraries", exc_type=ImportError)


@pytest.fixture(scope="module")
def made(twins: ArticulatedModel) -> SimulatedScan:
    return scenes.scene(twins, "twins", "second copy", 0)


def answered(state: State, labels: np.ndarray) -> Estimate:
    """Return an estimate of which nothing but its state, its labels and its confidence is told."""
    blank = dict.fromkeys(field.name for field in dataclasses.fields(Estimate))
    return Estimate(**{**blank, "state": state, "scan_labels": labels, "confidence": 0.7})  # type: ignore[arg-type]


@pytest.mark.parametrize("which", [0, 1])
def test_either_copy_is_right(which: int, made: SimulatedScan, ruler: Ruler, monkeypatch: pytest.MonkeyPatch) -> None:
    truths = [(made.state, made.labels), (made.copies[0].state, made.copies[0].labels)]
    state, labels = truths[which]
    called = np.where(np.arange(len(labels)) < np.flatnonzero(labels >= 0)[9], -1, labels)
    called[np.flatnonzero(labels < 0)[:90]] = 0
    monkeypatch.setattr(methods, "estimate", lambda *_: answered(state, called))

    found = scenes.outcome(ruler, "twins", "second copy", 0, made, 1)

    own = int((labels >= 0).sum())
    assert found.score.overlay and found.own == own and found.confidence == 0.7
    assert found.recall == pytest.approx((own - 9) / own)
    assert found.precision == pytest.approx((own - 9) / (own - 9 + 90))
    assert found.worst_part < 1e-6


def test_a_failure_counts_as_missed(made: SimulatedScan, ruler: Ruler, monkeypatch: pytest.MonkeyPatch) -> None:
    def failing(*_: object) -> Estimate:
        raise ValueError("no")

    monkeypatch.setattr(methods, "estimate", failing)
    missed = scenes.outcome(ruler, "twins", "second copy", 0, made, 1)
    assert not missed.score.overlay and missed.fault == "ValueError: no" and missed.recall == 0.0
    row = scenes.table([missed]).splitlines()[2]
    assert row.startswith("| second copy | 1 |") and "| 0% (0/1) |" in row and row.endswith("| 1 |")


def test_answers_to_rooms_are_cases_with_evidence(twins: ArticulatedModel) -> None:
    [outcome] = scenes.as_cases([("twins", twins)], ["contact"], 1, lambda _: None)
    assert (outcome.robot, outcome.tier, outcome.method) == ("twins", "contact", scenes.METHOD)
    assert set(Evidence.__dataclass_fields__) <= set(outcome.evidence)
    assert 0.5 < outcome.evidence["explained"] <= 1.0
