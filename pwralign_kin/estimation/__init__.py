"""From model and scan to `Estimate`."""

from pwralign_kin.estimation.correspondences import Correspondences, FpfhMatcher, Matcher
from pwralign_kin.estimation.estimate import Alternative, Estimate, PartEstimate
from pwralign_kin.estimation.estimator import estimate
from pwralign_kin.estimation.options import EstimatorOptions

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
