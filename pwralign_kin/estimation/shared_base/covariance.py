"""What the doubt about a shared base is for the estimate of each scan."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pwralign_kin.estimation.refinement.problem import Solution
from pwralign_kin.estimation.result import Estimate
from pwralign_kin.estimation.stages import SearchedScan
from pwralign_kin.se3 import Array


def with_base_covariance(
    estimate: Estimate, searched: SearchedScan, solution: Solution, base_covariance: Array
) -> Estimate:
    """Return the estimate with the doubt about the base, and what follows from it for the joints, in its covariance.

    With the base held, its doubt passes to the joints as they follow it: dq/dbase = -H_qq^-1 H_qb.
    """
    names, solver = list(estimate.state.joints), searched.solver
    unit = np.r_[np.ones(3), np.full(3, solver.comparison.observation.diagonal), solver.model.joint_scales]
    open_ = np.array([name not in estimate.undetermined for name in names], bool) & ~solver.locked
    H = solution.problem.H + solution.problem.prior.H / solution.problem.evidence
    follows = np.zeros((6 + len(names), 6))
    follows[:6] = np.eye(6)
    joints = 6 + np.flatnonzero(open_)
    follows[joints] = -np.linalg.solve(H[np.ix_(joints, joints)] + 1e-9 * np.eye(len(joints)), H[joints, :6])
    own = estimate.covariance.copy()
    own[:6] = own[:, :6] = 0.0
    covariance = own + (follows @ base_covariance @ follows.T) * np.outer(unit, unit)
    std = dict(estimate.std)
    for joint in np.flatnonzero(open_):
        std[names[joint]] = float(np.sqrt(covariance[6 + joint, 6 + joint]))
    return replace(estimate, covariance=covariance, std=std)
