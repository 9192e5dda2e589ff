"""Parts that were seen from one side only, in a scan that does not tell from where.

Without a sensor origin normals are turned to the open side. Of a plate seen from the inner side alone, such as that of
a half-open lid, this is the wrong one: then the plate is placed by its thickness beside where it is, or taken for
another, and its joint is wrong with confidence. Points alone cannot tell; the model can, if it is tried.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pwralign_kin.estimation.comparison.candidates import Candidates
from pwralign_kin.estimation.comparison.scan_comparison import ScanComparison

FLAT = 0.8
"""Share of the squares of a part's normals along one direction from which on what is seen of it is flat, ..."""
ONE_WAY = 0.4
"""... and mean of them along it from which on they face one way: openness is not of one mind about the inner side of a
half-open lid."""
LEAST_SHARE, LEAST_POINTS = 0.02, 50
"""Share of all prepared points that such a part holds at least, and how many."""
PARTS = 3
"""How many parts, those with most points first."""


def turned_over(comparison: ScanComparison, answer: Candidates) -> list[NDArray[np.bool_]]:
    """Return for each flat part of `answer` (one) that is seen from one side which points (m,) face that way."""
    observation = comparison.observation
    distance, owner = comparison.assigned(
        observation.points, comparison.part_placements(answer)[0], comparison.exists, comparison.options.near
    )
    owner = np.where(distance < comparison.reach, owner, -1)
    points = np.bincount(owner[owner >= 0], minlength=len(comparison.exists))
    least = max(LEAST_POINTS, LEAST_SHARE * len(owner))
    turned: list[NDArray[np.bool_]] = []
    for part in np.argsort(-points, kind="stable"):
        if len(turned) == PARTS or points[part] < least:
            break
        own = owner == part
        normals = observation.normals[own].astype(float)
        shares, directions = np.linalg.eigh(normals.T @ normals / len(normals))
        along = observation.normals @ directions[:, -1]
        mean = along[own].mean()
        if shares[-1] >= FLAT and abs(mean) >= ONE_WAY:
            turned.append(own & (along * mean > 0.0))
    return turned
