"""Moves of repair that bring a whole part to its place."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from searched_scenes import comparing, observed, true_and_moved

import pwralign_kin as pk
from pwralign_kin.estimation.comparison.candidates import Candidates
from pwralign_kin.estimation.comparison.scan_comparison import ScanComparison, Sought
from pwralign_kin.estimation.comparison.search_options import SearchOptions
from pwralign_kin.estimation.knowledge.prior import SearchPrior
from pwralign_kin.estimation.search.hypotheses import Hypotheses
from pwralign_kin.estimation.search.region_of_interest import subtrees
from pwralign_kin.estimation.search.repair import RepairOptions, _across, _worth_repair, repair_moves
from pwralign_kin.estimation.search.tree_search import TreeSearch
from pwralign_kin.estimation.sensing.observation import ObservationOptions
from pwralign_kin.estimation.sensing.preparation import observe
from pwralign_kin.simulation import SimulatedScan


@pytest.fixture(scope="module")
def laptop(robots_folder: Path) -> pk.ArticulatedModel:
    return pk.ArticulatedModel.from_urdf(robots_folder / "laptop" / "laptop.urdf")


@pytest.mark.parametrize("way", [0, 1])
def test_a_plate_beside_its_place_by_its_thickness_is_put_back(laptop: pk.ArticulatedModel, way: int) -> None:
    """Points on one of its sides were taken for points on the other, and nothing led back."""
    simulated = pk.simulate(laptop, seed=4)
    observation = observe(simulated.scan, laptop.diagonal, ObservationOptions(), 2)
    search = TreeSearch(
        ScanComparison(
            Sought(laptop.kernel_model, laptop.surfaces, SearchOptions(), 2),
            observation,
            SearchPrior.nothing(np.zeros(1)),
        )
    )
    true = observation.to_search(simulated.state.T_scan_base)
    beside = true.copy()
    beside[:3, 3] += true[:3, :3] @ _across(laptop.surfaces[0])[way]
    answer = Candidates.single(beside, np.array([simulated.state.joints["lid_hinge"]]))
    moves = repair_moves(search, answer, RepairOptions(), 0, foremost=False, turn=True)
    assert moves is not None
    assert np.linalg.norm((beside - true)[:3, 3]) > 0.02
    assert np.linalg.norm((moves.bases - true)[:, :3, 3], axis=1).min() < 1e-6


def test_only_thin_parts_have_two_sides(arm: pk.ArticulatedModel, laptop: pk.ArticulatedModel) -> None:
    assert all(len(_across(surface)) == 2 for surface in laptop.surfaces)
    thick = max(arm.surfaces, key=lambda surface: float(np.ptp(surface.samples, axis=0).min(initial=0.0)))
    assert len(_across(thick)) == 0


@pytest.mark.parametrize(("many_parts", "early", "late"), [(2, 4, 2), (1, 2, 1), (0, 1, 1)])
def test_fewer_solutions_of_models_of_many_parts_are_repaired(
    laptop: pk.ArticulatedModel, many_parts: int, early: int, late: int
) -> None:
    simulated = pk.simulate(laptop, seed=4)
    observation = observe(simulated.scan, laptop.diagonal, ObservationOptions(), 2)
    search = TreeSearch(
        ScanComparison(
            Sought(laptop.kernel_model, laptop.surfaces, SearchOptions(many_parts=many_parts), 2),
            observation,
            SearchPrior.nothing(np.zeros(1)),
        )
    )
    beside = observation.to_search(simulated.state.T_scan_base)
    beside[2, 3] += 0.2
    solutions = Candidates(np.tile(beside, (4, 1, 1)), np.zeros((4, 1)), np.zeros(4, np.float32))
    options = RepairOptions()
    assert _worth_repair(search, solutions, options, 0) == early
    assert _worth_repair(search, solutions, options, options.early_rounds) == late


@pytest.mark.parametrize("among_things", [True, False])
def test_in_a_scene_nothing_is_grown_from_single_parts_and_nowhere_swept_what_has_no_surface(
    excavator: pk.ArticulatedModel, scene: SimulatedScan, monkeypatch: pytest.MonkeyPatch, among_things: bool
) -> None:
    ready = observed(excavator, scene.scan)
    comparison = comparing(excavator, ready)
    aside = true_and_moved(excavator, scene, ready).take([1])
    if not among_things:
        own = pk.simulate(excavator, scene.state, seed=1).scan
        alone = observe(own, excavator.diagonal, ObservationOptions(), 2)
        comparison, aside = comparing(excavator, alone), true_and_moved(excavator, scene, alone).take([1])
    swept: list[int] = []
    grown: list[int] = []
    sweep, grow = ScanComparison.swept, TreeSearch.grow

    def sweeping(own: ScanComparison, solution: Candidates, joint: np.ndarray, *args: object) -> Candidates:
        swept.extend(joint.tolist())
        return sweep(own, solution, joint, *args)  # type: ignore[arg-type]

    def growing(own: TreeSearch, hypotheses: Hypotheses, keep: int = 1) -> Candidates:
        grown.append(len(hypotheses.parts))
        return grow(own, hypotheses, keep)

    monkeypatch.setattr(ScanComparison, "swept", sweeping)
    monkeypatch.setattr(TreeSearch, "grow", growing)
    joints = len(comparison.known.values)
    bare = comparison.exists & ~subtrees(comparison.parent)[1]  # the first part on a joint has no surface
    monkeypatch.setattr(comparison, "exists", bare)

    options = RepairOptions(held_limbs=0)
    assert repair_moves(TreeSearch(comparison), aside, options, 0, foremost=True, turn=False) is not None

    assert set(swept) == set(range(joints)) - {int(comparison.model.actuated[1])}
    assert bool(grown) != among_things
