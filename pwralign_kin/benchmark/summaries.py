"""Outcomes of methods on cases, summed up as tables."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import TypeVar

import numpy as np

from pwralign_kin.benchmark.methods import ABLATIONS
from pwralign_kin.benchmark.runs import Outcome
from pwralign_kin.benchmark.table import figure, markdown, median, quantile, share

Outcomes = Sequence[Outcome]
AnyOutcome = TypeVar("AnyOutcome")

LEAST_SQUARES = ("default", "no-least-squares", "no-bounds")
"""Methods whose answers differ in the last step only."""


def overlay_table(head: str, outcomes: Outcomes, key: Callable[[Outcome], str]) -> str:
    """Return how many cases are right, how exactly and how fast, in groups by `key` and in all."""
    heads = [
        head, " cases", " success", " overlay", " fine", " part recall", " median error", " time median",
        " time max", " joints median", " joints 90%", " errors",
    ]  # fmt: skip
    rows = []
    for name, own in [*grouped(outcomes, key), ("all", outcomes)]:
        scores, seconds, joints = [o.score for o in own], [o.seconds for o in own], joint_errors(own)
        rows.append(
            [
                name,
                str(len(own)),
                share([score.success for score in scores]),
                share([score.overlay for score in scores]),
                share([score.fine for score in scores]),
                figure(100 * float(np.mean([score.recall for score in scores])), "%", 1),
                figure(100 * median([score.mean_error for score in scores]), "% D"),
                figure(median(seconds), " s"),
                figure(max(seconds), " s"),
                figure(median(joints)),
                figure(quantile(joints, 0.9)),
                str(sum(bool(outcome.fault) for outcome in own)),
            ]
        )
    return markdown(heads, rows)


def determined_table(outcomes: Outcomes) -> str:
    """Return how `undetermined` compares with what the scans can tell by the truth, in successes."""
    heads = [
        "tier", " joints that the scan can tell", " of these called determined", " joints that it cannot",
        " of these called undetermined", " joints called determined: error median", " 90%", " over 5",
    ]  # fmt: skip
    rows = []
    for name, own in [*grouped(outcomes, lambda outcome: outcome.tier), ("all", outcomes)]:
        found = [outcome for outcome in own if outcome.score.success]
        told = [joint not in o.undetermined for o in found for joint in o.told]
        hidden = [joint in o.undetermined for o in found for joint in o.score.joint_errors.keys() - o.told]
        errors = [error for o in found for joint, error in o.score.joint_errors.items() if joint not in o.undetermined]
        rows.append(
            [
                name, str(len(told)), share(told), str(len(hidden)), share(hidden), figure(median(errors)),
                figure(quantile(errors, 0.9)), share([error > 5 for error in errors]),
            ]
        )  # fmt: skip
    return markdown(heads, rows)


def ablation_table(outcomes: Outcomes) -> str:
    """Return what each part of the pipeline is worth.

    Joint errors stand beside those of the default on the same cases: those where both succeed. A method that
    finds the easy cases only would look exact otherwise.
    """
    default = {outcome.case: outcome for outcome in outcomes if outcome.method == "default"}
    heads = [
        "variant", " success", " overlay", " fine", " joints median (default on the same cases)",
        " joints 90% (default on the same cases)", " time median", " time mean",
    ]  # fmt: skip
    rows = []
    for name, own in grouped(outcomes, lambda outcome: outcome.method):
        both = [outcome for outcome in own if outcome.score.success and default[outcome.case].score.success]
        joints, usual = joint_errors(both), joint_errors([default[outcome.case] for outcome in both])
        seconds = [outcome.seconds for outcome in own]
        rows.append(
            [
                ABLATIONS[name].title,
                share([outcome.score.success for outcome in own]),
                share([outcome.score.overlay for outcome in own]),
                share([outcome.score.fine for outcome in own]),
                f"{figure(median(joints), digits=3)} ({figure(median(usual), digits=3)})",
                f"{figure(quantile(joints, 0.9))} ({figure(quantile(usual, 0.9))})",
                figure(median(seconds), " s"),
                figure(float(np.mean(seconds)), " s"),
            ]
        )
    return markdown(heads, rows)


def overlay_by_tier_table(outcomes: Outcomes) -> str:
    """Return the share of overlays of every variant in every tier."""
    tiers = list(dict.fromkeys(outcome.tier for outcome in outcomes))
    rows = []
    for name, own in grouped(outcomes, lambda outcome: outcome.method):
        by_tier = dict(grouped(own, lambda outcome: outcome.tier))
        shares = [share([outcome.score.overlay for outcome in by_tier[tier]]) for tier in tiers]
        rows.append([ABLATIONS[name].title, *shares])
    return markdown(["overlay of variant", *(f" {tier}" for tier in tiers)], rows)


def least_squares_table(outcomes: Outcomes) -> str:
    """Return joint errors with and without the least squares and its bounds, tier by tier.

    Of the cases in which all three succeed. Each cell: median, 90%, and mean part error.
    """
    heads = ["tier", " cases", *(f" {ABLATIONS[name].title}" for name in LEAST_SQUARES)]
    rows = []
    for tier, own in [*grouped(outcomes, lambda outcome: outcome.tier), ("all", outcomes)]:
        methods = [{o.case: o for o in own if o.method == name} for name in LEAST_SQUARES]
        common = [case for case in methods[0] if all(found[case].score.success for found in methods)]
        cells = []
        for found in methods:
            joints = joint_errors([found[case] for case in common])
            parts = [100 * found[case].score.mean_error for case in common]
            cells.append(
                f"{figure(median(joints), digits=3)} / {figure(quantile(joints, 0.9))} / "
                f"{figure(float(np.mean(parts)) if parts else float('nan'), '% D', 3)}"
            )
        rows.append([tier, str(len(common)), *cells])
    return markdown(heads, rows)


def correspondence_table(outcomes: Outcomes) -> str:
    """Return the share of overlays by robot and method, and the time of all methods."""
    methods = list(dict.fromkeys(outcome.method for outcome in outcomes))
    rows = []
    for robot, own in [*grouped(outcomes, lambda outcome: outcome.robot), ("all", outcomes)]:
        overlays = [share([o.score.overlay for o in own if o.method == method]) for method in methods]
        rows.append([robot, *overlays, figure(median([o.seconds for o in own]), " s")])
    return markdown(["robot", *(f" {method}" for method in methods), " time median"], rows)


def grouped(outcomes: Iterable[AnyOutcome], key: Callable[[AnyOutcome], str]) -> list[tuple[str, list[AnyOutcome]]]:
    """Return the outcomes by key, the keys in order of appearance."""
    groups: dict[str, list[AnyOutcome]] = {}
    for outcome in outcomes:
        groups.setdefault(key(outcome), []).append(outcome)
    return list(groups.items())


def joint_errors(outcomes: Iterable[Outcome]) -> list[float]:
    """Return the errors of all joints that the scans can tell, of successes: elsewhere they mean nothing."""
    return [own.score.joint_errors[name] for own in outcomes if own.score.success for name in own.told]
