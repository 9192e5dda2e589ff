"""How scans that get worse are borne: points, noise, strays and gaps, beside the part-wise rigid baseline."""

from __future__ import annotations

import logging
import time
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from pwralign_kin.baselines.part_wise_rigid import part_wise_rigid
from pwralign_kin.benchmark.metrics import FOUND, Reference, Ruler
from pwralign_kin.benchmark.pictures import COLOURS, PALE, as_png, new_figure, tidy
from pwralign_kin.benchmark.runs import Models, Progress
from pwralign_kin.benchmark.table import figure, markdown, median, share
from pwralign_kin.estimation import EstimatorOptions, estimate
from pwralign_kin.exceptions import PwralignError
from pwralign_kin.model import ArticulatedModel
from pwralign_kin.scan import Scan
from pwralign_kin.se3 import Array
from pwralign_kin.simulation import GuessOffset, Sensor, simulate
from pwralign_kin.state import State

logger = logging.getLogger(__name__)

USUAL = Sensor(points=4000, guess=GuessOffset())
"""Eight views, noise 0.2% of the diagonal. The guess is for the baseline that needs one."""


@dataclass(frozen=True)
class Curve:
    """One thing that makes scans worse."""

    title: str
    levels: tuple[float, ...]
    unit: str
    scale: float
    """Factor from a level to its unit."""

    sensor: Callable[[float, int], Sensor]
    """Of the level and the number of parts with geometry."""

    logarithmic: bool = False


CURVES: Mapping[str, Curve] = MappingProxyType(
    {
        "points": Curve(
            "points per part", (25, 50, 100, 200, 400), "", 1,
            lambda level, parts: replace(USUAL, points=round(level * parts)), True,
        ),
        "noise": Curve(
            "noise (standard deviation)", (0.0, 0.0025, 0.005, 0.01, 0.015, 0.02, 0.03), "% D", 100,
            lambda level, parts: replace(USUAL, noise=level),
        ),
        "stray": Curve(
            "stray points", (0.0, 0.1, 0.2, 0.4, 0.8, 1.6), "% of the scan's own", 100,
            lambda level, parts: replace(USUAL, stray=level),
        ),
        "missing": Curve(
            "missing in one piece", (0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6), "% of the points", 100,
            lambda level, parts: replace(USUAL, missing_share=level),
        ),
    }
)  # fmt: skip

OURS, BASELINE, GUIDED = "pwralign_kin", "part-wise rigid", "part-wise rigid, given a guess"


@dataclass(frozen=True)
class Point:
    """What one method makes of one scan."""

    model: str
    curve: str
    level: float
    configuration: int
    method: str
    overlay: bool = False
    parts: float = 0.0
    """Share of the observed parts that are found, or whose true surface another part lies on."""

    gap: float = float("nan")
    """Widest opening of a joint, model diagonals."""

    seconds: float = 0.0
    fault: str = ""

    def __str__(self) -> str:
        """Return one line for the progress display."""
        verdict = self.fault or f"{self.parts:.0%} of the parts, widest gap {100 * self.gap:.1f}% D"
        return f"{self.model}-{self.configuration} {self.curve} {self.level:g} [{self.method}] {verdict}"


Placing = Callable[[ArticulatedModel, Scan, State | None, int], tuple[Array, float]]


def _by_estimate(model: ArticulatedModel, scan: Scan, guess: State | None, threads: int) -> tuple[Array, float]:
    del guess  # ours needs none
    found = estimate(model, scan, options=EstimatorOptions(threads=threads))
    return np.stack([found.parts[part.name].T_scan_part for part in model.parts]), 0.0


def _by_baseline(model: ArticulatedModel, scan: Scan, guess: State | None, threads: int) -> tuple[Array, float]:
    del guess, threads
    return _rigid(model, scan, None)


def _by_guided_baseline(model: ArticulatedModel, scan: Scan, guess: State | None, threads: int) -> tuple[Array, float]:
    del threads
    return _rigid(model, scan, guess)


def _rigid(model: ArticulatedModel, scan: Scan, guess: State | None) -> tuple[Array, float]:
    found = part_wise_rigid(model, scan, guess)
    gap = max((opening.gap for opening in found.openings.values()), default=0.0)
    return found.T_scan_parts, gap / model.diagonal


METHODS: Mapping[str, Placing] = MappingProxyType(
    {OURS: _by_estimate, BASELINE: _by_baseline, GUIDED: _by_guided_baseline}
)


def measure(models: Models, configurations: int, threads: int, progress: Progress) -> list[Point]:
    """Run all methods on scans of the models at every level of every curve."""
    points = []
    for name, model in models:
        ruler = Ruler(model)
        for point in _of_model(name, ruler, configurations, threads):
            points.append(point)
            progress(str(point))
    return points


def curves_table(points: Sequence[Point]) -> str:
    """Return the share of right overlays and of parts right at every level, all models together."""
    methods = list(dict.fromkeys(point.method for point in points))
    heads = ["curve", " level"]
    heads += [f" {method}: {column}" for method in methods for column in ("overlay", "parts right")]
    rows = []
    for curve, level in dict.fromkeys((point.curve, point.level) for point in points):
        cells = []
        for method in methods:
            own = [p for p in points if (p.curve, p.level, p.method) == (curve, level, method)]
            overlaid = 100 * float(np.mean([p.parts for p in own]))
            cells += [share([p.overlay for p in own]), figure(overlaid, "%", 0)]
        shown = CURVES[curve]
        rows.append([shown.title, f"{level * shown.scale:g}{shown.unit[:1]}", *cells])
    return markdown(heads, rows)


def methods_table(points: Sequence[Point]) -> str:
    """Return for every model and method how many parts are overlaid, how far joints open, and the time."""
    heads = ["model", "method", " overlay", " parts right", " widest gap median", " time median", " errors"]
    rows = []
    for model, method in dict.fromkeys((point.model, point.method) for point in points):
        own = [point for point in points if (point.model, point.method) == (model, method)]
        rows.append(
            [
                model, method, share([point.overlay for point in own]),
                figure(100 * float(np.mean([point.parts for point in own])), "%", 0),
                figure(100 * median([point.gap for point in own if not point.fault]), "% D", 1),
                figure(median([point.seconds for point in own]), " s"), str(sum(bool(p.fault) for p in own)),
            ]
        )  # fmt: skip
    return markdown(heads, rows)


def curve_pictures(points: Sequence[Point]) -> dict[str, bytes]:
    """Return a PNG for every curve: a panel per model, parts right against the level."""
    names = dict.fromkeys(point.curve for point in points)
    return {f"curves_{name}.png": _picture(name, [p for p in points if p.curve == name]) for name in names}


def _of_model(name: str, ruler: Ruler, configurations: int, threads: int) -> Iterator[Point]:
    parts = len(ruler.samples)
    for curve, own in CURVES.items():
        for level in own.levels:
            for configuration in range(configurations):
                seed = zlib.crc32(f"{name} {configuration}".encode())
                made = simulate(ruler.model, None, own.sensor(level, parts), seed)
                reference = ruler.reference(made.state, made.labels)
                for method, place in METHODS.items():
                    point = Point(name, curve, level, configuration, method)
                    yield _placed(point, place, ruler, reference, made.scan, made.guess, threads)


def _placed(
    point: Point, place: Placing, ruler: Ruler, reference: Reference, scan: Scan, guess: State | None, threads: int
) -> Point:
    start = time.perf_counter()
    try:
        placements, gap = place(ruler.model, scan, guess, threads)
    except PwralignError as error:  # too few points are a failure of the method, not of the benchmark
        logger.warning("%s", error)
        return replace(point, seconds=time.perf_counter() - start, fault=f"{type(error).__name__}: {error}")
    seconds = time.perf_counter() - start
    score, overlaid = ruler.score_parts(reference, placements), ruler.overlaid_parts(reference, placements)
    right = [error < FOUND or covered for error, covered in zip(score.part_errors.values(), overlaid, strict=True)]
    return replace(point, overlay=score.overlay, parts=float(np.mean(right)), gap=gap, seconds=seconds)


def _picture(name: str, points: Sequence[Point]) -> bytes:
    curve, models = CURVES[name], list(dict.fromkeys(point.model for point in points))
    picture = new_figure(max(2.5 * len(models), 6.5), 2.9)
    panels = picture.subplots(1, len(models), sharey=True, squeeze=False)[0]
    for axes, model in zip(panels, models, strict=True):
        for method, style, colour in zip(METHODS, ("o-", "s--", "^:"), (*COLOURS[:2], PALE), strict=True):
            own = [point for point in points if (point.model, point.method) == (model, method)]
            means = [_mean(p.parts for p in own if p.level == level) for level in curve.levels]
            levels, shares = np.array(curve.levels) * curve.scale, 100 * np.array(means)
            axes.plot(levels, shares, style, color=colour, markersize=4, label=method)
        axes.set(title=model, xlabel=f"{curve.title}\n{curve.unit}".strip(), ylim=(-3, 103), yticks=range(0, 101, 25))
        tidy(axes)
        if curve.logarithmic:
            axes.set_xscale("log")
            axes.set_xticks(curve.levels, [f"{level:g}" for level in curve.levels], minor=False)
            axes.minorticks_off()
    panels[0].set_ylabel("parts right, %")
    picture.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=3, frameon=False)
    return as_png(picture)


def _mean(values: Iterable[float]) -> float:
    return float(np.mean(list(values)))
