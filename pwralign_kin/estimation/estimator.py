"""The whole estimate: observe, hypothesise, grow, refine, repair, solve, judge."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pwralign_kin.estimation.answers.answer_search import AnswerSearch
from pwralign_kin.estimation.answers.contest import contested
from pwralign_kin.estimation.answers.equal_answers import equal_answers
from pwralign_kin.estimation.answers.one_sided import turned_over
from pwralign_kin.estimation.doubt.observability import doubted
from pwralign_kin.estimation.evidence.confidence import MIRRORED, confidence
from pwralign_kin.estimation.evidence.evidence import gathered
from pwralign_kin.estimation.evidence.other_size import other_size
from pwralign_kin.estimation.evidence.soundness import soundness
from pwralign_kin.estimation.knowledge.correspondences import Correspondences
from pwralign_kin.estimation.knowledge.prior import JOINT_REACH, BasePrior
from pwralign_kin.estimation.options import EstimatorOptions
from pwralign_kin.estimation.refinement.joint_least_squares import JointLeastSquares, Solution
from pwralign_kin.estimation.refinement.likelihood import likeliest
from pwralign_kin.estimation.refinement.surface_mixture import solved
from pwralign_kin.estimation.reporting import reported, state_of
from pwralign_kin.estimation.result import Estimate
from pwralign_kin.estimation.search.candidates import Candidates
from pwralign_kin.estimation.search.tree_search import TreeSearch
from pwralign_kin.estimation.sensing.observation import (
    Observation,
    edge_on,
    finely_seen_through,
    is_view,
    observe,
    seen_through,
    was_prepared,
    without_far_points,
)
from pwralign_kin.estimation.sensing.scene import is_scene, observe_scene, surroundings_of
from pwralign_kin.estimation.stages import Fit, Judged
from pwralign_kin.estimation.stopwatch import Stopwatch
from pwralign_kin.exceptions import CorrespondenceError, ScanError, StateError, UnknownNameError
from pwralign_kin.model import ArticulatedModel
from pwralign_kin.scan import Scan, warn_of_rounding
from pwralign_kin.scan.scan import point_text
from pwralign_kin.se3 import Array, transform
from pwralign_kin.state import State

logger = logging.getLogger(__name__)

SEEN_THROUGH = 0.25
"""Share of points that others hide from the sensor origin from which the scan was not seen from there: up to 0.23 where
every pixel at a depth edge mixes both sides, 0.28 and more where the origin is another's, or one of several."""
FINELY_SEEN_THROUGH, BY_NOISE = 0.07, 12.0
"""The same in pixels as fine as the points are dense, where the scan is of the model and nobody told its origin; or so
many times the noise (model diagonals), where that is more."""
BLIND, SIGHTED = 0.1, 0.5
"""Soundness below which an answer may be due to a wrong sensor origin, and from which one without it is believed."""
OTHER_SIDE = 0.02
"""Score by which an answer must be better for the other side of a part to have been seen: 0.08 and more where it was,
less than none where it was not."""
OTHER_SIDES = 3
"""How often in a row other sides are taken, at most: of one part, or of all."""
OUTLINED = 0.06
"""Mean displacement of the surface (model diagonals) within which an answer and what the search ended with are one, but
for what the outline mends: it reaches half as far, and surfaces slide and turn along themselves besides."""
PATCHED, STRANGE = 0.5, 0.05
"""Soundness from which, and share of strange points up to which, what an answer leaves unexplained is not looked at."""
UNLIKE = 0.03
"""Share of strange and astray points from which the size of the model is doubted."""
OF_OTHER_HAND = 0.02
"""Share of strange and astray points from which the mirror image of the scan is looked at: few right answers have as
much, and nearly all to mirror images of models that are not their own."""
OF_THE_MODEL = 0.8
"""Share of explained points from which the scan is of the model: among much else, what is strange is of that."""
CLEARLY = 0.04
"""Share by which points must lie better on a model of another size for a caller to be told: up to 0.025 where the size
is right, 0.05 to 0.3 where it is 7 to 15% off."""


class Estimator:
    """The pipeline for one model and one set of options."""

    def __init__(
        self,
        model: ArticulatedModel,
        options: EstimatorOptions,
        progress: Callable[[str], None] | None = None,
    ) -> None:
        """Check the options against the model. Raises `UnknownNameError` and `StateError`."""
        if not isinstance(model, ArticulatedModel):
            got = type(model).__name__
            raise StateError(f"expected an ArticulatedModel, got {got}; ArticulatedModel.from_urdf(path) reads one")
        for name in (*options.locked, *options.prior_std):
            if name not in model.joint_names:
                raise UnknownNameError("joint", name, model.joint_names)
        model.check_limits(options.prior)
        for name, std in options.prior_std.items():
            if std <= 0.0:
                raise StateError(f"the standard deviation of joint {name!r} must be a positive number, not {std}")
        self.model = model
        self.options = options
        self.progress = progress
        self.threads = options.threads or os.cpu_count() or 1
        self.prior_std = np.array([options.prior_std.get(name, np.inf) for name in model.joint_names])
        self.prior_std /= model.joint_scales

    def run(self, scan: Scan, initial: State | None, correspondences: Correspondences | None) -> Estimate:
        """Return the estimate of one scan."""
        warn_of_rounding(scan, self.model.diagonal)
        watch = Stopwatch(self.progress)
        fit = self.fit(scan, initial, correspondences, watch)
        estimate = self._finished(fit, initial)
        fit, estimate = self._from_other_sides(fit, estimate, initial, correspondences)
        estimate = self._beside_surroundings(fit, estimate, initial, correspondences)
        estimate = self._without_sensor_origin(fit, estimate, initial, correspondences)
        estimate = self._seen_from_own_origin(fit, estimate, initial, correspondences)
        if initial is None and correspondences is None:
            estimate = self._against_mirror_image(fit, estimate)
        warn_of_size(scan, estimate)
        warn_of_mirror_image(scan, estimate)
        return estimate

    def fit(
        self,
        scan: Scan,
        initial: State | None,
        correspondences: Correspondences | None,
        watch: Stopwatch | None = None,
        surroundings: NDArray[np.bool_] | None = None,
        turned: NDArray[np.bool_] | None = None,
    ) -> Fit:
        """Return all answers worth comparing, before the joint least squares.

        Points known to be of the `surroundings` (n,) make the scan a scene. Prepared points that are `turned` (m,) are
        taken for the other side of the surface.
        """
        watch = watch or Stopwatch(self.progress)
        scan = self._believed(scan)
        prior = self._prior(initial)
        lower, upper = self._bounds(prior)
        with watch.stage("observe"):
            observation = self._observe(scan, initial, surroundings, turned)
            search = self._search(observation, prior, lower, upper)
        answers = AnswerSearch(self.model, search, self.options, correspondences, watch)
        if initial is None:
            solutions = answers.without_guess()
        else:
            solutions = answers.from_guess(observation.to_search(self.model.root_placement(initial)), prior)
        with watch.stage("finish"):
            finished = answers.finished(solutions)
        solver = JointLeastSquares(self.model, answers.search, lower, upper, self.options.least_squares)
        return Fit(scan, solver, finished, prior, watch)

    def _finished(self, fit: Fit, initial: State | None) -> Estimate:
        """Return the estimate that a search makes, or its rivals if the points prefer one."""
        judged, equal = self._settled(fit, initial)
        with fit.watch.stage("contest"):
            finished = contested(
                fit.solver, judged.solution.configuration, judged.evidence, fit.finished, equal, self.options
            )
        if finished is not None:
            fit = replace(fit, finished=finished)
            judged, equal = self._settled(fit, initial)
        return reported(fit, judged, equal, self.options)

    def _settled(self, fit: Fit, initial: State | None) -> tuple[Judged, Candidates]:
        """Return the best answer solved and judged, and those that look alike."""
        with fit.watch.stage("least squares"):
            solution = self._solve(fit.solver, fit.finished)
        with fit.watch.stage("equal answers"):
            solution, equal = self._chosen(fit, solution, initial)
        return self._judged(fit, solution), equal

    def _from_other_sides(
        self, fit: Fit, estimate: Estimate, initial: State | None, correspondences: Correspondences | None
    ) -> tuple[Fit, Estimate]:
        """Look again, as if its other side had been seen, at each part that a scan without sensor origin shows from
        one side only, and return the best."""
        observation = fit.solver.search.observation
        if observation.scene or fit.scan.sensor_origin is not None:
            return fit, estimate
        first, turned = fit, np.zeros(len(observation.points), bool)
        tried = {turned.tobytes()}
        for _ in range(OTHER_SIDES):
            parts = turned_over(fit.solver.search, fit.finished.take([0]))
            several = [np.any(parts, axis=0)] if len(parts) > 1 else []
            best, now = fit, turned
            for over in several + parts:
                other = turned ^ over
                if other.tobytes() in tried:
                    continue
                tried.add(other.tobytes())
                found = self._with_turned(other, fit, initial, correspondences)
                if found is not None and found.finished.scores[0] > best.finished.scores[0]:
                    best, now = found, other
            if best is fit:
                break
            fit, turned = best, now
        return (fit, estimate) if fit is first else (fit, self._finished(fit, initial))

    def _with_turned(
        self, turned: NDArray[np.bool_], fit: Fit, initial: State | None, correspondences: Correspondences | None
    ) -> Fit | None:
        """Search again with points `turned` (m,), if the answer of a `fit` gets better by that; None if none does."""
        observation, enough = fit.solver.search.observation, fit.finished.scores[0] + OTHER_SIDE
        answer = state_of(self.model, observation, fit.finished.bases[0], fit.finished.values[0])
        try:
            from_answer = self.fit(fit.scan, answer, correspondences, fit.watch, turned=turned)
            if from_answer.finished.scores[0] <= enough:
                return None
            anew = self.fit(fit.scan, initial, correspondences, fit.watch, turned=turned)
        except (ScanError, CorrespondenceError):  # nothing of it can be a part of the model
            return None
        return anew if anew.finished.scores[0] > enough else from_answer

    def _beside_surroundings(
        self, fit: Fit, estimate: Estimate, initial: State | None, correspondences: Correspondences | None
    ) -> Estimate:
        """Look again at a scan whose `estimate` leaves a patch of its surroundings unexplained, and return the better.

        The patch draws parts of the model to it, and passes for a sign that something else was scanned.
        """
        observation, evidence = fit.solver.search.observation, estimate.evidence
        if observation.scene or evidence.strange <= STRANGE or soundness(evidence) >= PATCHED:
            return estimate
        near = without_far_points(fit.scan, self.model.reach)
        left = estimate.scan_labels[near.source_index] < 0
        left &= was_prepared(observation, near.points, self.options.observation)
        surroundings = surroundings_of(
            near, left, self.model.surfaces, self.model.diagonal, self.options.observation, self.options.scene,
            self.threads,
        )  # fmt: skip
        if not surroundings.any():
            return estimate
        try:
            other = self._finished(self.fit(near, initial, correspondences, fit.watch, surroundings), initial)
        except (ScanError, CorrespondenceError):  # nothing is left beside the surroundings
            return estimate
        sounder = soundness(other.evidence) > soundness(estimate.evidence)
        return other if sounder and other.confidence >= estimate.confidence else estimate

    def _believed(self, scan: Scan) -> Scan:
        """Return the scan without a sensor origin that its points contradict."""
        hidden = seen_through(scan, self.model.diagonal)
        if not self._is_contradicted(scan, hidden):
            return scan
        logger.warning(
            "%s: its sensor origin is not used: from there, %.0f%% of the points are behind others; is it in the frame "
            "of the scan, and is the scan of one view?",
            scan.source, 100.0 * hidden,
        )  # fmt: skip
        return scan.without_sensor_origin()

    def _is_contradicted(self, scan: Scan, hidden: float) -> bool:
        """Return whether points `hidden` by others, this share, speak against the sensor origin."""
        return hidden >= SEEN_THROUGH and not edge_on(scan, self.model.diagonal)

    def _without_sensor_origin(
        self, fit: Fit, estimate: Estimate, initial: State | None, correspondences: Correspondences | None
    ) -> Estimate:
        """Look again at a view to which no answer is any good, as if it were not known from where it was seen, and
        return that answer if it is good: the origin must be wrong."""
        observation = fit.solver.search.observation
        if not observation.single_view or observation.scene or soundness(estimate.evidence) >= BLIND:
            return estimate
        scan = fit.scan.without_sensor_origin()
        try:
            other = self._finished(self.fit(scan, initial, correspondences, fit.watch), initial)
        except (ScanError, CorrespondenceError):  # nothing of it can be a part of the model
            return estimate
        if soundness(other.evidence) < SIGHTED:
            return estimate
        logger.warning(
            "%s: its sensor origin is not used: the model fits the scan without it, and does not with it; is it in the "
            "frame of the scan?",
            scan.source,
        )
        return other

    def _seen_from_own_origin(
        self, fit: Fit, estimate: Estimate, initial: State | None, correspondences: Correspondences | None
    ) -> Estimate:
        """Look again at a scan whose answer is not sound and sure, and whose sensor origin nobody told, as if it were
        seen from the origin of its frame, where a camera puts its own, and return that answer if it is better."""
        known = fit.scan.sensor_origin is not None
        if known or min(soundness(estimate.evidence), estimate.confidence) >= SIGHTED:
            return estimate
        scan = fit.scan.with_sensor_origin(np.zeros(3))
        if not is_view(scan) or self._is_contradicted(scan, seen_through(scan, self.model.diagonal)):
            return estimate
        observation = fit.solver.search.observation
        if not observation.scene:
            noise = observation.noise
            hidden = finely_seen_through(scan, self.model.diagonal, noise, self.threads)
            if hidden >= max(FINELY_SEEN_THROUGH, BY_NOISE * noise):
                return estimate  # its points are of all sides
        try:
            other = self._finished(self.fit(scan, initial, correspondences, fit.watch), initial)
        except (ScanError, CorrespondenceError):  # nothing that is seen from there can be the model
            return estimate
        if soundness(other.evidence) < SIGHTED or other.confidence < estimate.confidence:
            return estimate
        logger.info("%s: taken to be seen from 0 0 0, the origin of its frame; nothing was found else", scan.source)
        return other

    def _against_mirror_image(self, fit: Fit, estimate: Estimate) -> Estimate:
        """Hold an answer that leaves points strange or astray against one to the mirror image of the scan, which some
        programs write: their coordinates are left-handed.

        What is known in the frame of the scan tells its hand, or would have to be mirrored with it.
        """
        evidence, options = estimate.evidence, self.options
        told = options.base != BasePrior() or options.region is not None or options.near is not None
        odd = evidence.strange + evidence.astray > OF_OTHER_HAND and estimate.scan_coverage >= OF_THE_MODEL
        if told or not odd or fit.solver.search.observation.scene:
            return estimate
        try:
            quick = Estimator(self.model, replace(options, effort="fast"))
            image = quick.fit(fit.scan.mirrored(), None, None, fit.watch)
        except (ScanError, CorrespondenceError):  # nothing of it can be a part of the model
            return estimate
        evidence = replace(evidence, mirrored=max(0.0, estimate.cost + float(image.finished.scores[0])))
        return replace(estimate, evidence=evidence, confidence=confidence(evidence))

    def concluded(self, fit: Fit, solution: Solution) -> Estimate:
        """Return the estimate that a solution of the joint least squares makes."""
        equal = equal_answers(self.model, fit.solver.search, solution.configuration)
        return reported(fit, self._judged(fit, solution), equal, self.options)

    def _judged(self, fit: Fit, solution: Solution) -> Judged:
        """Say what the scan does not tell of a solution, and what speaks for and against it."""
        with fit.watch.stage("least squares"):
            solution, doubt = doubted(fit.solver, solution, fit.prior)
        with fit.watch.stage("confidence"):
            evidence = gathered(fit.solver.search, bearing_out(fit, solution), fit.finished)
            if evidence.strange + evidence.astray > UNLIKE:
                size = other_size(fit.solver, solution)
                evidence = replace(evidence, size=size.factor, size_gain=size.gain)
        return Judged(solution, doubt, evidence)

    def _observe(
        self,
        scan: Scan,
        initial: State | None,
        surroundings: NDArray[np.bool_] | None,
        turned: NDArray[np.bool_] | None,
    ) -> Observation:
        """Prepare the scan: as one of the model, or as a scene that the model is somewhere in."""
        model, options = self.model, self.options
        self._check_hints(scan)
        if options.region is None and surroundings is None:
            if not is_scene(scan, model.diagonal, model.reach, options.scene, options.observation, self.threads):
                near = without_far_points(scan, model.reach)
                return observe(near, model.diagonal, options.observation, self.threads, turned)
            if scan.sensor_origin is None:
                logger.info(
                    "%s: searched as a scene; its sensor origin (0 0 0 in a camera's own frame) would tell hidden from "
                    "free space",
                    scan.source,
                )
        box = self._searched_box(initial)
        return observe_scene(
            scan, model.surfaces, model.diagonal, box, options.observation, options.scene, self.threads, surroundings
        )

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
        """Return which of the answers that look alike is meant, by a guess or by likelihood, and the others."""
        search = fit.solver.search
        answer = solution.configuration
        equal = equal_answers(self.model, search, answer)
        if len(equal) == 0 or search.known.held:
            return solution, equal
        several = Candidates.concatenate([answer, equal])
        if initial is None:
            chosen = likeliest(fit.solver, several, fit.prior)
        else:
            base = search.observation.to_search(self.model.root_placement(initial))
            guess = Candidates.single(base, fit.prior)
            apart = search.probe_positions(several) - search.probe_positions(guess)
            chosen = int(np.argmin(np.linalg.norm(apart, axis=-1).reshape(len(several), -1).mean(axis=1)))
        if chosen > 0:
            solution = solved(fit.solver, several.bases[chosen], fit.solver.limited(several.values[chosen]))
        return solution, several.take(np.arange(len(several)) != chosen)


def warn_of_size(scan: Scan, estimate: Estimate) -> None:
    """Log that the points lie clearly better on a model of another size."""
    if estimate.evidence.size_gain > CLEARLY:
        logger.warning(
            "%s: the points lie better on a model about %.2f times as large: is the scan to scale, and the model the "
            "right variant?",
            scan.source, estimate.evidence.size,
        )  # fmt: skip


def warn_of_mirror_image(scan: Scan, estimate: Estimate) -> None:
    """Log that the mirror image of the points clearly makes more of the model than they do."""
    if estimate.evidence.mirrored > MIRRORED[0]:
        logger.warning(
            "%s: its mirror image fits the model better: are its coordinates left-handed, as Unity's are? If so, turn "
            "the sign of one axis",
            scan.source,
        )  # fmt: skip


def bearing_out(fit: Fit, solution: Solution) -> Candidates:
    """Return the configuration by which the points bear an answer out: the solution, or what the search ended with
    where that scores more and is the same answer but for what the outline mends.

    A sensor that errs along its rays bends a whole surface away from where its outline has it.
    """
    search, final = fit.solver.search, solution.configuration
    if fit.solver.silhouette is None:
        return final
    both = search.scored(Candidates.concatenate([final, fit.finished.take([0])]))[0].best_first()
    same = len(search.distinct(both, len(both), OUTLINED)) == 1
    return both.take([0]) if same else final
