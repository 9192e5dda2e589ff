"""The search without a guess: part hypotheses, grown through the kinematic tree into whole configurations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pwralign_kin.arrays import Bools, Indices, Ints, Singles
from pwralign_kin.estimation.comparison.candidates import Candidates
from pwralign_kin.estimation.comparison.scan_comparison import ScanComparison
from pwralign_kin.estimation.knowledge.correspondences import OrientedPairs
from pwralign_kin.estimation.search.hypotheses import Hypotheses
from pwralign_kin.se3 import Array

Index = Sequence[int] | NDArray[Any]

PROBES = 40
"""Samples of a part that tell how far apart two placements of it are."""


class TreeSearch:
    """Proposes configurations of one model for one observed scan."""

    def __init__(self, comparison: ScanComparison) -> None:
        """Take what compares configurations with the scan, by which all proposals are scored."""
        self.comparison = comparison
        self.observation = comparison.observation
        self.options = comparison.options

    def widened(self) -> TreeSearch:
        """Return the same search with wide beams."""
        o = self.options
        wide = replace(o, beam=o.wide_beam, modes=o.wide_modes, branch_beam=o.wide_branch_beam)
        return TreeSearch(self.comparison.with_options(wide, self.comparison.searched))

    @property
    def root_parts(self) -> Ints:
        """The largest parts, that hypotheses start from."""
        return self.comparison.largest_parts(self.options.root_parts + self.many * self.options.more_root_parts)

    def pair_hypotheses(
        self, seed: int, parts: Ints | None = None, region: int = 0, anchors: int = 400, more: float = 1.0
    ) -> Hypotheses:
        """Return poses of the largest parts from oriented point pairs of one region, drawn about `anchors` points.

        Of each part, `more` times as many as usual.
        """
        largest = self.root_parts if parts is None else parts
        points = np.flatnonzero(self.observation.regions == region)
        return self.part_hypotheses(
            largest, [points] * len(largest), anchors, seed, round(more * self._per_part), self.observation.weights
        )

    def piecewise_hypotheses(self, seed: int) -> Hypotheses:
        """Return promising poses of the largest parts from oriented point pairs within each of some pieces of the scan.

        What is left of a part that is cut or covered makes a worse pose than whole parts that only coincide with
        surface elsewhere: each piece has its own share.
        """
        o, largest = self.options, self.root_parts
        pieces = halved(self.observation.points, np.arange(len(self.observation.points)), o.halvings)
        return Hypotheses.concatenate(
            [
                self.promising(
                    self.part_hypotheses(
                        largest, [piece] * len(largest), o.anchors_per_piece, seed, self._per_part,
                        self.observation.weights,
                    ),
                    o.roots_per_piece,
                )
                for piece in pieces
            ]
        )  # fmt: skip

    def part_hypotheses(
        self, parts: Ints, points: Sequence[Indices], anchors: int, seed: int, count: int, weights: Singles
    ) -> Hypotheses:
        """Return at most `count` poses of each of `parts` from oriented pairs of the scan points it is looked for in.

        The first point of a pair is one of `anchors`. `weights` (n,) of all scan points count in the scores.
        """
        return Hypotheses(
            *self.comparison.native.part_hypotheses(
                parts,
                [own.astype(np.int32) for own in points],
                anchors,
                seed,
                count,
                np.ascontiguousarray(weights, np.float32),
            )
        )

    def correspondence_hypotheses(self, pairs: Sequence[OrientedPairs], seed: int) -> Hypotheses:
        """Return poses of parts from correspondences, in minimal samples of two."""
        found = [
            Hypotheses(
                *self.comparison.native.correspondence_hypotheses(
                    p.part,
                    p.source,
                    p.source_normals,
                    p.target,
                    p.target_normals,
                    p.weight,
                    seed,
                    self._per_part,
                )
            )
            for p in pairs
        ]
        return Hypotheses.concatenate(found)

    def promising(self, hypotheses: Hypotheses, count: int | None = None) -> Hypotheses:
        """Return the hypotheses worth growing, best first, at most `count`; by default as many as a search grows."""
        # A large part explains more: its hypotheses deserve more trials.
        rank = -hypotheses.scores * self.comparison.weights[hypotheses.parts] ** 0.3
        return hypotheses.take(np.argsort(rank, kind="stable")[: count or self._roots])

    def rivalling(self, hypotheses: Hypotheses, answer: Candidates, margin: float) -> Bools:
        """Return which hypotheses (m,) may lead to another answer that is as good: they place their part elsewhere than
        `answer` (one) does, where it fits worse by no more than `margin`."""
        placed = self.comparison.part_placements(answer)[0]
        rivals = np.zeros(len(hypotheses.parts), bool)
        for part in np.unique(hypotheses.parts):
            own = hypotheses.parts == part
            moved = hypotheses.placements[own] - placed[part]
            probes = self.comparison.surfaces[part].samples[:PROBES] @ np.swapaxes(moved[:, :3, :3], 1, 2)
            apart = np.linalg.norm(probes + moved[:, None, :3, 3], axis=2).mean(axis=1)
            fits = self.aligned(np.array([part], np.int32), placed[[part]], 0).scores[0]
            rivals[own] = (apart > self.options.distinct) & (hypotheses.scores[own] > fits - margin)
        return rivals

    def grow(self, hypotheses: Hypotheses, keep: int = 1) -> Candidates:
        """Return the best `keep` whole configurations grown from each placed part (scored by growth alone)."""
        return Candidates(*self.comparison.native.grow(hypotheses.parts, hypotheses.placements, keep))

    def grow_from_bases(self, bases: Array, keep: int) -> Candidates:
        """Return the best `keep` configurations grown from each placement (m, 4, 4) of the root part."""
        count = len(bases)
        placed = Candidates(bases, np.tile(self.comparison.known.values, (count, 1)), np.zeros(count, np.float32))
        root = np.zeros(count, np.int32)
        return self.regrown(placed, np.arange(count), root, root - 1, keep)

    def regrown(self, candidates: Candidates, rows: Index, starts: Index, nexts: Index, keep: int) -> Candidates:
        """Return for each task the best `keep` configurations in which all from a part of `nexts` on is grown anew.

        It hangs on the part of `starts`, its neighbour, which stays as in the candidate of `rows` with the rest; -1:
        all but that part is grown.
        """
        row, start, following = (np.asarray(each, np.int32) for each in (rows, starts, nexts))
        weights = np.tile(self.comparison.weights, (len(row), 1))
        return Candidates(
            *self.comparison.native.regrow(candidates.bases, candidates.values, row, start, following, weights, keep)
        )

    def sifted(self, candidates: Candidates, count: int, varied: int = 0) -> Candidates:
        """Return the best `count` candidates, none nearly the same, by a two-way score on few points, best first.

        At most `varied` others follow, the best that differ from the first and from each other in whole limbs.
        """
        ordered = self.comparison.scored(candidates, self.options.sift_points)[0].best_first()
        best = self.comparison.distinct(ordered.take(slice(4 * count)), count, self.options.alike)
        if varied == 0:
            return best
        others = self.comparison.distinct(ordered, varied + 1, self.options.distinct)
        return self.comparison.distinct(Candidates.concatenate([best, others]), count + varied, self.options.alike)

    @property
    def many(self) -> bool:
        """Whether the model has so many parts that the search needs more of everything."""
        return len(self.comparison.exists) > self.options.many_parts

    @property
    def share_tried(self) -> float:
        """Share of what is tried for a model of few parts: time grows with the number of parts."""
        return min(1.0, self.options.many_parts / len(self.comparison.exists))

    @property
    def _roots(self) -> int:
        roots = self.options.roots + self.many * self.options.more_roots
        return max(1, round(self.options.roots_close_up * roots)) if self.observation.cut_out else roots

    @property
    def _per_part(self) -> int:
        if self.observation.scene:
            return self.options.scene_hypotheses_per_part
        return self.options.hypotheses_per_part + self.many * self.options.more_hypotheses

    def reached(
        self,
        solution: Candidates,
        anchors: Ints,
        hypotheses: Hypotheses,
        seed: int,
        starts: int,
        keep: int,
        tolerance: float,
    ) -> Candidates:
        """Return configurations of which the joints bring a part to where each of the hypotheses has it.

        It is reached from the part of `anchors` (m,), which stays as in `solution` (one). The joints between are solved
        from random `starts`, at most `keep` times, and may leave a distance of `tolerance`.
        """
        return Candidates(
            *self.comparison.native.reach(
                solution.bases, solution.values, np.zeros(len(anchors), np.int32), anchors, hypotheses.parts,
                hypotheses.placements, seed, starts, keep, tolerance,
            )
        )  # fmt: skip

    def aligned(self, parts: Ints, placements: Array, iterations: int) -> Hypotheses:
        """Return placed parts (m,), (m, 4, 4), each moved on its own to where it fits the scan, with scores."""
        return Hypotheses(*self.comparison.native.refine_parts(parts, placements, iterations))

    def distinct_hypotheses(self, hypotheses: Hypotheses, count: int, apart: float) -> Ints:
        """Return which hypotheses, the first `count`, place their part farther than `apart`, on average over its
        surface, from where those before them do."""
        return self.comparison.native.distinct_parts(hypotheses.parts, hypotheses.placements, count, apart)


def halved(points: Singles, chosen: Indices, times: int) -> list[Indices]:
    """Return the `chosen` of some points (n, 3) in two to the power of `times` compact pieces of equal size."""
    if times == 0:
        return [chosen]
    along = points[chosen][:, int(np.argmax(points[chosen].std(axis=0)))]
    order = chosen[np.argsort(along, kind="stable")]
    middle = len(order) // 2
    return halved(points, order[:middle], times - 1) + halved(points, order[middle:], times - 1)
