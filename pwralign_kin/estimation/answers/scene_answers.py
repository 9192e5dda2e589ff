"""The search for whole answers to a scene: where the model may be, and close looks at that."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from pwralign_kin.estimation.answers.answer_search import AnswerSearch, Found
from pwralign_kin.estimation.comparison.candidates import Candidates
from pwralign_kin.estimation.comparison.continuation import best_priced, priced
from pwralign_kin.estimation.comparison.scan_comparison import ScanComparison
from pwralign_kin.estimation.evidence.confidence import confidence
from pwralign_kin.estimation.evidence.evidence import gathered
from pwralign_kin.estimation.evidence.soundness import soundness
from pwralign_kin.estimation.search.repair import repair
from pwralign_kin.estimation.search.scene_search import RegionSearch, explained_share, is_convincing, unlike
from pwralign_kin.estimation.search.tree_search import TreeSearch
from pwralign_kin.estimation.sensing.observation import LEAST_POINTS
from pwralign_kin.estimation.sensing.scene import close_up
from pwralign_kin.estimation.stopwatch import Stopwatch
from pwralign_kin.se3 import Array


@dataclass(frozen=True)
class _Look:
    """A close look at one candidate of a scene."""

    focused: ScanComparison
    """The scene about it."""
    closely: AnswerSearch
    """The search of what is about it as a scan of the model alone, ..."""
    found: Candidates
    """... what that found, ..."""
    best: Candidates
    """... and the best of these (one), scored in the scene."""


class SceneAnswerSearch(AnswerSearch):
    """The search for the answers to one scene, which the model is somewhere in."""

    def without_guess(self) -> Found:
        """Search a scene, region by region, and repair what is found, until an answer is sound."""
        options = self.options.scene_search
        regions = RegionSearch(
            self.search, options, self.near, pairs="pairs" in self.options.sources,
            faces=self.options.faces if "faces" in self.options.sources else None,
        )  # fmt: skip
        several: list[Candidates] = []
        answers: list[Candidates] = []
        looked: list[Candidates] = []
        again: list[Candidates] = []
        for attempt in range(self.effort.searches):
            seed = self.options.seed + attempt
            with self.watch.stage("regions"):
                found = regions.candidates(seed, self._outside(seed), further=attempt > 0)
            if found is None:
                raise self._nothing_placed
            several.append(found)
            left = unlike(self.comparison, Candidates.concatenate(several), answers, options.apart).best_first()
            if len(left):
                with self.watch.stage("repair"):
                    answers.append(self._repaired_one_by_one(seed, left, looked, further=attempt > 0))
            best = self._distinct(answers)
            if self._sureness(best) >= options.sure:
                break
            if len(unlike(self.comparison, best.take([0]), again, self.comparison.options.distinct)):
                with self.watch.stage("repair"):
                    answers.append(self._looked_at_again(seed, best.take([0])))
                best = self._distinct(answers)
                again.append(best.take([0]))
                if self._sureness(best) >= options.sure:
                    break
        return Found(best, self.comparison)

    def from_guess(self, base: Array, values: Array) -> Found:
        """Return the answers near a guess, best first, of which none is plainly right in a scene."""
        start = Candidates.single(base, values)
        with self.watch.stage("refinement"):
            refined = Candidates.concatenate(list(self._refined_from_all_scales(start))).best_first()
        with self.watch.stage("repair"):
            solutions = repair(self.search, refined, self.repairing, turn=False)
        # Things may touch the model.
        if self.comparison.unexplained(solutions.take([0])) > self.options.scene_search.unexplained:
            solutions = self._distinct([solutions, self.without_guess().solutions])
        return Found(solutions, self.comparison)

    def finished(self, found: Found) -> Candidates:
        """Finish what was found; of near-ties that one comes first that explains more and is clearly the likeliest.

        Scores also speak for answers of which little is in sight: nothing contradicts these. The lead in score that is
        part of the chances is that of the first for all: it is what is in question.
        """
        finished, comparison = super().finished(found), found.comparison
        explained = comparison.coverage(finished)
        more = np.flatnonzero(explained > explained[0])
        several = [finished.take([rank]) for rank in (0, *more)]
        chances = [confidence(gathered(comparison, one, finished)) for one in several]
        best = int(np.argmax(chances))
        if chances[best] < chances[0] + self.options.scene_search.likelier:
            return finished
        return finished.take(np.argsort(np.arange(len(finished)) != more[best - 1], kind="stable"))

    def _looked_at_again(self, seed: int, answer: Candidates) -> Candidates:
        """Return what a close look at one answer to a scene finds, itself if nothing.

        The look that found it was about a configuration of which limbs were elsewhere, and drew other samples.
        """
        look = self._look(seed + self.effort.searches, answer)
        return answer if look is None else self._repaired_in_scene(look)

    def _repaired_one_by_one(
        self, seed: int, candidates: Candidates, looked: list[Candidates], *, further: bool
    ) -> Candidates:
        """Look closely at the leading candidates of a scene, and repair what the best looks found, one by one, until
        one answer is convincing, or better than repair makes what the others found; in a `further` search the best
        alone."""
        comparison, options = self.comparison, self.options.scene_search
        looks = sorted(self._looks(seed, candidates, looked), key=lambda look: -look.best.scores[0])
        if not looks:
            return self._distinct([priced(comparison, candidates)])
        several: list[Candidates] = []
        finalists = 1 if further else max(1, round(options.finalists * self.search.share_tried))
        for look in looks[:finalists]:
            best = max((float(own.scores[0]) for own in several), default=-np.inf)
            if look.best.scores[0] < best - options.gained:
                break
            several.append(self._repaired_in_scene(look))
            if is_convincing(comparison, several[-1].take([0]), options):
                break
        return self._distinct(several)

    def _repaired_in_scene(self, look: _Look) -> Candidates:
        """Return the answers that repair makes of what a close look found, closely and then in the scene."""
        rounds = min(self.options.scene_search.rounds, self.repairing.rounds)
        short = replace(self.repairing, rounds=rounds, early_rounds=0)
        repaired = look.closely.repaired(look.found)
        solutions = repair(TreeSearch(look.focused), look.focused.scored(repaired)[0], short, turn=False)
        # No repair knows what surface goes on beyond an answer: the best in the scene may have been dropped.
        return self._distinct([look.best, priced(self.comparison, self.comparison.scored(solutions)[0])])

    def _looks(self, seed: int, candidates: Candidates, looked: list[Candidates]) -> Iterator[_Look]:
        """Yield close looks at the candidates of a scene that score best, in turn with those that explain most, until
        one is convincing. What was `looked` at before is not looked at again; it grows.

        A true answer of which a part is still wrong loses to false ones that hide where nothing contradicts them, but
        it explains more.
        """
        comparison, options = self.comparison, self.options.scene_search
        scored = priced(comparison, candidates)
        rankings = scored, scored.with_scores(comparison.coverage(scored))
        for rank in range(max(1, round(options.leaders * self.search.share_tried))):
            left = unlike(comparison, rankings[rank % 2], looked, options.apart)
            if len(left) == 0:
                return
            leader = left.best_first().take([0])
            looked.append(leader)
            look = self._look(seed, leader)
            if look is None:
                continue
            looked.append(look.best)
            yield look
            if is_convincing(comparison, look.best, options):
                return

    def _look(self, seed: int, leader: Candidates) -> _Look | None:
        """Return a close look at one candidate of a scene, None if nothing is near it."""
        comparison = self.comparison
        focused = comparison.about(leader, self.options.scene_search.focus)
        if focused is comparison or focused.searched.sum() < LEAST_POINTS:
            return None
        closely = self._closely(focused)
        found = closely.grown_beside(leader, seed)
        return _Look(focused, closely, found, best_priced(comparison, comparison.scored(found)[0]))

    def _closely(self, focused: ScanComparison) -> AnswerSearch:
        """Return a search that takes the `focused` points of a scene for a scan of the model alone.

        Among so much less, more hypotheses are about the model, and all that is near it should be explained.
        """
        options, scene = self.options, self.search.observation
        view = close_up(scene, focused.searched, options.observation, options.scene, self.comparison.threads)
        # Its stages are all repair of the scene. Correspondences have had their say in the whole of it.
        search = TreeSearch(self.comparison.of(view))
        return AnswerSearch(self.model, search, options, None, Stopwatch(self.watch.progress))

    def _distinct(self, several: list[Candidates]) -> Candidates:
        """Return the best of several answers, and among them the best that is elsewhere, if any is."""
        best, together = super()._distinct(several), Candidates.concatenate(several).best_first()
        elsewhere = unlike(self.comparison, together, [best.take([0])], self.options.scene_search.apart)
        if len(elsewhere) == 0 or len(unlike(self.comparison, best, [best.take([0])], self.options.scene_search.apart)):
            return best
        return Candidates.concatenate([best.take(slice(max(1, self.repairing.solutions - 1))), elsewhere.take([0])])

    def _sureness(self, solutions: Candidates) -> float:
        """Return the confidence in the best of several answers to a scene; 0 where it is neither sound nor explains so
        much that the model must be there, or leaves too much of what is near it unexplained."""
        best, options = solutions.take([0]), self.options.scene_search
        evidence = gathered(self.comparison, best, solutions)
        if 1.0 - evidence.explained > options.unexplained or evidence.continued > options.continued:
            return 0.0
        sound = soundness(evidence) >= options.sound
        return confidence(evidence) if sound or explained_share(self.comparison, best) >= options.located else 0.0
