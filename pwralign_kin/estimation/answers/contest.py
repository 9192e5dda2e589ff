"""The last word on an answer: whether a rival that the points do not tell from it, or prefer, takes its place.

The search goes by what the scan shows of the model as well as by what the model explains of the scan. Where pieces of
the surface are missing, the first speaks against the truth; how closely the points lie on an answer does not. And no
step of any search leads over the gap between the limits of a joint that turns nearly all around.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from pwralign_kin.estimation.answers.answer_search import EFFORTS, WORTH_WIDE_BEAMS
from pwralign_kin.estimation.answers.mending import mended
from pwralign_kin.estimation.answers.ranking import finest, ranked, ranks
from pwralign_kin.estimation.evidence.evidence import Evidence, rivals_to
from pwralign_kin.estimation.options import EstimatorOptions
from pwralign_kin.estimation.refinement.joint_least_squares import JointLeastSquares
from pwralign_kin.estimation.refinement.likelihood import log_likelihoods
from pwralign_kin.estimation.search.candidates import Candidates
from pwralign_kin.estimation.search.continuation import priced
from pwralign_kin.estimation.search.reinterpretation import refined_both_ways
from pwralign_kin.estimation.search.repair import repair
from pwralign_kin.estimation.search.tree_search import TreeSearch
from pwralign_kin.estimation.sensing.observation import LEAST_POINTS
from pwralign_kin.estimation.sensing.scene import close_up
from pwralign_kin.model import ArticulatedModel

DISTINCT = 2.0
"""Standard deviations from which on points tell an answer from its rivals as they stand, before they are refined."""
GAIN = 0.005
"""What a rival must gain of the scores that answers are ranked by, ..."""
TIE, TIES = 0.01, 3
"""... and how much less it may have of them, and how many such rivals are looked at, if the points prefer it, ..."""
LIKELIER, ROUGHLY = 6.0, 3.0
"""... by this much of the logarithm of their likelihood on the model's own triangles, if it is not less by so much when
samples of the surface stand for them."""
AT_LIMIT = 1e-6
"""A joint this near to its limit (rad) is held there."""
GAP = float(np.radians(90.0))
"""Angle from limit to limit, the short way, up to which a joint held at one may be meant to be at the other."""
TURNS, HELD = 3, 0.01
"""How often in a row an answer to a scene is repaired at the end, as long as that gains, and how far (model diagonals)
most of its surface may move meanwhile: it is limbs that are repaired, and another answer has lost already."""


def contested(
    solver: JointLeastSquares,
    final: Candidates,
    evidence: Evidence,
    finished: Candidates,
    equal: Candidates,
    options: EstimatorOptions,
) -> Candidates | None:
    """Return the answers that the search `finished` with behind a better one: `final` (one) mended, or a rival of it.

    `evidence` is that for the configuration before it is mended, and those `equal` to that are no rivals. None where
    there is no such rival.
    """
    search = solver.search
    if search.known.held:
        return None
    if search.observation.scene:
        won = _repaired_in_scene(solver, final, options)
        return None if won is None else Candidates.concatenate([won, finished])
    better = mended(solver.model, search, final)
    final = final if better is None else better  # which has its rivals too
    rivals = _across_limits(solver, final)
    if evidence.distinct < DISTINCT:
        rivals = Candidates.concatenate([rivals, rivals_to(search, final, finished)])
    won = _better(search, final, rivals)
    if won is None:
        won = _likelier(solver, final, finished, equal)
    won = better if won is None else won
    return None if won is None else Candidates.concatenate([won, finished])


def _repaired_in_scene(solver: JointLeastSquares, final: Candidates, options: EstimatorOptions) -> Candidates | None:
    """Return the final configuration with limbs held otherwise, if that gains in what is near it in the scene.

    Before, repair is short, for there are other answers to be told from this one; and only when all else is refined to
    the end do the scores tell which small part is wrong.
    """
    search, answer = solver.search, final
    focused = search.about(answer, options.scene_search.focus)
    if focused.searched.sum() < LEAST_POINTS or focused is search:
        return None
    view = close_up(search.observation, focused.searched, options.observation, options.scene, search.threads)
    close = search.of(view)
    for _ in range(TURNS):
        better = _better_held(solver.model, focused, close, answer, final, options)
        if better is None:
            break
        answer = better
    return None if answer is final else priced(search, ranked(search, answer))


def _better_held(
    model: ArticulatedModel,
    focused: TreeSearch,
    close: TreeSearch,
    answer: Candidates,
    final: Candidates,
    options: EstimatorOptions,
) -> Candidates | None:
    """Return an answer (one) to a scene, `focused` on what is near it, with limbs held better, that leaves most of the
    surface where the `final` one has it; None if none is found."""
    # What refinement alone would gain is no merit of a repair.
    settled = ranked(focused, refined_both_ways(focused, answer))
    for otherwise in _otherwise(model, focused, close, answer, options):
        tried = refined_both_ways(focused, otherwise)
        several = Candidates.concatenate([settled, _held(focused, tried, final)])
        scores = priced(focused, Candidates(several.bases, several.values, ranks(focused, several))).scores
        best = int(np.argmax(scores))
        if scores[best] >= scores[: len(settled)].max() + GAIN:
            return several.take([best])
    return None


def _otherwise(
    model: ArticulatedModel, focused: TreeSearch, close: TreeSearch, answer: Candidates, options: EstimatorOptions
) -> Iterator[Candidates]:
    """Yield what repair makes of an answer (one) to a scene, `focused` on what is near it, and what mending makes of
    it `close` up; then what repair with wide beams makes of it, where it lacks much."""
    scored, effort = focused.scored(answer)[0], EFFORTS[options.effort]
    # Nothing but the answer: what else comes up has most of the surface elsewhere.
    repairing = replace(
        options.repair, rounds=min(options.repair.rounds, effort.repairs), early_rounds=0, late_solutions=1
    )
    repaired, better = repair(focused, scored, repairing, turn=False), mended(model, close, answer)
    yield repaired if better is None else Candidates.concatenate([repaired, better])
    if effort.wide_beams and focused.weights[focused.lacks(answer)].sum() > WORTH_WIDE_BEAMS:
        yield repair(focused.widened(), scored, repairing, turn=False)


def _held(search: TreeSearch, several: Candidates, final: Candidates) -> Candidates:
    """Return those of several configurations that leave most of the surface where the final configuration has it."""
    apart = np.linalg.norm(search.probe_positions(several) - search.probe_positions(final), axis=-1)
    return several.take(np.median(apart, axis=1) <= HELD)


def _better(search: TreeSearch, final: Candidates, rivals: Candidates) -> Candidates | None:
    """Return the best of the rivals, refined, if its scores are better than those of the final configuration."""
    if len(rivals) == 0:
        return None
    # What refinement alone would gain is no merit of a rival.
    settled, refined = refined_both_ways(search, final), refined_both_ways(search, rivals)
    both = Candidates.concatenate([settled, refined])
    scores = ranks(search, both)
    best = int(np.argmax(scores))
    if scores[best] < scores[: len(settled)].max() + GAIN:
        return None
    return Candidates(both.bases, both.values, scores).take([best])


def _likelier(
    solver: JointLeastSquares, final: Candidates, finished: Candidates, equal: Candidates
) -> Candidates | None:
    """Return which of the other answers that `finished` with nearly the same scores the points clearly prefer."""
    search = solver.search
    near = finished.take(finished.scores >= finished.scores[0] - TIE)
    known = Candidates.concatenate([final, equal])
    several = Candidates.concatenate([known, near])
    in_order = Candidates(several.bases, several.values, -np.arange(len(several), dtype=np.float32))
    distinct = search.distinct(in_order, len(several), search.options.distinct)
    order = np.rint(-distinct.scores).astype(np.int64) - len(known)
    rivals = near.take(order[order >= 0][:TIES])
    if len(rivals) == 0:
        return None
    together = Candidates.concatenate([final, rivals])
    rough = finest(search, together) * len(search.observation.given)
    together = together.take(np.append(0, np.flatnonzero(rough[1:] > rough[0] - ROUGHLY) + 1))
    if len(together) == 1:
        return None
    likelihoods = log_likelihoods(solver, together)
    best = int(np.argmax(likelihoods))
    return together.take([best]) if likelihoods[best] > likelihoods[0] + LIKELIER else None


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
