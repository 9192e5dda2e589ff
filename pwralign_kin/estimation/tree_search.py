"""The search without a guess: part hypotheses, grown through the kinematic tree, scored in both directions, refined."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pwralign_kin import kernels
from pwralign_kin.estimation.candidates import Candidates, Hypotheses
from pwralign_kin.estimation.correspondences import OrientedPairs
from pwralign_kin.estimation.observation import Observation
from pwralign_kin.estimation.prior import SearchPrior
from pwralign_kin.model.surface import Surface, part_weights, total_area
from pwralign_kin.se3 import Array

Float = NDArray[np.float32]
Ints = NDArray[np.int32]


@dataclass(frozen=True)
class SearchOptions:
    """How many hypotheses are made and kept, and how they are grown and scored. Lengths in model diagonals."""

    root_parts: int = 7
    """The largest parts that hypotheses start from."""
    hypotheses_per_part: int = 12
    roots: int = 60
    """Part hypotheses that are grown into whole configurations."""
    many_parts: int = 16
    """Models with more parts than this get `more_*` in addition."""
    more_root_parts: int = 4
    more_hypotheses: int = 3
    more_roots: int = 30
    more_refined: int = 12
    angle_step: float = float(np.radians(6))
    """Step of the sweep of a revolute joint, rad."""
    beam: int = 8
    """States kept along a chain."""
    modes: int = 5
    """Values kept of each joint."""
    branch_beam: int = 2
    """States kept at a branching."""
    wide_beam: int = 96
    """The same where the answer leaves much unexplained."""
    wide_modes: int = 16
    wide_branch_beam: int = 3
    refined: int = 24
    """Grown configurations that are refined together."""
    refine_points: int = 900
    fine_points: int = 1500
    sift_points: int = 800
    """Scan points that decide which of many candidates are worth refining."""
    support_weight: float = 0.6
    """Weight of model support (model to scan) against scan coverage (scan to model)."""
    two_way: bool = True
    """Whether model support counts at all."""
    support_distance: float = 0.035
    coverage_distance: float = 0.03
    least_sigma: float = 0.005
    """Smallest robust scale of the refinement."""
    distinct: float = 0.03
    """Mean displacement of the surface below which two configurations are the same."""


class TreeSearch:
    """The search of one model in one observed scan."""

    def __init__(
        self,
        model: Any,
        surfaces: Sequence[Surface],
        observation: Observation,
        neutral: Array,
        options: SearchOptions,
        threads: int,
        known: SearchPrior | None = None,
    ) -> None:
        """Take the `kernels.Articulated` model with its limits, the `neutral` values (k,) of unseen joints, a prior."""
        self.model = model
        self.observation = observation
        self.options = options
        self.neutral = neutral
        self.threads = threads
        self.exists = np.array([s.exists for s in surfaces], bool)
        self.areas = np.array([s.area for s in surfaces])
        self.weights = part_weights(surfaces)
        self.surfaces = surfaces
        self.parent = model.parent
        native = kernels.SearchOptions()
        native.support_distance = min(0.06, max(options.support_distance, 1.3 * observation.spacing))
        native.coverage_distance = options.coverage_distance
        native.support_weight = options.support_weight
        native.two_way = options.two_way
        self.coverage_scale = self._coverage_scale(total_area(surfaces))
        native.coverage_scale = self.coverage_scale
        native.angle_step = options.angle_step
        native.beam, native.modes, native.branch_beam = options.beam, options.modes, options.branch_beam
        native.threads = threads
        self.native = kernels.Search(model, observation.field, native, neutral)
        self.known = known or SearchPrior.nothing(neutral)
        self.known.tell(self.native)

    def _coverage_scale(self, area: float) -> float:
        """Return by how much coverage must be scaled up because the scan holds more than the model."""
        # Share of the visible surface that a single view, or views from all around, usually show.
        share = 0.42 if self.observation.single_view else 0.85
        count = len(self.observation.points)
        expected = max(area * share / self.observation.area_per_point, 0.05 * count)
        return count / min(count, expected)

    def widened(self) -> TreeSearch:
        """Return the same search with the wide beams."""
        o = self.options
        wide = replace(o, beam=o.wide_beam, modes=o.wide_modes, branch_beam=o.wide_branch_beam)
        return TreeSearch(self.model, self.surfaces, self.observation, self.neutral, wide, self.threads, self.known)

    def poorly_supported(self, support: Float) -> NDArray[np.bool_]:
        """Return which parts (parts,) the evidence speaks against, by the support of one candidate."""
        usual = float(np.median(support[self.exists]))
        return self.exists & (support < (-0.2 if self.observation.single_view else 0.85 * usual))

    @property
    def sigma(self) -> float:
        """Smallest robust scale that the noise of the scan allows."""
        noise = self.observation.noise
        return max(self.options.least_sigma, 1.2 * noise if noise > 0.0055 else 0.0)

    def largest_parts(self, count: int) -> Ints:
        """Return the parts with surface in decreasing size, at most `count`."""
        order = np.argsort(-self.areas * self.exists, kind="stable")
        return np.array([i for i in order[:count] if self.exists[i]], np.int32)

    def pair_hypotheses(self, seed: int) -> Hypotheses:
        """Return poses of the largest parts from oriented point pairs."""
        o = self.options
        return Hypotheses(
            *self.native.part_hypotheses(
                self.largest_parts(o.root_parts + self.many * o.more_root_parts), seed, self._per_part
            )
        )

    def correspondence_hypotheses(self, pairs: Sequence[OrientedPairs], seed: int) -> Hypotheses:
        """Return poses of parts from correspondences, in minimal samples of two."""
        found = [
            Hypotheses(
                *self.native.correspondence_hypotheses(
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

    def promising(self, hypotheses: Hypotheses) -> Hypotheses:
        """Return the hypotheses worth growing, best first."""
        # A large part explains more: its hypotheses deserve more trials.
        rank = -hypotheses.scores * self.weights[hypotheses.parts] ** 0.3
        count = self.options.roots + self.many * self.options.more_roots
        return hypotheses.take(np.argsort(rank, kind="stable")[:count])

    @property
    def many(self) -> bool:
        """Whether the model has so many parts that the search needs more of everything."""
        return len(self.exists) > self.options.many_parts

    @property
    def _per_part(self) -> int:
        return self.options.hypotheses_per_part + self.many * self.options.more_hypotheses

    def grow(self, hypotheses: Hypotheses) -> Candidates:
        """Return for each placed part the best whole configuration grown from it (scored by growth alone)."""
        return Candidates(*self.native.grow(hypotheses.parts, hypotheses.placements))

    def grow_from_bases(self, bases: Array, keep: int) -> Candidates:
        """Return the best `keep` configurations grown from each placement (m, 4, 4) of the root part."""
        count = len(bases)
        values = np.tile(self.neutral, (count, 1))
        each, root = np.arange(count, dtype=np.int32), np.zeros(count, np.int32)
        weights = np.tile(self.weights, (count, 1))
        return Candidates(*self.native.regrow(bases, values, each, root, root - 1, weights, keep))

    def scored(self, candidates: Candidates, distance: float | None = None) -> tuple[Candidates, Float]:
        """Return the candidates with two-way scores, and the support (m, parts) of each part."""
        total, _, support = self._score(candidates, distance or self.options.coverage_distance)
        return Candidates(candidates.bases, candidates.values, total), support

    def sifted(self, candidates: Candidates, count: int) -> Candidates:
        """Return the best `count` candidates by a two-way score on few points, best first."""
        total, _, _ = self._score(candidates, self.options.coverage_distance, self.options.sift_points)
        return Candidates(candidates.bases, candidates.values, total).best_first().take(slice(count))

    def coverage(self, candidates: Candidates) -> Float:
        """Return the weighted share of the scan that each candidate explains."""
        return self._score(candidates, self.options.coverage_distance)[1]

    def _score(self, candidates: Candidates, distance: float, points: int | None = None) -> tuple[Float, Float, Float]:
        points = points or len(self.observation.points)
        return self.native.score(candidates.bases, candidates.values, points, distance)

    def refined(
        self,
        candidates: Candidates,
        *,
        points: int | None = None,
        iterations: int = 15,
        sigma: float = 0.03,
        support_weight: float = 0.5,
        part_weights: Float | None = None,
    ) -> Candidates:
        """Return the candidates after batch Gauss-Newton from robust scale `sigma` down to the noise."""
        if part_weights is None:
            part_weights = np.tile(self.weights, (len(candidates), 1))
        support_weight = support_weight if self.options.two_way else 0.0
        bases, values, _ = self.native.refine(
            candidates.bases, candidates.values, points or self.options.refine_points, iterations, sigma,
            self.sigma, support_weight, part_weights,
        )  # fmt: skip
        return Candidates(bases, values, candidates.scores)

    def part_placements(self, candidates: Candidates) -> Array:
        """Return the placements (m, parts, 4, 4) of all parts."""
        return np.asarray(self.model.forward(candidates.bases, candidates.values))

    def probe_positions(self, candidates: Candidates, per_part: int = 12) -> Array:
        """Return positions (m, p, 3) of a few samples of every part, to compare configurations by."""
        T = self.part_placements(candidates)
        placed = [
            s.samples[:per_part] @ np.swapaxes(T[:, i, :3, :3], 1, 2) + T[:, i, None, :3, 3]
            for i, s in enumerate(self.surfaces)
            if s.exists
        ]
        return np.concatenate(placed, axis=1)

    def distinct(self, candidates: Candidates, count: int) -> Candidates:
        """Return the best `count` candidates whose surfaces differ by more than `options.distinct` on average."""
        ordered = candidates.best_first()
        positions = self.probe_positions(ordered)
        kept: list[int] = []
        for i in range(len(ordered)):
            apart = [np.linalg.norm(positions[i] - positions[j], axis=1).mean() for j in kept]
            if not apart or min(apart) > self.options.distinct:
                kept.append(i)
            if len(kept) >= count:
                break
        return ordered.take(np.array(kept, int))

    def unexplained(self, candidate: Candidates) -> float:
        """Return the share of scan points far from the surface of one candidate."""
        return float(np.mean(self._distances(candidate, self.observation.points) > self.reach))

    def residual(self, candidate: Candidates) -> float:
        """Return the robust standard deviation of the given points that lie on one candidate."""
        distance = self._distances(candidate, self.observation.given)
        near = distance[distance < self.reach]
        # The median of a half-normal distribution is 0.6745 standard deviations.
        return float(np.median(near)) / 0.6745 if len(near) else 0.0

    @property
    def reach(self) -> float:
        """Distance within which a scan point lies on the model."""
        return 0.02 + 2 * self.observation.noise

    def _distances(self, candidate: Candidates, points: Float) -> Float:
        placements = np.ascontiguousarray(self.part_placements(candidate)[0])
        return np.asarray(self.native.assign(points, placements, self.exists.astype(np.uint8), 0.06)[0])
