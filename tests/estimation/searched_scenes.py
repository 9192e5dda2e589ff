"""What tests of scenes share: a scene prepared and searched, the truth in it, and right correspondences."""

from __future__ import annotations

import numpy as np

import pwralign_kin as pk
from pwralign_kin.estimation.comparison.candidates import Candidates
from pwralign_kin.estimation.comparison.scan_comparison import ScanComparison, Sought
from pwralign_kin.estimation.comparison.search_options import SearchOptions
from pwralign_kin.estimation.knowledge.prior import SearchPrior
from pwralign_kin.estimation.search.tree_search import TreeSearch
from pwralign_kin.estimation.sensing.observation import Observation, ObservationOptions
from pwralign_kin.estimation.sensing.scene import SceneSetup, observe_scene
from pwralign_kin.estimation.sensing.scene_options import SceneOptions
from pwralign_kin.se3 import transform
from pwralign_kin.simulation import SimulatedScan

EVERYWHERE = (np.full(3, -np.inf), np.full(3, np.inf))


def scenes_of(model: pk.ArticulatedModel, threads: int = 2) -> SceneSetup:
    return SceneSetup(model.surfaces, model.diagonal, model.reach, ObservationOptions(), SceneOptions(), threads)


def observed(
    model: pk.ArticulatedModel, scan: pk.Scan, box: tuple[np.ndarray, np.ndarray] = EVERYWHERE, threads: int = 2
) -> Observation:
    return observe_scene(scan, scenes_of(model, threads), box)


def comparing(model: pk.ArticulatedModel, ready: Observation) -> ScanComparison:
    return ScanComparison(
        Sought(model.kernel_model, model.surfaces, SearchOptions(), 2), ready, SearchPrior.nothing(model.values({}))
    )


def searching(model: pk.ArticulatedModel, ready: Observation) -> TreeSearch:
    return TreeSearch(comparing(model, ready))


def true_and_moved(model: pk.ArticulatedModel, made: SimulatedScan, ready: Observation) -> Candidates:
    """Return the truth and, beside it, the same 0.1 diagonals aside."""
    bases = np.tile(ready.to_search(model.root_placement(made.state)), (2, 1, 1))
    bases[1, 0, 3] += 0.1
    return Candidates(bases, np.tile(model.values(made.state.joints), (2, 1)), np.zeros(2, np.float32))


def searched_points(ready: Observation) -> np.ndarray:
    return ready.points[ready.regions >= 0].astype(float) * ready.diagonal + ready.centre


def true_pairs(model: pk.ArticulatedModel, state: pk.State) -> list[np.ndarray]:
    """Points of the surface with all joints 0, and where they are in the scan."""
    zero = model.part_placements(np.zeros(len(model.joint_names)))
    posed = state.T_scan_base @ model.part_placements(model.values(state.joints))
    local = [surface.samples * model.diagonal for surface in model.surfaces]
    return [np.concatenate([transform(T, x) for T, x in zip(at, local, strict=True)]) for at in (zero, posed)]
