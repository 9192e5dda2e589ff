"""The model found in whole scenes, with and without hints."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from searched_scenes import observed, searched_points, true_pairs

import pwralign_kin as pk
from pwralign_kin.benchmark.metrics import Ruler
from pwralign_kin.estimation import Correspondences
from pwralign_kin.estimation.knowledge.correspondences import FpfhMatcher
from pwralign_kin.exceptions import CorrespondenceError, ScanError
from pwralign_kin.simulation import Room, SimulatedScan, simulate_scene

pytest.importorskip("open3d", reason="ray casting needs Open3D and its system libraries", exc_type=ImportError)


def test_the_model_is_found_and_its_points_are_named(excavator: pk.ArticulatedModel, scene: SimulatedScan) -> None:
    estimate = pk.estimate(excavator, scene.scan)

    ruler = Ruler(excavator)
    assert ruler.score(ruler.reference(scene.state, scene.labels[scene.labels >= 0]), estimate.state).overlay
    own, named = scene.labels >= 0, estimate.scan_labels >= 0
    assert (own & named).sum() > 0.95 * own.sum()
    assert (own & named).sum() > 0.8 * named.sum()


@pytest.mark.parametrize("seed", [3, 8])
def test_right_correspondences_do_no_harm(excavator: pk.ArticulatedModel, seed: int) -> None:
    """Looks away from the model have none of their targets."""
    made = simulate_scene(excavator, room=Room(contacts=1), seed=seed)
    source, target = true_pairs(excavator, made.state)
    estimate = pk.estimate(excavator, made.scan, correspondences=Correspondences(source, target, np.ones(len(source))))
    ruler = Ruler(excavator)
    assert ruler.score(ruler.reference(made.state, made.labels[made.labels >= 0]), estimate.state).overlay


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


@pytest.mark.slow
def test_features_are_matched_to_what_is_searched(excavator: pk.ArticulatedModel, scene: SimulatedScan) -> None:
    ready = observed(excavator, scene.scan)
    pairs = FpfhMatcher(samples=100).match(excavator, ready, [0, 1])
    assert set(map(tuple, ready.scaled(pairs.target))) <= set(map(tuple, ready.scaled(searched_points(ready))))
