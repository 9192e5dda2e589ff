"""Noisy scans fitted to all surface near their points: the kernel, and what it gains where parts are thin."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import pwralign_kin as pk
from pwralign_kin import kernels, se3
from pwralign_kin.directions import fibonacci_directions
from pwralign_kin.estimation.comparison.scan_comparison import ScanComparison
from pwralign_kin.estimation.estimator import Estimator
from pwralign_kin.estimation.refinement.joint_least_squares import JointLeastSquares, LeastSquaresOptions
from pwralign_kin.estimation.refinement.surface_mixture import solved
from pwralign_kin.simulation import Sensor, SimulatedScan

SIGMA, STRAYS, VOLUME = 0.02, 0.05, 0.5

SHEETS = """<robot name="sheets">
  <link name="foot"><visual><geometry><box size="0.3 0.2 0.004"/></geometry></visual></link>
  <link name="blade"><visual><origin xyz="0.15 0 0"/><geometry><box size="0.3 0.12 0.004"/></geometry></visual></link>
  <link name="tip">
    <visual><origin xyz="0.1 0.02 0"/><geometry><box size="0.2 0.08 0.003"/></geometry></visual>
  </link>
  <joint name="lift" type="revolute">
    <parent link="foot"/><child link="blade"/><origin xyz="0.15 0 0.05"/><axis xyz="0 1 0"/>
    <limit lower="-2" upper="0" effort="1" velocity="1"/>
  </joint>
  <joint name="bend" type="revolute">
    <parent link="blade"/><child link="tip"/><origin xyz="0.31 0 0"/><axis xyz="0 1 0"/>
    <limit lower="-2" upper="2" effort="1" velocity="1"/>
  </joint>
</robot>
"""


@pytest.fixture(scope="module")
def solver(arm: pk.ArticulatedModel, comparison: ScanComparison, units: np.ndarray) -> JointLeastSquares:
    return JointLeastSquares(arm, comparison, arm.lower / units, arm.upper / units, LeastSquaresOptions())


@pytest.fixture(scope="module")
def truth(
    arm: pk.ArticulatedModel, comparison: ScanComparison, full_scan: SimulatedScan, units: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    base = comparison.observation.to_search(arm.root_placement(full_scan.state))
    return base, arm.values(full_scan.state.joints) / units


def evidence(
    solver: JointLeastSquares,
    mixture: kernels.SurfaceMixture,
    points: np.ndarray,
    base: np.ndarray,
    values: np.ndarray,
    sigma: float = SIGMA,
    threads: int = 1,
) -> tuple[float, np.ndarray, np.ndarray, np.ndarray, float]:
    placements, J = (np.ascontiguousarray(array) for array in solver.part_twists(base, values))
    return mixture.evidence(points, placements, J, sigma, STRAYS, VOLUME, threads)


def test_the_density_of_points_sums_to_one(
    arm: pk.ArticulatedModel, solver: JointLeastSquares, truth: tuple[np.ndarray, np.ndarray]
) -> None:
    wide, high, steps = 0.12, 1.1, 16
    mixture = kernels.SurfaceMixture(arm.kernel_model, wide)
    mixture.look(np.ascontiguousarray(solver.part_twists(*truth)[0]), fibonacci_directions(12).astype(np.float32), 0.1)
    axis = high * ((2 * np.arange(steps) + 1) / steps - 1)
    places = np.stack(np.meshgrid(axis, axis, axis), axis=-1).reshape(-1, 1, 3).astype(np.float32)
    # Density is that of strays alone over the share of strays that a single point has.
    strays = STRAYS / VOLUME
    densities = [strays / evidence(solver, mixture, place, *truth, sigma=wide)[4] for place in places]
    whole = (2 * high) ** 3
    assert np.mean(densities) * whole == pytest.approx(strays * whole + 1 - STRAYS, rel=0.01)


def test_scores_are_the_derivatives_of_the_likelihood(
    arm: pk.ArticulatedModel, solver: JointLeastSquares, truth: tuple[np.ndarray, np.ndarray]
) -> None:
    base, values = truth
    mixture = kernels.SurfaceMixture(arm.kernel_model, SIGMA)
    points = np.ascontiguousarray(solver.comparison.observation.given[::20])
    g = evidence(solver, mixture, points, base, values)[1]
    h = 1e-3
    for parameter in range(len(g)):
        likelihoods = []
        for sign in (1, -1):
            step = np.zeros(len(g))
            step[parameter] = sign * h
            there = base.copy()
            there[:3, :3] = se3.from_twist(step[:6])[:3, :3] @ base[:3, :3]
            there[:3, 3] += step[3:6]
            likelihoods.append(
                evidence(solver, mixture, points, there, values + step[6:-1], SIGMA * np.exp(step[-1]))[0]
            )
        assert g[parameter] == pytest.approx(
            (likelihoods[0] - likelihoods[1]) / (2 * h), rel=0.05, abs=0.05 * len(points)
        )


def test_evidence_is_the_same_at_any_number_of_threads(
    arm: pk.ArticulatedModel, solver: JointLeastSquares, truth: tuple[np.ndarray, np.ndarray]
) -> None:
    mixture = kernels.SurfaceMixture(arm.kernel_model, SIGMA)
    points = solver.comparison.observation.given
    one, three = (evidence(solver, mixture, points, *truth, threads=threads) for threads in (1, 3))
    for first, second in zip(one, three, strict=True):
        np.testing.assert_array_equal(first, second)


def test_surface_that_nothing_sees_weighs_little(
    arm: pk.ArticulatedModel, solver: JointLeastSquares, truth: tuple[np.ndarray, np.ndarray]
) -> None:
    base, values = truth
    placements = np.ascontiguousarray(solver.part_twists(base, values)[0])
    surface = arm.surfaces[0]
    up = surface.dense_normals[:, 2] > 0.9
    points = [
        np.ascontiguousarray(se3.transform(placements[0], surface.dense[rows].astype(float)), np.float32)
        for rows in (up, surface.dense_normals[:, 2] < -0.9)
    ]
    mixture = kernels.SurfaceMixture(arm.kernel_model, 0.01)
    above = np.ascontiguousarray(placements[0, None, :3, 2], np.float32)
    mixture.look(placements, above, 0.01)
    strays = [evidence(solver, mixture, own, base, values, 0.003)[4] / len(own) for own in points]
    assert strays[0] < 0.2 * strays[1]


@pytest.fixture(scope="module")
def sheets(tmp_path_factory: pytest.TempPathFactory) -> pk.ArticulatedModel:
    path: Path = tmp_path_factory.mktemp("sheets") / "sheets.urdf"
    path.write_text(SHEETS)
    return pk.ArticulatedModel.from_urdf(path)


def test_noisy_scans_of_thin_parts_are_told_better_and_by_how_much(sheets: pk.ArticulatedModel) -> None:
    noise = 0.012
    nearest = pk.EstimatorOptions(least_squares=LeastSquaresOptions(noisy=np.inf))
    errors: dict[str, list[float]] = {"mixture": [], "nearest": []}
    within = []
    for seed in range(4):
        made = pk.simulate(sheets, sensor=Sensor(points=1200, noise=noise, stray=0.03), seed=seed)
        for name, options in (("mixture", pk.EstimatorOptions()), ("nearest", nearest)):
            estimate = pk.estimate(sheets, made.scan, initial=made.state, options=options)
            off = {joint: abs(estimate.state.joints[joint] - made.state.joints[joint]) for joint in sheets.joint_names}
            errors[name] += off.values()
            if name == "mixture":
                within += [off[joint] < 2 * estimate.std[joint] for joint in off]
    assert np.sqrt(np.mean(np.square(errors["mixture"]))) < 0.8 * np.sqrt(np.mean(np.square(errors["nearest"])))
    assert np.mean(within) >= 0.8


def test_the_noise_of_a_scan_is_told_where_it_hides_the_surface(sheets: pk.ArticulatedModel) -> None:
    made = pk.simulate(sheets, sensor=Sensor(points=1500, noise=0.015), seed=1)
    searched = Estimator(sheets, pk.EstimatorOptions()).searched(made.scan, made.state, None)
    solution = solved(searched.solver, searched.finished.bases[0], searched.finished.values[0])
    assert solution.problem.blur is not None
    assert solution.problem.blur.noise == pytest.approx(0.015, rel=0.06)


def test_one_view_and_little_noise_are_left_to_the_nearest_surface(arm: pk.ArticulatedModel) -> None:
    for sensor, noisy in (
        (Sensor(points=2000, noise=0.01), True),
        (Sensor(points=2000, noise=0.001), False),
        (Sensor(views=1, points=2000, noise=0.01, known_origin=True), False),
    ):
        made = pk.simulate(arm, sensor=sensor, seed=1)
        searched = Estimator(arm, pk.EstimatorOptions()).searched(made.scan, made.state, None)
        solution = solved(searched.solver, searched.finished.bases[0], searched.finished.values[0])
        assert (solution.problem.blur is not None) == noisy
