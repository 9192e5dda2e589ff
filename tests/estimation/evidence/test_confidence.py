"""What confidence is computed from, and that it tells right answers from wrong ones."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from good_evidence import GOOD

import pwralign_kin as pk
from pwralign_kin import se3
from pwralign_kin.estimation.comparison.candidates import Candidates
from pwralign_kin.estimation.comparison.scan_comparison import ScanComparison, Sought
from pwralign_kin.estimation.comparison.search_options import SearchOptions
from pwralign_kin.estimation.evidence.confidence import confidence
from pwralign_kin.estimation.evidence.evidence import Evidence, _distinctness, gathered
from pwralign_kin.estimation.evidence.soundness import soundness
from pwralign_kin.estimation.knowledge.prior import SearchPrior
from pwralign_kin.estimation.sensing.observation import ObservationOptions
from pwralign_kin.estimation.sensing.preparation import observe
from pwralign_kin.simulation import TIERS, SimulatedScan

FAIR = dataclasses.replace(GOOD, distinct=4.0, told=2.0, ahead=0.1)
"""An answer that is not so good that one more doubt would hardly count."""


def evidence(comparison: ScanComparison, arm: pk.ArticulatedModel, state: pk.State, units: np.ndarray) -> Evidence:
    base = comparison.observation.to_search(arm.root_placement(state))
    final = Candidates(base[None], (arm.values(state.joints) / units)[None], np.zeros(1, np.float32))
    return gathered(comparison, final, final)


def shifted(state: pk.State, by: float) -> pk.State:
    """The state with its base moved by as much (m) along each axis."""
    T = state.T_scan_base.copy()
    T[:3, 3] += by
    return dataclasses.replace(state, T_scan_base=T)


def test_the_truth_has_all_evidence_for_it(
    comparison: ScanComparison, arm: pk.ArticulatedModel, full_scan: SimulatedScan, units: np.ndarray
) -> None:
    found = evidence(comparison, arm, full_scan.state, units)
    assert found.nearby < 0.01
    assert found.lacking == 0.0
    assert found.uneven < 1.5
    assert found.margin > 0.02
    assert found.distinct > 8.0
    assert found.astray < 0.02
    assert confidence(found) > 0.9
    assert soundness(found) > 0.9


def test_a_wrong_limb_leaves_points_a_part_without_any_and_a_better_rival(
    comparison: ScanComparison, arm: pk.ArticulatedModel, full_scan: SimulatedScan, units: np.ndarray
) -> None:
    true = full_scan.state
    elbow = true.joints["elbow"]
    wrong = dataclasses.replace(true, joints={**true.joints, "elbow": elbow - 1.5 * np.sign(elbow)})
    found = evidence(comparison, arm, wrong, units)
    assert found.nearby > 0.01
    assert found.lacking > 0.1
    assert found.margin < 0.0
    assert found.distinct < 0.0
    assert confidence(found) < 0.3
    assert soundness(found) < 0.2


def test_noise_and_few_points_make_answers_alike(arm: pk.ArticulatedModel) -> None:
    clear, noisy, few = (
        pk.estimate(arm, pk.simulate(arm, sensor=sensor, seed=4).scan).evidence.distinct
        for sensor in (pk.Sensor(noise=0.002), pk.Sensor(noise=0.02), pk.Sensor(noise=0.002, points=300))
    )
    assert noisy < 0.8 * clear
    assert few < 0.4 * clear


def test_surface_that_noise_does_not_explain_is_astray(
    comparison: ScanComparison, arm: pk.ArticulatedModel, full_scan: SimulatedScan, units: np.ndarray
) -> None:
    found = evidence(comparison, arm, shifted(full_scan.state, 0.015 * arm.diagonal), units)
    assert found.strange < 0.05
    assert found.astray > 0.1


def test_what_is_not_searched_is_not_astray(
    comparison: ScanComparison, arm: pk.ArticulatedModel, full_scan: SimulatedScan, units: np.ndarray
) -> None:
    """Rounding made the share of what is astray negative, and the confidence no number."""
    observation, state = comparison.observation, shifted(full_scan.state, 0.015 * arm.diagonal)
    final = Candidates.single(observation.to_search(arm.root_placement(state)), arm.values(state.joints) / units)
    regions = np.where(comparison.lying(final)[0] > comparison.noise_reach, -1, 0).astype(np.int32)
    assert (regions < 0).any()
    for seed in range(10):
        areas = np.random.default_rng(seed).uniform(0.5, 2.0, len(regions)).astype(np.float32)
        other = comparison.of(dataclasses.replace(observation, areas=areas, regions=regions))
        assert gathered(other, final, final).astray >= 0.0


@pytest.mark.parametrize(
    "worse",
    [
        {"nearby": 0.05},
        {"lacking": 0.3},
        {"uneven": 3.0},
        {"distinct": 0.0},
        {"told": 0.0},
        {"ahead": 0.0},
        {"noise": 0.03},
        {"shown": 0.1},
        {"in_sight": 0.5, "strange": 0.3},
        {"in_sight": 0.5, "astray": 0.3},
        {"refuted": 0.5},
        {"continued": 0.5},
        {"size_gain": 0.05},
    ],
    ids=lambda worse: " ".join(worse),
)
def test_every_doubt_lowers_the_confidence(worse: dict[str, float]) -> None:
    assert confidence(FAIR) > 0.9
    assert confidence(dataclasses.replace(FAIR, **worse)) < confidence(FAIR) - 0.01


def test_holes_of_a_scan_count_only_beside_what_is_not_of_the_model() -> None:
    torn = dataclasses.replace(GOOD, in_sight=0.4)
    odd = {"strange": 0.1, "astray": 0.1}
    assert confidence(torn) > confidence(GOOD) - 0.01
    assert confidence(dataclasses.replace(torn, **odd)) < confidence(dataclasses.replace(GOOD, **odd)) - 0.1


@pytest.mark.parametrize("less", [{"agreed": 0.5}, {"explained": 0.5}], ids=str)
def test_what_a_scan_shows_besides_counts_only_beside_what_is_not_of_the_model(less: dict[str, float]) -> None:
    odd = dataclasses.replace(GOOD, strange=0.05, astray=0.05)
    assert confidence(dataclasses.replace(GOOD, **less)) == confidence(GOOD)
    assert confidence(dataclasses.replace(odd, **less)) < confidence(odd) - 0.02


@pytest.mark.parametrize("worse", [{"nearby": 0.05}, {"margin": -0.01}, {"borne_out": 0.15}], ids=str)
def test_every_doubt_makes_an_answer_less_sound(worse: dict[str, float]) -> None:
    assert soundness(GOOD) > 0.85
    assert soundness(dataclasses.replace(GOOD, **worse)) < soundness(GOOD) - 0.01


def test_what_else_the_scan_holds_does_not_count_against_the_answer(arm: pk.ArticulatedModel) -> None:
    cluttered = pk.simulate(arm, sensor=TIERS["clutter"], seed=4)
    estimate = pk.estimate(arm, cluttered.scan)
    assert estimate.scan_coverage < 0.7
    assert estimate.confidence > 0.7
    assert estimate.to_dict()["evidence"]["margin"] == estimate.evidence.margin


@pytest.mark.parametrize("size", [0.15, 0.3])
def test_a_box_is_hardly_taken_for_an_arm(arm: pk.ArticulatedModel, size: float) -> None:
    random = np.random.default_rng(0)
    points = random.uniform(-1.0, 1.0, (4000, 3))
    side = random.integers(3, size=len(points))
    points[np.arange(len(points)), side] = np.sign(points[np.arange(len(points)), side])
    estimate = pk.estimate(arm, pk.Scan(size * points * (1.0, 0.7, 0.5)))
    assert estimate.confidence < 0.2


def test_an_answer_that_explains_nothing_has_no_evidence_for_it(
    comparison: ScanComparison, arm: pk.ArticulatedModel, full_scan: SimulatedScan, units: np.ndarray
) -> None:
    found = evidence(comparison, arm, shifted(full_scan.state, 100.0 * arm.diagonal), units)
    assert found.lacking == 1.0
    assert found.borne_out == 0.0
    assert confidence(found) < 0.05


def test_what_a_view_does_not_show_is_not_missed(arm: pk.ArticulatedModel) -> None:
    full, single = (pk.simulate(arm, sensor=TIERS[tier], seed=4) for tier in ("full", "single"))
    found = pk.estimate(arm, single.scan).evidence
    assert found.in_sight > 0.8
    # As if it were of all sides.
    blind = pk.estimate(arm, pk.Scan(single.scan.points), initial=single.state).evidence
    assert blind.in_sight < 0.75
    assert found.shown > 0.5 and blind.shown == 1.0
    assert pk.estimate(arm, full.scan).evidence.in_sight > 0.8
    half = full.scan.points[full.scan.points[:, 0] < np.median(full.scan.points[:, 0])]
    torn = pk.estimate(arm, pk.Scan(half), initial=full.state).evidence
    assert torn.in_sight == pytest.approx(0.5, abs=0.15)
    assert torn.agreed > 0.8
    assert torn.explained > 0.95


def test_an_answer_behind_what_a_view_saw_hides_its_surface(
    comparison: ScanComparison, arm: pk.ArticulatedModel, units: np.ndarray
) -> None:
    seen = pk.simulate(arm, sensor=TIERS["single"], seed=4)
    origin = seen.view_origins[0]
    rays = seen.scan.points - origin
    before = origin + rays * (1.0 - 0.1 * arm.diagonal / np.linalg.norm(rays, axis=1, keepdims=True))
    shown, hidden = (
        evidence(
            comparison.of(observe(pk.Scan(points, sensor_origin=origin), arm.diagonal, ObservationOptions(), 2)),
            arm, seen.state, units,
        ).shown
        for points in (seen.scan.points, before)
    )  # fmt: skip
    assert hidden < 0.4 * shown


def test_surface_that_points_cross_does_not_agree_with_them(
    comparison: ScanComparison, arm: pk.ArticulatedModel, full_scan: SimulatedScan, units: np.ndarray
) -> None:
    true = full_scan.state
    turned = true.T_scan_base.copy()
    turned[:3, :3] = turned[:3, :3] @ se3.from_twist(np.array([0.6, 0.6, 0.0, 0.0, 0.0, 0.0]))[:3, :3]
    right, wrong = (
        evidence(comparison, arm, state, units) for state in (true, dataclasses.replace(true, T_scan_base=turned))
    )
    assert right.agreed > 0.8
    assert wrong.agreed < right.agreed - 0.15
    assert wrong.explained < right.explained - 0.2


def test_points_that_err_together_prefer_a_rival_by_no_more_than_their_patches(
    comparison: ScanComparison, arm: pk.ArticulatedModel, full_scan: SimulatedScan, units: np.ndarray
) -> None:
    placed = [
        comparison.observation.to_search(arm.root_placement(state))
        for state in (shifted(full_scan.state, 0.01 * arm.diagonal), full_scan.state)
    ]
    values = np.tile(arm.values(full_scan.state.joints) / units, (2, 1))
    bent = Candidates(np.array(placed), values, np.zeros(2, np.float32))
    (worse,), (better,) = _distinctness(comparison, bent), _distinctness(comparison, bent.take([1, 0]))
    assert better > 15.0
    assert -8.0 < worse < -1.0


def test_in_a_scene_points_oriented_otherwise_do_not_speak_for_a_rival(
    comparison: ScanComparison, arm: pk.ArticulatedModel, full_scan: SimulatedScan, units: np.ndarray
) -> None:
    observation = comparison.observation
    base = observation.to_search(arm.root_placement(full_scan.state))
    values = np.tile(arm.values(full_scan.state.joints) / units, (2, 1))
    values[1, arm.joint_names.index("elbow")] -= 0.8 * np.sign(full_scan.state.joints["elbow"])
    both = Candidates(np.array([base, base]), values, np.zeros(2, np.float32))
    last = int(comparison.exists.nonzero()[0][-1])
    placed = comparison.part_placements(both)[1, last]
    surface = comparison.surfaces[last]
    elsewhere, normals = surface.samples @ placed[:3, :3].T + placed[:3, 3], surface.normals @ placed[:3, :3].T
    across = np.cross(normals, np.roll(normals, 1, axis=1))
    across /= np.linalg.norm(across, axis=1, keepdims=True)

    def distinct(normals: np.ndarray, scene: bool) -> float:
        points = np.concatenate([observation.given, *[elsewhere] * 20]).astype(np.float32)
        directions = np.concatenate([observation.given_normals, *[normals] * 20]).astype(np.float32)
        seen = dataclasses.replace(observation, given=points, given_normals=directions, scene=scene)
        return float(_distinctness(comparison.of(seen), both)[0])

    assert distinct(normals, True) < -5.0
    assert distinct(across, False) < -5.0
    assert distinct(across, True) > 5.0


def test_a_face_that_lies_on_something_else_bears_next_to_nothing_of_the_model_out() -> None:
    root = Path(__file__).parents[3] / "robots"
    excavator = pk.ArticulatedModel.from_urdf(root / "excavator" / "excavator.urdf")
    found = pk.estimate(excavator, pk.Scan.load(root / "laptop" / "scans" / "full.ply"))
    assert found.evidence.borne_out < 0.1
    assert found.confidence < 0.5
    assert confidence(dataclasses.replace(GOOD, borne_out=0.15)) > 0.9


def test_few_points_a_part_are_little_to_go_by() -> None:
    chances = [confidence(dataclasses.replace(FAIR, points_per_part=count)) for count in (1.0, 6.0, 15.0, 300.0)]
    assert chances[0] < chances[1] - 0.01 < chances[2] - 0.02
    assert chances[2] == chances[3]


def test_where_the_sensor_bends_surfaces_what_is_hardly_a_rival_tells_nothing() -> None:
    near, none = (dataclasses.replace(GOOD, astray=0.45, told=told) for told in (-10.0, 8.0))
    assert confidence(near) == confidence(none)


def test_what_is_hardly_a_rival_is_told_from_the_answer_too(arm: pk.ArticulatedModel) -> None:
    found = pk.estimate(arm, pk.simulate(arm, sensor=pk.Sensor(noise=0.01, points=600), seed=4).scan).evidence
    assert found.told <= found.distinct
    assert found.refuted == 0.0


def test_a_view_looks_past_surface_that_is_not_there(arm: pk.ArticulatedModel) -> None:
    seen = pk.simulate(arm, sensor=TIERS["single"], seed=4)
    estimate = pk.estimate(arm, seen.scan)
    assert estimate.evidence.refuted < 0.1
    assert estimate.confidence > 0.8
    ahead = seen.scan.points[np.argsort(seen.scan.points[:, 0])[: len(seen.scan.points) // 3]]
    torn = pk.estimate(arm, pk.Scan(ahead, sensor_origin=seen.scan.sensor_origin), initial=seen.state)
    assert torn.evidence.refuted > 0.2


@pytest.mark.parametrize(("points", "least", "most"), [(40, 0.2, 0.7), (4000, 0.0, 0.05)])
def test_what_few_points_leave_unexplained_beside_the_model_is_strange(
    arm: pk.ArticulatedModel, units: np.ndarray, points: int, least: float, most: float
) -> None:
    # Of so few, hardly any of another thing is as near to the model as those of many are.
    made = pk.simulate(arm, sensor=pk.Sensor(views=6, points=points), seed=3)
    random = np.random.default_rng(0)
    directions = random.normal(size=(len(made.scan.points), 3))
    about = 0.55 * arm.diagonal * directions / np.linalg.norm(directions, axis=1)[:, None]
    beside = made.scan.points.mean(axis=0) + about
    observation = observe(pk.Scan(np.concatenate([made.scan.points, beside])), arm.diagonal, ObservationOptions(), 1)
    sought = Sought(arm.kernel_model, arm.surfaces, SearchOptions(), 1)
    comparison = ScanComparison(sought, observation, SearchPrior.nothing(arm.values({}) / units))
    assert least <= evidence(comparison, arm, made.state, units).strange <= most
