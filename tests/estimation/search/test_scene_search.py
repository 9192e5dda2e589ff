"""The search of a scene region by region, and what is compared with all of it."""

from __future__ import annotations

import numpy as np
import pytest
from searched_scenes import comparing, observed, searching, true_and_moved

import pwralign_kin as pk
from pwralign_kin.estimation.comparison.candidates import Candidates
from pwralign_kin.estimation.search.face_hypotheses import FaceOptions
from pwralign_kin.estimation.search.hypotheses import Hypotheses
from pwralign_kin.estimation.search.scene_search import RegionSearch, SceneSearchOptions
from pwralign_kin.simulation import SimulatedScan

pytest.importorskip("open3d", reason="ray casting needs Open3D and its system libraries", exc_type=ImportError)


def test_scores_about_a_configuration_are_those_of_the_whole_scene(
    excavator: pk.ArticulatedModel, scene: SimulatedScan
) -> None:
    ready = observed(excavator, scene.scan)
    comparison, candidates = comparing(excavator, ready), true_and_moved(excavator, scene, ready)

    about = comparison.about(candidates.take([0]), 0.2)

    assert about.searched.sum() < 0.8 * comparison.searched.sum()
    assert not (about.searched & ~comparison.searched).any()
    assert about.scored(candidates)[0].scores == pytest.approx(comparison.scored(candidates)[0].scores, abs=0.02)
    assert about.unexplained(candidates.take([0])) == pytest.approx(comparison.unexplained(candidates.take([0])))


def test_a_configuration_with_nothing_near_it_is_compared_with_the_whole_scene(
    excavator: pk.ArticulatedModel, scene: SimulatedScan
) -> None:
    ready = observed(excavator, scene.scan)
    comparison, candidates = comparing(excavator, ready), true_and_moved(excavator, scene, ready)
    astray = Candidates(candidates.bases[:1].copy(), candidates.values[:1], candidates.scores[:1])
    astray.bases[0, :3, 3] += 50.0

    about = comparison.about(astray, 0.35)

    assert np.array_equal(about.searched, comparison.searched)
    assert np.isfinite(about.scored(astray)[0].scores).all()


def test_another_search_grows_what_none_before_it_has_grown(
    excavator: pk.ArticulatedModel, scene: SimulatedScan
) -> None:
    search = searching(excavator, observed(excavator, scene.scan))
    few = SceneSearchOptions(anchors=150, roots=80, grown=1, refined=40, further=1.0)
    regions = RegionSearch(search, few, None, pairs=True, faces=FaceOptions())

    sizes = []
    for seed, further in ((0, False), (0, True), (1, True)):
        regions.candidates(seed, Hypotheses.nothing(), np.zeros_like(search.comparison.searched) if further else None)
        sizes.append(sum(len(roots.parts) for roots, _ in regions.grown.values()))
        assert sizes[-1] == sum(len(grown) for _, grown in regions.grown.values())

    assert sizes[0] == sizes[1] < sizes[2] < 2 * sizes[0]
