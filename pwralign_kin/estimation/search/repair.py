"""Repair: regrow the subtrees around badly supported parts, re-root at the well supported, turn the largest
around, and slide thin ones across."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from pwralign_kin.arrays import Bools, Ints, Singles
from pwralign_kin.checked_options import CheckedOptions, Count, Natural, NotNegative, Share
from pwralign_kin.estimation.comparison.candidates import Candidates
from pwralign_kin.estimation.comparison.off_points import off_points
from pwralign_kin.estimation.comparison.scan_comparison import ScanComparison
from pwralign_kin.estimation.search.hypotheses import Hypotheses
from pwralign_kin.estimation.search.region_of_interest import subtrees
from pwralign_kin.estimation.search.tree_search import TreeSearch
from pwralign_kin.estimation.search.voting import VoteOptions, voted
from pwralign_kin.model.surface import Surface
from pwralign_kin.se3 import Array, rotation_about

THIN = (0.01, 0.1)
"""Thickness (model diagonals) of a part that may be taken for seen from its other side and lie beside its place by it;
less is refined away."""
FACING = 0.9
"""Cosine of the angle to a thin part's shortest axis from which on its surface is one of its two sides."""
ALL_NEAR, OUTWARD = 14, 10
"""Parts of a model up to which every joint is cut where points are unexplained, and up to which what is further in is
grown anew from every part, not from those alone that large limbs begin with."""
ROOTS = 4
"""Best supported parts, from which the whole model is grown anew."""
HOPEFUL_TURN = 0.6
"""Share of its score from which on a part that was turned over is grown from."""


@dataclass(frozen=True)
class RepairOptions(CheckedOptions):
    """How hard wrong answers are repaired."""

    rounds: Natural = 10
    """How often all solutions are repaired, at most; the effort may allow fewer."""
    solutions: Count = 4
    """Distinct solutions that are repaired side by side, of a model of few parts, ..."""
    early_rounds: Natural = 2
    """... for so many rounds, and after that only ..."""
    late_solutions: Count = 2
    """... so many."""
    gain: NotNegative = 0.006
    """A round without this gain of score is the last."""
    margin: NotNegative = 0.12
    """Solutions worse than the best by more than this are not worth repairing."""
    alternatives: Count = 16
    """Regrown configurations kept per move."""
    refined: Count = 8
    """Moves per solution that are refined, ..."""
    varied: Natural = 8
    """... and others that change whole limbs: before it is refined, a limb brought to its place scores less than the
    many moves that change next to nothing, ..."""
    hopeful: NotNegative = 0.06
    """... if they score, before that, no worse than the best solution by more than this."""
    narrow: Natural = 6
    """Moves, the best before refinement, that are refined from a narrow scale too: it does not undo what a sweep got
    right."""
    held_limbs: Natural = 16
    """Joints about which all the rest is swept or grown anew, those first that most of the model's surface hangs on."""
    turned_parts: Count = 3
    """Largest parts that are turned by half a revolution and, where they are thin, slid across by their thickness."""
    unexplained: Share = 0.006
    """Share of scan points far from the model below which nothing is missing, and only the best solution is
    repaired, ..."""
    much_unexplained: Share = 0.1
    """... and above which every solution has votes, not only the foremost: which one that is says little yet."""
    votes: VoteOptions = field(default_factory=VoteOptions)


def repair(
    search: TreeSearch,
    candidates: Candidates,
    options: RepairOptions,
    *,
    turn: bool,
    enough: Callable[[Candidates], bool] = lambda best: False,
) -> Candidates:
    """Return the distinct solutions after at most `options.rounds` rounds, best first; until the best is `enough`."""
    comparison = search.comparison
    solutions = comparison.distinct(candidates, options.solutions, search.options.distinct)
    done: set[tuple[float, ...]] = set()
    for round_ in range(options.rounds):
        worth = _worth_repair(search, solutions, options, round_)
        moved: list[Candidates] = []
        for rank in range(worth):
            solution = solutions.take([rank])
            where = np.concatenate([solution.bases[0, :3, 3], solution.values[0]])
            key = tuple(float(v) for v in np.round(where, 2))
            if key in done:
                continue
            done.add(key)
            tried = repair_moves(search, solution, options, round_, foremost=rank == 0, turn=turn and round_ == 0)
            if tried is not None:
                moved.append(search.sifted(tried, options.refined, options.varied))
        if not moved:
            break
        moves = Candidates.concatenate(moved)
        moves = moves.take(moves.scores > solutions.scores[0] - options.hopeful * _scale(solutions))
        if len(moves) == 0:
            break
        refined = [
            comparison.refined(moves, iterations=10, sigma=0.03),
            comparison.refined(moves.best_first().take(slice(options.narrow)), iterations=10, sigma=0.01),
        ]
        found = comparison.scored(Candidates.concatenate(refined))[0]
        in_vain = found.scores.max() <= solutions.scores[0] + options.gain
        solutions = comparison.distinct(
            Candidates.concatenate([solutions, found]), options.solutions, search.options.distinct
        )
        if in_vain or enough(solutions.take([0])):
            break
    return solutions


def _worth_repair(search: TreeSearch, solutions: Candidates, options: RepairOptions, round_: int) -> int:
    """Return how many of the solutions, best first, are repaired in a round."""
    comparison, best = search.comparison, solutions.take([0])
    # A scan that holds more than the model leaves something unexplained however good the answer.
    complete = comparison.coverage_scale > 1.0 and not comparison.lacks(best).any()
    if complete or comparison.unexplained(best) <= options.unexplained:
        return 1
    near = solutions.scores >= solutions.scores[0] - options.margin * _scale(solutions)
    most = options.solutions if round_ < options.early_rounds else options.late_solutions
    # Among other things the right answer may be behind several that lie in these.
    share = 1.0 if comparison.observation.scene or comparison.observation.cut_out else search.share_tried
    return min(int(near.sum()), max(1, round(most * share)))


def _scale(solutions: Candidates) -> float:
    """Return what score margins are multiplied by: in a scene scores go far beyond 1."""
    return max(1.0, float(solutions.scores[0]))


def repair_moves(
    search: TreeSearch, solution: Candidates, options: RepairOptions, seed: int, *, foremost: bool, turn: bool
) -> Candidates | None:
    """Return configurations that differ from `solution` where the evidence speaks against it; None if nowhere.

    Votes and sweeps, which cost most, are for the `foremost` solution.
    """
    comparison = search.comparison
    support = comparison.scored(solution)[1][0]
    unexplained = comparison.unexplained(solution)
    exists = comparison.exists
    bad = comparison.poorly_supported(support)
    missing = unexplained > options.unexplained
    moves: list[Candidates] = []
    placements = comparison.part_placements(solution)[0]
    if bad.any() or missing:
        moves += _regrown(search, solution, _Faults(support, bad, missing), options)
    if (bad.any() or missing) and not search.observation.scene:
        # In a scene this never won: close looks at what is near an answer have grown all from many such places.
        best = np.argsort(-support * exists * np.sqrt(comparison.weights), kind="stable")[:ROOTS]
        roots = np.array([i for i in best if exists[i]], np.int32)
        moves.append(search.grow(_placed(roots, placements[roots])))
    if (foremost and (missing or search.observation.scene)) or (
        unexplained > options.much_unexplained and not search.observation.scene
    ):
        # In a scene what is near and unexplained may be of other things: one look at all that is doubtful.
        ways = (True,) if search.observation.scene else (False, True)
        votes = [voted(search, solution, options.votes, seed, doubting=doubting) for doubting in ways]
        moves += [vote for vote in votes if vote is not None]
    elif foremost:
        # A part that is wrong leaves little unexplained where other surface lies near to its points.
        off = off_points(comparison, solution)[0]
        vote = voted(search, solution, options.votes, seed, doubting=True, off=off) if len(off) else None
        moves += [] if vote is None else [vote]
    if foremost:
        moves.append(_swept(comparison, solution, options))
    if turn:
        moves += _turned(search, placements, options)
        if not search.observation.single_view:
            moves += _slid(search, placements, options)
    return Candidates.concatenate(moves) if moves else None


@dataclass(frozen=True)
class _Faults:
    """What speaks against a solution."""

    support: Singles
    """(parts,)"""
    bad: Bools
    """(parts,) which parts the evidence speaks against."""
    missing: bool
    """Whether the scan holds points far from the model."""


def _regrown(search: TreeSearch, solution: Candidates, faults: _Faults, options: RepairOptions) -> list[Candidates]:
    """Cut the tree at joints near bad parts and grow one side anew while the other side stays."""
    comparison = search.comparison
    count, exists, parent = len(comparison.exists), comparison.exists, comparison.parent
    support, bad, missing = faults.support, faults.bad, faults.missing
    usual = float(np.median(support[exists]))
    below = subtrees(parent)
    near = bad | comparison.lacks(solution) if missing else bad.copy()
    if missing and count <= ALL_NEAR:
        near[:] = True
    else:
        # A part is often bad because an ancestor is slightly wrong.
        for _ in range(3):
            above = np.zeros(count, bool)
            above[parent[1:][near[1:]]] = True
            near |= above
    is_limb = np.zeros(count, bool)
    is_limb[1:] = _among_largest(comparison, options.held_limbs)[comparison.model.actuated[1:]]
    starts, nexts = [], []
    for i in range(1, count):
        for start, following, side in ((parent[i], i, below[i]), (i, parent[i], ~below[i])):
            outward = following == i
            if outward and not near[i]:
                continue
            if not outward and count > OUTWARD and not (is_limb[i] and support[i] > usual and bad[parent[i]]):
                continue
            if not (exists & side).any() or not (exists & ~side).any() or not (bad | missing)[side].any():
                continue
            starts.append(start)
            nexts.append(following)
    if not starts:
        return []
    return [search.regrown(solution, [0] * len(starts), starts, nexts, options.alternatives)]


def _swept(comparison: ScanComparison, solution: Candidates, options: RepairOptions) -> Candidates:
    """Sweep every joint with what hangs on it moving, some with all the rest, and compound joints whole.

    A growing beam takes what matches best; only whole configurations tell that a part is where it is hardly seen.
    """
    every = np.flatnonzero(_hanging(comparison) > 0.0).astype(np.int32)
    held = np.flatnonzero(_among_largest(comparison, options.held_limbs)).astype(np.int32)
    first, second = _compound_joints(comparison, comparison.lacks(solution))
    joint = np.concatenate([every, held, first])
    with_joint = np.concatenate([np.full(len(every) + len(held), -1, np.int32), second])
    base_moves = np.zeros(len(joint), bool)
    base_moves[len(every) : len(every) + len(held)] = True
    # Few points tell a score less well than those by which moves are dropped later.
    hopeless = 2.0 * options.hopeful * _scale(solution)
    return comparison.swept(solution, joint, base_moves, 3, with_joint, hopeless)


def _among_largest(comparison: ScanComparison, count: int) -> Bools:
    """Return which actuated joints (k,) are among the `count` that most of the model's surface hangs on."""
    hanging = _hanging(comparison)
    chosen = np.zeros(len(hanging), bool)
    chosen[np.argsort(-hanging, kind="stable")[:count]] = True
    return chosen


def _hanging(comparison: ScanComparison) -> Array:
    """Return the share of the model's surface that hangs on each actuated joint (k,)."""
    surface = subtrees(comparison.parent) @ (comparison.weights * comparison.exists)
    hanging = np.zeros(len(comparison.known.values))
    np.maximum.at(hanging, comparison.model.actuated[1:], surface[1:])
    return hanging


def _compound_joints(comparison: ScanComparison, lacking: Bools) -> tuple[Ints, Ints]:
    """Return pairs of actuated joints, inner and outer, between which no surface tells where to turn.

    The part between them has none, or explains too little, as does the part beyond: both are `lacking`.
    """
    actuated, parent = comparison.model.actuated, comparison.parent
    silent = ~comparison.exists
    outer = [i for i in range(1, len(parent)) if parent[i] > 0 and (silent | (lacking & lacking[i]))[parent[i]]]
    pairs = {(int(actuated[parent[i]]), int(actuated[i])) for i in outer if actuated[parent[i]] != actuated[i]}
    first, second = np.array(sorted(pairs), np.int32).reshape(-1, 2).T
    return np.ascontiguousarray(first), np.ascontiguousarray(second)


def _placed(parts: Ints, placements: Array) -> Hypotheses:
    return Hypotheses(np.ascontiguousarray(parts), np.ascontiguousarray(placements), np.zeros(len(parts), np.float32))


def _turned(search: TreeSearch, placements: Array, options: RepairOptions) -> list[Candidates]:
    """Turn each of the largest parts by half a revolution about its own and its frame's axes and grow from there."""
    comparison = search.comparison
    parts: list[int] = []
    turned: list[Array] = []
    for i in comparison.largest_parts(options.turned_parts):
        samples = comparison.surfaces[i].samples
        centre = (samples.min(axis=0) + samples.max(axis=0)) / 2
        axes = np.linalg.svd(samples - samples.mean(axis=0), full_matrices=False)[2]
        for axis in (*np.eye(3), *axes):
            half = np.eye(4)
            half[:3, :3] = rotation_about(axis, np.pi)
            half[:3, 3] = centre - half[:3, :3] @ centre
            parts.append(int(i))
            turned.append(placements[i] @ half)
    part = np.array(parts, np.int32)
    before = search.aligned(part, np.ascontiguousarray(placements[part]), 0)
    after = search.aligned(part, np.array(turned), 4)
    moved = np.array(
        [
            np.linalg.norm(comparison.surfaces[i].samples @ (a - b)[:3, :3].T + (a - b)[:3, 3], axis=1).mean()
            for i, a, b in zip(part, after.placements, before.placements, strict=True)
        ]
    )
    good = np.flatnonzero((after.scores > HOPEFUL_TURN * before.scores) & (moved > search.options.distinct))
    if len(good) == 0:
        return []
    after = after.take(good)
    return [search.grow(after.take(search.distinct_hypotheses(after, options.turned_parts, search.options.distinct)))]


def _slid(search: TreeSearch, placements: Array, options: RepairOptions) -> list[Candidates]:
    """Slide each of the largest parts, where it is thin, to where its one side takes the place of the other, and grow
    from there: points do not tell which side of it they are of."""
    parts: list[int] = []
    slid: list[Array] = []
    for i in search.comparison.largest_parts(options.turned_parts):
        for offset in _across(search.comparison.surfaces[i]):
            slide = np.eye(4)
            slide[:3, 3] = offset
            parts.append(int(i))
            slid.append(placements[i] @ slide)
    # Refined by itself, such a part would slide back.
    return [search.grow(_placed(np.array(parts, np.int32), np.array(slid)))] if parts else []


def _across(surface: Surface) -> Array:
    """Return the two offsets (2, 3) between the sides of a thin part, none (0, 3) of others."""
    samples, normals = surface.samples.astype(float), surface.normals.astype(float)
    axis = np.linalg.svd(samples - samples.mean(axis=0), full_matrices=False)[2][2]
    heights, along = samples @ axis, normals @ axis
    upper, lower = heights[along > FACING], heights[along < -FACING]
    if min(len(upper), len(lower)) == 0:
        return np.zeros((0, 3))
    thickness = float(np.median(upper) - np.median(lower))
    return np.array([-thickness * axis, thickness * axis]) if THIN[0] < thickness < THIN[1] else np.zeros((0, 3))
