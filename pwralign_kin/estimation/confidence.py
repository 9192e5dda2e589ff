"""The chance that an answer is right, from the evidence for and against it: fitted to simulated scans."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pwralign_kin.estimation.evidence import Evidence, logistic, on_surface

PRESENT = (6.62, 3.63, 2.08, 0.59, -2.5)
"""Coefficients of 1 and of what tells whether the model is in the scan at all (`presence_features`), ..."""
RIGHT = (-3.91, -0.73, -0.63, -1.9, 0.27)
"""... and of 1 and of what tells whether an answer is right if it is (`features`):
`pwralign_kin.benchmark.calibration.fitted` to answers of `python scripts/benchmark.py --table confidence`, to scans of
seventeen models and to scans of something else; that of what is continued with the others held."""
CONTINUED = (0.15, 0.55)
"""Share of the edges beyond which surface goes on: simulated scans have less where the answer is right, real sensors
that widen outlines a little more; beyond the second, more tells no more."""
FEW, SPARSE = 15.0, 2.0
"""Points a part below which an answer's odds fall with their number, and the exponent: fitted to 25 to 400 points of
scans of ten robots, with all else as it is."""


def confidence(evidence: Evidence) -> float:
    """Return the chance in [0, 1] that an answer with this evidence is right.

    It is the chance that the model is in the scan at all, times the chance that the answer is right if it is: two
    logistic regressions. It fades to nothing where the points fill a volume or are too few.
    """
    chance = logistic(PRESENT, presence_features(evidence)) * logistic(RIGHT, features(evidence))
    odds = chance / (1.0 - chance) * min(evidence.points_per_part / FEW, 1.0) ** SPARSE
    return float(on_surface(evidence) * odds / (1.0 + odds))


def presence_features(evidence: Evidence) -> NDArray[np.float64]:
    """Return what tells a scan of the model from one of something else (4,).

    What lies on or near the model and is not of it to within the noise counts the more, the less of the model is borne
    out: masks leak and sensors bend surfaces, and parts that a scan lacks bear nothing out, but neither does both. In
    something else, many answers are about as good, and surface that only coincides with the model's goes on beyond it.
    """
    unlike = 10.0 * min(evidence.strange + evidence.astray, 0.4)
    return np.array(
        [
            unlike * np.log(np.clip(evidence.borne_out, 0.05, 0.5) / 0.5),
            np.log(np.clip(evidence.borne_out, 0.01, 0.2)),
            np.clip(evidence.distinct, -8.0, 4.0),
            10.0 * (np.clip(evidence.continued, *CONTINUED) - CONTINUED[0]),
        ]
    )


def features(evidence: Evidence) -> NDArray[np.float64]:
    """Return what tells a right answer from a wrong one (4,), within the range that simulated scans tell apart:
    logarithms, for the first doubts weigh most, and standard deviations."""
    return np.array(
        [
            np.log(min(evidence.nearby, 0.05) + 0.005),
            np.log(evidence.lacking + 0.01),
            np.log(np.clip(evidence.uneven, 0.8, 3.0)),
            np.clip(evidence.distinct, -8.0, 12.0),
        ]
    )
