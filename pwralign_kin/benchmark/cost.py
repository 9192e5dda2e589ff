"""What size costs: time and peak memory against scan points, parts and triangles, each in a process of its own."""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from pwralign_kin.benchmark.chains import chain, mesh_files
from pwralign_kin.benchmark.empty_cache import empty_cache
from pwralign_kin.benchmark.pictures import COLOURS, PALE, as_png, new_figure, tidy
from pwralign_kin.benchmark.runs import Progress
from pwralign_kin.benchmark.table import figure, markdown, median
from pwralign_kin.dependencies import open3d
from pwralign_kin.se3 import Array

if TYPE_CHECKING:
    from pwralign_kin.model import ArticulatedModel

ROBOT = "panda"
"""What is scanned with more and more points."""

CHAIN_POINTS = 6000
"""Points of the scans of chains, whatever their number of parts."""

USUAL, LARGE = 20_000, 1_000_000
"""Scan points: what a scan may have anyway, and what must take at most twice the time after its downsampling."""

REPEATS = 3


@dataclass(frozen=True)
class Cost:
    """What one size costs."""

    size: int
    seconds: Mapping[str, float]
    """By stage, medians; the last is their sum or the whole."""
    idle: float
    """Memory of the process with its libraries and the model or its files, before it begins, MB; ..."""
    peak: float
    """... and the most it takes, MB."""

    def __str__(self) -> str:
        """Return one line for the progress display."""
        stages = ", ".join(f"{stage} {seconds:.3f} s" for stage, seconds in self.seconds.items())
        return f"{self.size}: {stages}; {self.peak:.0f} MB"


@dataclass(frozen=True)
class Size:
    """One thing that grows."""

    title: str
    sizes: tuple[int, ...]
    child: Callable[[int, Path, int], Cost]
    """Runs in a fresh process on a size, a folder of its own and a number of threads; ..."""
    before: Callable[[int, Path, int], None] | None = None
    """... after this has run in another one, whose memory does not count."""


def measure(threads: int, progress: Progress, sizes: Mapping[str, Size] | None = None) -> dict[str, list[Cost]]:
    """Return the costs of every size of every thing that grows (`SIZES`)."""
    measured: dict[str, list[Cost]] = {}
    for name, grown in (sizes or SIZES).items():
        measured[name] = []
        for size in grown.sizes:
            with tempfile.TemporaryDirectory() as folder:
                if grown.before is not None:
                    _in_fresh_process(grown.before, size, Path(folder), threads)
                cost = _in_fresh_process(grown.child, size, Path(folder), threads)
            measured[name].append(cost)
            progress(f"{grown.title} {cost}")
    return measured


Outcome = TypeVar("Outcome")


def _in_fresh_process(task: Callable[[int, Path, int], Outcome], size: int, folder: Path, threads: int) -> Outcome:
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as fresh:
        return fresh.submit(task, size, folder, threads).result()


def tables(measured: Mapping[str, Sequence[Cost]]) -> str:
    """Return a table for everything that grows, with the slope of its time, and what a large scan costs."""
    texts = []
    for name, costs in measured.items():
        grown = SIZES[name]
        stages = list(costs[0].seconds)
        heads = [grown.title, *(f" {stage}" for stage in stages), " memory before", " peak"]
        lines = [
            [
                str(own.size), *(figure(own.seconds[stage], " s", 3) for stage in stages),
                figure(own.idle, " MB", 0), figure(own.peak, " MB", 0),
            ]
            for own in costs
        ]  # fmt: skip
        for label, own in (("slope", costs), ("slope, upper half", costs[len(costs) // 2 :])):
            slopes = [figure(slope(own, stage)) for stage in stages]
            lines.append([label, *slopes, "", figure(slope(own, None))])
        texts.append(markdown(heads, lines))
    return "\n".join([*texts, *_large_scan(measured.get("points", ()))])


def slope(costs: Sequence[Cost], stage: str | None) -> float:
    """Return the exponent of a stage's time in the size (of the peak memory for None), by a line in log-log scales."""
    values = [own.peak if stage is None else own.seconds[stage] for own in costs]
    if len(costs) < 2:
        return float("nan")
    return float(np.polyfit(np.log([own.size for own in costs]), np.log(values), 1)[0])


def _large_scan(costs: Sequence[Cost]) -> Iterator[str]:
    """Yield what a large scan costs beside a usual one."""
    by_size = {own.size: own for own in costs}
    if USUAL in by_size and LARGE in by_size:
        usual, large = by_size[USUAL], by_size[LARGE]
        after = large.seconds["search"] / usual.seconds["search"]
        whole = large.seconds["whole"] / usual.seconds["whole"]
        yield (
            f"{LARGE:,} points against {USUAL:,}: {after:.2f} times the time after the downsampling, {whole:.2f} times "
            f"in all; {large.peak:.0f} MB at most.\n"
        )


def pictures(measured: Mapping[str, Sequence[Cost]]) -> dict[str, bytes]:
    """Return a PNG for everything that grows: times, and peak memory beside."""
    drawn = {}
    for name, costs in measured.items():
        grown = SIZES[name]
        picture = new_figure(8.4, 4.0)
        left, right = picture.subplots(1, 2)
        sizes = [own.size for own in costs]
        for stage, style, colour in zip(costs[0].seconds, ("o-", "s--", "^:", "D-.", "v-"), COLOURS, strict=False):
            label = f"{stage}, slope {slope(costs, stage):.2f}"
            left.plot(sizes, [own.seconds[stage] for own in costs], style, color=colour, markersize=4, label=label)
        right.plot(sizes, [own.peak for own in costs], "o-", color=COLOURS[0], markersize=4, label="peak")
        right.plot(sizes, [own.idle for own in costs], "s--", color=PALE, markersize=4, label="before")
        left.set(xlabel=grown.title, ylabel="time, s", xscale="log", yscale="log")
        right.set(xlabel=grown.title, ylabel="memory, MB", xscale="log")
        right.set_ylim(bottom=0)
        for axes in (left, right):
            tidy(axes)
            # Below the panel, where it hides no curve.
            axes.legend(fontsize=8, frameon=False, ncols=2, loc="upper center", bbox_to_anchor=(0.5, -0.17))
        drawn[f"cost_{name}.png"] = as_png(picture)
    return drawn


def points_cost(size: int, folder: Path, threads: int) -> Cost:
    """Clean and search the scan in `folder`."""
    from pwralign_kin.benchmark.cases import load_robot

    model = load_robot(ROBOT)
    points = np.load(folder / "points.npy")
    return _estimates(model, points, size, threads)


def parts_cost(size: int, folder: Path, threads: int) -> Cost:
    """Prepare a chain of `size` parts and search a scan of it."""
    from pwralign_kin.model import ArticulatedModel
    from pwralign_kin.simulation import Sensor, simulate

    urdf = folder / "chain.urdf"
    urdf.write_text(chain(size), encoding="utf-8")
    with empty_cache(folder / "cache"):
        model = ArticulatedModel.from_urdf(urdf)
    points = np.array(simulate(model, None, Sensor(points=CHAIN_POINTS), 0).scan.points)
    return _estimates(model, points, size, threads)


def triangles_cost(size: int, folder: Path, threads: int) -> Cost:
    """Prepare a chain of six parts with `size` triangles in all, read it again, and search a scan of it."""
    # The libraries that a preparation loads on the way, so that their time and memory do not count.
    import pinocchio  # noqa: F401
    import trimesh  # noqa: F401

    from pwralign_kin.model import ArticulatedModel
    from pwralign_kin.simulation import Sensor, simulate

    open3d()
    urdf = folder / "chain.urdf"
    idle = memory()
    with empty_cache(folder / "cache"):
        start = time.perf_counter()
        model = ArticulatedModel.from_urdf(urdf)
        prepared = time.perf_counter()
        ArticulatedModel.from_urdf(urdf)
        again = time.perf_counter()
    peak = peak_memory()
    points = np.array(simulate(model, None, Sensor(points=CHAIN_POINTS), 0).scan.points)
    searched = _estimates(model, points, size, threads)
    seconds = {
        "preparation": prepared - start,
        "from the cache": again - prepared,
        "estimate": searched.seconds["whole"],
    }
    return Cost(sum(len(part.faces) for part in model.parts), seconds, idle, peak)


def scan_file(size: int, folder: Path, threads: int) -> None:
    """Write a simulated scan of `size` points into `folder`, in a process whose memory does not count."""
    from pwralign_kin.benchmark.cases import load_robot
    from pwralign_kin.simulation import Sensor, simulate

    del threads
    np.save(folder / "points.npy", simulate(load_robot(ROBOT), None, Sensor(points=size), 0).scan.points)


def _estimates(model: ArticulatedModel, points: Array, size: int, threads: int) -> Cost:
    """Return what an estimate of the points costs, cleaning and all, after one that does not count."""
    from pwralign_kin.estimation import EstimatorOptions, estimate
    from pwralign_kin.scan import Scan

    options = EstimatorOptions(threads=threads)
    idle = memory()
    seconds: dict[str, list[float]] = {}
    for repeat in range(REPEATS + 1):
        start = time.perf_counter()
        scan = Scan(points)
        cleaned = time.perf_counter()
        found = estimate(model, scan, options=options)
        end = time.perf_counter()
        observed = found.timings["observe"]
        stages = {"cleaning": cleaned - start, "downsampling, normals": observed, "search": end - cleaned - observed}
        for stage, own in {**stages, "whole": end - start}.items():
            if repeat:
                seconds.setdefault(stage, []).append(own)
    return Cost(size, {stage: median(own) for stage, own in seconds.items()}, idle, peak_memory())


def memory() -> float:
    """Return the memory that this process occupies, MB; where the system does not tell, the most it did."""
    return _status("VmRSS") or peak_memory()


def peak_memory() -> float:
    """Return the most memory that this process occupied, MB.

    The kernel's own figure for the process: `getrusage` keeps what the parent had when it started a child.
    """
    import resource

    unit = 1 if sys.platform == "darwin" else 1024
    return _status("VmHWM") or resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 1e6


def _status(name: str) -> float:
    """Return an entry of Linux' status of this process, MB; 0 elsewhere."""
    status = Path("/proc/self/status")
    lines = status.read_text(encoding="utf-8").splitlines() if status.exists() else []
    return next((1024 * float(line.split()[1]) / 1e6 for line in lines if line.startswith(f"{name}:")), 0.0)


SIZES: Mapping[str, Size] = MappingProxyType(
    {
        "points": Size("scan points", (1000, 3000, 10_000, USUAL, 50_000, 200_000, LARGE), points_cost, scan_file),
        "parts": Size("parts", (2, 4, 8, 15, 30, 60), parts_cost),
        "triangles": Size("triangles", (1000, 10_000, 100_000, 300_000, 1_000_000), triangles_cost, mesh_files),
    }
)
