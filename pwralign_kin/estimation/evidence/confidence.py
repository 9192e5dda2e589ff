"""The chance that an answer is right, from the evidence for and against it: fitted to simulated scans."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pwralign_kin.estimation.evidence.evidence import Evidence, logistic, on_surface

PRESENT = (3.77, 5.5, 3.38, 0.45, -1.96, -0.53, -6.0)
"""Coefficients of 1 and of what tells whether the model is in the scan at all (`presence_features`), ..."""
RIGHT = (-0.47, -0.43, -0.3, -0.86, 0.78, 0.59)
"""... and of 1 and of what tells whether an answer is right if it is (`features`):
`pwralign_kin.benchmark.calibration.fitted` to answers to scans such as those of `python scripts/benchmark.py --table
confidence`, which shows what it finds beside these."""
SHOWN = (0.2, 0.8)
"""How much surface is in sight, against what a scan usually shows: less tells no more, nor does more."""
CONTINUED = (0.15, 0.55)
"""Share of the edges beyond which surface goes on: simulated scans have less where the answer is right, real sensors
that widen outlines a little more; beyond the second, more tells no more."""
REFUTED = (0.1, 0.9)
"""Share of the surface that a single view looks past: pixels mixed at edges make as much of right answers."""
SIZE_GAIN = (0.025, 0.055)
"""Gain by a model of another size: sensors and noise make less, and beyond the second, more tells no more."""
LEFT = (0.2, 0.5)
"""Share of what is near an answer to a scene that it leaves unexplained, from which on it is doubtful, and worth
nothing: things may touch the model, but hardly all around."""
FEW = 15.0
"""Points a part below which an answer's odds fall with their number."""
BENT = 0.4
"""Share of astray points from which on the sensor bends surfaces so much that rivals beside the answer tell nothing."""


def confidence(evidence: Evidence) -> float:
    """Return the chance in [0, 1] that an answer with this evidence is right.

    It is the chance that the model is in the scan at all, times the chance that the answer is right if it is: two
    logistic regressions. It fades to nothing where the points fill a volume, and where an answer to a scene lies among
    much else.
    """
    chance = logistic(PRESENT, presence_features(evidence)) * logistic(RIGHT, features(evidence))
    alone = float(np.clip((LEFT[1] - evidence.left) / (LEFT[1] - LEFT[0]), 0.0, 1.0))
    return on_surface(evidence) * alone * chance


def presence_features(evidence: Evidence) -> NDArray[np.float64]:
    """Return what tells a scan of the model from one of something else (6,).

    What lies on or near the model and is not of it to within the noise counts the more, the less of the model in sight
    is confirmed: masks leak and sensors bend surfaces, and scans have holes, but neither does both. In something else,
    answers turn most of the model away, many of them are about as good, surface that only coincides with the model's
    goes on beyond it, a view from one side looks past much of the model, and a model of another size may fit better.
    """
    unlike = np.sqrt(10.0 * min(evidence.strange + evidence.astray, 0.4))
    shown = max(evidence.borne_out, 0.01) / max(evidence.in_sight, 0.02)
    return np.array(
        [
            unlike * np.log(np.clip(evidence.in_sight, 0.1, 0.8) / 0.8),
            np.log(np.clip(shown, *SHOWN)),
            np.clip(evidence.distinct, -8.0, 4.0),
            10.0 * (np.clip(evidence.continued, *CONTINUED) - CONTINUED[0]),
            10.0 * (np.clip(evidence.refuted, *REFUTED) - REFUTED[0]),
            (np.clip(evidence.size_gain, *SIZE_GAIN) - SIZE_GAIN[0]) / (SIZE_GAIN[1] - SIZE_GAIN[0]),
        ]
    )


def features(evidence: Evidence) -> NDArray[np.float64]:
    """Return what tells a right answer from a wrong one (5,), within the range that simulated scans tell apart:
    logarithms, or nearly, for the first doubts weigh most."""
    distinct, told = np.clip([evidence.distinct, evidence.told], -8.0, 12.0)
    return np.array(
        [
            np.log(min(evidence.nearby, 0.05) + 0.02),
            np.log(evidence.lacking + 0.01),
            np.log(np.clip(evidence.uneven, 0.8, 3.0)),
            np.arcsinh((distinct + (told - distinct) * max(0.0, 1.0 - evidence.astray / BENT)) / 2.0),
            np.log(np.clip(evidence.points_per_part, 1.0, FEW) / FEW),
        ]
    )
