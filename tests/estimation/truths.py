"""The truth about a simulated scan as the search has it."""

from __future__ import annotations

import numpy as np

import pwralign_kin as pk
from pwralign_kin.estimation.comparison.candidates import Candidates
from pwralign_kin.estimation.sensing.observation import Observation
from pwralign_kin.simulation import SimulatedScan


def true_candidate(
    model: pk.ArticulatedModel, observation: Observation, made: SimulatedScan, units: np.ndarray
) -> Candidates:
    base = observation.to_search(made.state.T_scan_base)
    return Candidates.single(base, model.values(made.state.joints) / units)
