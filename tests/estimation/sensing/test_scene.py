"""Whole scenes made ready for the search: what is told from the model, what is searched, what a view says."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from searched_scenes import EVERYWHERE, comparing, observed, scenes_of, searched_points, true_and_moved

import pwralign_kin as pk
from pwralign_kin.estimation.comparison.candidates import Candidates
from pwralign_kin.estimation.search.scene_search import SceneSearchOptions
from pwralign_kin.estimation.sensing.observation import ObservationOptions
from pwralign_kin.estimation.sensing.scene import close_up, is_scene, observe_scene, surroundings_of
from pwralign_kin.estimation.sensing.scene_options import SceneOptions
from pwralign_kin.exceptions import ScanError, UnitError
from pwralign_kin.se3 import inverse, transform
from pwralign_kin.simulation import TIERS, SimulatedScan

pytest.importorskip("open3d", reason="ray casting needs Open3D and its system libraries", exc_type=ImportError)


def taken_for_scene(model: pk.ArticulatedModel, scan: pk.Scan) -> bool:
    return is_scene(scan, scenes_of(model))


def test_a_scan_of_the_model_alone_is_no_scene(excavator: pk.ArticulatedModel, scene: SimulatedScan) -> None:
    alone = pk.Scan(scene.scan.points[scene.labels >= 0], sensor_origin=np.zeros(3))

    assert taken_for_scene(excavator, scene.scan)
    assert not taken_for_scene(excavator, alone)


@pytest.mark.parametrize("away", [1e4, 1e9])
def test_points_without_depth_put_far_away_make_no_scene_of_a_scan(
    excavator: pk.ArticulatedModel, scene: SimulatedScan, away: float
) -> None:
    alone = scene.scan.points[scene.labels >= 0]
    strays = pk.Scan(np.concatenate([alone, np.full((10, 3), away)]), sensor_origin=np.zeros(3))

    assert not taken_for_scene(excavator, strays)


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


def test_a_scan_of_the_model_alone_in_inches_is_no_scene_that_shows_nothing(excavator: pk.ArticulatedModel) -> None:
    inches = pk.simulate(excavator, sensor=TIERS["single"], seed=1).scan.scaled(1.0 / 0.0254)
    with pytest.raises(UnitError, match="--units in") as caught:
        observed(excavator, inches)
    assert caught.value.scale == 0.0254


def test_the_field_of_a_scene_does_not_depend_on_the_threads(
    excavator: pk.ArticulatedModel, scene: SimulatedScan
) -> None:
    several = [observed(excavator, scene.scan, threads=threads) for threads in (1, 3)]
    scores = [
        comparing(excavator, ready).scored(true_and_moved(excavator, scene, ready))[0].scores for ready in several
    ]
    assert np.array_equal(*scores)


def against(model: pk.ArticulatedModel, made: SimulatedScan, points: np.ndarray, unreturned: float) -> float:
    """Return how much of the model's surface, at the truth, a view of `points` speaks against."""
    scan, options = pk.Scan(points, sensor_origin=np.zeros(3)), SceneOptions(unreturned=unreturned)
    ready = observe_scene(scan, replace(scenes_of(model), options=options), EVERYWHERE)
    comparison = comparing(model, ready)
    support = comparison.scored(true_and_moved(model, made, ready).take([0]))[1][0]
    return -float(support @ (comparison.weights * comparison.exists))


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


def test_a_scene_says_as_much_of_what_is_far_from_all_that_is_searched(
    excavator: pk.ArticulatedModel, scene: SimulatedScan
) -> None:
    ready = observed(excavator, scene.scan)
    comparison, answer = comparing(excavator, ready), true_and_moved(excavator, scene, ready).take([0])
    sensor = ready.scaled(np.zeros((1, 3)))[0]
    forward = answer.bases[0, :3, 3] - sensor

    def against_model(at: np.ndarray) -> float:
        answer.bases[0, :3, 3] = at
        support = comparison.scored(answer)[1][0]
        return -float(support @ (comparison.weights * comparison.exists))

    assert against_model(sensor + 0.5 * forward) > 0.6  # before everything else
    assert against_model(sensor - forward) == 0.0  # behind the camera


def test_gaps_between_sparse_points_say_little_against_the_model(
    excavator: pk.ArticulatedModel, scene: SimulatedScan
) -> None:
    points, unreturned = scene.scan.points.astype(float), SceneOptions().unreturned
    few = np.random.default_rng(0).permutation(len(points))[: len(points) // 12]

    whole = against(excavator, scene, points, unreturned)
    assert against(excavator, scene, points[few], unreturned) < whole + 0.1


def test_the_surface_of_a_model_hangs_together_where_points_are_few(
    excavator: pk.ArticulatedModel, scene: SimulatedScan
) -> None:
    few = np.random.default_rng(0).permutation(len(scene.scan.points))[: len(scene.scan.points) // 12]
    scan = pk.Scan(scene.scan.points[few], sensor_origin=np.zeros(3))

    def linked(options: SceneOptions) -> int:
        ready = observe_scene(scan, replace(scenes_of(excavator), options=options), EVERYWHERE)
        own = ready.scaled(scan.points[scene.labels[few] >= 0])
        near = ready.field.nearest(own)
        return int(np.bincount(ready.regions[near[near >= 0]] + 1)[1:].max(initial=0))

    assert linked(SceneOptions()) > 1.3 * linked(SceneOptions(link_spacings=0.0))


@pytest.mark.parametrize("share", [6, 8, 10, 14, 20])
def test_a_model_farther_than_enough_other_surface_is_searched_where_points_are_few(
    excavator: pk.ArticulatedModel, scene: SimulatedScan, share: int
) -> None:
    from scipy.spatial import cKDTree

    few = np.random.default_rng(0).permutation(len(scene.scan.points))[: len(scene.scan.points) // share]
    scan = pk.Scan(scene.scan.points[few], sensor_origin=np.zeros(3))
    ready = observed(excavator, scan)

    own = scan.points[scene.labels[few] >= 0]
    assert (cKDTree(searched_points(ready)).query(own)[0] < 0.05 * ready.diagonal).mean() > 0.75


def test_a_close_look_takes_what_is_near_for_a_scan_of_the_model_and_sees_the_room_around_it(
    excavator: pk.ArticulatedModel, scene: SimulatedScan
) -> None:
    ready = observed(excavator, scene.scan)
    comparison = comparing(excavator, ready)
    candidates = true_and_moved(excavator, scene, ready)
    about = comparison.about(candidates.take([0]), SceneSearchOptions().focus)

    closely = comparison.of(close_up(ready, about.searched, ObservationOptions(), SceneOptions(), 2))

    assert not closely.observation.scene and closely.searched.all()
    assert np.array_equal(closely.observation.points, ready.points[about.searched])
    assert closely.explained_shares(closely.owners(candidates.take([0]), closely.exists)[1]).max() > 0.5
    # Raised above everything, the model is where the camera sees walls behind.
    raised = Candidates(candidates.bases[:1].copy(), candidates.values[:1], candidates.scores[:1])
    raised.bases[0, :3, 3] += 0.5 * raised.bases[0, :3, 2]
    true, wrong = (closely.scored(own)[1][0] @ closely.weights for own in (candidates.take([0]), raised))
    assert true > -0.06 and wrong < 3 * true


def test_what_a_limb_passes_without_facing_alike_counts_against_it_in_a_close_look(
    excavator: pk.ArticulatedModel, scene: SimulatedScan
) -> None:
    # As where a limb explains a thing that touches the model.
    ready = observed(excavator, scene.scan)
    aside = np.roll(ready.normals, 1, axis=1)
    across = np.cross(ready.normals, aside)
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-6)
    true = true_and_moved(excavator, scene, ready).take([0])
    near = comparing(excavator, ready).about(true, SceneSearchOptions().focus).searched

    def explained(normals: np.ndarray) -> float:
        view = close_up(replace(ready, normals=normals), near, ObservationOptions(), SceneOptions(), 2)
        return float(comparing(excavator, ready).of(view).coverage(true)[0])

    assert explained(np.ascontiguousarray(across, np.float32)) < 0.0 < explained(ready.normals)


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
    found = surroundings_of(scan, left, scenes_of(excavator))
    assert found[left].mean() > 0.9 and not found[~left].any()
    assert not surroundings_of(scan, ~left, scenes_of(excavator)).any()

    estimate = pk.estimate(excavator, scan)
    assert estimate.confidence > 0.5
    assert (estimate.scan_labels[left] < 0).mean() > 0.8


def test_the_floor_is_told_across_the_rings_of_a_spinning_sensor(excavator: pk.ArticulatedModel) -> None:
    """No neighbourhood held points of two rings, whose planes then were of no floor."""
    height, random = 0.6 * excavator.diagonal, np.random.default_rng(0)
    radii = height / np.tan(np.radians(np.arange(20.0, 60.0, 4.0)))
    turn = np.radians(np.arange(-25.0, 25.0, 0.4))
    rings = np.stack([np.outer(radii, np.cos(turn)), np.outer(radii, np.sin(turn))], axis=-1).reshape(-1, 2)
    noise = random.normal(0.0, 0.002 * excavator.diagonal, len(rings))
    floor = pk.Scan(np.column_stack([rings, noise]), sensor_origin=(0.0, 0.0, height))
    found = surroundings_of(floor, np.ones(len(rings), bool), scenes_of(excavator))
    assert found.mean() > 0.9
