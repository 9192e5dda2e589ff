"""The sample models: is the overlay of their scans right, and every joint up to the model's own symmetry?"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pwralign_kin.benchmark.cases import Case, load_sample, sample_cases, sample_names
from pwralign_kin.benchmark.methods import DEFAULT, answer
from pwralign_kin.benchmark.metrics import Ruler, Score, wrapped
from pwralign_kin.benchmark.runs import Progress
from pwralign_kin.benchmark.symmetry import in_words_of_truth
from pwralign_kin.benchmark.table import figure, markdown


@dataclass(frozen=True)
class SampleOutcome:
    """The estimate of one sample scan."""

    model: str
    scan: str
    score: Score
    told: tuple[str, ...]
    """Joints that the scan can tell, by the truth."""

    undetermined: tuple[str, ...]
    """Joints that the estimate calls undetermined."""

    turns: dict[str, float]
    """Error of each turning joint, deg, up to the model's own symmetry; empty where the overlay is wrong."""

    slides: dict[str, float]
    """The same of sliding joints, percent of the model's diagonal."""

    seconds: float
    fault: str


def evaluate_samples(folder: Path, threads: int, progress: Progress) -> list[SampleOutcome]:
    """Estimate the sample scans of the models in `folder`."""
    outcomes = []
    for name in sample_names(folder):
        ruler = Ruler(load_sample(folder, name))
        for case in sample_cases(ruler.model, folder, name):
            outcomes.append(_outcome(case, ruler, threads))
            progress(" ".join([*_row(outcomes[-1]), outcomes[-1].fault]))
    return outcomes


def table(outcomes: Iterable[SampleOutcome]) -> str:
    """Return a row per scan."""
    heads = [
        "model", "scan", " overlay", " parts found", " joints that the scan can tell", " worst turn",
        " worst slide", " joints called determined", " worst turn", " worst slide", " time",
    ]  # fmt: skip
    return markdown(heads, map(_row, outcomes))


def _row(own: SampleOutcome) -> list[str]:
    names = {*own.turns, *own.slides}
    # Where limbs are taken for each other, the estimate speaks of other joints than the truth.
    determined = names - set(own.undetermined) if own.score.success else set()
    return [
        own.model,
        own.scan,
        "right" if own.score.overlay else "WRONG",
        figure(100 * own.score.recall, "%", 0),
        *_worst(own, names & set(own.told)),
        *_worst(own, determined),
        figure(own.seconds, " s"),
    ]


def _worst(own: SampleOutcome, names: set[str]) -> tuple[str, str, str]:
    """Return how many joints these are, and the largest errors of their turns and slides."""
    turns = [error for name, error in own.turns.items() if name in names]
    slides = [error for name, error in own.slides.items() if name in names]
    none = float("nan")
    return str(len(names)), figure(max(turns, default=none), " deg"), figure(max(slides, default=none), "% D")


def _outcome(case: Case, ruler: Ruler, threads: int) -> SampleOutcome:
    model = ruler.model
    reference = ruler.reference(case.truth, case.labels)
    answer(DEFAULT, case, ruler, reference, threads)  # untimed: libraries load
    given = answer(DEFAULT, case, ruler, reference, threads)
    state = None if given.estimate is None else given.estimate.state
    score = ruler.score(reference, state)
    turns: dict[str, float] = {}
    slides: dict[str, float] = {}
    if state is not None and score.overlay:
        same = in_words_of_truth(ruler, reference, state)
        for name in model.joint_names:
            offset = same.joints[name] - case.truth.joints[name]
            if model.units[name] == "m":
                slides[name] = 100.0 * abs(offset) / model.diagonal
            else:
                turns[name] = abs(float(np.degrees(wrapped(offset))))
    return SampleOutcome(
        model=case.robot,
        scan=case.tier,
        score=score,
        told=reference.told,
        undetermined=() if given.estimate is None else given.estimate.undetermined,
        turns=turns,
        slides=slides,
        seconds=given.seconds,
        fault=given.fault,
    )
