"""The result of an estimate."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pwralign_kin.estimation.evidence.evidence import Evidence
from pwralign_kin.read_only import ReadOnly
from pwralign_kin.se3 import Array, placement_text
from pwralign_kin.state import State

SEEN_POINTS = 15
"""Scan points from which a part counts as seen."""


@dataclass(frozen=True, eq=False)
class PartEstimate(ReadOnly):
    """One rigid part after the estimate."""

    T_scan_part: Array
    """(4, 4) placement of the part's frame (the frame of the link it is named after) in the scan frame."""

    residual: float
    """Root mean square distance of the part's scan points to the samples of its surface, m; NaN without points."""

    points: int
    """Number of scan points that lie on the part."""

    support: float
    """Share of the part's surface that should be seen and is, in [0, 1]; NaN for a part without geometry."""

    @property
    def seen(self) -> bool:
        """Whether more than stray points lie on the part."""
        return self.points >= SEEN_POINTS


@dataclass(frozen=True, eq=False)
class Alternative:
    """Another answer that was found, distinct from the best one."""

    state: State
    cost: float
    """Lower is better; comparable within one estimate."""

    equal: bool
    """Whether the scan cannot tell it from the best answer (interchangeable limbs, symmetry)."""


@dataclass(frozen=True, eq=False)
class Estimate(ReadOnly):
    """What `pwralign_kin.estimate` returns."""

    state: State
    """The best answer: base placement and every actuated joint's value."""

    cost: float
    """Cost of the best answer, on the scale of `alternatives`."""

    confidence: float
    """In [0, 1]: the chance that the answer overlays the scan, from simulated scans with such evidence."""

    evidence: Evidence
    """What the confidence is computed from."""

    inlier_rmse: float
    """Root mean square distance of the explained scan points to the samples of the model's surface, m; NaN without
    any."""

    scan_coverage: float
    """Share of the scan points that the model explains."""

    model_support: float
    """Share of the model surface that should be seen and is."""

    viewpoint_known: bool
    """Whether the scan told the one place that it was seen from. Otherwise all surface should be seen."""

    parts: Mapping[str, PartEstimate]
    """Per part: placement, residual, points, support."""

    scan_labels: NDArray[np.int64]
    """(n,) for every point given: index of the part it lies on, in the order of `parts`; -1 = not the model's."""

    undetermined: tuple[str, ...]
    """Joints that the scan does not tell; they keep their prior value."""

    std: Mapping[str, float]
    """Standard deviation of each joint value, rad or m; where undetermined the prior's, infinite without one."""

    covariance: Array
    """(6 + k, 6 + k) covariance of base twist (rotation, translation; rad and m, scan frame axes, about the base's
    origin) and of the k joints in the order of `state.joints`. Rows of undetermined joints are zero."""

    alternatives: tuple[Alternative, ...]
    """The next-best distinct answers, best first."""

    converged: bool
    """Whether the joint least squares met its step tolerance."""

    iterations: int
    """Iterations of the joint least squares."""

    timings: Mapping[str, float]
    """Seconds per stage, in order."""

    options: Mapping[str, Any]
    """The options that the estimate ran with, where they differ from the defaults, as nested plain values."""

    units: Mapping[str, str]
    """Unit of each joint value: "rad" or "m"."""

    @property
    def base_covariance(self) -> Array:
        """(6, 6) covariance of the base twist: the first rows and columns of `covariance`."""
        return self.covariance[:6, :6]

    def to_dict(self) -> dict[str, Any]:
        """Return a JSON-ready summary: the state and all the figures, without the arrays per point.

        Numbers that are not finite become None.
        """
        summary = {
            **self.state.to_dict(),
            "units": dict(self.units),
            "confidence": self.confidence,
            "evidence": asdict(self.evidence),
            "cost": self.cost,
            "inlier_rmse": self.inlier_rmse,
            "scan_coverage": self.scan_coverage,
            "model_support": self.model_support,
            "viewpoint_known": self.viewpoint_known,
            "undetermined": list(self.undetermined),
            "std": dict(self.std),
            "base_covariance": self.base_covariance.tolist(),
            "parts": {
                name: {
                    "T_scan_part": part.T_scan_part.tolist(),
                    "residual": part.residual,
                    "points": part.points,
                    "support": part.support,
                    "seen": part.seen,
                }
                for name, part in self.parts.items()
            },
            "alternatives": [
                {**other.state.to_dict(), "cost": other.cost, "equal": other.equal} for other in self.alternatives
            ],
            "converged": self.converged,
            "iterations": self.iterations,
            "timings": dict(self.timings),
            "options": dict(self.options),
        }
        return {key: _finite(value) for key, value in summary.items()}

    def __repr__(self) -> str:
        """Return one line: how sure the answer is, and the answer. `print` shows the table."""
        undetermined = f"undetermined: {', '.join(self.undetermined)}; " * bool(self.undetermined)
        others = f"alternatives: {len(self.alternatives)}; " * bool(self.alternatives)
        return f"Estimate(confidence {self.confidence:.2f}; {undetermined}{others}{self.state!r})"

    def __str__(self) -> str:
        """Return a table of joints and parts, worth reading."""
        lines = [
            f"confidence {self.confidence:.2f}   coverage {self.scan_coverage:.1%} of the scan   "
            f"support {self.model_support:.1%} of the {'visible' if self.viewpoint_known else 'whole'} model   "
            f"inlier RMSE {millimetres(self.inlier_rmse)}",
            f"base link {self.state.base_link}: {placement_text(self.state.T_scan_base, 4)}",
            "",
            *joint_table(self.state.joints, self.std, self.undetermined, self.units),
        ]
        part_width = max([len("part"), *map(len, self.parts)])
        lines += ["", f"{'part':{part_width}}  points  residual  support"]
        for name, part in self.parts.items():
            if np.isfinite(part.support):
                hardly = "" if part.seen else "  hardly seen" if part.points else "  not seen"
                residual = millimetres(part.residual)
                lines.append(f"{name:{part_width}}  {part.points:6d} {residual:>9}  {part.support:6.0%}{hardly}")
        if self.alternatives:
            equal = sum(other.equal for other in self.alternatives)
            rival = f"best cost {self.alternatives[0].cost:.4f} against {self.cost:.4f}, less is better"
            count = len(self.alternatives)
            as_well = f"{equal or 'none'} of them explain{'s' * (equal <= 1)} the scan as well"
            lines += ["", f"alternatives: {count}; {as_well} ({rival})"]
        outcome = "converged" if self.converged else "NOT converged"
        steps = f"{self.iterations} iteration{'s' * (self.iterations != 1)}"
        lines.append(f"{outcome} in {steps}, {sum(self.timings.values()):.2f} s")
        return "\n".join(lines)


def _finite(value: Any) -> Any:
    """Return nested dictionaries and sequences with None for numbers that are not finite."""
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    if isinstance(value, float | np.floating):
        return float(value) if np.isfinite(value) else None
    return value


def joint_table(
    values: Mapping[str, float], std: Mapping[str, float], undetermined: Collection[str], units: Mapping[str, str]
) -> list[str]:
    """Return the lines of a table of joints: degrees or mm, and how sure they are."""
    width = max([len("joint"), *map(len, values)])
    lines = [f"{'joint':{width}}       value         std"]
    for name, value in values.items():
        doubt = "undetermined" if name in undetermined else f"{shown(std[name], units[name], 8, 3)}"
        lines.append(f"{name:{width}} {shown(value, units[name], 9, 2)} {doubt.rstrip()}")
    return lines


def millimetres(length: float) -> str:
    """Return a length (m), NaN for none, in mm."""
    return f"{1e3 * length:.2f} mm" if np.isfinite(length) else "-"


def shown(value: float, unit: str, width: int, digits: int) -> str:
    """Return a joint value (rad or m) in degrees or mm, as wide in one as in the other."""
    if unit == "rad":
        return f"{np.degrees(value):{width}.{digits}f} deg"
    return f"{1e3 * value:{width}.{digits}f} mm "
