"""From model and scan to `Estimate`."""

from pwralign_kin.estimation.correspondences import Correspondences, FpfhMatcher, Matcher
from pwralign_kin.estimation.estimator import estimate
from pwralign_kin.estimation.options import EstimatorOptions
from pwralign_kin.estimation.result import Alternative, Estimate, PartEstimate

__all__ = [
    "Alternative",
    "Correspondences",
    "Estimate",
    "EstimatorOptions",
    "FpfhMatcher",
    "Matcher",
    "PartEstimate",
    "estimate",
]
