"""What the estimator judges an answer by."""

from __future__ import annotations

from dataclasses import replace
from unittest import mock

import numpy as np

import pwralign_kin as pk
from pwralign_kin.estimation.estimator import Estimator, bearing_out
from pwralign_kin.simulation import SimulatedScan


def test_an_answer_that_outlines_mend_is_borne_out_where_the_points_lie_on_it(
    arm: pk.ArticulatedModel, single_scan: SimulatedScan
) -> None:
    searched = Estimator(arm, pk.EstimatorOptions()).searched(single_scan.scan, None, None)
    start = searched.finished.take([0])
    solution = searched.solver.run(start.bases[0], start.values[0])
    bent = replace(solution, base=solution.base.copy())
    bent.base[:3, 3] += 0.03 / np.sqrt(3)
    far = replace(solution, base=solution.base.copy())
    far.base[:3, 3] += 0.2

    searched.solver.silhouette = None
    assert np.array_equal(bearing_out(searched, bent).bases[0], bent.base)
    searched.solver.silhouette = mock.Mock()
    assert np.array_equal(bearing_out(searched, bent).bases[0], start.bases[0])
    assert np.array_equal(bearing_out(searched, far).bases[0], far.base)
