"""Whether doubt is honest: confidence against overlays, standard deviations against joint errors."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence

import numpy as np

from pwralign_kin.benchmark.evidence import JointDoubt
from pwralign_kin.benchmark.methods import HASTY_NAME
from pwralign_kin.benchmark.pictures import COLOURS, as_png, new_figure, tidy
from pwralign_kin.benchmark.runs import Outcome
from pwralign_kin.benchmark.table import figure, markdown, share
from pwralign_kin.estimation.evidence import confidence
from pwralign_kin.estimation.evidence.evidence import Evidence, logistic
from pwralign_kin.se3 import Array

Groups = Mapping[str, Sequence[Outcome]]

HASTY_WEIGHT = 0.5
"""How much an answer of the hasty search counts in the fit, against one of the search as it comes."""
ROUNDS = 30
"""Of expectation maximisation, enough for the digits shown."""
RIDGE, PRESENCE_RIDGE = 1.0, 0.1
"""Inverse variance of the coefficients before any answer is looked at; scans of something else are nearly all told."""

BINS = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0)
SURE = 0.9


def confidence_table(groups: Groups) -> str:
    """Return how well confidence tells right answers from wrong ones, by group."""
    heads = [
        "cases", " number", " overlay right", " AUROC", f" confidence of {SURE} or more", " of these right",
        " confidence below 0.5", " of these right", " calibration error",
    ]  # fmt: skip
    rows = []
    for name, outcomes in groups.items():
        right = [own.score.overlay for own in outcomes]
        sure = [own.score.overlay for own in outcomes if own.confidence >= SURE]
        unsure = [own.score.overlay for own in outcomes if own.confidence < 0.5]
        rows.append(
            [
                name, str(len(right)), share(right), figure(auroc([o.confidence for o in outcomes], right), digits=3),
                str(len(sure)), share(sure), str(len(unsure)), share(unsure), figure(calibration_error(outcomes)),
            ]
        )  # fmt: skip
    return markdown(heads, rows)


def doubt_table(groups: Groups) -> str:
    """Return how honest standard deviations and undetermined joints are, over all successes of each group."""
    heads = [
        "successes", " joints called determined", " truth within 1 std", " within 2", " within 3",
        " of these that the scan can tell: within 2", " joints that the scan can tell", " of these called determined",
    ]  # fmt: skip
    rows = []
    for name, outcomes in groups.items():
        joints = [joint for own in outcomes if own.score.success for joint in own.joints]
        determined = [joint for joint in joints if joint.determined]
        told = [joint for joint in joints if joint.told]
        rows.append(
            [
                name, str(len(determined)), *(within(determined, stds) for stds in (1, 2, 3)),
                within([joint for joint in determined if joint.told], 2),
                str(len(told)), share([joint.determined for joint in told]),
            ]
        )  # fmt: skip
    return markdown(heads, rows)


def reliability_table(groups: Groups) -> str:
    """Return the share of right answers by confidence."""
    heads = ["confidence", *(f" {column}" for name in groups for column in (f"{name}: mean", "right"))]
    bins = {name: reliability(outcomes) for name, outcomes in groups.items()}
    rows = []
    for index, (low, high) in enumerate(itertools.pairwise(BINS)):
        cells = []
        for name in groups:
            mean, right = bins[name][index]
            cells += [figure(mean), share(right)]
        rows.append([f"{low:.1f} to {high:.1f}", *cells])
    return markdown(heads, rows)


def within(joints: Sequence[JointDoubt], stds: float) -> str:
    """Return the share of joints whose truth is no farther than so many standard deviations."""
    return share([joint.error <= stds * joint.std for joint in joints])


def reliability(outcomes: Sequence[Outcome]) -> list[tuple[float, list[bool]]]:
    """Return the mean confidence and the verdicts of each bin of confidence."""
    place = np.digitize([own.confidence for own in outcomes], BINS[1:-1])
    bins = []
    for index in range(len(BINS) - 1):
        own = [outcome for outcome, bin_index in zip(outcomes, place, strict=True) if bin_index == index]
        mean = float(np.mean([outcome.confidence for outcome in own])) if own else float("nan")
        bins.append((mean, [outcome.score.overlay for outcome in own]))
    return bins


def calibration_error(outcomes: Sequence[Outcome]) -> float:
    """Return the mean distance of confidence and share of right answers over the bins, weighted by their sizes."""
    gaps = [len(right) * abs(mean - float(np.mean(right))) for mean, right in reliability(outcomes) if right]
    return float(sum(gaps) / max(len(outcomes), 1))


def auroc(confidences: Sequence[float], right: Sequence[bool]) -> float:
    """Return the chance that a right answer has more confidence than a wrong one, ties by half; NaN without both."""
    values, verdicts = np.asarray(confidences, float), np.asarray(right, bool)
    above = np.sign(values[verdicts][:, None] - values[~verdicts][None])
    return float(0.5 + 0.5 * above.mean()) if above.size else float("nan")


def fitted(outcomes: Sequence[Outcome], present: Array) -> Array:
    """Return intercept and coefficients (7,) of what tells right answers from wrong ones, the model being there.

    It is the product with the chance of being there, by the coefficients `present`, that is to be right as often as it
    says: expectation maximisation tells how far answers are wrong for what the one does not know or the other. What
    fades a confidence besides is left out.
    """
    evidence = [_evidence(own) for own in outcomes]
    values = [confidence.features(own) for own in evidence]
    there = np.array([logistic(tuple(present), confidence.presence_features(own)) for own in evidence])
    right = np.array([own.score.overlay for own in outcomes], float)
    weights = np.where([own.method == HASTY_NAME for own in outcomes], HASTY_WEIGHT, 1.0)
    blamed = np.ones(len(outcomes))
    for _ in range(ROUNDS):
        coefficients = _logistic_regression(values, right, weights * blamed, RIDGE)
        chance = np.array([logistic(tuple(coefficients), own) for own in values])
        blamed = np.where(right, 1.0, there * (1.0 - chance) / (1.0 - there * chance))
    return coefficients


def fitted_presence(outcomes: Sequence[Outcome], elsewhere: Sequence[Outcome]) -> Array:
    """Return intercept and coefficients (8,) of what tells scans of the model from those it is not in, `elsewhere`."""
    values = [confidence.presence_features(_evidence(own)) for own in (*outcomes, *elsewhere)]
    there = np.repeat([1.0, 0.0], [len(outcomes), len(elsewhere)])
    return _logistic_regression(values, there, np.ones(len(there)), PRESENCE_RIDGE)


def _logistic_regression(values: Sequence[Array], verdicts: Array, weights: Array, least: float) -> Array:
    """Return intercept and coefficients by Newton's method, with ridge."""
    centre = np.mean(values, axis=0)  # steps from 0 lead astray where values are all far from it
    X = np.column_stack([np.ones(len(values)), np.array(values) - centre])
    ridge = least * np.diag([0.0, *np.ones(X.shape[1] - 1)])
    coefficients = np.zeros(X.shape[1])
    for _ in range(50):
        chance = 1.0 / (1.0 + np.exp(-X @ coefficients))
        H = (X * (weights * chance * (1.0 - chance))[:, None]).T @ X + ridge + 1e-9 * np.eye(len(ridge))
        step = np.linalg.solve(H, X.T @ (weights * (verdicts - chance)) - ridge @ coefficients)
        coefficients += np.clip(step, -2.0, 2.0)
    return np.append(coefficients[0] - centre @ coefficients[1:], coefficients[1:])


def coefficients_table(outcomes: Sequence[Outcome], elsewhere: Sequence[Outcome]) -> str:
    """Return the coefficients fitted to the outcomes, and to those of scans without the model, beside those in use,
    and as they are written down there."""
    names = (
        "present: intercept", "unlike and little alike", "shown", "distinct", "continued", "refuted",
        "another size", "ahead",
        "right: intercept", "nearby", "lacking", "uneven", "told", "few points", "ahead",
    )  # fmt: skip
    present = fitted_presence(outcomes, elsewhere)
    found = np.concatenate([present, fitted(outcomes, present)])
    in_use = (*confidence.PRESENT, *confidence.RIGHT)
    rows = [[name, f"{own:.2f}", f"{used:.2f}"] for name, own, used in zip(names, found, in_use, strict=True)]
    fits = {"PRESENT": found[: len(present)], "RIGHT": found[len(present) :]}
    lines = (f"    {name} = ({', '.join(str(round(float(own), 2)) for own in fit)})" for name, fit in fits.items())
    pasted = "\n".join(["For `pwralign_kin/estimation/evidence/confidence.py`:", "", *lines, ""])
    return markdown(["coefficient of", " fitted", " in use"], rows) + "\n" + pasted


def foreign_table(outcomes: Sequence[Outcome]) -> str:
    """Return how much confidence scans of something else are given, by what they are of."""
    heads = ["something else", " number", " median confidence", " largest", " more than 0.2", " more than 0.5"]
    whats = sorted({own.tier.partition(",")[0] for own in outcomes})
    rows = []
    for what in [*whats, "all"]:
        given = np.array([own.confidence for own in outcomes if what in ("all", own.tier.partition(",")[0])])
        over = (str(int((given > limit).sum())) for limit in (0.2, 0.5))
        rows.append([what, str(len(given)), figure(float(np.median(given))), figure(float(given.max())), *over])
    return markdown(heads, rows)


def _evidence(outcome: Outcome) -> Evidence:
    return Evidence(**{name: outcome.evidence[name] for name in Evidence.__dataclass_fields__})


def reliability_diagram(groups: Groups) -> bytes:
    """Return a PNG: share of right answers against confidence, and how many answers have which confidence."""
    picture = new_figure(5.2, 5.6)
    upper, lower = picture.subplots(2, 1, height_ratios=(3, 1), sharex=True)
    upper.plot([0, 1], [0, 1], color="0.75", linewidth=1, label="perfectly calibrated")
    for colour, marker, (name, outcomes) in zip(COLOURS, "osD^v", groups.items(), strict=False):
        points = filled(reliability(outcomes))
        means, sizes = [mean for mean, _ in points], [20 + 6 * np.sqrt(len(right)) for _, right in points]
        low, middle, high = zip(*(_wilson(right) for _, right in points), strict=True)
        spread = np.abs(np.array([low, high]) - middle)
        upper.errorbar(means, middle, yerr=spread, color=colour, linestyle="none", capsize=2, linewidth=1)
        upper.scatter(means, middle, sizes, color=colour, marker=marker, alpha=0.85, linewidths=0, label=name)
    names = list(groups)
    confidences = [[own.confidence for own in groups[name]] for name in names]
    lower.hist(confidences, bins=list(BINS), label=names, color=COLOURS[: len(names)])
    upper.set(ylabel="share of right overlays", ylim=(-0.03, 1.05), title="Reliability of the confidence")
    lower.set(xlabel="confidence", ylabel="answers", xlim=(0, 1.02), yscale="log")
    lower.set_ylim(bottom=0.5)
    upper.legend(loc="upper left", frameon=False)
    for axes in (upper, lower):
        tidy(axes)
    return as_png(picture)


def filled(bins: Sequence[tuple[float, list[bool]]], least: int = 10) -> list[tuple[float, list[bool]]]:
    """Return the bins of `reliability`, neighbours taken together until each holds `least` answers or all there are."""
    kept: list[tuple[float, list[bool]]] = []
    for mean, right in bins:
        if not right:
            continue
        if kept and len(kept[-1][1]) < least:
            mean, right = _together(kept.pop(), (mean, right))
        kept.append((mean, right))
    if len(kept) > 1 and len(kept[-1][1]) < least:
        last = kept.pop()
        kept.append(_together(kept.pop(), last))
    return kept


def _together(one: tuple[float, list[bool]], two: tuple[float, list[bool]]) -> tuple[float, list[bool]]:
    counts = [len(right) for _, right in (one, two)]
    return float(np.average([one[0], two[0]], weights=counts)), [*one[1], *two[1]]


def _wilson(right: Sequence[bool], z: float = 1.0) -> Array:
    """Return lower end, share, and upper end of the Wilson score interval (Wilson, 1927)."""
    count, p = len(right), float(np.mean(right))
    middle = (p + z**2 / (2 * count)) / (1 + z**2 / count)
    half = z * np.sqrt(p * (1 - p) / count + z**2 / (4 * count**2)) / (1 + z**2 / count)
    return np.array([min(middle - half, p), p, max(middle + half, p)])
