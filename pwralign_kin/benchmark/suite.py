"""The tables of the benchmark by name: what each runs, and how its figures are put down."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import Any

from pwralign_kin.benchmark import (
    calibration,
    comparison,
    cost,
    curves,
    first_use,
    foreign,
    further,
    joint_gap,
    profile,
    samples,
    scenes,
    summaries,
    tracking,
)
from pwralign_kin.benchmark.cases import (
    FEW,
    HARSH,
    MESHED,
    PARKED,
    ROBOTS,
    Case,
    load_robot,
    load_sample,
    sample_cases,
    sample_names,
    simulated_case,
    wheel_robots,
)
from pwralign_kin.benchmark.methods import ABLATIONS, DEFAULT, HASTY, HASTY_NAME, Method, with_outside_pairs
from pwralign_kin.benchmark.peers import CONTENDERS
from pwralign_kin.benchmark.runs import Outcome, Progress, evaluate, tier_cases
from pwralign_kin.benchmark.table import markdown
from pwralign_kin.exceptions import DependencyError, UnknownNameError
from pwralign_kin.model import ArticulatedModel
from pwralign_kin.simulation import TIERS

ABLATION_ROBOTS = ("panda", "ur5", "z1", "allegro", "solo12", "tiago", "go2", "pendulum")
"""Arms, a hand, legs that can be taken for each other, a mobile base, and two plain rods."""

ABLATION_TIERS = ("full", "hololens", "sparse", "missing", "single", PARKED)
"""Where noise, sparsity, gaps, one-sidedness and limits tell the variants apart."""

FIT_ROBOTS = (
    "kinova", "so101", "finger_edu", "anymal_c_simple_anymal", "hyq_no_sensors", "go1", "solo", "human",
    "double_pendulum_simple", "cubebot", "viking_lander", "excavator", "cabinet", "door", "laptop",
)  # fmt: skip
"""What the confidence is fitted to: arms, legs, a humanoid, boxes, plates; none that the calibration is measured on."""

FIT_ROOMS = ("furniture", "contact")
"""Whole rooms with the model, that it is fitted to besides."""

CORRESPONDENCE_TIERS = ("full", "single")
OUTSIDE_PAIRS = ((1000, 0.6), (100, 0.6), (100, 1.0))
"""Number, and share that is wrong. All wrong is the control: what the search finds in spite of them."""

GAP_TIERS = ("full", "single")

KNOWN, DRAWN = "12 robots", "further robots"
"""Robots that the estimator was made with, and those drawn by lot."""

FIGURES = ("cubebot", "viking_lander")
"""What the published method was shown on."""

CURVE_MODELS = (*FIGURES, "panda", "go2", "allegro")

TRACKED = ("panda", "z1", "allegro", "solo12", "go2", "tiago")
"""Arms of seven and six joints, a hand, two quadrupeds, and a mobile base with an arm."""

COMPARED = (*FIGURES, "panda", "ur5", "go2", "allegro")
"""Where other methods are compared: what the published method was shown on, two arms, a quadruped, a hand."""

COMPARED_TIERS = ("full", "single", "warm")
"""All around, from one side, and from one side with a guess."""

COMPARED_REPEATS = 2

GUESSED, GUESSED_FRAMES = "panda", 20

CONFIGURATIONS, FIGURE_CONFIGURATIONS = 3, 10


@dataclass(frozen=True)
class Settings:
    """What to run."""

    samples: Path
    """The folder of the sample models."""

    robots: tuple[str, ...] | None = None
    """None: all of a table."""

    tiers: tuple[str, ...] | None = None
    """None: those of the table."""

    configurations: int | None = None
    """Random states of each model in each tier; None: as many as the table has."""

    threads: int = 2

    frames: int | None = None
    """Frames of a tracked sequence; None: as many as the table has."""


@dataclass(frozen=True)
class Result:
    """The figures of one table."""

    text: str
    """Markdown."""

    records: Any
    """All single results, as dataclasses."""

    pictures: Mapping[str, bytes] = field(default_factory=dict)
    """PNGs by file name."""


def overlay(settings: Settings, progress: Progress) -> Result:
    """Every robot in every tier, with the default options."""
    outcomes = _as_it_comes(settings, settings.robots or tuple(ROBOTS), progress)
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


def further_robots(settings: Settings, progress: Progress) -> Result:
    """Robots drawn by lot in every tier, with the default options."""
    drawn = _drawn(progress)
    outcomes = _as_it_comes(settings, settings.robots or further.accepted(drawn), progress)
    return Result(
        "\n".join(
            [
                summaries.overlay_table("tier", outcomes, lambda outcome: outcome.tier),
                summaries.overlay_table("robot", outcomes, lambda outcome: outcome.robot),
                further.draws_table(drawn),
            ]
        ),
        {"draws": drawn, "outcomes": outcomes},
    )


def unsegmented_scenes(settings: Settings, progress: Progress) -> Result:
    """The model in whole rooms, without a mask: every robot, and those drawn by lot. The rooms take the place of the
    tiers."""
    robots = [name for group in _known_and_drawn(settings, progress) for name in group]
    outcomes = scenes.measure(
        models(settings.samples, robots), settings.configurations or CONFIGURATIONS, settings.threads, progress
    )
    groups = summaries.grouped(outcomes, _origin)
    return Result("\n".join(f"**{name}**\n\n{scenes.table(own)}" for name, own in groups), outcomes)


def honest_doubt(settings: Settings, progress: Progress) -> Result:
    """Confidence and standard deviations against the truth, on the cases of two tables and harsher ones."""
    all_of = []
    for robots in _known_and_drawn(settings, progress):
        all_of += _as_it_comes(settings, robots, progress)
        if not settings.tiers:
            all_of += _evaluate(settings, robots, HARSH, {"default": DEFAULT}, progress)
    outcomes = dict(summaries.grouped(all_of, _origin))
    by_tier = dict(summaries.grouped(all_of, lambda outcome: outcome.tier))
    return _illustrated(
        [
            calibration.confidence_table({**outcomes, **by_tier, "all": all_of}),
            calibration.reliability_table({**outcomes, "all": all_of}),
            calibration.doubt_table({**outcomes, **by_tier, "all": all_of}),
        ],
        all_of,
        {"reliability.png": calibration.reliability_diagram(outcomes)},
    )


def confidence_fit(settings: Settings, progress: Progress) -> Result:
    """The coefficients of the confidence, from answers of the estimator as it comes and of a hasty search, to whole
    rooms too, and from its answers to scans that the model is not in."""
    robots = settings.robots or FIT_ROBOTS
    outcomes = _evaluate(settings, robots, TIERS, {"default": DEFAULT}, progress, 1)
    outcomes += _evaluate(settings, robots, HARSH, {"default": DEFAULT}, progress, 2)
    outcomes += _evaluate(settings, robots, FEW, {"default": DEFAULT}, progress, 1)
    outcomes += _evaluate(settings, robots, MESHED, {"default": DEFAULT}, progress, 2)
    without_guess = [tier for tier in TIERS if tier != "warm"]
    outcomes += _evaluate(settings, robots, without_guess, {HASTY_NAME: HASTY}, progress, 1)
    outcomes += scenes.as_cases(models(settings.samples, robots), FIT_ROOMS, settings.threads, progress)
    given = [own for own in outcomes if own.evidence]
    by_method = dict(summaries.grouped(given, lambda own: own.method))
    elsewhere = foreign.measure(models(settings.samples, robots), settings.threads, progress)
    answered = [own for own in elsewhere if own.evidence]
    tables = (
        calibration.coefficients_table(given, answered),
        calibration.confidence_table({**by_method, "all": given}),
        calibration.foreign_table(elsewhere),
    )
    return Result("\n".join(tables), [*outcomes, *elsewhere])


def figure_models(settings: Settings, progress: Progress) -> Result:
    """Cubebot and lander in every tier, with the default options."""
    outcomes = _evaluate(settings, FIGURES, TIERS, {"default": DEFAULT}, progress, FIGURE_CONFIGURATIONS)
    by_tier = [
        summaries.overlay_table(name, own, lambda outcome: outcome.tier)
        for name, own in summaries.grouped(outcomes, lambda outcome: outcome.robot)
    ]
    return Result("\n".join(by_tier), outcomes)


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


def degradation(settings: Settings, progress: Progress) -> Result:
    """Scans that get worse, beside the part-wise rigid baseline."""
    robots = models(settings.samples, settings.robots or CURVE_MODELS)
    points = curves.measure(robots, settings.configurations or CONFIGURATIONS, settings.threads, progress)
    tables = (curves.curves_table(points), curves.methods_table(points))
    return _illustrated(tables, points, curves.curve_pictures(points))


def tracked(settings: Settings, progress: Progress) -> Result:
    """Sequences followed, models found again, guesses refined."""
    robots = list(models(settings.samples, settings.robots or TRACKED))
    tracks = list(tracking.tracks(robots, settings.frames or tracking.FRAMES, progress))
    found = list(tracking.recoveries(robots, progress))
    [(name, model)] = models(settings.samples, (GUESSED,))
    count = settings.configurations or GUESSED_FRAMES
    refined = list(tracking.guesses(name, model, count, progress))
    tables = (tracking.tracks_table(tracks), tracking.recoveries_table(found), tracking.guesses_table(refined))
    return Result("\n".join(tables), {"tracks": tracks, "recoveries": found, "guesses": refined})


def peers(settings: Settings, progress: Progress) -> Result:
    """Ours beside everything else, in one run."""
    cases = tier_cases(
        models(settings.samples, settings.robots or COMPARED), settings.tiers or COMPARED_TIERS,
        settings.configurations or 1,
    )  # fmt: skip
    measured = comparison.compare(cases, CONTENDERS, COMPARED_REPEATS, 0, settings.threads, progress)
    tables = [
        f"**{tier}**\n\n{markdown(comparison.HEADS, comparison.rows(own))}"
        for tier, own in comparison.by_tier(measured)
    ]
    by_robot = markdown(*comparison.overlays_by_robot(measured))
    return _illustrated([*tables, by_robot], measured, comparison.pictures(measured))


def cost_against_size(settings: Settings, progress: Progress) -> Result:
    """Time and memory against scan points, parts and triangles."""
    measured = cost.measure(settings.threads, progress)
    return _illustrated([cost.tables(measured)], measured, cost.pictures(measured))


def where_time_goes(settings: Settings, progress: Progress) -> Result:
    """Stages and functions of estimates."""
    cases = tier_cases(
        models(settings.samples, settings.robots or COMPARED), settings.tiers or TIERS, settings.configurations or 1
    )
    measured = profile.measure(cases, settings.threads, progress)
    return Result(profile.tables(measured), measured)


TABLES: Mapping[str, Callable[[Settings, Progress], Result]] = MappingProxyType(
    {
        "overlay": overlay,
        "further": further_robots,
        "figures": figure_models,
        "scenes": unsegmented_scenes,
        "calibration": honest_doubt,
        "confidence": confidence_fit,
        "curves": degradation,
        "ablation": ablation,
        "correspondences": correspondences,
        "first-use": first_use_costs,
        "samples": sample_scans,
        "gap": joint_gaps,
        "tracking": tracked,
        "peers": peers,
        "cost": cost_against_size,
        "profile": where_time_goes,
    }
)


def _illustrated(texts: Iterable[str], records: Any, pictures: Mapping[str, bytes]) -> Result:
    """Return figures whose pictures stand before them."""
    links = "\n".join(f"![{name.removesuffix('.png').replace('_', ' ')}](docs/{name})" for name in pictures)
    return Result("\n".join([f"{links}\n", *texts]), records, pictures)


@cache
def _as_it_comes(settings: Settings, robots: tuple[str, ...], progress: Progress) -> list[Outcome]:
    """Return the outcomes of these robots with the default options; tables of one run share them."""
    cases = tier_cases(
        models(settings.samples, robots), settings.tiers or TIERS, settings.configurations or CONFIGURATIONS
    )
    return evaluate(cases, {"default": DEFAULT}, settings.threads, progress)


@cache
def _drawn(progress: Progress) -> list[further.Draw]:
    """Return the robots drawn by lot, with those refused."""
    drawn = []
    for draw in further.draws():
        progress(str(draw))
        drawn.append(draw)
    return drawn


def _known_and_drawn(settings: Settings, progress: Progress) -> list[tuple[str, ...]]:
    """Return `ROBOTS` and the robots drawn by lot, or those that the settings name."""
    return [settings.robots] if settings.robots else [tuple(ROBOTS), further.accepted(_drawn(progress))]


def _origin(own: Outcome | scenes.SceneOutcome) -> str:
    """Return whether the estimator was made with the robot of an outcome, or it was drawn by lot."""
    return KNOWN if own.robot in ROBOTS else DRAWN


def _evaluate(
    settings: Settings,
    robots: Iterable[str],
    tiers: Iterable[str],
    methods: Mapping[str, Method],
    progress: Progress,
    configurations: int = CONFIGURATIONS,
) -> list[Outcome]:
    chosen = models(settings.samples, settings.robots or robots)
    cases = tier_cases(chosen, settings.tiers or tiers, settings.configurations or configurations)
    return evaluate(cases, methods, settings.threads, progress)


def models(folder: Path, names: Iterable[str]) -> Iterator[tuple[str, ArticulatedModel]]:
    """Yield sample models in `folder` and robots of the wheel by name, other models by their URDF file."""
    samples = sample_names(folder)
    for name in names:
        if name.endswith(".urdf"):
            yield Path(name).stem, ArticulatedModel.from_urdf(name)
            continue
        if name not in samples:
            _check_robot(name, folder, samples)
        yield name, load_sample(folder, name) if name in samples else load_robot(name)


def _check_robot(name: str, folder: Path, samples: Iterable[str]) -> None:
    """Raise `UnknownNameError` that says where a model was looked for."""
    try:
        robots = wheel_robots()
    except DependencyError:
        if name in ROBOTS:
            raise
        robots = {}
    if name not in robots:
        where = f"sample model in {folder.absolute()} (another folder: --samples DIR) or robot of example-robot-data"
        raise UnknownNameError(where, name, [*samples, *robots])


def _gap_cases(settings: Settings) -> Iterator[tuple[ArticulatedModel, Case]]:
    """Yield a case per robot and tier; with all robots also the sample scans: mimic joints and slides."""
    for robot, model in models(settings.samples, settings.robots or ROBOTS):
        for tier in settings.tiers or GAP_TIERS:
            yield model, simulated_case(model, robot, tier, 0)
    if settings.robots is None:
        for name in sample_names(settings.samples):
            model = load_sample(settings.samples, name)
            for case in sample_cases(model, settings.samples, name):
                yield model, case
