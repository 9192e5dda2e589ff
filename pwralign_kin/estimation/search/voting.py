"""Votes: scan points that an answer leaves unexplained say where the parts that it has wrong should be.

Each part that explains too little is placed on its own among the unexplained points of its region of interest, and the
joints between it and the parts that are right are solved so that it comes there. A beam that grows through a chain of
small parts judges each of them on little evidence; a vote skips them and judges the large part at the end.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pwralign_kin.arrays import Bools, Indices, Ints
from pwralign_kin.checked_options import CheckedOptions, Count, Natural, NotNegative, Share
from pwralign_kin.estimation.comparison.candidates import Candidates
from pwralign_kin.estimation.comparison.scan_comparison import ScanComparison
from pwralign_kin.estimation.search.hypotheses import Hypotheses
from pwralign_kin.estimation.search.region_of_interest import Ball, path_between, region_of_interest, subtrees
from pwralign_kin.estimation.search.tree_search import TreeSearch
from pwralign_kin.se3 import Array, transform

LIMB, OTHER_LIMB = (0.08, 0.7), 0.03
"""Least and largest share of the model's surface in a limb that is doubted as a whole, what of it two limbs must not
share, ..."""
KEPT = 4
"""... and how many ways to hold it are kept of the best, and of those that change most."""


@dataclass(frozen=True)
class VoteOptions(CheckedOptions):
    """How many votes are counted."""

    parts: Natural = 8
    """Parts that explain too little, largest lack first, that votes are cast for."""
    points: Count = 200
    """Unexplained points that pairs are drawn about."""
    explained_weight: Share = 0.3
    """Weight of all other points in the score of a placement."""
    placements: Count = 5
    """Placements of each."""
    anchors: Count = 3
    """Parts on the way to the best explained one, nearest first, that each placement is reached from."""
    starts: Count = 12
    """Random starts of the joints between them."""
    kept: Count = 2
    """Solutions of each."""
    tolerance: NotNegative = 0.03
    """Distance (model diagonals) that the joints may leave."""
    scene_reach: NotNegative = 0.35
    """Only points of a scene this near (model diagonals) to explained ones may be of the model."""
    least_points: Count = 25
    """Unexplained points that are worth a vote, ..."""
    least_misfits: Count = 5
    """... or so many that are farther than noise explains from all but parts off their points."""


def voted(
    search: TreeSearch,
    solution: Candidates,
    options: VoteOptions,
    seed: int,
    *,
    doubting: bool,
    off: Indices | None = None,
) -> Candidates | None:
    """Return configurations that bring the parts `solution` has wrong to its unexplained points; None if none.

    When `doubting`, points on parts that are wrong vote too: they may belong to another part. Parts that explain too
    little are, and those known to lie `off` their points; where there are such, points are explained to within the
    noise alone, and what is right beyond what is wrong is held in other ways too.
    """
    comparison = search.comparison
    owners = comparison.owners(solution, comparison.exists)[1]
    share = comparison.fair_shares(owners)
    wrong = comparison.lacking(share)
    lack = np.where(wrong, comparison.weights * (1.0 - share), 0.0)
    reach, least = comparison.reach, options.least_points
    if off is not None:
        wrong[off], lack[off] = True, comparison.weights[off]
        reach, least = comparison.noise_reach, options.least_misfits
    right = comparison.exists & ~wrong
    cast = [int(i) for i in np.argsort(-lack, kind="stable")[: options.parts] if lack[i] > 0]
    unexplained = comparison.owners(solution, right if doubting else comparison.exists)[0] > reach
    if search.observation.scene:
        unexplained &= _about(comparison, ~unexplained, options.scene_reach)
    if unexplained.sum() < least or not cast or not right.any():
        return None
    best = int(np.argmax(comparison.weights * share * right))
    weights = search.observation.weights * np.where(unexplained, 1.0, options.explained_weight)
    points = search.observation.points
    placements = comparison.part_placements(solution)[0]
    ways = {part: path_between(comparison.parent, part, best) for part in cast}
    regions = {part: _regions(comparison, placements, way, right, options.anchors) for part, way in ways.items()}
    widest = [list(own.values())[-1] for own in regions.values()]
    found = search.part_hypotheses(
        np.array(cast, np.int32),
        [np.flatnonzero(unexplained & region.holds(points, comparison.reach)) for region in widest],
        options.points,
        seed,
        options.placements,
        weights,
    )
    tasks = [
        (row, anchor)
        for row, (part, T) in enumerate(zip(found.parts, found.placements, strict=True))
        for anchor, region in regions[int(part)].items()
        if region.holds(transform(T, comparison.surfaces[part].samples), comparison.reach).all()
    ]
    rows, holding = (np.array([task[column] for task in tasks], np.int32) for column in (0, 1))
    placed = found.take(rows)
    if off is not None:
        inner, outer = _ends(comparison, right, wrong)
        held = Hypotheses(outer, np.ascontiguousarray(placements[outer]), np.zeros(len(outer), np.float32))
        holding, placed = np.concatenate([holding, inner]), Hypotheses.concatenate([placed, held])
    if len(holding) == 0:
        return None
    reached = search.reached(solution, holding, placed, seed, options.starts, options.kept, options.tolerance)
    return reached if len(reached) else None


def limbs_voted(search: TreeSearch, solution: Candidates, options: VoteOptions, seed: int) -> Candidates | None:
    """Return configurations that hold whole limbs otherwise than `solution` (one), None if none: each limb in turn is
    taken to be wrong, whatever it explains.

    One that lies on points of another thing, or of another limb, lacks nothing, and no vote is cast for it else.
    """
    limbs = _limbs(search.comparison)
    ways = [voted(search, solution, options, seed, doubting=True, off=np.flatnonzero(limb)) for limb in limbs]
    found = [search.sifted(way, KEPT, KEPT) for way in ways if way is not None]
    return Candidates.concatenate(found) if found else None


def _limbs(comparison: ScanComparison) -> list[Bools]:
    """Return the parts (parts,) with surface on either side of each joint where they are a limb, the largest first; of
    limbs that are nearly the same, the largest."""
    below = subtrees(comparison.parent)[1:]
    sides = np.unique(np.concatenate([below, ~below]) & comparison.exists, axis=0)
    shares = sides @ comparison.weights
    limbs: list[Bools] = []
    for i in np.argsort(-shares, kind="stable"):
        if not LIMB[0] < shares[i] < LIMB[1]:
            continue
        if all((sides[i] ^ limb) @ comparison.weights > OTHER_LIMB for limb in limbs):
            limbs.append(sides[i])
    return limbs


def _ends(comparison: ScanComparison, right: Bools, wrong: Bools) -> tuple[Ints, Ints]:
    """Return pairs of parts that are right, inner and outer, with one that is wrong on the way between them: three
    joints in a row have two ways to hold what is beyond them."""
    pairs = []
    for outer in map(int, np.flatnonzero(right)):
        inner, crossed = outer, False
        while inner > 0 and (inner == outer or not right[inner]):
            inner = int(comparison.parent[inner])
            crossed |= bool(wrong[inner])
        if crossed and right[inner]:
            pairs.append((inner, outer))
    inner_parts, outer_parts = (np.array([pair[end] for pair in pairs], np.int32) for end in (0, 1))
    return inner_parts, outer_parts


def _regions(
    comparison: ScanComparison, placements: Array, way: Sequence[int], right: Bools, most: int
) -> dict[int, Ball]:
    """Return where a part can be when it is reached from parts that are `right` (parts,), `most` at the most and
    nearest first, on its `way` to the best explained one; `placements` (parts, 4, 4) are those of all parts."""
    anchors = [node for node in way[1:] if right[node]][:most]
    return {anchor: region_of_interest(comparison, placements, way[: way.index(anchor) + 1]) for anchor in anchors}


def _about(comparison: ScanComparison, explained: Bools, reach: float) -> Bools:
    """Return which points (m,) of a scene are searched and near to explained ones."""
    from scipy.spatial import cKDTree

    points = comparison.observation.points
    if not explained.any():
        return comparison.searched
    distance = cKDTree(points[explained]).query(points, distance_upper_bound=reach)[0]
    return np.asarray(comparison.searched & np.isfinite(distance))
