"""The same surface read otherwise: a part turned over, limbs in each other's places.

Near-equal boxes leave answers that are right in most of their surface, but where a part is the wrong way round: what
hangs on it starts at the wrong spot. No joint alone leads out of that. So each part is turned by the motions that
nearly map its surface onto itself, and the joints of all other parts are solved for the places where parts that look
like them were, the nearest way that the whole tree allows (dynamic programming over the tree).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pwralign_kin.checked_options import CheckedOptions, Count, Natural, NotNegative
from pwralign_kin.estimation.comparison.candidates import Candidates
from pwralign_kin.estimation.comparison.scan_comparison import ScanComparison
from pwralign_kin.estimation.search.joint_closing import Chain, JointClosing, chains_between
from pwralign_kin.estimation.search.tree_search import TreeSearch
from pwralign_kin.model import ArticulatedModel
from pwralign_kin.se3 import Array, inverse

Message = tuple[Array, list[int]]

PROBES = 8
"""Surface samples that a displacement is measured at."""


@dataclass(frozen=True)
class ReinterpretationOptions(CheckedOptions):
    """How many readings of a surface are looked at. Lengths in model diagonals."""

    ways: Count = 64
    """Placements that a part of a model of few parts is tried in: its own ways round first, then those in the places of
    parts like it."""
    turned: Natural = 64
    """Readings of such a model, each for another turn of one part, the nearest to the old surface first."""
    same: NotNegative = 0.003
    """Sum of the displacements of all parts up to which a reading has the old surface, ..."""
    apart: NotNegative = 0.15
    """... and beyond which it has little of it."""
    turn_cost: NotNegative = 0.001
    """Displacement that each part counts for that is turned or in another's place: of equal readings the nearest."""
    regrown: Natural = 2
    """Ways in which what hangs on a turned part is grown anew."""
    refined: Count = 2
    """Readings of each turned part that are refined."""
    kept: Count = 12
    """Readings that are worth a look at every point."""


def reinterpreted(
    model: ArticulatedModel, search: TreeSearch, solution: Candidates, options: ReinterpretationOptions
) -> Candidates | None:
    """Return configurations that nearly have the surface of `solution` (one), best score first; None if none."""
    fewer = {name: max(1, round(getattr(options, name) * search.share_tried)) for name in ("ways", "turned")}
    turned, parts = _Reader(model, search.comparison, solution, replace(options, **fewer)).readings()
    if len(turned) == 0:
        return None
    regrown, regrown_parts = _regrown_below(search, turned, parts, options.regrown)
    tried, of = Candidates.concatenate([turned, regrown]), np.concatenate([parts, regrown_parts])
    # Refinement has yet to bring what hangs on a turned part to its place: each part has its own share.
    moves = [search.sifted(tried.take(of == part), options.refined) for part in np.unique(parts)]
    found = search.comparison.scored(refined_both_ways(search.comparison, Candidates.concatenate(moves)))[0]
    return found.best_first().take(slice(options.kept))


def refined_both_ways(comparison: ScanComparison, candidates: Candidates) -> Candidates:
    """Return the candidates, and what a wide and a narrow refinement make of them."""
    refined = [comparison.refined(candidates, iterations=10, sigma=sigma) for sigma in (0.03, 0.01)]
    return Candidates.concatenate([candidates, *refined])


class _Reader:
    """Tells how one configuration could be read otherwise."""

    def __init__(
        self,
        model: ArticulatedModel,
        comparison: ScanComparison,
        solution: Candidates,
        options: ReinterpretationOptions,
    ) -> None:
        self.comparison, self.options = comparison, options
        self.symmetry, self.values = model.symmetry, solution.values[0]
        self.parts = np.flatnonzero(self.symmetry.kind >= 0)
        self.chains_at: dict[int, list[Chain]] = {int(part): [] for part in self.parts}
        for chain in chains_between(model):
            self.chains_at[chain.above].append(chain)
            self.chains_at[chain.below].append(chain)
        places = comparison.part_placements(solution)[0]
        self.ways = {int(part): self._ways(int(part), places) for part in self.parts}
        closing = JointClosing(model, comparison.model)
        self.closed = {(chain.above, chain.below): self._closed(chain, closing) for chain in chains_between(model)}
        self.messages: dict[tuple[int, int], Message] = {}
        self.walks: dict[int, list[tuple[int, int, Chain]]] = {}

    def readings(self) -> tuple[Candidates, NDArray[np.int64]]:
        """Return configurations (unscored) each of which turns one part over, and which (m,) part that is."""
        seeds = []
        for part in self.chains_at:
            total = self._total(part)
            own = len(self.symmetry.replacements(part, part)) + len(self.symmetry.nearly[part])
            seeds += [(float(total[way]), part, way) for way in range(1, min(own, self.options.ways))]
        anchor = int(self.comparison.largest_parts(1)[0])
        bases: list[Array] = []
        values: list[Array] = []
        turned: list[int] = []
        for cost, part, way in sorted(seeds):
            if len(turned) == self.options.turned or cost > self.options.apart:
                break
            chosen, read = self._followed(part, way)
            moved = sum(way > 0 for way in chosen.values())
            if cost - self.options.turn_cost * moved < self.options.same:
                continue
            # The largest part holds still: the turned one may be small and a little out of place.
            held = anchor if anchor in chosen else part
            at_origin = self.comparison.part_placements(Candidates.single(np.eye(4), read))
            bases.append(self.ways[held][0][chosen[held]] @ inverse(at_origin[0, held]))
            values.append(read)
            turned.append(part)
        count = len(turned)
        placed = np.array(bases).reshape(count, 4, 4), np.array(values).reshape(count, len(self.values))
        return Candidates(*placed, np.zeros(count, np.float32)), np.array(turned, int)

    def _ways(self, part: int, places: Array) -> tuple[Array, Array]:
        """Return the placements (m, 4, 4) that a part may take, its own first, and what each costs (m,)."""
        symmetry = self.symmetry
        alike = [int(i) for i in self.parts if symmetry.kind[i] == symmetry.kind[part] and i != part]
        nearly = symmetry.nearly[part]
        placements = [
            places[part] @ symmetry.replacements(part, part),
            places[part] @ nearly,
            *(places[place] @ symmetry.replacements(part, place) for place in alike),
        ]
        off = [symmetry.nearly_off[part] if i == 1 else np.zeros(len(own)) for i, own in enumerate(placements)]
        costs = np.concatenate(off) + self.options.turn_cost
        costs[0] = 0.0
        return np.concatenate(placements)[: self.options.ways], costs[: self.options.ways]

    def _closed(self, chain: Chain, closing: JointClosing) -> tuple[Array, Array]:
        """Return how far (a, b) each way of the part below is displaced when the joints hold it to each way of the part
        above, and the values (a, b, joints) that they take."""
        above, below = self.ways[chain.above][0], self.ways[chain.below][0]
        values = closing.values(chain, above, below)[0]
        off = closing.placed(chain.joints, above[:, None], values) - below
        probes = self.comparison.surfaces[chain.below].samples[:PROBES].astype(float)
        moved = probes @ np.swapaxes(off[..., :3, :3], -1, -2) + off[..., None, :3, 3]
        return np.linalg.norm(moved, axis=-1).mean(axis=-1), values

    def _total(self, part: int, beside: Chain | None = None) -> Array:
        """Return the least cost (m,) of all parts for each way of one, those beyond the chain `beside` excepted."""
        total = self.ways[part][1].copy()
        for chain in self.chains_at[part]:
            if chain is not beside:
                total += self._message(part, chain)[0]
        return total

    def _message(self, part: int, chain: Chain) -> Message:
        """Return per way of `part` the least cost (m,) of all beyond `chain`, and the way of the next part."""
        following = chain.other(part)
        if (part, following) not in self.messages:
            gap = self.closed[chain.above, chain.below][0]
            each = (gap if part == chain.above else gap.T) + self._total(following, beside=chain)
            self.messages[part, following] = each.min(axis=1), each.argmin(axis=1).tolist()
        return self.messages[part, following]

    def _followed(self, part: int, way: int) -> tuple[dict[int, int], Array]:
        """Return the ways of all parts that follow from that of one, by part, and the joint values (k,)."""
        chosen, values = {part: way}, self.values.copy()
        for origin, following, chain in self._walk(part):
            chosen[following] = self._message(origin, chain)[1][chosen[origin]]
            closed = self.closed[chain.above, chain.below][1][chosen[chain.above], chosen[chain.below]]
            for joint, value in zip(chain.joints, closed, strict=True):
                values[joint.actuated] = value
        return chosen, values

    def _walk(self, part: int) -> list[tuple[int, int, Chain]]:
        """Return all chains from one part outwards, each with the part that it is reached from and the next one."""
        if part not in self.walks:
            walk: list[tuple[int, int, Chain]] = []
            front, reached = [part], {part}
            while front:
                origin = front.pop()
                for chain in self.chains_at[origin]:
                    following = chain.other(origin)
                    if following not in reached:
                        walk.append((origin, following, chain))
                        reached.add(following)
                        front.append(following)
            self.walks[part] = walk
        return self.walks[part]


def _regrown_below(
    search: TreeSearch, turned: Candidates, parts: NDArray[np.int64], keep: int
) -> tuple[Candidates, NDArray[np.int64]]:
    """Grow what hangs on each turned part anew. Return the configurations, and the part (m,) turned in each."""
    grown, of = [turned.take(slice(0, 0))], [np.zeros(0, int)]
    for part in np.unique(parts):
        children = np.flatnonzero(search.comparison.parent == part)
        rows = np.flatnonzero(parts == part)
        tasks = len(rows) * len(children)
        if tasks == 0:
            continue
        each, nexts = np.repeat(rows, len(children)), np.tile(children, len(rows))
        own = search.regrown(turned, each, np.full(tasks, part), nexts, keep)
        grown.append(own)
        of.append(np.full(len(own), part))
    return Candidates.concatenate(grown), np.concatenate(of)
