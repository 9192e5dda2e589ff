"""What the scan tells and what it does not: undetermined joints and the covariance of base and joints."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pwralign_kin.estimation.comparison.candidates import Candidates
from pwralign_kin.estimation.comparison.scan_comparison import ScanComparison
from pwralign_kin.estimation.refinement.matrices import inverse_of, normal_matrix
from pwralign_kin.estimation.refinement.problem import Problem
from pwralign_kin.estimation.sensing.patches import patches
from pwralign_kin.se3 import Array

PROBE_TURN = float(np.radians(5.0))
"""A joint is probed by this turn (rad) ..."""
PROBE_SLIDE = 0.03
"""... or this slide (model diagonals);"""
LEAST_DISPLACEMENT = 0.0018
"""it is determined when the surface of the observed parts then moves by this much (rms, model diagonals)."""
PLAIN_DISPLACEMENT = 0.0036
"""From here on it is without a closer look: normals of samples of a round surface make it less round than it is."""
WEAK_DISPLACEMENT = 0.0005
"""From here to there, it is if its other values are compared and none is as good: surfaces are rounder than they are
told to be."""
SYSTEMATIC_SHARE = 0.3
"""Share of the systematic residual (sensor bias, model error) that may pass for a motion of a joint."""
LEAST_POINTS = 8
"""Correspondences below which a part counts as unseen."""
LEAST_NOISE = 1e-3
"""Residuals below this (model diagonals) are not believed: model and sensor are never that exact."""
SAMPLING = 8e-4
"""Residual (model diagonals) that distances to samples of the surface, instead of to itself, leave of exact scans."""
POINTS_AS_ONE = 3.0
"""How many points are worth one whose error is independent: robust weights and neighbours that share their errors."""
MORE_THAN_FISHER = 2.0
"""Variance of errors against that which the Fisher information of noisy points promises: sensors do not see all surface
as evenly as is assumed."""
LEAST_CORRELATED = 2e-4
"""Least standard deviation of the error that all points of a part share (model diagonals). These two, and the next: by
joint errors of simulated and real scans, of which 90 to 99% are within two std, in every tier."""
POINTS_OF_PATCH, MOST_ABSORBED = 5, 0.7
"""Systematic errors are thought to be alike within a patch of so many points. Base and joints follow them where they
can, and take up as large a share of their variance as they are many against such patches; at most this."""


@dataclass(frozen=True)
class Errors:
    """How far scan points lie from a right answer, model diagonals."""

    noise: float
    """Standard deviation of the errors that are each point's own."""
    systematic: float
    """That of the errors that do not average out over points, as far as the answer leaves them: sensor bias and model
    error."""
    absorbed: float = 0.0
    """Share of their variance that the answer has taken up."""

    @property
    def correlated(self) -> float:
        """Standard deviation of the error that a whole part may have in common."""
        return float(np.hypot(self.systematic / np.sqrt(1.0 - self.absorbed), LEAST_CORRELATED))


def observed_errors(comparison: ScanComparison, final: Candidates, problem: Problem) -> Errors:
    """Return the errors that one final configuration leaves; `problem` is that of the configuration."""
    # Neighbouring points hide some of the noise where it folds thin parts.
    noise = max(comparison.observation.noise if problem.blur is None else problem.blur.noise, LEAST_NOISE)
    given, placements = comparison.observation.given, comparison.part_placements(final)
    off, owner = comparison.given_owners(final)
    part = np.where(off < comparison.reach, owner, -1)
    distance = comparison.distances(given, placements, comparison.exists, comparison.reach, loosely=True)[0]
    systematic = float(np.sqrt(max(comparison.residual_of(distance) ** 2 - noise**2 - SAMPLING**2, 0.0)))
    seen = problem.counts >= LEAST_POINTS
    unknowns = 6 + int((np.abs(problem.J[seen, :, 6:]) > 0.0).any(axis=(0, 1)).sum())
    counts = np.bincount(patches(given[part >= 0], part[part >= 0]))
    absorbed = unknowns / max(int((counts >= POINTS_OF_PATCH).sum()), 1)
    return Errors(noise, systematic, min(absorbed, MOST_ABSORBED))


def undetermined_joints(
    displacement: Array, locked: NDArray[np.bool_], errors: Errors, least: float = LEAST_DISPLACEMENT
) -> NDArray[np.bool_]:
    """Return which joints (k,) the scan does not tell, by the displacement of a probe motion (k,).

    It must stand out of the systematic residual, and be no less than the `least`.
    """
    return np.asarray(~locked & (displacement < least_visible(errors, least)))


def least_visible(errors: Errors, least: float = LEAST_DISPLACEMENT) -> float:
    """Return the displacement of what is seen (rms, model diagonals) that stands out of the systematic residual."""
    return max(least, SYSTEMATIC_SHARE * errors.systematic)


def probe_motions(
    problem: Problem, absent: NDArray[np.bool_], slide: NDArray[np.bool_], locked: NDArray[np.bool_]
) -> tuple[Array, Array]:
    """Return by how much base and joints (6 + k, k) move in the probe motion of each joint, and by how much (k,) that
    displaces what is seen; `absent` parts tell nothing.

    A joint is undetermined when everything else can compensate its motion: with each observed part's information
    scaled to mean squared displacement, the least displacement that the probe leaves is the Schur complement of its
    entry; the outline counts besides the surface, by its weight against it. Locked joints displace nothing.
    """
    seen, displacements = mean_information(problem, absent)
    mean_H = normal_matrix(problem.J[seen], displacements)
    # Moving a known base by its standard deviation is as unlikely as displacing surface that is seen.
    mean_H[:6, :6] += LEAST_DISPLACEMENT**2 * problem.prior.H[:6, :6]
    free = np.concatenate([np.ones(6, bool), ~locked])
    inverse = np.zeros_like(mean_H)
    inverse[np.ix_(free, free)] = inverse_of(mean_H[np.ix_(free, free)] + 1e-9 * np.eye(int(free.sum())))
    probe = np.where(slide, PROBE_SLIDE, PROBE_TURN)
    variance = np.maximum(np.diag(inverse)[6:], 1e-18)
    return inverse[:, 6:] / variance * probe, np.where(locked, 0.0, probe / np.sqrt(variance))


def inverse_covariance(problem: Problem, absent: NDArray[np.bool_], errors: Errors, span: Array) -> Array:
    """Return the inverse covariance (6 + k, 6 + k) of base twist and joints that one scan and the priors make.

    Points tell a part's displacement the better the more they are, but never better than the error they share:
    the part's information is that of one point of variance  noise^2 / points + correlated^2.  Joints are somewhere
    in their `span` (k,), with the variance of a uniform distribution, whatever the scan tells.
    """
    seen, displacements = mean_information(problem, absent)
    own = errors.noise**2 * POINTS_AS_ONE / problem.counts[seen]
    if problem.blur is None:
        information = displacements / own[:, None, None]
    else:
        # Points that may come from either side of a thin part tell less than their number.
        own = problem.blur.noise**2 * MORE_THAN_FISHER / problem.counts[seen]
        information = problem.blur.information[seen] / MORE_THAN_FISHER
    H = normal_matrix(problem.J[seen], information * (own / (own + errors.correlated**2))[:, None, None])
    H += problem.prior.H
    joints = np.arange(6, len(H))
    H[joints, joints] += 12.0 / np.maximum(span, 1e-9) ** 2
    return np.asarray(H)


def covariance(
    H: Array, locked: NDArray[np.bool_], undetermined: NDArray[np.bool_], besides: Array | float = 0.0
) -> Array:
    """Return the covariance of base twist and joints from its inverse `H`, and what there is `besides`; zero rows for
    joints without a value of their own: the doubt about undetermined ones is in the base's rows, if it is the base that
    they turn."""
    free = np.concatenate([np.ones(6, bool), ~locked])
    result = np.zeros_like(H)
    result[np.ix_(free, free)] = inverse_of(H[np.ix_(free, free)] + 1e-6 * np.eye(int(free.sum())))
    result += besides
    silent = 6 + np.flatnonzero(undetermined)
    result[silent] = result[:, silent] = 0.0
    return result


def mean_information(problem: Problem, absent: NDArray[np.bool_]) -> tuple[NDArray[np.int64], Array]:
    """Return the parts (m,) that the scan shows, and their information (m, 6, 6) as mean squared displacement."""
    seen = np.flatnonzero((problem.counts >= LEAST_POINTS) & ~absent)
    return seen, problem.information[seen] / np.maximum(problem.mass[seen], 1e-12)[:, None, None]
