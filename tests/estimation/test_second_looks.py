"""Which answer is kept where a scan is looked at again."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any
from unittest import mock

import numpy as np
import pytest

import pwralign_kin as pk
from pwralign_kin.estimation import second_looks
from pwralign_kin.estimation.estimator import Estimator
from pwralign_kin.simulation import SimulatedScan


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
    monkeypatch.setattr(estimator, "fit", mock.Mock())
    monkeypatch.setattr(estimator, "finished", lambda fit: second)
    searched = mock.Mock(scan=scan)
    searched.solver.search.observation.scene = False
    answer = second_looks._beside_surroundings(estimator, searched, first)
    assert answer is (second if taken else first)
    assert estimator.fit.call_args.args[4].all()  # what the first answer left unexplained
