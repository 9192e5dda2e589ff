"""The base that most of the scans agree on, each of which was searched on its own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pwralign_kin import se3
from pwralign_kin.estimation.comparison.candidates import Candidates
from pwralign_kin.estimation.comparison.ranking import ranked
from pwralign_kin.estimation.estimator import Estimator
from pwralign_kin.estimation.knowledge.prior import LEAST_STD, SearchPrior, placement_in_root
from pwralign_kin.estimation.options import EstimatorOptions
from pwralign_kin.estimation.sensing.observation import Observation
from pwralign_kin.estimation.stages import SearchedScan
from pwralign_kin.model import ArticulatedModel
from pwralign_kin.se3 import Array

PULL_TURN, PULL_DISTANCE = 0.05, 0.02
"""Standard deviations (rad, model diagonals) of another scan's base as a prior: single scans tell it no better."""
CONTRADICTION = 0.1
"""Share of its score that a scan loses under a base that it contradicts."""
TRIED = 6
"""Most bases that are tried on all scans, ..."""
SEARCHED_AGAIN = 2
"""... and most for which the scans that contradict them are searched again."""
WIDE_SIGMA, FINE_SIGMA = 0.03, 0.012
"""Robust scales (model diagonals) that scans follow another scan's base with."""


@dataclass(frozen=True)
class Consensus:
    """Searches that agree on one base."""

    scans: list[SearchedScan]
    """One a scan, searched again where it had contradicted the base."""
    starts: list[Candidates]
    """Of each scan its one configuration at the common base, in its own search units."""
    outvoted: tuple[int, ...]
    """Scans that on their own had found another base."""

    @property
    def score(self) -> float:
        """How well the base serves all scans."""
        return _total(self.starts)


def consensus(model: ArticulatedModel, alone: list[SearchedScan], options: Sequence[EstimatorOptions]) -> Consensus:
    """Return the base that serves all scans best, each of which was searched `alone`.

    Every scan offers the base of its best answer; the others follow as far as their points let them, and those that
    cannot are searched again with that base known.
    """
    offered = _offered(alone, model.diagonal)
    pulled = [[_pulled(searched, searched.finished, base) for searched in alone] for base in offered]
    best: Consensus | None = None
    for choice in np.argsort([-_total(starts) for starts in pulled], kind="stable")[:SEARCHED_AGAIN]:
        agreed = _agreed(model, alone, options, offered[choice], pulled[choice])
        if best is None or agreed.score > best.score:
            best = agreed
        if not agreed.outvoted:
            break
    assert best is not None
    return best


def _offered(alone: list[SearchedScan], diagonal: float) -> list[Array]:
    """Return the bases (4, 4) in the common frame of the best answers, those that fit best first."""
    offered: list[Array] = []
    for i in np.argsort([-searched.finished.scores[0] for searched in alone], kind="stable"):
        base = _observation(alone[i]).to_scan(alone[i].finished.bases[0])
        if len(offered) < TRIED and all(_apart(base, other, diagonal) for other in offered):
            offered.append(base)
    return offered


def _agreed(
    model: ArticulatedModel,
    alone: list[SearchedScan],
    options: Sequence[EstimatorOptions],
    base: Array,
    pulled: list[Candidates],
) -> Consensus:
    """Return what the scans make of a base that they were `pulled` to: those that contradict it are searched again."""
    scans, starts, outvoted = list(alone), list(pulled), []
    for i, (first, start) in enumerate(zip(alone, pulled, strict=True)):
        if start.scores[0] >= (1 - CONTRADICTION) * first.finished.scores[0]:
            continue
        outvoted.append(i)
        again = Estimator(model, _with_base(model, options[i], base)).searched(first.scan, None, None)
        scans[i] = again.knowing(first.solver.comparison.known)
        found = _pulled(scans[i], scans[i].finished, base)
        # Another search may take the view to have holes: both are compared by the first one's scores.
        starts[i] = max(start, _pulled(first, found, base), key=lambda one: one.scores[0])
    return Consensus(scans, starts, tuple(outvoted))


def known_base(searched: SearchedScan, base: Array, translation_std: float, rotation_std: float) -> SearchPrior:
    """Return what a search knows, with its base known to these standard deviations (all in search units)."""
    return replace(
        searched.solver.comparison.known,
        placement=base,
        translation_std=max(translation_std, LEAST_STD),
        rotation_std=max(rotation_std, LEAST_STD),
        held=translation_std == 0,
    )


def _observation(searched: SearchedScan) -> Observation:
    return searched.solver.comparison.observation


def _total(starts: list[Candidates]) -> float:
    return sum(float(start.scores[0]) for start in starts)


def _apart(one: Array, other: Array, diagonal: float) -> bool:
    """Return whether two bases are farther apart than a single scan's doubt."""
    turn = se3.rotation_angle(one[:3, :3].T @ other[:3, :3])
    return bool(turn > PULL_TURN or np.linalg.norm(one[:3, 3] - other[:3, 3]) > PULL_DISTANCE * diagonal)


def _pulled(searched: SearchedScan, candidates: Candidates, base: Array) -> Candidates:
    """Return the best of the candidates after its base was pulled to another one and the joints gave way."""
    known = known_base(searched, _observation(searched).to_search(base), PULL_DISTANCE, PULL_TURN)
    comparison = searched.solver.comparison.knowing(known)
    wide = comparison.refined(candidates, iterations=20, sigma=WIDE_SIGMA)
    fine = comparison.refined(wide, points=comparison.options.fine_points, iterations=15, sigma=FINE_SIGMA)
    return ranked(comparison, fine).take([0])


def _with_base(model: ArticulatedModel, options: EstimatorOptions, base: Array) -> EstimatorOptions:
    """Return the options with the root link's placement known about as well as one scan tells it."""
    known = replace(
        options.base,
        T_scan_base=base @ placement_in_root(model, options.base.base_link),
        translation_std=PULL_DISTANCE * model.diagonal,
        rotation_std=PULL_TURN,
    )
    return replace(options, base=known)
