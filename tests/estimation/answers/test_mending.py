"""A small part off its points, because what it hangs on is the wrong way round, is found; what fits is left alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import pwralign_kin as pk
from pwralign_kin.estimation.answers.mending import mended
from pwralign_kin.estimation.comparison.candidates import Candidates
from pwralign_kin.estimation.comparison.off_points import off_points
from pwralign_kin.estimation.comparison.scan_comparison import ScanComparison, Sought
from pwralign_kin.estimation.comparison.search_options import SearchOptions
from pwralign_kin.estimation.knowledge.prior import SearchPrior
from pwralign_kin.estimation.search.voting import VoteOptions
from pwralign_kin.estimation.sensing.observation import ObservationOptions
from pwralign_kin.estimation.sensing.preparation import observe
from pwralign_kin.simulation import TIERS, Sensor

BALL = """
  <link name="{part}_twisted"/>
  <link name="{part}"><visual><origin xyz="{x} 0 {z}"/><geometry><box size="{size}"/></geometry></visual></link>
  <joint name="{part}_twist" type="revolute">
    <parent link="{above}"/><child link="{part}_twisted"/><origin xyz="{at}"/><axis xyz="0 0 1"/>
    <limit lower="-3.1416" upper="3.1416" effort="1" velocity="1"/>
  </joint>
  <joint name="{part}_fold" type="revolute">
    <parent link="{part}_twisted"/><child link="{part}"/><axis xyz="0 1 0"/>
    <limit lower="-1.5" upper="1.5" effort="1" velocity="1"/>
  </joint>"""

LEG = (
    '<robot name="leg"><link name="body"><visual><geometry><box size="0.3 0.5 0.2"/></geometry></visual></link>'
    + BALL.format(part="shin", above="body", x=0, z=-0.2, size="0.12 0.12 0.35", at="0.05 0.1 -0.11")
    + BALL.format(part="foot", above="shin", x=0.03, z=-0.04, size="0.12 0.08 0.06", at="0.04 0 -0.385")
    + "</robot>"
)
"""A body, a square shin, and a foot that hangs off the middle of the shin; each on a twist and a fold."""

TRUE = {"shin_twist": 0.5, "shin_fold": 0.7, "foot_twist": 0.4, "foot_fold": -0.5}
TURNED = {"shin_twist": 0.5 - np.pi, "shin_fold": -0.7, "foot_twist": -1.6, "foot_fold": 0.9}
"""The shin lies on itself, turned by half a revolution, and the foot cannot come to its place."""


@pytest.fixture(scope="module")
def leg(tmp_path_factory: pytest.TempPathFactory) -> pk.ArticulatedModel:
    path = tmp_path_factory.mktemp("leg") / "leg.urdf"
    path.write_text(LEG)
    return pk.ArticulatedModel.from_urdf(path)


def searched(leg: pk.ArticulatedModel, sensor: Sensor) -> ScanComparison:
    scan = pk.simulate(leg, pk.State(np.eye(4), TRUE), sensor, seed=2).scan
    observation = observe(scan, leg.diagonal, ObservationOptions(), 1)
    return ScanComparison(
        Sought(leg.kernel_model, leg.surfaces, SearchOptions(), 1), observation, SearchPrior.nothing(leg.values({}))
    )


def configuration(leg: pk.ArticulatedModel, comparison: ScanComparison, joints: dict[str, float]) -> Candidates:
    base = comparison.observation.to_search(leg.root_placement(pk.State(np.eye(4), joints)))
    return Candidates.single(base, leg.values(joints))


def test_what_a_part_hangs_on_is_turned_to_bring_it_to_its_points(leg: pk.ArticulatedModel) -> None:
    comparison = searched(leg, TIERS["full"])
    wrong, right = (configuration(leg, comparison, joints) for joints in (TURNED, TRUE))
    parts, less = off_points(comparison, wrong)
    assert [leg.parts[i].name for i in parts] == ["foot"]
    assert less[0] > 0.0
    found = mended(leg, comparison, wrong, VoteOptions())
    assert found is not None
    apart = np.linalg.norm(comparison.probe_positions(found) - comparison.probe_positions(right), axis=-1).mean()
    assert apart < 0.005


def test_a_right_answer_is_left_alone(leg: pk.ArticulatedModel) -> None:
    comparison = searched(leg, TIERS["full"])
    right = configuration(leg, comparison, TRUE)
    assert len(off_points(comparison, right)[0]) == 0
    assert mended(leg, comparison, right, VoteOptions()) is None


def test_the_points_of_a_bent_scan_do_not_tell_where_a_small_part_is(leg: pk.ArticulatedModel) -> None:
    comparison = searched(leg, replace(TIERS["single"], bend=0.02))
    wrong = configuration(leg, comparison, TURNED)
    assert len(off_points(comparison, wrong)[0]) > 0
    assert mended(leg, comparison, wrong, VoteOptions()) is None
