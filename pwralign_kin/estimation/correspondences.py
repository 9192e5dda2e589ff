"""Correspondences between model and scan: built-in FPFH features, or from any outside matcher."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class CorrespondenceOptions:
    """How correspondences become part hypotheses. Lengths in model diagonals."""

    feature_radius: float = 0.08
