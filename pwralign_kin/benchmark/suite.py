"""The tables of the benchmark by name: what each runs, and how its figures are put down."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

from pwralign_kin.benchmark import first_use, joint_gap, samples, summaries
from pwralign_kin.benchmark.cases import (
    PARKED,
    ROBOTS,
    Case,
    load_robot,
    load_sample,
    sample_cases,
    sample_names,
    simulated_case,
)
from pwralign_kin.benchmark.methods import ABLATIONS, DEFAULT, Method, with_outside_pairs
from pwralign_kin.benchmark.runs import Outcome, Progress, evaluate
from pwralign_kin.model import ArticulatedModel
from pwralign_kin.simulation import TIERS

ABLATION_ROBOTS = ("panda", "ur5", "z1", "allegro", "solo12", "tiago", "go2", "pendulum")
"""Arms, a hand, legs that can be taken for each other, a mobile base, and two plain rods."""

ABLATION_TIERS = ("full", "hololens", "sparse", "missing", "single", PARKED)
"""Where noise, sparsity, gaps, one-sidedness and limits tell the variants apart."""

CORRESPONDENCE_TIERS = ("full", "single")
OUTSIDE_PAIRS = ((1000, 0.6), (100, 0.6), (100, 1.0))
"""Number, and share that is wrong. All wrong is the control: what the search finds in spite of them."""

GAP_TIERS = ("full", "single")


@dataclass(frozen=True)
class Settings:
    """What to run."""

    samples: Path
    """The folder of the sample models."""

    robots: tuple[str, ...] | None = None
    """None: all of a table."""

    tiers: tuple[str, ...] | None = None
    """None: those of the table."""

    configurations: int = 3
    threads: int = 2


@dataclass(frozen=True)
class Result:
    """The figures of one table."""

    text: str
    """Markdown."""

    records: Any
    """All single results, as dataclasses."""


def overlay(settings: Settings, progress: Progress) -> Result:
    """Every robot in every tier, with the default options."""
    outcomes = _evaluate(settings, ROBOTS, TIERS, {"default": DEFAULT}, progress)
    return Result(
        "\n".join(
            [
                summaries.overlay_table("tier", outcomes, lambda outcome: outcome.tier),
                summaries.overlay_table("robot", outcomes, lambda outcome: outcome.robot),
                summaries.determined_table(outcomes),
            ]
        ),
        outcomes,
    )


def ablation(settings: Settings, progress: Progress) -> Result:
    """Each part of the pipeline off in turn."""
    outcomes = _evaluate(settings, ABLATION_ROBOTS, ABLATION_TIERS, ABLATIONS, progress)
    tables = (summaries.ablation_table, summaries.overlay_by_tier_table, summaries.least_squares_table)
    return Result("\n".join(table(outcomes) for table in tables), outcomes)


def correspondences(settings: Settings, progress: Progress) -> Result:
    """Nothing but correspondences from outside, most of them wrong."""
    methods = {method.title: method for method in (with_outside_pairs(*pairs) for pairs in OUTSIDE_PAIRS)}
    outcomes = _evaluate(settings, ROBOTS, CORRESPONDENCE_TIERS, methods, progress)
    return Result(summaries.correspondence_table(outcomes), outcomes)


def first_use_costs(settings: Settings, progress: Progress) -> Result:
    """What imports, help and the preparation of a robot cost."""
    costs = first_use.measure(settings.robots or ROBOTS, settings.threads, progress)
    return Result(first_use.table(costs), costs)


def sample_scans(settings: Settings, progress: Progress) -> Result:
    """The sample scans beside the sample models."""
    outcomes = samples.evaluate_samples(settings.samples, settings.threads, progress)
    return Result(samples.table(outcomes), outcomes)


def joint_gaps(settings: Settings, progress: Progress) -> Result:
    """Gaps at the joints of estimates and of their exports."""
    gaps = joint_gap.measure(_gap_cases(settings), settings.threads, progress)
    return Result(joint_gap.table(gaps), gaps)


TABLES: Mapping[str, Callable[[Settings, Progress], Result]] = MappingProxyType(
    {
        "overlay": overlay,
        "ablation": ablation,
        "correspondences": correspondences,
        "first-use": first_use_costs,
        "samples": sample_scans,
        "gap": joint_gaps,
    }
)


def _evaluate(
    settings: Settings,
    robots: Iterable[str],
    tiers: Iterable[str],
    methods: Mapping[str, Method],
    progress: Progress,
) -> list[Outcome]:
    robots, tiers = settings.robots or robots, settings.tiers or tiers
    return evaluate(robots, tiers, settings.configurations, methods, settings.threads, progress)


def _gap_cases(settings: Settings) -> Iterator[tuple[ArticulatedModel, Case]]:
    """Yield a case per robot and tier; with all robots also the sample scans: mimic joints and slides."""
    for robot in settings.robots or ROBOTS:
        model = load_robot(robot)
        for tier in settings.tiers or GAP_TIERS:
            yield model, simulated_case(model, robot, tier, 0)
    if settings.robots is None:
        for name in sample_names(settings.samples):
            model = load_sample(settings.samples, name)
            for case in sample_cases(model, settings.samples, name):
                yield model, case
