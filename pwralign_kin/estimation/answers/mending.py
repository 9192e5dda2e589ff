"""An answer mended where a part lies off its points: the part, or what it hangs on, held otherwise.

A small part at the end of a limb explains so few points that the scores of whole answers hardly tell where it is, and
no joint of its own leads to its place if the part that it hangs on is turned the wrong way round, which of a box
nothing else tells. How closely the part's own points lie on it does.
"""

from __future__ import annotations

import numpy as np

from pwralign_kin.arrays import Indices
from pwralign_kin.estimation.comparison.candidates import Candidates
from pwralign_kin.estimation.comparison.off_points import off_points
from pwralign_kin.estimation.comparison.ranking import SAMPLING, finest, ranked, ranks
from pwralign_kin.estimation.comparison.scan_comparison import ScanComparison
from pwralign_kin.estimation.search.joint_closing import Chain, JointClosing, chains_between
from pwralign_kin.estimation.search.reinterpretation import refined_both_ways
from pwralign_kin.estimation.search.tree_search import TreeSearch
from pwralign_kin.estimation.search.voting import VoteOptions, voted
from pwralign_kin.model import ArticulatedModel

PARTS, ROUNDS = 2, 6
"""Parts that are mended at a time, those first that are most off their points, and times in a row, ..."""
GAIN = 0.002
"""... as long as the scores that answers are ranked by gain this, ..."""
MOSTLY = 0.5
"""... and the likelihood of all points this share of what that of the part's own is less, of several the least."""
BENT = 1.5
"""How many times as far from an answer as noise explains the points may be: farther in bent scans, where parts lie off
their points in the right answer too."""
UP = 2
"""How many parts with surface farther up a limb is cut and held otherwise."""
WAYS, HELD, SWEPT, REFINED = 8, 16, 3, 32
"""Ways in which what is cut is grown anew, how many of all ways to hold a part its own joints are swept in, values that
each sweep keeps, and how many configurations are refined."""
VOTED = 8
"""How many configurations that votes about such parts lead to are refined, and of those that differ from the first of
these in whole limbs."""
APART = 0.015
"""Displacement of one part (model diagonals) from which on two configurations are not the same."""


def mended(
    model: ArticulatedModel, comparison: ScanComparison, answer: Candidates, votes: VoteOptions
) -> Candidates | None:
    """Return a better configuration than `answer` (one), with other values in limbs that lie off their points; some are
    what `votes` lead to.

    None if no part does, or none is found, and in a bent scan.
    """
    if comparison.residual(answer) > BENT * np.hypot(comparison.observation.noise, SAMPLING):
        return None
    mender = _Mender(model, comparison, votes)
    found = None
    for round_ in range(ROUNDS):
        parts, less = off_points(comparison, answer)
        if len(parts) == 0:
            break
        # What refinement alone would gain is no merit of a repair.
        start = ranked(comparison, answer if found is not None else refined_both_ways(comparison, answer)).take([0])
        each_way = (mender.ways_of(answer, int(part)) for part in parts[:PARTS])
        ways = [mender.ways_voted(answer, parts, round_), *each_way]
        tried = [start, *(refined_both_ways(comparison, some) for some in ways)]
        several = Candidates.concatenate(tried)
        each = finest(comparison, several)
        scores, likelihoods = ranks(comparison, several, each), each * len(comparison.observation.given)
        least = np.concatenate([[0.0], less[:PARTS][-1:], less[:PARTS]])
        needed = np.repeat(MOSTLY * least, [len(some) for some in tried])
        likely = np.flatnonzero(likelihoods >= likelihoods[0] + needed)
        best = likely[np.argmax(scores[likely])]
        if scores[best] < scores[0] + GAIN:
            break
        found = answer = several.with_scores(scores).take([best])
    return found


class _Mender:
    """Holds parts of one model otherwise."""

    def __init__(self, model: ArticulatedModel, comparison: ScanComparison, votes: VoteOptions) -> None:
        self.comparison, self.symmetry, self.votes = comparison, model.symmetry, votes
        self.search = TreeSearch(comparison)
        self.closing = JointClosing(model, comparison.model)
        self.chains = {chain.below: chain for chain in chains_between(model)}

    def ways_of(self, answer: Candidates, part: int) -> Candidates:
        """Return the likeliest configurations in which a part is elsewhere, with what hangs on it."""
        comparison, held = self.comparison, self._held_otherwise(answer, part)
        apart = APART / int(comparison.exists.sum())
        swept = self._swept(comparison.distinct(comparison.scored(held)[0], HELD, apart), part)
        return comparison.distinct(comparison.scored(Candidates.concatenate([held, swept]))[0], REFINED, apart)

    def ways_voted(self, answer: Candidates, off: Indices, seed: int) -> Candidates:
        """Return the most promising configurations that the points on parts `off` theirs vote for."""
        votes = voted(self.search, answer, self.votes, seed, doubting=True, off=off)
        return answer.take([]) if votes is None else self.search.sifted(votes, VOTED, VOTED)

    def _held_otherwise(self, answer: Candidates, part: int) -> Candidates:
        """Return the answer, and others in which a limb that ends with `part`, or begins with it, is held otherwise."""
        found, lower, onward = [answer], part, np.flatnonzero(self.comparison.parent == part).tolist()
        for _ in range(UP + 1):
            above, cut = self._above(lower)
            if above < 0:
                break
            found.append(self._regrown(answer, above, cut))
            if lower in self.chains:
                turned = self._turned(answer, lower, self.chains[lower])
                found += [turned, *(self._regrown(turned, lower, below) for below in onward)]
            lower, onward = above, [cut]
        return Candidates.concatenate(found)

    def _above(self, part: int) -> tuple[int, int]:
        """Return the next part with surface above one, -1 if none has, and the part below that on the way."""
        parent, exists = self.comparison.parent, self.comparison.exists
        cut = part
        while cut > 0 and not exists[parent[cut]]:
            cut = int(parent[cut])
        return (int(parent[cut]), cut) if cut > 0 else (-1, cut)

    def _turned(self, answer: Candidates, part: int, chain: Chain) -> Candidates:
        """Return the answer with a part turned by the motions that map it onto itself, or nearly do, as its joints let
        it."""
        placements = self.comparison.part_placements(answer)[0]
        turns = np.concatenate([self.symmetry.replacements(part, part)[1:], self.symmetry.nearly[part]])
        if len(turns) == 0:
            return answer.take(slice(0, 0))
        found, fits = self.closing.values(chain, placements[[chain.above]], placements[part] @ turns)
        values = np.tile(answer.values, (int(fits.sum()), 1))
        values[:, chain.actuated] = found[fits]
        return Candidates(np.tile(answer.bases, (len(values), 1, 1)), values, np.zeros(len(values), np.float32))

    def _regrown(self, several: Candidates, above: int, cut: int) -> Candidates:
        """Return the configurations with all from `cut` on, which hangs on `above`, grown anew."""
        count = len(several)
        return self.search.regrown(several, np.arange(count), np.full(count, above), np.full(count, cut), WAYS)

    def _swept(self, several: Candidates, part: int) -> Candidates:
        """Return the configurations with the joint that a part hangs on swept, together with that before it where no
        surface lies between them."""
        comparison = self.comparison
        joint, before = (int(comparison.model.actuated[i]) for i in (part, comparison.parent[part]))
        pair = comparison.parent[part] > 0 and not comparison.exists[comparison.parent[part]] and joint != before
        first, second = (before, joint) if pair else (joint, -1)
        return comparison.swept_each(several, first, second, SWEPT)
