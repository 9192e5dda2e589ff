"""The search without a guess: part hypotheses, grown through the kinematic tree, scored in both directions, refined."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from pwralign_kin import kernels
from pwralign_kin.checked_options import CheckedOptions, Count, Natural, NotNegative, Positive, Range, Share
from pwralign_kin.estimation.knowledge.correspondences import OrientedPairs
from pwralign_kin.estimation.knowledge.prior import SearchPrior
from pwralign_kin.estimation.search.candidates import Candidates, Hypotheses
from pwralign_kin.estimation.sensing.observation import ALL_SIDES, ONE_SIDE, Observation, median
from pwralign_kin.model.surface import Surface, part_weights, total_area
from pwralign_kin.se3 import Array, transform

Float = NDArray[np.float32]
Ints = NDArray[np.int32]
Index = Sequence[int] | NDArray[Any]
Look = TypeVar("Look", bound=tuple[NDArray[Any], ...])

FOCUS_PROBES = 60
"""Surface samples of each part that say what is near to a candidate."""


CONTRADICTED, WORSE = -0.2, 0.85
"""Support of a part from which on the evidence speaks against it: in single views, where nothing speaks for it, and in
others as a share of that of the median part."""
BAND = 0.06
"""Distances beyond this (model diagonals) are all the same to the kernels."""
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
class SearchOptions(CheckedOptions):
    """How many hypotheses are made and kept, and how they are grown and scored. Lengths in model diagonals."""

    root_parts: Count = 7
    """The largest parts that hypotheses start from."""
    hypotheses_per_part: Count = 12
    scene_hypotheses_per_part: Count = 28
    """The same in each region of a scene, where other things look like parts."""
    roots: Count = 60
    """Part hypotheses that are grown into whole configurations."""
    many_parts: Natural = 16
    """Models with more parts than this get `more_*` in addition."""
    halvings: Annotated[int, Range(0, 20)] = 3
    """How often a scan that has no convincing answer is halved into pieces with hypotheses of their own, ..."""
    anchors_per_piece: Count = 50
    roots_per_piece: Count = 40
    """... and how many of these are grown, of each piece."""
    more_root_parts: Natural = 4
    more_hypotheses: Natural = 3
    more_roots: Natural = 30
    more_refined: Natural = 12
    angle_step: Annotated[float, Range(float(np.radians(0.1)), np.pi)] = float(np.radians(6))
    """Step of the sweep of a revolute joint, rad."""
    beam: Count = 8
    """States kept along a chain."""
    modes: Count = 5
    """Values kept of each joint."""
    branch_beam: Count = 2
    """States kept at a branching."""
    wide_beam: Count = 96
    """The same from a known base, and for the limbs that the answer to a scene lacks."""
    wide_modes: Count = 16
    wide_branch_beam: Count = 3
    refined: Count = 24
    """Grown configurations that are refined together."""
    refine_points: Count = 900
    fine_points: Count = 1500
    lacking: NotNegative = 0.6
    """A part that explains less than this, against the average of all parts, may be wrong."""
    scene_points: Count = 4
    """How many times as many points of a scene are used, ..."""
    near_points: Count = 2
    """... and of what is near to one candidate."""
    sift_points: Count = 800
    """Scan points that decide which of many candidates are worth refining."""
    support_weight: NotNegative = 0.6
    """Weight of model support (model to scan) against scan coverage (scan to model)."""
    tolerant_unreturned: Share = 0.1
    """How free space is where no ray came back, once a single view has no convincing answer: it may have holes."""
    scene_support_weight: NotNegative = 1.5
    """The same where the scan is of a whole scene: a false answer hides where little speaks for or against it."""
    scene_normal_penalty: NotNegative = 1.8
    """Share of a point's gain lost when its normal is at right angles to the model's: more than all, in a scene and in
    what is cut out of one, or limbs would explain the things that touch the model."""
    scene_near_penalty: NotNegative = 0.3
    """Gain lost by a point near the model that it does not explain."""
    scene_mismatch_penalty: NotNegative = 0.5
    two_way: bool = True
    """Whether model support counts at all."""
    solid: bool = False
    """Whether parts that no joint connects may not be inside each other. Meshes of real machines often are."""
    support_distance: Positive = 0.035
    coverage_distance: Positive = 0.03
    least_sigma: Positive = 0.005
    """Smallest robust scale of the refinement."""
    contradicted: Share = 0.1
    """Share of its surface that a single view may contradict of a right answer: 0.02 to 0.05 at true poses, 0.07 where
    a real sensor bends surfaces."""
    near: NotNegative = BAND - 1e-4
    """Points of a scene nearer than this should be of the model; the last distance that the kernels tell."""
    distinct: NotNegative = 0.03
    """Mean displacement of the surface below which two configurations are the same solution, ..."""
    alike: NotNegative = 0.004
    """... and below which they are not worth refining both."""


@dataclass(frozen=True)
class Sought:
    """A model, and how scans are searched for it."""

    model: Any
    """The `kernels.Articulated` with its limits."""
    surfaces: Sequence[Surface]
    options: SearchOptions
    threads: int


class TreeSearch:
    """The search of one model in one observed scan."""

    def __init__(
        self, sought: Sought, observation: Observation, known: SearchPrior, searched: NDArray[np.bool_] | None = None
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
        self.coverage_scale = self._coverage_scale(total_area(surfaces))
        native.coverage_scale = self.coverage_scale
        native.angle_step = options.angle_step
        native.beam, native.modes, native.branch_beam = options.beam, options.modes, options.branch_beam
        native.threads = threads
        self.native = kernels.Search(model, observation.field, native, known.values)
        self._looks: dict[tuple[str, bytes, bytes, bytes], Any] = {}
        self.known = known
        self.known.tell(self.native)
        if searched is not None:
            self.native.look_first(searched.astype(np.uint8))

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

    def widened(self) -> TreeSearch:
        """Return the same search with wide beams."""
        o = self.options
        wide = replace(o, beam=o.wide_beam, modes=o.wide_modes, branch_beam=o.wide_branch_beam)
        return self._with(wide, self.searched)

    def tolerant(self) -> TreeSearch:
        """Return the same search for a single view that may have holes: where no ray came back is hardly free space.

        Masks cut pieces of a model away. Through them a view seems to look past it, so that the truth has much
        against it, and false answers that hide what is missing have little.
        """
        if not self.observation.single_view or self.observation.scene:
            return self
        field = self.observation.field.with_unreturned(self.options.tolerant_unreturned)
        return self.of(replace(self.observation, field=field))

    def about(self, candidate: Candidates, reach: float) -> TreeSearch:
        """Return the same search of only those points of a scene that are within `reach` of one candidate, if any.

        Samples of the whole scene hold few points of thin parts.
        """
        from scipy.spatial import cKDTree

        tree = cKDTree(self.probe_positions(candidate, FOCUS_PROBES)[0])
        near = self.searched & np.isfinite(tree.query(self.observation.points, distance_upper_bound=reach)[0])
        if not near.any():
            return self
        return self._with(replace(self.options, scene_points=self.options.near_points), near)

    def of(self, observation: Observation) -> TreeSearch:
        """Return the same search of another observation about the same centre."""
        return TreeSearch(self.sought, observation, self.known)

    def _with(self, options: SearchOptions, searched: NDArray[np.bool_]) -> TreeSearch:
        return TreeSearch(replace(self.sought, options=options), self.observation, self.known, searched)

    def poorly_supported(self, support: Float) -> NDArray[np.bool_]:
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

    def pair_hypotheses(self, seed: int, region: int = 0, anchors: int = 400, more: float = 1.0) -> Hypotheses:
        """Return poses of the largest parts from oriented point pairs of one region, drawn about `anchors` points.

        Of each part, `more` times as many as usual.
        """
        o = self.options
        largest = self.largest_parts(o.root_parts + self.many * o.more_root_parts)
        points = np.flatnonzero(self.observation.regions == region)
        return self.part_hypotheses(
            largest, [points] * len(largest), anchors, seed, round(more * self._per_part), self.observation.weights
        )

    def piecewise_hypotheses(self, seed: int) -> Hypotheses:
        """Return promising poses of the largest parts from oriented point pairs within each of some pieces of the scan.

        What is left of a part that is cut or covered makes a worse pose than whole parts that only coincide with
        surface elsewhere: each piece has its own share.
        """
        o = self.options
        largest = self.largest_parts(o.root_parts + self.many * o.more_root_parts)
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
        self, parts: Ints, points: Sequence[NDArray[np.int64]], anchors: int, seed: int, count: int, weights: Float
    ) -> Hypotheses:
        """Return at most `count` poses of each of `parts` from oriented pairs of the scan points it is looked for in.

        The first point of a pair is one of `anchors`. `weights` (n,) of all scan points count in the scores.
        """
        return Hypotheses(
            *self.native.part_hypotheses(
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

    def promising(self, hypotheses: Hypotheses, count: int | None = None) -> Hypotheses:
        """Return the hypotheses worth growing, best first, at most `count`."""
        # A large part explains more: its hypotheses deserve more trials.
        rank = -hypotheses.scores * self.weights[hypotheses.parts] ** 0.3
        count = count or self.options.roots + self.many * self.options.more_roots
        return hypotheses.take(np.argsort(rank, kind="stable")[:count])

    @property
    def many(self) -> bool:
        """Whether the model has so many parts that the search needs more of everything."""
        return len(self.exists) > self.options.many_parts

    @property
    def share_tried(self) -> float:
        """Share of what is tried for a model of few parts: time grows with the number of parts."""
        return min(1.0, self.options.many_parts / len(self.exists))

    @property
    def _per_part(self) -> int:
        if self.observation.scene:
            return self.options.scene_hypotheses_per_part
        return self.options.hypotheses_per_part + self.many * self.options.more_hypotheses

    def grow(self, hypotheses: Hypotheses, keep: int = 1) -> Candidates:
        """Return the best `keep` whole configurations grown from each placed part (scored by growth alone)."""
        return Candidates(*self.native.grow(hypotheses.parts, hypotheses.placements, keep))

    def grow_from_bases(self, bases: Array, keep: int) -> Candidates:
        """Return the best `keep` configurations grown from each placement (m, 4, 4) of the root part."""
        count = len(bases)
        placed = Candidates(bases, np.tile(self.known.values, (count, 1)), np.zeros(count, np.float32))
        root = np.zeros(count, np.int32)
        return self.regrown(placed, np.arange(count), root, root - 1, keep)

    def regrown(self, candidates: Candidates, rows: Index, starts: Index, nexts: Index, keep: int) -> Candidates:
        """Return for each task the best `keep` configurations in which all from a part of `nexts` on is grown anew.

        It hangs on the part of `starts`, its neighbour, which stays as in the candidate of `rows` with the rest; -1:
        all but that part is grown.
        """
        row, start, following = (np.asarray(each, np.int32) for each in (rows, starts, nexts))
        weights = np.tile(self.weights, (len(row), 1))
        return Candidates(
            *self.native.regrow(candidates.bases, candidates.values, row, start, following, weights, keep)
        )

    def swept(
        self,
        candidate: Candidates,
        joints: Ints,
        base_moves: NDArray[np.bool_],
        keep: int,
        with_joints: Ints | None = None,
    ) -> Candidates:
        """Return the best `keep` values of each of `joints` in turn, all else as in `candidate` (one), with scores.

        What hangs on the joint moves, or all the rest where `base_moves`. A joint of `with_joints`, further out, is
        swept together with the first in steps twice as long; -1: none.
        """
        together = np.full_like(joints, -1) if with_joints is None else with_joints
        return Candidates(
            *self.native.sweep(
                candidate.bases, candidate.values, np.zeros_like(joints), joints, base_moves.astype(np.uint8),
                together, keep,
            )
        )  # fmt: skip

    def scored(self, candidates: Candidates) -> tuple[Candidates, Float]:
        """Return the candidates with two-way scores, and the support (m, parts) of each part."""
        total, _, support = self._score(candidates)
        return Candidates(candidates.bases, candidates.values, total), support

    def seen_shares(self, candidates: Candidates) -> Float:
        """Return per part (m, parts) the share of its surface that should be seen and is."""
        return self._seen(self._score(candidates)[2])

    def _seen(self, support: Float) -> Float:
        # Single views score only what is missing.
        return np.asarray(np.clip(1 + support if self.observation.single_view else support, 0, 1), np.float32)

    def scored_both_ways(self, candidates: Candidates, tight: float) -> tuple[Float, Float]:
        """Return the sum of coarse and tight score of each candidate, and that of the shares that it explains."""
        points = int(self.searched.sum())
        distances = (self.options.coverage_distance, tight)
        coarse, fine = self.native.score(candidates.bases, candidates.values, points, distances)
        return coarse[0] + fine[0], coarse[1] + fine[1]

    def sifted(self, candidates: Candidates, count: int, varied: int = 0) -> Candidates:
        """Return the best `count` candidates, none nearly the same, by a two-way score on few points, best first.

        At most `varied` others follow, the best that differ from the first and from each other in whole limbs.
        """
        total, _, _ = self._score(candidates, self.options.sift_points)
        ordered = Candidates(candidates.bases, candidates.values, total).best_first()
        best = self.distinct(ordered.take(slice(4 * count)), count, self.options.alike)
        if varied == 0:
            return best
        others = self.distinct(ordered, varied + 1, self.options.distinct)
        return self.distinct(Candidates.concatenate([best, others]), count + varied, self.options.alike)

    def weighed(self, candidates: Candidates) -> tuple[Float, Float, Float]:
        """Return the two-way score of each candidate, the weighted share of the scan that it explains, and the
        `seen_shares` of its parts."""
        total, coverage, support = self._score(candidates)
        return total, coverage, self._seen(support)

    def coverage(self, candidates: Candidates, points: int | None = None) -> Float:
        """Return the weighted share of the scan that each candidate explains; by a sample of `points` about it."""
        return self._score(candidates, points)[1]

    def _score(self, candidates: Candidates, points: int | None = None) -> tuple[Float, Float, Float]:
        if points is None and len(candidates) == 1:
            return self._remembered("score", candidates, self.exists, lambda: self._scores(candidates, None))
        return self._scores(candidates, points)

    def _scores(self, candidates: Candidates, points: int | None) -> tuple[Float, Float, Float]:
        points = self._spread(points) if points else int(self.searched.sum())
        return self.native.score(candidates.bases, candidates.values, points, [self.options.coverage_distance])[0]

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
            candidates.bases, candidates.values, self._spread(points or self.options.refine_points), iterations, sigma,
            self.sigma, support_weight, part_weights,
        )  # fmt: skip
        return Candidates(bases, values, candidates.scores)

    def _spread(self, points: int) -> int:
        """Return how many points to draw for `points` of them to be about the model."""
        return min(int(self.searched.sum()), self.options.scene_points * points) if self.observation.scene else points

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

    def passes(self, candidates: Candidates, point: Float) -> NDArray[np.bool_]:
        """Return which of the candidates (m,) have surface near `point` (1, 3)."""
        distances = self.distances(point, self.part_placements(candidates), self.exists, BAND)
        return np.asarray(distances[:, 0] < self.options.near)

    def owners(self, candidate: Candidates, parts: NDArray[np.bool_]) -> tuple[Float, Ints]:
        """Return per scan point its distance (at most `BAND`) from one candidate's nearest of `parts`, and which."""
        return self._owners(candidate, parts)[:2]

    def _owners(self, candidate: Candidates, parts: NDArray[np.bool_]) -> tuple[Float, Ints, Ints]:
        def look() -> tuple[Float, Ints, Ints]:
            return self.native.owners(self.part_placements(candidate)[0], parts.astype(np.uint8), BAND)

        return self._remembered("owners", candidate, parts, look)

    def lying(self, candidate: Candidates) -> tuple[Float, Ints, Float]:
        """Return per scan point its distance (at most `BAND`) from one candidate's nearest part, which that is (-1:
        none), and the cosine between the point's normal and the model's there (0 for none)."""
        distance, part, sample = self._owners(candidate, self.exists)
        cosine = self.native.facing(self.observation.normals, self.part_placements(candidate)[0], part, sample)
        return distance, part, np.asarray(cosine)

    def given_owners(self, candidate: Candidates) -> tuple[Float, Ints]:
        """Return per given point its distance (at most `BAND`) from one candidate, and the nearest part (-1: none)."""

        def look() -> tuple[Float, Ints]:
            return self.assigned(self.observation.given, self.part_placements(candidate)[0], self.exists, BAND)

        return self._remembered("given", candidate, self.exists, look)

    def _remembered(self, what: str, candidate: Candidates, parts: NDArray[np.bool_], look: Callable[[], Look]) -> Look:
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

    def confirmed(self, candidate: Candidates) -> tuple[float, float]:
        """Return the share of one candidate's surface in sight that scan points confirm: they lie on it, and are
        oriented like it. In sight of a sensor is what faces it and nothing hides; without one, all.

        The second is the share of that alone which points lie on at all, 1 where none do: a hole in the scan does not
        speak against a surface, one that crosses it does."""
        placements = np.ascontiguousarray(self.part_placements(candidate)[0])
        distance = min(max(self.reach, SPARSE * self.observation.spacing), MOST_REACH)
        shown, near, confirmed = (float(self.areas @ own) for own in self.native.in_sight(placements, distance, ALIKE))
        return confirmed / max(shown, 1e-9), confirmed / near if near > 0.0 else 1.0

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

    def explained_shares(self, owners: Ints) -> Float:
        """Return per part the scanned area that lies on it over the area of it that a scan usually shows."""
        area = self.observation.areas if self.observation.scene else self.observation.area_per_point
        own = np.bincount(owners[owners >= 0], (area * np.ones(len(owners)))[owners >= 0], len(self.exists))
        return np.asarray(own / np.maximum(self.areas * self._usual_share, 1e-9), np.float32)

    def fair_shares(self, owners: Ints) -> Float:
        """Return the `explained_shares`, at most 1; of what the median part has, where that is more than it should.

        Noise spreads the points of thin parts over more area than they have.
        """
        shares = self.explained_shares(owners)
        fair = max(1.0, float(np.median(shares[self.exists])))
        return np.asarray(np.minimum(shares / fair, 1.0), np.float32)

    def lacking(self, shares: Float) -> NDArray[np.bool_]:
        """Return which parts (parts,) explain too little of the scan, by their `fair_shares`.

        The measure is the average of all parts: a sparse scan shows less of every part.
        """
        average = float(shares @ self.weights) / float(self.weights[self.exists].sum())
        return self.exists & (shares <= self.options.lacking * average)

    def lacks(self, candidate: Candidates) -> NDArray[np.bool_]:
        """Return which parts (parts,) of one candidate explain too little of the scan."""
        return self.lacking(self.fair_shares(self.owners(candidate, self.exists)[1]))

    def residual(self, candidate: Candidates) -> float:
        """Return the robust standard deviation of the given points that lie on one candidate."""
        return self.residual_of(self.given_owners(candidate)[0])

    def residual_of(self, distance: Float) -> float:
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

    def assigned(self, points: Float, placements: Array, parts: NDArray[np.bool_], reach: float) -> tuple[Float, Ints]:
        """Return per point its distance (at most `reach`) from the nearest of `parts` placed (parts, 4, 4), and which;
        -1 for none."""
        mask = parts.astype(np.uint8)
        distance, part, _ = self.native.assign(points, np.ascontiguousarray(placements), mask, reach)
        return np.asarray(distance), np.asarray(part)

    def distances(
        self, points: Float, placements: Array, parts: NDArray[np.bool_], reach: float, *, loosely: bool = False
    ) -> Float:
        """Return (m, n) the distances (at most `reach`) of points (n, 3) from the nearest of `parts`, for each of
        several sets of placements (m, parts, 4, 4).

        The samples that a point is held against may be off the closest by the size of a grid's cell. `loosely`, that
        does not make a point lie beyond an edge.
        """
        flat = np.ascontiguousarray(placements).reshape(-1, 4, 4)
        return np.asarray(self.native.distances(points, flat, parts.astype(np.uint8), reach, loosely))


def halved(points: Float, chosen: NDArray[np.int64], times: int) -> list[NDArray[np.int64]]:
    """Return the `chosen` of some points (n, 3) in two to the power of `times` compact pieces of equal size."""
    if times == 0:
        return [chosen]
    along = points[chosen][:, int(np.argmax(points[chosen].std(axis=0)))]
    order = chosen[np.argsort(along, kind="stable")]
    middle = len(order) // 2
    return halved(points, order[:middle], times - 1) + halved(points, order[middle:], times - 1)
