"""Cases x methods in one process, interleaved: how right and how fast, beside a baseline on the same case."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from pwralign_kin.baselines.part_wise_rigid import openings, rigid_fit
from pwralign_kin.benchmark.metrics import FOUND
from pwralign_kin.benchmark.peers import CONTENDERS, OURS, Placement, Task
from pwralign_kin.benchmark.pictures import COLOURS, PALE, as_png, new_figure, tidy
from pwralign_kin.benchmark.runs import Cases, Progress
from pwralign_kin.benchmark.table import NONE, figure, median, quantile, share
from pwralign_kin.exceptions import DependencyError
from pwralign_kin.se3 import transform

logger = logging.getLogger(__name__)

NAN = float("nan")


@dataclass(frozen=True)
class Measurement:
    """What one method makes of one case, once. Lengths in model diagonals."""

    robot: str
    tier: str
    configuration: int
    repetition: int
    method: str
    seconds: float
    overlay: bool | None = False
    """None: the method has no parts to lay over."""
    right: float = 0.0
    """Share of the observed parts that are found, or whose true surface another part lies on."""
    error: float = NAN
    """Mean distance of the observed parts' surface, where the method puts it, to where it truly is."""
    joints: float = NAN
    """Median error of the joints that the scan can tell: degrees, or percent of a slide's range."""
    gap: float = NAN
    """Widest opening of a joint."""
    bend: float = NAN
    """Most that a part's surface departs (rms) from its best rigid fit."""
    fault: str = ""

    def __str__(self) -> str:
        """Return one line for the progress display."""
        verdict = self.fault or f"off by {100 * self.error:.2f}% D"
        case = f"{self.robot}-{self.configuration}-{self.tier}"
        return f"{case} [{self.method}] {verdict} {self.seconds:.3f} s"


def compare(
    cases: Cases, methods: Iterable[str], repeats: int, seed: int, threads: int, progress: Progress
) -> list[Measurement]:
    """Run all methods on all cases, `repeats` times in an order that goes round, so that noise hits all alike.

    Before the first case every method runs once on it without counting. Repetitions have seeds of their own, from
    `seed` on. Raises `DependencyError` where a method's library is missing.
    """
    names = tuple(methods)
    measured: list[Measurement] = []
    for index, (ruler, case) in enumerate(cases):
        task = Task(case, ruler, ruler.reference(case.truth, case.labels), threads)
        for name in names if not index else ():
            once(task, name, 0, seed)
        for repetition in range(repeats):
            first = (index + repetition) % len(names)
            for name in (*names[first:], *names[:first]):
                measured.append(once(task, name, repetition, seed + repetition))
                progress(str(measured[-1]))
    return measured


def once(task: Task, name: str, repetition: int, seed: int) -> Measurement:
    """Run one method once; what goes wrong is logged and becomes part of the measurement."""
    contender = CONTENDERS[name]
    case = task.case
    measurement = Measurement(case.robot, case.tier, case.configuration, repetition, name, NAN)
    start = time.perf_counter()
    try:
        run = contender.prepare(task, seed)
        start = time.perf_counter()
        placement = run()
    except DependencyError:
        raise
    except Exception as error:  # a benchmark goes on; the failure counts against the method
        logger.info("%s: %s: %s", case.name, contender.title, error)
        return replace(
            measurement, seconds=time.perf_counter() - start, fault=f"{type(error).__name__}: {error}",
            overlay=None if contender.bends else False,
        )  # fmt: skip
    return _judged(replace(measurement, seconds=time.perf_counter() - start), task, placement)


def _judged(measurement: Measurement, task: Task, placement: Placement) -> Measurement:
    ruler, reference = task.ruler, task.reference
    score = ruler.score_parts(reference, placement.T_scan_parts)
    errors = np.array(list(score.part_errors.values()))
    bend = 0.0
    if placement.surface is not None:
        errors = ruler.surface_errors(reference, placement.surface)
        bend = max(_bend(placement, task, part) for part in reference.observed)
    joints: list[float] = []
    if placement.state is not None:
        own = ruler.joint_errors(reference, placement.state)
        joints = [own[name] for name in reference.told]
    gaps = [opening.gap for opening in openings(ruler.model, placement.T_scan_parts).values()]
    return replace(
        measurement,
        overlay=score.overlay if placement.surface is None else None,
        right=float(np.mean((errors < FOUND) | list(ruler.overlaid_parts(reference, placement.T_scan_parts)))),
        error=float(errors.mean()),
        joints=median(joints),
        gap=max(gaps, default=0.0) / ruler.model.diagonal,
        bend=bend,
    )


def _bend(placement: Placement, task: Task, part: int) -> float:
    """Return how far (rms) a part's surface departs from the rigid fit of it, model diagonals."""
    assert placement.surface is not None
    own, placed = task.ruler.samples[part], placement.surface[part]
    offsets = transform(rigid_fit(own, placed), own) - placed
    return float(np.sqrt((offsets**2).sum(axis=1).mean()) / task.ruler.model.diagonal)


HEADS = (
    "method", " overlay", " parts right", " surface off by", " joints", " widest gap", " bent by", " time median",
    " quartiles", " ratio", " quartiles", " failures",
)  # fmt: skip


def rows(measured: Sequence[Measurement], baseline: str = OURS) -> list[list[str]]:
    """Return a line of `HEADS` for each method.

    A ratio is the time to that of the baseline on the same case in the same repetition: its median and quartiles.
    Times of failures do not count.
    """
    times = {_place(own): own.seconds for own in measured if own.method == baseline and not own.fault}
    lines = []
    for name in _methods(measured):
        runs = [own for own in measured if own.method == name]
        done = [own for own in runs if not own.fault]
        overlays = [own.overlay for own in runs if own.overlay is not None]
        seconds = [own.seconds for own in done]
        ratios = [own.seconds / times[_place(own)] for own in done if _place(own) in times]
        lines.append(
            [
                CONTENDERS[name].title,
                share(overlays),
                figure(100 * float(np.mean([own.right for own in runs])), "%", 0),
                figure(100 * median([own.error for own in done]), "% D"),
                figure(median([own.joints for own in done if np.isfinite(own.joints)])),
                figure(100 * median([own.gap for own in done]), "% D"),
                figure(100 * median([own.bend for own in done]), "% D"),
                _seconds(median(seconds)),
                _quartiles(seconds, _seconds),
                _ratio(median(ratios)),
                _quartiles(ratios, _ratio),
                str(len(runs) - len(done)),
            ]
        )
    return lines


def by_tier(measured: Sequence[Measurement]) -> Iterator[tuple[str, list[Measurement]]]:
    """Yield the measurements of each tier, in order of appearance."""
    for tier in dict.fromkeys(own.tier for own in measured):
        yield tier, [own for own in measured if own.tier == tier]


def overlays_by_robot(measured: Sequence[Measurement]) -> tuple[list[str], list[list[str]]]:
    """Return heads and lines of a table: the overlays of every method that has them, robot by robot."""
    robots = list(dict.fromkeys(own.robot for own in measured))
    lines = []
    for name in _methods([own for own in measured if own.overlay is not None]):
        runs = [own for own in measured if own.method == name]
        cells = [share([bool(own.overlay) for own in runs if own.robot == robot]) for robot in robots]
        lines.append([CONTENDERS[name].title, *cells])
    return ["overlays", *(f" {robot}" for robot in robots)], lines


def pictures(measured: Sequence[Measurement]) -> Mapping[str, bytes]:
    """Return PNGs by file name: parts right against time, a panel a tier, one above the other: a page
    is narrow."""
    tiers = list(by_tier(measured))
    picture = new_figure(8.2, 3.5 * len(tiers))
    panels = picture.subplots(len(tiers), 1, sharex=True, squeeze=False)[:, 0]
    methods = _methods(measured)
    for axes, (tier, own) in zip(panels, tiers, strict=True):
        places = {}
        for name in methods:
            runs = [one for one in own if one.method == name]
            seconds = [one.seconds for one in runs if not one.fault]
            if not seconds:
                continue
            low, middle, high = (quantile(seconds, part) for part in (0.25, 0.5, 0.75))
            places[name] = (middle, 100 * float(np.mean([one.right for one in runs])))
            colour, marker = _mark(name)
            axes.errorbar(
                *places[name], xerr=[[middle - low], [high - middle]], marker=marker, color=colour,
                markersize=10 if name == OURS else 6, elinewidth=1, capsize=2, linestyle="none",
                zorder=3 if _is_ours(name) else 2,
            )  # fmt: skip
        axes.set(title=tier, ylabel="parts right, %", xscale="log", ylim=(-4, 108))
        tidy(axes)
        _label(axes, places)
    panels[-1].set_xlabel("time, s")
    return {"peers.png": as_png(picture)}


def _is_ours(name: str) -> bool:
    return CONTENDERS[name].title.startswith("pwralign")


def _mark(name: str) -> tuple[str, str]:
    """Return colour and marker: ours, rigid methods, those that bend the parts, and the rest."""
    if _is_ours(name):
        return COLOURS[0], "o"
    if "rigid)" in CONTENDERS[name].title or name == "cpd-rigid":
        return PALE, "s"
    return (COLOURS[1], "^") if CONTENDERS[name].bends else (COLOURS[2], "D")


def _label(axes: Any, places: Mapping[str, tuple[float, float]]) -> None:
    """Write the names of the methods right of the panel, a line from each to its place (time, share)."""
    order = sorted(places, key=lambda name: (places[name][1], -places[name][0]))
    least = 5.4  # percent that a line of text is high
    heights: list[float] = []
    for name in order:
        heights.append(max(places[name][1], heights[-1] + least if heights else 0.0))
    top = 106.0
    for index in reversed(range(len(heights))):  # those that do not fit push down what is below
        heights[index] = min(heights[index], top - least * (len(heights) - 1 - index))
    for name, height in zip(order, heights, strict=True):
        axes.annotate(
            CONTENDERS[name].title, places[name], (1.03, height), textcoords=axes.get_yaxis_transform(),
            va="center", fontsize=7.5, color=_mark(name)[0], fontweight="bold" if name == OURS else "normal",
            arrowprops={
                "arrowstyle": "-", "color": "0.8", "linewidth": 0.6, "shrinkA": 2, "shrinkB": 4, "relpos": (0, 0.5)
            },
            annotation_clip=False, zorder=1,
        )  # fmt: skip


def _methods(measured: Sequence[Measurement]) -> list[str]:
    """Return the methods in the order of `CONTENDERS`."""
    ran = {own.method for own in measured}
    return [name for name in CONTENDERS if name in ran]


def _quartiles(values: Sequence[float], shown: Callable[[float], str]) -> str:
    return f"{shown(quantile(values, 0.25))} to {shown(quantile(values, 0.75))}" if values else NONE


def _place(own: Measurement) -> tuple[str, str, int, int]:
    return own.robot, own.tier, own.configuration, own.repetition


def _seconds(value: float) -> str:
    """Return a time with three figures or so."""
    return figure(1e3 * value, " ms", 1) if value < 0.1 else figure(value, " s")


def _ratio(value: float) -> str:
    return figure(value, digits=3 if value < 0.1 else 2 if value < 10 else 1)
