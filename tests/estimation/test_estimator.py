"""What the estimator judges an answer by."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any
from unittest import mock

import numpy as np
import pytest

import pwralign_kin as pk
from pwralign_kin.estimation import estimator as pipeline
from pwralign_kin.estimation.estimator import Estimator, bearing_out
from pwralign_kin.simulation import SimulatedScan


def test_an_answer_that_outlines_mend_is_borne_out_where_the_points_lie_on_it(
    arm: pk.ArticulatedModel, single_scan: SimulatedScan
) -> None:
    fit = Estimator(arm, pk.EstimatorOptions()).fit(single_scan.scan, None, None)
    start = fit.finished.take([0])
    solution = fit.solver.run(start.bases[0], start.values[0])
    bent = replace(solution, base=solution.base.copy())
    bent.base[:3, 3] += 0.03 / np.sqrt(3)
    far = replace(solution, base=solution.base.copy())
    far.base[:3, 3] += 0.2

    fit.solver.silhouette = None
    assert np.array_equal(bearing_out(fit, bent).bases[0], bent.base)
    fit.solver.silhouette = mock.Mock()
    assert np.array_equal(bearing_out(fit, bent).bases[0], start.bases[0])
    assert np.array_equal(bearing_out(fit, far).bases[0], far.base)


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
    monkeypatch.setattr(pipeline, "soundness", lambda evidence: evidence.sound)
    monkeypatch.setattr(pipeline, "was_prepared", lambda observation, points, options: np.ones(len(points), bool))
    monkeypatch.setattr(pipeline, "surroundings_of", lambda near, left, *rest: left)
    monkeypatch.setattr(estimator, "fit", mock.Mock())
    monkeypatch.setattr(estimator, "_finished", lambda fit, initial: second)
    searched = mock.Mock(scan=scan)
    searched.solver.search.observation.scene = False
    answer = estimator._beside_surroundings(searched, first, None, None)
    assert answer is (second if taken else first)
    assert estimator.fit.call_args.args[4].all()  # what the first answer left unexplained
