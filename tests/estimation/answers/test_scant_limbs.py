"""A limb folded into a body, of which only the tip shows, is held there: elsewhere its surface would be in sight."""

from __future__ import annotations

import numpy as np
import pytest

import pwralign_kin as pk
from pwralign_kin.estimation.answers.scant_limbs import GAIN, scant_limbs_held
from pwralign_kin.estimation.comparison.candidates import Candidates
from pwralign_kin.estimation.comparison.ranking import ranks
from pwralign_kin.estimation.estimator import Estimator
from pwralign_kin.estimation.refinement.joint_least_squares import JointLeastSquares
from pwralign_kin.estimation.refinement.surface_mixture import mean_log_likelihoods
from pwralign_kin.simulation import TIERS

CRAB = """
<robot name="crab">
  <link name="body">
    <visual><geometry><box size="0.4 0.3 0.2"/></geometry></visual>
    <visual><origin xyz="0.05 0.1 0.12"/><geometry><box size="0.1 0.06 0.1"/></geometry></visual>
  </link>
  <link name="upper"><visual><origin xyz="0 0.06 0"/><geometry><box size="0.05 0.16 0.05"/></geometry></visual></link>
  <link name="lower"><visual><origin xyz="-0.13 0 0"/><geometry><box size="0.3 0.04 0.04"/></geometry></visual></link>
  <joint name="turn" type="revolute">
    <parent link="body"/><child link="upper"/><origin xyz="0.05 0.09 0"/><axis xyz="1 0 0"/>
    <limit lower="-1.5" upper="1.5" effort="1" velocity="1"/>
  </joint>
  <joint name="fold" type="revolute">
    <parent link="upper"/><child link="lower"/><origin xyz="0 0.02 0"/><axis xyz="0 0 1"/>
    <limit lower="-1.6" upper="1.6" effort="1" velocity="1"/>
  </joint>
</robot>
"""

FOLDED = {"turn": 0.1, "fold": 0.3}
"""The lower limb comes out of the body's other side by its tip."""


@pytest.fixture(scope="module")
def crab(tmp_path_factory: pytest.TempPathFactory) -> pk.ArticulatedModel:
    path = tmp_path_factory.mktemp("crab") / "crab.urdf"
    path.write_text(CRAB)
    return pk.ArticulatedModel.from_urdf(path)


def solver_of(crab: pk.ArticulatedModel, tier: str) -> JointLeastSquares:
    truth = pk.State(np.eye(4), FOLDED)
    scan = pk.simulate(crab, truth, TIERS[tier], seed=2).scan
    return Estimator(crab, pk.EstimatorOptions(threads=1)).searched(scan, truth, None).solver


def held_at(crab: pk.ArticulatedModel, solver: JointLeastSquares, joints: dict[str, float]) -> Candidates:
    base = solver.comparison.observation.to_search(crab.root_placement(pk.State(np.eye(4), joints)))
    return Candidates.single(base, crab.values(joints))


@pytest.mark.parametrize("tier", ["full", "hololens"])
@pytest.mark.parametrize("wrong", [{"turn": 0.1, "fold": 1.5}, {"turn": 1.2, "fold": 1.6}])
def test_limbs_are_held_where_they_hide_but_for_their_points(
    crab: pk.ArticulatedModel, tier: str, wrong: dict[str, float]
) -> None:
    solver = solver_of(crab, tier)
    found = scant_limbs_held(solver, held_at(crab, solver, wrong))
    assert found is not None
    assert found.values[0] == pytest.approx(list(FOLDED.values()), abs=0.05)


def test_a_right_answer_is_left_alone(crab: pk.ArticulatedModel) -> None:
    solver = solver_of(crab, "full")
    assert scant_limbs_held(solver, held_at(crab, solver, FOLDED)) is None


def test_views_do_not_tell_what_limbs_hide(crab: pk.ArticulatedModel) -> None:
    solver = solver_of(crab, "single")
    assert scant_limbs_held(solver, held_at(crab, solver, {"turn": 1.2, "fold": 1.6})) is None


def test_surface_in_sight_without_points_speaks_against_an_answer(crab: pk.ArticulatedModel) -> None:
    """By the scores of whole answers, surface within the body lacks points as that in the air does."""
    solver = solver_of(crab, "missing")  # of the limbs next to nothing
    inside, outside = ({"turn": 0.1, "fold": fold} for fold in (0.0, 1.6))
    both = Candidates.concatenate([held_at(crab, solver, joints) for joints in (inside, outside)])
    scores, likelihoods = ranks(solver.comparison, both), mean_log_likelihoods(solver, both)
    assert abs(scores[0] - scores[1]) < GAIN
    assert likelihoods[0] > likelihoods[1] + GAIN
