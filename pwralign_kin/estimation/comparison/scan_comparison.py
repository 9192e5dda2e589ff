"""Configurations of a model compared with an observed scan: scored, held against its points, moved to where they fit.

Nothing is proposed here. What proposes configurations, and what judges those that were found, compares them by this.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from pwralign_kin import kernels
from pwralign_kin.arrays import Bools, Ints, Singles
from pwralign_kin.estimation.comparison.candidates import Candidates
from pwralign_kin.estimation.comparison.search_options import BAND, SearchOptions
from pwralign_kin.estimation.knowledge.prior import SearchPrior
from pwralign_kin.estimation.sensing.observation import ALL_SIDES, ONE_SIDE, Observation
from pwralign_kin.estimation.sensing.points import median
from pwralign_kin.model.surface import Surface, part_weights, total_area
from pwralign_kin.se3 import Array, transform

Look = TypeVar("Look", bound=tuple[NDArray[Any], ...])

FOCUS_PROBES = 60
"""Surface samples of each part that say what is near to a candidate."""
CONTRADICTED, WORSE = -0.2, 0.85
"""Support of a part from which on the evidence speaks against it: in single views, where nothing speaks for it, and in
others as a share of that of the median part."""
ALIKE = 0.7
"""Cosine between the normals of a scan point and of the model there, from which they agree."""
SPARSE = 1.2
"""Spacings of points within which one confirms surface, where that is farther than a point's reach."""
LEAST_PICTURED = 0.25
"""Share of the surface that a picture holds, at least."""
REMEMBERED = 8
"""Looks at one candidate that are kept: the stages ask the same of the same answer in turn."""
MOST_REACH = 0.9 * BAND
"""A point lies on the model nowhere beyond this, however noisy: of all others none would be told to be near it."""


@dataclass(frozen=True)
class Sought:
    """A model, and how scans are searched for it."""

    model: kernels.Articulated
    """With the limits of the search."""
    surfaces: Sequence[Surface]
    options: SearchOptions
    threads: int


class ScanComparison:
    """Compares configurations of one model with one observed scan. It never changes, but for what it remembers."""

    def __init__(
        self, sought: Sought, observation: Observation, known: SearchPrior, searched: Bools | None = None
    ) -> None:
        """Take what is `sought`, and what is `known` of its base and joints.

        Only scan points that are `searched` (m,) are looked at; without it those of any region.
        """
        model, surfaces, options, threads = sought.model, sought.surfaces, sought.options, sought.threads
        self.sought = sought
        self.model = model
        self.observation = observation
        self.options = options
        self.threads = threads
        self.exists = np.array([s.exists for s in surfaces], bool)
        self.areas = np.array([s.area for s in surfaces])
        self.weights = part_weights(surfaces)
        self.surfaces = surfaces
        self.parent = model.parent
        self.searched = observation.regions >= 0 if searched is None else searched
        self.coverage_scale = self._coverage_scale(total_area(surfaces))
        self.known = known
        self.native = kernels.Search(model, observation.field, self._kernel_options(), known.values)
        known.tell(self.native)
        self._marked = searched
        if searched is not None:
            self.native.look_first(searched.astype(np.uint8))
        self._looks: dict[tuple[str, bytes, bytes, bytes], Any] = {}

    def _kernel_options(self) -> kernels.SearchOptions:
        options, observation = self.options, self.observation
        native = kernels.SearchOptions()
        native.support_distance = min(BAND, max(options.support_distance, 1.3 * observation.spacing))
        native.coverage_distance = options.coverage_distance
        native.support_weight = options.support_weight
        if observation.scene:
            native.support_weight = options.scene_support_weight
            native.near_penalty = options.scene_near_penalty
            native.mismatch_penalty = options.scene_mismatch_penalty
        if observation.scene or observation.cut_out:
            native.normal_penalty = options.scene_normal_penalty
        native.two_way = options.two_way
        native.solid = options.solid
        native.coverage_scale = self.coverage_scale
        native.angle_step = options.angle_step
        native.beam, native.modes, native.branch_beam = options.beam, options.modes, options.branch_beam
        native.threads = self.threads
        return native

    def _coverage_scale(self, area: float) -> float:
        """Return by how much coverage must be scaled up because the scan holds more than the model."""
        share = self._usual_share
        if self.observation.scene:
            # Little of the model may be seen: what it explains is measured by what it usually shows.
            areas, regions = self.observation.areas, self.observation.regions
            return float(areas[self.searched].sum()) / min(area * share, float(areas[regions >= 0].sum()))
        count = len(self.observation.points)
        expected = max(area * share / self.observation.area_per_point, 0.05 * count)
        return count / min(count, expected)

    @property
    def _usual_share(self) -> float:
        """Share of the visible surface that a single view, or views from all around, usually show."""
        return ONE_SIDE if self.observation.single_view else ALL_SIDES

    def tolerant(self) -> ScanComparison:
        """Return the same for a single view that may have holes: where no ray came back is hardly free space.

        Masks cut pieces of a model away. Through them a view seems to look past it, so that the truth has much
        against it, and false answers that hide what is missing have little.
        """
        if not self.observation.single_view or self.observation.scene:
            return self
        field = self.observation.field.with_unreturned(self.options.tolerant_unreturned)
        return self.of(replace(self.observation, field=field))

    def about(self, candidate: Candidates, reach: float) -> ScanComparison:
        """Return the same of only those points of a scene that are within `reach` of one candidate, if any.

        Samples of the whole scene hold few points of thin parts.
        """
        from scipy.spatial import cKDTree

        tree = cKDTree(self.probe_positions(candidate, FOCUS_PROBES)[0])
        near = self.searched & np.isfinite(tree.query(self.observation.points, distance_upper_bound=reach)[0])
        if not near.any():
            return self
        return self.with_options(replace(self.options, scene_points=self.options.near_points), near)

    def of(self, observation: Observation) -> ScanComparison:
        """Return the same comparison with another observation about the same centre."""
        return ScanComparison(self.sought, observation, self.known)

    def knowing(self, known: SearchPrior) -> ScanComparison:
        """Return the same comparison by another prior of base and joints."""
        return ScanComparison(self.sought, self.observation, known, self._marked)

    def with_options(self, options: SearchOptions, searched: Bools) -> ScanComparison:
        """Return the same comparison by other options, with the `searched` points (m,) looked at alone."""
        return ScanComparison(replace(self.sought, options=options), self.observation, self.known, searched)

    def poorly_supported(self, support: Singles) -> Bools:
        """Return which parts (parts,) the evidence speaks against, by the support of one candidate."""
        usual = float(np.median(support[self.exists]))
        return self.exists & (support < (CONTRADICTED if self.observation.single_view else WORSE * usual))

    @property
    def sigma(self) -> float:
        """Smallest robust scale that the noise of the scan allows."""
        return max(self.options.least_sigma, 1.2 * self.observation.noise)

    def largest_parts(self, count: int) -> Ints:
        """Return the parts with surface in decreasing size, at most `count`."""
        order = np.argsort(-self.areas * self.exists, kind="stable")
        return np.array([i for i in order[:count] if self.exists[i]], np.int32)

    def scored(self, candidates: Candidates, points: int | None = None) -> tuple[Candidates, Singles]:
        """Return the candidates with two-way scores, and the support (m, parts) of each part; by a sample of `points`
        about the model."""
        total, _, support = self._score(candidates, points)
        return candidates.with_scores(total), support

    def seen_shares(self, candidates: Candidates) -> Singles:
        """Return per part (m, parts) the share of its surface that should be seen and is."""
        return self._seen(self._score(candidates)[2])

    def _seen(self, support: Singles) -> Singles:
        # Single views score only what is missing.
        return np.asarray(np.clip(1 + support if self.observation.single_view else support, 0, 1), np.float32)

    def scored_both_ways(self, candidates: Candidates, tight: float) -> tuple[Singles, Singles]:
        """Return the sum of coarse and tight score of each candidate, and that of the shares that it explains."""
        points = int(self.searched.sum())
        distances = (self.options.coverage_distance, tight)
        coarse, fine = self.native.score(candidates.bases, candidates.values, points, distances)
        return coarse[0] + fine[0], coarse[1] + fine[1]

    def weighed(self, candidates: Candidates) -> tuple[Singles, Singles, Singles]:
        """Return the two-way score of each candidate, the weighted share of the scan that it explains, and the
        `seen_shares` of its parts."""
        total, coverage, support = self._score(candidates)
        return total, coverage, self._seen(support)

    def coverage(self, candidates: Candidates, points: int | None = None) -> Singles:
        """Return the weighted share of the scan that each candidate explains; by a sample of `points` about it."""
        return self._score(candidates, points)[1]

    def _score(self, candidates: Candidates, points: int | None = None) -> tuple[Singles, Singles, Singles]:
        if points is None and len(candidates) == 1:
            return self._remembered("score", candidates, self.exists, lambda: self._scores(candidates, None))
        return self._scores(candidates, points)

    def _scores(self, candidates: Candidates, points: int | None) -> tuple[Singles, Singles, Singles]:
        points = self._spread(points) if points else int(self.searched.sum())
        return self.native.score(candidates.bases, candidates.values, points, [self.options.coverage_distance])[0]

    def _spread(self, points: int) -> int:
        """Return how many points to draw for `points` of them to be about the model."""
        return min(int(self.searched.sum()), self.options.scene_points * points) if self.observation.scene else points

    def refined(
        self,
        candidates: Candidates,
        *,
        points: int | None = None,
        iterations: int = 15,
        sigma: float = 0.03,
        support_weight: float = 0.5,
        part_weights: Singles | None = None,
    ) -> Candidates:
        """Return the candidates after batch Gauss-Newton from robust scale `sigma` down to the noise."""
        if part_weights is None:
            part_weights = np.tile(self.weights, (len(candidates), 1))
        support_weight = support_weight if self.options.two_way else 0.0
        bases, values, _ = self.native.refine(
            candidates.bases, candidates.values, self._spread(points or self.options.refine_points), iterations, sigma,
            self.sigma, support_weight, part_weights,
        )  # fmt: skip
        return Candidates(bases, values, candidates.scores)

    def swept(
        self,
        candidate: Candidates,
        joints: Ints,
        base_moves: Bools,
        keep: int,
        with_joints: Ints | None = None,
        behind: float = np.inf,
    ) -> Candidates:
        """Return the best `keep` values of each of `joints` in turn, all else as in `candidate` (one), with scores.

        What hangs on the joint moves, or all the rest where `base_moves`. A joint of `with_joints`, further out, is
        swept together with the first in steps twice as long; -1: none. Values that score less than the candidate does
        on the same points, by more than `behind`, are left out.
        """
        together = np.full_like(joints, -1) if with_joints is None else with_joints
        return self._swept(candidate, np.zeros_like(joints), joints, base_moves, together, keep, behind)

    def swept_each(self, candidates: Candidates, joint: int, with_joint: int, keep: int) -> Candidates:
        """Return the best `keep` values of one joint of each of the candidates, what hangs on it moving, with scores.

        The joint `with_joint`, further out, is swept together with it; -1: none.
        """
        rows = np.arange(len(candidates), dtype=np.int32)
        joints, together = np.full_like(rows, joint), np.full_like(rows, with_joint)
        return self._swept(candidates, rows, joints, np.zeros(len(rows), bool), together, keep, np.inf)

    def _swept(
        self,
        candidates: Candidates,
        rows: Ints,
        joints: Ints,
        base_moves: Bools,
        together: Ints,
        keep: int,
        behind: float,
    ) -> Candidates:
        moving = base_moves.astype(np.uint8)
        return Candidates(
            *self.native.sweep(candidates.bases, candidates.values, rows, joints, moving, together, keep, behind)
        )

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

    def distinct(self, candidates: Candidates, count: int, apart: float) -> Candidates:
        """Return the best `count` candidates whose surfaces differ by more than `apart` on average."""
        ordered = candidates.best_first()
        return ordered.take(self.native.distinct_configurations(ordered.bases, ordered.values, count, apart))

    def unexplained(self, candidate: Candidates) -> float:
        """Return the share of scan points far from the surface of one candidate."""
        distance = self.owners(candidate, self.exists)[0]
        if self.observation.scene:
            # Most of a scene is other things: only what is searched and near the model should be explained.
            distance = distance[self.searched & (distance < self.options.near)]
        return float(np.mean(distance > self.reach)) if len(distance) else 1.0

    def is_contradicted(self, candidate: Candidates) -> bool:
        """Return whether a single view sees free space, or other surface, where one candidate has much of its own."""
        if not self.observation.single_view:
            return False
        support = self.scored(candidate)[1][0]
        return -float(support @ (self.weights * self.exists)) > self.options.contradicted

    def passes(self, candidates: Candidates, point: Singles) -> Bools:
        """Return which of the candidates (m,) have surface near `point` (1, 3)."""
        distances = self.distances(point, self.part_placements(candidates), self.exists, BAND)
        return np.asarray(distances[:, 0] < self.options.near)

    def owners(self, candidate: Candidates, parts: Bools) -> tuple[Singles, Ints]:
        """Return per scan point its distance (at most `BAND`) from one candidate's nearest of `parts`, and which."""
        return self._owners(candidate, parts)[:2]

    def _owners(self, candidate: Candidates, parts: Bools) -> tuple[Singles, Ints, Ints]:
        def look() -> tuple[Singles, Ints, Ints]:
            return self.native.owners(self.part_placements(candidate)[0], parts.astype(np.uint8), BAND)

        return self._remembered("owners", candidate, parts, look)

    def lying(self, candidate: Candidates) -> tuple[Singles, Ints, Singles]:
        """Return per scan point its distance (at most `BAND`) from one candidate's nearest part, which that is (-1:
        none), and the cosine between the point's normal and the model's there (0 for none)."""
        distance, part, sample = self._owners(candidate, self.exists)
        cosine = self.native.facing(self.observation.normals, self.part_placements(candidate)[0], part, sample)
        return distance, part, np.asarray(cosine)

    def given_owners(self, candidate: Candidates) -> tuple[Singles, Ints]:
        """Return per given point its distance (at most `BAND`) from one candidate, and the nearest part (-1: none)."""

        def look() -> tuple[Singles, Ints]:
            return self.assigned(self.observation.given, self.part_placements(candidate)[0], self.exists, BAND)

        return self._remembered("given", candidate, self.exists, look)

    def _remembered(self, what: str, candidate: Candidates, parts: Bools, look: Callable[[], Look]) -> Look:
        """Return what a `look` at one candidate finds; it is not to be written to."""
        key = (what, candidate.bases.tobytes(), candidate.values.tobytes(), parts.tobytes())
        if key not in self._looks:
            found = look()
            for array in found:
                array.flags.writeable = False
            while len(self._looks) >= REMEMBERED:
                del self._looks[next(iter(self._looks))]
            self._looks[key] = found
        kept: Look = self._looks[key]
        return kept

    def confirmed(self, candidate: Candidates) -> tuple[float, float, float]:
        """Return the share of one candidate's surface in sight that scan points confirm: they lie on it, and are
        oriented like it. In sight of a sensor is what faces it and nothing hides; without one, all.

        The second is the share of that alone which points lie on at all, 1 where none do: a hole in the scan does not
        speak against a surface, one that crosses it does. The third is the share of the whole surface that is in
        sight."""
        shown, near, confirmed = self._in_sight(self.part_placements(candidate)[0], ALIKE)
        whole = float(self.areas[self.exists].sum())
        return confirmed / max(shown, 1e-9), confirmed / near if near > 0.0 else 1.0, shown / whole

    def confirmed_share(self, placements: Array, size: float) -> float:
        """Return the first of that for parts placed (parts, 4, 4), so many times as large by their placements."""
        shown, _, confirmed = self._in_sight(placements, min(size * ALIKE, 1.0))
        return confirmed / max(shown, 1e-9)

    def _in_sight(self, placements: Array, cosine: float) -> tuple[float, float, float]:
        """Return the area in sight, that which points lie on, and that which they are oriented like."""
        distance = min(max(self.reach, SPARSE * self.observation.spacing), MOST_REACH)
        sight = self.native.in_sight(np.ascontiguousarray(placements), distance, cosine)
        shown, near, confirmed = (float(self.areas @ own) for own in sight)
        return shown, near, confirmed

    def pictured(self, candidate: Candidates) -> float:
        """Return the share of one candidate's surface that is within the picture of a view; 1 where nothing cuts it."""
        observation = self.observation
        if observation.sensor_origin is None or len(observation.borders) == 0:
            return 1.0
        placements, inside = self.part_placements(candidate)[0], 0.0
        for part in map(int, np.flatnonzero(self.exists)):
            rays = transform(placements[part], self.surfaces[part].samples.astype(float)) - observation.sensor_origin
            inside += float(self.areas[part] * (rays @ observation.borders.T <= 0.0).all(axis=1).mean())
        return max(inside / float(self.areas[self.exists].sum()), LEAST_PICTURED)

    def explained_shares(self, owners: Ints) -> Singles:
        """Return per part the scanned area that lies on it over the area of it that a scan usually shows."""
        area = self.observation.areas if self.observation.scene else self.observation.area_per_point
        own = np.bincount(owners[owners >= 0], (area * np.ones(len(owners)))[owners >= 0], len(self.exists))
        return np.asarray(own / np.maximum(self.areas * self._usual_share, 1e-9), np.float32)

    def fair_shares(self, owners: Ints) -> Singles:
        """Return the `explained_shares`, at most 1; of what the median part has, where that is more than it should.

        Noise spreads the points of thin parts over more area than they have.
        """
        shares = self.explained_shares(owners)
        fair = max(1.0, float(np.median(shares[self.exists])))
        return np.asarray(np.minimum(shares / fair, 1.0), np.float32)

    def lacking(self, shares: Singles) -> Bools:
        """Return which parts (parts,) explain too little of the scan, by their `fair_shares`.

        The measure is the average of all parts: a sparse scan shows less of every part.
        """
        average = float(shares @ self.weights) / float(self.weights[self.exists].sum())
        return self.exists & (shares <= self.options.lacking * average)

    def lacks(self, candidate: Candidates) -> Bools:
        """Return which parts (parts,) of one candidate explain too little of the scan."""
        return self.lacking(self.fair_shares(self.owners(candidate, self.exists)[1]))

    def residual(self, candidate: Candidates) -> float:
        """Return the robust standard deviation of the given points that lie on one candidate."""
        return self.residual_of(self.given_owners(candidate)[0])

    def residual_of(self, distance: Singles) -> float:
        """Return the robust standard deviation of points that lie on the model, by the distances of all."""
        near = distance[distance < self.reach]
        # The median of a half-normal distribution is 0.6745 standard deviations.
        return median(near) / 0.6745 if len(near) else 0.0

    @property
    def reach(self) -> float:
        """Distance within which a scan point lies on the model, less than the kernels tell of what does not."""
        return min(MOST_REACH, 0.02 + 2 * self.observation.noise)

    @property
    def noise_reach(self) -> float:
        """Distance from the model beyond which noise does not explain a scan point that lies on it."""
        return 0.005 + 3.0 * self.observation.noise

    def assigned(self, points: Singles, placements: Array, parts: Bools, reach: float) -> tuple[Singles, Ints]:
        """Return per point its distance (at most `reach`) from the nearest of `parts` placed (parts, 4, 4), and which;
        -1 for none."""
        mask = parts.astype(np.uint8)
        distance, part, _ = self.native.assign(points, np.ascontiguousarray(placements), mask, reach)
        return np.asarray(distance), np.asarray(part)

    def distances(
        self, points: Singles, placements: Array, parts: Bools, reach: float, *, loosely: bool = False
    ) -> Singles:
        """Return (m, n) the distances (at most `reach`) of points (n, 3) from the nearest of `parts`, for each of
        several sets of placements (m, parts, 4, 4).

        The samples that a point is held against may be off the closest by the size of a grid's cell. `loosely`, that
        does not make a point lie beyond an edge.
        """
        flat = np.ascontiguousarray(placements).reshape(-1, 4, 4)
        return np.asarray(self.native.distances(points, flat, parts.astype(np.uint8), reach, loosely))

    def facing(self, points: Singles, normals: Singles, placements: Array, parts: Bools, reach: float) -> Singles:
        """Return per point (n, 3) the cosine between its normal and that of the nearest of `parts` placed
        (parts, 4, 4) within `reach`; 0 for none."""
        _, owner, sample = self.native.assign(points, placements, parts.astype(np.uint8), reach)
        return np.asarray(self.native.facing(normals, placements, owner, sample))

    def normal_equations(
        self, placements: Array, scale: float, reach: float, support_weight: float, *, along_rays: bool
    ) -> tuple[Array, Array, Ints]:
        """Return information (parts, 6, 6) and gradients (parts, 6) of the given points on parts placed (parts, 4, 4),
        in twist space, and how many (parts,) points are of each.

        A robust kernel of this `scale` weighs those within `reach`, and model samples count by `support_weight`. Points
        are matched to what a sensor sees there where they are matched `along_rays`.
        """
        observation = self.observation
        weight = support_weight * self.options.two_way
        return self.native.normal_equations(
            placements, observation.given, observation.given_normals, scale, reach, weight, self.weights, along_rays
        )

    def base_prior(self, base: Array) -> tuple[Array, Array]:
        """Return the normal matrix (6, 6) and right-hand side (6,) of what is known of the `base` (4, 4)."""
        return self.native.base_prior(base[None])
