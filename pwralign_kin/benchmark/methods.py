"""What is compared: the estimator as it comes, and with one part of it left out or replaced at a time."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType

import numpy as np

from pwralign_kin.benchmark.cases import Case
from pwralign_kin.benchmark.metrics import Reference, Ruler
from pwralign_kin.estimation import Correspondences, Estimate, EstimatorOptions, estimate
from pwralign_kin.estimation.comparison.search_options import SearchOptions
from pwralign_kin.estimation.refinement.joint_least_squares import LeastSquaresOptions
from pwralign_kin.estimation.search.repair import RepairOptions
from pwralign_kin.estimation.search.voting import VoteOptions
from pwralign_kin.se3 import inverse, transform

logger = logging.getLogger(__name__)

Matching = Callable[[Case, Ruler, Reference], Correspondences]


@dataclass(frozen=True)
class Method:
    """A way to estimate."""

    title: str
    """What it is, as the tables say it."""

    options: EstimatorOptions = field(default_factory=EstimatorOptions)
    matching: Matching | None = None
    """Makes the correspondences that the estimate is given."""


@dataclass(frozen=True)
class Answer:
    """What a method makes of a case."""

    estimate: Estimate | None
    """None when it failed."""

    seconds: float
    fault: str
    """Why it failed; empty when it did not."""


DEFAULT = Method("as it comes")

HASTY_NAME = "hasty"
"""How answers of this one are told from those of the estimator as it comes."""

HASTY = Method(
    "few hypotheses, narrow beams, no repair",
    EstimatorOptions(
        repair=RepairOptions(rounds=0),
        search=SearchOptions(root_parts=3, hypotheses_per_part=4, roots=6, refined=4, beam=3, modes=2),
    ),
)
"""Wrong often, and in the way that searches are wrong: what confidence can learn from."""

ABLATIONS: Mapping[str, Method] = MappingProxyType(
    {
        "default": DEFAULT,
        "fpfh": Method("FPFH instead of oriented pairs", EstimatorOptions(sources=("fpfh", "faces"))),
        "pairs+fpfh": Method("FPFH beside oriented pairs", EstimatorOptions(sources=("pairs", "faces", "fpfh"))),
        "no-faces": Method("no hypotheses from flat faces", EstimatorOptions(sources=("pairs",))),
        "no-repair": Method("no repair", EstimatorOptions(repair=RepairOptions(rounds=0))),
        "fpfh-no-repair": Method(
            "no repair, and FPFH instead of oriented pairs",
            EstimatorOptions(sources=("fpfh", "faces"), repair=RepairOptions(rounds=0)),
        ),
        "no-votes": Method("no votes", EstimatorOptions(repair=RepairOptions(votes=VoteOptions(parts=0)))),
        "one-way": Method(
            "score in one direction: scan coverage", EstimatorOptions(search=SearchOptions(two_way=False))
        ),
        "no-least-squares": Method(
            "no CasADi least squares", EstimatorOptions(least_squares=LeastSquaresOptions(enabled=False))
        ),
        "no-bounds": Method(
            "least squares without bounds, clamped afterwards",
            EstimatorOptions(least_squares=LeastSquaresOptions(bounds=False)),
        ),
        "no-outlines": Method(
            "least squares without outlines", EstimatorOptions(least_squares=LeastSquaresOptions(silhouette=False))
        ),
        "fast": Method("effort: fast", EstimatorOptions(effort="fast")),
        "thorough": Method("effort: thorough", EstimatorOptions(effort="thorough")),
    }
)
"""The default, each part of the pipeline off in turn, and other efforts. Repair makes up for poor hypotheses: off
together too."""


def answer(method: Method, case: Case, ruler: Ruler, reference: Reference, threads: int) -> Answer:
    """Run one method on one case; what goes wrong is logged and becomes part of the answer."""
    options = replace(method.options, threads=threads)
    pairs = method.matching(case, ruler, reference) if method.matching else None
    start = time.perf_counter()
    try:
        found = estimate(ruler.model, case.scan, case.guess, pairs, options)
    except Exception as error:  # a benchmark goes on; the failure counts against the method
        logger.exception("%s: %s", case.name, method.title)
        return Answer(None, time.perf_counter() - start, f"{type(error).__name__}: {error}")
    return Answer(found, time.perf_counter() - start, "")


def with_outside_pairs(count: int, wrong: float) -> Method:
    """Return the method that has `count` outside correspondences only, a share `wrong` of them wrong."""

    def match(case: Case, ruler: Ruler, reference: Reference) -> Correspondences:
        return outside_pairs(case, ruler, reference, count, wrong)

    return Method(f"{count} pairs, {wrong:.0%} wrong", EstimatorOptions(sources=()), match)


def outside_pairs(case: Case, ruler: Ruler, reference: Reference, count: int, wrong: float) -> Correspondences:
    """Return pairs of a scan point and its place on the model, a share `wrong` of them torn apart.

    A wrong pair keeps its place on the model and gets any scan point. The same case gives the same pairs.
    """
    random = np.random.default_rng([case.configuration, *case.robot.encode()])
    on_model = np.flatnonzero(case.labels >= 0)
    chosen = random.choice(on_model, min(count, len(on_model)), replace=False)
    target, labels = case.scan.points[chosen], case.labels[chosen]
    at_zero = ruler.model.part_placements(np.zeros(len(ruler.model.joint_names)))
    source = np.empty_like(target)
    for part in np.unique(labels):
        own = labels == part
        local = transform(inverse(reference.placements[part]), target[own])
        source[own] = transform(at_zero[part], ruler.scenes[part].closest(local)[0])
    torn = random.permutation(len(chosen))[: round(wrong * len(chosen))]
    target[torn] = case.scan.points[random.integers(len(case.scan.points), size=len(torn))]
    return Correspondences(source, target, np.ones(len(chosen)))
