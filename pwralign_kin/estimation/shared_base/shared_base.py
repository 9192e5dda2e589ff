"""Several scans of one model that does not move from its place: one base placement, joint values per scan.

Every scan is searched on its own. The base that most of the answers agree on wins; scans that found another one are
searched again with that base known. Then one least-squares problem over the base and the joints of all scans: its
normal matrix has the shape of an arrow, a block per scan that only the base's rows connect.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pwralign_kin import se3
from pwralign_kin.estimation.answers.ranking import ranked
from pwralign_kin.estimation.doubt.uncertainty import inverse_covariance, observed_errors
from pwralign_kin.estimation.estimator import Estimator, warn_of_size
from pwralign_kin.estimation.knowledge.correspondences import Correspondences
from pwralign_kin.estimation.knowledge.prior import LEAST_STD, SearchPrior, placement_in_root
from pwralign_kin.estimation.options import EstimatorOptions
from pwralign_kin.estimation.refinement.joint_least_squares import JointLeastSquares, Problem, Solution, bounded_step
from pwralign_kin.estimation.result import Estimate, millimetres, shown
from pwralign_kin.estimation.search.candidates import Candidates
from pwralign_kin.estimation.sensing.observation import Observation
from pwralign_kin.estimation.shared_base.joint_offsets import JointOffsets, joint_offsets
from pwralign_kin.estimation.stages import SearchedScan
from pwralign_kin.exceptions import ArgumentError
from pwralign_kin.model import ArticulatedModel
from pwralign_kin.read_only import ReadOnly
from pwralign_kin.scan import Scan, warn_of_rounding
from pwralign_kin.se3 import Array
from pwralign_kin.state import State

logger = logging.getLogger(__name__)

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


@dataclass(frozen=True, eq=False)
class SharedBaseEstimate(ReadOnly):
    """What `estimate` of several scans and `calibrate` return."""

    T_scan_base: Array
    """(4, 4) placement of the root link in the frame that all scans share, m."""
    base_link: str
    """The root link."""
    base_covariance: Array
    """(6, 6) covariance of the base twist (rotation, translation; rad and m, scan frame axes, about the base's
    origin); joints that are not locked are free to follow the base."""
    estimates: tuple[Estimate, ...]
    """One estimate a scan, in the order given; all have the same base."""
    outvoted: tuple[int, ...]
    """Scans that on their own had found another base."""
    converged: bool
    """Whether the joint least squares met its step tolerance."""
    iterations: int
    """Iterations of the joint least squares."""
    offsets: JointOffsets
    """How far joints that were given in all scans lie from their values, as the scans tell."""

    @property
    def confidence(self) -> float:
        """In [0, 1]: the median confidence of the scans."""
        return float(np.median([e.confidence for e in self.estimates]))

    @property
    def rotation_std(self) -> float:
        """Standard deviation of the base's rotation, rad: root of the summed variances about the three axes."""
        return float(np.sqrt(np.trace(self.base_covariance[:3, :3])))

    @property
    def translation_std(self) -> float:
        """Standard deviation of the base's position, m: root of the summed variances along the three axes."""
        return float(np.sqrt(np.trace(self.base_covariance[3:, 3:])))

    @property
    def contradicted(self) -> list[str]:
        """A line for every joint value that was given and that the scans contradict; then the base is wrong, too."""
        units = self.estimates[0].units
        return [
            f"{'all scans' if scan is None else f'scan {scan}'}: {name} seems {shown(offset.value, units[name], 0, 2)} "
            f"off its given value, +- {shown(offset.std, units[name], 0, 2)}"
            for scan, name, offset in self.offsets.large()
        ]

    def to_dict(self) -> dict[str, Any]:
        """Return a JSON-ready summary; options that all estimates share are not repeated in each."""
        each = [estimate.to_dict() for estimate in self.estimates]
        first, *others = (own["options"] for own in each)
        shared = {name: value for name, value in first.items() if all(own.get(name) == value for own in others)}
        for own in each:
            own["options"] = {name: value for name, value in own["options"].items() if name not in shared}
        return {
            "base_link": self.base_link,
            "T_scan_base": self.T_scan_base.tolist(),
            "base_covariance": self.base_covariance.tolist(),
            "confidence": self.confidence,
            "outvoted": list(self.outvoted),
            "converged": self.converged,
            "iterations": self.iterations,
            "joint_offsets": asdict(self.offsets),
            "options": shared,
            "estimates": each,
        }

    def __repr__(self) -> str:
        """Return one line: how sure the base is, and the base. `print` shows a line a scan."""
        base = f"{self.base_link}: {se3.placement_text(self.T_scan_base, 4)}"
        return f"SharedBaseEstimate({len(self.estimates)} scans, confidence {self.confidence:.2f}; {base})"

    def __str__(self) -> str:
        """Return the base, and a line a scan."""
        lines = [
            f"base link {self.base_link}: {se3.placement_text(self.T_scan_base, 5)}",
            f"standard deviation {1e3 * self.translation_std:.2f} mm, {np.degrees(self.rotation_std):.3f} deg   "
            f"confidence {self.confidence:.2f}",
            "",
            "scan  confidence  coverage  support  inlier RMSE  undetermined",
        ]
        for i, e in enumerate(self.estimates):
            lines.append(
                f"{i:4d}  {e.confidence:10.2f}  {e.scan_coverage:8.1%}  {e.model_support:7.1%}  "
                f"{millimetres(e.inlier_rmse):>11}  {', '.join(e.undetermined) or '-'}"
                + ("  (alone it had another base)" if i in self.outvoted else "")
            )
        width = max([len("joint"), *map(len, self.estimates[0].state.joints)])
        lines += ["", f"{'joint':{width}}" + "".join(f"{f'scan {i}':>15}" for i in range(len(self.estimates)))]
        for name, unit in self.estimates[0].units.items():
            values = (
                f"{'undetermined':>15}" if name in e.undetermined else shown(e.state.joints[name], unit, 11, 2)
                for e in self.estimates
            )
            lines.append(f"{name:{width}}" + "".join(values).rstrip())
        lines += [""] * any(self.contradicted)
        lines += self.contradicted
        return "\n".join(lines)


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
    fits = []
    for i, (scan, guess, pairs, own) in enumerate(zip(scans, initials, correspondences, options, strict=True)):
        warn_of_rounding(scan, model.diagonal)
        fits.append(Estimator(model, own, _numbered(progress, i)).fit(scan, guess, pairs))
    if progress is not None:
        progress("consensus")
    fits, starts, outvoted = _consensus(model, fits, options)
    if progress is not None:
        progress("joint least squares")
    solved = SharedLeastSquares([fit.solver for fit in fits]).run(starts)
    estimates = []
    for own, fit, solution in zip(options, fits, solved.solutions, strict=True):
        _tell(fit, _known_base(fit, solution.base, 0.0, 0.0))
        estimate = Estimator(model, own).concluded(replace(fit, finished=_with_base_held(fit, solution.base)), solution)
        warn_of_size(fit.scan, estimate)
        estimates.append(_with_base_covariance(estimate, fit, solution, solved.base_covariance))
    scale = np.r_[np.ones(3), np.full(3, model.diagonal)]
    return SharedBaseEstimate(
        estimates[0].state.T_scan_base,
        model.root_link,
        solved.base_covariance * np.outer(scale, scale),
        tuple(estimates),
        outvoted,
        solved.converged,
        solved.iterations,
        joint_offsets([fit.solver for fit in fits], solved.solutions),
    )


def _numbered(progress: Callable[[str], None] | None, scan: int) -> Callable[[str], None] | None:
    return None if progress is None else lambda stage: progress(f"scan {scan}: {stage}")


def _tell(fit: SearchedScan, known: SearchPrior) -> None:
    """Let a search know something else of the base."""
    fit.solver.search.known = known
    known.tell(fit.solver.search.native)


def _known_base(fit: SearchedScan, base: Array, translation_std: float, rotation_std: float) -> SearchPrior:
    """Return what a search knows, with its base known to these standard deviations (all in search units)."""
    return replace(
        fit.solver.search.known,
        placement=base,
        translation_std=max(translation_std, LEAST_STD),
        rotation_std=max(rotation_std, LEAST_STD),
        held=translation_std == 0,
    )


def _consensus(
    model: ArticulatedModel, fits: list[SearchedScan], options: Sequence[EstimatorOptions]
) -> tuple[list[SearchedScan], list[Candidates], tuple[int, ...]]:
    """Return the fits, of each the configuration at the base that serves all scans best, and the outvoted scans.

    Every scan offers the base of its best answer; the others follow as far as their points let them, and those that
    cannot are searched again with that base known.
    """
    alone = np.array([fit.finished.scores[0] for fit in fits])
    offered: list[Array] = []
    for i in np.argsort(-alone, kind="stable"):
        base = _observation(fits[i]).to_scan(fits[i].finished.bases[0])
        if len(offered) < TRIED and all(_apart(base, other, model.diagonal) for other in offered):
            offered.append(base)
    pulled = [[_pulled(fit, fit.finished, base) for fit in fits] for base in offered]
    best: tuple[float, list[SearchedScan], list[Candidates], list[int]] | None = None
    for choice in np.argsort([-_total(starts) for starts in pulled], kind="stable")[:SEARCHED_AGAIN]:
        base, starts, again = offered[choice], pulled[choice], list(fits)
        outvoted = [i for i, start in enumerate(starts) if start.scores[0] < (1 - CONTRADICTION) * alone[i]]
        for i in outvoted:
            again[i] = Estimator(model, _with_base(model, options[i], base)).fit(fits[i].scan, None, None)
            _tell(again[i], fits[i].solver.search.known)
            found = _pulled(again[i], again[i].finished, base)
            # Another search may take the view to have holes: both are compared by the first one's scores.
            starts[i] = max(starts[i], _pulled(fits[i], found, base), key=lambda start: start.scores[0])
        if best is None or _total(starts) > best[0]:
            best = _total(starts), again, starts, outvoted
        if not outvoted:
            break
    assert best is not None
    return best[1], best[2], tuple(best[3])


def _observation(fit: SearchedScan) -> Observation:
    return fit.solver.search.observation


def _total(starts: list[Candidates]) -> float:
    return sum(float(start.scores[0]) for start in starts)


def _apart(one: Array, other: Array, diagonal: float) -> bool:
    """Return whether two bases are farther apart than a single scan's doubt."""
    turn = se3.rotation_angle(one[:3, :3].T @ other[:3, :3])
    return bool(turn > PULL_TURN or np.linalg.norm(one[:3, 3] - other[:3, 3]) > PULL_DISTANCE * diagonal)


def _pulled(fit: SearchedScan, candidates: Candidates, base: Array) -> Candidates:
    """Return the best of the candidates after its base was pulled to another one and the joints gave way."""
    search, known = fit.solver.search, fit.solver.search.known
    _tell(fit, _known_base(fit, _observation(fit).to_search(base), PULL_DISTANCE, PULL_TURN))
    wide = search.refined(candidates, iterations=20, sigma=WIDE_SIGMA)
    fine = search.refined(wide, points=search.options.fine_points, iterations=15, sigma=FINE_SIGMA)
    best = ranked(search, fine).take([0])
    _tell(fit, known)
    return best


def _with_base_held(fit: SearchedScan, base: Array) -> Candidates:
    """Return what the search of a scan ended with, refined with the base held where all scans have it.

    An answer with another base, which fits one scan better for its sensor's errors, is no rival of the common one.
    """
    search, found = fit.solver.search, fit.finished
    held = search.refined(Candidates(np.repeat(base[None], len(found), axis=0), found.values, found.scores))
    held.bases[:] = base
    return search.scored(held)[0].best_first()


def _with_base(model: ArticulatedModel, options: EstimatorOptions, base: Array) -> EstimatorOptions:
    """Return the options with the root link's placement known about as well as one scan tells it."""
    known = replace(
        options.base,
        T_scan_base=base @ placement_in_root(model, options.base.base_link),
        translation_std=PULL_DISTANCE * model.diagonal,
        rotation_std=PULL_TURN,
    )
    return replace(options, base=known)


def _with_base_covariance(
    estimate: Estimate, fit: SearchedScan, solution: Solution, base_covariance: Array
) -> Estimate:
    """Return the estimate with the doubt about the base, and what follows from it for the joints, in its covariance.

    With the base held, its doubt passes to the joints as they follow it: dq/dbase = -H_qq^-1 H_qb.
    """
    names = list(estimate.state.joints)
    unit = np.r_[np.ones(3), np.full(3, _observation(fit).diagonal), fit.solver.model.joint_scales]
    open_ = np.array([name not in estimate.undetermined for name in names], bool) & ~fit.solver.locked
    H = solution.problem.H + solution.problem.prior.H / solution.problem.evidence
    follows = np.zeros((6 + len(names), 6))
    follows[:6] = np.eye(6)
    joints = 6 + np.flatnonzero(open_)
    follows[joints] = -np.linalg.solve(H[np.ix_(joints, joints)] + 1e-9 * np.eye(len(joints)), H[joints, :6])
    own = estimate.covariance.copy()
    own[:6] = own[:, :6] = 0.0
    covariance = own + (follows @ base_covariance @ follows.T) * np.outer(unit, unit)
    std = dict(estimate.std)
    for joint in np.flatnonzero(open_):
        std[names[joint]] = float(np.sqrt(covariance[6 + joint, 6 + joint]))
    return replace(estimate, covariance=covariance, std=std)


@dataclass(frozen=True)
class SharedSolution:
    """The end of the joint least squares, in search units."""

    solutions: tuple[Solution, ...]
    """One a scan; the bases are the same placement in each scan's search frame."""
    base_covariance: Array
    """(6, 6)"""
    converged: bool
    iterations: int


class SharedLeastSquares:
    """One base and the joints of all scans fitted to all scans together."""

    def __init__(self, solvers: Sequence[JointLeastSquares]) -> None:
        """Take the problem of each scan; what they know of the base is counted once, as the first has it."""
        self.solvers = solvers
        self.joints = len(solvers[0].model.joint_names)
        points = np.array([len(solver.search.observation.given) for solver in solvers], float)
        self.shares = points / points.mean()

    def assembled(self, problems: Sequence[Problem]) -> tuple[Array, Array]:
        """Return normal matrix and right-hand side over [base twist, joints of scan 1, joints of scan 2, ...].

        The scans weigh by their points and the scales of their residuals: the result is an inverse covariance.
        """
        k = self.joints
        size = 6 + k * len(problems)
        H, g = np.zeros((size, size)), np.zeros(size)
        for i, (problem, share) in enumerate(zip(problems, self.shares, strict=True)):
            at = self.columns(i)
            prior_H, prior_g = problem.prior.H.copy(), problem.prior.g.copy()
            if i > 0:
                prior_H[:6, :6], prior_g[:6] = 0.0, 0.0
            H[np.ix_(at, at)] += share * problem.evidence * problem.H + prior_H
            g[at] += share * problem.evidence * problem.g + prior_g
        return H, g

    def columns(self, scan: int) -> NDArray[np.int64]:
        """Return where the base and the joints of one scan stand among all unknowns."""
        return np.concatenate([np.arange(6), 6 + scan * self.joints + np.arange(self.joints)])

    def run(self, starts: Sequence[Candidates]) -> SharedSolution:
        """Iterate from one configuration a scan, whose bases may differ a little, to convergence."""
        solvers, options = self.solvers, self.solvers[0].options
        observations = [solver.search.observation for solver in solvers]
        base = _mean([o.to_scan(start.bases[0]) for o, start in zip(observations, starts, strict=True)])
        known = solvers[0].search.known
        if known.held and known.placement is not None:
            base = observations[0].to_scan(known.placement)
        values = [s.limited(start.values[0]) for s, start in zip(solvers, starts, strict=True)]
        bases = [o.to_search(base) for o in observations]
        residuals = [s.residual(b, v) for s, b, v in zip(solvers, bases, values, strict=True)]
        sigmas = [s.robust_scale(residual) for s, residual in zip(solvers, residuals, strict=True)]
        for solver, at, v, residual in zip(solvers, bases, values, residuals, strict=True):
            solver.look(at, v, residual)
        converged, iterations = not options.enabled, 0
        while True:
            bases = [o.to_search(base) for o in observations]
            problems = [s.build(b, v, sigma) for s, b, v, sigma in zip(solvers, bases, values, sigmas, strict=True)]
            if converged or iterations >= options.iterations:
                break
            iterations += 1
            try:
                step = self.solve(problems, values)
            except np.linalg.LinAlgError as error:
                logger.warning("%s: the answer has not converged", error)
                break
            move = se3.exp(step[:6])
            base[:3, :3] = move[:3, :3] @ base[:3, :3]
            base[:3, 3] += move[:3, 3] * observations[0].diagonal
            values = [
                s.limited(v + step[self.columns(i)[6:]]) for i, (s, v) in enumerate(zip(solvers, values, strict=True))
            ]
            converged = bool(np.abs(step).max() < options.tolerance)
        base = se3.orthonormalised(base)
        solutions = tuple(
            Solution(o.to_search(base), v, problem, converged, iterations)
            for o, v, problem in zip(observations, values, problems, strict=True)
        )
        return SharedSolution(solutions, self.base_covariance(bases, values, problems), converged, iterations)

    def solve(self, problems: Sequence[Problem], values: Sequence[Array]) -> Array:
        """Return the bounded step over all unknowns."""
        H, g = self.assembled(problems)
        scale = 1.0 / problems[0].evidence / len(problems)
        bounds = [solver.step_bounds(v) for solver, v in zip(self.solvers, values, strict=True)]
        low = np.concatenate([bounds[0][0][:6], *(low[6:] for low, _ in bounds)])
        high = np.concatenate([bounds[0][1][:6], *(high[6:] for _, high in bounds)])
        return bounded_step(scale * H, scale * g, low, high, self.solvers[0].options.damping)

    def base_covariance(self, bases: Sequence[Array], values: Sequence[Array], problems: Sequence[Problem]) -> Array:
        """Return the base's covariance (6, 6) when all joints are free to follow it.

        The doubt of each scan's joints leaves its inverse covariance as a Schur complement.
        """
        total = np.zeros((6, 6))
        for i, (solver, base, value, problem) in enumerate(zip(self.solvers, bases, values, problems, strict=True)):
            final = Candidates.single(base, value)
            absent = ~solver.search.exists
            errors = observed_errors(solver.search, final, problem)
            H = inverse_covariance(problem, absent, errors, solver.upper - solver.lower)
            if i > 0:
                H[:6, :6] -= problem.prior.H[:6, :6]  # known once
            free = 6 + np.flatnonzero(~solver.locked)
            total += H[:6, :6] - H[:6, free] @ np.linalg.solve(H[np.ix_(free, free)], H[free, :6])
        return np.asarray(np.linalg.inv(total))


def _mean(placements: Sequence[Array]) -> Array:
    """Return the mean of placements (chordal mean of the rotations)."""
    return se3.orthonormalised(np.mean(placements, axis=0))
