"""The search for whole answers: hypotheses, growth, refinement and repair, as often as the effort and the scan ask."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from pwralign_kin.arrays import Singles
from pwralign_kin.estimation.answers.plainly_right import PLAIN_OFF, is_explained, is_plainly_right, off_surface
from pwralign_kin.estimation.comparison.candidates import Candidates
from pwralign_kin.estimation.comparison.continuation import priced
from pwralign_kin.estimation.comparison.ranking import better_ranked, ranked, ranks
from pwralign_kin.estimation.comparison.scan_comparison import ScanComparison
from pwralign_kin.estimation.evidence.evidence import gathered
from pwralign_kin.estimation.evidence.soundness import soundness
from pwralign_kin.estimation.knowledge.correspondences import Correspondences, oriented_pairs
from pwralign_kin.estimation.options import EstimatorOptions
from pwralign_kin.estimation.search.face_hypotheses import face_hypotheses
from pwralign_kin.estimation.search.hypotheses import Hypotheses
from pwralign_kin.estimation.search.reinterpretation import refined_both_ways, reinterpreted
from pwralign_kin.estimation.search.repair import repair
from pwralign_kin.estimation.search.scene_search import unlike
from pwralign_kin.estimation.search.tree_search import TreeSearch
from pwralign_kin.estimation.stopwatch import Stopwatch
from pwralign_kin.exceptions import CorrespondenceError
from pwralign_kin.model import ArticulatedModel
from pwralign_kin.se3 import Array

WARM_SIGMAS = (0.06, 0.03, 0.1)
"""Robust scales (model diagonals) that a guess is refined from, until the answer is plainly right."""
NUDGES, NUDGED, NUDGE_SIGMA = 3, 4, 0.04
"""How often in a row each joint of an answer near a guess is swept, at most, how many of the swept are then refined,
and from which robust scale: refinement alone leaves joints at values from which no small step is better."""
AGREED_DOUBT = 2.0
"""How many times as many points may be unexplained or off an answer that refinement from all scales comes to."""
UNCONVINCING = 0.015
"""A solution that leaves more than this share of the scan unexplained is searched on."""
HARDLY_SOUND = 0.3
"""So is one that is less sound and leaves more than that unexplained, whatever its parts explain."""
LACKING = 0.1
"""Share of the model's surface in parts that explain too little, from which an answer may lack whole limbs."""
NEAR_TIE = 0.08
"""Solutions within this score of the best are refined to the end and compared again, ..."""
FINE_SIGMA, FINE_SUPPORT = 0.012, 0.3
"""... from this robust scale (model diagonals), with this weight of model support."""
ABSENT = 0.2
"""Support below which a part is taken for one that a scan of all sides lacks."""
LEADING, FOREMOST, FEW_REFINED = 2, 4, 8
"""The largest parts, that may lead to an answer on their own; so many of their hypotheses are grown at first, and so
many of the configurations that come of it refined."""
QUIET, LED_DOUBT = 0.006, 1.5
"""Noise (model diagonals) up to which that is tried, and how many times as many points as of a plainly right answer may
be unexplained or off what it leads to: repair, which follows, explains some."""
RIVAL = 0.1
"""By how much less a leading part may fit somewhere else than there for that to lead to an answer that is as good."""
GROWN_FROM_BASE = 12
"""Configurations that are grown from each placement of a known base."""
READINGS = 5
"""How often in a row the surface of an answer is read otherwise, ..."""
READING_GAIN = 0.001
"""... as long as the scores that answers are ranked by gain this, ..."""
SOUND = 0.85
"""... and unless it is this sound."""
AGREE = 0.01
"""Two searches agree if the scores of their answers differ by less."""


@dataclass(frozen=True)
class Effort:
    """How much work a search may take."""

    searches: int
    """Searches with other samples, at most: ..."""
    until_agreed: bool
    """... until two agree, or else until one is convincing, in a scene until one has some confidence."""
    repairs: int
    """Rounds of repair, at most."""


@dataclass(frozen=True)
class Found:
    """The answers that a search ends with."""

    solutions: Candidates
    """Best first."""
    comparison: ScanComparison
    """What scored them, and compares them from then on."""


EFFORTS = {
    "fast": Effort(searches=1, until_agreed=False, repairs=3),
    "default": Effort(searches=2, until_agreed=False, repairs=10),
    "thorough": Effort(searches=5, until_agreed=True, repairs=16),
}
"""What the names of `EstimatorOptions.effort` stand for."""


class AnswerSearch:
    """The search for the answers to one scan of the model."""

    def __init__(
        self,
        model: ArticulatedModel,
        search: TreeSearch,
        options: EstimatorOptions,
        correspondences: Correspondences | None,
        watch: Stopwatch,
    ) -> None:
        """Take the prepared search, and correspondences of other sources."""
        self.model = model
        self.search = search
        self.comparison = search.comparison
        self.options = options
        self.effort = EFFORTS[options.effort]
        self.repairing = replace(options.repair, rounds=min(options.repair.rounds, self.effort.repairs))
        self.correspondences = correspondences
        self.watch = watch
        near = options.near
        self.near: Singles | None = None if near is None else search.observation.scaled(np.array([near]))

    def without_guess(self) -> Found:
        """Return the answers of searches from nothing, best first. `CorrespondenceError` if no part fits.

        Where the first finds nothing convincing, the others look at pieces of the scan as well, and take it that a
        single view has holes: all answers are compared so, from then on.
        """
        several: list[Candidates] = []
        for attempt in range(self.effort.searches):
            search = self.search if attempt == 0 else TreeSearch(self.comparison.tolerant())
            seed = self.options.seed + attempt
            found = self._further_search(seed, search, self._distinct(several)) if several else self._first_search(seed)
            several.append(found)
            several = [search.comparison.scored(found)[0].best_first() for found in several]
            best = self._distinct(several)
            if self._is_settled(best, several):
                break
        return Found(best, search.comparison)

    def from_guess(self, base: Array, values: Array) -> Found:
        """Return the answers near a guess, best first; those of a search as well where it leaves much unexplained."""
        solutions = self._near_guess(Candidates.single(base, values))
        if self.comparison.unexplained(solutions.take([0])) <= UNCONVINCING:
            return Found(solutions, self.comparison)
        anywhere = self.without_guess()
        rescored = anywhere.comparison.scored(solutions)[0]
        return Found(self._distinct([rescored, anywhere.solutions]), anywhere.comparison)

    def _near_guess(self, start: Candidates) -> Candidates:
        """Return the answers near one configuration, best first; one alone that is plainly right."""
        search, comparison = self.search, self.comparison
        with self.watch.stage("refinement"):
            found: list[Candidates] = []
            for answer in self._refined_from_all_scales(start):
                if is_plainly_right(comparison, answer):
                    return answer
                found.append(answer)
            refined = Candidates.concatenate(found).best_first()
            agreed = len(comparison.distinct(refined, len(refined), search.options.alike)) == 1
            if agreed and is_plainly_right(comparison, refined.take([0]), AGREED_DOUBT):
                return refined.take([0])
            # Where only what is not seen speaks against an answer, no joint on its own is what is wrong.
            if not is_explained(comparison, refined.take([0])):
                refined = Candidates.concatenate([self._nudged(refined.take([0])), refined])
                if is_plainly_right(comparison, refined.take([0])):
                    return refined.take([0])
        with self.watch.stage("repair"):
            first = repair(search, refined, self.repairing, turn=False, enough=partial(is_plainly_right, comparison))
            if is_plainly_right(comparison, first.take([0])):
                return first
            return self._reinterpreted(search, first)

    def _refined_from_all_scales(self, start: Candidates) -> Iterator[Candidates]:
        for sigma in WARM_SIGMAS:
            yield self.comparison.scored(self.comparison.refined(start, iterations=25, sigma=sigma))[0]

    def _nudged(self, answer: Candidates) -> Candidates:
        """Return one answer with joints moved to where they are better, until it is plainly right or nothing gains."""
        comparison = self.comparison
        joints = np.arange(answer.values.shape[1], dtype=np.int32)
        for _ in range(NUDGES):
            moved = comparison.swept(answer, joints, np.zeros(len(joints), bool), keep=1).best_first()
            refined = comparison.refined(moved.take(slice(NUDGED)), sigma=NUDGE_SIGMA)
            several = Candidates.concatenate([answer, comparison.scored(refined)[0]])
            before, answer = answer, several.best_first().take([0])
            gained = answer.scores[0] > before.scores[0] + self.repairing.gain
            if not gained or is_plainly_right(comparison, answer):
                break
        return answer

    def finished(self, found: Found) -> Candidates:
        """Refine near-ties to the end with all points and rank them by coarse and tight scores together."""
        solutions, comparison = found.solutions, found.comparison
        if self.near is not None:
            passing = solutions.take(comparison.passes(solutions, self.near))
            solutions = passing if len(passing) else solutions
        near = solutions.take(solutions.scores > solutions.scores[0] - NEAR_TIE)
        points = comparison.options.fine_points
        fine = comparison.refined(near, points=points, iterations=20, sigma=FINE_SIGMA, support_weight=FINE_SUPPORT)
        if not comparison.observation.single_view:
            # Parts that the scan lacks must not be pulled to their neighbours' points.
            absent = comparison.exists & (comparison.scored(fine)[1] < ABSENT)
            again = absent.any(axis=1)
            if again.any():
                weights = np.ascontiguousarray(comparison.weights * ~absent[again], np.float32)
                mended = comparison.refined(
                    fine.take(again), points=points, sigma=FINE_SIGMA, support_weight=FINE_SUPPORT, part_weights=weights
                )
                fine.bases[again], fine.values[again] = mended.bases, mended.values
        if not comparison.observation.scene:
            return ranked(comparison, fine)
        return priced(comparison, better_ranked(comparison, near, fine)).best_first()

    def _is_settled(self, best: Candidates, several: list[Candidates]) -> bool:
        """Return whether another search would be in vain."""
        as_good = sum(float(best.scores[0] - own.scores[0]) < AGREE for own in several)
        if as_good > 1:
            return True
        if self.effort.until_agreed or not (self._is_convincing(best.take([0])) and self._is_close(best.take([0]))):
            return False
        # Among other things, a wrong answer may explain enough for all of its parts.
        explained = self.comparison.unexplained(best.take([0])) <= UNCONVINCING
        return explained or self._soundness(self.comparison, best) >= HARDLY_SOUND

    def _is_convincing(self, best: Candidates) -> bool:
        """Return whether an answer to a scan of the model leaves little unexplained that parts of it lack."""
        # A scan that holds more than the model leaves something unexplained however good the answer.
        if self.comparison.is_contradicted(best):
            return False
        return self._lacking(best) <= LACKING or self.comparison.unexplained(best) <= UNCONVINCING

    def _lacking(self, best: Candidates) -> float:
        """Return the share of the model's surface in parts that explain too little."""
        return float(self.comparison.weights[self.comparison.lacks(best)].sum())

    def _is_close(self, best: Candidates) -> bool:
        """Return whether an answer that lacks parts lies as close to the scan as a right one would."""
        if self._lacking(best) <= LACKING:
            return True
        distance = self.comparison.owners(best, self.comparison.exists)[0]
        return float(off_surface(self.comparison, distance).mean()) <= PLAIN_OFF

    def _first_search(self, seed: int) -> Candidates:
        """Search a scan of the model. `CorrespondenceError` if no part fits."""
        leading = self._leading(seed)
        found = None if leading is None else self._led_to(leading)
        if found is None:
            hypotheses = self._hypotheses(seed, self.search, leading)
            if len(hypotheses.parts) == 0:
                raise self._nothing_placed
            found = self._refined(self.search, self._grown(self.search, hypotheses))
        with self.watch.stage("repair"):
            return self.repaired(found)

    def _leading(self, seed: int) -> Hypotheses | None:
        """Return the pair hypotheses of the leading parts where these may tell all: of a scan from all sides, whose
        noise hides no limb, if nothing else is known. None elsewhere."""
        sources, observation = self.options.sources, self.search.observation
        told = self.near is not None or self.comparison.known.near
        informed = told or self.correspondences is not None or "fpfh" in sources
        if informed or "pairs" not in sources or observation.single_view or observation.noise > QUIET:
            return None
        with self.watch.stage("hypotheses"):
            return self.search.pair_hypotheses(seed, self.search.root_parts[:LEADING])

    def _led_to(self, leading: Hypotheses) -> Candidates | None:
        """Return what grows from the foremost of the leading parts' hypotheses, refined, if that explains the scan and
        hardly lacks parts: what a scan lacks may be anywhere. None if not.

        Another answer that explains it as well has these parts where this one has them, and grows from there, or
        elsewhere, where they fit as well: from all such places is grown, too.
        """
        search = self.search
        ordered = search.promising(leading)
        foremost, others = ordered.take(slice(FOREMOST)), ordered.take(slice(FOREMOST, None))
        if len(foremost.parts) == 0:
            return None
        found = self._refined(search, self._grown(search, foremost), most=FEW_REFINED)
        best = found.best_first().take([0])
        if not is_explained(self.comparison, best, LED_DOUBT) or self._lacking(best) > LACKING:
            return None
        rivals = others.take(search.rivalling(others, best, RIVAL))
        if len(rivals.parts) == 0:
            return found
        elsewhere = self._refined(search, self._grown(search, rivals), most=FEW_REFINED)
        return Candidates.concatenate([found, elsewhere])

    def _further_search(self, seed: int, search: TreeSearch, before: Candidates) -> Candidates:
        """Search a scan of the model by other samples, and its pieces too, until they lead to the best answer found
        `before` again; return what was found before where all of the scan does without repair."""
        comparison = search.comparison
        several, hypotheses = [before], self._hypotheses(seed, search)
        if len(hypotheses.parts) > 0:
            several = [self._grown(search, hypotheses)]
            if self._is_confirmed(search, before, several[0]):
                return before
        if "pairs" in self.options.sources:
            with self.watch.stage("hypotheses"):
                in_pieces = search.piecewise_hypotheses(seed)
            with self.watch.stage("growth"):
                several += [search.grow(in_pieces, search.options.beam)] if len(in_pieces.parts) > 0 else []
        found = self._refined(search, Candidates.concatenate(several), times=2)
        known = comparison.scored(before.take([0]))[0]
        enough = partial(self._is_known, comparison, known)
        with self.watch.stage("repair"):
            repaired = repair(search, found, self.repairing, turn=True, enough=enough)
            if enough(repaired.take([0])):
                return self._distinct([comparison.scored(before)[0], repaired])
            return self._reinterpreted(search, repaired)

    def _is_confirmed(self, search: TreeSearch, before: Candidates, grown: Candidates) -> bool:
        """Return whether what has `grown` from other samples of the scan comes to the best answer of a search `before`
        without repair."""
        # Through holes a view seems to look past the model: all of it may lead to one wrong answer again.
        if search.observation.single_view:
            return False
        return _is_one(search.comparison, before.take([0]), self._refined(search, grown).best_first().take([0]))

    def _is_known(self, comparison: ScanComparison, known: Candidates, found: Candidates) -> bool:
        """Return whether an answer that was `found` is `known`, and no better than it was."""
        return found.scores[0] <= known.scores[0] + self.repairing.gain and _is_one(comparison, known, found)

    def grown_beside(self, start: Candidates, seed: int) -> Candidates:
        """Return what grows from hypotheses, and a configuration to `start` from, refined; that alone if there are
        none."""
        hypotheses = self._hypotheses(seed, self.search)
        if len(hypotheses.parts) == 0:
            return start
        return self._refined(self.search, self._grown(self.search, hypotheses), start)

    def _grown(self, search: TreeSearch, hypotheses: Hypotheses) -> Candidates:
        """Return the configurations that grow from hypotheses, and from a known base."""
        with self.watch.stage("growth"):
            grown = search.grow(hypotheses, search.options.beam)
            if search.comparison.known.near:
                from_base = search.widened().grow_from_bases(search.comparison.known.bases(), GROWN_FROM_BASE)
                grown = Candidates.concatenate([from_base, grown])
        return grown

    def _refined(
        self,
        search: TreeSearch,
        grown: Candidates,
        start: Candidates | None = None,
        *,
        times: int = 1,
        most: int | None = None,
    ) -> Candidates:
        """Return the most promising of what has grown, so many `times` as many as usual or at `most` so many, and a
        configuration to `start` from, refined."""
        with self.watch.stage("refinement"):
            count = search.options.refined + search.many * search.options.more_refined
            kept = search.sifted(grown, most or times * count)
            if start is not None:
                kept = Candidates.concatenate([start, kept])
            return search.comparison.scored(search.comparison.refined(kept))[0]

    def repaired(self, candidates: Candidates) -> Candidates:
        """Return candidates repaired, best first, the surface of the best read otherwise unless it is sound."""
        return self._reinterpreted(self.search, repair(self.search, candidates, self.repairing, turn=True))

    def _reinterpreted(self, search: TreeSearch, solutions: Candidates) -> Candidates:
        """Read the surface of the best solution otherwise unless it is sound, and repair what comes out."""
        comparison = search.comparison
        best = None
        if self._soundness(comparison, solutions) < SOUND:
            best = self._read_otherwise(search, solutions.take([0]))
        if best is None:
            return solutions
        others = unlike(comparison, solutions, [best], search.options.distinct)
        # The others were repaired before.
        few = replace(self.repairing, rounds=1, early_rounds=0, late_solutions=1)
        read = repair(search, Candidates.concatenate([best, others]), few, turn=False)
        before, after = ranks(comparison, Candidates.concatenate([solutions.take([0]), read.take([0])]))
        return read if after >= before + READING_GAIN else solutions

    def _read_otherwise(self, search: TreeSearch, solution: Candidates) -> Candidates | None:
        """Return a better configuration with nearly the same surface, None if none is found.

        The tight score decides as well: the surfaces differ by little.
        """
        comparison = search.comparison
        # What refinement alone would gain is no merit of another reading.
        best = start = ranked(comparison, refined_both_ways(comparison, solution)).take([0])
        for _ in range(READINGS):
            found = reinterpreted(self.model, search, best, self.options.reinterpretation)
            if found is None:
                break
            better = ranked(comparison, Candidates.concatenate([best, found])).take([0])
            if better.scores[0] < best.scores[0] + READING_GAIN:
                break
            best = better
        return comparison.scored(best)[0] if best is not start else None

    def _soundness(self, comparison: ScanComparison, solutions: Candidates) -> float:
        """Return how sound the best of several solutions is."""
        return soundness(gathered(comparison, solutions.take([0]), solutions))

    def _distinct(self, several: list[Candidates]) -> Candidates:
        together = Candidates.concatenate(several)
        return self.comparison.distinct(together, self.repairing.solutions, self.comparison.options.distinct)

    def _hypotheses(self, seed: int, search: TreeSearch, leading: Hypotheses | None = None) -> Hypotheses:
        """Return the part hypotheses that are grown, those of the `leading` parts among them if these are known.

        Those of faces are few and do not compete with the others: a large part of which one face is seen scores less
        than small ones that lie anywhere on it.
        """
        with self.watch.stage("hypotheses"):
            sources = self.options.sources
            found = self._outside(seed)
            if "pairs" in sources:
                known, parts = ([], search.root_parts) if leading is None else ([leading], search.root_parts[LEADING:])
                found = Hypotheses.concatenate([*known, search.pair_hypotheses(seed, parts), found])
            promising = search.promising(found)
            if "faces" not in sources:
                return promising
            largest = search.comparison.largest_parts(search.options.root_parts)
            return Hypotheses.concatenate([promising, face_hypotheses(search, largest, self.options.faces)])

    def _outside(self, seed: int) -> Hypotheses:
        """Return part hypotheses from correspondences: those given, and those of the built-in features."""
        search = self.search
        given = [] if self.correspondences is None else [self.correspondences]
        if "fpfh" in self.options.sources:
            largest = search.comparison.largest_parts(search.options.root_parts)
            given.append(self.options.fpfh.match(self.model, search.observation, largest.tolist()))
        oriented = [oriented_pairs(pairs, self.model, search.observation) for pairs in given]
        return Hypotheses.concatenate(
            [Hypotheses.nothing(), *(search.correspondence_hypotheses(pairs, seed) for pairs in oriented)]
        )

    @property
    def _nothing_placed(self) -> CorrespondenceError:
        if not self.options.sources:
            fault = "no part could be placed in the scan: without sources only correspondences do, and none does"
            return CorrespondenceError("estimate", fault)
        return CorrespondenceError(
            "estimate",
            "nothing in the scan can be a part of the model: is it a scan of it, in the right unit, and of "
            "more than a line, a plane or a ball? A guess (initial / --base, --initial) is tried all the same",
        )


def _is_one(comparison: ScanComparison, one: Candidates, other: Candidates) -> bool:
    """Return whether two configurations (one each) are the same answer."""
    return len(comparison.distinct(Candidates.concatenate([one, other]), 2, comparison.options.distinct)) == 1
