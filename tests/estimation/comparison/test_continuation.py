"""Surface that lies in something larger: what goes on beyond the model's edges speaks against it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import pwralign_kin as pk
from pwralign_kin.benchmark.scenes import scene
from pwralign_kin.estimation.comparison.candidates import Candidates
from pwralign_kin.estimation.comparison.continuation import best_priced, continued, priced
from pwralign_kin.estimation.comparison.scan_comparison import ScanComparison, Sought
from pwralign_kin.estimation.comparison.search_options import SearchOptions
from pwralign_kin.estimation.knowledge.prior import SearchPrior
from pwralign_kin.estimation.sensing.observation import ObservationOptions
from pwralign_kin.estimation.sensing.preparation import observe

PLATE = """<robot name="plate"><link name="plate">
<visual><geometry><box size="0.6 0.4 0.02"/></geometry></visual>
</link></robot>"""
EYE = np.array([0.2, 0.1, 3.0])


@pytest.fixture(scope="module")
def plate(tmp_path_factory: pytest.TempPathFactory) -> pk.ArticulatedModel:
    path = tmp_path_factory.mktemp("plate") / "plate.urdf"
    path.write_text(PLATE, encoding="utf-8")
    return pk.ArticulatedModel.from_urdf(path)


def searched(plate: pk.ArticulatedModel, *surfaces: np.ndarray) -> ScanComparison:
    """Return the search for the plate in a scan of `surfaces`."""
    points = np.concatenate(surfaces) + np.random.default_rng(1).normal(scale=5e-4, size=(sum(map(len, surfaces)), 3))
    scan = pk.Scan(points, sensor_origin=EYE)
    ready = observe(scan, plate.diagonal, ObservationOptions(), 1)
    return ScanComparison(
        Sought(plate.kernel_model, plate.surfaces, SearchOptions(), 1), ready, SearchPrior.nothing(np.zeros(0))
    )


def at_height(comparison: ScanComparison, height: float, score: float = 0.0) -> Candidates:
    """Return the plate above the origin."""
    T = np.eye(4)
    T[2, 3] = height
    return Candidates.single(comparison.observation.to_search(T), np.zeros(0), score)


def share_continued(plate: pk.ArticulatedModel, *surfaces: np.ndarray) -> float:
    """Return what is continued of the plate at the origin in a scan of `surfaces`."""
    comparison = searched(plate, *surfaces)
    return continued(comparison, at_height(comparison, 0.0))


def level(width: float, depth: float, height: float) -> np.ndarray:
    """A horizontal rectangle about the z axis, a point every 6 mm."""
    x, y = np.meshgrid(np.arange(-width / 2, width / 2, 0.006), np.arange(-depth / 2, depth / 2, 0.006))
    return np.column_stack([x.ravel(), y.ravel(), np.full(x.size, height)])


def test_nothing_goes_on_beyond_the_edges_of_a_plate_that_is_there(plate: pk.ArticulatedModel) -> None:
    assert share_continued(plate, level(0.6, 0.4, 0.01)) < 0.05


def test_a_wall_goes_on_beyond_the_plate_that_is_laid_in_it(plate: pk.ArticulatedModel) -> None:
    assert share_continued(plate, level(1.6, 1.4, 0.01)) > 0.8


def test_what_lies_behind_a_plate_does_not_continue_it(plate: pk.ArticulatedModel) -> None:
    behind = level(1.6, 1.4, -0.15)
    seen = (np.abs(behind[:, 0]) > 0.35) | (np.abs(behind[:, 1]) > 0.25)
    assert share_continued(plate, level(0.6, 0.4, 0.01), behind[seen]) < 0.05


def test_the_best_price_is_that_of_all_prices(plate: pk.ArticulatedModel) -> None:
    comparison = searched(plate, level(1.6, 1.4, 0.01), level(0.6, 0.4, 0.51))
    several = Candidates.concatenate([at_height(comparison, *own) for own in ((1.0, 0.5), (0.0, 0.9), (0.5, 0.8))])
    best, all_of = best_priced(comparison, several), priced(comparison, several)
    assert all_of.scores[1] < all_of.scores[2] == best.scores[0] == all_of.scores.max()
    assert np.array_equal(best.bases[0], several.bases[2])
    assert several.scores[1] == np.float32(0.9)


def test_a_lid_is_not_laid_in_the_wall_behind_it(robots_folder: Path) -> None:
    laptop = pk.ArticulatedModel.from_urdf(robots_folder / "laptop" / "laptop.urdf")
    made = scene(laptop, "laptop", "furniture", 3)
    found = pk.estimate(laptop, made.scan)
    for name, value in made.state.joints.items():
        assert found.state.joints[name] == pytest.approx(value, abs=0.05)
    assert found.evidence.continued < 0.2
    assert found.confidence > 0.8
