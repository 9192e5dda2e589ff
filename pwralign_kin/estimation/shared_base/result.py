"""What several scans of one model that does not move from its place tell together."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from pwralign_kin import se3
from pwralign_kin.estimation.result import Estimate, millimetres, shown
from pwralign_kin.estimation.shared_base.joint_offsets import JointOffsets
from pwralign_kin.read_only import ReadOnly
from pwralign_kin.se3 import Array


@dataclass(frozen=True, eq=False)
class SharedBaseEstimate(ReadOnly):
    """What `estimate` of several scans and `calibrate` return."""

    T_scan_base: Array
    """(4, 4) placement of the root link in the frame that all scans share, m."""
    base_link: str
    """The root link."""
    base_covariance: Array
    """(6, 6) covariance of the base twist (rotation, translation; rad and m, scan frame axes, about the base's
    origin); joints that are not locked are free to follow the base."""
    estimates: tuple[Estimate, ...]
    """One estimate a scan, in the order given; all have the same base."""
    outvoted: tuple[int, ...]
    """Scans that on their own had found another base."""
    converged: bool
    """Whether the joint least squares met its step tolerance."""
    iterations: int
    """Iterations of the joint least squares."""
    offsets: JointOffsets
    """How far joints that were given in all scans lie from their values, as the scans tell."""

    @property
    def confidence(self) -> float:
        """In [0, 1]: the median confidence of the scans."""
        return float(np.median([e.confidence for e in self.estimates]))

    @property
    def rotation_std(self) -> float:
        """Standard deviation of the base's rotation, rad: root of the summed variances about the three axes."""
        return float(np.sqrt(np.trace(self.base_covariance[:3, :3])))

    @property
    def translation_std(self) -> float:
        """Standard deviation of the base's position, m: root of the summed variances along the three axes."""
        return float(np.sqrt(np.trace(self.base_covariance[3:, 3:])))

    @property
    def contradicted(self) -> list[str]:
        """A line for every joint value that was given and that the scans contradict; then the base is wrong, too."""
        units = self.estimates[0].units
        return [
            f"{'all scans' if scan is None else f'scan {scan}'}: {name} seems {shown(offset.value, units[name], 0, 2)} "
            f"off its given value, +- {shown(offset.std, units[name], 0, 2)}"
            for scan, name, offset in self.offsets.large()
        ]

    def to_dict(self) -> dict[str, Any]:
        """Return a JSON-ready summary; options that all estimates share are not repeated in each."""
        each = [estimate.to_dict() for estimate in self.estimates]
        first, *others = (own["options"] for own in each)
        shared = {name: value for name, value in first.items() if all(own.get(name) == value for own in others)}
        for own in each:
            own["options"] = {name: value for name, value in own["options"].items() if name not in shared}
        return {
            "base_link": self.base_link,
            "T_scan_base": self.T_scan_base.tolist(),
            "base_covariance": self.base_covariance.tolist(),
            "confidence": self.confidence,
            "outvoted": list(self.outvoted),
            "converged": self.converged,
            "iterations": self.iterations,
            "joint_offsets": asdict(self.offsets),
            "options": shared,
            "estimates": each,
        }

    def __repr__(self) -> str:
        """Return one line: how sure the base is, and the base. `print` shows a line a scan."""
        base = f"{self.base_link}: {se3.placement_text(self.T_scan_base, 4)}"
        return f"SharedBaseEstimate({len(self.estimates)} scans, confidence {self.confidence:.2f}; {base})"

    def __str__(self) -> str:
        """Return the base, and a line a scan."""
        lines = [
            f"base link {self.base_link}: {se3.placement_text(self.T_scan_base, 5)}",
            f"standard deviation {1e3 * self.translation_std:.2f} mm, {np.degrees(self.rotation_std):.3f} deg   "
            f"confidence {self.confidence:.2f}",
            "",
            "scan  confidence  coverage  support  inlier RMSE  undetermined",
        ]
        for i, e in enumerate(self.estimates):
            lines.append(
                f"{i:4d}  {e.confidence:10.2f}  {e.scan_coverage:8.1%}  {e.model_support:7.1%}  "
                f"{millimetres(e.inlier_rmse):>11}  {', '.join(e.undetermined) or '-'}"
                + ("  (alone it had another base)" if i in self.outvoted else "")
            )
        width = max([len("joint"), *map(len, self.estimates[0].state.joints)])
        lines += ["", f"{'joint':{width}}" + "".join(f"{f'scan {i}':>15}" for i in range(len(self.estimates)))]
        for name, unit in self.estimates[0].units.items():
            values = (
                f"{'undetermined':>15}" if name in e.undetermined else shown(e.state.joints[name], unit, 11, 2)
                for e in self.estimates
            )
            lines.append(f"{name:{width}}" + "".join(values).rstrip())
        lines += [""] * any(self.contradicted)
        lines += self.contradicted
        return "\n".join(lines)
