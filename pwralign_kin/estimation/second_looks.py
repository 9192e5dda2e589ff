"""One scan estimated: as it is given and, where its answer leaves something open, under other suppositions about it."""

from __future__ import annotations

import logging
from contextlib import suppress
from dataclasses import replace

import numpy as np

from pwralign_kin.arrays import Bools
from pwralign_kin.estimation.answers.one_sided import turned_over
from pwralign_kin.estimation.answers.plainly_right import is_plainly_right
from pwralign_kin.estimation.comparison.candidates import Candidates
from pwralign_kin.estimation.comparison.ranking import ahead_of_mirrored
from pwralign_kin.estimation.estimator import Estimator, warn_of_size
from pwralign_kin.estimation.evidence.confidence import MIRRORED, confidence
from pwralign_kin.estimation.evidence.evidence import gathered
from pwralign_kin.estimation.evidence.soundness import soundness
from pwralign_kin.estimation.knowledge.correspondences import Correspondences
from pwralign_kin.estimation.knowledge.prior import BasePrior
from pwralign_kin.estimation.reporting import state_of
from pwralign_kin.estimation.result import Estimate
from pwralign_kin.estimation.sensing.picture import borders_of
from pwralign_kin.estimation.sensing.preparation import was_prepared, without_far_points
from pwralign_kin.estimation.sensing.scene import surroundings_of, wide_patches
from pwralign_kin.estimation.sensing.sensor_origin import contradicting, is_of_all_sides, is_view
from pwralign_kin.estimation.stages import NOTHING_SUPPOSED, SearchedScan, Suppositions
from pwralign_kin.exceptions import CorrespondenceError, ScanError
from pwralign_kin.model import ArticulatedModel
from pwralign_kin.scan import Scan, note_of_unit, warn_of_rounding
from pwralign_kin.state import State

logger = logging.getLogger(__name__)

Answer = tuple[SearchedScan, Estimate]

BLIND, SIGHTED = 0.1, 0.5
"""Soundness below which an answer may be due to a wrong sensor origin, or lie in what the model stands on, and from
which one without the origin is believed."""
OTHER_SIDE = 0.02
"""Score by which an answer must be better for the other side of a part to have been seen: 0.08 and more where it was,
less than none where it was not."""
OTHER_SIDES = 3
"""How often in a row other sides are taken, at most: of one part, or of all."""
PATCHED, STRANGE = 0.5, 0.05
"""Soundness from which, and share of strange points up to which, what an answer leaves unexplained is not looked at."""
PATCHES = 0.02
"""Share of strange points from which patches of surroundings are looked for among them: less tells little."""
OF_OTHER_HAND = 0.02
"""Share of strange and astray points from which the mirror image of the scan is looked at: few right answers have as
much, and nearly all to mirror images of models that are not their own."""
UNSURE = 0.7
"""Confidence below which an answer in a scene may come of a wrong unit: scans in feet of a model alone got 0.6."""
OF_THE_MODEL = 0.8
"""Share of explained points from which the scan is of the model: among much else, what is strange is of that."""


def estimated(
    estimator: Estimator, scan: Scan, initial: State | None, correspondences: Correspondences | None
) -> Estimate:
    """Return the estimate of one scan."""
    warn_of_rounding(scan, estimator.model.diagonal)
    searched = estimator.searched(scan, initial, correspondences)
    estimate = estimator.finished(searched)
    looks = (_from_other_sides, _within_picture, _beside_surroundings, _without_sensor_origin, _seen_from_own_origin)
    for look in looks:
        searched, estimate = look(estimator, searched, estimate)
    estimate = _apart_from_surroundings(estimator, searched, estimate)
    estimate = _against_mirror_image(estimator, searched, estimate)
    warn_of_size(scan, estimate)
    if searched.solver.comparison.observation.scene and estimate.confidence < UNSURE:
        note_of_unit(scan, estimator.model.diagonal)
    return estimate


def _from_other_sides(estimator: Estimator, searched: SearchedScan, estimate: Estimate) -> Answer:
    """Look again, as if its other side had been seen, at each part that a scan without sensor origin shows from one
    side only, and return the best."""
    observation = searched.solver.comparison.observation
    if observation.scene or searched.scan.sensor_origin is not None:
        return searched, estimate
    first, turned = searched, np.zeros(len(observation.points), bool)
    tried = {turned.tobytes()}
    for _ in range(OTHER_SIDES):
        parts = turned_over(searched.solver.comparison, searched.finished.take([0]))
        several = [np.any(parts, axis=0)] if len(parts) > 1 else []
        best, now = searched, turned
        for over in several + parts:
            other = turned ^ over
            if other.tobytes() in tried:
                continue
            tried.add(other.tobytes())
            found = _with_turned(estimator, other, searched)
            if found is not None and found.finished.scores[0] > best.finished.scores[0]:
                best, now = found, other
        if best is searched:
            break
        searched, turned = best, now
    return (searched, estimate) if searched is first else (searched, estimator.finished(searched))


def _with_turned(estimator: Estimator, turned: Bools, searched: SearchedScan) -> SearchedScan | None:
    """Search again with points `turned` (m,), if the answer gets better by that; None if none does."""
    observation, enough = searched.solver.comparison.observation, searched.finished.scores[0] + OTHER_SIDE
    answer = state_of(estimator.model, observation, searched.finished.bases[0], searched.finished.values[0])
    try:
        from_answer = _anew(estimator, searched, Suppositions(turned=turned, start=answer))
    except (ScanError, CorrespondenceError):  # nothing of it can be a part of the model
        return None
    if from_answer.finished.scores[0] <= enough:
        return None
    with suppress(ScanError, CorrespondenceError):
        anew = _anew(estimator, searched, Suppositions(turned=turned))
        if anew.finished.scores[0] > enough:
            return anew
    return from_answer


def _within_picture(estimator: Estimator, searched: SearchedScan, estimate: Estimate) -> Answer:
    """Look again at a view that the border of its picture cuts, as one that tells nothing of what is beyond, and return
    the best answer by what it then tells. An answer from a guess was not led away from it by free space."""
    observation = searched.solver.comparison.observation
    if observation.scene or not observation.single_view or len(observation.borders) or searched.initial is not None:
        return searched, estimate
    borders = borders_of(searched.scan, observation, estimator.threads)
    if len(borders) == 0:
        return searched, estimate
    answer = state_of(estimator.model, observation, searched.finished.bases[0], searched.finished.values[0])
    try:
        best = _anew(estimator, searched, Suppositions(borders=borders, start=answer))
        if not is_plainly_right(best.solver.comparison, best.finished.take([0])):
            anew = _anew(estimator, searched, Suppositions(borders=borders))
            best = max(best, anew, key=lambda own: float(own.finished.scores[0]))
        return best, estimator.finished(best)
    except (ScanError, CorrespondenceError):  # too little is left within the picture
        return searched, estimate


def _beside_surroundings(estimator: Estimator, searched: SearchedScan, estimate: Estimate) -> Answer:
    """Look again at a scan whose `estimate` leaves a patch of its surroundings unexplained, or may lie in it; return
    the better.

    The patch draws parts of the model to it, or all of it, and passes for a sign that something else was scanned.
    """
    model, options = estimator.model, estimator.options
    observation, evidence = searched.solver.comparison.observation, estimate.evidence
    blind = soundness(evidence) < BLIND  # the answer may lie in the patch: what it explains is looked at, too
    if observation.scene or soundness(evidence) >= PATCHED or (evidence.strange <= STRANGE and not blind):
        return searched, estimate
    near = without_far_points(searched.scan, model.reach)
    left = blind | (estimate.scan_labels[near.source_index] < 0)
    left &= was_prepared(observation, near.points, options.observation)
    surroundings = surroundings_of(near, left, estimator.scenes)
    other = _among(estimator, searched, near, surroundings) if surroundings.any() else None
    if other is None or soundness(other[1].evidence) <= soundness(estimate.evidence):
        return searched, estimate
    return other if other[1].confidence >= estimate.confidence else (searched, estimate)


def _apart_from_surroundings(estimator: Estimator, searched: SearchedScan, estimate: Estimate) -> Estimate:
    """Judge an answer that leaves a patch of its surroundings unexplained by the rest of the scan: the floor that the
    model stands on begins where the model ends, and is strange to it for no fault of the answer.

    An answer to something else takes the patch for some of the model.
    """
    model, comparison, evidence = estimator.model, searched.solver.comparison, estimate.evidence
    observation = comparison.observation
    if observation.scene or evidence.strange <= PATCHES:
        return estimate
    final = _configuration(model, searched, estimate)
    patches = comparison.lying(final)[0] > comparison.reach
    patches[patches] = wide_patches(observation.points[patches], observation.sensor_origin, estimator.scenes)
    if not patches.any() or patches.all():
        return estimate
    apart = gathered(comparison, final, searched.finished, patches)
    evidence = replace(evidence, nearby=apart.nearby, explained=apart.explained, strange=apart.strange)
    return replace(estimate, evidence=evidence, confidence=confidence(evidence))


def _configuration(model: ArticulatedModel, searched: SearchedScan, estimate: Estimate) -> Candidates:
    """Return the answer of an estimate in units of its search (one)."""
    observation = searched.solver.comparison.observation
    values = model.values(estimate.state.joints) / model.joint_scales
    return Candidates.single(observation.to_search(model.root_placement(estimate.state)), values)


def _without_sensor_origin(estimator: Estimator, searched: SearchedScan, estimate: Estimate) -> Answer:
    """Look again at a view to which no answer is any good, as if it were not known from where it was seen, and return
    that answer if it is good: the origin must be wrong."""
    observation = searched.solver.comparison.observation
    if not observation.single_view or observation.scene or soundness(estimate.evidence) >= BLIND:
        return searched, estimate
    other = _sighted(estimator, searched, searched.scan.without_sensor_origin())
    if other is None:
        return searched, estimate
    logger.warning(
        "%s: its sensor origin is not used: the model fits the scan without it, and does not with it; is it in the "
        "frame of the scan?",
        searched.scan.source,
    )
    return other


def _seen_from_own_origin(estimator: Estimator, searched: SearchedScan, estimate: Estimate) -> Answer:
    """Look again at a scan whose answer is not sound and sure, and whose sensor origin nobody told, as if it were seen
    from the origin of its frame, where a camera puts its own, and return that answer if it is better."""
    known, observation = searched.scan.sensor_origin is not None, searched.solver.comparison.observation
    if known or min(soundness(estimate.evidence), estimate.confidence) >= SIGHTED:
        return searched, estimate
    scan, diagonal = searched.scan.with_sensor_origin(np.zeros(3)), estimator.model.diagonal
    if not is_view(scan) or contradicting(scan, diagonal):
        return searched, estimate
    if not observation.scene and is_of_all_sides(scan, diagonal, observation.noise, estimator.threads):
        return searched, estimate
    other = _sighted(estimator, searched, scan)
    if other is None or other[1].confidence < estimate.confidence:
        return searched, estimate
    logger.info("%s: taken to be seen from 0 0 0, the origin of its frame; nothing was found else", scan.source)
    return _within_picture(estimator, *other)


def _sighted(estimator: Estimator, searched: SearchedScan, scan: Scan) -> Answer | None:
    """Return the answer to a scan `searched` before, as seen from elsewhere, None if it is not sound.

    One short search tells most of those that are and that are not.
    """
    effort = estimator.options.effort
    quick = Estimator(estimator.model, replace(estimator.options, effort="fast"))
    try:
        found = _anew(quick, searched, scan=scan)
        sound = _searched_soundness(found)
        if sound >= BLIND and (effort == "thorough" or (effort == "default" and sound < SIGHTED)):
            found = _anew(estimator, searched, scan=scan)
    except (ScanError, CorrespondenceError):  # nothing of it can be a part of the model
        return None
    if sound < BLIND:
        return None
    other = estimator.finished(found)
    return (found, other) if soundness(other.evidence) >= SIGHTED else None


def _searched_soundness(searched: SearchedScan) -> float:
    """Return how sound the answer is that a search ended with."""
    return soundness(gathered(searched.solver.comparison, searched.finished.take([0]), searched.finished))


def _anew(
    estimator: Estimator, searched: SearchedScan, supposed: Suppositions = NOTHING_SUPPOSED, scan: Scan | None = None
) -> SearchedScan:
    """Search a scan again, or another that is put in its place, with what was told of it."""
    scan = searched.scan if scan is None else scan
    return estimator.searched(scan, searched.initial, searched.correspondences, searched.watch, supposed)


def _among(estimator: Estimator, searched: SearchedScan, scan: Scan, surroundings: Bools) -> Answer | None:
    """Return the answer to a scan of the model among `surroundings`, None if nothing of it can be of the model."""
    try:
        other = _anew(estimator, searched, Suppositions(surroundings=surroundings), scan)
        return other, estimator.finished(other)
    except (ScanError, CorrespondenceError):
        return None


def _against_mirror_image(estimator: Estimator, searched: SearchedScan, estimate: Estimate) -> Estimate:
    """Hold an answer that leaves points strange or astray against one to the mirror image of the scan, which some
    programs write: their coordinates are left-handed.

    What is known in the frame of the scan tells its hand, or would have to be mirrored with it.
    """
    evidence, options = estimate.evidence, estimator.options
    told = options.base != BasePrior() or options.region is not None or options.near is not None
    told = told or searched.initial is not None or searched.correspondences is not None
    odd = evidence.strange + evidence.astray > OF_OTHER_HAND and estimate.scan_coverage >= OF_THE_MODEL
    if told or not odd or searched.solver.comparison.observation.scene:
        return estimate
    try:
        # Of the model, the image is found without repair; of anything else, repair takes most of the time.
        quick = replace(options, effort="fast", repair=replace(options.repair, rounds=0))
        borders = searched.solver.comparison.observation.borders * np.array([1.0, 1.0, -1.0], np.float32)
        supposed = Suppositions(borders=borders if len(borders) else None)
        image = _anew(Estimator(estimator.model, quick), searched, supposed, searched.scan.mirrored())
    except (ScanError, CorrespondenceError):  # nothing of it can be a part of the model
        return estimate
    if image.solver.comparison.observation.scene:  # its scores do not compare
        return estimate
    answer = searched.solver.comparison, _configuration(estimator.model, searched, estimate)
    behind = -ahead_of_mirrored(answer, (image.solver.comparison, image.finished.take([0])))
    evidence = replace(evidence, mirrored=max(0.0, behind))
    if evidence.mirrored > MIRRORED[0]:
        logger.warning(
            "%s: its mirror image fits the model better: are its coordinates left-handed, as Unity's are? If so, "
            "turn the sign of one axis: --left-handed, or scan.mirrored('x')",
            searched.scan.source,
        )
    return replace(estimate, evidence=evidence, confidence=confidence(evidence))
