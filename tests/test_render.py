"""Pictures: what is where, what hides what, and how views are chosen."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from pwralign_kin.exceptions import ArgumentError, UnknownNameError
from pwralign_kin.model import ArticulatedModel
from pwralign_kin.render import (
    PosedMesh,
    View,
    corner_normals,
    default_views,
    draw,
    drawable,
    drawing,
    part_colours,
    posed_mesh,
    refitted,
    render,
)
from pwralign_kin.render.drawing import MOST_POINTS
from pwralign_kin.scan import Scan
from pwralign_kin.state import State

SIZE = (160, 120)

TWO_BOXES = """<robot name="two">
<link name="base"><visual><geometry><box size="0.4 0.4 0.4"/></geometry></visual></link>
<link name="arm"><visual><geometry><box size="0.2 0.2 0.2"/></geometry></visual></link>
<joint name="lift" type="prismatic"><origin xyz="0 0 0.3"/><parent link="base"/><child link="arm"/>
<axis xyz="0 0 1"/><limit lower="0" upper="1" effort="1" velocity="1"/></joint></robot>"""

FRONT = View(np.array([4.0, 0.0, 0.1]), np.array([0.0, 0.0, 0.1]), np.array([0.0, 0.0, 1.0]), np.radians(15.0))


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> ArticulatedModel:
    path = tmp_path_factory.mktemp("robot") / "two.urdf"
    path.write_text(TWO_BOXES)
    return ArticulatedModel.from_urdf(path)


def drawn(picture: np.ndarray) -> np.ndarray:
    """Where the picture is not background."""
    return (picture != 255).any(axis=2)


def hue_of(colour: np.ndarray) -> np.ndarray:
    """The direction of a colour away from grey."""
    linear = (np.asarray(colour, dtype=float) / 255.0) ** 2.2
    tint = linear - linear.mean()
    return tint / np.linalg.norm(tint)


def scan_at(*places: tuple[float, float, float]) -> Scan:
    """Ten points within a hair of each place (a scan needs ten)."""
    spread = np.random.default_rng(0).normal(scale=1e-4, size=(10, 3))
    return Scan(np.concatenate([place + spread for place in np.array(places)]))


def test_every_part_shows_in_its_colour_on_white(model: ArticulatedModel) -> None:
    picture = render(model, State(), size=SIZE, view=FRONT)
    assert picture.shape == (120, 160, 3)
    assert picture.dtype == np.uint8
    assert (picture[0] == 255).all()
    assert (picture[:, 0] == 255).all()
    base, arm = 255.0 * part_colours(2)
    assert hue_of(picture[80, 80]) @ hue_of(base) > 0.99
    assert hue_of(picture[36, 80]) @ hue_of(arm) > 0.99


def test_the_picture_follows_the_state(model: ArticulatedModel) -> None:
    low = drawn(render(model, State(), size=SIZE, view=FRONT))
    high = drawn(render(model, State(joints={"lift": 0.1}), size=SIZE, view=FRONT))
    moved = np.eye(4)
    moved[:3, 3] = [0.0, 0.1, 0.0]
    aside = drawn(render(model, State(moved), size=SIZE, view=FRONT))
    pixels_per_metre = 60.0 / np.tan(np.radians(7.5)) / 3.85
    assert np.argmax(low.any(axis=1)) - np.argmax(high.any(axis=1)) == pytest.approx(0.1 * pixels_per_metre, abs=1.5)
    # Seen from +x with z up, +y lies to the right.
    assert np.argmax(aside.any(axis=0)) - np.argmax(low.any(axis=0)) == pytest.approx(0.1 * pixels_per_metre, abs=1.5)


def test_points_show_in_front_and_not_behind(model: ArticulatedModel) -> None:
    bare = render(model, State(), size=SIZE, view=FRONT).astype(int)
    front = render(model, State(), scan_at((0.2, 0.0, 0.0)), size=SIZE, view=FRONT).astype(int)
    just_behind = render(model, State(), scan_at((0.195, 0.0, 0.0)), size=SIZE, view=FRONT).astype(int)
    behind = render(model, State(), scan_at((-0.2, 0.0, 0.0)), size=SIZE, view=FRONT).astype(int)
    assert np.array_equal(behind, bare)
    for picture in (front, just_behind):
        changed = (picture != bare).any(axis=2)
        assert 1 <= changed.sum() < 40
        assert (picture[changed].sum(axis=1) < bare[changed].sum(axis=1)).all()


def test_points_off_the_model_are_pale(model: ArticulatedModel) -> None:
    picture = render(model, State(), scan_at((0.0, 0.35, 0.0)), size=SIZE, view=FRONT)
    bare = render(model, State(), size=SIZE, view=FRONT)
    changed = (picture != bare).any(axis=2)
    assert changed.any()
    assert picture[changed].min() > 120


def test_dense_scans_do_not_bury_the_model(model: ArticulatedModel) -> None:
    rng = np.random.default_rng(0)
    points = np.column_stack([np.full(20000, 0.2), rng.uniform(-0.2, 0.2, (20000, 2))])
    bare = render(model, State(), size=SIZE, view=FRONT)
    picture = render(model, State(), Scan(points), size=SIZE, view=FRONT)
    darkened = picture.sum(axis=2) < 0.8 * bare.sum(axis=2)
    assert 0.05 < darkened.sum() / drawn(bare).sum() < 0.35


def test_hatched_parts_are_striped_and_others_as_before(model: ArticulatedModel) -> None:
    mesh = posed_mesh(model, State())
    plain = drawing(mesh, FRONT, size=SIZE).image.astype(int)
    striped = drawing(mesh, FRONT, size=SIZE, striped={1}).image.astype(int)
    arm = np.s_[30:42, 72:88]
    assert np.array_equal(striped[60:], plain[60:])
    assert (striped[arm] >= plain[arm]).all()
    assert np.ptp(striped[arm].sum(axis=2)) > np.ptp(plain[arm].sum(axis=2)) + 60


def test_a_drawing_tells_what_is_to_be_seen_in_it(model: ArticulatedModel) -> None:
    mesh = posed_mesh(model, State())
    scan = scan_at((0.2, 0.0, 0.0), (0.0, 0.35, 0.0), (-0.2, 0.0, 0.0))
    seen = drawing(mesh, FRONT, scan, size=SIZE)
    assert (seen.near, seen.far) == (10, 10)
    assert seen.shown.tolist() == [True, True]
    below = View(np.array([0.0, 0.0, -4.0]), np.zeros(3), np.array([1.0, 0.0, 0.0]), FRONT.fov)
    assert drawing(mesh, below, size=SIZE).shown.tolist() == [True, False]


def test_a_picture_looks_at_few_of_many_points(model: ArticulatedModel) -> None:
    mesh, rng = posed_mesh(model, State()), np.random.default_rng(5)
    on_top = np.column_stack([rng.uniform(-0.2, 0.2, (300_000, 2)), np.full(300_000, 0.2)])
    around = rng.uniform(5.0, 9.0, (500_000, 3))
    scan = Scan(np.concatenate([around, on_top]), sensor_origin=rng.normal(size=(800_000, 3)))
    few = drawable(scan, mesh)
    assert len(few) == 2 * MOST_POINTS
    assert np.count_nonzero(few.points[:, 2] < 1.0) == MOST_POINTS
    row = int(np.flatnonzero((scan.points == few.points[0]).all(axis=1))[0])
    assert np.array_equal(few.sensor_origin[0], scan.sensor_origin[row])
    assert drawable(few.cropped([-1, -1, -1], [1, 1, 1]), mesh).points.shape == (MOST_POINTS, 3)


def test_outlines_are_dark_and_smooth(model: ArticulatedModel) -> None:
    tilted = View(FRONT.eye, FRONT.target, np.array([0.0, 0.2, 1.0]), FRONT.fov)
    levels = np.unique(draw(posed_mesh(model, State()), tilted, size=SIZE).sum(axis=2))
    assert len(levels[(levels > 560) & (levels < 760)]) >= 2  # a slanting edge on white has steps in between
    assert levels.min() < 300


def test_the_same_picture_comes_out_twice(model: ArticulatedModel) -> None:
    scan = scan_at((0.2, 0.0, 0.0), (0.0, 0.2, 0.0))
    assert np.array_equal(render(model, State(), scan, size=SIZE), render(model, State(), scan, size=SIZE))


@pytest.mark.parametrize("size", [(160, 120), (90, 160)])
@pytest.mark.parametrize("up", np.eye(3).tolist())
def test_default_views_hold_the_whole_model(model: ArticulatedModel, size: tuple[int, int], up: list[float]) -> None:
    mesh = posed_mesh(model, State(joints={"lift": 0.7}))
    views = default_views(mesh, size=size, up=np.array(up))
    for view in views:
        shown = drawn(draw(mesh, view, size=size))
        assert not shown[[0, -1]].any()
        assert not shown[:, [0, -1]].any()
        rows, columns = np.flatnonzero(shown.any(axis=1)), np.flatnonzero(shown.any(axis=0))
        assert max(np.ptp(rows) / size[1], np.ptp(columns) / size[0]) > 0.8
    first, second = (view.axes()[2] for view in views)
    assert first @ second < 0.8


def test_the_first_view_is_the_sensors(model: ArticulatedModel) -> None:
    mesh = posed_mesh(model, State())
    origin = np.array([0.5, -2.0, 1.0])
    points = np.random.default_rng(0).normal(size=(20, 3))
    view, _ = default_views(mesh, Scan(points, sensor_origin=origin), size=SIZE)
    assert np.array_equal(view.eye, origin)
    shown = drawn(draw(mesh, view, size=SIZE))
    assert shown.any()
    assert not shown[[0, -1]].any()
    assert not shown[:, [0, -1]].any()


def test_a_view_is_fitted_to_another_size(model: ArticulatedModel) -> None:
    mesh = posed_mesh(model, State())
    scan = Scan(np.random.default_rng(0).normal(size=(20, 3)), sensor_origin=np.array([0.5, -2.0, 1.0]))
    for view in default_views(mesh, scan, size=SIZE):
        other = refitted(view, mesh, (80, 200))
        assert other.axes()[2] @ view.axes()[2] > 0.99
        shown = drawn(draw(mesh, other, size=(80, 200)))
        assert not shown[[0, -1]].any()
        assert not shown[:, [0, -1]].any()
        assert (
            max(np.ptp(np.flatnonzero(shown.any(axis=1))) / 200, np.ptp(np.flatnonzero(shown.any(axis=0))) / 80) > 0.8
        )


def test_a_cloud_in_the_frame_of_its_camera_is_shown_upright(model: ArticulatedModel) -> None:
    ahead = np.eye(4)
    ahead[:3, 3] = [0.1, 0.0, 3.0]
    points = np.random.default_rng(0).normal(size=(20, 3))
    mesh = posed_mesh(model, State(ahead))
    for view in default_views(mesh, Scan(points, sensor_origin=np.zeros(3)), size=SIZE):
        assert np.array_equal(view.up, [0.0, -1.0, 0.0])
    for view in default_views(mesh, Scan(points, sensor_origin=np.array([0.0, -2.0, 3.0])), size=SIZE):
        assert np.array_equal(view.up, [0.0, 0.0, 1.0])


@pytest.mark.parametrize("origin", [(0.0, 0.0, 0.0), (0.0, 0.0, 0.1), (0.3, 0.0, 0.0), (0.0, 0.0, 3.0)])
def test_a_sensor_within_or_above_the_model_still_gives_a_view(
    model: ArticulatedModel, origin: tuple[float, float, float]
) -> None:
    mesh = posed_mesh(model, State())
    points = np.random.default_rng(0).normal(size=(20, 3))
    for view in default_views(mesh, Scan(points, sensor_origin=origin), size=SIZE):
        assert drawn(draw(mesh, view, size=SIZE)).any()


def test_a_scan_without_visible_points_is_drawn(model: ArticulatedModel) -> None:
    far_away = scan_at((100.0, 0.0, 0.0))
    bare = render(model, State(), size=SIZE, view=FRONT)
    assert np.array_equal(render(model, State(), far_away, size=SIZE, view=FRONT), bare)


def test_neighbouring_colours_differ() -> None:
    colours = part_colours(40)
    assert colours.min() >= 0.0
    assert colours.max() <= 1.0
    assert np.linalg.norm(np.diff(colours, axis=0), axis=1).min() > 0.2


def test_normals_are_flat_on_a_box_and_smooth_on_a_ball() -> None:
    box = trimesh.creation.box()
    normals = corner_normals(box.vertices, box.faces)
    assert np.allclose(normals, box.face_normals[:, None])
    ball = trimesh.creation.icosphere(subdivisions=3)
    normals = corner_normals(ball.vertices, ball.faces)
    assert np.einsum("fci,fci->fc", normals, ball.vertices[ball.faces]).min() > 0.999
    apart = ball.vertices[ball.faces].reshape(-1, 3)  # an STL shares no vertices
    assert np.allclose(corner_normals(apart, np.arange(len(apart)).reshape(-1, 3)), normals)


def test_normals_do_not_cancel_where_the_winding_flips() -> None:
    ball = trimesh.creation.icosphere(subdivisions=2)
    faces = ball.faces.copy()
    faces[::3] = faces[::3, ::-1]
    assert np.allclose(np.linalg.norm(corner_normals(ball.vertices, faces), axis=2), 1.0)


def test_a_far_scan_frame_costs_no_precision() -> None:
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.1)
    shift = np.array([5000.0, -3000.0, 800.0])
    pictures = []
    for offset in (np.zeros(3), shift):
        mesh = PosedMesh(ball.vertices + offset, ball.faces, np.zeros(len(ball.faces), dtype=np.int64), ("ball",), 0.35)
        pictures.append(draw(mesh, default_views(mesh, size=SIZE)[0], size=SIZE).astype(int))
    assert np.abs(pictures[0] - pictures[1]).mean() < 0.5


def test_mistakes_are_typed(model: ArticulatedModel) -> None:
    with pytest.raises(UnknownNameError, match="did you mean 'lift'"):
        render(model, State(joints={"lft": 0.1}), size=SIZE, view=FRONT)
    with pytest.raises(ArgumentError, match="differ"):
        render(model, State(), size=SIZE, view=View(FRONT.eye, FRONT.eye, FRONT.up, 0.3))
