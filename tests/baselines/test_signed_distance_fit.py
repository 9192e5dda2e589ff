"""The fit of distances: exact derivatives, a guess refined, an arm found from random starts."""

from __future__ import annotations

import numpy as np

from pwralign_kin import se3
from pwralign_kin.baselines.signed_distance_fit import SignedDistanceOptions, _Problem, signed_distance_fit
from pwralign_kin.benchmark.metrics import Ruler
from pwralign_kin.model import ArticulatedModel
from pwralign_kin.simulation import Sensor, simulate
from pwralign_kin.state import State

TRUTH = State(
    se3.from_quaternion(np.array([0.4, -1.2, 2.0]), np.array([0.3, -0.5, 0.2, 0.7])), {"shoulder": 0.5, "elbow": -0.8}
)


def test_jacobian_is_that_of_the_residuals(arm: ArticulatedModel) -> None:
    points = simulate(arm, TRUTH, Sensor(points=400, noise=0.0)).scan.points
    problem = _Problem(arm, points, SignedDistanceOptions())
    x = problem.from_state(TRUTH) + np.random.default_rng(0).normal(scale=0.01, size=8)
    J = problem.jacobian(x)
    step = 1e-6
    numeric = np.stack(
        [(problem.residuals(x + e) - problem.residuals(x - e)) / (2 * step) for e in step * np.eye(8)], axis=1
    )
    same_sample = np.abs(numeric - J).max(axis=1) < 1e-4  # a point may change its sample within the step
    assert same_sample.mean() > 0.97
    assert np.abs(J).max(axis=0).min() > 0.05


def test_a_guess_is_refined(arm: ArticulatedModel) -> None:
    points = np.array(simulate(arm, TRUTH, Sensor(points=3000)).scan.points)
    guess = State(
        TRUTH.T_scan_base @ se3.from_twist(np.array([0.1, -0.1, 0.05, 0.02, 0.02, -0.02])),
        {"shoulder": 0.35, "elbow": -0.6},
    )
    found = signed_distance_fit(arm, points, guess)
    for name, value in TRUTH.joints.items():
        assert abs(found.joints[name] - value) < 0.02
    np.testing.assert_allclose(found.T_scan_base, TRUTH.T_scan_base, atol=0.02)


def test_random_starts_find_the_arm(arm: ArticulatedModel) -> None:
    made = simulate(arm, TRUTH, Sensor(points=3000))
    ruler = Ruler(arm)
    found = signed_distance_fit(arm, np.array(made.scan.points), options=SignedDistanceOptions(points=300, starts=24))
    assert ruler.score(ruler.reference(made.state, made.labels), found).overlay
    assert all(arm.lower <= arm.values(found.joints)) and all(arm.values(found.joints) <= arm.upper)
