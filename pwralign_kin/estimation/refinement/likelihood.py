"""Which of several answers that look alike the scan speaks for: their likelihoods on the model's own triangles.

Answers made from a model's symmetry differ by details that are far smaller than the noise (the bolts of one side, a
chamfer), which samples of its surface do not resolve but thousands of points together tell. Each answer is fitted once
more, to the exact closest points of the triangles, before it is judged. The noise of a point is normal, or anything.
"""

from __future__ import annotations

import numpy as np

from pwralign_kin import kernels
from pwralign_kin.arrays import Singles
from pwralign_kin.estimation.comparison.candidates import Candidates
from pwralign_kin.estimation.refinement.bounded_step import bounded_step
from pwralign_kin.estimation.refinement.joint_least_squares import JointLeastSquares
from pwralign_kin.estimation.refinement.matrices import normal_matrix
from pwralign_kin.se3 import Array

MOST_POINTS, FEW_POINTS = 5000, 800
"""Scan points that are looked at, and on the way to the maximum."""
REACH = 0.03
"""Points farther from the model (model diagonals) are of other things."""
LEAST_NOISE = 0.0003
"""Least standard deviation of the points (model diagonals): what single precision and bent surfaces leave."""
ANYTHING = 0.02
"""Density of the points that are not on the model, against that of the normal noise at its peak."""
STEPS, LITTLE = 6, 0.5
"""Steps of Gauss-Newton by few points towards the exact closest ones, at most: one that gains no more than this
logarithm of the likelihood is the last. What one more step by all points would gain is taken from its linear model."""
REST = 1.5
"""Standard deviation of joint values about their prior (rad or model diagonals), for want of a closer one, ..."""
TOLD = 3.0
"""... which chooses among answers whose logarithms of the likelihood differ by less."""


def likeliest(solver: JointLeastSquares, several: Candidates, prior: Array) -> int:
    """Return which of several answers is the most likely, by the scan and by the joint values (k,) of the `prior`."""
    likelihoods = log_likelihoods(solver, several)
    away = several.values - prior
    turns = np.where(solver.model.continuous, 2.0 * np.pi * np.round(away / (2.0 * np.pi)), 0.0)
    usual = likelihoods - np.square((away - turns) / REST).sum(axis=1) / 2.0
    return int(np.argmax(np.where(likelihoods > likelihoods.max() - TOLD, usual, -np.inf)))


def log_likelihoods(solver: JointLeastSquares, several: Candidates) -> Array:
    """Return (m,) the logarithms, up to a common constant, each at the maximum near to the answer; all 0 where
    no points are near the first of them."""
    points = _points_near(solver, several.take([0]))
    if len(points) == 0:
        return np.zeros(len(several))
    few = np.ascontiguousarray(points[:: max(1, len(points) // FEW_POINTS)])
    first = _Look(solver, few, several.bases[0], several.values[0])
    noise = max(LEAST_NOISE, 1.4826 * float(np.median(first.distance)))
    settled = [_settled(solver, few, *answer, noise) for answer in zip(several.bases, several.values, strict=True)]
    return np.array([_log_likelihood(solver, _Look(solver, points, *answer), noise) for answer in settled])


def _settled(
    solver: JointLeastSquares, points: Singles, base: Array, values: Array, noise: float
) -> tuple[Array, Array]:
    """Return the configuration near to one that these points make the most likely."""
    for _ in range(STEPS):
        step, _, gain = _Look(solver, points, base, values).step(solver, noise)
        if gain < LITTLE:
            break
        base, values = solver.stepped(base, values, step)
    return base, values


def _log_likelihood(solver: JointLeastSquares, look: _Look, noise: float) -> float:
    """Return the logarithm of the likelihood at its maximum near to what is looked at."""
    _, likelihood, gain = look.step(solver, noise)
    prior = solver.prior(look.base, look.values)
    against = float(prior.g @ np.linalg.lstsq(prior.H, prior.g)[0]) / 2
    return likelihood + gain - against


class _Look:
    """One configuration held against points."""

    def __init__(self, solver: JointLeastSquares, points: Singles, base: Array, values: Array) -> None:
        self.base, self.values = base, values
        placements, self.twists = solver.part_twists(base, values)
        closest, self.part = kernels.closest_on_meshes(
            solver.model.kernel_meshes, placements, points, REACH, solver.comparison.threads
        )
        off = points.astype(float) - closest
        self.distance = np.where(self.part >= 0, np.linalg.norm(off, axis=1), REACH)
        away = off / np.maximum(self.distance, 1e-9)[:, None]
        self.rows = np.concatenate([np.cross(closest - base[:3, 3], away), away], axis=1)

    def step(self, solver: JointLeastSquares, noise: float) -> tuple[Array, float, float]:
        """Return the step (6 + k,) to the maximum, the logarithm of the likelihood here, and what the step gains."""
        normal = np.exp(-0.5 * (self.distance / noise) ** 2)
        weight = normal / (normal + ANYTHING)
        information = np.zeros((len(self.twists), 6, 6))
        gradients = np.zeros((len(self.twists), 6))
        for part in np.flatnonzero(np.bincount(self.part[self.part >= 0])):
            own = self.part == part
            weighted = self.rows[own] * weight[own, None]
            information[part] = weighted.T @ self.rows[own]
            gradients[part] = weighted.T @ self.distance[own]
        H, g = normal_matrix(self.twists, information), np.einsum("pia,pi->a", self.twists, gradients)
        try:
            step = bounded_step(H, g, *solver.step_bounds(self.values), solver.options.damping)
        except np.linalg.LinAlgError:  # the answer stays where it is
            step = np.zeros(len(g))
        gain = float(g @ step - step @ H @ step / 2) / noise**2
        return step, float(np.log(normal + ANYTHING).sum()), gain


def _points_near(solver: JointLeastSquares, answer: Candidates) -> Singles:
    """Return scan points (n, 3) near to an answer, as given by the sensor."""
    comparison = solver.comparison
    raw = comparison.observation.raw
    distance = comparison.assigned(raw, comparison.part_placements(answer)[0], comparison.exists, REACH)[0]
    near = raw[distance < REACH]
    chosen = np.linspace(0, len(near) - 1, min(len(near), MOST_POINTS)).astype(int)
    points = np.ascontiguousarray(near[chosen])
    # What is closest to a point is soon found from what is closest to the point before.
    return np.ascontiguousarray(points[kernels.along_curve(points)]) if len(points) else points
