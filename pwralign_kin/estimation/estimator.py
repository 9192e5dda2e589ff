"""The whole estimate: observe, hypothesise, grow, refine, repair, solve, judge."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from pwralign_kin.estimation.answer_search import EFFORTS, AnswerSearch, finest, total_coverage
from pwralign_kin.estimation.candidates import Candidates
from pwralign_kin.estimation.confidence import confidence, gathered
from pwralign_kin.estimation.correspondences import Correspondences
from pwralign_kin.estimation.equal_answers import equal_answers
from pwralign_kin.estimation.joint_least_squares import JointLeastSquares, Solution
from pwralign_kin.estimation.joint_profile import profiled
from pwralign_kin.estimation.likelihood import likeliest
from pwralign_kin.estimation.observation import Observation, observe, without_far_points
from pwralign_kin.estimation.options import EstimatorOptions
from pwralign_kin.estimation.prior import JOINT_REACH
from pwralign_kin.estimation.result import Alternative, Estimate, PartEstimate
from pwralign_kin.estimation.scene import is_scene, observe_scene
from pwralign_kin.estimation.stopwatch import Stopwatch
from pwralign_kin.estimation.surface_mixture import solved
from pwralign_kin.estimation.tree_search import TreeSearch
from pwralign_kin.estimation.uncertainty import (
    WEAK_DISPLACEMENT,
    Errors,
    covariance,
    inverse_covariance,
    observed_errors,
    probe_displacements,
    undetermined_joints,
)
from pwralign_kin.exceptions import StateError, UnknownNameError
from pwralign_kin.model import ArticulatedModel
from pwralign_kin.scan import Scan
from pwralign_kin.se3 import Array, inverse, transform
from pwralign_kin.state import State

NO_COST = 0.004
"""Score that an undetermined joint may cost when it is set to its prior, ..."""
NO_POINTS = 3.0
"""... and scan points that it may leave unexplained, ..."""
NO_SUPPORT = 0.15
"""... and support that it may cost any one part: that of a small part is little of the score, ..."""
NO_LIKELIHOOD = 5.0
"""... and logarithm of the likelihood of all scan points."""
NO_RIVAL = 6.0
"""Log-likelihood by which the best value of a weakly determined joint must be better than all others."""
EQUAL = 0.01
"""Score within which the scan cannot tell two answers apart."""
EQUAL_POINTS = 600
"""Scan points that answers made from the model's symmetry are refined with."""


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
        if options.effort not in EFFORTS:
            raise UnknownNameError("effort", options.effort, tuple(EFFORTS))
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
        with fit.watch.stage("equal answers"):
            solution, equal = self._chosen(fit, solution, initial)
        return self.concluded(fit, solution, equal)

    def fit(self, scan: Scan, initial: State | None, correspondences: Correspondences | None) -> Fit:
        """Return all answers worth comparing, before the joint least squares."""
        watch = Stopwatch(self.progress)
        prior = self._prior(initial)
        lower, upper = self._bounds(prior)
        with watch.stage("observe"):
            observation = self._observe(scan, initial)
            search = self._search(observation, prior, lower, upper)
        answers = AnswerSearch(self.model, search, self.options, correspondences, watch)
        if initial is None:
            solutions = answers.without_guess()
        else:
            solutions = answers.from_guess(observation.to_search(self.model.root_placement(initial)), prior)
        with watch.stage("finish"):
            finished = answers.finished(solutions)
        solver = JointLeastSquares(self.model, search, lower, upper, self.options.least_squares)
        return Fit(scan, solver, finished, prior, watch)

    def concluded(self, fit: Fit, solution: Solution, equal: Candidates | None = None) -> Estimate:
        """Return the estimate that a solution of the joint least squares makes; None: its `equal` answers are made."""
        search = fit.solver.search
        if equal is None:
            equal = equal_answers(self.model, search, _candidate(solution))
        with fit.watch.stage("least squares"):
            solution, judged = self._judge(search, fit.solver, solution, fit.prior)
        return self._report(fit.scan, search, fit.finished, solution, equal, judged, fit.watch)

    def _observe(self, scan: Scan, initial: State | None) -> Observation:
        """Prepare the scan: as one of the model, or as a scene that the model is somewhere in."""
        model, options = self.model, self.options
        if options.region is None and not is_scene(
            scan, model.diagonal, model.reach, options.scene, options.observation, self.threads
        ):
            near = without_far_points(scan, model.reach)
            return observe(near, model.diagonal, options.observation, self.threads)
        box = self._searched_box(initial)
        return observe_scene(
            scan, model.surfaces, model.diagonal, box, options.observation, options.scene, self.threads
        )

    def _searched_box(self, initial: State | None) -> tuple[Array, Array]:
        """Return the corners of the box (scan frame, m) that the guess and the hints leave to search."""
        low, high = np.full(3, -np.inf), np.full(3, np.inf)
        if self.options.region is not None:
            low, high = np.array(self.options.region[:3], float), np.array(self.options.region[3:], float)
        if self.options.near is not None:
            low = np.maximum(low, np.array(self.options.near) - self.model.reach)
            high = np.minimum(high, np.array(self.options.near) + self.model.reach)
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

    def _solve(self, solver: JointLeastSquares, finished: Candidates) -> Solution:
        base, values = finished.bases[0], finished.values[0]
        if solver.search.known.held:
            base = solver.search.known.placement
        if not self.options.least_squares.enabled:
            problem = solver.build(base, values, solver.robust_scale(base, values))
            return Solution(base, values, problem, True, 0)
        return solved(solver, base, solver.limited(values))

    def _chosen(self, fit: Fit, solution: Solution, initial: State | None) -> tuple[Solution, Candidates]:
        """Return which of the answers that look alike is meant, and the others: by a guess or else by likelihood."""
        search = fit.solver.search
        answer = _candidate(solution)
        equal = equal_answers(self.model, search, answer)
        if len(equal) == 0 or search.known.held:
            return solution, equal
        several = Candidates.concatenate([answer, equal])
        if initial is None:
            chosen = likeliest(fit.solver, several)
        else:
            base = search.observation.to_search(self.model.root_placement(initial))
            guess = Candidates(base[None], fit.prior[None], np.zeros(1, np.float32))
            apart = search.probe_positions(several) - search.probe_positions(guess)
            chosen = int(np.argmin(np.linalg.norm(apart, axis=-1).reshape(len(several), -1).mean(axis=1)))
        if chosen > 0:
            solution = solved(fit.solver, several.bases[chosen], fit.solver.limited(several.values[chosen]))
        return solution, several.take(np.arange(len(several)) != chosen)

    def _judge(
        self, search: TreeSearch, solver: JointLeastSquares, solution: Solution, prior: Array
    ) -> tuple[Solution, Doubt]:
        """Find the joints that the scan does not tell, and give them their prior value where that costs nothing."""
        final = _candidate(solution)
        errors = observed_errors(search, final, solution.problem)
        # Points of its neighbours touch a part that the scan lacks.
        absent = search.scored(final)[1][0] <= 0.0 if not search.observation.single_view else ~search.exists
        displacement = probe_displacements(solution.problem, absent, self.slide, solver.locked)
        undetermined = undetermined_joints(displacement, solver.locked, errors)
        weak = undetermined & ~undetermined_joints(displacement, solver.locked, errors, WEAK_DISPLACEMENT)
        if weak.any():
            solution, sure = self._compared(solver, solution, np.flatnonzero(weak), errors)
            undetermined &= ~sure
        if undetermined.any():
            base, values = solution.base, solution.values.copy()
            for joint in np.flatnonzero(undetermined):
                base, values = self._at_prior(search, base, values, int(joint), prior)
            solution = solved(solver.with_locked(undetermined, values), base, values, solution.problem.blur)
        H = inverse_covariance(solution.problem, absent, errors, solver.upper - solver.lower)
        return solution, Doubt(undetermined, covariance(H, solver.locked, undetermined))

    def _compared(
        self, solver: JointLeastSquares, solution: Solution, weak: NDArray[np.int64], errors: Errors
    ) -> tuple[Solution, NDArray[np.bool_]]:
        """Give weakly determined joints their best values; return too which (k,) have no rival to them."""
        sure = np.zeros(len(solution.values), bool)
        for joint in weak:
            profile = profiled(solver, solution.base, solution.values, int(joint), errors)
            sure[joint] = profile.margin > NO_RIVAL
            if sure[joint] and profile.gain > 0.0:
                solution = solved(solver, profile.base, solver.limited(profile.values), solution.problem.blur)
        return solution, sure

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
        scores, coverage = search.weighed(choices)
        best = int(np.argmax(scores[1:])) + 1
        lost = (coverage[0] - coverage[best]) * len(search.observation.points)
        seen = _seen_shares(search.scored(choices)[1], search.observation)
        hidden = float((seen[0] - seen[best]).max(initial=0.0, where=search.exists))
        if scores[best] < scores[0] - NO_COST or lost > NO_POINTS or hidden > NO_SUPPORT:
            return base, values
        likelihood = finest(search, choices) * len(search.observation.given)
        if likelihood[best] < likelihood[0] - NO_LIKELIHOOD:
            return base, values
        return bases[best], moved

    def _report(
        self,
        scan: Scan,
        search: TreeSearch,
        finished: Candidates,
        solution: Solution,
        equal: Candidates,
        judged: Doubt,
        watch: Stopwatch,
    ) -> Estimate:
        model, observation = self.model, search.observation
        final = _candidate(solution)
        seen = _seen_shares(search.scored(final)[1][0], observation)
        with watch.stage("confidence"):
            evidence = gathered(search, final, finished)
        with watch.stage("equal answers"):
            others = self._others(search, final, finished, equal)
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

    def _others(self, search: TreeSearch, final: Candidates, finished: Candidates, made: Candidates) -> Candidates:
        """Return what the search found besides the answer, and what the model's symmetry `made` of it, best first."""
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


def _candidate(solution: Solution) -> Candidates:
    return Candidates(solution.base[None], solution.values[None], np.zeros(1, np.float32))


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
