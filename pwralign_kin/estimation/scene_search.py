"""The search of a scene: every region with its own budget, the best of each kept until they can be compared."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pwralign_kin.estimation.candidates import Candidates
from pwralign_kin.estimation.tree_search import TreeSearch


@dataclass(frozen=True)
class SceneSearchOptions:
    """How much is tried in every region."""

    attempts: int = 2
    """Searches at most; one where its answer leaves little around it unexplained."""
    regions: int = 12
    """Regions searched, the largest."""
    anchors: int = 600
    """Scan points that hypotheses of each part start from, shared among the regions by the root of their area."""
    least_anchors: int = 60
    roots: int = 400
    """Part hypotheses that are grown, shared alike."""
    least_roots: int = 8
    refined: int = 120
    """Configurations that are refined, shared alike."""
    least_refined: int = 4
    iterations: int = 8
    """Iterations of the refinement before the regions are compared."""
    kept: int = 24
    """Configurations that are refined to the end."""
    kept_per_region: int = 2
    """Of them at least so many of each region."""


def search_regions(search: TreeSearch, options: SceneSearchOptions, seed: int) -> Candidates:
    """Return refined configurations from all regions."""
    observation = search.observation
    areas = np.bincount(observation.regions[observation.regions >= 0], observation.areas[observation.regions >= 0])
    share = np.sqrt(areas[: options.regions])
    share /= share.sum()
    found = []
    for region, part in enumerate(share):
        hypotheses = search.pair_hypotheses(seed, region, max(options.least_anchors, int(part * options.anchors)))
        if len(hypotheses.parts) == 0:
            continue
        roots = search.promising(hypotheses, max(options.least_roots, int(part * options.roots)))
        grown = search.grow(roots)
        kept = search.sifted(grown, max(options.least_refined, int(part * options.refined)))
        found.append(search.scored(search.refined(kept, iterations=options.iterations))[0].best_first())
    firsts = Candidates.concatenate([f.take(slice(options.kept_per_region)) for f in found])
    others = Candidates.concatenate([f.take(slice(options.kept_per_region, None)) for f in found]).best_first()
    chosen = Candidates.concatenate([firsts, others.take(slice(max(0, options.kept - len(firsts))))])
    return search.scored(search.refined(chosen))[0]
