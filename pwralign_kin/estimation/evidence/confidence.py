"""The chance that an answer is right, from the evidence for and against it: fitted to simulated scans."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pwralign_kin.estimation.evidence.evidence import Evidence, logistic, on_surface

PRESENT = (3.07, 3.71, 1.37, 0.15, -1.83, -2.05, -4.57, 0.23)
"""Coefficients of 1 and of what tells whether the model is in the scan at all (`presence_features`), ..."""
RIGHT = (0.25, -0.54, -0.38, -2.0, 0.98, 0.74, 0.4)
"""... and of 1 and of what tells whether an answer is right if it is (`features`).

The first was fitted by `python scripts/benchmark.py --table confidence` (`pwralign_kin.benchmark.calibration`). Too few
of today's answers are wrong to fit the second, which lies between what an earlier estimator's answers, wrong more
often, and today's make of it: how much `uneven` and `ahead` count is by today's. The table shows what it finds beside
these."""
MOST_UNLIKE = 0.2
"""Share of strange and astray points from which more tells no more: fused meshes, and sensors that bend surfaces, make
as much of right answers."""
AGREED = (0.3, 0.95)
"""Share of the surface that points lie on that is oriented like them: corners, and noise, take the rest."""
EXPLAINED = 0.6
"""Share of the scan below which less of it explained tells no more."""
ALIKE = 0.8 * AGREED[1]
"""How much of model and scan is alike, at most: product of the shares of one confirmed, and agreeing, and of the other
explained."""
SHOWN = (0.2, 0.6)
"""How much surface is in sight, against what a picture usually shows: less tells no more, nor does more."""
AHEAD = (0.01, 0.3)
"""Score by which an answer is ahead of the next: less is none, and beyond the second, more tells no more."""
CONTINUED = (0.15, 0.55)
"""Share of the edges beyond which surface goes on: simulated scans have less where the answer is right, real sensors
that widen outlines a little more; beyond the second, more tells no more."""
REFUTED = (0.15, 0.9)
"""Share of the surface that a single view looks past: pixels mixed at edges make as much of right answers."""
SIZE_GAIN = (0.025, 0.1)
"""Gain by a model of another size: sensors and noise make less, and beyond the second, more tells no more."""
MIRRORED = (0.12, 0.25)
"""Score by which an answer to the mirror image of the scan is better: chance makes less than the first, and from the
second on the scan is of the other hand, and its answer wrong."""
BORNE_OUT = 0.1
"""Share of the surface that a scan usually shows, below which what is confirmed of it may as well be of something else,
the less the likelier, however well it lies there: a face of one thing on a face of another."""
FEW = 15.0
"""Points a part below which an answer's odds fall with their number."""
BENT = 0.4
"""Share of astray points from which on the sensor bends surfaces so much that rivals beside the answer tell nothing."""


def confidence(evidence: Evidence) -> float:
    """Return the chance in [0, 1] that an answer with this evidence is right.

    It is the chance that the model is in the scan at all, times the chance that the answer is right if it is: two
    logistic regressions. It fades to nothing where the points fill a volume, bear out next to nothing of the model, or
    make the mirror image of it.
    """
    chance = logistic(PRESENT, presence_features(evidence)) * logistic(RIGHT, features(evidence))
    borne_out = min(1.0, evidence.borne_out / BORNE_OUT)
    return on_surface(evidence) * _of_this_hand(evidence) * borne_out * chance


def _of_this_hand(evidence: Evidence) -> float:
    """Return how far the scan is no mirror image, from 1 to 0."""
    least, most = MIRRORED
    return float(np.clip((most - evidence.mirrored) / (most - least), 0.0, 1.0))


def presence_features(evidence: Evidence) -> NDArray[np.float64]:
    """Return what tells a scan of the model from one of something else (7,).

    What lies on or near the model and is not of it to within the noise counts the more, the less of the model in sight
    is confirmed, the less what is seen of it agrees, and the less of the scan it explains: masks leak and sensors bend
    surfaces, scans have holes, and scenes hold much else, but no right answer is doubtful in every way. In something
    else, answers turn most of the model away, many of them are about as good, surface that only coincides with the
    model's goes on beyond it, a view from one side looks past much of the model, and a model of another size may fit
    better.
    """
    unlike = np.sqrt(10.0 * min(evidence.strange + evidence.astray, MOST_UNLIKE))
    seen = np.clip(evidence.in_sight, 0.1, 0.8) * np.clip(evidence.agreed, *AGREED)
    alike = seen * max(evidence.explained, EXPLAINED)
    return np.array(
        [
            unlike * np.log(alike / ALIKE),
            np.log(np.clip(evidence.shown, *SHOWN) / SHOWN[1]),
            np.clip(evidence.distinct, -8.0, 4.0),
            10.0 * (np.clip(evidence.continued, *CONTINUED) - CONTINUED[0]),
            10.0 * (np.clip(evidence.refuted, *REFUTED) - REFUTED[0]),
            (np.clip(evidence.size_gain, *SIZE_GAIN) - SIZE_GAIN[0]) / (SIZE_GAIN[1] - SIZE_GAIN[0]),
            _ahead(evidence),
        ]
    )


def features(evidence: Evidence) -> NDArray[np.float64]:
    """Return what tells a right answer from a wrong one (6,), within the range that simulated scans tell apart:
    logarithms, or nearly, for the first doubts weigh most."""
    distinct, told = np.clip([evidence.distinct, evidence.told], -8.0, 12.0)
    return np.array(
        [
            np.log(min(evidence.nearby, 0.05) + 0.02),
            np.log(evidence.lacking + 0.01),
            np.log(np.clip(evidence.uneven, 0.8, 3.0)),
            np.arcsinh((distinct + (told - distinct) * max(0.0, 1.0 - evidence.astray / BENT)) / 2.0),
            np.log(np.clip(evidence.points_per_part, 1.0, FEW) / FEW),
            _ahead(evidence),
        ]
    )


def _ahead(evidence: Evidence) -> float:
    """Return the logarithm of how far the answer is ahead of the next."""
    least, most = AHEAD
    return float(np.log((np.clip(evidence.ahead, 0.0, most) + least) / (most + least)))
