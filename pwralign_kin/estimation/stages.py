"""What the stages of an estimate hand to each other."""

from __future__ import annotations

from dataclasses import dataclass, replace

from pwralign_kin.arrays import Bools, Singles
from pwralign_kin.estimation.comparison.candidates import Candidates
from pwralign_kin.estimation.doubt.observability import Doubt
from pwralign_kin.estimation.evidence.evidence import Evidence
from pwralign_kin.estimation.knowledge.correspondences import Correspondences
from pwralign_kin.estimation.knowledge.prior import SearchPrior
from pwralign_kin.estimation.refinement.joint_least_squares import JointLeastSquares
from pwralign_kin.estimation.refinement.problem import Solution
from pwralign_kin.estimation.refinement.view import View
from pwralign_kin.estimation.stopwatch import Stopwatch
from pwralign_kin.scan import Scan
from pwralign_kin.se3 import Array
from pwralign_kin.state import State


@dataclass(frozen=True)
class Suppositions:
    """What a scan is taken to show for the length of one search, though nobody told."""

    surroundings: Bools | None = None
    """(n,) Points of the scan that are of something else: with them, it is a scene."""
    turned: Bools | None = None
    """(m,) Prepared points that are of the other side of their surface."""
    borders: Singles | None = None
    """(b, 3) Where the picture of a view ends: outward unit normals of planes through the sensor."""
    start: State | None = None
    """An answer to search about that nobody knows to be near: unlike a guess, it is no prior."""


NOTHING_SUPPOSED = Suppositions()


@dataclass(frozen=True)
class SearchedScan:
    """One scan searched: the state of an estimate before the joint least squares."""

    scan: Scan
    initial: State | None
    """The guess that it was searched from, if any."""
    correspondences: Correspondences | None
    """Those of an outside matcher that it was searched with, if any."""
    solver: JointLeastSquares
    finished: Candidates
    """Distinct answers, best first."""
    prior: Array
    """(k,) values in search units that joints keep where the scan does not tell."""
    watch: Stopwatch

    def knowing(self, known: SearchPrior) -> SearchedScan:
        """Return the same, judged from here on by another prior of base and joints."""
        return replace(self, solver=self.solver.knowing(known))

    def seeing(self, view: View) -> SearchedScan:
        """Return the same with what its image told near an answer."""
        return replace(self, solver=self.solver.seeing(view))


@dataclass(frozen=True)
class Judged:
    """An answer, what the scan does not tell of it, and what speaks for and against it."""

    solution: Solution
    doubt: Doubt
    evidence: Evidence
