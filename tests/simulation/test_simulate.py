"""Simulated scans against the geometry and the truth they come from."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pwralign_kin.exceptions import ArgumentError, ModelError, OptionError, ScanError, StateError, UnknownNameError
from pwralign_kin.model import ArticulatedModel
from pwralign_kin.scan import Scan
from pwralign_kin.se3 import inverse, rotation_angle, transform
from pwralign_kin.simulation import TIERS, GuessOffset, Sensor, random_state, simulate
from pwralign_kin.state import State

pytest.importorskip("open3d", reason="ray casting needs Open3D and its system libraries", exc_type=ImportError)


def distances(model: ArticulatedModel, state: State, points: np.ndarray) -> np.ndarray:
    """Distances (parts, n) of points in the scan frame to the posed surface of every part, m."""
    import open3d as o3d

    placements = state.T_scan_base @ model.part_placements(model.values(state.joints))
    found = []
    for part, T in zip(model.parts, placements, strict=True):
        scene = o3d.t.geometry.RaycastingScene()
        scene.add_triangles(
            o3d.core.Tensor(part.vertices.astype(np.float32)), o3d.core.Tensor(part.faces.astype(np.uint32))
        )
        local = transform(inverse(T), points).astype(np.float32)
        found.append(scene.compute_distance(o3d.core.Tensor(local)).numpy())
    return np.stack(found)


def sees(model: ArticulatedModel, state: State, origin: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Whether nothing of the model lies between `origin` and each of the points."""
    import open3d as o3d

    scene = o3d.t.geometry.RaycastingScene()
    placements = state.T_scan_base @ model.part_placements(model.values(state.joints))
    for part, T in zip(model.parts, placements, strict=True):
        posed = transform(T, part.vertices)
        scene.add_triangles(o3d.core.Tensor(posed.astype(np.float32)), o3d.core.Tensor(part.faces.astype(np.uint32)))
    rays = np.concatenate([np.broadcast_to(origin, points.shape), points - origin], axis=1)
    hit = scene.cast_rays(o3d.core.Tensor(rays.astype(np.float32)))["t_hit"].numpy()
    return hit > 1.0 - 1e-3


def test_points_without_noise_lie_on_the_part_that_their_label_names(crane: ArticulatedModel) -> None:
    simulated = simulate(crane, sensor=Sensor(noise=0.0), seed=1)
    found = distances(crane, simulated.state, simulated.scan.points)
    assert len(simulated.scan) == 8000
    assert found[simulated.labels, np.arange(8000)].max() < 1e-5 * crane.diagonal
    assert set(np.unique(simulated.labels)) == {0, 1, 2, 3}
    assert simulated.part_names == ("base", "tower", "boom", "hook")


def test_fused_views_cover_the_model_from_all_sides(crane: ArticulatedModel) -> None:
    state = State(joints={"turn": 0.3})
    simulated = simulate(crane, state, Sensor(noise=0.0), seed=2)
    on_base = simulated.scan.points[simulated.labels == 0]
    for axis, half in enumerate((0.3, 0.2, 0.1)):
        for side in (-half, half):
            assert np.isclose(on_base[:, axis], side, atol=1e-6).mean() > 0.02
    assert len(np.unique(simulated.view)) == 8


@pytest.mark.parametrize("along_ray", [False, True])
def test_noise_has_the_size_and_direction_asked_for(crane: ArticulatedModel, along_ray: bool) -> None:
    state = State(joints={"turn": 0.3, "lift": -0.4, "slide": 0.1})
    views = 1 if along_ray else 4
    clean = simulate(crane, state, Sensor(views=views, noise=0.0), seed=3)
    noisy = simulate(crane, state, Sensor(views=views, noise=0.01, noise_along_ray=along_ray), seed=3)
    offset = (noisy.scan.points - clean.scan.points) / (0.01 * crane.diagonal)
    if along_ray:
        rays = clean.scan.points - clean.view_origins[0]
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        along = np.sum(offset * rays, axis=1)
        assert np.abs(offset - along[:, None] * rays).max() < 1e-3
        assert along.std() == pytest.approx(1.0, abs=0.05)
    else:
        assert offset.std(axis=0) == pytest.approx([1.0, 1.0, 1.0], abs=0.05)


def test_a_single_view_shows_only_what_its_origin_sees(crane: ArticulatedModel) -> None:
    sensor = Sensor(views=1, noise=0.0, known_origin=True)
    for seed in range(4):
        simulated = simulate(crane, sensor=sensor, seed=seed)
        origin = simulated.scan.sensor_origin
        assert origin is not None and np.array_equal(origin, simulated.view_origins[0])
        assert sees(crane, simulated.state, origin, simulated.scan.points).mean() > 0.999
        away = np.linalg.norm(simulated.scan.points.mean(axis=0) - origin) / crane.diagonal
        assert 1.1 < away < 2.9


def test_fused_scans_may_know_the_origin_of_every_point(crane: ArticulatedModel) -> None:
    simulated = simulate(crane, sensor=Sensor(views=3, noise=0.0, known_origin=True), seed=5)
    origins = simulated.scan.sensor_origin
    assert origins is not None
    assert np.array_equal(origins, simulated.view_origins[simulated.view])
    for view in range(3):
        points = simulated.scan.points[simulated.view == view]
        assert sees(crane, simulated.state, simulated.view_origins[view], points).mean() > 0.999


def test_mixed_pixels_float_between_near_and_far_and_belong_to_no_part(crane: ArticulatedModel) -> None:
    state = State(joints={"turn": 0.5, "lift": 0.3})
    simulated = simulate(crane, state, Sensor(views=6, noise=0.0, mixed_pixels=1.0), seed=6)
    mixed = simulated.labels == -1
    found = distances(crane, state, simulated.scan.points).min(axis=0)
    assert 10 < mixed.sum() < 800
    assert found[~mixed].max() < 1e-5
    assert (found[mixed] > 1e-3).mean() > 0.8
    none = simulate(crane, state, Sensor(views=6, noise=0.0), seed=6)
    assert (none.labels >= 0).all()


def test_bent_surfaces_are_off_along_the_rays_and_smoothly(crane: ArticulatedModel) -> None:
    sensors = (Sensor(views=1, noise=0.0, known_origin=True, bend=bend) for bend in (0.0, 0.02))
    flat, bent = (simulate(crane, sensor=sensor, seed=6) for sensor in sensors)
    moved = (bent.scan.points - flat.scan.points) / crane.diagonal
    rays = flat.scan.points - flat.view_origins[0]
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    along = np.einsum("ij,ij->i", moved, rays)
    assert np.abs(moved - along[:, None] * rays).max() < 1e-5
    assert 0.005 < along.std() < 0.04
    near = np.linalg.norm(flat.scan.points - flat.scan.points[1000], axis=1) < 0.02 * crane.diagonal
    assert near.sum() > 10 and np.ptp(along[near]) < 0.5 * np.ptp(along)


def test_a_fused_mesh_is_smooth_and_round_at_its_edges(crane: ArticulatedModel) -> None:
    state = random_state(crane, 6)
    noisy, fused, exact = (
        simulate(crane, state, Sensor(noise=noise, rounding=rounding), seed=6)
        for noise, rounding in ((0.01, 0.0), (0.01, 0.03), (0.0, 0.03))
    )
    off, smooth, edges = (
        distances(crane, state, made.scan.points).min(axis=0) / crane.diagonal for made in (noisy, fused, exact)
    )
    assert np.median(smooth) < 0.8 * np.median(off)
    assert np.median(edges) < 0.004 and 0.004 < np.quantile(edges, 0.95) < 0.03


def test_stray_points_are_added_around_the_model(crane: ArticulatedModel) -> None:
    simulated = simulate(crane, sensor=Sensor(points=1000, stray=0.1, noise=0.0), seed=7)
    stray = simulated.labels == -1
    assert len(simulated.scan) == 1100
    assert stray.sum() == 100
    on_model = simulated.scan.points[~stray]
    beyond = 0.26 * crane.diagonal
    assert (simulated.scan.points >= on_model.min(axis=0) - beyond).all()
    assert (simulated.scan.points <= on_model.max(axis=0) + beyond).all()
    assert np.median(distances(crane, simulated.state, simulated.scan.points[stray]).min(axis=0)) > 0.05


def test_a_named_part_can_be_missing(crane: ArticulatedModel) -> None:
    whole = simulate(crane, sensor=Sensor(), seed=8)
    simulated = simulate(crane, sensor=Sensor(missing_parts=("boom",)), seed=8)
    assert 2 in whole.labels and 2 not in simulated.labels
    assert len(simulated.scan) == (whole.labels != 2).sum()


def test_random_losses_take_a_part_and_one_contiguous_piece(crane: ArticulatedModel) -> None:
    whole = simulate(crane, sensor=Sensor(noise=0.0), seed=9)
    simulated = simulate(crane, sensor=Sensor(noise=0.0, missing_random_parts=1, missing_share=0.2), seed=9)
    kept = {tuple(point) for point in simulated.scan.points}
    lost = np.array([tuple(point) not in kept for point in whole.scan.points])
    absent = [part for part in range(4) if lost[whole.labels == part].all()]
    assert absent
    rest = np.count_nonzero(whole.labels != absent[0])
    assert len(simulated.scan) in [round(0.8 * np.count_nonzero(whole.labels != part)) for part in absent]
    bite = whole.scan.points[lost & (whole.labels != absent[0])]
    assert len(bite) == pytest.approx(0.2 * rest, abs=1)
    remaining = simulated.scan.points
    nearest = np.argsort(np.linalg.norm(np.vstack([bite, remaining]) - bite.mean(axis=0), axis=1))[: len(bite)]
    assert (nearest < len(bite)).mean() > 0.7


def test_clutter_is_a_table_under_the_model_and_solids_beside_it(crane: ArticulatedModel) -> None:
    simulated = simulate(crane, sensor=replace(TIERS["clutter"], noise=0.0), seed=10)
    on_model = simulated.scan.points[simulated.labels >= 0]
    clutter = simulated.scan.points[simulated.labels == -1]
    assert len(simulated.scan) == 12000
    assert len(on_model) > 300
    height = np.median(clutter[:, 2])
    table = np.abs(clutter[:, 2] - height) < 1e-6
    solids = clutter[clutter[:, 2] > height + 1e-6]
    assert 0.5 < table.mean() < 0.98
    assert height == pytest.approx(on_model[:, 2].min(), abs=0.05 * crane.diagonal)
    assert height < on_model[:, 2].min()
    assert len(solids) > 300
    assert distances(crane, simulated.state, solids).min() > 0.02 * crane.diagonal


def test_the_same_seed_gives_the_same_scan_and_another_seed_another(crane: ArticulatedModel) -> None:
    for sensor in TIERS.values():
        first, second = (simulate(crane, sensor=sensor, seed=11) for _ in range(2))
        assert np.array_equal(first.scan.points, second.scan.points)
        assert np.array_equal(first.labels, second.labels)
        assert first.state.to_dict() == second.state.to_dict()
    other = simulate(crane, seed=12)
    assert other.state.to_dict() != first.state.to_dict()


def test_tiers_have_the_figures_of_the_benchmark(crane: ArticulatedModel) -> None:
    scans = {tier: simulate(crane, sensor=sensor, seed=13) for tier, sensor in TIERS.items()}
    sizes = {tier: len(simulated.scan) for tier, simulated in scans.items()}
    missing = sizes.pop("missing")
    assert sizes == {
        "full": 8000,
        "hololens": 2100,
        "sparse": 600,
        "single": 8000,
        "warm": 8000,
        "clutter": 12000,
    }
    assert missing < 6400
    assert {tier: len(simulated.view_origins) for tier, simulated in scans.items()} == {
        "full": 8, "hololens": 8, "sparse": 8, "missing": 8, "single": 1, "warm": 1, "clutter": 4,
    }  # fmt: skip
    known = {tier for tier, simulated in scans.items() if simulated.scan.sensor_origin is not None}
    assert known == {"single", "warm"}
    assert np.array_equal(scans["single"].scan.points, scans["warm"].scan.points)
    assert {tier for tier, simulated in scans.items() if simulated.guess is not None} == {"warm"}
    expected = {"full": 0.002, "hololens": 0.01, "sparse": 0.005, "clutter": 0.005}
    for tier, noise in expected.items():
        on_model = scans[tier].labels >= 0
        found = distances(crane, scans[tier].state, scans[tier].scan.points[on_model])
        residual = found[scans[tier].labels[on_model], np.arange(on_model.sum())] / crane.diagonal
        assert np.sqrt(np.mean(residual**2)) == pytest.approx(noise, rel=0.15)
    assert len({json.dumps(simulated.state.to_dict()) for simulated in scans.values()}) == 1


def test_guesses_lie_off_the_truth_by_no_more_than_asked(crane: ArticulatedModel) -> None:
    most = GuessOffset()
    rotations, shifts, angles, slides = [], [], [], []
    for seed in range(20):
        simulated = simulate(crane, sensor=Sensor(views=1, points=300, guess=most), seed=seed)
        guess, truth = simulated.guess, simulated.state
        assert guess is not None
        rotations.append(rotation_angle(truth.T_scan_base[:3, :3].T @ guess.T_scan_base[:3, :3]))
        shifts.append(np.linalg.norm(guess.T_scan_base[:3, 3] - truth.T_scan_base[:3, 3]) / crane.diagonal)
        angles += [abs(guess.joints[name] - truth.joints[name]) for name in ("turn", "lift")]
        slides.append(abs(guess.joints["slide"] - truth.joints["slide"]) / 0.3)
        values = crane.values(guess.joints)
        assert (values >= crane.lower).all() and (values <= crane.upper).all()
    for offsets, reach in ((rotations, most.rotation), (shifts, 0.08), (angles, 0.35), (slides, 0.15)):
        assert max(offsets) <= reach + 1e-9
        assert max(offsets) > 0.5 * reach


def test_random_states_fill_the_limits_and_turn_the_base_every_way(crane: ArticulatedModel) -> None:
    states = [random_state(crane, seed) for seed in range(200)]
    values = np.array([crane.values(state.joints) for state in states])
    assert (values >= crane.lower).all() and (values <= crane.upper).all()
    assert (np.ptp(values, axis=0) > 0.9 * (crane.upper - crane.lower)).all()
    up = np.array([state.T_scan_base[:3, 2] for state in states])
    assert np.linalg.norm(up.mean(axis=0)) < 0.2
    assert np.abs([state.T_scan_base[:3, 3] for state in states]).max() <= 2.0 * crane.diagonal


def test_a_given_state_is_completed_and_moved_to_the_root(crane: ArticulatedModel) -> None:
    T = np.eye(4)
    T[:3, 3] = [1.0, 2.0, 3.0]
    simulated = simulate(crane, State(T, {"turn": 1.0}, base_link="tower"), Sensor(points=500), seed=1)
    assert simulated.state.base_link == "base"
    assert simulated.state.joints == {"turn": 1.0, "lift": 0.0, "slide": 0.0}
    placements = simulated.state.T_scan_base @ crane.part_placements(crane.values(simulated.state.joints))
    assert np.allclose(placements[1], T)


def test_saved_scans_come_back(crane: ArticulatedModel, tmp_path: Path) -> None:
    simulated = simulate(crane, sensor=TIERS["warm"], seed=3)
    simulated.save(tmp_path / "new" / "case")
    folder = tmp_path / "new" / "case"
    assert {path.name for path in folder.iterdir()} == {"scan.ply", "truth.json", "labels.npz", "guess.json"}
    truth = json.loads((folder / "truth.json").read_text())
    scan = Scan.load(folder / "scan.ply")
    assert scan.sensor_origin is not None and np.array_equal(scan.sensor_origin, truth["sensor_origin"])
    assert np.array_equal(scan.points, simulated.scan.points)
    assert scan.sensor_origin is not None and np.array_equal(scan.sensor_origin, simulated.view_origins[0])
    assert simulated.guess is not None
    for name, state in (("truth.json", simulated.state), ("guess.json", simulated.guess)):
        loaded = State.load(folder / name)
        assert (loaded.joints, loaded.base_link) == (state.joints, "base")
        assert np.allclose(loaded.T_scan_base, state.T_scan_base, atol=1e-12)
    with np.load(folder / "labels.npz") as arrays:
        assert np.array_equal(arrays["part"], simulated.labels)
        assert np.array_equal(arrays["view"], simulated.view)
    assert truth["parts"] == ["base", "tower", "boom", "hook"]
    simulate(crane, seed=4).save(folder)
    assert not (folder / "guess.json").exists(), "it is of another scan"


@pytest.mark.parametrize(
    ("values", "fault"),
    [
        ({"views": 0}, "views must be a whole number from 1"),
        ({"points": 0}, "points must be a whole number from 1"),
        ({"distance": (2.0, 1.0)}, "distance must be the lesser number, then the greater"),
        ({"distance": (0.0, 1.0)}, r"distance\[0\] must be a finite number above 0"),
        ({"distance": 1.0}, "distance must be 2 numbers"),
        ({"noise": -0.1}, "noise must be a finite number from 0"),
        ({"noise": float("nan")}, "noise must be a finite number from 0"),
        ({"bend": -0.1}, "bend must be"),
        ({"rounding": 0.2}, "rounding must be"),
        ({"stray": -1.0}, "stray must be"),
        ({"mixed_pixels": 1.5}, "mixed_pixels must be a number from 0 to 1, not 1.5"),
        ({"missing_random_parts": -1}, "missing_random_parts must be"),
        ({"missing_share": 1.0}, "missing_share must be"),
        ({"missing_parts": "boom"}, "missing_parts must be several names"),
        ({"guess": 0.1}, r"guess must be GuessOffset\(...\)"),
    ],
)
def test_sensors_out_of_range_raise(values: dict[str, object], fault: str) -> None:
    with pytest.raises(OptionError, match=f"Sensor.{fault}"):
        Sensor(**values)  # type: ignore[arg-type]


def test_what_cannot_be_scanned_raises(crane: ArticulatedModel) -> None:
    with pytest.raises(UnknownNameError, match="no part named 'bom'; did you mean 'boom'"):
        simulate(crane, sensor=Sensor(missing_parts=("bom",)))
    with pytest.raises(StateError, match="limits"):
        simulate(crane, State(joints={"slide": 99.0}))
    with pytest.raises(UnknownNameError, match="no joint named 'trun'; did you mean 'turn'"):
        simulate(crane, State(joints={"trun": 1.0}))
    with pytest.raises(ScanError, match="cannot leave out 4 of the 4 parts"):
        simulate(crane, sensor=Sensor(missing_random_parts=4))
    with pytest.raises(ScanError, match=r"simulated crane: .*no points"):
        simulate(crane, sensor=Sensor(missing_parts=("base", "tower", "boom", "hook")))
    for seed in (-1, 2**32):
        with pytest.raises(OptionError, match="seed must be a whole number from 0 to 4294967295"):
            simulate(crane, seed=seed)
    with pytest.raises(ArgumentError, match="expected State, got dict"):
        simulate(crane, state={})  # type: ignore[arg-type]


def test_a_model_without_geometry_raises(tmp_path: Path) -> None:
    (tmp_path / "bare.urdf").write_text('<robot name="bare"><link name="base"/></robot>')
    with pytest.raises(ModelError, match="no geometry"):
        simulate(ArticulatedModel.from_urdf(tmp_path / "bare.urdf"))
