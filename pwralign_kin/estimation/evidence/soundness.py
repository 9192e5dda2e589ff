"""How sound an answer looks while it is searched for: what decides whether the search goes on."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pwralign_kin.estimation.evidence.evidence import Evidence, logistic, on_surface

PRESENT = (8.23, 9.19, 4.02)
"""Coefficients of 1 and of what tells whether the model is in the scan at all, ..."""
RIGHT = (-0.27, -1.34, -0.67, -2.65, 1.35)
"""... and of 1 and of what tells whether an answer is right if it is."""


def soundness(evidence: Evidence) -> float:
    """Return how well the evidence speaks for an answer, in [0, 1].

    No chance of being right, which is `confidence`: most thresholds of searches hang on this scale, and it stays as it
    is when the confidence is fitted anew.
    """
    return float(on_surface(evidence) * logistic(PRESENT, _presence(evidence)) * logistic(RIGHT, _rightness(evidence)))


def _presence(evidence: Evidence) -> NDArray[np.float64]:
    """Return (2,): strange points, the more of them the less of the model is borne out, and what is borne out."""
    borne_out = np.clip(evidence.borne_out, 0.05, 0.5)
    strange = 3.0 * np.sqrt(min(evidence.strange, 0.3))
    return np.array([strange * np.log(borne_out / 0.5), np.log(min(borne_out, 0.3))])


def _rightness(evidence: Evidence) -> NDArray[np.float64]:
    """Return (4,) logarithms, for the first doubts weigh most, within the range that simulated scans tell apart."""
    return np.array(
        [
            np.log(min(evidence.nearby, 0.05) + 0.005),
            np.log(evidence.lacking + 0.01),
            np.log(np.clip(evidence.uneven, 0.8, 3.0)),
            np.log(np.clip(evidence.margin, -0.004, 0.1) + 0.006),
        ]
    )
