"""The region of interest of a part: where its joints let it be while another part stays.

The published part-wise method searches each part in a box around the place that the whole-body fit gave it. A kinematic
tree says more: the joints between the part and one that stays bound how far its surface can come.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from pwralign_kin.arrays import Bools, Ints, Singles
from pwralign_kin.estimation.comparison.scan_comparison import ScanComparison
from pwralign_kin.se3 import Array, transform


@dataclass(frozen=True)
class Ball:
    """Where a part may be, in search units."""

    centre: Array
    radius: float

    def holds(self, points: Singles | Array, margin: float) -> Bools:
        """Return which of the points (n, 3) are inside, or no farther outside than `margin`."""
        return np.asarray(np.linalg.norm(points - self.centre, axis=1) < self.radius + margin, bool)


def region_of_interest(comparison: ScanComparison, placements: Array, way: Sequence[int]) -> Ball:
    """Return the ball that the surface of the first part of `way` cannot leave while the last one stays.

    `way` names neighbours in the tree, `placements` (parts, 4, 4) the parts in the scan. The bound is the sum of the
    lengths between the joints on the way, of what slides, and of the farthest surface of the part.
    """
    joints = [one if comparison.parent[one] == other else other for one, other in pairwise(way)]
    origins = placements[joints, :3, 3]
    surface = transform(placements[way[0]], comparison.surfaces[way[0]].samples.astype(float))
    reach = float(np.linalg.norm(surface - origins[0], axis=1).max())
    links = float(np.linalg.norm(np.diff(origins, axis=0), axis=1).sum())
    return Ball(origins[-1], reach + links + float(comparison.model.travel[joints].sum()))


def path_between(parent: Ints, part: int, goal: int) -> list[int]:
    """Return the parts from `part` to `goal` through the tree."""
    above = [goal]
    while above[-1] > 0:
        above.append(int(parent[above[-1]]))
    way = [part]
    while way[-1] not in above:
        way.append(int(parent[way[-1]]))
    return way + above[: above.index(way[-1])][::-1]


def subtrees(parent: Ints) -> Bools:
    """Return the (parts, parts) matrix whose row i marks part i and everything below it."""
    below = np.eye(len(parent), dtype=bool)
    for i in range(len(parent) - 1, 0, -1):
        below[parent[i]] |= below[i]
    return below
