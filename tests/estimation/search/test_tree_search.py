"""The search: which of many configurations are worth refining, and which states grow on."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest
from truths import true_candidate

import pwralign_kin as pk
from pwralign_kin.estimation.comparison.candidates import Candidates
from pwralign_kin.estimation.comparison.scan_comparison import ScanComparison, Sought
from pwralign_kin.estimation.comparison.search_options import SearchOptions
from pwralign_kin.estimation.knowledge.prior import SearchPrior
from pwralign_kin.estimation.search.hypotheses import Hypotheses
from pwralign_kin.estimation.search.tree_search import TreeSearch, halved
from pwralign_kin.estimation.sensing.observation import ObservationOptions
from pwralign_kin.estimation.sensing.preparation import observe
from pwralign_kin.simulation import TIERS

BALL = """<robot name="ball">
  <link name="base">
    <visual><geometry><box size="0.3 0.2 0.1"/></geometry></visual>
    <visual><origin xyz="0.1 0.05 0.1"/><geometry><box size="0.05 0.06 0.15"/></geometry></visual>
  </link>
  <link name="first"/>
  <link name="second"/>
  <link name="limb">
    <visual><origin xyz="0.2 0 0"/><geometry><box size="0.4 0.06 0.04"/></geometry></visual>
    <visual><origin xyz="0.38 0.08 0"/><geometry><box size="0.04 0.12 0.04"/></geometry></visual>
  </link>
  {joints}
</robot>"""


HINGE = """<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/>
  <origin xyz="{x} 0 0"/><axis xyz="{axis}"/><limit lower="-1.5" upper="1.5" effort="1" velocity="1"/></joint>"""


HINGES = [
    ("z", "base", "first", 0.15, "0 0 1"),
    ("y", "first", "second", 0, "0 1 0"),
    ("x", "second", "limb", 0, "1 0 0"),
]


TABLE = """<robot name="table">
  <link name="a"><visual><geometry><box size="0.3 0.2 0.1"/></geometry></visual></link>
  <link name="b"><visual><geometry><box size="0.15 0.12 0.3"/></geometry></visual></link>
  <joint name="j" type="planar"><parent link="a"/><child link="b"/><origin xyz="0 0 0.2"/><axis xyz="0 0 1"/></joint>
</robot>"""


def test_a_moved_limb_is_not_crowded_out_by_near_copies(search: TreeSearch, right: Candidates) -> None:
    rng = np.random.default_rng(0)
    copies = np.repeat(right.values, 200, axis=0) + rng.normal(0, 0.02, (200, right.values.shape[1]))
    moved = right.values.copy()
    moved[0, 0] *= -1.0
    values = np.concatenate([copies, moved])
    many = Candidates(np.repeat(right.bases, len(values), axis=0), values, np.zeros(len(values), np.float32))

    def has_moved(kept: Candidates) -> bool:
        return bool((np.abs(kept.values - moved) < 1e-12).all(axis=1).any())

    assert not has_moved(search.sifted(many, 8))
    kept = search.sifted(many, 4, varied=4)
    assert has_moved(kept)
    assert len(kept) <= 8
    assert (np.diff(kept.scores) <= 0).all()


def test_a_part_elsewhere_rivals_an_answer_where_it_fits_as_well(search: TreeSearch, right: Candidates) -> None:
    part = search.root_parts[0]
    placed = search.comparison.part_placements(right)[0, part]
    elsewhere, beside = placed.copy(), placed.copy()
    elsewhere[:3, 3] += 0.1
    beside[:3, 3] += 0.01
    fits = float(search.aligned(np.array([part], np.int32), placed[None], 0).scores[0])
    scores = np.array([fits, fits, fits - 0.05, fits - 0.15], np.float32)
    several = Hypotheses(np.full(4, part, np.int32), np.array([beside, elsewhere, elsewhere, elsewhere]), scores)
    assert search.rivalling(several, right, 0.1).tolist() == [False, True, True, False]
    assert len(search.rivalling(Hypotheses.nothing(), right, 0.1)) == 0


def test_each_piece_of_a_scan_has_hypotheses_of_its_own(search: TreeSearch) -> None:
    points = search.observation.points
    pieces = halved(points, np.arange(len(points)), search.options.halvings)
    np.testing.assert_array_equal(np.sort(np.concatenate(pieces)), np.arange(len(points)))
    assert np.ptp([len(piece) for piece in pieces]) <= 1
    found = search.piecewise_hypotheses(0)
    whole = search.promising(search.pair_hypotheses(0))
    radius = 0.25 * float(np.linalg.norm(np.ptp(points, axis=0)))

    def beside(hypotheses: Hypotheses) -> list[int]:
        placed = [
            search.comparison.surfaces[part].samples[:20] @ T[:3, :3].T + T[:3, 3]
            for part, T in zip(hypotheses.parts, hypotheses.placements, strict=True)
        ]
        return [
            sum(float(np.linalg.norm(own.mean(axis=0) - points[piece].mean(axis=0))) < radius for own in placed)
            for piece in pieces
        ]

    assert min(beside(found)) > min(beside(whole))
    assert len(found.parts) <= len(pieces) * search.options.roots_per_piece


def test_a_ball_joint_of_three_hinges_is_turned_as_one(tmp_path: Path) -> None:
    names = ("name", "parent", "child", "x", "axis")
    joints = "\n".join(HINGE.format(**dict(zip(names, hinge, strict=True))) for hinge in HINGES)
    (tmp_path / "ball.urdf").write_text(BALL.format(joints=joints))
    model = pk.ArticulatedModel.from_urdf(tmp_path / "ball.urdf")
    for z, y, x in [(1.2, 1.0, 1.1), (0.9, -0.8, 0.7), (-0.6, 1.3, -1.2)]:
        state = pk.State(T_scan_base=np.eye(4), joints={"z": z, "y": y, "x": x})
        made = pk.simulate(model, state, TIERS["full"], 0)
        observation = observe(made.scan, model.diagonal, ObservationOptions(), 2)
        search = TreeSearch(
            ScanComparison(
                Sought(model.kernel_model, model.surfaces, SearchOptions(), 2),
                observation,
                SearchPrior.nothing(np.zeros(3)),
            )
        )
        true = true_candidate(model, observation, made, np.ones(3))
        root = Hypotheses(np.zeros(1, np.int32), search.comparison.part_placements(true)[:, 0], np.ones(1, np.float32))
        best = search.comparison.scored(search.comparison.refined(search.grow(root, 8)))[0].best_first().take([0])
        apart = np.linalg.norm(
            search.comparison.probe_positions(best) - search.comparison.probe_positions(true), axis=-1
        )
        assert apart.mean() < 0.01, (z, y, x)


def test_growth_for_one_answer_finds_the_best_of_many(search: TreeSearch) -> None:
    roots = search.promising(search.pair_hypotheses(0), 20)
    best = search.grow(roots, 1)
    several = [search.grow(roots.take([index]), search.options.beam) for index in range(len(roots.parts))]
    assert max(len(many) for many in several) > 1
    for index, many in enumerate(several):
        assert (np.diff(many.scores) <= 0).all()
        assert many.scores[0] == best.scores[index]
        assert np.array_equal(many.values[0], best.values[index])


BONE = """<link name="{name}"><visual><geometry><box size="0.18 {width:.3f} 0.03"/></geometry></visual></link>"""


RIB = """<joint name="to_{child}" type="revolute"><parent link="{parent}"/><child link="{child}"/>
  <origin xyz="{x} {y} 0" rpy="0 0 {turn}"/><axis xyz="0 1 1"/><limit lower="-1" upper="1" effort="1" velocity="1"/>
</joint>"""


def test_time_to_grow_does_not_double_with_every_branching(tmp_path: Path) -> None:
    def seconds(bones: int) -> float:
        pieces = [BONE.format(name="bone0", width=0.05)]
        for i in range(bones):
            pieces.append(BONE.format(name=f"bone{i + 1}", width=0.04 + 0.003 * i))
            pieces.append(BONE.format(name=f"rib{i}", width=0.03))
            pieces.append(RIB.format(parent=f"bone{i}", child=f"bone{i + 1}", x=0.2, y=0, turn=0))
            pieces.append(RIB.format(parent=f"bone{i}", child=f"rib{i}", x=0, y=0.1, turn=1.4))
        (tmp_path / "spine.urdf").write_text(f'<robot name="spine">{"".join(pieces)}</robot>')
        model = pk.ArticulatedModel.from_urdf(tmp_path / "spine.urdf")
        made = pk.simulate(model, sensor=TIERS["full"], seed=0)
        observation = observe(made.scan, model.diagonal, ObservationOptions(), 1)
        search = TreeSearch(
            ScanComparison(
                Sought(model.kernel_model, model.surfaces, SearchOptions(), 1),
                observation,
                SearchPrior.nothing(np.zeros(2 * bones)),
            )
        )
        true = true_candidate(model, observation, made, np.ones(2 * bones))
        root = Hypotheses(np.zeros(1, np.int32), search.comparison.part_placements(true)[:, 0], np.ones(1, np.float32))
        start = time.process_time()
        search.grow(root, 8)
        return time.process_time() - start

    assert seconds(12) < 16 * seconds(6)


@pytest.mark.parametrize("seed", [0, 2, 7])
def test_a_part_on_a_planar_joint_is_found_wherever_it_slides(tmp_path: Path, seed: int) -> None:
    urdf = tmp_path / "table.urdf"
    urdf.write_text(TABLE)
    model = pk.ArticulatedModel.from_urdf(urdf)
    made = pk.simulate(model, sensor=pk.Sensor(points=3000), seed=seed)
    estimate = pk.estimate(model, made.scan)
    assert estimate.scan_coverage > 0.99
    assert estimate.confidence > 0.8
