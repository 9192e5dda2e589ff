"""What the image of a single view tells of a model, besides the points on its surface."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pwralign_kin import se3
from pwralign_kin.estimation.comparison.candidates import Candidates
from pwralign_kin.estimation.comparison.scan_comparison import ScanComparison
from pwralign_kin.estimation.sensing.silhouette import ON_MODEL, Silhouette
from pwralign_kin.se3 import Array

OUTLINE_REACH = 0.03
"""Samples on the model's outline farther than this (model diagonals) from the scan's have no counterpart in it."""
EXACT = 0.003
"""Residuals of the surface (model diagonals) that samples and noise explain; outlines only mend what is beyond."""
MOSTLY_SHARED = 3.0
"""Systematic residual, against the noise, from which errors are mostly shared by neighbouring points: 11 times in real
frames, up to 1.8 in simulated ones, whose systematic residual is noise that the scan hides."""
ACROSS = 0.005
"""Noise (model diagonals) from which it takes points across thin parts."""
LEAST_OUTLINED = 100
"""Scan points on the model below which there is no outline."""


@dataclass(frozen=True)
class View:
    """An image told by a configuration near to the answer; without an argument, nothing was looked at."""

    silhouette: Silhouette | None = None
    """The outline of the model's points; None where surfaces tell all."""
    systematic: float = 0.0
    """Residual of the surface (model diagonals) that noise does not explain."""
    along_rays: bool = False
    """Whether counterparts of points are what the sensor sees there, not what is nearest."""

    def outline(self, comparison: ScanComparison, placements: Array, centre: Array, most: float) -> tuple[Array, Array]:
        """Return information (parts, 6, 6) and gradients (parts, 6) of the model's outline, in twist space about
        `centre`, of parts placed (parts, 4, 4); against the surface it weighs at `most` so much."""
        if self.silhouette is None:
            return np.zeros((len(placements), 6, 6)), np.zeros((len(placements), 6))
        surfaces = comparison.surfaces
        parts = np.concatenate([np.full(len(s.dense), i) for i, s in enumerate(surfaces)])
        points = np.concatenate(
            [se3.transform(T, s.dense.astype(float)) for T, s in zip(placements, surfaces, strict=True)]
        )
        spacing = max(s.spacing for s in surfaces if s.exists)
        found = self.silhouette.residuals(parts, points, spacing, OUTLINE_REACH)
        return found.normal_equations(self.systematic, most, len(placements), centre)


NOT_LOOKED_AT = View()


def view_of(comparison: ScanComparison, near: Candidates, residual: float, *, outlined: bool) -> View:
    """Tell the model's points in the image of a single view from the rest, by one configuration `near` to the answer.

    `residual` is that of the configuration; the silhouette is taken where it is to be `outlined`.
    """
    observation = comparison.observation
    # In a scene the outline is one of depth jumps, which sensors smear.
    if not observation.single_view or observation.scene:
        return NOT_LOOKED_AT
    known = (1.2 * observation.noise) ** 2 + EXACT**2
    systematic = float(np.sqrt(max(residual**2 - known, 0.0)))
    # Noise takes points across thin parts, to whose far faces they are then nearer: counterparts are what the
    # sensor sees there. Errors that neighbours share bend the surface instead, and its normals tell what is where.
    along_rays = observation.noise > max(ACROSS, systematic / MOSTLY_SHARED)
    silhouette = _silhouette(comparison, near) if outlined and systematic > 0 else None
    return View(silhouette, systematic, along_rays)


def _silhouette(comparison: ScanComparison, near: Candidates) -> Silhouette | None:
    """Return the outline of the points near to one configuration, None where they are too few."""
    raw, placements = comparison.observation.raw, comparison.part_placements(near)[0]
    on_model = comparison.assigned(raw, placements, comparison.exists, ON_MODEL)[0] < ON_MODEL
    return Silhouette(comparison.observation, raw, on_model) if on_model.sum() > LEAST_OUTLINED else None
