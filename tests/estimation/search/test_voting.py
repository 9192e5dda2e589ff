"""Votes: a part far from where an answer has it is found in the unexplained points, and the joints bring it there."""

from __future__ import annotations

import numpy as np
import pytest

import pwralign_kin as pk
from pwralign_kin.estimation.answers.mending import mended
from pwralign_kin.estimation.comparison.candidates import Candidates
from pwralign_kin.estimation.comparison.off_points import off_points
from pwralign_kin.estimation.comparison.scan_comparison import ScanComparison, Sought
from pwralign_kin.estimation.comparison.search_options import SearchOptions
from pwralign_kin.estimation.knowledge.prior import SearchPrior
from pwralign_kin.estimation.search.hypotheses import Hypotheses
from pwralign_kin.estimation.search.repair import RepairOptions, repair_moves
from pwralign_kin.estimation.search.tree_search import TreeSearch
from pwralign_kin.estimation.search.voting import LIMB, OTHER_LIMB, VoteOptions, _limbs, limbs_voted, voted
from pwralign_kin.estimation.sensing.observation import ObservationOptions
from pwralign_kin.estimation.sensing.preparation import observe
from pwralign_kin.simulation import TIERS

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


def test_a_part_off_its_points_is_brought_to_them_though_it_explains_them(
    arm: pk.ArticulatedModel, search: TreeSearch, right: Candidates
) -> None:
    lower = [part.name for part in arm.parts].index("lower")
    true = search.comparison.part_placements(right)[0, lower]
    values = right.values.copy()
    values[0, 1] += 0.12
    wrong = Candidates(right.bases, values, NONE)
    before = displaced(search, lower, wrong, true)[0]
    off = off_points(search.comparison, wrong)[0]
    assert lower in off and not search.comparison.lacks(wrong)[lower]
    moved = voted(search, wrong, VoteOptions(), 0, doubting=True, off=off)
    assert moved is not None
    assert displaced(search, lower, moved, true).min() < 0.5 * before


WRIST = """<robot name="wrist">
  <link name="body"><visual><geometry><box size="0.3 0.5 0.2"/></geometry></visual></link>
  <link name="one"><visual><origin xyz="0.08 0 -0.03"/><geometry><box size="0.16 0.06 0.05"/></geometry></visual></link>
  <link name="two"><visual><origin xyz="0.09 0 0"/><geometry><box size="0.16 0.05 0.04"/></geometry></visual></link>
  <link name="leg"><visual><origin xyz="0 0 -0.3"/><geometry><box size="0.12 0.08 0.5"/></geometry></visual></link>
  <joint name="a" type="revolute"><parent link="body"/><child link="one"/><origin xyz="0.05 0.1 -0.13"/>
    <axis xyz="0 0 1"/><limit lower="-3.1416" upper="3.1416" effort="1" velocity="1"/></joint>
  <joint name="b" type="revolute"><parent link="one"/><child link="two"/><origin xyz="0 0 -0.06"/>
    <axis xyz="0 1 0"/><limit lower="-1.5" upper="1.5" effort="1" velocity="1"/></joint>
  <joint name="c" type="revolute"><parent link="two"/><child link="leg"/>
    <axis xyz="0 0 1"/><limit lower="-3.1416" upper="3.1416" effort="1" velocity="1"/></joint>
</robot>"""


@pytest.fixture(scope="module")
def wrist(tmp_path_factory: pytest.TempPathFactory) -> pk.ArticulatedModel:
    path = tmp_path_factory.mktemp("wrist") / "wrist.urdf"
    path.write_text(WRIST)
    return pk.ArticulatedModel.from_urdf(path)


@pytest.fixture(scope="module")
def seen(wrist: pk.ArticulatedModel) -> tuple[ScanComparison, Candidates, Candidates]:
    """A scan, the truth, and the leg where it is with the wrist the other way round."""
    a, b, c = 0.5, 0.7, 0.4
    scan = pk.simulate(wrist, pk.State(np.eye(4), {"a": a, "b": b, "c": c}), TIERS["full"], seed=2).scan
    observation = observe(scan, wrist.diagonal, ObservationOptions(), 1)
    sought = Sought(wrist.kernel_model, wrist.surfaces, SearchOptions(), 1)
    comparison = ScanComparison(sought, observation, SearchPrior.nothing(wrist.values({})))
    base = observation.to_search(wrist.root_placement(pk.State(np.eye(4), {})))
    true, other = np.array([a, b, c]), np.array([a - np.pi, -b, c - np.pi])
    return comparison, Candidates.single(base, true), Candidates.single(base, other)


def apart(comparison: ScanComparison, several: Candidates, true: Candidates) -> np.ndarray:
    displacements = comparison.probe_positions(several) - comparison.probe_positions(true)
    return np.asarray(np.linalg.norm(displacements, axis=-1).mean(axis=1))


def test_three_joints_hold_what_is_beyond_them_the_other_way(
    seen: tuple[ScanComparison, Candidates, Candidates],
) -> None:
    comparison, true, other = seen
    leg, held = 3, comparison.part_placements(Candidates.concatenate([true, other]))[:, 3]
    np.testing.assert_allclose(held[0], held[1], atol=1e-9)
    off = off_points(comparison, other)[0]
    assert set(off) <= {1, 2} and leg not in off
    moved = voted(TreeSearch(comparison), other, VoteOptions(), 0, doubting=True, off=np.array([1, 2]))
    assert moved is not None
    assert apart(comparison, moved, true).min() < 0.005


def test_repair_and_mending_have_parts_off_their_points_voted_for(
    wrist: pk.ArticulatedModel, seen: tuple[ScanComparison, Candidates, Candidates]
) -> None:
    comparison, true, other = seen
    options = RepairOptions(unexplained=0.1)  # nothing counts as missing
    moves = repair_moves(TreeSearch(comparison), other, options, 0, foremost=True, turn=False)
    mend = mended(wrist, comparison, other, VoteOptions())
    assert moves is not None and mend is not None
    assert apart(comparison, moves, true).min() < 0.001 and apart(comparison, mend, true) < 0.005
    silent = RepairOptions(unexplained=0.1, votes=VoteOptions(parts=0))
    less = repair_moves(TreeSearch(comparison), other, silent, 0, foremost=True, turn=False)
    assert less is not None and apart(comparison, less, true).min() > 0.005


def test_limbs_are_doubted_as_a_whole_whatever_their_parts_explain(
    seen: tuple[ScanComparison, Candidates, Candidates],
) -> None:
    comparison, true, other = seen
    search = TreeSearch(comparison)
    lacking = voted(search, other, VoteOptions(), 0, doubting=True)
    assert lacking is None or apart(comparison, lacking, true).min() > 0.005
    moved = limbs_voted(search, other, VoteOptions(), 0)
    assert moved is not None
    assert apart(comparison, moved, true).min() < 0.005


def test_limbs_are_what_hangs_on_either_side_of_a_joint(
    seen: tuple[ScanComparison, Candidates, Candidates], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Those that differ by hardly any surface, as a leg with or without a small link of the hip, are one."""
    comparison = seen[0]
    sides = {(0,), (1, 2, 3), (0, 1), (2, 3), (0, 1, 2), (3,)}
    share = {side: float(comparison.weights[list(side)].sum()) for side in sides}

    def limbs() -> list[tuple[int, ...]]:
        return [tuple(map(int, np.flatnonzero(limb))) for limb in _limbs(comparison)]

    assert share[2, 3] - share[3,] < OTHER_LIMB
    assert (2, 3) in limbs() and (3,) not in limbs()
    monkeypatch.setattr("pwralign_kin.estimation.search.voting.OTHER_LIMB", 0.0)
    assert sorted(limbs()) == sorted(side for side in sides if LIMB[0] < share[side] < LIMB[1])
