"""Several scans of one model that does not move from its place: one base placement, joint values per scan.

Every scan is searched on its own. The base that most of the answers agree on wins; scans that found another one are
searched again with that base known. Then one least-squares problem over the base and the joints of all scans.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from pwralign_kin.estimation.comparison.candidates import Candidates
from pwralign_kin.estimation.comparison.continuation import priced
from pwralign_kin.estimation.comparison.ranking import ranks
from pwralign_kin.estimation.estimator import Estimator, warn_of_size
from pwralign_kin.estimation.knowledge.correspondences import Correspondences
from pwralign_kin.estimation.options import EstimatorOptions
from pwralign_kin.estimation.refinement.problem import Solution
from pwralign_kin.estimation.shared_base.consensus import consensus, known_base
from pwralign_kin.estimation.shared_base.covariance import with_base_covariance
from pwralign_kin.estimation.shared_base.joint_offsets import joint_offsets
from pwralign_kin.estimation.shared_base.result import SharedBaseEstimate
from pwralign_kin.estimation.shared_base.shared_least_squares import SharedLeastSquares
from pwralign_kin.estimation.stages import SearchedScan
from pwralign_kin.exceptions import ArgumentError
from pwralign_kin.model import ArticulatedModel
from pwralign_kin.scan import Scan, warn_of_rounding
from pwralign_kin.state import State


def estimate_shared_base(
    model: ArticulatedModel,
    scans: Sequence[Scan],
    initials: Sequence[State | None],
    correspondences: Sequence[Correspondences | None],
    options: Sequence[EstimatorOptions],
    progress: Callable[[str], None] | None = None,
) -> SharedBaseEstimate:
    """Return the estimate of one base and the joints of every scan; everything else is given one a scan.

    The options' joint priors and locks may differ, what they know of the base may not. Raises `ArgumentError` when
    there are no scans, and what `Estimator` raises.
    """
    if not scans:
        raise ArgumentError("scan", "a Scan or several", "none")
    alone = []
    for i, (scan, guess, pairs, own) in enumerate(zip(scans, initials, correspondences, options, strict=True)):
        warn_of_rounding(scan, model.diagonal)
        alone.append(Estimator(model, own, _numbered(progress, i)).searched(scan, guess, pairs))
    if progress is not None:
        progress("consensus")
    agreed = consensus(model, alone, options)
    if progress is not None:
        progress("joint least squares")
    solved = SharedLeastSquares([searched.solver for searched in agreed.scans]).run(agreed.starts)
    together = [
        searched.knowing(known_base(searched, solution.base, 0.0, 0.0)).seeing(solution.view)
        for searched, solution in zip(agreed.scans, solved.solutions, strict=True)
    ]
    estimates = []
    for own, searched, solution in zip(options, together, solved.solutions, strict=True):
        held = replace(searched, finished=_with_base_held(searched, solution))
        estimate = Estimator(model, own).concluded(held, solution)
        warn_of_size(searched.scan, estimate)
        estimates.append(with_base_covariance(estimate, searched, solution, solved.base_covariance))
    scale = np.r_[np.ones(3), np.full(3, model.diagonal)]
    return SharedBaseEstimate(
        T_scan_base=estimates[0].state.T_scan_base,
        base_link=model.root_link,
        base_covariance=solved.base_covariance * np.outer(scale, scale),
        estimates=tuple(estimates),
        outvoted=agreed.outvoted,
        converged=solved.converged,
        iterations=solved.iterations,
        offsets=joint_offsets([searched.solver for searched in together], solved.solutions),
    )


def _with_base_held(searched: SearchedScan, solution: Solution) -> Candidates:
    """Return the solution, and behind it what the search of a scan ended with, refined with the base held where all
    scans have it.

    An answer with another base, which fits one scan better for its sensor's errors, is no rival of the common one.
    """
    comparison, found = searched.solver.comparison, searched.finished
    bases = np.repeat(solution.base[None], len(found), axis=0)
    held = comparison.refined(Candidates(bases, found.values, found.scores))
    held.bases[:] = solution.base
    several = Candidates.concatenate([solution.configuration, held])
    scored = priced(comparison, several.with_scores(ranks(comparison, several)))
    return Candidates.concatenate([scored.take([0]), scored.take(slice(1, None)).best_first()])


def _numbered(progress: Callable[[str], None] | None, scan: int) -> Callable[[str], None] | None:
    return None if progress is None else lambda stage: progress(f"scan {scan}: {stage}")
