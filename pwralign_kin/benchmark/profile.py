"""Where the time of estimates goes: stages, and the compiled kernels within them."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import wraps
from typing import Any

import numpy as np

from pwralign_kin import kernels
from pwralign_kin.benchmark.runs import Cases, Progress
from pwralign_kin.benchmark.table import NONE, figure, markdown
from pwralign_kin.estimation import EstimatorOptions, estimate

LEAST_SHARE = 0.005
"""Kernels that take less of the time stand in the last line of their table together."""


@dataclass(frozen=True)
class Timed:
    """One estimate."""

    robot: str
    tier: str
    seconds: float
    stages: dict[str, float]
    """Seconds by stage."""
    kernels: dict[str, tuple[int, float]]
    """Calls and seconds by kernel."""


def measure(cases: Cases, threads: int, progress: Progress) -> list[Timed]:
    """Time an estimate of each case; the first case is estimated once before, without counting."""
    measured: list[Timed] = []
    options = EstimatorOptions(threads=threads)
    for ruler, case in cases:
        if not measured:
            estimate(ruler.model, case.scan, case.guess, options=options)
        with timed_kernels() as calls:
            start = time.perf_counter()
            found = estimate(ruler.model, case.scan, case.guess, options=options)
            seconds = time.perf_counter() - start
        counted = {name: (len(own), sum(own)) for name, own in calls.items()}
        measured.append(Timed(case.robot, case.tier, seconds, dict(found.timings), counted))
        progress(f"{case.name} {seconds:.2f} s")
    return measured


def tables(measured: Sequence[Timed]) -> str:
    """Return the share of every stage, by tier and by robot, and what the kernels take."""
    return "\n".join(
        [
            _stage_table("tier", measured, lambda own: own.tier),
            _stage_table("robot", measured, lambda own: own.robot),
            _kernel_table(measured),
        ]
    )


def _stage_table(head: str, measured: Sequence[Timed], key: Callable[[Timed], str]) -> str:
    stages = list(dict.fromkeys(stage for own in measured for stage in own.stages))
    heads = [head, " time median", *(f" {stage}" for stage in stages), " other"]
    groups = {group: [own for own in measured if key(own) == group] for group in dict.fromkeys(map(key, measured))}
    lines = []
    for group, runs in {**groups, "all": list(measured)}.items():
        total = sum(own.seconds for own in runs)
        spent = [sum(own.stages.get(stage, 0.0) for own in runs) for stage in stages]
        shares = [figure(100 * part / total, "%", 0) if part else NONE for part in (*spent, total - sum(spent))]
        lines.append([group, figure(float(np.median([own.seconds for own in runs])), " s"), *shares])
    return markdown(heads, lines)


def _kernel_table(measured: Sequence[Timed]) -> str:
    total = sum(own.seconds for own in measured)
    names = {name for own in measured for name in own.kernels}
    spent = {
        name: (
            sum(own.kernels.get(name, (0, 0.0))[0] for own in measured),
            sum(own.kernels.get(name, (0, 0.0))[1] for own in measured),
        )
        for name in names
    }
    lines, small = [], 0.0
    for name, (calls, seconds) in sorted(spent.items(), key=lambda item: -item[1][1]):
        if seconds < LEAST_SHARE * total:
            small += seconds
            continue
        lines.append(
            [
                name, figure(calls / len(measured), digits=1), figure(1e3 * seconds / calls, " ms"),
                figure(100 * seconds / total, "%", 1),
            ]
        )  # fmt: skip
    compiled = sum(seconds for _, seconds in spent.values())
    lines.append(["other kernels", NONE, NONE, figure(100 * small / total, "%", 1)])
    lines.append(["Python and libraries", NONE, NONE, figure(100 * (1 - compiled / total), "%", 1)])
    return markdown(["kernel", " calls an estimate", " a call", " share"], lines)


@contextmanager
def timed_kernels() -> Iterator[dict[str, list[float]]]:
    """Note, within the block, the time (s) of every call of a kernel by the kernel's name."""
    calls: dict[str, list[float]] = {}
    places: list[tuple[Any, str]] = [(kernels, name) for name in kernels.__all__ if name[0].islower()]
    places += [(kernels, "ScanField")]
    places += [(kernels.Search, name) for name in dir(kernels.Search) if not name.startswith("_")]
    before = [(owner, name, getattr(owner, name)) for owner, name in places]
    for owner, name, function in before:
        setattr(owner, name, _noting(function, name, calls))
    try:
        yield calls
    finally:
        for owner, name, function in before:
            setattr(owner, name, function)


def _noting(function: Callable[..., Any], name: str, calls: dict[str, list[float]]) -> Callable[..., Any]:
    def call(*arguments: Any, **named: Any) -> Any:
        start = time.perf_counter()
        try:
            return function(*arguments, **named)
        finally:
            calls.setdefault(name, []).append(time.perf_counter() - start)

    return wraps(function, assigned=("__name__", "__doc__"))(call)
