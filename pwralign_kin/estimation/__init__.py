"""From model and scan to `Estimate`."""

from pwralign_kin.estimation.correspondences import Correspondences, FpfhMatcher
from pwralign_kin.estimation.entry import calibrate, estimate
from pwralign_kin.estimation.evidence import Evidence
from pwralign_kin.estimation.options import EstimatorOptions
from pwralign_kin.estimation.prior import BasePrior
from pwralign_kin.estimation.result import Alternative, Estimate, PartEstimate
from pwralign_kin.estimation.shared_base import SharedBaseEstimate
from pwralign_kin.estimation.tree_search import SearchOptions

__all__ = [
    "Alternative",
    "BasePrior",
    "Correspondences",
    "Estimate",
    "EstimatorOptions",
    "Evidence",
    "FpfhMatcher",
    "PartEstimate",
    "SearchOptions",
    "SharedBaseEstimate",
    "calibrate",
    "estimate",
]
