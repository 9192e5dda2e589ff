"""The model somewhere in a room, without a mask: is it found, and are its points told from all others?"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from pwralign_kin.benchmark.cases import Case
from pwralign_kin.benchmark.methods import DEFAULT, answer
from pwralign_kin.benchmark.metrics import Ruler, Score
from pwralign_kin.benchmark.runs import Models, Outcome, Progress, Run
from pwralign_kin.benchmark.runs import outcome as judged
from pwralign_kin.benchmark.summaries import grouped
from pwralign_kin.benchmark.table import figure, markdown, median, share
from pwralign_kin.estimation import Estimate
from pwralign_kin.model import ArticulatedModel
from pwralign_kin.simulation import Room, SimulatedCopy, SimulatedScan, simulate_scene

ROOMS: Mapping[str, Room] = MappingProxyType(
    {
        "furniture": Room(furniture=8),
        "contact": Room(contacts=2),
        "occluder": Room(occluders=2),
        "second copy": Room(furniture=3, second_copy=True),
    }
)
"""What makes a scene hard, by name."""


METHOD = "in a room"
"""How answers to scenes are named among those of other tiers."""


@dataclass(frozen=True)
class SceneOutcome:
    """The estimate of one scene. Where the room holds a second copy, of the one that the answer is nearer to."""

    robot: str
    room: str
    configuration: int
    points: int
    """Points of the scene."""

    own: int
    """Points on the model."""

    score: Score
    precision: float
    """Share of the points called the model's that are; NaN where none is."""

    recall: float
    """Share of the model's points that are called so."""

    confidence: float
    """By the estimate; 0 without one."""

    seconds: float
    fault: str

    @property
    def worst_part(self) -> float:
        """Largest error of an observed part, at most 1, model diagonals."""
        return min(1.0, max(self.score.part_errors.values()))

    def __str__(self) -> str:
        """Return one line for the progress display."""
        verdict = "found" if self.score.success else "overlaid" if self.score.overlay else "MISSED"
        error = self.fault or f"worst part {100 * self.worst_part:.2f}% D"
        return (
            f"{self.robot}-{self.configuration}-{self.room} {verdict} {error} precision {self.precision:.2f} "
            f"recall {self.recall:.2f} {self.seconds:.2f} s"
        )


def scene(model: ArticulatedModel, robot: str, room: str, configuration: int) -> SimulatedScan:
    """Return a scene of `model`; the same arguments give the same points."""
    return simulate_scene(model, room=ROOMS[room], seed=zlib.crc32(f"{robot} {room} {configuration}".encode()))


def measure(models: Models, configurations: int, threads: int, progress: Progress) -> list[SceneOutcome]:
    """Estimate every model in rooms of every kind. The first scene is run twice: no time includes loading."""
    outcomes: list[SceneOutcome] = []
    for robot, model in models:
        ruler = Ruler(model)
        for room in ROOMS:
            for configuration in range(configurations):
                made = scene(model, robot, room, configuration)
                if not outcomes:
                    outcome(ruler, robot, room, configuration, made, threads)
                outcomes.append(outcome(ruler, robot, room, configuration, made, threads))
                progress(str(outcomes[-1]))
    return outcomes


def outcome(ruler: Ruler, robot: str, room: str, configuration: int, made: SimulatedScan, threads: int) -> SceneOutcome:
    """Estimate one scene with the default options."""
    reference = ruler.reference(made.state, made.labels[made.labels >= 0])
    case = Case(robot, room, configuration, made.scan, made.labels, made.state, None)
    given = answer(DEFAULT, case, ruler, reference, threads)
    score, labels = max(_scores(ruler, made, given.estimate), key=lambda found: (found[0].overlay, found[0].recall))
    precision, recall = _told_apart(given.estimate, labels)
    return SceneOutcome(
        robot=robot,
        room=room,
        configuration=configuration,
        points=len(made.scan.points),
        own=int((labels >= 0).sum()),
        score=score,
        precision=precision,
        recall=recall,
        confidence=0.0 if given.estimate is None else given.estimate.confidence,
        seconds=given.seconds,
        fault=given.fault,
    )


def as_cases(models: Models, rooms: Sequence[str], threads: int, progress: Progress) -> list[Outcome]:
    """Estimate every model in one room of each of these kinds, as the cases of tables that go by evidence."""
    outcomes = []
    for robot, model in models:
        ruler = Ruler(model)
        for room in rooms:
            made = scene(model, robot, room, 0)
            reference = ruler.reference(made.state, made.labels[made.labels >= 0])
            case = Case(robot, room, 0, made.scan, made.labels, made.state, None)
            given = answer(DEFAULT, case, ruler, reference, threads)
            outcomes.append(judged(Run(case, ruler, reference, METHOD, given)))
            progress(str(outcomes[-1]))
    return outcomes


def _scores(ruler: Ruler, made: SimulatedScan, found: Estimate | None) -> Iterator[tuple[Score, NDArray[np.int64]]]:
    """Yield how right an answer is about each copy of the model that can be seen, and the labels of that copy."""
    for copy in (SimulatedCopy(made.state, made.labels), *made.copies):
        reference = ruler.reference(copy.state, copy.labels[copy.labels >= 0])
        if reference.observed:
            yield ruler.score(reference, None if found is None else found.state), copy.labels


def _told_apart(found: Estimate | None, labels: NDArray[np.int64]) -> tuple[float, float]:
    """Return precision and recall of the points that an estimate calls the model's."""
    own = labels >= 0
    called = np.zeros(len(own), bool) if found is None else found.scan_labels >= 0
    both = float((own & called).sum())
    return both / float(called.sum()) if called.any() else float("nan"), both / float(own.sum())


def table(outcomes: Sequence[SceneOutcome]) -> str:
    """Return a row per kind of room, and a row per robot."""
    return "\n".join(
        [
            _grouped_table("scene", outcomes, lambda own: own.room),
            _grouped_table("robot", outcomes, lambda own: own.robot),
        ]
    )


def _grouped_table(head: str, outcomes: Sequence[SceneOutcome], key: Callable[[SceneOutcome], str]) -> str:
    heads = [
        head, " scenes", " share of points on the model", " overlay", " part recall", " worst part",
        " own points: precision", " recall", " time median", " time max", " errors",
    ]  # fmt: skip
    groups = [*grouped(outcomes, key), ("all", outcomes)]
    return markdown(heads, [[name, *_cells(own)] for name, own in groups])


def _cells(own: Sequence[SceneOutcome]) -> list[str]:
    """Return the figures of a group; those not said to be other are medians over its scenes, part recall is a mean."""
    seconds = [outcome.seconds for outcome in own]
    return [
        str(len(own)),
        figure(100 * median([outcome.own / outcome.points for outcome in own]), "%", 1),
        share([outcome.score.overlay for outcome in own]),
        figure(100 * float(np.mean([outcome.score.recall for outcome in own])), "%", 1),
        figure(100 * median([outcome.worst_part for outcome in own]), "% D"),
        figure(median([0.0 if np.isnan(outcome.precision) else outcome.precision for outcome in own])),
        figure(median([outcome.recall for outcome in own])),
        figure(median(seconds), " s"),
        figure(max(seconds), " s"),
        str(sum(bool(outcome.fault) for outcome in own)),
    ]
