"""What the scan tells and what it does not: undetermined joints and the covariance of base and joints."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pwralign_kin.estimation.joint_least_squares import Problem
from pwralign_kin.se3 import Array

PROBE_TURN = float(np.radians(5.0))
"""A joint is probed by this turn (rad) ..."""
PROBE_SLIDE = 0.03
"""... or this slide (model diagonals);"""
LEAST_DISPLACEMENT = 0.0018
"""it is determined when the surface of the observed parts then moves by this much (rms, model diagonals)."""
SYSTEMATIC_SHARE = 0.6
"""Share of the systematic residual (sensor bias, model error) that may pass for a motion of a joint."""
LEAST_POINTS = 8
"""Correspondences below which a part counts as unseen."""


@dataclass(frozen=True)
class Doubt:
    """Uncertainty in search units."""

    undetermined: NDArray[np.bool_]
    """(k,) joints that the scan does not tell."""
    displacement: Array
    """(k,) rms displacement of observed surface that a probe motion of each joint leaves, model diagonals."""
    covariance: Array
    """(6 + k, 6 + k) of base twist and joints; zero rows where undetermined."""


def doubt(
    problem: Problem,
    absent: NDArray[np.bool_],
    slide: NDArray[np.bool_],
    locked: NDArray[np.bool_],
    noise: float,
    systematic: float,
) -> Doubt:
    """Return which joints are undetermined, and the covariance of the rest; `absent` parts tell nothing.

    A joint is undetermined when everything else can compensate a probe motion of it: with each observed part's
    information scaled to mean squared displacement, the least displacement that the probe leaves is the Schur
    complement of its entry; the outline counts besides the surface, by its weight against it. It must stand out of
    the `systematic` residual, which does not average out over points. The covariance is that of Gauss-Newton with
    residuals of standard deviation `noise`, plus the systematic share of every joint (both in model diagonals).
    """
    size = problem.H.shape[0]
    seen = (problem.counts >= LEAST_POINTS) & ~absent
    weights = np.zeros(len(seen))
    weights[seen] = 1.0 / np.maximum(problem.mass[seen], 1e-12)
    mean_H = np.einsum("p,pia,pij,pjb->ab", weights, problem.J, problem.information, problem.J)
    # Moving a known base by its standard deviation is as unlikely as displacing surface that is seen.
    mean_H[:6, :6] += LEAST_DISPLACEMENT**2 * problem.prior.H[:6, :6]
    free = np.concatenate([np.ones(6, bool), ~locked])
    ridge = 1e-9 * np.eye(int(free.sum()))
    inverse = np.linalg.inv(mean_H[np.ix_(free, free)] + ridge)
    probe = np.where(slide, PROBE_SLIDE, PROBE_TURN)
    displacement = np.zeros(size - 6)
    displacement[~locked] = probe[~locked] / np.sqrt(np.maximum(np.diag(inverse)[6:], 1e-18))
    hidden = SYSTEMATIC_SHARE * systematic
    undetermined = ~locked & (displacement < max(LEAST_DISPLACEMENT, hidden))
    fixed = undetermined | locked
    covariance = _covariance(problem, fixed, noise)
    joints = np.flatnonzero(~fixed)
    covariance[6 + joints, 6 + joints] += (probe * hidden / np.maximum(displacement, 1e-12))[joints] ** 2
    return Doubt(undetermined, displacement, covariance)


def _covariance(problem: Problem, fixed: NDArray[np.bool_], noise: float) -> Array:
    size = problem.H.shape[0]
    free = np.concatenate([np.ones(6, bool), ~fixed])
    count = max(int(problem.counts.sum()), 1)
    H = (problem.H * count / noise**2 + problem.prior.H)[np.ix_(free, free)]
    covariance = np.zeros((size, size))
    covariance[np.ix_(free, free)] = np.linalg.inv(H + 1e-6 * np.eye(len(H)))
    return covariance
