"""The last word on an answer: whether it is better with limbs held otherwise, or a joint at its other limit.

How closely the points lie on it tells of limbs what the scores of whole answers hardly do. And no step of any search
leads over the gap between the limits of a joint that turns nearly all around.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pwralign_kin.estimation.answers.answer_search import LACKING, repairing_within
from pwralign_kin.estimation.answers.mending import mended
from pwralign_kin.estimation.answers.scant_limbs import scant_limbs_held
from pwralign_kin.estimation.comparison.candidates import Candidates
from pwralign_kin.estimation.comparison.continuation import priced
from pwralign_kin.estimation.comparison.off_points import off_points
from pwralign_kin.estimation.comparison.ranking import ranked, ranks
from pwralign_kin.estimation.comparison.scan_comparison import ScanComparison
from pwralign_kin.estimation.options import EstimatorOptions
from pwralign_kin.estimation.refinement.joint_least_squares import JointLeastSquares
from pwralign_kin.estimation.search.reinterpretation import refined_both_ways
from pwralign_kin.estimation.search.repair import repair
from pwralign_kin.estimation.search.tree_search import TreeSearch
from pwralign_kin.estimation.search.voting import limbs_voted
from pwralign_kin.estimation.sensing.observation import LEAST_POINTS
from pwralign_kin.estimation.sensing.scene import close_up
from pwralign_kin.model import ArticulatedModel

GAIN = 0.005
"""What another answer must gain of the scores that answers are ranked by."""
UNEXPLAINED = 0.1
"""Share of what is near to an answer to a scene that it leaves unexplained, from which on limbs of it may be elsewhere
though none lacks points."""
CLEARLY = 0.02
"""What an answer to a scene that holds whole limbs elsewhere must gain of them, ..."""
VOTED, ROUNDS = 24, 4
"""... how many ways to hold limbs are tried, and as many that differ most, and rounds of repair of these."""
AT_LIMIT = 1e-6
"""A joint this near to its limit (rad) is held there."""
GAP = float(np.radians(90.0))
"""Angle from limit to limit, the short way, up to which a joint held at one may be meant to be at the other."""
TURNS, HELD = 3, 0.01
"""How often in a row a mended answer, or one to a scene, is repaired at the end, as long as that gains, and how far
(model diagonals) most of a scene's answer may move meanwhile: it is limbs that are repaired."""


def contested(
    solver: JointLeastSquares, final: Candidates, finished: Candidates, options: EstimatorOptions
) -> Candidates | None:
    """Return the answers that the search `finished` with behind a better one: `final` (one) mended, or across a limit,
    or in a scene with limbs held elsewhere, as others that it found may have them.

    None where there is none.
    """
    comparison = solver.comparison
    if comparison.known.held:
        return None
    if comparison.observation.scene:
        won = _repaired_in_scene(solver, final, finished, options)
        return None if won is None else Candidates.concatenate([won, finished])
    better = _mended_by_turns(solver.model, comparison, final, options)
    final = final if better is None else better  # which may be held at a limit too
    won = _better(comparison, final, _across_limits(solver, final))
    won = better if won is None else won
    held = scant_limbs_held(solver, final if won is None else won)
    won = won if held is None else held
    return None if won is None else Candidates.concatenate([won, finished])


def _mended_by_turns(
    model: ArticulatedModel, comparison: ScanComparison, final: Candidates, options: EstimatorOptions
) -> Candidates | None:
    """Return the final configuration mended, and repaired and mended again as long as parts lie off their points and
    that gains; None where nothing does."""
    found = mended(model, comparison, final, options.repair.votes)
    repairing = replace(repairing_within(options), early_rounds=0, late_solutions=1)
    for _ in range(TURNS):
        if found is None or len(off_points(comparison, found)[0]) == 0:
            break
        repaired = repair(TreeSearch(comparison), comparison.scored(found)[0], repairing, turn=False)
        better = _better(comparison, found, repaired)
        if better is None:
            break
        again = mended(model, comparison, better, options.repair.votes)
        found = better if again is None else again
    return found


def _repaired_in_scene(
    solver: JointLeastSquares, final: Candidates, finished: Candidates, options: EstimatorOptions
) -> Candidates | None:
    """Return the final configuration, or another that was found, with limbs held otherwise, if that gains in what is
    near it in the scene.

    Before, repair is short, for there are other answers to be told from this one; and only when all else is refined to
    the end do the scores tell which small part is wrong.
    """
    comparison = solver.comparison
    near = _near(comparison, final, options)
    other = None if near is None else _with_limbs_elsewhere(*near, final, finished, options)
    if other is not None:
        near = _near(comparison, other, options)
    answer = start = final if other is None else other
    for _ in range(TURNS):
        better = None if near is None else _better_held(solver.model, *near, answer, start, options)
        if better is None:
            break
        answer = better
    return None if answer is final else priced(comparison, ranked(comparison, answer))


def _near(
    comparison: ScanComparison, answer: Candidates, options: EstimatorOptions
) -> tuple[ScanComparison, ScanComparison] | None:
    """Return the comparison with what is near to an answer (one) in a scene, and with that as a scan of the model
    alone; None if hardly anything is, or all."""
    focused = comparison.about(answer, options.scene_search.focus)
    if focused.searched.sum() < LEAST_POINTS or focused is comparison:
        return None
    scene, threads = comparison.observation, comparison.threads
    return focused, comparison.of(close_up(scene, focused.searched, options.observation, options.scene, threads))


def _with_limbs_elsewhere(
    focused: ScanComparison, close: ScanComparison, final: Candidates, finished: Candidates, options: EstimatorOptions
) -> Candidates | None:
    """Return an answer (one) to a scene, `focused` on what is near the `final` one, that is clearly better than that
    and all that the search `finished` with; None if none is found, or no limb is in doubt.

    Every limb is doubted in turn, `close` up, and what comes of that is repaired with wide beams beside all the others:
    limbs of two of them may each be right, held by a small part that is so in neither.
    """
    complete = focused.weights[focused.lacks(final)].sum() <= LACKING
    if complete and focused.unexplained(final) <= UNEXPLAINED:
        return None
    known = Candidates.concatenate([final, finished])
    # What refinement alone would gain is no merit of a repair.
    settled = ranked(focused, refined_both_ways(focused, known))
    search = TreeSearch(close)
    votes = limbs_voted(search, settled.take([0]), options.repair.votes, options.seed)
    if votes is not None:
        promising = search.sifted(votes, VOTED, VOTED)
        known = Candidates.concatenate([known, settled.take([0]), close.refined(promising, iterations=10)])
    repairing = repairing_within(options)
    repairing = replace(repairing, rounds=min(ROUNDS, repairing.rounds))
    repaired = repair(TreeSearch(focused).widened(), focused.scored(known)[0], repairing, turn=False)
    several = Candidates.concatenate([settled, refined_both_ways(focused, repaired)])
    scores = priced(focused, several.with_scores(ranks(focused, several))).scores
    best = int(np.argmax(scores))
    return several.take([best]) if scores[best] >= scores[: len(settled)].max() + CLEARLY else None


def _better_held(
    model: ArticulatedModel,
    focused: ScanComparison,
    close: ScanComparison,
    answer: Candidates,
    final: Candidates,
    options: EstimatorOptions,
) -> Candidates | None:
    """Return an answer (one) to a scene, `focused` on what is near it, with limbs held better, that leaves most of the
    surface where the `final` one has it; None if none is found."""
    # What refinement alone would gain is no merit of a repair.
    settled = ranked(focused, refined_both_ways(focused, answer))
    tried = refined_both_ways(focused, _otherwise(model, focused, close, answer, options))
    several = Candidates.concatenate([settled, _held(focused, tried, final)])
    scores = priced(focused, several.with_scores(ranks(focused, several))).scores
    best = int(np.argmax(scores))
    return several.take([best]) if scores[best] >= scores[: len(settled)].max() + GAIN else None


def _otherwise(
    model: ArticulatedModel,
    focused: ScanComparison,
    close: ScanComparison,
    answer: Candidates,
    options: EstimatorOptions,
) -> Candidates:
    """Return what repair makes of an answer (one) to a scene, `focused` on what is near it, and what mending makes of
    it `close` up; what repair with wide beams does too, where whole limbs may be lacking."""
    scored = focused.scored(answer)[0]
    # Nothing but the answer: what else comes up has most of the surface elsewhere.
    repairing = replace(repairing_within(options), early_rounds=0, late_solutions=1)
    search = TreeSearch(focused)
    found = [repair(search, scored, repairing, turn=False)]
    if focused.weights[focused.lacks(answer)].sum() > LACKING:
        found.append(repair(search.widened(), scored, repairing, turn=False))
    better = mended(model, close, answer, options.repair.votes)
    return Candidates.concatenate(found if better is None else [*found, better])


def _held(comparison: ScanComparison, several: Candidates, final: Candidates) -> Candidates:
    """Return those of several configurations that leave most of the surface where the final configuration has it."""
    apart = np.linalg.norm(comparison.probe_positions(several) - comparison.probe_positions(final), axis=-1)
    return several.take(np.median(apart, axis=1) <= HELD)


def _better(comparison: ScanComparison, final: Candidates, rivals: Candidates) -> Candidates | None:
    """Return the best of the rivals, refined, if its scores are better than those of the final configuration."""
    if len(rivals) == 0:
        return None
    # What refinement alone would gain is no merit of a rival.
    settled, refined = refined_both_ways(comparison, final), refined_both_ways(comparison, rivals)
    both = Candidates.concatenate([settled, refined])
    scores = ranks(comparison, both)
    best = int(np.argmax(scores))
    if scores[best] < scores[: len(settled)].max() + GAIN:
        return None
    return both.with_scores(scores).take([best])


def _across_limits(solver: JointLeastSquares, final: Candidates) -> Candidates:
    """Return the final configuration with each joint that is held at a limit at its other limit, if that is near.

    Joints that turn nearly all around stop at a limit on the way to a value beyond the other.
    """
    values, lower, upper = final.values[0], solver.lower, solver.upper
    gap = 2.0 * np.pi - (upper - lower)
    turns = ~solver.model.prismatic & ~solver.locked & (gap > 0.0) & (gap < GAP)
    other = np.where(values < lower + AT_LIMIT, upper, lower)
    held = np.flatnonzero(turns & ((values < lower + AT_LIMIT) | (values > upper - AT_LIMIT)))
    turned = np.tile(values, (len(held), 1))
    turned[np.arange(len(held)), held] = other[held]
    return Candidates(np.tile(final.bases, (len(held), 1, 1)), turned, np.zeros(len(held), np.float32))
