"""The whole estimate: observe, hypothesise, grow, refine, repair, solve, judge."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field

import numpy as np
from numpy.typing import NDArray

from pwralign_kin.estimation.candidates import Candidates, Hypotheses
from pwralign_kin.estimation.confidence import confidence, gathered
from pwralign_kin.estimation.correspondences import Correspondences, oriented_pairs
from pwralign_kin.estimation.equal_answers import equal_answers
from pwralign_kin.estimation.joint_least_squares import JointLeastSquares, Solution
from pwralign_kin.estimation.observation import Observation, observe
from pwralign_kin.estimation.options import EstimatorOptions
from pwralign_kin.estimation.prior import JOINT_REACH
from pwralign_kin.estimation.repair import repair
from pwralign_kin.estimation.result import Alternative, Estimate, PartEstimate
from pwralign_kin.estimation.scene import is_scene, model_reach, observe_scene
from pwralign_kin.estimation.scene_search import is_convincing, search_regions
from pwralign_kin.estimation.tree_search import TreeSearch
from pwralign_kin.estimation.uncertainty import covariance, inverse_covariance, observed_errors, undetermined_joints
from pwralign_kin.exceptions import CorrespondenceError, StateError, UnknownNameError
from pwralign_kin.model import ArticulatedModel
from pwralign_kin.scan import Scan
from pwralign_kin.se3 import Array, inverse, transform
from pwralign_kin.state import State

WARM_SIGMAS = (0.03, 0.06, 0.1)
"""Robust scales (model diagonals) that a guess is refined from."""
UNCONVINCING = 0.015
"""A solution that leaves more than this share of the scan unexplained is searched on."""
WORTH_WIDE_BEAMS = 0.1
"""Share of the model's surface in parts that explain too little, from which wide beams are worth their time."""
NEAR_TIE = 0.08
"""Solutions within this score of the best are refined to the end and compared again."""
NO_COST = 0.004
"""Score that an undetermined joint may cost when it is set to its prior, ..."""
NO_POINTS = 3.0
"""... and scan points that it may leave unexplained."""
GROWN_FROM_BASE = 12
"""Configurations that are grown from each placement of a known base."""
EQUAL = 0.01
"""Score within which the scan cannot tell two answers apart."""
EQUAL_POINTS = 600
"""Scan points that answers made from the model's symmetry are refined with."""


@dataclass
class Stopwatch:
    """Seconds per stage."""

    progress: Callable[[str], None] | None = None
    seconds: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Add the time of the block to the stage `name`."""
        if self.progress is not None:
            self.progress(name)
        start = time.perf_counter()
        yield
        self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start


@dataclass(frozen=True)
class Fit:
    """One scan searched: the state of an estimate before the joint least squares."""

    scan: Scan
    solver: JointLeastSquares
    finished: Candidates
    """Distinct answers, best first."""
    prior: Array
    """(k,) values in search units that joints keep where the scan does not tell."""
    watch: Stopwatch


@dataclass(frozen=True)
class Doubt:
    """What the scan does not tell, in search units."""

    undetermined: NDArray[np.bool_]
    """(k,) joints."""
    covariance: Array
    """(6 + k, 6 + k) of base twist and joints; zero rows where undetermined."""


class Estimator:
    """The pipeline for one model and one set of options."""

    def __init__(
        self,
        model: ArticulatedModel,
        options: EstimatorOptions,
        progress: Callable[[str], None] | None = None,
    ) -> None:
        """Check the options against the model. Raises `UnknownNameError` and `StateError`."""
        for name in (*options.locked, *options.prior, *options.prior_std):
            if name not in model.joint_names:
                raise UnknownNameError("joint", name, model.joint_names)
        for name, value in options.prior.items():
            joint = model.joint_names.index(name)
            lower, upper = model.lower[joint], model.upper[joint]
            if not model.continuous[joint] and not lower <= value <= upper:
                raise StateError(f"joint {name!r} cannot be {value:g}: its limits are {lower:g} to {upper:g}")
        for name, std in options.prior_std.items():
            if not (np.isfinite(std) and std > 0):
                raise StateError(f"the standard deviation of joint {name!r} must be a positive number, not {std}")
        self.model = model
        self.options = options
        self.progress = progress
        self.threads = options.threads or os.cpu_count() or 1
        self.slide = np.array([model.units[name] == "m" for name in model.joint_names], bool)
        self.unit = np.where(self.slide, model.diagonal, 1.0)
        self.prior_std = np.array([options.prior_std.get(name, np.inf) for name in model.joint_names]) / self.unit

    def run(self, scan: Scan, initial: State | None, correspondences: Correspondences | None) -> Estimate:
        """Return the estimate of one scan."""
        fit = self.fit(scan, initial, correspondences)
        with fit.watch.stage("least squares"):
            solution = self._solve(fit.solver, fit.finished)
        return self.concluded(fit, solution)

    def fit(self, scan: Scan, initial: State | None, correspondences: Correspondences | None) -> Fit:
        """Return all answers worth comparing, before the joint least squares."""
        watch = Stopwatch(self.progress)
        prior = self._prior(initial)
        lower, upper = self._bounds(prior)
        with watch.stage("observe"):
            observation = self._observe(scan, initial)
            search = self._search(observation, prior, lower, upper)
        if initial is None:
            solutions = self._global(search, correspondences, watch)
        else:
            guess = search.observation.to_search(self.model.root_placement(initial))
            solutions = self._from_guess(search, guess, prior, correspondences, watch)
        near = self._near(observation)
        if near is not None:
            passing = solutions.take(search.passes(solutions, near))
            solutions = passing if len(passing) else solutions
        with watch.stage("finish"):
            finished = self._finish(search, solutions)
        solver = JointLeastSquares(self.model, search, lower, upper, self.options.least_squares)
        return Fit(scan, solver, finished, prior, watch)

    def concluded(self, fit: Fit, solution: Solution) -> Estimate:
        """Return the estimate that a solution of the joint least squares makes."""
        with fit.watch.stage("least squares"):
            solution, judged = self._judge(fit.solver.search, fit.solver, solution, fit.prior)
        return self._report(fit.scan, fit.solver.search, fit.finished, solution, judged, fit.watch)

    def _observe(self, scan: Scan, initial: State | None) -> Observation:
        """Prepare the scan: as one of the model, or as a scene that the model is somewhere in."""
        model, options = self.model, self.options
        reach = model_reach(model.kernel_model, model.surfaces) * model.diagonal
        if options.region is None and not is_scene(
            scan, model.diagonal, reach, options.scene, options.observation, self.threads
        ):
            return observe(scan, model.diagonal, options.observation, self.threads)
        box = self._searched_box(initial, reach)
        return observe_scene(
            scan, model.surfaces, model.diagonal, box, options.observation, options.scene, self.threads
        )

    def _near(self, observation: Observation) -> NDArray[np.float32] | None:
        """Return the point (1, 3) on the model that is told, in the search's frame."""
        return None if self.options.near is None else observation.scaled(np.array([self.options.near]))

    def _searched_box(self, initial: State | None, reach: float) -> tuple[Array, Array]:
        """Return the corners of the box (scan frame, m) that the guess and the hints leave to search."""
        low, high = np.full(3, -np.inf), np.full(3, np.inf)
        if self.options.region is not None:
            low, high = np.array(self.options.region[:3], float), np.array(self.options.region[3:], float)
        if self.options.near is not None:
            low = np.maximum(low, np.array(self.options.near) - reach)
            high = np.minimum(high, np.array(self.options.near) + reach)
        if initial is not None:
            placements = self.model.root_placement(initial) @ self.model.part_placements(
                self.model.values(initial.joints)
            )
            placed = np.concatenate(
                [
                    transform(T, surface.samples.astype(float) * self.model.diagonal)
                    for T, surface in zip(placements, self.model.surfaces, strict=True)
                    if surface.exists
                ]
            )
            margin = self.options.scene.margin * self.model.diagonal
            low = np.maximum(low, placed.min(axis=0) - margin)
            high = np.minimum(high, placed.max(axis=0) + margin)
        return low, high

    def _prior(self, initial: State | None) -> Array:
        """Return the values (k,) in search units that joints start from and keep where the scan does not tell."""
        model = self.model
        values = model.values({**self.options.prior, **(initial.joints if initial else {})})
        span = np.where(model.continuous, model.upper - model.lower, 1.0)
        turned = model.lower + np.mod(values - model.lower, span)
        return np.where(model.continuous, turned, np.clip(values, model.lower, model.upper)) / self.unit

    def _bounds(self, prior: Array) -> tuple[Array, Array]:
        """Return the joint limits in search units, narrowed by priors; a locked joint's limits are its prior value."""
        locked = np.isin(self.model.joint_names, self.options.locked)
        lower = np.maximum(self.model.lower / self.unit, prior - JOINT_REACH * self.prior_std)
        upper = np.minimum(self.model.upper / self.unit, prior + JOINT_REACH * self.prior_std)
        return np.where(locked, prior, lower), np.where(locked, prior, upper)

    def _search(self, observation: Observation, prior: Array, lower: Array, upper: Array) -> TreeSearch:
        native = self.model.kernel_model
        if self.options.locked or self.options.prior_std:
            native = native.restricted(lower, upper)
        known = self.options.base.in_search_units(self.model, observation, prior, self.prior_std)
        return TreeSearch(native, self.model.surfaces, observation, prior, self.options.search, self.threads, known)

    def _global(self, search: TreeSearch, correspondences: Correspondences | None, watch: Stopwatch) -> Candidates:
        """Search without a guess."""
        if search.observation.scene:
            return self._in_scene(search, correspondences, watch)
        with watch.stage("hypotheses"):
            found = self._outside(search, correspondences, self.options.seed)
            if "pairs" in self.options.sources:
                found = Hypotheses.concatenate([search.pair_hypotheses(self.options.seed), found])
            if len(found.parts) == 0:
                raise self._nothing_placed
            hypotheses = search.promising(found)
        with watch.stage("growth"):
            grown = search.grow(hypotheses)
            if search.known.near:
                from_base = search.widened().grow_from_bases(search.known.bases(), GROWN_FROM_BASE)
                grown = Candidates.concatenate([from_base, grown])
        with watch.stage("refinement"):
            kept = search.sifted(grown, search.options.refined + search.many * search.options.more_refined)
            refined = search.scored(search.refined(kept))[0]
        with watch.stage("repair"):
            return self._repaired(search, refined, turn=True)

    def _in_scene(self, search: TreeSearch, correspondences: Correspondences | None, watch: Stopwatch) -> Candidates:
        """Search a scene, again with other samples until an answer is convincing or comes twice."""
        options = self.options.scene_search
        several: list[Candidates] = []
        near, pairs = self._near(search.observation), "pairs" in self.options.sources
        for attempt in range(options.attempts):
            seed = self.options.seed + attempt
            with watch.stage("regions"):
                outside = self._outside(search, correspondences, seed)
                found = search_regions(search, options, self.options.repair, seed, outside, near, pairs=pairs)
            if found is None:
                raise self._nothing_placed
            with watch.stage("repair"):
                several.append(self._repaired(search, found, turn=True))
            best = search.distinct(
                Candidates.concatenate(several), self.options.repair.solutions, search.options.distinct
            )
            as_good = [float(best.scores[0] - own.scores[0]) < options.agree for own in several]
            if sum(as_good) > 1 or is_convincing(search, best.take([0]), options):
                break
        return best

    def _repaired(self, search: TreeSearch, candidates: Candidates, *, turn: bool) -> Candidates:
        """Repair with small beams, and with wide ones where much of the scan is still unexplained."""
        solutions = repair(search, candidates, self.options.repair, turn=turn)
        best = solutions.take([0])
        # A scan that holds more than the model leaves something unexplained however good the answer.
        doubtful = not search.observation.scene and float(search.weights[search.lacks(best)].sum()) > WORTH_WIDE_BEAMS
        if doubtful and search.unexplained(best) > UNCONVINCING:
            solutions = repair(search.widened(), solutions, self.options.repair, turn=False)
        return solutions

    def _outside(self, search: TreeSearch, correspondences: Correspondences | None, seed: int) -> Hypotheses:
        """Return part hypotheses from correspondences: those given, and those of the built-in features."""
        given = [] if correspondences is None else [correspondences]
        if "fpfh" in self.options.sources:
            largest = search.largest_parts(search.options.root_parts)
            given.append(self.options.fpfh.match(self.model, search.observation, largest.tolist()))
        oriented = [oriented_pairs(pairs, self.model, search.observation) for pairs in given]
        return Hypotheses.concatenate(
            [Hypotheses.nothing(), *(search.correspondence_hypotheses(pairs, seed) for pairs in oriented)]
        )

    @property
    def _nothing_placed(self) -> CorrespondenceError:
        sources = self.options.sources
        return CorrespondenceError("estimate", f"no part could be placed in the scan from sources {sources}")

    def _from_guess(
        self,
        search: TreeSearch,
        base: Array,
        values: Array,
        correspondences: Correspondences | None,
        watch: Stopwatch,
    ) -> Candidates:
        """Refine a guess from several scales, repair it; search as well where it leaves much unexplained."""
        start = Candidates(base[None], values[None].copy(), np.zeros(1, np.float32))
        with watch.stage("refinement"):
            starts = [search.refined(start, iterations=25, sigma=sigma) for sigma in WARM_SIGMAS]
            refined = search.scored(Candidates.concatenate(starts))[0]
        with watch.stage("repair"):
            solutions = self._repaired(search, refined, turn=False)
        # Things may touch the model in a scene.
        tolerated = self.options.scene_search.unexplained if search.observation.scene else UNCONVINCING
        if search.unexplained(solutions.take([0])) > tolerated:
            solutions = search.distinct(
                Candidates.concatenate([solutions, self._global(search, correspondences, watch)]),
                self.options.repair.solutions,
                search.options.distinct,
            )
        return solutions

    def _finish(self, search: TreeSearch, solutions: Candidates) -> Candidates:
        """Refine near-ties to the end with all points and rank them by coarse and tight scores together."""
        near = solutions.take(solutions.scores > solutions.scores[0] - NEAR_TIE)
        points = search.options.fine_points
        fine = search.refined(near, points=points, iterations=20, sigma=0.012, support_weight=0.3)
        if not search.observation.single_view:
            # Parts that the scan lacks must not be pulled to their neighbours' points.
            absent = search.exists & (search.scored(fine)[1] < 0.2)
            again = absent.any(axis=1)
            if again.any():
                weights = np.ascontiguousarray(search.weights * ~absent[again], np.float32)
                mended = search.refined(
                    fine.take(again), points=points, sigma=0.012, support_weight=0.3, part_weights=weights
                )
                fine.bases[again], fine.values[again] = mended.bases, mended.values
        return ranked(search, fine)

    def _solve(self, solver: JointLeastSquares, finished: Candidates) -> Solution:
        base, values = finished.bases[0], finished.values[0]
        if solver.search.known.held:
            base = solver.search.known.placement
        if not self.options.least_squares.enabled:
            problem = solver.build(base, values, solver.robust_scale(base, values))
            return Solution(base, values, problem, True, 0)
        return solver.run(base, solver.limited(values))

    def _judge(
        self, search: TreeSearch, solver: JointLeastSquares, solution: Solution, prior: Array
    ) -> tuple[Solution, Doubt]:
        """Find the joints that the scan does not tell, and give them their prior value where that costs nothing."""
        final = Candidates(solution.base[None], solution.values[None], np.zeros(1, np.float32))
        errors = observed_errors(search, final)
        # Points of its neighbours touch a part that the scan lacks.
        absent = search.scored(final)[1][0] <= 0.0 if not search.observation.single_view else ~search.exists
        undetermined = undetermined_joints(solution.problem, absent, self.slide, solver.locked, errors)
        if undetermined.any():
            base, values = solution.base, solution.values.copy()
            for joint in np.flatnonzero(undetermined):
                base, values = self._at_prior(search, base, values, int(joint), prior)
            solution = solver.with_locked(undetermined, values).run(base, values)
        H = inverse_covariance(solution.problem, absent, errors, solver.upper - solver.lower)
        return solution, Doubt(undetermined, covariance(H, solver.locked, undetermined))

    def _at_prior(
        self, search: TreeSearch, base: Array, values: Array, joint: int, prior: Array
    ) -> tuple[Array, Array]:
        """Set one joint to its prior, moving what hangs on it or else all the rest, unless the scan speaks against."""
        moved = values.copy()
        moved[joint] = prior[joint]
        child = next(i for i, part in enumerate(self.model.parts) if part.joint and part.joint.actuated == joint)
        origin, none = np.eye(4)[None], np.zeros(1, np.float32)
        before = search.part_placements(Candidates(origin, values[None], none))[0, child]
        after = search.part_placements(Candidates(origin, moved[None], none))[0, child]
        bases = np.array([base, base, base @ before @ inverse(after)])
        choices = Candidates(bases, np.array([values, moved, moved]), np.zeros(3, np.float32))
        scores, coverage = search.scored(choices)[0].scores, search.coverage(choices)
        best = int(np.argmax(scores[1:])) + 1
        lost = (coverage[0] - coverage[best]) * len(search.observation.points)
        if scores[best] < scores[0] - NO_COST or lost > NO_POINTS:
            return base, values
        return bases[best], moved

    def _report(
        self,
        scan: Scan,
        search: TreeSearch,
        finished: Candidates,
        solution: Solution,
        judged: Doubt,
        watch: Stopwatch,
    ) -> Estimate:
        model, observation = self.model, search.observation
        final = Candidates(solution.base[None], solution.values[None], np.zeros(1, np.float32))
        seen = _seen_shares(search.scored(final)[1][0], observation)
        with watch.stage("confidence"):
            evidence = gathered(search, final, finished)
        with watch.stage("equal answers"):
            others = self._others(search, final, finished)
        state = self._state(observation, solution.base, solution.values)
        T_scan_parts = state.T_scan_base @ model.part_placements(model.values(state.joints))
        labels, distances = self._labels(scan, search, observation.to_search(T_scan_parts))
        explained = labels >= 0
        names = model.joint_names
        variances = np.diag(judged.covariance)[6:] * self.unit**2
        std = np.where(judged.undetermined, self.prior_std * self.unit, np.sqrt(variances))
        scale = np.concatenate([np.ones(3), np.full(3, model.diagonal), self.unit])
        seen_weight = search.weights * search.exists
        return Estimate(
            state=state,
            cost=-float(finished.scores[0]),
            confidence=confidence(evidence),
            evidence=evidence,
            inlier_rmse=_rms(distances[explained]),
            scan_coverage=float(explained.mean()),
            model_support=float(seen @ seen_weight),
            parts={
                part.name: PartEstimate(
                    T_scan_part=T_scan_parts[i],
                    residual=_rms(distances[labels == i]),
                    points=int((labels == i).sum()),
                    support=float(seen[i]) if search.exists[i] else float("nan"),
                )
                for i, part in enumerate(model.parts)
            },
            scan_labels=_per_input(labels, scan),
            undetermined=tuple(name for name, is_so in zip(names, judged.undetermined, strict=True) if is_so),
            std=dict(zip(names, std.tolist(), strict=True)),
            covariance=judged.covariance * np.outer(scale, scale),
            alternatives=tuple(
                Alternative(
                    self._state(observation, others.bases[i], others.values[i]),
                    -float(others.scores[i]),
                    bool(finished.scores[0] - others.scores[i] < EQUAL),
                )
                for i in range(len(others))
            ),
            converged=solution.converged,
            iterations=solution.iterations,
            timings=dict(watch.seconds),
            options=asdict(self.options),
            units={name: model.units[name] for name in names},
        )

    def _others(self, search: TreeSearch, final: Candidates, finished: Candidates) -> Candidates:
        """Return what the search found besides the answer, and what the model's symmetry makes of it, best first."""
        made = equal_answers(self.model, search, final)
        if len(made):
            # Parts only nearly look alike, so that a little refinement may help, or not.
            refined = search.refined(made, points=EQUAL_POINTS, iterations=4, sigma=0.012, support_weight=0.3)
            made = Candidates.concatenate([made, refined])
            # Equal surfaces have equal support, but for how their parts are sampled: what they explain compares them.
            covered = total_coverage(search, Candidates.concatenate([final, made]))
            made = Candidates(made.bases, made.values, finished.scores[0] - (covered[0] - covered[1:]))
        answer = Candidates(final.bases, final.values, np.full(1, np.inf, np.float32))
        several = Candidates.concatenate([answer, finished.take(slice(1, None)), made])
        return search.distinct(several, len(several), search.options.distinct).take(slice(1, None))

    def _state(self, observation: Observation, base: Array, values: Array) -> State:
        joints = np.clip(values * self.unit, self.model.lower, self.model.upper)
        return State(
            T_scan_base=observation.to_scan(base),
            joints=dict(zip(self.model.joint_names, joints.tolist(), strict=True)),
            base_link=self.model.root_link,
        )

    def _labels(self, scan: Scan, search: TreeSearch, placements: Array) -> tuple[NDArray[np.int64], Array]:
        """Return per kept scan point the part it lies on (-1: none) and its distance (m)."""
        distance, part, _ = search.native.assign(
            search.observation.scaled(scan.points),
            np.ascontiguousarray(placements),
            search.exists.astype(np.uint8),
            search.reach,
        )
        return np.asarray(part, np.int64), distance.astype(float) * self.model.diagonal


def ranked(search: TreeSearch, candidates: Candidates) -> Candidates:
    """Return refined candidates by coarse and tight scores together, best first."""
    total = search.scored(candidates)[0].scores + search.scored(candidates, _tight(search, candidates))[0].scores
    return Candidates(candidates.bases, candidates.values, total).best_first()


def total_coverage(search: TreeSearch, candidates: Candidates) -> NDArray[np.float32]:
    """Return the part of these scores that is coverage of the scan."""
    points = int(search.searched.sum())
    several = [
        search.native.score(candidates.bases, candidates.values, points, distance)[1]
        for distance in (search.options.coverage_distance, _tight(search, candidates))
    ]
    return np.asarray(search.coverage_scale * (several[0] + several[1]), np.float32)


def _tight(search: TreeSearch, candidates: Candidates) -> float:
    """Return the distance of the tight score, the first candidate being the best known."""
    blur = search.observation.noise
    if search.observation.scene:
        # Sensors bend whole surfaces besides their noise: what the best answer leaves must not count against it.
        blur = max(blur, search.residual(candidates.take([0])))
    return 0.012 + 1.5 * min(blur, 0.012)


def _seen_shares(support: NDArray[np.float32], observation: Observation) -> NDArray[np.float32]:
    """Return per part the share of its surface that should be seen and is; single views score only what is missing."""
    return np.asarray(np.clip(1 + support if observation.single_view else support, 0, 1), np.float32)


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2))) if len(values) else float("nan")


def _per_input(labels: NDArray[np.int64], scan: Scan) -> NDArray[np.int64]:
    """Spread labels of kept points to all points given; dropped points are nobody's."""
    out = np.full(scan.n_input, -1, np.int64)
    out[scan.source_index] = labels
    return out
