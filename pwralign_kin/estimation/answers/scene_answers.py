"""The search for whole answers to a scene: where the model may be, and close looks at that."""

from __future__ import annotations

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
from pwralign_kin.estimation.search.scene_search import RegionSearch, is_at, is_convincing, unlike
from pwralign_kin.estimation.search.tree_search import TreeSearch
from pwralign_kin.estimation.sensing.observation import LEAST_POINTS
from pwralign_kin.estimation.sensing.scene import Bools, close_up
from pwralign_kin.estimation.stopwatch import Stopwatch
from pwralign_kin.se3 import Array


@dataclass(frozen=True)
class _Look:
    """A close look at one place in a scene."""

    focused: ScanComparison
    """The scene about it."""
    closely: AnswerSearch
    """The search of what is about it as a scan of the model alone, ..."""
    found: Candidates
    """... what that found, ..."""
    best: Candidates
    """... and the best of these (one), scored in the scene."""


@dataclass
class _Known:
    """What earlier searches of a scene have come to."""

    answers: list[Candidates]
    looked: list[Candidates]
    """Configurations (one each) that were looked at closely, ..."""
    points: Bools
    """... and which points of the scene (n,) are of the places where that was."""


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
        again = np.zeros_like(self.comparison.searched)
        known = _Known([], [], again.copy())
        for attempt in range(self.effort.searches):
            seed = self.options.seed + attempt
            with self.watch.stage("regions"):
                found = regions.candidates(seed, self._outside(seed), known.points if attempt > 0 else None)
            if found is None and not known.answers:
                raise self._nothing_placed
            if found is None:
                break
            several.append(found)
            left = unlike(self.comparison, Candidates.concatenate(several), known.answers, options.apart).best_first()
            if len(left):
                with self.watch.stage("repair"):
                    known.answers.append(self._repaired_one_by_one(seed, left, known))
            best = self._distinct(known.answers)
            sure = self._sureness(best)
            if sure >= options.sure:
                break
            focused = self._focused(best.take([0]))
            if focused is not None and not is_at(focused.searched, again):
                with self.watch.stage("repair"):
                    known.answers.append(self._looked_at_again(seed, best.take([0])))
                best = self._distinct(known.answers)
                again |= focused.searched
                sure = self._sureness(best)
            if sure >= options.confident:
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

    def _looked_at_again(self, seed: int, answer: Candidates) -> Candidates:
        """Return what a close look at one answer to a scene finds, itself if nothing.

        The look that found it was about a configuration of which limbs were elsewhere, and drew other samples.
        """
        focused = self._focused(answer)
        return answer if focused is None else self._repaired(self._look(seed + self.effort.searches, answer, focused))

    def _repaired_one_by_one(self, seed: int, candidates: Candidates, known: _Known) -> Candidates:
        """Look closely at the leading candidates of a scene, and repair what the best looks found, one by one, until
        one answer is convincing, or better than repair makes what the others found."""
        search, options = self.search, self.options.scene_search
        looks = sorted(self._looks(seed, candidates, known), key=lambda look: -look.best.scores[0])
        several: list[Candidates] = []
        for look in looks[: max(1, round(options.finalists * search.share_tried))]:
            best = max((float(own.scores[0]) for own in known.answers + several), default=-np.inf)
            if look.best.scores[0] < best - options.gained:
                break
            several.append(self._repaired(look))
            if is_convincing(search.comparison, several[-1].take([0]), options):
                break
        return self._distinct(several or [priced(search.comparison, candidates)])

    def _repaired(self, look: _Look) -> Candidates:
        """Return the answers that repair makes of what a close look found, closely and then in the scene."""
        rounds = min(self.options.scene_search.rounds, self.repairing.rounds)
        short = replace(self.repairing, rounds=rounds, early_rounds=0)
        repaired = look.closely._narrowly_repaired(look.closely.search, look.found, turn=True)
        solutions = repair(TreeSearch(look.focused), look.focused.scored(repaired)[0], short, turn=False)
        # No repair knows what surface goes on beyond an answer: the best in the scene may have been dropped.
        return self._distinct([look.best, priced(self.comparison, self.comparison.scored(solutions)[0])])

    def _looks(self, seed: int, candidates: Candidates, known: _Known) -> list[_Look]:
        """Return close looks at the candidates of a scene that score best, in turn with those that explain most, until
        one is convincing; one look at each place. What is `known` is not looked at again; it grows.

        A true answer of which a part is still wrong loses to false ones that hide where nothing contradicts them, but
        it explains more.
        """
        search, options = self.search, self.options.scene_search
        comparison = self.comparison
        scored = priced(comparison, candidates)
        rankings = scored, Candidates(scored.bases, scored.values, comparison.coverage(scored))
        looks: list[_Look] = []
        for rank in range(max(1, round(options.leaders * search.share_tried))):
            left = unlike(comparison, rankings[rank % 2], known.looked, options.apart)
            if len(left) == 0:
                break
            leader = left.best_first().take([0])
            known.looked.append(leader)
            focused = self._focused(leader)
            if focused is None or is_at(focused.searched, known.points):
                continue
            there = next((i for i, look in enumerate(looks) if is_at(focused.searched, look.focused.searched)), None)
            if there is None:
                looks.append(look := self._look(seed, leader, focused))
            else:
                looks[there] = look = self._with_leader(looks[there], leader)
            known.looked.append(look.best)
            if is_convincing(comparison, look.best, options):
                break
        for look in looks:
            known.points |= look.focused.searched
        return looks

    def _focused(self, candidate: Candidates) -> ScanComparison | None:
        """Return the scene about one candidate, None if nothing is near it."""
        focused = self.comparison.about(candidate, self.options.scene_search.focus)
        return None if focused is self.comparison or focused.searched.sum() < LEAST_POINTS else focused

    def _look(self, seed: int, leader: Candidates, focused: ScanComparison) -> _Look:
        """Return a close look at one candidate of a scene, which is `focused` on what is about it."""
        closely = self._closely(focused)
        found = closely._found(seed, closely.search, leader)
        return _Look(focused, closely, found, self._best_in_scene(found))

    def _with_leader(self, look: _Look, leader: Candidates) -> _Look:
        """Return a look with one more candidate at its place refined."""
        closely = look.closely.comparison
        refined = closely.scored(closely.refined(leader))[0]
        best = Candidates.concatenate([look.best, self._best_in_scene(refined)]).best_first().take([0])
        return replace(look, found=Candidates.concatenate([look.found, refined]), best=best)

    def _best_in_scene(self, found: Candidates) -> Candidates:
        """Return the best (one) of what was found closely, as the scene has it."""
        return best_priced(self.comparison, self.comparison.scored(found)[0])

    def _closely(self, focused: ScanComparison) -> AnswerSearch:
        """Return a search that takes the `focused` points of a scene for a scan of the model alone.

        Among so much less, more hypotheses are about the model, and all that is near it should be explained.
        """
        options, scene = self.options, self.search.observation
        view = close_up(scene, focused.searched, options.observation, options.scene, self.comparison.threads)
        # Its stages are all repair of the scene. Correspondences have had their say in the whole of it.
        search = TreeSearch(self.comparison.of(view))
        return AnswerSearch(self.model, search, options, None, Stopwatch(self.watch.progress))

    def _sureness(self, solutions: Candidates) -> float:
        """Return the confidence in the best of several answers to a scene, 0 where it is not sound, or leaves too much
        of what is near it unexplained."""
        evidence, options = gathered(self.comparison, solutions.take([0]), solutions), self.options.scene_search
        alone = 1.0 - evidence.explained <= options.unexplained and evidence.continued <= options.continued
        return confidence(evidence) if alone and soundness(evidence) >= options.sound else 0.0
