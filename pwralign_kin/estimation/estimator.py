"""The whole estimate: observe, hypothesise, grow, refine, repair, solve, judge."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np

from pwralign_kin.estimation.answer_search import AnswerSearch
from pwralign_kin.estimation.candidates import Candidates
from pwralign_kin.estimation.contest import contested
from pwralign_kin.estimation.correspondences import Correspondences
from pwralign_kin.estimation.equal_answers import equal_answers
from pwralign_kin.estimation.evidence import Evidence, gathered
from pwralign_kin.estimation.joint_least_squares import JointLeastSquares, Solution
from pwralign_kin.estimation.likelihood import likeliest
from pwralign_kin.estimation.observability import Doubt, doubted
from pwralign_kin.estimation.observation import Observation, observe, without_far_points
from pwralign_kin.estimation.options import EstimatorOptions
from pwralign_kin.estimation.prior import JOINT_REACH
from pwralign_kin.estimation.reporting import reported
from pwralign_kin.estimation.result import Estimate
from pwralign_kin.estimation.scene import is_scene, observe_scene
from pwralign_kin.estimation.stopwatch import Stopwatch
from pwralign_kin.estimation.surface_mixture import solved
from pwralign_kin.estimation.tree_search import TreeSearch
from pwralign_kin.exceptions import ScanError, StateError, UnknownNameError
from pwralign_kin.model import ArticulatedModel
from pwralign_kin.scan import Scan
from pwralign_kin.se3 import Array, transform
from pwralign_kin.state import State


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
class Judged:
    """An answer, what the scan does not tell of it, and what speaks for and against it."""

    solution: Solution
    doubt: Doubt
    evidence: Evidence


class Estimator:
    """The pipeline for one model and one set of options."""

    def __init__(
        self,
        model: ArticulatedModel,
        options: EstimatorOptions,
        progress: Callable[[str], None] | None = None,
    ) -> None:
        """Check the options against the model. Raises `UnknownNameError` and `StateError`."""
        for name in (*options.locked, *options.prior_std):
            if name not in model.joint_names:
                raise UnknownNameError("joint", name, model.joint_names)
        model.check_limits(options.prior)
        for name, std in options.prior_std.items():
            if not (np.isfinite(std) and std > 0):
                raise StateError(f"the standard deviation of joint {name!r} must be a positive number, not {std}")
        self.model = model
        self.options = options
        self.progress = progress
        self.threads = options.threads or os.cpu_count() or 1
        self.prior_std = np.array([options.prior_std.get(name, np.inf) for name in model.joint_names])
        self.prior_std /= model.joint_scales

    def run(self, scan: Scan, initial: State | None, correspondences: Correspondences | None) -> Estimate:
        """Return the estimate of one scan."""
        fit = self.fit(scan, initial, correspondences)
        with fit.watch.stage("least squares"):
            solution = self._solve(fit.solver, fit.finished)
        with fit.watch.stage("equal answers"):
            solution, equal = self._chosen(fit, solution, initial)
        judged = self._judged(fit, solution)
        with fit.watch.stage("contest"):
            finished = contested(fit.solver.search, judged.solution.configuration, judged.evidence, fit.finished)
        if finished is not None:
            fit = replace(fit, finished=finished)
            with fit.watch.stage("least squares"):
                solution = self._solve(fit.solver, finished)
            with fit.watch.stage("equal answers"):
                solution, equal = self._chosen(fit, solution, initial)
            judged = self._judged(fit, solution)
        return self._reported(fit, judged, equal)

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

    def concluded(self, fit: Fit, solution: Solution) -> Estimate:
        """Return the estimate that a solution of the joint least squares makes."""
        equal = equal_answers(self.model, fit.solver.search, solution.configuration)
        return self._reported(fit, self._judged(fit, solution), equal)

    def _judged(self, fit: Fit, solution: Solution) -> Judged:
        """Say what the scan does not tell of a solution, and what speaks for and against it."""
        with fit.watch.stage("least squares"):
            solution, doubt = doubted(fit.solver, solution, fit.prior)
        with fit.watch.stage("confidence"):
            evidence = gathered(fit.solver.search, solution.configuration, fit.finished)
        return Judged(solution, doubt, evidence)

    def _reported(self, fit: Fit, judged: Judged, equal: Candidates) -> Estimate:
        return reported(
            fit.scan, fit.solver, judged.solution, judged.doubt, judged.evidence, fit.finished, equal, self.options,
            fit.watch,
        )  # fmt: skip

    def _observe(self, scan: Scan, initial: State | None) -> Observation:
        """Prepare the scan: as one of the model, or as a scene that the model is somewhere in."""
        model, options = self.model, self.options
        self._check_hints(scan)
        if options.region is None and not is_scene(
            scan, model.diagonal, model.reach, options.scene, options.observation, self.threads
        ):
            near = without_far_points(scan, model.reach)
            return observe(near, model.diagonal, options.observation, self.threads)
        box = self._searched_box(initial)
        return observe_scene(
            scan, model.surfaces, model.diagonal, box, options.observation, options.scene, self.threads
        )

    def _check_hints(self, scan: Scan) -> None:
        """Raise `ScanError` for hints that lead away from the scan."""
        low, high = scan.points.min(axis=0), scan.points.max(axis=0)
        extent = f"the scan is from {_point(low)} to {_point(high)} m"
        near, region = self.options.near, self.options.region
        if near is not None:
            away = float(np.linalg.norm(np.maximum(np.maximum(low - near, near - high), 0.0)))
            if away > self.model.reach:
                raise ScanError(scan.source, f"near {_point(near)} is {away:.3g} m away from it: {extent}")
        if region is not None:
            inside = np.all((scan.points >= region[0]) & (scan.points <= region[1]), axis=1)
            if not inside.any():
                raise ScanError(
                    scan.source, f"no point is in the region {_point(region[0])} to {_point(region[1])}: {extent}"
                )

    def _searched_box(self, initial: State | None) -> tuple[Array, Array]:
        """Return the corners of the box (scan frame, m) that the guess and the hints leave to search."""
        low, high = np.full(3, -np.inf), np.full(3, np.inf)
        if self.options.region is not None:
            low, high = np.array(self.options.region)
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
        return np.where(model.continuous, turned, np.clip(values, model.lower, model.upper)) / self.model.joint_scales

    def _bounds(self, prior: Array) -> tuple[Array, Array]:
        """Return the joint limits in search units, narrowed by priors; a locked joint's limits are its prior value."""
        locked = np.isin(self.model.joint_names, self.options.locked)
        lower = np.maximum(self.model.lower / self.model.joint_scales, prior - JOINT_REACH * self.prior_std)
        upper = np.minimum(self.model.upper / self.model.joint_scales, prior + JOINT_REACH * self.prior_std)
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
            problem = solver.build(base, values, solver.robust_scale(solver.residual(base, values)))
            return Solution(base, values, problem, True, 0)
        return solved(solver, base, solver.limited(values))

    def _chosen(self, fit: Fit, solution: Solution, initial: State | None) -> tuple[Solution, Candidates]:
        """Return which of the answers that look alike is meant, and the others: by a guess or else by likelihood."""
        search = fit.solver.search
        answer = solution.configuration
        equal = equal_answers(self.model, search, answer)
        if len(equal) == 0 or search.known.held:
            return solution, equal
        several = Candidates.concatenate([answer, equal])
        if initial is None:
            chosen = likeliest(fit.solver, several)
        else:
            base = search.observation.to_search(self.model.root_placement(initial))
            guess = Candidates.single(base, fit.prior)
            apart = search.probe_positions(several) - search.probe_positions(guess)
            chosen = int(np.argmin(np.linalg.norm(apart, axis=-1).reshape(len(several), -1).mean(axis=1)))
        if chosen > 0:
            solution = solved(fit.solver, several.bases[chosen], fit.solver.limited(several.values[chosen]))
        return solution, several.take(np.arange(len(several)) != chosen)


def _point(values: Iterable[float]) -> str:
    return "(" + ", ".join(f"{value:.3g}" for value in values) + ")"
