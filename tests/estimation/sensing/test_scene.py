"""The model in whole scenes: what is told from it, what is searched, and that it is found."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import pwralign_kin as pk
from pwralign_kin.benchmark.metrics import Ruler
from pwralign_kin.estimation import Correspondences
from pwralign_kin.estimation.answers.answer_search import AnswerSearch
from pwralign_kin.estimation.knowledge.correspondences import FpfhMatcher
from pwralign_kin.estimation.search.candidates import Candidates, Hypotheses
from pwralign_kin.estimation.search.face_hypotheses import FaceOptions
from pwralign_kin.estimation.search.scene_search import RegionSearch, SceneSearchOptions, unlike
from pwralign_kin.estimation.search.tree_search import SearchOptions, TreeSearch
from pwralign_kin.estimation.sensing.observation import Observation, ObservationOptions
from pwralign_kin.estimation.sensing.scene import SceneOptions, close_up, is_scene, observe_scene, surroundings_of
from pwralign_kin.estimation.stopwatch import Stopwatch
from pwralign_kin.exceptions import CorrespondenceError, ScanError
from pwralign_kin.se3 import inverse, transform
from pwralign_kin.simulation import TIERS, Room, SimulatedScan, simulate_scene

pytest.importorskip("open3d", reason="ray casting needs Open3D and its system libraries", exc_type=ImportError)

EVERYWHERE = (np.full(3, -np.inf), np.full(3, np.inf))


@pytest.fixture(scope="module")
def excavator(robots_folder: Path) -> pk.ArticulatedModel:
    return pk.ArticulatedModel.from_urdf(robots_folder / "excavator" / "excavator.urdf")


@pytest.fixture(scope="module")
def scene(excavator: pk.ArticulatedModel) -> SimulatedScan:
    return simulate_scene(excavator, room=Room(contacts=1), seed=14)


def observed(
    model: pk.ArticulatedModel, scan: pk.Scan, box: tuple[np.ndarray, np.ndarray] = EVERYWHERE, threads: int = 2
) -> Observation:
    return observe_scene(scan, model.surfaces, model.diagonal, box, ObservationOptions(), SceneOptions(), threads)


def searching(model: pk.ArticulatedModel, ready: Observation) -> TreeSearch:
    return TreeSearch(model.kernel_model, model.surfaces, ready, model.values({}), SearchOptions(), 2)


def true_and_moved(model: pk.ArticulatedModel, made: SimulatedScan, ready: Observation) -> Candidates:
    """Return the truth and, beside it, the same 0.1 diagonals aside."""
    bases = np.tile(ready.to_search(model.root_placement(made.state)), (2, 1, 1))
    bases[1, 0, 3] += 0.1
    return Candidates(bases, np.tile(model.values(made.state.joints), (2, 1)), np.zeros(2, np.float32))


def searched_points(ready: Observation) -> np.ndarray:
    return ready.points[ready.regions >= 0].astype(float) * ready.diagonal + ready.centre


def taken_for_scene(model: pk.ArticulatedModel, scan: pk.Scan) -> bool:
    return is_scene(scan, model.diagonal, model.reach, SceneOptions(), ObservationOptions(), 2)


def test_a_scan_of_the_model_alone_is_no_scene(excavator: pk.ArticulatedModel, scene: SimulatedScan) -> None:
    alone = pk.Scan(scene.scan.points[scene.labels >= 0], sensor_origin=np.zeros(3))

    assert taken_for_scene(excavator, scene.scan)
    assert not taken_for_scene(excavator, alone)


def test_a_model_cut_out_with_the_floor_it_stands_on_is_a_scene(
    excavator: pk.ArticulatedModel, scene: SimulatedScan
) -> None:
    upright = transform(inverse(scene.state.T_scan_base), scene.scan.points)
    own = upright[scene.labels >= 0]
    margin = 0.2 * excavator.diagonal
    near = ((upright > own.min(axis=0) - margin) & (upright < own.max(axis=0) + margin)).all(axis=1)
    cut_out = pk.Scan(scene.scan.points[near], sensor_origin=np.zeros(3))

    assert np.ptp(cut_out.points, axis=0).max() < 1.5 * excavator.diagonal
    assert taken_for_scene(excavator, cut_out)


def test_walls_and_floors_are_surroundings_and_the_model_is_searched(
    excavator: pk.ArticulatedModel, scene: SimulatedScan
) -> None:
    from scipy.spatial import cKDTree

    ready = observed(excavator, scene.scan)

    searched = searched_points(ready)
    own = scene.scan.points[scene.labels >= 0]
    assert (cKDTree(searched).query(own)[0] < 0.03 * ready.diagonal).mean() > 0.9
    assert len(searched) < 0.5 * len(scene.scan.points)
    assert (ready.weights[ready.regions < 0] < 1).all()


def test_only_the_box_is_searched(excavator: pk.ArticulatedModel, scene: SimulatedScan) -> None:
    low, high = (getattr(scene.scan.points[scene.labels >= 0], side)(axis=0) for side in ("min", "max"))
    ready = observed(excavator, scene.scan, (low, high))

    searched = searched_points(ready)
    margin = 0.02 * ready.diagonal
    assert ((searched > low - margin) & (searched < high + margin)).all()
    with pytest.raises(ScanError, match="what is to be searched"):
        observed(excavator, scene.scan, (low + 100.0, high + 100.0))


def test_the_field_of_a_scene_does_not_depend_on_the_threads(
    excavator: pk.ArticulatedModel, scene: SimulatedScan
) -> None:
    several = [observed(excavator, scene.scan, threads=threads) for threads in (1, 3)]
    scores = [
        searching(excavator, ready).scored(true_and_moved(excavator, scene, ready))[0].scores for ready in several
    ]
    assert np.array_equal(*scores)


def test_scores_about_a_configuration_are_those_of_the_whole_scene(
    excavator: pk.ArticulatedModel, scene: SimulatedScan
) -> None:
    ready = observed(excavator, scene.scan)
    search, candidates = searching(excavator, ready), true_and_moved(excavator, scene, ready)

    about = search.about(candidates.take([0]), 0.2)

    assert about.searched.sum() < 0.8 * search.searched.sum()
    assert not (about.searched & ~search.searched).any()
    assert about.scored(candidates)[0].scores == pytest.approx(search.scored(candidates)[0].scores, abs=0.02)
    assert about.unexplained(candidates.take([0])) == pytest.approx(search.unexplained(candidates.take([0])))


def test_a_configuration_with_nothing_near_it_is_compared_with_the_whole_scene(
    excavator: pk.ArticulatedModel, scene: SimulatedScan
) -> None:
    ready = observed(excavator, scene.scan)
    search, candidates = searching(excavator, ready), true_and_moved(excavator, scene, ready)
    astray = Candidates(candidates.bases[:1].copy(), candidates.values[:1], candidates.scores[:1])
    astray.bases[0, :3, 3] += 50.0

    about = search.about(astray, 0.35)

    assert np.array_equal(about.searched, search.searched)
    assert np.isfinite(about.scored(astray)[0].scores).all()


def against(model: pk.ArticulatedModel, made: SimulatedScan, points: np.ndarray, unreturned: float) -> float:
    """Return how much of the model's surface, at the truth, a view of `points` speaks against."""
    scan, options = pk.Scan(points, sensor_origin=np.zeros(3)), SceneOptions(unreturned=unreturned)
    ready = observe_scene(scan, model.surfaces, model.diagonal, EVERYWHERE, ObservationOptions(), options, 2)
    search = searching(model, ready)
    support = search.scored(true_and_moved(model, made, ready).take([0]))[1][0]
    return -float(support @ (search.weights * search.exists))


def test_a_hole_in_the_view_says_less_against_the_model_than_what_is_seen_behind_it(
    excavator: pk.ArticulatedModel, scene: SimulatedScan
) -> None:
    points, unreturned = scene.scan.points.astype(float), SceneOptions().unreturned
    own = np.flatnonzero(scene.labels >= 0)
    rays = points / np.linalg.norm(points, axis=1, keepdims=True)
    hole = np.linalg.norm(rays - rays[own[len(own) // 2]], axis=1) < 0.06
    seen_through = np.where(hole[:, None], 2.0 * points, points)

    whole = against(excavator, scene, points, unreturned)
    silent = against(excavator, scene, points[~hole], unreturned) - whole
    through = against(excavator, scene, seen_through, unreturned) - whole
    assert through > 0.02
    assert 0.0 < silent < 0.6 * through


def test_surface_out_of_the_picture_has_little_against_it(excavator: pk.ArticulatedModel, scene: SimulatedScan) -> None:
    points = scene.scan.points.astype(float)
    columns = points[:, 0] / points[:, 2]
    pictured = points[columns < np.median(columns[scene.labels >= 0])]

    free = against(excavator, scene, pictured, 1.0)
    unknown = against(excavator, scene, pictured, SceneOptions().unreturned)
    assert free > 0.1
    assert unknown < 0.3 * free


def test_the_surface_of_a_model_hangs_together_where_points_are_few(
    excavator: pk.ArticulatedModel, scene: SimulatedScan
) -> None:
    few = np.random.default_rng(0).permutation(len(scene.scan.points))[: len(scene.scan.points) // 12]
    scan = pk.Scan(scene.scan.points[few], sensor_origin=np.zeros(3))

    def linked(options: SceneOptions) -> int:
        ready = observe_scene(
            scan, excavator.surfaces, excavator.diagonal, EVERYWHERE, ObservationOptions(), options, 2
        )
        own = ready.scaled(scan.points[scene.labels[few] >= 0])
        near = ready.field.nearest(own)
        return int(np.bincount(ready.regions[near[near >= 0]] + 1)[1:].max(initial=0))

    assert linked(SceneOptions()) > 1.3 * linked(SceneOptions(link_spacings=0.0))


def test_a_scene_is_searched_on_while_its_answer_has_no_confidence(
    excavator: pk.ArticulatedModel, scene: SimulatedScan, monkeypatch: pytest.MonkeyPatch
) -> None:
    searches = []
    candidates = RegionSearch.candidates

    def counted(own: RegionSearch, seed: int, outside: Hypotheses, *, further: bool) -> Candidates | None:
        searches.append(further)
        return candidates(own, seed, outside, further=further)

    monkeypatch.setattr(RegionSearch, "candidates", counted)
    pk.estimate(excavator, scene.scan)
    assert searches == [False]
    monkeypatch.setattr("pwralign_kin.estimation.answers.answer_search.confidence", lambda _: 0.0)
    pk.estimate(excavator, scene.scan)
    assert searches == [False, False, True]


def test_a_close_look_takes_what_is_near_for_a_scan_of_the_model_and_sees_the_room_around_it(
    excavator: pk.ArticulatedModel, scene: SimulatedScan
) -> None:
    ready = observed(excavator, scene.scan)
    search = searching(excavator, ready)
    candidates = true_and_moved(excavator, scene, ready)
    about = search.about(candidates.take([0]), SceneSearchOptions().focus)

    closely = search.of(close_up(ready, about.searched, ObservationOptions(), SceneOptions(), 2))

    assert not closely.observation.scene and closely.searched.all()
    assert np.array_equal(closely.observation.points, ready.points[about.searched])
    assert closely.explained_shares(closely.owners(candidates.take([0]), closely.exists)[1]).max() > 0.5
    # Raised above everything, the model is where the camera sees walls behind.
    raised = Candidates(candidates.bases[:1].copy(), candidates.values[:1], candidates.scores[:1])
    raised.bases[0, :3, 3] += 0.5 * raised.bases[0, :3, 2]
    true, wrong = (closely.scored(own)[1][0] @ closely.weights for own in (candidates.take([0]), raised))
    assert true > -0.06 and wrong < 3 * true


def test_limbs_are_found_that_the_search_of_the_whole_scene_leaves_wrong(
    excavator: pk.ArticulatedModel, scene: SimulatedScan
) -> None:
    ready = observed(excavator, scene.scan)
    search = searching(excavator, ready)
    astray = true_and_moved(excavator, scene, ready).take([0])
    astray.values[0] = excavator.within_limits(excavator.values({})) / excavator.joint_scales
    answers = AnswerSearch(excavator, search, pk.EstimatorOptions(threads=2), None, Stopwatch())

    closely = answers._closely(search.about(astray, SceneSearchOptions().focus))
    looked = closely._found(0, closely.search, astray)
    found = closely._narrowly_repaired(closely.search, looked, turn=True)

    true = search.probe_positions(true_and_moved(excavator, scene, ready).take([0]))
    errors = np.linalg.norm(search.probe_positions(found) - true, axis=-1).mean(axis=1)
    assert errors.min() < 0.01 < 0.03 < np.linalg.norm(search.probe_positions(astray) - true, axis=-1).mean()


def test_another_search_grows_what_none_before_it_has_grown(
    excavator: pk.ArticulatedModel, scene: SimulatedScan
) -> None:
    search = searching(excavator, observed(excavator, scene.scan))
    few = SceneSearchOptions(anchors=150, roots=80, grown=1, refined=40, further=1.0)
    regions = RegionSearch(search, few, None, pairs=True, faces=FaceOptions())

    sizes = []
    for seed, further in ((0, False), (0, True), (1, True)):
        regions.candidates(seed, Hypotheses.nothing(), further=further)
        sizes.append(sum(len(roots.parts) for roots, _ in regions.grown.values()))
        assert sizes[-1] == sum(len(grown) for _, grown in regions.grown.values())

    assert sizes[0] == sizes[1] < sizes[2] < 2 * sizes[0]


def test_the_model_is_found_and_its_points_are_named(excavator: pk.ArticulatedModel, scene: SimulatedScan) -> None:
    estimate = pk.estimate(excavator, scene.scan)

    ruler = Ruler(excavator)
    assert ruler.score(ruler.reference(scene.state, scene.labels[scene.labels >= 0]), estimate.state).overlay
    own, named = scene.labels >= 0, estimate.scan_labels >= 0
    assert (own & named).sum() > 0.95 * own.sum()
    assert (own & named).sum() > 0.8 * named.sum()


def true_pairs(model: pk.ArticulatedModel, state: pk.State) -> list[np.ndarray]:
    """Points of the surface with all joints 0, and where they are in the scan."""
    zero = model.part_placements(np.zeros(len(model.joint_names)))
    posed = state.T_scan_base @ model.part_placements(model.values(state.joints))
    local = [surface.samples * model.diagonal for surface in model.surfaces]
    return [np.concatenate([transform(T, x) for T, x in zip(at, local, strict=True)]) for at in (zero, posed)]


@pytest.mark.parametrize("seed", [3, 8])
def test_right_correspondences_do_no_harm(excavator: pk.ArticulatedModel, seed: int) -> None:
    """Looks away from the model have none of their targets."""
    made = simulate_scene(excavator, room=Room(contacts=1), seed=seed)
    source, target = true_pairs(excavator, made.state)
    estimate = pk.estimate(excavator, made.scan, correspondences=Correspondences(source, target, np.ones(len(source))))
    ruler = Ruler(excavator)
    assert ruler.score(ruler.reference(made.state, made.labels[made.labels >= 0]), estimate.state).overlay


def test_another_search_looks_at_other_configurations(excavator: pk.ArticulatedModel, scene: SimulatedScan) -> None:
    search = searching(excavator, observed(excavator, scene.scan))
    options = pk.EstimatorOptions(threads=2)
    answers = AnswerSearch(excavator, search, options, None, Stopwatch())
    regions = RegionSearch(search, options.scene_search, None, pairs=True, faces=FaceOptions())
    candidates = regions.candidates(0, Hypotheses.nothing(), further=False)
    assert candidates is not None
    looked: list[Candidates] = []
    for seed in (0, 1):
        before = list(looked)
        assert list(answers._looks(seed, candidates, looked))
        leader = looked[len(before)]
        assert len(unlike(search, leader, before, options.scene_search.apart)) == 1


def test_correspondences_alone_find_the_model(excavator: pk.ArticulatedModel, scene: SimulatedScan) -> None:
    rng = np.random.default_rng(0)
    source, target = true_pairs(excavator, scene.state)
    wrong = rng.random(len(target)) < 0.4
    target[wrong] = rng.permutation(scene.scan.points)[: wrong.sum()]
    alone = pk.EstimatorOptions(sources=())

    estimate = pk.estimate(excavator, scene.scan, None, Correspondences(source, target, np.ones(len(source))), alone)

    ruler = Ruler(excavator)
    assert ruler.score(ruler.reference(scene.state, scene.labels[scene.labels >= 0]), estimate.state).overlay
    with pytest.raises(CorrespondenceError):
        pk.estimate(excavator, scene.scan, None, Correspondences(source, target + 99.0, np.ones(len(source))))


def test_no_source_of_hypotheses_is_told(excavator: pk.ArticulatedModel, scene: SimulatedScan) -> None:
    with pytest.raises(CorrespondenceError, match="no part could be placed"):
        pk.estimate(excavator, scene.scan, options=pk.EstimatorOptions(sources=()))


@pytest.mark.slow
def test_features_are_matched_to_what_is_searched(excavator: pk.ArticulatedModel, scene: SimulatedScan) -> None:
    ready = observed(excavator, scene.scan)
    pairs = FpfhMatcher(samples=100).match(excavator, ready, [0, 1])
    assert set(map(tuple, ready.scaled(pairs.target))) <= set(map(tuple, ready.scaled(searched_points(ready))))


@pytest.mark.slow
def test_a_point_on_one_of_two_copies_finds_that_copy(excavator: pk.ArticulatedModel) -> None:
    scene = simulate_scene(excavator, room=Room(second_copy=True, furniture=2), seed=4)
    (copy,) = scene.copies
    ruler = Ruler(excavator)
    for state, labels in ((scene.state, scene.labels), (copy.state, copy.labels)):
        near = tuple(np.median(scene.scan.points[labels == np.bincount(labels[labels >= 0]).argmax()], axis=0))
        estimate = pk.estimate(excavator, scene.scan, options=pk.EstimatorOptions(near=near))
        distance = np.linalg.norm(estimate.state.T_scan_base[:3, 3] - state.T_scan_base[:3, 3])
        assert distance < 0.05 * excavator.diagonal
        assert ruler.score(ruler.reference(state, labels[labels >= 0]), estimate.state).recall > 0.6


def test_millimetres_are_noticed(excavator: pk.ArticulatedModel, scene: SimulatedScan) -> None:
    from pwralign_kin.exceptions import UnitError

    with pytest.raises(UnitError):
        pk.estimate(excavator, scene.scan.scaled(1000.0))


def test_a_box_that_is_no_hint_of_the_scene_is_refused(excavator: pk.ArticulatedModel, scene: SimulatedScan) -> None:
    options = replace(pk.EstimatorOptions(), region=((90.0, 90.0, 90.0), (91.0, 91.0, 91.0)))
    with pytest.raises(ScanError):
        pk.estimate(excavator, scene.scan, options=options)


def test_a_patch_of_floor_that_is_left_unexplained_is_looked_at_as_surroundings(
    excavator: pk.ArticulatedModel,
) -> None:
    made = pk.simulate(excavator, sensor=TIERS["single"], seed=5)
    points = made.scan.points
    random = np.random.default_rng(0)
    lowest = points[points[:, 2].argmin()]
    across = random.uniform(-0.2, 0.2, (3000, 2)) * excavator.diagonal
    patch = np.column_stack([lowest[:2] + across, np.full(3000, lowest[2])])
    patch[:, 2] += random.normal(0.0, 0.001 * excavator.diagonal, 3000)
    scan = pk.Scan(np.concatenate([points, patch]), sensor_origin=made.scan.sensor_origin)

    left = np.arange(len(scan.points)) >= len(points)
    options = (ObservationOptions(), SceneOptions(), 2)
    found = surroundings_of(scan, left, excavator.surfaces, excavator.diagonal, *options)
    assert found[left].mean() > 0.9 and not found[~left].any()
    assert not surroundings_of(scan, ~left, excavator.surfaces, excavator.diagonal, *options).any()

    estimate = pk.estimate(excavator, scan)
    assert estimate.confidence > 0.5
    assert (estimate.scan_labels[left] < 0).mean() > 0.8
