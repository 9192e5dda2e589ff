"""The last word on an answer: whether a rival that the points do not tell from it, or prefer, takes its place.

The search goes by what the scan shows of the model as well as by what the model explains of the scan. Where pieces of
the surface are missing, the first speaks against the truth; how closely the points lie on an answer does not.
"""

from __future__ import annotations

import numpy as np

from pwralign_kin.estimation.answer_search import ranks
from pwralign_kin.estimation.candidates import Candidates
from pwralign_kin.estimation.evidence import Evidence, rivals_to
from pwralign_kin.estimation.reinterpretation import refined_both_ways
from pwralign_kin.estimation.tree_search import TreeSearch

DISTINCT = 2.0
"""Standard deviations from which on points tell an answer from its rivals as they stand, before they are refined."""
GAIN = 0.005
"""What a rival must gain of the scores that answers are ranked by."""


def contested(search: TreeSearch, final: Candidates, evidence: Evidence, finished: Candidates) -> Candidates | None:
    """Return the answers that the search `finished` with behind a better one, if a rival of `final` (one) is better.

    `evidence` is that for the final configuration. None where there is no such rival, and in a scene, where most
    points are of other things.
    """
    if search.observation.scene or search.known.held or evidence.distinct >= DISTINCT:
        return None
    rivals = rivals_to(search, final, finished)
    # What refinement alone would gain is no merit of a rival.
    settled, refined = refined_both_ways(search, final), refined_both_ways(search, rivals)
    both = Candidates.concatenate([settled, refined])
    scores = ranks(search, both)
    best = int(np.argmax(scores))
    if scores[best] < scores[: len(settled)].max() + GAIN:
        return None
    won = Candidates(both.bases, both.values, scores).take([best])
    return Candidates.concatenate([won, finished])
