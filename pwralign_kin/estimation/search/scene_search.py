"""The search of a scene: every region with its own budget, the best of each kept until they can be compared."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from pwralign_kin.arrays import Singles
from pwralign_kin.checked_options import (
    LARGEST_COUNT,
    CheckedOptions,
    Count,
    Natural,
    NotNegative,
    Positive,
    Share,
)
from pwralign_kin.estimation.comparison.candidates import Candidates
from pwralign_kin.estimation.comparison.continuation import continued
from pwralign_kin.estimation.comparison.scan_comparison import ScanComparison
from pwralign_kin.estimation.search.face_hypotheses import FaceOptions, face_hypotheses
from pwralign_kin.estimation.search.hypotheses import Hypotheses
from pwralign_kin.estimation.search.tree_search import TreeSearch


@dataclass(frozen=True)
class SceneSearchOptions(CheckedOptions):
    """How much is tried in every region, and how closely the best answers of all are looked at."""

    convincing: NotNegative = 0.4
    """An answer is convincing if it explains this share of what the model usually shows, ..."""
    unexplained: Share = 0.2
    """... and leaves no more than this of what is near it unexplained: things may touch it."""
    continued: Share = 0.3
    """... Of its edges, this share at most has surface that goes on beyond: right answers in simulated rooms have 0.11
    at most, and 0.25 where a real sensor widens outlines."""
    sound: NotNegative = 0.3
    """Soundness of a repaired answer from which on no further search is worth it: 7 of 20 below were right, 13 of 15
    from here to 0.5, ..."""
    located: NotNegative = 0.3
    """... or the share that it explains: limbs of it may be wrong, but the model is not elsewhere."""
    sure: NotNegative = 0.5
    """Confidence below which another close look at the answer is worth it however sound it is, and then, where that
    does not make it sure, a further search."""
    likelier: NotNegative = 0.2
    """Confidence by which another answer must be ahead to be preferred to one that scores a little better."""
    further: Positive = 4.0
    """How many times as much is tried in every further search."""
    regions: Count = 12
    """Regions searched, the largest."""
    anchors: Count = 600
    """Scan points that hypotheses of each part start from, shared among the regions by the root of their area."""
    least_anchors: Count = 60
    """Those that every region gets at least."""
    more: Positive = 1.0
    """How many times as many hypotheses of each part are kept as the search says."""
    roots: Count = 400
    """Part hypotheses that are grown, shared alike."""
    least_roots: Count = 8
    """Those that every region gets at least."""
    grown: Count = 4
    """Configurations that are kept of each: only two-way scores tell where parts are that are hardly seen."""
    same_root: NotNegative = 0.015
    """Mean displacement of a part within which a further search does not grow a hypothesis again."""
    refined: Count = 120
    """Configurations that are refined, shared alike."""
    least_refined: Count = 4
    """Those that every region gets at least."""
    iterations: Natural = 8
    """Iterations of the refinement before the regions are compared."""
    kept: Count = 16
    """Configurations that are refined to the end: the best, ..."""
    kept_per_region: Count = 2
    """... so many of each region, ..."""
    kept_by_coverage: Count = 8
    """... and those that explain most: before they are refined, true ones stand in free space a little."""
    leaders: Count = 8
    """Configurations that are looked at closely, until one is convincing, ..."""
    apart: NotNegative = 0.1
    """... their surfaces farther than this from each other, ..."""
    focus: NotNegative = 0.35
    """... with the points this near (model diagonals) to each of them."""
    finalists: Count = 2
    """Looks, the best, of a further search one, whose answers are repaired, until one is convincing, ..."""
    gained: NotNegative = 0.15
    """... as long as what repair gains of the scores lets the next overtake it, ..."""
    rounds: Natural = 2
    """... and rounds of repair that they get in the scene after that."""

    def scaled(self, factor: float) -> SceneSearchOptions:
        """Return the same with `factor` times the budgets that the regions share, as far as they go."""
        names = ("anchors", "least_anchors", "roots", "least_roots", "refined", "least_refined")
        budgets = {name: min(round(factor * getattr(self, name)), LARGEST_COUNT) for name in names}
        return replace(self, more=min(factor * self.more, LARGEST_COUNT), **budgets)


class RegionSearch:
    """The search of all regions of one scene. It remembers what it has grown."""

    def __init__(
        self,
        search: TreeSearch,
        options: SceneSearchOptions,
        near: Singles | None,
        *,
        pairs: bool,
        faces: FaceOptions | None,
    ) -> None:
        """Say whether part hypotheses of `pairs` and of `faces` are made, beside those of other sources.

        Where some answers pass through the point `near` (1, 3), the others are dropped.
        """
        self.search = search
        self.options = options
        self.near = near
        self.pairs = pairs
        self.faces = faces
        self.grown: dict[int, tuple[Hypotheses, Candidates]] = {}
        """By source of hypotheses: the roots, and what grew from them."""

    def candidates(self, seed: int, outside: Hypotheses, *, further: bool) -> Candidates | None:
        """Return refined configurations from all regions and from `outside` hypotheses; None without any hypothesis.

        In a `further` search more is tried.
        """
        search = self.search
        options = self.options.scaled(max(1.0, self.options.further * search.share_tried)) if further else self.options
        sources = _sources(search, options, seed, outside, pairs=self.pairs, faces=self.faces)
        found = [
            self._searched(options, source, hypotheses, share)
            for source, (hypotheses, share) in enumerate(sources)
            if len(hypotheses.parts)
        ]
        if not found:
            return None
        if self.near is not None:
            passing = [f.take(search.comparison.passes(f, self.near)) for f in found]
            found = [f for f in passing if len(f)] or found
        return search.comparison.scored(search.comparison.refined(_chosen(search, options, found)))[0]

    def _searched(self, options: SceneSearchOptions, source: int, roots: Hypotheses, share: float) -> Candidates:
        """Return configurations grown from placed parts and refined a little, best first."""
        search = self.search
        if source in self.grown:
            earlier, grown = self.grown[source]
            together = Hypotheses.concatenate([earlier, roots])
            distinct = search.distinct_hypotheses(together, len(together.parts), options.same_root)
            new = together.take(distinct[distinct >= len(earlier.parts)])
            grown = Candidates.concatenate([grown, search.grow(new, options.grown)]) if len(new.parts) else grown
            self.grown[source] = Hypotheses.concatenate([earlier, new]), grown
        else:
            grown = search.grow(roots, options.grown)
            self.grown[source] = roots, grown
        kept = search.sifted(grown, max(options.least_refined, int(share * options.refined)))
        return search.sifted(search.comparison.refined(kept, iterations=options.iterations), len(kept))


def _chosen(search: TreeSearch, options: SceneSearchOptions, found: list[Candidates]) -> Candidates:
    """Return the candidates that are worth refining to the end: the best of each region, of all, and by coverage."""
    together = Candidates.concatenate(found)
    rank = np.concatenate([np.arange(len(f)) for f in found])
    firsts = np.flatnonzero(rank < options.kept_per_region)
    best = np.argsort(-together.scores, kind="stable")[: options.kept]
    coverage = search.comparison.coverage(together, search.options.sift_points)
    most = np.argsort(-coverage, kind="stable")[: options.kept_by_coverage]
    return together.take(np.unique(np.concatenate([firsts, best, most])))


def _sources(
    search: TreeSearch,
    options: SceneSearchOptions,
    seed: int,
    outside: Hypotheses,
    *,
    pairs: bool,
    faces: FaceOptions | None,
) -> Iterator[tuple[Hypotheses, float]]:
    """Yield sets of part hypotheses, and the share of the budget that each gets; `outside` count as one whole."""
    yield _promising(search, options, outside, 1.0), 1.0
    observation = search.observation
    areas = np.bincount(observation.regions[observation.regions >= 0], observation.areas[observation.regions >= 0])
    shares = np.sqrt(areas[: options.regions])
    for region, share in enumerate((shares / shares.sum()).tolist()):
        found = Hypotheses.nothing()
        if pairs:
            anchors = max(options.least_anchors, int(share * options.anchors))
            paired = search.pair_hypotheses(seed, None, region, anchors, options.more)
            found = _promising(search, options, paired, share)
        if faces is not None:
            largest = search.comparison.largest_parts(search.options.root_parts)
            found = Hypotheses.concatenate([found, face_hypotheses(search, largest, faces, region)])
        yield found, share


def _promising(search: TreeSearch, options: SceneSearchOptions, hypotheses: Hypotheses, share: float) -> Hypotheses:
    """Return the hypotheses that are worth a share of the budget."""
    return search.promising(hypotheses, max(options.least_roots, int(share * options.roots)))


def is_convincing(comparison: ScanComparison, candidate: Candidates, options: SceneSearchOptions) -> bool:
    """Return whether one configuration explains so much of the model and around it that no other is worth a search."""
    if explained_share(comparison, candidate) < options.convincing:
        return False
    if comparison.unexplained(candidate) > options.unexplained:
        return False
    return continued(comparison, candidate) <= options.continued


def explained_share(comparison: ScanComparison, candidate: Candidates) -> float:
    """Return the share of what the model usually shows that one configuration explains."""
    return float(comparison.coverage(candidate)[0]) * comparison.coverage_scale


def unlike(comparison: ScanComparison, candidates: Candidates, others: list[Candidates], distance: float) -> Candidates:
    """Return those candidates that are farther than `distance` from all `others`, on average over the surface."""
    positions = comparison.probe_positions(candidates)
    new = np.ones(len(candidates), bool)
    for other in comparison.probe_positions(Candidates.concatenate(others)) if others else ():
        new &= np.linalg.norm(positions - other, axis=-1).mean(axis=-1) > distance
    return candidates.take(new)
