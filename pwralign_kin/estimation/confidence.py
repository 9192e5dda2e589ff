"""The chance that an answer is right, from the evidence for and against it: fitted to simulated scans."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pwralign_kin.estimation.evidence import Evidence

SURFACE_NOISE, VOLUME_NOISE = 0.025, 0.035
"""Noise (model diagonals) up to which simulated scans were answered right, and from which on points fill a volume."""
PRESENT = (8.23, 9.19, 4.02)
"""Coefficients of 1 and of what tells whether the model is in the scan at all (`presence_features`), ..."""
COEFFICIENTS = (-0.27, -1.34, -0.67, -2.65, 1.35)
"""... and of 1 and of what tells whether an answer is right if it is (`features`):
`pwralign_kin.benchmark.calibration.fitted` to answers of `python scripts/benchmark.py --table confidence`, to scans of
twelve robots and to scans of something else."""


def confidence(evidence: Evidence) -> float:
    """Return the chance in [0, 1] that an answer with this evidence is right.

    It is the chance that the model is in the scan at all, times the chance that the answer is right if it is: two
    logistic regressions. It fades to nothing where the points fill a volume.
    """
    surface = np.clip((VOLUME_NOISE - evidence.noise) / (VOLUME_NOISE - SURFACE_NOISE), 0.0, 1.0)
    present = _logistic(PRESENT, presence_features(evidence))
    return float(surface * present * _logistic(COEFFICIENTS, features(evidence)))


def presence_features(evidence: Evidence) -> NDArray[np.float64]:
    """Return what tells a scan of the model from one of something else (2,).

    Strange points count the more, the less of the model is borne out: masks leak and sensors bend surfaces, and parts
    that a scan lacks bear nothing out, but neither does both.
    """
    borne_out = np.clip(evidence.borne_out, 0.05, 0.5)
    strange = 3.0 * np.sqrt(min(evidence.strange, 0.3))
    return np.array([strange * np.log(borne_out / 0.5), np.log(min(borne_out, 0.3))])


def features(evidence: Evidence) -> NDArray[np.float64]:
    """Return what tells a right answer from a wrong one (4,): logarithms, for the first doubts weigh most, within the
    range that simulated scans tell apart."""
    return np.array(
        [
            np.log(min(evidence.nearby, 0.05) + 0.005),
            np.log(evidence.lacking + 0.01),
            np.log(np.clip(evidence.uneven, 0.8, 3.0)),
            np.log(np.clip(evidence.margin, -0.004, 0.1) + 0.006),
        ]
    )


def _logistic(coefficients: tuple[float, ...], values: NDArray[np.float64]) -> float:
    return float(1.0 / (1.0 + np.exp(-(coefficients[0] + values @ np.array(coefficients[1:])))))
