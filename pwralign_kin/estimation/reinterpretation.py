"""The same surface read otherwise: a part turned over, limbs in each other's places.

Near-equal boxes leave answers that are right in most of their surface, but where a part is the wrong way round: what
hangs on it starts at the wrong spot. No joint alone leads out of that. So each part is turned by the motions that
nearly map its surface onto itself, and the joints of all other parts are solved for the places where parts that look
like them were, the nearest way that the whole tree allows (dynamic programming over the tree).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pwralign_kin.estimation.candidates import Candidates
from pwralign_kin.estimation.joint_closing import Chain, JointClosing, chains_between
from pwralign_kin.estimation.tree_search import TreeSearch
from pwralign_kin.model import ArticulatedModel
from pwralign_kin.se3 import Array, inverse

Bool = NDArray[np.bool_]


@dataclass(frozen=True)
class ReinterpretationOptions:
    """How many readings are looked at."""

    turned: int = 64
    """Readings that differ in how one part is turned, the nearest to the old surface first."""
    same: float = 0.003
    """Sum of the displacements of all parts (model diagonals) up to which a reading has the old surface, ..."""
    apart: float = 0.15
    """... and beyond which it has little of it."""
    turn_cost: float = 0.001
    """Displacement that each part counts for that is not where it was: of equal readings the one nearest to the old."""
    regrown: int = 2
    """Ways in which what hangs on a turned part is grown anew."""
    refined: int = 2
    """Readings of each turned part that are refined."""


@dataclass(frozen=True)
class _Reading:
    """What the parts could be taken for."""

    placements: tuple[Array, ...]
    """Per part (m, 4, 4) the placements that it may take, its own first."""
    costs: tuple[Array, ...]
    """Per part (m,) how far its surface is then from what was there."""


def reinterpreted(
    model: ArticulatedModel, search: TreeSearch, solution: Candidates, options: ReinterpretationOptions
) -> Candidates | None:
    """Return refined and scored configurations that nearly have the surface of `solution` (one); None if none."""
    turned, parts = _readings(model, search, solution, options)
    if len(turned) == 0:
        return None
    regrown, of = _regrown_below(search, turned, parts, options.regrown)
    # Refinement has yet to bring what hangs on a turned part to its place: each part has its own share.
    moves = Candidates.concatenate(
        [
            search.sifted(Candidates.concatenate([turned.take(parts == part), regrown.take(of == part)]), options.refined)
            for part in np.unique(parts)
        ]
    )
    refined = [search.refined(moves, iterations=10, sigma=sigma) for sigma in (0.03, 0.01)]
    return search.scored(Candidates.concatenate([moves, *refined]))[0]


def _readings(
    model: ArticulatedModel, search: TreeSearch, solution: Candidates, options: ReinterpretationOptions
) -> tuple[Candidates, NDArray[np.int64]]:
    """Return configurations (unscored) each of which turns one part over, and which (m,) part that is."""
    symmetry, places = model.symmetry, search.part_placements(solution)[0]
    parts = np.flatnonzero(symmetry.kind >= 0)
    placements, costs = {}, {}
    for part in parts:
        alike = [place for place in parts if symmetry.kind[place] == symmetry.kind[part] and place != part]
        own = [symmetry.replacements(part, part), symmetry.nearly[part]]
        placements[part] = np.concatenate(
            [places[part] @ np.concatenate(own), *(places[i] @ symmetry.replacements(part, i) for i in alike)]
        )
        costs[part] = np.concatenate(
            [np.zeros(len(own[0])), symmetry.nearly_off[part], *(np.zeros(len(symmetry.replacements(part, i))) for i in alike)]
        )
        costs[part][1:] += options.turn_cost
    closing = JointClosing(model, search.model)
    around = _around(chains_between(model))
    edges = {}
    for chain in chains_between(model):
        above, below = placements[chain.above], placements[chain.below]
        pairs = np.repeat(above, len(below), axis=0), np.tile(below, (len(above), 1, 1))
        values = closing.values(chain.joints, *pairs)[0]
        reached = closing.placed(chain.joints, pairs[0], values)
        probes = search.surfaces[chain.below].samples[:8].astype(float)
        gap = np.linalg.norm(
            np.einsum("mij,pj->mpi", (reached - pairs[1])[:, :3, :3], probes) + (reached - pairs[1])[:, None, :3, 3], axis=-1
        ).mean(axis=1)
        edges[chain.above, chain.below] = gap.reshape(len(above), len(below)), values.reshape(len(above), len(below), -1)

    messages: dict[tuple[int, int], tuple[Array, NDArray[np.int64]]] = {}

    def message(origin: int, chain: Chain) -> tuple[Array, NDArray[np.int64]]:
        """Return per option of `origin` the least cost of all beyond `chain`, and the option of the next part."""
        part = chain.other(origin)
        if (origin, part) not in messages:
            total = costs[part] + sum((message(part, c)[0] for c in around[part] if c is not chain), np.zeros(len(costs[part])))
            gap = edges[chain.above, chain.below][0] if origin == chain.above else edges[chain.above, chain.below][0].T
            each = gap + total
            best = each.argmin(axis=1)
            messages[origin, part] = each[np.arange(len(each)), best], best
        return messages[origin, part]

    seeds = []
    for part in parts:
        count = len(symmetry.replacements(part, part)) + len(symmetry.nearly[part])
        total = costs[part] + sum((message(part, c)[0] for c in around.get(part, ())), np.zeros(len(costs[part])))
        seeds += [(float(total[option]), int(part), option) for option in range(1, count)]
    largest = int(search.largest_parts(1)[0])
    bases, several = [], []
    kept = []
    for cost, seed, option in sorted(seeds):
        if len(kept) == options.turned or cost > options.apart:
            break
        values = solution.values[0].copy()
        chosen, front = {seed: option}, [seed]
        while front:
            origin = front.pop()
            for chain in around.get(origin, ()):
                part = chain.other(origin)
                if part in chosen:
                    continue
                chosen[part] = int(message(origin, chain)[1][chosen[origin]])
                values[[joint.actuated for joint in chain.joints]] = edges[chain.above, chain.below][1][chosen[chain.above], chosen[chain.below]]
                front.append(part)
        at_origin = search.part_placements(Candidates(np.eye(4)[None], values[None], np.zeros(1, np.float32)))[0]
        if cost - options.turn_cost * sum(o > 0 for o in chosen.values()) < options.same:
            continue
        kept.append(seed)
        anchor = largest if largest in chosen else seed
        bases.append(placements[anchor][chosen[anchor]] @ inverse(at_origin[anchor]))
        several.append(values)
    count = len(kept)
    if count == 0:
        return solution.take(slice(0, 0)), np.zeros(0, int)
    return Candidates(np.array(bases), np.array(several), np.zeros(count, np.float32)), np.array(kept)


def _around(chains: tuple[Chain, ...]) -> dict[int, list[Chain]]:
    around: dict[int, list[Chain]] = {}
    for chain in chains:
        around.setdefault(chain.above, []).append(chain)
        around.setdefault(chain.below, []).append(chain)
    return around


def _regrown_below(
    search: TreeSearch, turned: Candidates, parts: NDArray[np.int64], keep: int
) -> tuple[Candidates, NDArray[np.int64]]:
    """Grow what hangs on each turned part anew. Return the configurations and the part (m,) turned in each."""
    grown, of = [turned.take(slice(0, 0))], []
    for part in np.unique(parts):
        rows = np.flatnonzero(parts == part)
        tasks = [(row, part, child) for row in rows for child in np.flatnonzero(search.parent == part)]
        if tasks:
            row, start, following = (np.array(column, np.int32) for column in zip(*tasks, strict=True))
            weights = np.tile(search.weights, (len(tasks), 1))
            own = Candidates(
                *search.native.regrow(turned.bases, turned.values, row, start, following, weights, keep)
            )
            grown.append(own)
            of += [part] * len(own)
    return Candidates.concatenate(grown), np.array(of, int)
