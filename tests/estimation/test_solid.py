"""Parts inside each other, where the caller says that they cannot be."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

import pwralign_kin as pk
from pwralign_kin.estimation.comparison.candidates import Candidates
from pwralign_kin.estimation.comparison.scan_comparison import ScanComparison, Sought

# Boxes of the parts that other parts can come into, lowest and highest corner in the part's frame, m.
BOXES = {
    "base": [((-0.25, -0.15, 0.0), (0.25, 0.15, 0.1)), ((0.14, 0.03, 0.1), (0.22, 0.13, 0.2))],
    "upper": [((-0.06, -0.04, 0.0), (0.06, 0.04, 0.4)), ((0.06, -0.025, 0.25), (0.12, 0.025, 0.35))],
}
STRANGERS = [("lower", "base"), ("jaw", "base"), ("jaw", "upper")]


def shares_inside(
    arm: pk.ArticulatedModel, comparison: ScanComparison, candidates: Candidates, depth: float
) -> np.ndarray:
    """Share (m, pairs) of each part's samples deeper than `depth` (m) in a box of a part it is not joined to."""
    names = [part.name for part in arm.parts]
    T = comparison.part_placements(candidates)
    columns = []
    for part, other in STRANGERS:
        relative = np.linalg.inv(T[:, names.index(other)]) @ T[:, names.index(part)]
        samples = comparison.surfaces[names.index(part)].samples
        local = (samples @ np.swapaxes(relative[:, :3, :3], 1, 2) + relative[:, None, :3, 3]) * arm.diagonal
        inside = np.zeros(local.shape[:2], bool)
        for low, high in BOXES[other]:
            inside |= ((local > np.add(low, depth)) & (local < np.subtract(high, depth))).all(axis=-1)
        columns.append(inside.mean(axis=1))
    return np.stack(columns, axis=1)


def test_only_parts_inside_others_that_they_are_not_joined_to_cost(
    arm: pk.ArticulatedModel, comparison: ScanComparison, units: np.ndarray
) -> None:
    solid = ScanComparison(
        Sought(comparison.model, comparison.surfaces, replace(comparison.options, solid=True), 2),
        comparison.observation,
        comparison.known,
    )
    values = np.random.default_rng(0).uniform(arm.lower, arm.upper, (400, len(units))) / units
    candidates = Candidates(np.tile(np.eye(4), (400, 1, 1)), values, np.zeros(400, np.float32))
    cost = comparison.scored(candidates)[0].scores - solid.scored(candidates)[0].scores
    apart = shares_inside(arm, comparison, candidates, 0.0).max(axis=1) == 0
    within = shares_inside(arm, comparison, candidates, 0.015).max(axis=1) > 0.1
    assert apart.sum() > 100 and within.sum() > 10
    np.testing.assert_allclose(cost[apart], 0.0, atol=1e-6)
    assert (cost[within] > 0.003).all()
