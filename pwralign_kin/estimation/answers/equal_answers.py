"""Answers that the scan cannot tell from the best one, made from the model's own symmetry.

A large part is turned so that its surface covers itself. The other parts follow: each takes a place where a part that
looks like it was, whichever brings its joint together within the limits. What comes out has the same surface as the
answer, with limbs in each other's places or parts the other way round.
"""

from __future__ import annotations

import numpy as np

from pwralign_kin.estimation.comparison.candidates import Candidates
from pwralign_kin.estimation.comparison.scan_comparison import ScanComparison
from pwralign_kin.estimation.search.joint_closing import BEYOND, JointClosing, chains_between
from pwralign_kin.model import ArticulatedModel
from pwralign_kin.se3 import Array, inverse

SEEDS = 12
"""Turns of parts that are followed, of the largest parts first."""
MOST = 6
"""Equal answers that are made."""


def equal_answers(model: ArticulatedModel, comparison: ScanComparison, final: Candidates) -> Candidates:
    """Return distinct configurations (unscored, at most `MOST`) whose surface is that of the `final` one."""
    symmetry, places = model.symmetry, comparison.part_placements(final)[0]
    follower, found = _Follower(model, comparison, final), final
    seeds = [
        (part, turn) for part in comparison.largest_parts(len(places)) for turn in symmetry.replacements(part, part)[1:]
    ]
    for part, turn in seeds[:SEEDS]:
        values = follower.follow(int(part), places[part] @ turn)
        if values is None:
            continue
        at_origin = comparison.part_placements(Candidates.single(np.eye(4), values))[0]
        base = places[part] @ turn @ inverse(at_origin[part])
        other = Candidates.single(base, values, -np.inf)
        found = comparison.distinct(Candidates.concatenate([found, other]), MOST + 1, comparison.options.distinct)
        if len(found) > MOST:
            break
    return found.take(slice(1, None))


class _Follower:
    """Lets all parts follow one that was turned."""

    def __init__(self, model: ArticulatedModel, comparison: ScanComparison, final: Candidates) -> None:
        self.model, self.symmetry = model, model.symmetry
        self.places = comparison.part_placements(final)[0]
        self.values = final.values[0]
        self.chains = chains_between(model)
        self.closing = JointClosing(model, comparison.model)
        kind = model.symmetry.kind
        self.alike = [
            [part, *(int(i) for i in np.flatnonzero(kind == kind[part]) if i != part)] for part in range(len(kind))
        ]
        self.looks: dict[tuple[int, int], Array] = {}

    def follow(self, seed: int, placement: Array) -> Array | None:
        """Return the joint values (k,) that bring all surface back onto that of the answer; None where none do."""
        placed, taken, front = {seed: placement}, {seed}, [seed]
        values, told = self.values.copy(), np.zeros(len(self.values), bool)
        while front:
            origin = front.pop(0)
            for chain in self.chains:
                if origin not in (chain.above, chain.below) or chain.other(origin) in placed:
                    continue
                part = chain.other(origin)
                several = [(place, self._looking_as(part, place)) for place in self._places_for(part, taken)]
                if not several:
                    return None
                placements, at = np.concatenate([own for _, own in several]), placed[origin][None]
                ends = (at, placements) if part == chain.below else (placements, at)
                found, fits = (own.reshape(len(placements), -1) for own in self.closing.values(chain, *ends))
                actuated = chain.actuated
                fits &= ((np.abs(found - values[actuated]) < BEYOND) | ~told[actuated]).all(axis=1, keepdims=True)
                if not fits.any():
                    return None
                chosen = int(np.argmax(fits))
                values[actuated], told[actuated] = found[chosen], True
                placed[part] = placements[chosen]
                taken.add(np.repeat([place for place, _ in several], [len(own) for _, own in several])[chosen])
                front.append(part)
        return values if len(placed) == int((self.symmetry.kind >= 0).sum()) else None

    def _looking_as(self, part: int, place: int) -> Array:
        """Return the placements (m, 4, 4) of `part` that look as the answer's part `place` does."""
        if (part, place) not in self.looks:
            self.looks[part, place] = self.places[place] @ self.symmetry.replacements(part, place)
        return self.looks[part, place]

    def _places_for(self, part: int, taken: set[int]) -> list[int]:
        """Return the free places of parts that look like `part`, its own first."""
        return [place for place in self.alike[part] if place not in taken]
