"""Configurations compared with a scan: scores, what a view contradicts, what lacks, and what is remembered."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from truths import true_candidate

import pwralign_kin as pk
from pwralign_kin.estimation.comparison.candidates import Candidates
from pwralign_kin.estimation.comparison.scan_comparison import REMEMBERED, ScanComparison, Sought
from pwralign_kin.estimation.comparison.search_options import SearchOptions
from pwralign_kin.estimation.knowledge.prior import SearchPrior
from pwralign_kin.estimation.sensing.observation import ObservationOptions
from pwralign_kin.estimation.sensing.preparation import observe
from pwralign_kin.model.surface import Surface
from pwralign_kin.simulation import TIERS, SimulatedScan

NONE = np.zeros(1, np.float32)

SLAT = '<visual><origin xyz="{x:.3f} 0 0" rpy="0 0.8 0"/><geometry><box size="0.001 0.3 0.014"/></geometry></visual>'


BLIND = """<robot name="blind">
  <link name="slats">{slats}</link>
  <link name="bar"><visual><geometry><box size="0.3 0.03 0.03"/></geometry></visual></link>
  <joint name="j" type="revolute"><parent link="slats"/><child link="bar"/><origin xyz="-0.17 0 0"/><axis xyz="0 1 0"/>
    <limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
</robot>"""


@pytest.mark.parametrize("base_moves", [False, True])
def test_what_a_sweep_finds_scores_as_whole_configurations_do(
    arm: pk.ArticulatedModel, single_scan: SimulatedScan, units: np.ndarray, base_moves: bool
) -> None:
    few = pk.Scan(single_scan.scan.points[::25], sensor_origin=single_scan.scan.sensor_origin)
    observation = observe(few, arm.diagonal, ObservationOptions(), 1)
    assert len(observation.points) <= 350  # a sweep looks at no more of them at first
    comparison = ScanComparison(
        Sought(arm.kernel_model, arm.surfaces, SearchOptions(), 1),
        observation,
        SearchPrior.nothing(arm.values({}) / units),
    )
    true = true_candidate(arm, observation, single_scan, units)
    joints = np.arange(true.values.shape[1], dtype=np.int32)
    swept = comparison.swept(true, joints, np.full(len(joints), base_moves), 4)
    assert len(swept) > len(joints)
    np.testing.assert_allclose(swept.scores, comparison.scored(swept)[0].scores, atol=1e-4)
    # No score is left out that is not behind, and none is told that is.
    behind = 0.1
    best = comparison.swept(true, joints, np.full(len(joints), base_moves), 4, behind=behind)
    near = swept.take(swept.scores > comparison.scored(true)[0].scores[0] - behind)
    assert 0 < len(near) < len(swept)
    np.testing.assert_array_equal(best.values, near.values)
    np.testing.assert_array_equal(best.scores, near.scores)


def test_a_view_contradicts_surface_in_free_space(
    arm: pk.ArticulatedModel, single_scan: SimulatedScan, units: np.ndarray
) -> None:
    observation = observe(single_scan.scan, arm.diagonal, ObservationOptions(), 2)
    comparison = ScanComparison(
        Sought(arm.kernel_model, arm.surfaces, SearchOptions(), 2),
        observation,
        SearchPrior.nothing(arm.values({}) / units),
    )
    true = true_candidate(arm, observation, single_scan, units)
    assert not comparison.is_contradicted(true)
    sensor = observation.scaled(np.asarray(single_scan.scan.sensor_origin, float).reshape(1, 3))[0]
    nearer = true.bases.copy()
    nearer[0, :3, 3] += 0.3 * (sensor - nearer[0, :3, 3]) / np.linalg.norm(sensor - nearer[0, :3, 3])
    assert comparison.is_contradicted(Candidates(nearer, true.values, NONE))


def test_what_a_mask_cuts_away_hardly_contradicts_a_tolerant_comparison(
    arm: pk.ArticulatedModel, single_scan: SimulatedScan, units: np.ndarray
) -> None:
    scan = single_scan.scan
    kept = scan.points[:, 0] > np.quantile(scan.points[:, 0], 0.4)
    cut = pk.Scan(scan.points[kept], sensor_origin=scan.sensor_origin)
    observation = observe(cut, arm.diagonal, ObservationOptions(), 2)
    comparison = ScanComparison(
        Sought(arm.kernel_model, arm.surfaces, SearchOptions(), 2),
        observation,
        SearchPrior.nothing(arm.values({}) / units),
    )
    true = true_candidate(arm, observation, single_scan, units)
    assert comparison.is_contradicted(true)
    assert not comparison.tolerant().is_contradicted(true)
    # What the sensor saw something through is free all the same.
    sensor = observation.scaled(np.asarray(cut.sensor_origin, float).reshape(1, 3))[0]
    nearer = true.bases.copy()
    nearer[0, :3, 3] += 0.1 * (sensor - nearer[0, :3, 3]) / np.linalg.norm(sensor - nearer[0, :3, 3])
    assert comparison.tolerant().is_contradicted(Candidates(nearer, true.values, NONE))


def test_views_from_all_sides_contradict_nothing(comparison: ScanComparison, right: Candidates) -> None:
    away = right.bases.copy()
    away[0, 0, 3] += 0.3
    assert not comparison.is_contradicted(Candidates(away, right.values, NONE))


def test_distinct_configurations_lie_apart(comparison: ScanComparison, right: Candidates) -> None:
    rng = np.random.default_rng(0)
    count, apart = 60, 0.03
    values = np.repeat(right.values, count, axis=0) + rng.normal(0, 0.15, (count, right.values.shape[1]))
    scores = rng.uniform(size=count).astype(np.float32)
    several = Candidates(np.repeat(right.bases, count, axis=0), values, scores)
    kept = comparison.distinct(several, count, apart)
    placed, positions = comparison.probe_positions(kept), comparison.probe_positions(several)
    between = np.linalg.norm(positions[:, None] - placed, axis=-1).mean(axis=-1)
    assert 1 < len(kept) < count
    assert (np.diff(kept.scores) <= 0).all()
    for dropped in np.flatnonzero(~np.isin(scores, kept.scores)):
        assert between[dropped, kept.scores > scores[dropped]].min() <= apart + 1e-6
    own = np.linalg.norm(placed[:, None] - placed, axis=-1).mean(axis=-1) + np.eye(len(kept))
    assert own.min() > apart - 1e-6


def test_normals_of_points_on_an_answer_are_compared_with_its_own(
    comparison: ScanComparison, right: Candidates
) -> None:
    distance, part, cosine = comparison.lying(right)
    placements = comparison.part_placements(right)[0]
    on = distance < 0.005
    assert on.mean() > 0.9 and (part[on] >= 0).all()
    assert np.median(np.abs(cosine[on])) > 0.99
    assert (cosine[part < 0] == 0.0).all()
    turned = np.ascontiguousarray(placements @ np.diag([-1.0, -1.0, 1.0, 1.0]))
    part, sample = np.zeros(5, np.int32), np.arange(5, dtype=np.int32)
    normals = np.ascontiguousarray(comparison.surfaces[0].dense_normals[:5] @ placements[0, :3, :3].T, np.float32)
    np.testing.assert_allclose(comparison.native.facing(normals, placements, part, sample), 1.0, atol=1e-5)
    expected = 2.0 * comparison.surfaces[0].dense_normals[:5, 2] ** 2 - 1.0
    np.testing.assert_allclose(comparison.native.facing(normals, turned, part, sample), expected, atol=1e-5)


def test_fine_slats_explain_a_scan_that_shows_them_as_one_plane(tmp_path: Path) -> None:
    slats = "".join(SLAT.format(x=0.008 * i) for i in range(-20, 21))
    (tmp_path / "blind.urdf").write_text(BLIND.format(slats=slats))
    model = pk.ArticulatedModel.from_urdf(tmp_path / "blind.urdf")
    made = pk.simulate(model, pk.State(T_scan_base=np.eye(4), joints={"j": 0.3}), TIERS["full"], 0)
    observation = observe(made.scan, model.diagonal, ObservationOptions(), 2)

    def explained(surfaces: tuple[Surface, ...]) -> float:
        other = replace(model)
        vars(other)["surfaces"] = surfaces
        comparison = ScanComparison(
            Sought(other.kernel_model, surfaces, SearchOptions(), 2), observation, SearchPrior.nothing(np.zeros(1))
        )
        return float(comparison.coverage(true_candidate(model, observation, made, np.ones(1)))[0])

    as_made = tuple(replace(s, apparent_normals=s.dense_normals) for s in model.surfaces)
    assert explained(model.surfaces) > explained(as_made) + 0.05


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
    comparison = ScanComparison(
        Sought(rule.kernel_model, rule.surfaces, SearchOptions(), 1),
        observation,
        SearchPrior.nothing(rule.values({})),
    )
    right = true_candidate(rule, observation, made, np.ones(4))
    off = Candidates(right.bases, right.values + np.array([0.0, 0.0, 0.0, 1.5]), NONE)
    assert comparison.explained_shares(comparison.owners(right, comparison.exists)[1]).min() > 1.5
    assert not comparison.lacks(right).any()
    assert comparison.lacks(off).tolist() == [False, False, False, False, True]


def test_looks_at_an_answer_are_kept_and_never_mistaken_for_those_at_another(
    comparison: ScanComparison, right: Candidates
) -> None:
    fresh = comparison.knowing(comparison.known)
    seen = (
        fresh.scored(right)[0].scores,
        *fresh.owners(right, fresh.exists),
        *fresh.given_owners(right),
    )
    others = [Candidates(right.bases, right.values + 0.05 * i, right.scores) for i in range(1, 2 * REMEMBERED)]
    apart = [(fresh.scored(one)[0].scores, fresh.owners(one, fresh.exists)[0]) for one in others]
    again = (
        fresh.scored(right)[0].scores,
        *fresh.owners(right, fresh.exists),
        *fresh.given_owners(right),
    )
    for before, after in zip(seen, again, strict=True):
        np.testing.assert_array_equal(before, after)
    assert all(score != seen[0] and (distance != seen[1]).any() for score, distance in apart)
    without = fresh.exists & (np.arange(len(fresh.exists)) > 0)
    assert (fresh.owners(right, without)[1] != 0).all() and (fresh.owners(right, fresh.exists)[1] == 0).any()
    with pytest.raises(ValueError, match="read-only"):
        fresh.owners(right, fresh.exists)[0][0] = 0.0


def test_a_comparison_by_another_prior_leaves_the_first_as_it_was(
    arm: pk.ArticulatedModel, comparison: ScanComparison, right: Candidates
) -> None:
    """The prior was rewritten and put back: an error in between left the wrong one."""
    before = comparison.scored(right)[0].scores, comparison.base_prior(right.bases[0])
    known = replace(comparison.known, placement=right.bases[0], translation_std=0.01, rotation_std=0.01)
    other = comparison.knowing(known)
    assert other.known is known and comparison.known is not known
    assert (other.base_prior(right.bases[0])[0] != before[1][0]).any()
    after = comparison.scored(right)[0].scores, comparison.base_prior(right.bases[0])
    for one, again in zip((before[0], *before[1]), (after[0], *after[1]), strict=True):
        np.testing.assert_array_equal(one, again)
