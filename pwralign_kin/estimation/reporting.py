"""The estimate as its user gets it: from the search's units to those of the scan and the URDF."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pwralign_kin.estimation.answers.answer_search import FINE_SIGMA, FINE_SUPPORT
from pwralign_kin.estimation.comparison.candidates import Candidates
from pwralign_kin.estimation.comparison.ranking import total_coverage
from pwralign_kin.estimation.comparison.scan_comparison import ScanComparison
from pwralign_kin.estimation.doubt.observability import Doubt
from pwralign_kin.estimation.evidence.confidence import confidence
from pwralign_kin.estimation.evidence.evidence import ahead_of
from pwralign_kin.estimation.options import EstimatorOptions, changed
from pwralign_kin.estimation.result import Alternative, Estimate, PartEstimate
from pwralign_kin.estimation.sensing.observation import Observation
from pwralign_kin.estimation.stages import Judged, SearchedScan
from pwralign_kin.model import ArticulatedModel
from pwralign_kin.scan import Scan
from pwralign_kin.se3 import Array
from pwralign_kin.state import State

EQUAL = 0.01
"""Score within which the scan cannot tell two answers apart."""
EQUAL_POINTS = 600
"""Scan points that answers made from the model's symmetry are refined with."""


def reported(searched: SearchedScan, judged: Judged, equal: Candidates, options: EstimatorOptions) -> Estimate:
    """Return the estimate that a `judged` answer makes.

    Beside it are the other answers that the search ended with and those that the model's symmetry makes `equal` to it.
    """
    scan, comparison, finished = searched.scan, searched.solver.comparison, searched.finished
    solution, doubt, model = judged.solution, judged.doubt, searched.solver.model
    observation, final = comparison.observation, solution.configuration
    seen = comparison.seen_shares(final)[0]
    with searched.watch.stage("equal answers"):
        others = _others(comparison, final, finished, equal)
        evidence = replace(judged.evidence, ahead=ahead_of(finished.scores[:1], others.scores))
    state = state_of(model, observation, solution.base, solution.values)
    T_scan_parts = state.T_scan_base @ model.part_placements(model.values(state.joints))
    labels, distances = _labels(scan, comparison, observation.to_search(T_scan_parts))
    explained = labels >= 0
    names, scales = model.joint_names, model.joint_scales
    twist_scales = np.concatenate([np.ones(3), np.full(3, model.diagonal), scales])
    return Estimate(
        state=state,
        cost=-float(finished.scores[0]),
        confidence=confidence(evidence),
        evidence=evidence,
        inlier_rmse=_rms(distances[explained]),
        scan_coverage=float(explained.mean()),
        model_support=float(seen @ (comparison.weights * comparison.exists)),
        viewpoint_known=observation.single_view,
        parts=_parts(model, T_scan_parts, labels, distances, np.where(comparison.exists, seen, np.nan)),
        scan_labels=_per_input(labels, scan),
        undetermined=tuple(name for name, is_so in zip(names, doubt.undetermined, strict=True) if is_so),
        std=_deviations(model, doubt, options),
        covariance=doubt.covariance * np.outer(twist_scales, twist_scales),
        alternatives=tuple(
            Alternative(
                state_of(model, observation, base, values),
                -float(score),
                bool(abs(finished.scores[0] - score) < EQUAL),
            )
            for base, values, score in zip(others.bases, others.values, others.scores, strict=True)
        ),
        converged=solution.converged,
        iterations=solution.iterations,
        timings=dict(searched.watch.seconds),
        options=changed(options),
        units={name: model.units[name] for name in names},
    )


def _parts(
    model: ArticulatedModel, T_scan_parts: Array, labels: NDArray[np.int64], distances: Array, support: Array
) -> dict[str, PartEstimate]:
    """Return what is told of each part, placed (parts, 4, 4), by the part that each kept point lies on, their distances
    (m) and the `support` (parts,)."""
    explained, count = labels >= 0, len(model.parts)
    points = np.bincount(labels[explained], minlength=count)
    squares = np.bincount(labels[explained], np.square(distances[explained]), count)
    residuals = np.sqrt(squares / np.where(points > 0, points, np.nan))
    return {
        part.name: PartEstimate(T_scan_parts[i], float(residuals[i]), int(points[i]), float(support[i]))
        for i, part in enumerate(model.parts)
    }


def _deviations(model: ArticulatedModel, doubt: Doubt, options: EstimatorOptions) -> dict[str, float]:
    """Return the standard deviation of each joint value (rad or m): where it is undetermined, that of its prior."""
    variances = np.diag(doubt.covariance)[6:] * model.joint_scales**2
    prior = np.array([options.prior_std.get(name, np.inf) for name in model.joint_names])
    std = np.where(doubt.undetermined, prior, np.sqrt(variances))
    return dict(zip(model.joint_names, std.tolist(), strict=True))


def _others(comparison: ScanComparison, final: Candidates, finished: Candidates, made: Candidates) -> Candidates:
    """Return what the search found besides the answer, and what the model's symmetry `made` of it, best first."""
    if len(made):
        # Parts only nearly look alike, so that a little refinement may help, or not.
        refined = comparison.refined(
            made, points=EQUAL_POINTS, iterations=4, sigma=FINE_SIGMA, support_weight=FINE_SUPPORT
        )
        made = Candidates.concatenate([made, refined])
        # Equal surfaces have equal support, but for how their parts are sampled: what they explain compares them.
        covered = total_coverage(comparison, Candidates.concatenate([final, made]))
        made = made.with_scores(finished.scores[0] - (covered[0] - covered[1:]))
    answer = final.with_scores(np.full(1, np.inf, np.float32))
    several = Candidates.concatenate([answer, finished.take(slice(1, None)), made])
    return comparison.distinct(several, len(several), comparison.options.distinct).take(slice(1, None))


def state_of(model: ArticulatedModel, observation: Observation, base: Array, values: Array) -> State:
    """Return base (4, 4) and values (k,) of the search in the scan frame and in joint units."""
    joints = np.clip(values * model.joint_scales, model.lower, model.upper)
    return State(
        T_scan_base=observation.to_scan(base),
        joints=dict(zip(model.joint_names, joints.tolist(), strict=True)),
        base_link=model.root_link,
    )


def _labels(scan: Scan, comparison: ScanComparison, placements: Array) -> tuple[NDArray[np.int64], Array]:
    """Return per kept scan point the part it lies on (-1: none) and its distance (m)."""
    observation = comparison.observation
    points, exists = observation.scaled(scan.points), comparison.exists
    distance, part = comparison.assigned(points, placements, exists, comparison.reach)
    return np.asarray(part, np.int64), distance.astype(float) * observation.diagonal


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2))) if len(values) else float("nan")


def _per_input(labels: NDArray[np.int64], scan: Scan) -> NDArray[np.int64]:
    """Spread labels of kept points to all points given; dropped points are nobody's."""
    out = np.full(scan.n_input, -1, np.int64)
    out[scan.source_index] = labels
    return out
