"""Votes: a part far from where an answer has it is found in the unexplained points, and the joints bring it there."""

from __future__ import annotations

import numpy as np

import pwralign_kin as pk
from pwralign_kin.estimation.comparison.candidates import Candidates
from pwralign_kin.estimation.search.hypotheses import Hypotheses
from pwralign_kin.estimation.search.tree_search import TreeSearch
from pwralign_kin.estimation.search.voting import VoteOptions, voted

NONE = np.zeros(1, np.float32)


def displaced(search: TreeSearch, part: int, candidates: Candidates, true: np.ndarray) -> np.ndarray:
    """Mean displacement of a part's samples from their true place, for every candidate."""
    samples = search.comparison.surfaces[part].samples.astype(float)

    def placed(T: np.ndarray) -> np.ndarray:
        return samples @ np.swapaxes(T[..., :3, :3], -1, -2) + T[..., None, :3, 3]

    apart = placed(search.comparison.part_placements(candidates)[:, part]) - placed(true)
    return np.asarray(np.linalg.norm(apart, axis=-1).mean(axis=-1))


def test_joints_between_two_parts_are_solved(
    arm: pk.ArticulatedModel, search: TreeSearch, right: Candidates, units: np.ndarray
) -> None:
    lower = [part.name for part in arm.parts].index("lower")
    true = search.comparison.part_placements(right)[0]
    rng = np.random.default_rng(0)
    for seed in range(5):
        wrong = Candidates(right.bases, (rng.uniform(arm.lower, arm.upper) / units)[None], NONE)
        held = search.comparison.part_placements(wrong)[0, 0]
        placed = Hypotheses(np.array([lower], np.int32), true[[lower]], NONE)
        reached = search.reached(wrong, np.zeros(1, np.int32), placed, seed, 12, 2, 0.03)
        assert displaced(search, lower, reached, true[lower]).min() < 0.01
        np.testing.assert_allclose(
            search.comparison.part_placements(reached)[:, 0], held[None].repeat(len(reached), 0), atol=1e-9
        )
        assert (reached.values * units >= arm.lower - 1e-9).all()
        assert (reached.values * units <= arm.upper + 1e-9).all()


def test_unexplained_points_vote_for_a_part_in_the_wrong_place(
    arm: pk.ArticulatedModel, search: TreeSearch, right: Candidates
) -> None:
    lower = [part.name for part in arm.parts].index("lower")
    true = search.comparison.part_placements(right)[0, lower]
    values = right.values.copy()
    values[0, :2] *= -1.0
    wrong = Candidates(right.bases, values, NONE)
    assert displaced(search, lower, wrong, true)[0] > 0.2
    moved = voted(search, wrong, VoteOptions(), 0, doubting=False)
    assert moved is not None
    assert displaced(search, lower, moved, true).min() < 0.03


def test_an_answer_that_explains_everything_gets_no_votes(search: TreeSearch, right: Candidates) -> None:
    assert voted(search, right, VoteOptions(), 0, doubting=False) is None
