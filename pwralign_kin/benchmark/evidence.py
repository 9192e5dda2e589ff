"""What an estimate says for itself, as plain numbers: what a confidence can be computed from, and is held against."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np

from pwralign_kin.benchmark.metrics import Reference, Ruler, wrapped
from pwralign_kin.benchmark.symmetry import in_words_of_truth
from pwralign_kin.estimation import Estimate
from pwralign_kin.scan import Scan
from pwralign_kin.state import State

SUSPICIOUS = float(np.radians(10.0))
"""A joint off by more than this (rad, or as a share of the diagonal) may be right up to the part's own symmetry."""

_LEAST_POINTS = 15
"""Scan points with which a part counts as seen."""

_POOR_SUPPORT = 0.3


@dataclass(frozen=True)
class JointDoubt:
    """What an estimate says of one joint, and what is true."""

    name: str
    error: float
    """Distance from the truth, rad or m; up to the part's own symmetry where the scan can tell the joint."""

    std: float
    """Standard deviation by the estimate, rad or m; infinite where undetermined."""

    determined: bool
    """Whether the estimate calls it determined."""

    told: bool
    """Whether the scan can tell it, by the truth."""


def evidence(estimate: Estimate, scan: Scan, ruler: Ruler) -> dict[str, float]:
    """Return figures of an estimate that need no truth; lengths in model diagonals.

    Other margins than that of the evidence are the cost of an alternative beyond that of the answer.
    """
    model = ruler.model
    solid = [estimate.parts[part.name] for part in model.parts if len(part.faces)]
    points = np.array([part.points for part in solid])
    support = np.array([part.support for part in solid])
    seen = points >= _LEAST_POINTS
    residuals = np.array([part.residual for part in solid])[seen] / model.diagonal
    margins = [other.cost - estimate.cost for other in estimate.alternatives]
    unequal = [m for m, other in zip(margins, estimate.alternatives, strict=True) if not other.equal]
    return {
        **asdict(estimate.evidence),
        "scan_coverage": estimate.scan_coverage,
        "model_support": estimate.model_support,
        "inlier_rmse": estimate.inlier_rmse / model.diagonal,
        "cost": estimate.cost,
        "unequal_margin": min(unequal, default=1.0),
        "least_margin": min(margins, default=1.0),
        "alternatives": float(len(margins)),
        "equal_alternatives": float(len(margins) - len(unequal)),
        "undetermined_share": len(estimate.undetermined) / max(len(model.joint_names), 1),
        "parts": float(len(solid)),
        "joints": float(len(model.joint_names)),
        "seen_share": float(seen.mean()),
        "least_support": _least(support),
        "least_seen_support": _least(support[seen]),
        "mean_support": float(np.nanmean(support)),
        "poorly_supported_share": float(np.nanmean(support < _POOR_SUPPORT)),
        "worst_residual": float(residuals.max(initial=0.0)),
        "median_residual": float(np.median(residuals)) if len(residuals) else 0.0,
        "points": float(len(scan.points)),
        "unexplained_points": float((1.0 - estimate.scan_coverage) * len(scan.points)),
        "single_view": float(scan.sensor_origin is not None),
        "converged": float(estimate.converged),
        "iterations": float(estimate.iterations),
        **{f"seconds {stage}": seconds for stage, seconds in estimate.timings.items()},
    }


def joint_doubts(ruler: Ruler, reference: Reference, estimate: Estimate) -> tuple[JointDoubt, ...]:
    """Return what the estimate says of every joint, beside the truth.

    Meaningful where every observed part is found, for else the names of limbs may be exchanged.
    """
    errors = _errors(ruler, reference.truth, estimate.state)
    if any(errors[name] > SUSPICIOUS for name in reference.told):
        same = _errors(ruler, reference.truth, in_words_of_truth(ruler, reference, estimate.state))
        errors |= {name: min(errors[name], same[name]) for name in reference.told}
    return tuple(
        JointDoubt(
            name=name,
            error=errors[name] * scale,
            std=estimate.std[name],
            determined=name not in estimate.undetermined,
            told=name in reference.told,
        )
        for name, scale in zip(ruler.model.joint_names, ruler.model.joint_scales.tolist(), strict=True)
    )


def _errors(ruler: Ruler, truth: State, answer: State) -> dict[str, float]:
    """Return the distance of every joint from the truth, rad or model diagonals."""
    model = ruler.model
    found = {}
    for name in model.joint_names:
        offset = answer.joints[name] - truth.joints[name]
        found[name] = abs(offset) / model.diagonal if model.units[name] == "m" else abs(wrapped(offset))
    return found


def _least(values: np.ndarray) -> float:
    return float(np.nanmin(values)) if np.isfinite(values).any() else 0.0
