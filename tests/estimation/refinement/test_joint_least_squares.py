"""The joint least squares: its derivatives, its bounds, and what it converges to."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import pwralign_kin as pk
from pwralign_kin import se3
from pwralign_kin.estimation.comparison.candidates import Candidates
from pwralign_kin.estimation.comparison.scan_comparison import ScanComparison, Sought
from pwralign_kin.estimation.comparison.search_options import SearchOptions
from pwralign_kin.estimation.knowledge.prior import SearchPrior
from pwralign_kin.estimation.refinement.joint_least_squares import JointLeastSquares, LeastSquaresOptions
from pwralign_kin.estimation.sensing.observation import ObservationOptions
from pwralign_kin.estimation.sensing.preparation import observe
from pwralign_kin.simulation import TIERS, SimulatedScan

SIGMA = 0.005


def units(model: pk.ArticulatedModel) -> np.ndarray:
    return np.array([model.diagonal if model.units[name] == "m" else 1.0 for name in model.joint_names])


def solver(model: pk.ArticulatedModel, comparison: ScanComparison, **options: object) -> JointLeastSquares:
    unit = units(model)
    settings = LeastSquaresOptions(**options)  # type: ignore[arg-type]
    return JointLeastSquares(model, comparison, model.lower / unit, model.upper / unit, settings)


def truth(model: pk.ArticulatedModel, comparison: ScanComparison, scan: SimulatedScan) -> tuple[np.ndarray, np.ndarray]:
    return comparison.observation.to_search(scan.state.T_scan_base), model.values(scan.state.joints) / units(model)


def test_kernel_kinematics_agree_with_pinocchio(arm: pk.ArticulatedModel, comparison: ScanComparison) -> None:
    rng = np.random.default_rng(0)
    for _ in range(20):
        values = rng.uniform(arm.lower, arm.upper)
        placed = comparison.part_placements(
            Candidates(np.eye(4)[None], (values / units(arm))[None], np.zeros(1, np.float32))
        )
        expected = arm.part_placements(values)
        expected[:, :3, 3] /= arm.diagonal
        np.testing.assert_allclose(placed[0], expected, atol=1e-12)


def test_jacobian_against_finite_differences(
    arm: pk.ArticulatedModel, comparison: ScanComparison, full_scan: SimulatedScan
) -> None:
    base, values = truth(arm, comparison, full_scan)
    problem = solver(arm, comparison).build(base, values, SIGMA)
    h, none = 1e-6, np.zeros(1, np.float32)

    def placed(step: np.ndarray) -> np.ndarray:
        move = se3.from_twist(step[:6])
        moved = base.copy()
        moved[:3, :3] = move[:3, :3] @ base[:3, :3]
        moved[:3, 3] += move[:3, 3]
        return comparison.part_placements(Candidates(moved[None], (values + step[6:])[None], none))[0]

    for column in range(problem.J.shape[2]):
        step = np.zeros(problem.J.shape[2])
        step[column] = h
        ahead, behind = placed(step), placed(-step)
        for part in range(len(arm.parts)):
            turn = (ahead[part, :3, :3] - behind[part, :3, :3]) / (2 * h) @ placed(0 * step)[part, :3, :3].T
            angular = np.array([turn[2, 1], turn[0, 2], turn[1, 0]])
            arm_to_part = placed(0 * step)[part, :3, 3] - base[:3, 3]
            linear = (ahead[part, :3, 3] - behind[part, :3, 3]) / (2 * h) - np.cross(angular, arm_to_part)
            np.testing.assert_allclose(problem.J[part, :3, column], angular, atol=1e-7)
            np.testing.assert_allclose(problem.J[part, 3:, column], linear, atol=1e-7)


def test_normal_matrix_is_symmetric_and_positive(
    arm: pk.ArticulatedModel, comparison: ScanComparison, full_scan: SimulatedScan
) -> None:
    problem = solver(arm, comparison).build(*truth(arm, comparison, full_scan), SIGMA)
    np.testing.assert_allclose(problem.H, problem.H.T, atol=1e-12)
    assert np.linalg.eigvalsh(problem.H).min() > 0


def test_converges_to_the_truth_from_nearby(
    arm: pk.ArticulatedModel, comparison: ScanComparison, full_scan: SimulatedScan
) -> None:
    base, values = truth(arm, comparison, full_scan)
    moved = base.copy()
    moved[:3, 3] += 0.004
    result = solver(arm, comparison).run(moved, values + 0.02)
    assert result.converged
    np.testing.assert_allclose(result.values, values, atol=0.008)
    np.testing.assert_allclose(result.base[:3, 3], base[:3, 3], atol=0.003)


def test_steps_respect_bounds_that_bind(
    arm: pk.ArticulatedModel, comparison: ScanComparison, full_scan: SimulatedScan
) -> None:
    base, values = truth(arm, comparison, full_scan)
    unit = units(arm)
    upper = arm.upper / unit
    upper[1] = values[1] - 0.05  # the truth is out of reach
    bounded = JointLeastSquares(arm, comparison, arm.lower / unit, upper, LeastSquaresOptions())
    start = np.minimum(values, upper)
    problem = bounded.build(base, start, SIGMA)
    assert (start + bounded.solve(problem, *bounded.step_bounds(start))[6:] <= upper + 1e-9).all()
    result = bounded.run(base, start)
    assert result.values[1] == pytest.approx(upper[1], abs=1e-6)


def test_the_robust_scale_follows_noise_and_residuals(
    arm: pk.ArticulatedModel, comparison: ScanComparison, full_scan: SimulatedScan
) -> None:
    base, values = truth(arm, comparison, full_scan)
    usual = solver(arm, comparison)
    right = usual.residual(base, values)
    off = base.copy()
    off[:3, 3] += 0.01
    assert usual.robust_scale(right) < 0.008
    assert usual.robust_scale(usual.residual(off, values)) > usual.robust_scale(right)
    assert solver(arm, comparison, sigmas=20.0).robust_scale(right) > 0.02


def test_a_locked_joint_does_not_move(
    arm: pk.ArticulatedModel, comparison: ScanComparison, full_scan: SimulatedScan
) -> None:
    base, values = truth(arm, comparison, full_scan)
    start = values + np.array([0.03, 0.0, 0.0])
    locked = solver(arm, comparison).with_locked(np.array([True, False, False]), start)
    assert locked.locked.tolist() == [True, False, False]
    assert locked.run(base, start).values[0] == pytest.approx(start[0], abs=1e-12)


def test_noise_along_the_rays_does_not_pull_the_model_to_its_sensor(arm: pk.ArticulatedModel) -> None:
    pulled = []
    for seed in range(4):
        sensor = replace(TIERS["single"], noise=0.012, points=4000)
        scan = pk.simulate(arm, sensor=sensor, seed=seed)
        observation = observe(scan.scan, arm.diagonal, ObservationOptions(), 1)
        comparison = ScanComparison(
            Sought(arm.kernel_model, arm.surfaces, SearchOptions(), 1),
            observation,
            SearchPrior.nothing(arm.values({}) / units(arm)),
        )
        base, values = truth(arm, comparison, scan)
        result = solver(arm, comparison).run(base, values)
        assert observation.sensor_origin is not None
        placed = comparison.probe_positions(
            Candidates(np.stack([base, result.base]), np.stack([values, result.values]), np.zeros(2, np.float32))
        )
        rays = placed[0] - observation.sensor_origin
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        pulled.append(float(((placed[1] - placed[0]) * rays).sum(axis=1).mean()))
    assert abs(np.mean(pulled)) < 0.0007
