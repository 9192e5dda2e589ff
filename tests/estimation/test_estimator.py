"""What the estimator judges an answer by."""

from __future__ import annotations

from dataclasses import replace
from unittest import mock

import numpy as np

import pwralign_kin as pk
from pwralign_kin.estimation.estimator import Estimator, bearing_out
from pwralign_kin.estimation.refinement.view import NOT_LOOKED_AT, View
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

    assert np.array_equal(bearing_out(searched.seeing(NOT_LOOKED_AT), bent).bases[0], bent.base)
    outlined = searched.seeing(View(silhouette=mock.Mock()))
    assert np.array_equal(bearing_out(outlined, bent).bases[0], start.bases[0])
    assert np.array_equal(bearing_out(outlined, far).bases[0], far.base)


def test_what_one_answer_shows_of_a_view_is_not_kept_for_the_next(
    arm: pk.ArticulatedModel, single_scan: SimulatedScan
) -> None:
    origin = np.asarray(single_scan.scan.sensor_origin)
    rays = single_scan.scan.points - origin
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    # Errors that neighbours share, and noise therefore does not explain.
    ripples = 0.015 * arm.diagonal * np.sin(20.0 / arm.diagonal * single_scan.scan.points[:, :1])
    scan = pk.Scan(single_scan.scan.points + ripples * rays, sensor_origin=origin)
    searched = Estimator(arm, pk.EstimatorOptions()).searched(scan, None, None)
    start = searched.finished.take([0])

    solution = searched.solver.run(start.bases[0], start.values[0])
    aside = searched.solver.run(start.bases[0], start.values[0] + 0.05)

    assert solution.view.silhouette is not None
    assert aside.view.silhouette is not solution.view.silhouette
    assert searched.solver.view is NOT_LOOKED_AT
    assert searched.seeing(solution.view).solver.run(solution.base, solution.values).view is solution.view
