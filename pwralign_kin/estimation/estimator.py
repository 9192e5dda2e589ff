"""From a scan to an answer: observe, hypothesise, grow, refine, repair, solve, judge."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable
from dataclasses import replace
from functools import cached_property

import numpy as np

from pwralign_kin.estimation.answers.answer_search import AnswerSearch
from pwralign_kin.estimation.answers.contest import contested
from pwralign_kin.estimation.answers.equal_answers import equal_answers
from pwralign_kin.estimation.answers.scene_answers import SceneAnswerSearch
from pwralign_kin.estimation.comparison.candidates import Candidates
from pwralign_kin.estimation.comparison.scan_comparison import ScanComparison, Sought
from pwralign_kin.estimation.doubt.observability import doubted
from pwralign_kin.estimation.evidence.evidence import gathered
from pwralign_kin.estimation.evidence.other_size import LEAST_SEEN, other_size
from pwralign_kin.estimation.knowledge.correspondences import Correspondences
from pwralign_kin.estimation.knowledge.prior import JOINT_REACH
from pwralign_kin.estimation.options import EstimatorOptions
from pwralign_kin.estimation.refinement.joint_least_squares import JointLeastSquares
from pwralign_kin.estimation.refinement.likelihood import likeliest
from pwralign_kin.estimation.refinement.problem import Solution
from pwralign_kin.estimation.refinement.surface_mixture import solved
from pwralign_kin.estimation.reporting import reported
from pwralign_kin.estimation.result import Estimate
from pwralign_kin.estimation.search.tree_search import TreeSearch
from pwralign_kin.estimation.sensing.observation import Observation
from pwralign_kin.estimation.sensing.preparation import observe, without_far_points
from pwralign_kin.estimation.sensing.scene import SceneSetup, is_scene, observe_scene
from pwralign_kin.estimation.sensing.sensor_origin import contradicting
from pwralign_kin.estimation.stages import NOTHING_SUPPOSED, Judged, SearchedScan, Suppositions
from pwralign_kin.estimation.stopwatch import Stopwatch
from pwralign_kin.exceptions import ArgumentError, OptionError, ScanError, UnknownNameError
from pwralign_kin.model import ArticulatedModel
from pwralign_kin.scan import Scan
from pwralign_kin.scan.scan import point_text
from pwralign_kin.se3 import Array, transform
from pwralign_kin.state import State

logger = logging.getLogger(__name__)

OUTLINED = 0.06
"""Mean displacement of the surface (model diagonals) within which an answer and what the search ended with are one, but
for what the outline mends: it reaches half as far, and surfaces slide and turn along themselves besides."""
UNLIKE = 0.03
"""Share of strange and astray points from which the size of the model is doubted, as where much of it is not seen."""
CLEARLY = 0.04
"""Gain of a model of another size from which a caller is told: less where the size is right, but for rounded edges, and
0.05 to 0.4 where it is 7 to 15% off."""


class Estimator:
    """The pipeline for one model and one set of options."""

    def __init__(
        self,
        model: ArticulatedModel,
        options: EstimatorOptions,
        progress: Callable[[str], None] | None = None,
    ) -> None:
        """Check the options against the model.

        Raises `ArgumentError` for what is no model, `UnknownNameError`, `OptionError` and `StateError` for options.
        """
        if not isinstance(model, ArticulatedModel):
            reader = "ArticulatedModel.from_urdf(path) reads one"
            raise ArgumentError("model", f"an ArticulatedModel ({reader})", type(model).__name__)
        for name in (*options.locked, *options.prior_std):
            if name not in model.joint_names:
                raise UnknownNameError("joint", name, model.joint_names)
        model.check_limits(options.prior)
        for name, std in options.prior_std.items():
            if std <= 0.0:
                raise OptionError(f"prior_std of joint {name!r}", std, "a finite number above 0")
        self.model = model
        self.options = options
        self.progress = progress
        self.threads = options.threads or os.cpu_count() or 1
        self.prior_std = np.array([options.prior_std.get(name, np.inf) for name in model.joint_names])
        self.prior_std /= model.joint_scales

    @cached_property
    def scenes(self) -> SceneSetup:
        """How scenes are prepared for the model."""
        model, options = self.model, self.options
        return SceneSetup(model.surfaces, model.diagonal, model.reach, options.observation, options.scene, self.threads)

    def searched(
        self,
        scan: Scan,
        initial: State | None,
        correspondences: Correspondences | None,
        watch: Stopwatch | None = None,
        supposed: Suppositions = NOTHING_SUPPOSED,
    ) -> SearchedScan:
        """Return all answers worth comparing, before the joint least squares: those about the guess, or everywhere."""
        watch = watch or Stopwatch(self.progress)
        scan = self._believed(scan)
        prior = self._prior(initial)
        lower, upper = self._bounds(prior)
        with watch.stage("observe"):
            observation = self._observe(scan, initial, supposed)
            search = self._search(observation, prior, lower, upper)
        searching = SceneAnswerSearch if observation.scene else AnswerSearch
        answers = searching(self.model, search, self.options, correspondences, watch)
        near = supposed.start or initial
        if near is None:
            found = answers.without_guess()
        else:
            values = np.clip(self._prior(near), lower, upper)
            found = answers.from_guess(observation.to_search(self.model.root_placement(near)), values)
        with watch.stage("finish"):
            finished = answers.finished(found)
        solver = JointLeastSquares(self.model, found.comparison, lower, upper, self.options.least_squares)
        return SearchedScan(scan, initial, correspondences, solver, finished, prior, watch)

    def finished(self, searched: SearchedScan) -> Estimate:
        """Return the estimate that a search makes, or a better answer if its contest finds one."""
        judged, equal = self._settled(searched)
        with searched.watch.stage("contest"):
            finished = contested(searched.solver, judged.solution.configuration, searched.finished, self.options)
        if finished is not None:
            searched = replace(searched, finished=finished)
            judged, equal = self._settled(searched)
        return reported(searched, judged, equal, self.options)

    def concluded(self, searched: SearchedScan, solution: Solution) -> Estimate:
        """Return the estimate that a solution of the joint least squares makes."""
        equal = equal_answers(self.model, searched.solver.comparison, solution.configuration)
        return reported(searched, self._judged(searched, solution), equal, self.options)

    def _settled(self, searched: SearchedScan) -> tuple[Judged, Candidates]:
        """Return the best answer solved and judged, and those that look alike."""
        with searched.watch.stage("least squares"):
            solution = self._solve(searched.solver, searched.finished)
        with searched.watch.stage("equal answers"):
            solution, equal = self._chosen(searched.seeing(solution.view), solution)
        return self._judged(searched.seeing(solution.view), solution), equal

    def _believed(self, scan: Scan) -> Scan:
        """Return the scan without a sensor origin that its points contradict."""
        hidden = contradicting(scan, self.model.diagonal)
        if not hidden:
            return scan
        logger.warning(
            "%s: its sensor origin is not used: from there, %.0f%% of the points are behind others; is it in the frame "
            "of the scan, and is the scan of one view?",
            scan.source, 100.0 * hidden,
        )  # fmt: skip
        return scan.without_sensor_origin()

    def _judged(self, searched: SearchedScan, solution: Solution) -> Judged:
        """Say what the scan does not tell of a solution, and what speaks for and against it."""
        with searched.watch.stage("least squares"):
            solution, doubt = doubted(searched.solver, solution, searched.prior)
        with searched.watch.stage("confidence"):
            evidence = gathered(searched.solver.comparison, bearing_out(searched, solution), searched.finished)
            if evidence.strange + evidence.astray > UNLIKE or evidence.in_sight < LEAST_SEEN:
                size = other_size(searched.solver, solution)
                evidence = replace(evidence, size=size.factor, size_gain=size.gain)
        return Judged(solution, doubt, evidence)

    def _observe(self, scan: Scan, initial: State | None, supposed: Suppositions) -> Observation:
        """Prepare the scan: as one of the model, or as a scene that the model is somewhere in."""
        model, options = self.model, self.options
        self._check_hints(scan)
        if options.region is None and supposed.surroundings is None:
            if not is_scene(scan, self.scenes):
                near = without_far_points(scan, model.reach)
                turned, borders = supposed.turned, supposed.borders
                return observe(near, model.diagonal, options.observation, self.threads, turned, borders)
            if scan.sensor_origin is None:
                logger.info(
                    "%s: searched as a scene; its sensor origin (0 0 0 in a camera's own frame) would tell hidden from "
                    "free space",
                    scan.source,
                )
        box = self._searched_box(initial)
        return observe_scene(scan, self.scenes, box, supposed.surroundings)

    def _check_hints(self, scan: Scan) -> None:
        """Raise `ScanError` for hints that lead away from the scan."""
        if self.options.near is None and self.options.region is None:
            return
        low, high = scan.box
        extent = f"the scan is from {point_text(low)} to {point_text(high)} m"
        near, region = self.options.near, self.options.region
        if near is not None:
            away = float(np.linalg.norm(np.maximum(np.maximum(low - near, near - high), 0.0)))
            if away > self.model.reach:
                raise ScanError(scan.source, f"near {point_text(near)} is {away:.3g} m away from it: {extent}")
        if region is not None:
            inside = np.all((scan.points >= region[0]) & (scan.points <= region[1]), axis=1)
            if not inside.any():
                box = f"{point_text(region[0])} to {point_text(region[1])}"
                raise ScanError(scan.source, f"no point is in the region {box}: {extent}")

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
        return model.within_limits(values) / model.joint_scales

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
        sought = Sought(native, self.model.surfaces, self.options.search, self.threads)
        return TreeSearch(ScanComparison(sought, observation, known))

    def _solve(self, solver: JointLeastSquares, finished: Candidates) -> Solution:
        base, values = finished.bases[0], finished.values[0]
        if solver.comparison.known.held:
            base = solver.comparison.known.placement
        if not self.options.least_squares.enabled:
            problem = solver.build(base, values, solver.robust_scale(solver.residual(base, values)))
            return Solution(base, values, problem, True, 0, solver.view)
        return solved(solver, base, solver.limited(values))

    def _chosen(self, searched: SearchedScan, solution: Solution) -> tuple[Solution, Candidates]:
        """Return which of the answers that look alike is meant, by a guess or by likelihood, and the others."""
        comparison = searched.solver.comparison
        answer = solution.configuration
        equal = equal_answers(self.model, comparison, answer)
        if len(equal) == 0 or comparison.known.held:
            return solution, equal
        several = Candidates.concatenate([answer, equal])
        if searched.initial is None:
            chosen = likeliest(searched.solver, several, searched.prior)
        else:
            base = comparison.observation.to_search(self.model.root_placement(searched.initial))
            guess = Candidates.single(base, searched.prior)
            apart = comparison.probe_positions(several) - comparison.probe_positions(guess)
            chosen = int(np.argmin(np.linalg.norm(apart, axis=-1).reshape(len(several), -1).mean(axis=1)))
        if chosen > 0:
            solution = solved(searched.solver, several.bases[chosen], searched.solver.limited(several.values[chosen]))
        return solution, several.take(np.arange(len(several)) != chosen)


def warn_of_size(scan: Scan, estimate: Estimate) -> None:
    """Log that the points lie clearly better on a model of another size."""
    if estimate.evidence.size_gain > CLEARLY:
        logger.warning(
            "%s: the points lie better on a model about %.2f times as large: is the scan to scale, and the model the "
            "right variant?",
            scan.source, estimate.evidence.size,
        )  # fmt: skip


def bearing_out(searched: SearchedScan, solution: Solution) -> Candidates:
    """Return the configuration by which the points bear an answer out: the solution, or what the search ended with
    where that scores more and is the same answer but for what the outline mends.

    A sensor that errs along its rays bends a whole surface away from where its outline has it.
    """
    comparison, final = searched.solver.comparison, solution.configuration
    if searched.solver.view.silhouette is None:
        return final
    both = comparison.scored(Candidates.concatenate([final, searched.finished.take([0])]))[0].best_first()
    same = len(comparison.distinct(both, len(both), OUTLINED)) == 1
    return both.take([0]) if same else final
