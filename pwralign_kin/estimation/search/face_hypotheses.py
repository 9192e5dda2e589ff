"""Poses of parts from their flat faces: rectangles around flat patches of the scan laid onto those of the model.

Oriented pairs of points tell where a plane is, but not where on it they lie; the edges of the face do.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from pwralign_kin.arrays import Ints
from pwralign_kin.checked_options import CheckedOptions, Count, NotNegative, Positive, Share
from pwralign_kin.estimation.search.hypotheses import Hypotheses
from pwralign_kin.estimation.search.tree_search import TreeSearch
from pwralign_kin.estimation.sensing.observation import Observation
from pwralign_kin.model.flat_faces import FlatFaces, flat_faces
from pwralign_kin.se3 import Array, inverse


@dataclass(frozen=True)
class FaceOptions(CheckedOptions):
    """Which faces are laid onto each other. Lengths in model diagonals."""

    least_area: NotNegative = 0.01
    """Area of a patch of the scan below which it is laid onto no face."""
    tolerance: Positive = 0.01
    """Distance of a scan point from the plane of its patch, without noise; three times the noise is added."""
    links: Positive = 2.5
    """Distance of neighbouring points of one patch in point spacings."""
    slack: NotNegative = 0.03
    """Difference of two sides that are the same."""
    surplus: NotNegative = 0.1
    """How much longer than a face its patch may be: other surface lies in the same plane beside it."""
    least_side: Share = 0.4
    """Share of a side of a face that a patch of it shows at least."""
    screened: Count = 60
    """Poses of each part that are aligned with the scan, ..."""
    kept: Count = 6
    """... and kept, ..."""
    scene_kept: Count = 16
    """... and in each region of a scene, where other things look like parts."""


def face_hypotheses(search: TreeSearch, parts: Ints, options: FaceOptions, region: int = 0) -> Hypotheses:
    """Return poses of `parts` that lay one of their flat faces onto a flat patch of one region of the scan."""
    patches = scan_faces(search.observation, options, region)
    found = [_of_part(search, int(part), patches, options) for part in parts]
    return Hypotheses.concatenate([Hypotheses.nothing(), *found])


def scan_faces(observation: Observation, options: FaceOptions, region: int) -> FlatFaces:
    """Return the flat patches of one region of a scan."""
    own = np.flatnonzero(observation.regions == region)
    link = max(options.links * observation.spacing, 0.02)
    tolerance = options.tolerance + 3 * observation.noise
    area = observation.areas[own].astype(float) * (1.0 if observation.scene else observation.area_per_point)
    points, normals = (np.ascontiguousarray(of[own]) for of in (observation.points, observation.normals))
    return flat_faces(points, normals, area, link, tolerance, options.least_area)


def _of_part(search: TreeSearch, part: int, patches: FlatFaces, options: FaceOptions) -> Hypotheses:
    surface = search.comparison.surfaces[part]
    placements = [
        patch @ motion @ inverse(face)
        for (patch, seen), (face, size) in product(
            zip(patches.frames, patches.sizes, strict=True), zip(surface.faces, surface.face_sizes, strict=True)
        )
        for motion in matching(seen, size, options)
    ]
    if not placements:
        return Hypotheses.nothing()
    own = np.full(len(placements), part, np.int32)
    screened = search.aligned(own, np.array(placements), 0)
    screened = screened.take(np.argsort(-screened.scores, kind="stable")[: options.screened])
    refined = search.aligned(screened.parts, screened.placements, 5)
    refined = refined.take(np.argsort(-refined.scores, kind="stable"))
    kept = options.scene_kept if search.observation.scene else options.kept
    return refined.take(search.distinct_hypotheses(refined, kept, 0.03))


def matching(seen: Array, size: Array, options: FaceOptions) -> list[Array]:
    """Return the motions (4, 4), from a face's rectangle to a patch's, that lay the sides of the two onto each other.

    `seen` and `size` (2,) are the sides of patch and face. A patch may show less of the face than there is, and a
    little more, to either end.
    """
    motions = []
    for quarter in range(4):
        sides = size[::-1] if quarter % 2 else size
        hidden = sides - seen
        if (hidden < -options.surplus).any() or (seen < options.least_side * sides).any():
            continue
        ends = [(0.0,) if abs(own) < options.slack else (-own / 2, own / 2) for own in hidden]
        cos, sin = [(1, 0), (0, 1), (-1, 0), (0, -1)][quarter]
        for x, y in product(*ends):
            motion = np.eye(4)
            motion[:2, :2] = [[cos, -sin], [sin, cos]]
            motion[:2, 3] = x, y
            motions.append(motion)
    return motions
