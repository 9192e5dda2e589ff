"""A part the wrong way round, and what hangs on it where it nearly belongs: read otherwise, the surface comes right."""

from __future__ import annotations

import numpy as np
import pytest

import pwralign_kin as pk
from pwralign_kin.estimation.comparison.candidates import Candidates
from pwralign_kin.estimation.comparison.scan_comparison import ScanComparison, Sought
from pwralign_kin.estimation.comparison.search_options import SearchOptions
from pwralign_kin.estimation.knowledge.prior import SearchPrior
from pwralign_kin.estimation.search.reinterpretation import ReinterpretationOptions, reinterpreted
from pwralign_kin.estimation.search.tree_search import TreeSearch
from pwralign_kin.estimation.sensing.observation import ObservationOptions
from pwralign_kin.estimation.sensing.preparation import observe
from pwralign_kin.model.symmetry import find_symmetry

LIMB = """
  <link name="{side}_thigh">
    <visual><origin xyz="0 0 -0.2"/><geometry><box size="0.12 0.12 0.4"/></geometry></visual>
  </link>
  <joint name="{side}_hip" type="revolute">
    <parent link="body"/><child link="{side}_thigh"/><origin xyz="0.05 {y} -0.1"/><axis xyz="0 0 1"/>
    <limit lower="-3.2" upper="3.2" effort="1" velocity="1"/>
  </joint>
  <link name="{side}_shin">
    <visual><origin xyz="0 0 -0.2"/><geometry><box size="0.08 0.1 0.35"/></geometry></visual>
  </link>
  <joint name="{side}_knee" type="revolute">
    <parent link="{side}_thigh"/><child link="{side}_shin"/><origin xyz="0.025 0 -0.4"/><axis xyz="0 1 0"/>
    <limit lower="-2.2" upper="2.2" effort="1" velocity="1"/>
  </joint>"""

FIGURE = (
    '<robot name="figure"><link name="body"><visual><geometry><box size="0.3 0.5 0.2"/></geometry></visual></link>'
    + LIMB.format(side="left", y=0.18)
    + LIMB.format(side="right", y=-0.18)
    + "</robot>"
)
"""A body and two legs whose knees are off the middle of the square thighs."""

TRUE = {"left_hip": 0.4, "left_knee": 0.9, "right_hip": -0.7, "right_knee": -0.5}


@pytest.fixture(scope="module")
def figure(tmp_path_factory: pytest.TempPathFactory) -> pk.ArticulatedModel:
    path = tmp_path_factory.mktemp("figure") / "figure.urdf"
    path.write_text(FIGURE)
    return pk.ArticulatedModel.from_urdf(path)


@pytest.fixture(scope="module")
def searched(figure: pk.ArticulatedModel) -> TreeSearch:
    scan = pk.simulate(figure, pk.State(np.eye(4), TRUE), seed=4).scan
    observation = observe(scan, figure.diagonal, ObservationOptions(), 1)
    neutral = figure.values({})
    return TreeSearch(
        ScanComparison(
            Sought(figure.kernel_model, figure.surfaces, SearchOptions(), 1), observation, SearchPrior.nothing(neutral)
        )
    )


def configuration(figure: pk.ArticulatedModel, search: TreeSearch, joints: dict[str, float]) -> Candidates:
    base = search.observation.to_search(figure.root_placement(pk.State(np.eye(4), joints)))
    return search.comparison.scored(Candidates(base[None], figure.values(joints)[None], np.zeros(1, np.float32)))[0]


@pytest.mark.parametrize("sides", [("left",), ("left", "right")])
def test_a_thigh_turned_over_comes_right(
    figure: pk.ArticulatedModel, searched: TreeSearch, sides: tuple[str, ...]
) -> None:
    wrong = dict(TRUE)
    for side in sides:
        wrong[f"{side}_hip"] -= np.copysign(np.pi, wrong[f"{side}_hip"])
        wrong[f"{side}_knee"] *= -1.0
    right = configuration(figure, searched, TRUE)
    answer = configuration(figure, searched, wrong)
    assert answer.scores[0] < right.scores[0] - 0.02
    for _ in sides:
        found = reinterpreted(figure, searched, answer, ReinterpretationOptions())
        assert found is not None
        answer = found.take([0])
    assert answer.scores[0] > right.scores[0] - 0.01
    apart = np.linalg.norm(
        searched.comparison.probe_positions(answer) - searched.comparison.probe_positions(right), axis=-1
    )
    assert apart.mean() < 0.02


def test_turns_that_nearly_map_a_part_onto_itself_are_told_from_exact_ones(figure: pk.ArticulatedModel) -> None:
    symmetry = find_symmetry(figure.surfaces)
    names = [part.name for part in figure.parts]
    assert len(symmetry.nearly[names.index("left_shin")]) > 0
    assert len(symmetry.nearly[names.index("body")]) == 0
    for part in range(len(names)):
        exact = symmetry.replacements(part, part)
        samples = figure.surfaces[part].samples
        for turn, off in zip(symmetry.nearly[part], symmetry.nearly_off[part], strict=True):
            assert 0.0 < off < 0.01
            moved = samples @ turn[:3, :3].T + turn[:3, 3]
            same = [np.linalg.norm(samples @ T[:3, :3].T + T[:3, 3] - moved, axis=1).mean() for T in exact]
            assert min(same) > 0.005


def test_without_a_turn_that_keeps_surface_nothing_is_read_otherwise(
    figure: pk.ArticulatedModel, searched: TreeSearch
) -> None:
    answer = configuration(figure, searched, TRUE)
    assert reinterpreted(figure, searched, answer, ReinterpretationOptions(apart=0.0)) is None
