"""Standard deviations: what the points of a part tell, what they cannot, and how far the truth is."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import pwralign_kin as pk
from pwralign_kin.estimation.comparison.candidates import Candidates
from pwralign_kin.estimation.comparison.scan_comparison import ScanComparison
from pwralign_kin.estimation.doubt.uncertainty import Errors, covariance, inverse_covariance, observed_errors
from pwralign_kin.estimation.refinement.joint_least_squares import JointLeastSquares, LeastSquaresOptions
from pwralign_kin.estimation.refinement.problem import Problem
from pwralign_kin.simulation import SimulatedScan

NONE = np.zeros(3, bool)


@pytest.fixture(scope="module")
def problem(
    arm: pk.ArticulatedModel, comparison: ScanComparison, full_scan: SimulatedScan, units: np.ndarray
) -> Problem:
    solver = JointLeastSquares(arm, comparison, arm.lower / units, arm.upper / units, LeastSquaresOptions())
    base = comparison.observation.to_search(arm.root_placement(full_scan.state))
    return solver.build(base, arm.values(full_scan.state.joints) / units, 0.005)


def deviations(problem: Problem, errors: Errors) -> np.ndarray:
    H = inverse_covariance(problem, np.zeros(4, bool), errors, np.full(3, 2.0))
    return np.sqrt(np.diag(covariance(H, NONE, NONE)))


def test_more_points_do_not_help_against_an_error_that_they_share(problem: Problem) -> None:
    many = dataclasses.replace(problem, counts=problem.counts * 100)
    noisy, biased = Errors(noise=0.01, systematic=0.0), Errors(noise=0.001, systematic=0.01)
    assert (deviations(many, noisy) < 0.6 * deviations(problem, noisy)).all()
    np.testing.assert_allclose(deviations(many, biased), deviations(problem, biased), rtol=0.02)


def test_the_samples_of_the_surface_are_no_bias_of_the_sensor(
    arm: pk.ArticulatedModel, comparison: ScanComparison, full_scan: SimulatedScan, problem: Problem, units: np.ndarray
) -> None:
    base = comparison.observation.to_search(arm.root_placement(full_scan.state))
    right = Candidates.single(base, arm.values(full_scan.state.joints) / units)
    assert observed_errors(comparison, right, problem).systematic < 0.0005


def test_many_unknowns_take_up_much_of_a_bias(
    arm: pk.ArticulatedModel, comparison: ScanComparison, full_scan: SimulatedScan, problem: Problem, units: np.ndarray
) -> None:
    base = comparison.observation.to_search(arm.root_placement(full_scan.state))
    right = Candidates.single(base, arm.values(full_scan.state.joints) / units)
    whole = observed_errors(comparison, right, problem)
    assert 9 / 60 < whole.absorbed < 9 / 20  # six of the base, three joints
    base_alone = dataclasses.replace(problem, counts=np.array([500, 0, 0, 0], np.int32))
    assert observed_errors(comparison, right, base_alone).absorbed == pytest.approx(whole.absorbed * 6 / 9)
    # What is left is the less, the more of it was taken up.
    left = [Errors(0.001, 0.01 * np.sqrt(1.0 - absorbed), absorbed).correlated for absorbed in (0.0, 0.2, 0.6)]
    assert left == pytest.approx([left[0]] * 3)


def test_bias_makes_base_and_joints_uncertain_alike(problem: Problem) -> None:
    exact, biased = (deviations(problem, Errors(0.001, systematic)) for systematic in (0.0, 0.01))
    growth = biased / exact
    assert growth.min() > 5
    assert growth.max() < 3 * growth.min()


def test_the_doubt_about_an_undetermined_joint_is_in_the_bases_rows(problem: Problem) -> None:
    # Of the upper arm alone nobody can say how the base stands about the shoulder's axis.
    upper_alone = dataclasses.replace(problem, counts=np.array([0, 500, 0, 0], np.int32))
    shoulder = np.array([True, False, False])
    H = inverse_covariance(upper_alone, np.zeros(4, bool), Errors(0.001, 0.0), np.full(3, 2.0))
    free, held = covariance(H, NONE, shoulder), covariance(H, shoulder, NONE)
    assert (free[6] == 0.0).all()
    assert np.trace(free[:3, :3]) == pytest.approx(4.0 / 12.0, rel=0.05)
    assert np.trace(held[:3, :3]) < 1e-4


def test_the_truth_is_within_the_standard_deviations(arm: pk.ArticulatedModel) -> None:
    within = []
    for seed in (1, 2, 3, 4):
        made = pk.simulate(arm, sensor=pk.simulation.Sensor(points=1500, noise=0.006), seed=seed)
        estimate = pk.estimate(arm, made.scan, initial=made.state)
        told = set(made.state.joints) - set(estimate.undetermined)
        within += [abs(estimate.state.joints[name] - made.state.joints[name]) < 2 * estimate.std[name] for name in told]
        offset = estimate.state.T_scan_base[:3, 3] - made.state.T_scan_base[:3, 3]
        within += (np.abs(offset) < 2 * np.sqrt(np.diag(estimate.covariance)[3:6])).tolist()
    assert np.mean(within) > 0.8
    assert max(estimate.std[name] for name in set(arm.joint_names) - set(estimate.undetermined)) < np.radians(2.0)
