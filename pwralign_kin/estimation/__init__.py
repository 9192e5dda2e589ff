"""From model and scan to `Estimate`."""

from pwralign_kin.estimation.comparison.search_options import SearchOptions
from pwralign_kin.estimation.entry import calibrate, estimate
from pwralign_kin.estimation.evidence.evidence import Evidence
from pwralign_kin.estimation.knowledge.correspondences import Correspondences, FpfhMatcher
from pwralign_kin.estimation.knowledge.prior import BasePrior
from pwralign_kin.estimation.options import EstimatorOptions
from pwralign_kin.estimation.result import Alternative, Estimate, PartEstimate
from pwralign_kin.estimation.shared_base.result import SharedBaseEstimate

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
