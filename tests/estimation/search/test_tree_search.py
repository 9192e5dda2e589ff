"""The search: which of many configurations are worth refining, which states grow on, and what a view contradicts."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import pwralign_kin as pk
from pwralign_kin.estimation.comparison.candidates import Candidates
from pwralign_kin.estimation.comparison.scan_comparison import REMEMBERED, Sought
from pwralign_kin.estimation.comparison.search_options import SearchOptions
from pwralign_kin.estimation.knowledge.prior import SearchPrior
from pwralign_kin.estimation.search.hypotheses import Hypotheses
from pwralign_kin.estimation.search.tree_search import TreeSearch, halved
from pwralign_kin.estimation.sensing.observation import ObservationOptions, observe
from pwralign_kin.model.surface import Surface
from pwralign_kin.simulation import TIERS, SimulatedScan

NONE = np.zeros(1, np.float32)

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


SLAT = '<visual><origin xyz="{x:.3f} 0 0" rpy="0 0.8 0"/><geometry><box size="0.001 0.3 0.014"/></geometry></visual>'
BLIND = """<robot name="blind">
  <link name="slats">{slats}</link>
  <link name="bar"><visual><geometry><box size="0.3 0.03 0.03"/></geometry></visual></link>
  <joint name="j" type="revolute"><parent link="slats"/><child link="bar"/><origin xyz="-0.17 0 0"/><axis xyz="0 1 0"/>
    <limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
</robot>"""


def true_candidate(
    model: pk.ArticulatedModel, search: TreeSearch, made: SimulatedScan, units: np.ndarray
) -> Candidates:
    base = search.observation.to_search(made.state.T_scan_base)
    return Candidates(base[None], (model.values(made.state.joints) / units)[None], NONE)


@pytest.fixture(scope="module")
def right(arm: pk.ArticulatedModel, full_scan: SimulatedScan, search: TreeSearch, units: np.ndarray) -> Candidates:
    return true_candidate(arm, search, full_scan, units)


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


@pytest.mark.parametrize("base_moves", [False, True])
def test_what_a_sweep_finds_scores_as_whole_configurations_do(
    arm: pk.ArticulatedModel, single_scan: SimulatedScan, units: np.ndarray, base_moves: bool
) -> None:
    few = pk.Scan(single_scan.scan.points[::25], sensor_origin=single_scan.scan.sensor_origin)
    observation = observe(few, arm.diagonal, ObservationOptions(), 1)
    assert len(observation.points) <= 350  # a sweep looks at no more of them at first
    search = TreeSearch(
        Sought(arm.kernel_model, arm.surfaces, SearchOptions(), 1),
        observation,
        SearchPrior.nothing(arm.values({}) / units),
    )
    true = true_candidate(arm, search, single_scan, units)
    joints = np.arange(true.values.shape[1], dtype=np.int32)
    swept = search.swept(true, joints, np.full(len(joints), base_moves), 4)
    assert len(swept) > len(joints)
    np.testing.assert_allclose(swept.scores, search.scored(swept)[0].scores, atol=1e-4)


def test_a_view_contradicts_surface_in_free_space(
    arm: pk.ArticulatedModel, single_scan: SimulatedScan, units: np.ndarray
) -> None:
    observation = observe(single_scan.scan, arm.diagonal, ObservationOptions(), 2)
    search = TreeSearch(
        Sought(arm.kernel_model, arm.surfaces, SearchOptions(), 2),
        observation,
        SearchPrior.nothing(arm.values({}) / units),
    )
    true = true_candidate(arm, search, single_scan, units)
    assert not search.is_contradicted(true)
    sensor = observation.scaled(np.asarray(single_scan.scan.sensor_origin, float).reshape(1, 3))[0]
    nearer = true.bases.copy()
    nearer[0, :3, 3] += 0.3 * (sensor - nearer[0, :3, 3]) / np.linalg.norm(sensor - nearer[0, :3, 3])
    assert search.is_contradicted(Candidates(nearer, true.values, NONE))


def test_what_a_mask_cuts_away_hardly_contradicts_a_tolerant_search(
    arm: pk.ArticulatedModel, single_scan: SimulatedScan, units: np.ndarray
) -> None:
    scan = single_scan.scan
    kept = scan.points[:, 0] > np.quantile(scan.points[:, 0], 0.4)
    cut = pk.Scan(scan.points[kept], sensor_origin=scan.sensor_origin)
    observation = observe(cut, arm.diagonal, ObservationOptions(), 2)
    search = TreeSearch(
        Sought(arm.kernel_model, arm.surfaces, SearchOptions(), 2),
        observation,
        SearchPrior.nothing(arm.values({}) / units),
    )
    true = true_candidate(arm, search, single_scan, units)
    assert search.is_contradicted(true)
    assert not search.tolerant().is_contradicted(true)
    # What the sensor saw something through is free all the same.
    sensor = observation.scaled(np.asarray(cut.sensor_origin, float).reshape(1, 3))[0]
    nearer = true.bases.copy()
    nearer[0, :3, 3] += 0.1 * (sensor - nearer[0, :3, 3]) / np.linalg.norm(sensor - nearer[0, :3, 3])
    assert search.tolerant().is_contradicted(Candidates(nearer, true.values, NONE))


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
            search.surfaces[part].samples[:20] @ T[:3, :3].T + T[:3, 3]
            for part, T in zip(hypotheses.parts, hypotheses.placements, strict=True)
        ]
        return [
            sum(float(np.linalg.norm(own.mean(axis=0) - points[piece].mean(axis=0))) < radius for own in placed)
            for piece in pieces
        ]

    assert min(beside(found)) > min(beside(whole))
    assert len(found.parts) <= len(pieces) * search.options.roots_per_piece


def test_views_from_all_sides_contradict_nothing(search: TreeSearch, right: Candidates) -> None:
    away = right.bases.copy()
    away[0, 0, 3] += 0.3
    assert not search.is_contradicted(Candidates(away, right.values, NONE))


def test_distinct_configurations_lie_apart(search: TreeSearch, right: Candidates) -> None:
    rng = np.random.default_rng(0)
    count, apart = 60, 0.03
    values = np.repeat(right.values, count, axis=0) + rng.normal(0, 0.15, (count, right.values.shape[1]))
    scores = rng.uniform(size=count).astype(np.float32)
    several = Candidates(np.repeat(right.bases, count, axis=0), values, scores)
    kept = search.distinct(several, count, apart)
    placed, positions = search.probe_positions(kept), search.probe_positions(several)
    between = np.linalg.norm(positions[:, None] - placed, axis=-1).mean(axis=-1)
    assert 1 < len(kept) < count
    assert (np.diff(kept.scores) <= 0).all()
    for dropped in np.flatnonzero(~np.isin(scores, kept.scores)):
        assert between[dropped, kept.scores > scores[dropped]].min() <= apart + 1e-6
    own = np.linalg.norm(placed[:, None] - placed, axis=-1).mean(axis=-1) + np.eye(len(kept))
    assert own.min() > apart - 1e-6


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
            Sought(model.kernel_model, model.surfaces, SearchOptions(), 2),
            observation,
            SearchPrior.nothing(np.zeros(3)),
        )
        true = true_candidate(model, search, made, np.ones(3))
        root = Hypotheses(np.zeros(1, np.int32), search.part_placements(true)[:, 0], np.ones(1, np.float32))
        best = search.scored(search.refined(search.grow(root, 8)))[0].best_first().take([0])
        apart = np.linalg.norm(search.probe_positions(best) - search.probe_positions(true), axis=-1)
        assert apart.mean() < 0.01, (z, y, x)


def test_normals_of_points_on_an_answer_are_compared_with_its_own(search: TreeSearch, right: Candidates) -> None:
    distance, part, cosine = search.lying(right)
    placements = search.part_placements(right)[0]
    on = distance < 0.005
    assert on.mean() > 0.9 and (part[on] >= 0).all()
    assert np.median(np.abs(cosine[on])) > 0.99
    assert (cosine[part < 0] == 0.0).all()
    turned = np.ascontiguousarray(placements @ np.diag([-1.0, -1.0, 1.0, 1.0]))
    part, sample = np.zeros(5, np.int32), np.arange(5, dtype=np.int32)
    normals = np.ascontiguousarray(search.surfaces[0].dense_normals[:5] @ placements[0, :3, :3].T, np.float32)
    np.testing.assert_allclose(search.native.facing(normals, placements, part, sample), 1.0, atol=1e-5)
    expected = 2.0 * search.surfaces[0].dense_normals[:5, 2] ** 2 - 1.0
    np.testing.assert_allclose(search.native.facing(normals, turned, part, sample), expected, atol=1e-5)


def test_fine_slats_explain_a_scan_that_shows_them_as_one_plane(tmp_path: Path) -> None:
    slats = "".join(SLAT.format(x=0.008 * i) for i in range(-20, 21))
    (tmp_path / "blind.urdf").write_text(BLIND.format(slats=slats))
    model = pk.ArticulatedModel.from_urdf(tmp_path / "blind.urdf")
    made = pk.simulate(model, pk.State(T_scan_base=np.eye(4), joints={"j": 0.3}), TIERS["full"], 0)
    observation = observe(made.scan, model.diagonal, ObservationOptions(), 2)

    def explained(surfaces: tuple[Surface, ...]) -> float:
        other = replace(model)
        vars(other)["surfaces"] = surfaces
        search = TreeSearch(
            Sought(other.kernel_model, surfaces, SearchOptions(), 2), observation, SearchPrior.nothing(np.zeros(1))
        )
        return float(search.coverage(true_candidate(model, search, made, np.ones(1)))[0])

    as_made = tuple(replace(s, apparent_normals=s.dense_normals) for s in model.surfaces)
    assert explained(model.surfaces) > explained(as_made) + 0.05


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
            Sought(model.kernel_model, model.surfaces, SearchOptions(), 1),
            observation,
            SearchPrior.nothing(np.zeros(2 * bones)),
        )
        true = true_candidate(model, search, made, np.ones(2 * bones))
        root = Hypotheses(np.zeros(1, np.int32), search.part_placements(true)[:, 0], np.ones(1, np.float32))
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


STRIP = """<link name="s{0}">
  <visual><origin xyz="0.1 0 0"/><geometry><box size="0.22 0.016 0.003"/></geometry></visual></link>"""
PIVOT = """<joint name="p{1}" type="revolute"><parent link="s{0}"/><child link="s{1}"/>
  <origin xyz="0.2 0 0.0035"/><axis xyz="0 0 1"/><limit lower="-3" upper="3" effort="1" velocity="1"/></joint>"""


def test_a_thin_part_off_the_scan_lacks_however_much_area_noise_gives_the_others(tmp_path: Path) -> None:
    strips = "".join(STRIP.format(i) for i in range(5)) + "".join(PIVOT.format(i, i + 1) for i in range(4))
    (tmp_path / "rule.urdf").write_text(f'<robot name="rule">{strips}</robot>')
    rule = pk.ArticulatedModel.from_urdf(tmp_path / "rule.urdf")
    truth = pk.State(np.eye(4), dict(zip(rule.joint_names, (0.9, -1.1, 1.2, 0.8), strict=True)))
    made = pk.simulate(rule, truth, TIERS["hololens"], seed=0)
    observation = observe(made.scan, rule.diagonal, ObservationOptions(), 1)
    search = TreeSearch(
        Sought(rule.kernel_model, rule.surfaces, SearchOptions(), 1), observation, SearchPrior.nothing(rule.values({}))
    )
    right = true_candidate(rule, search, made, np.ones(4))
    off = Candidates(right.bases, right.values + np.array([0.0, 0.0, 0.0, 1.5]), NONE)
    assert search.explained_shares(search.owners(right, search.exists)[1]).min() > 1.5
    assert not search.lacks(right).any()
    assert search.lacks(off).tolist() == [False, False, False, False, True]


def test_looks_at_an_answer_are_kept_and_never_mistaken_for_those_at_another(
    search: TreeSearch, right: Candidates
) -> None:
    fresh = search.widened()
    seen = fresh.scored(right)[0].scores, *fresh.owners(right, fresh.exists), *fresh.given_owners(right)
    others = [Candidates(right.bases, right.values + 0.05 * i, right.scores) for i in range(1, 2 * REMEMBERED)]
    apart = [(fresh.scored(one)[0].scores, fresh.owners(one, fresh.exists)[0]) for one in others]
    again = fresh.scored(right)[0].scores, *fresh.owners(right, fresh.exists), *fresh.given_owners(right)
    for before, after in zip(seen, again, strict=True):
        np.testing.assert_array_equal(before, after)
    assert all(score != seen[0] and (distance != seen[1]).any() for score, distance in apart)
    without = fresh.exists & (np.arange(len(fresh.exists)) > 0)
    assert (fresh.owners(right, without)[1] != 0).all() and (fresh.owners(right, fresh.exists)[1] == 0).any()
    with pytest.raises(ValueError, match="read-only"):
        fresh.owners(right, fresh.exists)[0][0] = 0.0
