"""Pictures of a posed model and a scan, drawn by ray casting: no display, window system or GPU is needed."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pwralign_kin.dependencies import open3d
from pwralign_kin.exceptions import ModelError, StateError
from pwralign_kin.model import ArticulatedModel
from pwralign_kin.scan import Scan
from pwralign_kin.se3 import Array, rotation_about, transform
from pwralign_kin.state import State

Image = NDArray[np.uint8]
Indices = NDArray[np.int64]
Singles = NDArray[np.float32]

SAMPLES_PER_PIXEL = 2
"""Side of the square of rays that are averaged into a pixel that an edge or an outline crosses."""

POINT_SHARE = 0.16
"""Largest share of the model's silhouette that scan points may hide; more of them are thinned out."""

NEAR_SURFACE = 0.02
"""Scan points within this distance of the model (relative to its diagonal) count as lying on it."""

POINT_NEAR = np.array([0.06, 0.07, 0.12])
"""sRGB colour of scan points on the model."""

POINT_FAR = np.array([0.62, 0.62, 0.64])
"""sRGB colour of scan points off the model."""

_CREASE = np.cos(np.radians(40.0))
_BEND, _STEP = 0.7, 0.03  # cosine between normals and step in depth (of the diagonal) that make a line
_OCCLUSION_RAYS, _COARSE = 12, 3
_STRIPES, _STRIPED = 9.0, 0.62  # pixels from stripe to stripe, and how white they are
_FIELD_OF_VIEW = np.radians(20.0)
_MARGIN = 0.92


@dataclass(frozen=True)
class View:
    """A pinhole camera in the scan frame."""

    eye: Array
    """(3,) place of the camera, m."""

    target: Array
    """(3,) point in the middle of the picture, m."""

    up: Array
    """(3,) direction that points up in the picture."""

    fov: float
    """Angle that the shorter side of the picture spans, rad."""

    def axes(self) -> Array:
        """Return (3, 3) rows: right, down, forward, as unit vectors in the scan frame.

        Raises `StateError` when eye and target coincide.
        """
        forward = np.asarray(self.target, dtype=np.float64) - self.eye
        length = np.linalg.norm(forward)
        if not length > 0.0:
            raise StateError("a view needs an eye and a target that differ")
        return _camera_axes(forward / length, np.asarray(self.up, dtype=np.float64))


@dataclass(frozen=True)
class PosedMesh:
    """All geometry of a model in one state."""

    vertices: Array
    """(v, 3) in the scan frame, m."""

    faces: Indices
    """(f, 3) vertex indices."""

    face_part: Indices
    """(f,) index of the part that each face belongs to."""

    parts: tuple[str, ...]
    """Names of the parts."""

    diagonal: float
    """The model's diagonal, m."""

    @cached_property
    def centre(self) -> Array:
        """Middle (3,) of the axis-aligned bounding box, m."""
        return np.asarray((self.vertices.min(axis=0) + self.vertices.max(axis=0)) / 2.0)

    @cached_property
    def colours(self) -> Array:
        """sRGB colours (p, 3) of the parts, in [0, 1]; white for parts without geometry."""
        shown = np.bincount(self.face_part, minlength=len(self.parts)) > 0
        colours = np.ones((len(self.parts), 3))
        colours[shown] = part_colours(int(np.count_nonzero(shown)))
        return colours

    @cached_property
    def outline(self) -> Array:
        """Vertices (h, 3) of the convex hull: as far as the mesh reaches in any picture."""
        from scipy.spatial import ConvexHull, QhullError

        try:
            return np.asarray(self.vertices[ConvexHull(self.vertices - self.centre).vertices])
        except QhullError:  # a flat mesh has no hull
            return self.vertices

    @cached_property
    def scene(self) -> RayScene:
        """The mesh for casting rays, moved by minus `centre`, so that single precision is fine enough."""
        return RayScene(self.vertices - self.centre, self.faces)

    @cached_property
    def corner_normals(self) -> Singles:
        """Normals for shading, (f, 3, 3); see `corner_normals`."""
        return corner_normals(self.vertices, self.faces).astype(np.float32)


@dataclass(frozen=True)
class Hits:
    """What rays (...) met."""

    distance: Singles
    """(...) along the ray, m; infinite where nothing is met."""

    face: Indices
    """(...) index of the face; -1 where nothing is met."""

    normal: Singles
    """(..., 3) unit normal of the face by its winding."""

    barycentric: Singles
    """(..., 2) weights of the corners 1 and 2 of the face."""


class RayScene:
    """Triangles that rays and closest-place queries meet: Open3D's `RaycastingScene`, in single precision."""

    def __init__(self, vertices: Array, faces: Indices) -> None:
        """Take over `vertices` (v, 3), m, and `faces` (f, 3). Raises `DependencyError` without Open3D."""
        library = open3d()
        self._tensor = library.core.Tensor
        self._scene = library.t.geometry.RaycastingScene()
        self._scene.add_triangles(self._tensor(vertices.astype(np.float32)), self._tensor(faces.astype(np.uint32)))

    def cast(self, rays: Singles) -> Hits:
        """Return the first hit of each of `rays` (..., 6): origin and direction."""
        answer = self._scene.cast_rays(self._tensor(rays))
        distance = answer["t_hit"].numpy()
        face = np.where(np.isinf(distance), -1, answer["primitive_ids"].numpy().astype(np.int64))
        return Hits(distance, face, answer["primitive_normals"].numpy(), answer["primitive_uvs"].numpy())

    def blocked(self, rays: Singles, reach: float = np.inf) -> NDArray[np.bool_]:
        """Return (...) whether `rays` (..., 6) of unit direction meet anything within `reach`, m."""
        answer = self._scene.test_occlusions(self._tensor(rays), tnear=0.0, tfar=reach)
        return np.asarray(answer.numpy())

    def closest(self, places: Array) -> tuple[Array, Array, Indices]:
        """Return what is closest to `places` (n, 3): places (n, 3), their faces' normals and indices (n,)."""
        answer = self._scene.compute_closest_points(self._tensor(places.astype(np.float32)))
        return (
            answer["points"].numpy().astype(np.float64),
            answer["primitive_normals"].numpy().astype(np.float64),
            answer["primitive_ids"].numpy().astype(np.int64),
        )


def posed_mesh(model: ArticulatedModel, state: State) -> PosedMesh:
    """Return the geometry of every part of `model` placed by `state`.

    Raises `UnknownNameError` for joints that the model lacks and `ModelError` for a model without geometry.
    """
    T_scan_base = model.root_placement(state)
    vertices, faces, face_part = [], [], []
    count = 0
    placements = model.part_placements(model.values(state.joints))
    for index, (part, T_base_part) in enumerate(zip(model.parts, placements, strict=True)):
        vertices.append(transform(T_scan_base @ T_base_part, part.vertices))
        faces.append(part.faces + count)
        face_part.append(np.full(len(part.faces), index, dtype=np.int64))
        count += len(part.vertices)
    if not sum(map(len, faces)):
        raise ModelError(model.urdf_path, "the model has no geometry to show")
    return PosedMesh(
        np.concatenate(vertices),
        np.concatenate(faces),
        np.concatenate(face_part),
        tuple(part.name for part in model.parts),
        model.diagonal,
    )


def part_colours(count: int) -> Array:
    """Return (count, 3) sRGB colours in [0, 1], easy to tell apart, neighbours in the list most of all.

    Hues follow the golden angle in the OKLCH space (Ottosson, 2020, "A perceptual color space for image
    processing"). It comes back near an earlier hue after 8 and 13 steps; then the lightness differs.
    """
    index = np.arange(count)
    lightness = 0.67 + 0.042 * np.array([0, 4, 3, 2, 1])[index % 5]
    hue = np.radians(250.0 + 137.50776 * index)
    chroma = 0.105
    lms = np.stack([lightness, chroma * np.cos(hue), chroma * np.sin(hue)], axis=1) @ _OKLAB_TO_LMS.T
    return _to_srgb(np.clip(lms**3 @ _LMS_TO_LINEAR.T, 0.0, 1.0))


def render(
    model: ArticulatedModel,
    state: State,
    scan: Scan | None = None,
    *,
    size: tuple[int, int] = (1280, 720),
    view: View | None = None,
) -> Image:
    """Return a picture (height, width, 3) of `model` in `state`, each part in its own colour, on white.

    Points of `scan` that are not hidden by the model are drawn as dots, dark on the surface and grey off it.
    `size` is (width, height) in pixels; `view` is by default the first of `default_views`. The parts' colours
    are `PosedMesh.colours`.

    Raises `UnknownNameError` for joints that the model lacks and `ModelError` for a model without geometry.
    """
    mesh = posed_mesh(model, state)
    return draw(mesh, default_views(mesh, scan, size=size)[0] if view is None else view, scan, size=size)


def default_views(
    mesh: PosedMesh, scan: Scan | None = None, *, size: tuple[int, int] = (1280, 720), up: Array | None = None
) -> tuple[View, View]:
    """Return two views that show the mesh well in a picture of `size` (width, height).

    The first is from the sensor if `scan` has one origin, else oblique from the side that shows most of the
    parts and of the scan; the second is from another side. `up` (3,) is the upward direction in the scan
    frame, by default z; where the sensor at the origin looks along it, the scan is taken to be in the optical
    frame of a camera, in which y points down (ROS REP 103).
    """
    up = _upward(mesh, scan, np.array([0.0, 0.0, 1.0]) if up is None else np.asarray(up, dtype=np.float64))
    candidates = [_oblique_view(mesh.outline, up, azimuth, size) for azimuth in np.radians(np.arange(0.0, 360.0, 30.0))]
    scores = np.array([_view_score(mesh, scan, view, size) for view in candidates])
    if scan is not None and scan.sensor_origin is not None and np.ndim(scan.sensor_origin) == 1:
        first = _view_from(np.asarray(scan.sensor_origin, dtype=np.float64), mesh.outline, up, size)
    else:
        first = candidates[int(np.argmax(scores))]
    turned = np.array([_azimuth_cosine(first, view, up) for view in candidates])
    second = candidates[int(np.argmax(np.where(np.abs(turned) < 0.6, scores, -np.inf)))]
    return first, second


@dataclass(frozen=True)
class Drawing:
    """A picture and what is to be seen in it."""

    image: Image
    """(height, width, 3)."""

    shown: NDArray[np.bool_]
    """(p,) the parts that are not hidden."""

    near: int
    """Number of dots of points on the model, and ..."""

    far: int
    """... off it."""


def draw(mesh: PosedMesh, view: View, scan: Scan | None = None, *, size: tuple[int, int] = (1280, 720)) -> Image:
    """Return the picture (height, width, 3) of `mesh` from `view` with the points of `scan`; see `render`."""
    return drawing(mesh, view, scan, size=size).image


def drawing(
    mesh: PosedMesh,
    view: View,
    scan: Scan | None = None,
    *,
    size: tuple[int, int] = (1280, 720),
    striped: Collection[int] = (),
    dot: float | None = None,
) -> Drawing:
    """Return the picture of `mesh` from `view` with the points of `scan`, parts in `striped` (indices) hatched.

    `dot` is the radius of points, pixels; by default it goes with the size. One ray is cast for every pixel,
    and more where neighbours differ.
    """
    pixels = _cast(mesh, view, size, _middles(size))
    busy = _busy(pixels, mesh.diagonal)
    finer = _cast(mesh, view, size, _middles_within(busy))
    openness = _openness(mesh, pixels, view)
    stripes = np.isin(np.arange(len(mesh.parts)), list(striped))
    colour = np.ones((size[1], size[0], 3), dtype=np.float32)
    plain = (pixels.face >= 0) & ~busy
    colour[plain] = _shaded(mesh, pixels.at(plain), openness[plain], view, stripes)
    light = np.ones((*finer.face.shape, 3), dtype=np.float32)
    hit = finer.face >= 0
    open_there = np.broadcast_to(openness[busy][:, None], hit.shape)
    light[hit] = _shaded(mesh, finer.at(hit), open_there[hit], view, stripes)
    light *= 1.0 - 0.75 * _lines(pixels, busy, finer, mesh.diagonal)[..., None]
    colour[busy] = light.mean(axis=1)
    near = far = 0
    if scan is not None and len(scan.points):
        dot = 1.5e-3 * float(np.sqrt(size[0] * size[1])) if dot is None else dot
        near, far = _paint_points(colour, mesh, pixels, view, scan.points, dot)
    shown = np.bincount(pixels.part[pixels.part >= 0], minlength=len(mesh.parts)) > 0
    return Drawing(as_bytes(colour), shown, near, far)


def corner_normals(vertices: Array, faces: Indices) -> Array:
    """Return unit normals (f, 3, 3) at the corners of `faces` (f, 3), smooth over edges under 40 degrees.

    Around a vertex, faces joined by smooth edges share the sum of their area-weighted normals. Vertices at
    the same place count as one. A face without area has the normal zero.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    corners = vertices[faces]
    area_normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(area_normal, axis=1)
    unit = area_normal / np.where(length > 0.0, length, 1.0)[:, None]

    place = distinct_rows(vertices)[1][faces]
    # Half-edge `k` of a face runs from its corner k to its corner k + 1.
    start, end = place.reshape(-1), np.roll(place, -1, axis=1).reshape(-1)
    low, high = np.minimum(start, end), np.maximum(start, end)
    order = np.lexsort((high, low))
    one, two = order[:-1], order[1:]
    shared = (low[one] == low[two]) & (high[one] == high[two])
    one, two = one[shared], two[shared]
    smooth = np.einsum("ij,ij->i", unit[one // 3], unit[two // 3]) > _CREASE
    one, two = one[smooth], two[smooth]

    def following(half_edge: Indices) -> Indices:
        return half_edge - half_edge % 3 + (half_edge + 1) % 3

    same_way = start[one] == start[two]
    linked_two_start = np.where(same_way, two, following(two))
    linked_two_end = np.where(same_way, following(two), two)
    rows = np.concatenate([one, following(one)])
    columns = np.concatenate([linked_two_start, linked_two_end])
    size = 3 * len(faces)
    _, group = connected_components(coo_array((np.ones(len(rows), dtype=bool), (rows, columns)), shape=(size, size)))
    per_corner = np.repeat(area_normal, 3, axis=0)
    total = np.stack([np.bincount(group, per_corner[:, axis]) for axis in range(3)], axis=1)
    total_length = np.linalg.norm(total, axis=1, keepdims=True)
    return np.asarray((total / np.where(total_length > 0.0, total_length, 1.0))[group].reshape(-1, 3, 3))


def distinct_rows(rows: NDArray[Any]) -> tuple[Indices, Indices]:
    """Return indices of one of each of the different `rows` (n, k), and (n,) which of those each row is like."""
    order = np.lexsort(rows.T)
    new = np.ones(len(rows), dtype=bool)
    new[1:] = (rows[order[1:]] != rows[order[:-1]]).any(axis=1)
    index = np.empty(len(rows), dtype=np.int64)
    index[order] = np.cumsum(new) - 1
    return order[new], index


# --- views ---


def refitted(view: View, mesh: PosedMesh, size: tuple[int, int]) -> View:
    """Return one of `default_views` for a picture of another `size` (width, height)."""
    if view.fov == _FIELD_OF_VIEW:
        return _fitted_view(mesh.outline, view.axes()[2], view.up, size)
    return _view_from(view.eye, mesh.outline, view.up, size)


def overview(points: Array, view: View, size: tuple[int, int]) -> View:
    """Return a view of all of `points` (n, 3) but the outermost: from the eye of `view`, or else along it."""
    forward = view.axes()[2]
    low, high = np.percentile(points, [1.0, 99.0], axis=0)
    inner = points[((points >= low) & (points <= high)).all(axis=1)]
    inner = points if len(inner) < 10 else inner
    if view.fov == _FIELD_OF_VIEW:
        return _fitted_view(inner, forward, view.up, size)
    return _view_from(view.eye, inner, view.up, size, np.radians(130.0))


def splat(points: Array, view: View, size: tuple[int, int]) -> Image:
    """Return a picture (height, width, 3) of `points` (n, 3) alone, the nearer the darker."""
    pixel, depth = _projected(points, view, size)
    inside = pixel >= 0
    shade = np.ones(size[0] * size[1], dtype=np.float32)
    if inside.any():
        nearest = np.full(len(shade), np.inf)
        np.minimum.at(nearest, pixel[inside], depth[inside])
        low, high = np.percentile(depth[inside], [2.0, 98.0])
        hit = np.isfinite(nearest)
        shade[hit] = 0.22 + 0.5 * np.clip((nearest[hit] - low) / max(high - low, 1e-9), 0.0, 1.0)
    return as_bytes(np.repeat(shade.reshape(size[1], size[0], 1), 3, axis=2))


def frame_of(mesh: PosedMesh, view: View, size: tuple[int, int]) -> tuple[float, float, float, float]:
    """Return left, top, right and bottom (pixels) of what holds `mesh` in a picture from `view`."""
    in_axes = (mesh.outline - view.eye) @ view.axes().T
    slopes = in_axes[:, :2] / np.maximum(in_axes[:, 2:], 1e-9)
    places = (slopes / _tangents(size, view.fov) + 1.0) / 2.0 * np.array(size)
    return (*places.min(axis=0).tolist(), *places.max(axis=0).tolist())


def _upward(mesh: PosedMesh, scan: Scan | None, up: Array) -> Array:
    """Return `up` (3,), or what points up in the optical frame of a camera if `up` can only be its direction."""
    if scan is None or scan.sensor_origin is None or np.any(scan.sensor_origin):
        return up
    along = float(mesh.centre @ up) / max(float(np.linalg.norm(mesh.centre) * np.linalg.norm(up)), 1e-12)
    return np.array([0.0, -1.0, 0.0]) if along > np.cos(np.radians(35.0)) else up


def _camera_axes(forward: Array, up: Array) -> Array:
    """Return (3, 3) rows right, down, forward for the unit direction `forward`; `up` may lie along it."""
    right = np.cross(forward, up)
    if np.linalg.norm(right) < 1e-6 * max(float(np.linalg.norm(up)), 1e-12):
        right = np.cross(forward, np.eye(3)[int(np.argmin(np.abs(forward)))])
    right = right / np.linalg.norm(right)
    return np.stack([right, np.cross(forward, right), forward])


def _tangents(size: tuple[int, int], fov: float) -> Array:
    """Return half the width and half the height of the picture at distance 1."""
    return np.asarray(np.tan(fov / 2.0) * np.array(size) / min(size))


def _fitted_view(outline: Array, forward: Array, up: Array, size: tuple[int, int]) -> View:
    """Return the closest view along `forward` that holds `outline` (n, 3).

    A vertex (x, y, z) in camera axes is inside when |x - ex| <= t (z - ez): linear in the eye (ex, ez), so
    the tightest eye is found in closed form.
    """
    axes = _camera_axes(forward, up)
    in_axes = outline @ axes.T
    bounds = []
    eye = np.zeros(3)
    for side, tangent in enumerate(_MARGIN * _tangents(size, _FIELD_OF_VIEW)):
        left = float(np.min(tangent * in_axes[:, 2] + in_axes[:, side]))
        right = float(np.min(tangent * in_axes[:, 2] - in_axes[:, side]))
        eye[side] = (left - right) / 2.0
        bounds.append((left + right) / (2.0 * tangent))
    eye[2] = min(bounds)
    return View(eye @ axes, eye @ axes + axes[2], up, float(_FIELD_OF_VIEW))


def _view_from(eye: Array, outline: Array, up: Array, size: tuple[int, int], widest: float = np.radians(75.0)) -> View:
    """Return the view from `eye` that just holds `outline` (n, 3).

    Where `eye` is so close that the shorter side would span more than `widest` (rad), it is from further back.
    """
    forward = (outline.min(axis=0) + outline.max(axis=0)) / 2.0 - eye
    distance = float(np.linalg.norm(forward))
    if distance < 1e-6:
        return _oblique_view(outline, up, 0.0, size)
    forward = forward / distance
    for _ in range(3):
        axes = _camera_axes(forward, up)
        in_axes = (outline - eye) @ axes.T
        if in_axes[:, 2].min() < 0.02 * distance:
            return _fitted_view(outline, forward, up, size)
        slopes = in_axes[:, :2] / in_axes[:, 2:]
        middle = (slopes.min(axis=0) + slopes.max(axis=0)) / 2.0
        forward = np.array([*middle, 1.0]) @ axes
        forward /= np.linalg.norm(forward)
    half = np.abs(slopes - middle).max(axis=0) / np.array(size) * min(size) / _MARGIN
    fov = 2.0 * float(np.arctan(half.max()))
    if fov > widest:
        return _fitted_view(outline, forward, up, size)
    return View(eye, eye + forward * distance, up, fov)


def _oblique_view(outline: Array, up: Array, azimuth: float, size: tuple[int, int]) -> View:
    """Return the fitted view from `azimuth` (rad) about `up`, looking down by 20 degrees."""
    up = up / np.linalg.norm(up)
    level = np.cross(up, np.eye(3)[int(np.argmin(np.abs(up)))])
    level = rotation_about(up, azimuth) @ (level / np.linalg.norm(level))
    elevation = np.radians(20.0)
    return _fitted_view(outline, np.cos(elevation) * level - np.sin(elevation) * up, up, size)


def _azimuth_cosine(one: View, two: View, up: Array) -> float:
    """Return the cosine of the angle between the two directions of view, seen along `up`."""
    flat = [view.axes()[2] - view.axes()[2] @ up * up / (up @ up) for view in (one, two)]
    lengths = np.linalg.norm(flat[0]) * np.linalg.norm(flat[1])
    return float(flat[0] @ flat[1] / lengths) if lengths > 1e-9 else 0.0


def _view_score(mesh: PosedMesh, scan: Scan | None, view: View, size: tuple[int, int]) -> float:
    """Return how much a view shows: roots of the parts' visible areas, times the share of the scan seen."""
    width, height = (max(1, round(96 * side / max(size))) for side in size)
    pixels = _cast(mesh, view, (width, height), _middles((width, height)))
    hit = pixels.part >= 0
    areas = np.bincount(pixels.part[hit], pixels.depth[hit] ** 2, minlength=len(mesh.parts))
    seen = 0.0
    if scan is not None and len(scan.points):
        points = scan.points[:: max(1, len(scan.points) // 2000)]
        pixel, depth = _projected(points, view, (width, height))
        shown = (pixel >= 0) & (depth < pixels.depth.reshape(-1)[pixel] + NEAR_SURFACE * mesh.diagonal)
        seen = np.count_nonzero(shown) / len(points)
    return float(np.sqrt(areas).sum() * (0.5 + seen))


# --- drawing ---


@dataclass(frozen=True)
class _Samples:
    """What rays of a view met; all arrays (..., as said)."""

    places: Singles  # (2) column and row in the picture, pixels
    directions: Singles  # (3) unit, scan frame
    depth: Singles  # along the forward axis, m; infinite where nothing is met
    face: Indices  # -1 where nothing is met
    part: Indices  # -1 where nothing is met
    normal: Singles  # (3) of the face met, towards the camera
    barycentric: Singles  # (2) of the corners 1 and 2 of the face

    def at(self, chosen: Any) -> _Samples:
        """Return the samples that an index or a mask chooses."""
        return _Samples(*(getattr(self, name)[chosen] for name in self.__dataclass_fields__))


def _middles(size: tuple[int, int]) -> Singles:
    """Return (height, width, 2) the middle of every pixel."""
    columns, rows = np.meshgrid(np.arange(size[0], dtype=np.float32), np.arange(size[1], dtype=np.float32))
    return np.stack([columns, rows], axis=-1) + np.float32(0.5)


def _middles_within(chosen: NDArray[np.bool_]) -> Singles:
    """Return (n, s, 2) the middles of the squares that the chosen pixels are divided into, row by row."""
    rows, columns = np.nonzero(chosen)
    inner = _middles((SAMPLES_PER_PIXEL, SAMPLES_PER_PIXEL)).reshape(-1, 2) / SAMPLES_PER_PIXEL
    return (np.stack([columns, rows], axis=-1)[:, None] + inner).astype(np.float32)


def _cast(mesh: PosedMesh, view: View, size: tuple[int, int], places: Singles) -> _Samples:
    """Cast a ray through each of `places` (..., 2) of the picture."""
    axes = view.axes().astype(np.float32)
    slopes = ((2.0 * places / np.array(size, dtype=np.float32) - 1.0) * _tangents(size, view.fov)).astype(np.float32)
    rays = np.empty((*places.shape[:-1], 6), dtype=np.float32)
    rays[..., :3] = view.eye - mesh.centre
    directions = rays[..., 3:]
    directions[:] = slopes @ axes[:2] + axes[2]
    directions /= np.sqrt(np.einsum("...i,...i->...", directions, directions))[..., None]
    hits = mesh.scene.cast(rays)
    away = np.einsum("...i,...i->...", hits.normal, directions) > 0.0
    return _Samples(
        places=places,
        directions=directions,
        depth=hits.distance * (directions @ axes[2]),
        face=hits.face,
        part=np.where(hits.face < 0, -1, mesh.face_part[hits.face]),
        normal=np.where(away[..., None], -hits.normal, hits.normal),
        barycentric=hits.barycentric,
    )


def _shaded(mesh: PosedMesh, met: _Samples, openness: Singles, view: View, striped: NDArray[np.bool_]) -> Singles:
    """Return the colours (n, 3) of samples on the mesh in linear light: Lambert's law, two lamps, ambient occlusion.

    `openness` is (n,), `striped` (p,) the parts to be hatched.
    """
    weights = np.concatenate([1.0 - met.barycentric.sum(axis=1, keepdims=True), met.barycentric], axis=1)
    smooth = np.einsum("nc,nci->ni", weights, mesh.corner_normals[met.face])
    smooth *= np.where(np.einsum("ni,ni->n", smooth, met.normal) < 0.0, -1.0, 1.0).astype(np.float32)[:, None]
    length = np.sqrt(np.einsum("ni,ni->n", smooth, smooth))[:, None]
    normal = np.where(length > 0.5, smooth / np.where(length > 0.0, length, 1.0), met.normal)

    axes = view.axes().astype(np.float32)
    lamps = np.array([[-0.45, -0.75, -0.6], [0.8, -0.1, -0.5]], dtype=np.float32) @ axes
    lamps /= np.linalg.norm(lamps, axis=1, keepdims=True)
    key_light, fill_light = np.clip(lamps @ normal.T, 0.0, None)
    sky = 0.5 - 0.5 * normal @ axes[1]
    light = (0.28 + 0.30 * sky + 0.14 * fill_light) * openness + 0.52 * key_light * (0.4 + 0.6 * openness)
    colour = to_linear(mesh.colours).astype(np.float32)[met.part] * light.astype(np.float32)[:, None]
    hatched = striped[met.part]
    if hatched.any():
        colour[hatched] += stripes(met.places[hatched])[:, None] * (1.0 - colour[hatched])
    return np.asarray(colour)


def stripes(places: Singles) -> Singles:
    """Return how white (n,) places (n, 2) of the picture, pixels, are in a hatched area, in [0, 1]."""
    wave = np.sin(places.sum(axis=-1) * np.float32(2.0 * np.pi / (np.sqrt(2.0) * _STRIPES)))
    return np.asarray(_STRIPED * np.clip(0.5 + 1.6 * wave, 0.0, 1.0), dtype=np.float32)


def _openness(mesh: PosedMesh, pixels: _Samples, view: View) -> Singles:
    """Return (height, width) the cosine-weighted share of sky that the surface in each pixel sees.

    What is further away than 0.15 diagonals does not hide the sky. Traced for one pixel in nine, with few
    rays each, and smoothed.
    """
    coarse = pixels.at(np.s_[::_COARSE, ::_COARSE])
    hit = coarse.face >= 0
    normals, directions = coarse.normal[hit], coarse.directions[hit]
    distance = coarse.depth[hit] / (directions @ view.axes()[2])
    places = view.eye - mesh.centre + directions * distance[:, None] + 1e-4 * mesh.diagonal * normals

    rng = np.random.default_rng(0)
    shift, turn = rng.random((2, len(places), 1), dtype=np.float32)
    steps = np.arange(_OCCLUSION_RAYS, dtype=np.float32)
    # A golden-angle spiral on the disc, shifted and turned at random from place to place.
    radii = np.sqrt((steps + shift) / _OCCLUSION_RAYS)
    angles = np.float32(2.0 * np.pi) * turn + np.float32(2.39996) * steps
    helper = np.where(np.abs(normals[:, :1]) < 0.7, *np.eye(3, dtype=np.float32)[:2, None])
    tangent = np.cross(normals, helper)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    bitangent = np.cross(normals, tangent)
    rays = np.empty((len(places), _OCCLUSION_RAYS, 6), dtype=np.float32)
    rays[..., :3] = places[:, None]
    rays[..., 3:] = (
        (radii * np.cos(angles))[..., None] * tangent[:, None]
        + (radii * np.sin(angles))[..., None] * bitangent[:, None]
        + np.sqrt(1.0 - radii**2)[..., None] * normals[:, None]
    )
    blocked = mesh.scene.blocked(rays, reach=0.15 * mesh.diagonal)
    total = np.zeros(hit.shape, dtype=np.float32)
    total[hit] = 1.0 - blocked.mean(axis=1)
    weight = _summed_around(hit.astype(np.float32))
    smooth = np.where(weight > 0.0, _summed_around(total) / np.maximum(weight, 1.0), 1.0)
    return _enlarged(smooth.astype(np.float32), pixels.face.shape)


def _summed_around(values: Singles) -> Singles:
    """Return for each entry (r, c) the sum of the square of nine around it."""
    padded = np.pad(values, 1)
    rows = padded[:-2] + padded[1:-1] + padded[2:]
    return np.asarray(rows[:, :-2] + rows[:, 1:-1] + rows[:, 2:])


def _enlarged(values: Singles, shape: tuple[int, ...]) -> Singles:
    """Return `values`, which stand for every `_COARSE`-th row and column, interpolated to `shape`."""
    for axis in (0, 1):
        place = np.minimum(np.arange(shape[axis], dtype=np.float32) / _COARSE, values.shape[axis] - 1)
        low = place.astype(int)
        share = (place - low).reshape((-1, 1) if axis == 0 else (1, -1))
        high = np.minimum(low + 1, values.shape[axis] - 1)
        values = values.take(low, axis) * (1.0 - share) + values.take(high, axis) * share
    return values


def _busy(pixels: _Samples, diagonal: float) -> NDArray[np.bool_]:
    """Return (height, width) the pixels that differ from one of their neighbours so much that a line runs between."""
    busy = np.zeros(pixels.face.shape, dtype=bool)
    for here, there in ((np.s_[:-1], np.s_[1:]), (np.s_[:, :-1], np.s_[:, 1:])):
        one, two = pixels.at(here), pixels.at(there)
        hit = np.nonzero((one.face != two.face) & ((one.face >= 0) | (two.face >= 0)))
        differ = np.zeros(one.face.shape, dtype=bool)
        differ[hit] = _line(one.at(hit), two.at(hit), diagonal) > 0.0
        busy[here] |= differ
        busy[there] |= differ
    return busy


def _lines(pixels: _Samples, busy: NDArray[np.bool_], finer: _Samples, diagonal: float) -> Singles:
    """Return the darkness (n, s) of lines at the samples within busy pixels."""
    height, width = busy.shape
    side = SAMPLES_PER_PIXEL
    # Where the sample of each square is in the two sets, one after the other; with a frame around the picture.
    index = np.arange(height * width, dtype=np.int32).reshape(height, width).repeat(side, 0).repeat(side, 1)
    rows, columns = np.nonzero(busy)
    inner = np.arange(side)
    row = (side * rows[:, None, None] + inner[:, None]) + np.zeros(side, dtype=int)
    column = (side * columns[:, None, None] + inner) + np.zeros((side, 1), dtype=int)
    index[row, column] = height * width + np.arange(finer.face.size).reshape(row.shape)
    row, column = row.reshape(finer.face.shape), column.reshape(finer.face.shape)
    both = _Samples(
        *(
            np.concatenate([values.reshape(-1, *tail), more.reshape(-1, *tail)])
            for values, more, tail in (
                (getattr(pixels, name), getattr(finer, name), getattr(pixels, name).shape[2:])
                for name in _Samples.__dataclass_fields__
            )
        )
    )
    darkness = np.zeros(finer.face.shape, dtype=np.float32)
    for down, right in ((-1, 0), (1, 0), (0, -1), (0, 1)):
        beside = index[np.clip(row + down, 0, len(index) - 1), np.clip(column + right, 0, index.shape[1] - 1)]
        differ = np.nonzero(both.face[beside] != finer.face)
        darkness[differ] = np.maximum(darkness[differ], _line(finer.at(differ), both.at(beside[differ]), diagonal))
    return darkness


def _line(one: _Samples, two: _Samples, diagonal: float) -> Singles:
    """Return how dark (...) a line between neighbours is: 1 between parts and at depth steps, less on creases."""
    bend = np.einsum("...i,...i->...", one.normal, two.normal)
    apart = np.minimum(one.depth, 1e3 * diagonal) - np.minimum(two.depth, 1e3 * diagonal)
    outline = (one.part != two.part) | (np.abs(apart) > _STEP * diagonal)
    crease = (one.face >= 0) & (two.face >= 0) & (bend < _BEND)
    return np.where(outline, 1.0, np.where(crease, 0.35, 0.0)).astype(np.float32)


def _projected(points: Array, view: View, size: tuple[int, int]) -> tuple[Indices, Array]:
    """Return the flat pixel index (n,) of each point, -1 outside the picture, and its depth (n,), m."""
    in_axes = (points - view.eye) @ view.axes().T
    depth = in_axes[:, 2]
    ahead = depth > 1e-9
    slopes = in_axes[:, :2] / np.where(ahead, depth, 1.0)[:, None]
    place = np.floor((slopes / _tangents(size, view.fov) + 1.0) / 2.0 * np.array(size))
    inside = ahead & (place >= 0).all(axis=1) & (place < np.array(size)).all(axis=1)
    column, row = np.where(inside[:, None], place, 0.0).astype(np.int64).T
    return np.where(inside, row * size[0] + column, -1), depth


def _paint_points(
    colour: Singles, mesh: PosedMesh, pixels: _Samples, view: View, points: Array, dot_radius: float
) -> tuple[int, int]:
    """Paint dots into `colour` (height, width, 3) where the model does not hide them; return how many on and off it.

    A point on the model is shown where its closest place on the surface is: noise must not hide it behind the
    surface.
    """
    height, width = pixels.face.shape
    reach = NEAR_SURFACE * mesh.diagonal
    surface = pixels.depth.reshape(-1)
    pixel, depth = _projected(points, view, (width, height))
    shown = np.flatnonzero((pixel >= 0) & (depth <= surface[pixel] + reach))
    local = points[shown] - mesh.centre
    closest, _, _ = mesh.scene.closest(local)
    near = np.linalg.norm(closest - local, axis=1) < reach
    place, place_depth = _projected(closest[near] + mesh.centre, view, (width, height))
    on_model = shown[near][(place >= 0) & (place_depth <= surface[place] + 0.25 * reach)]
    off_model = shown[~near][depth[shown[~near]] <= surface[pixel[shown[~near]]]]

    side = SAMPLES_PER_PIXEL
    fine = (side * width, side * height)
    radius = max(1.0, side * dot_radius)
    steps = np.arange(-int(np.ceil(radius)), int(np.ceil(radius)) + 1)
    offsets = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    offsets = offsets[(offsets**2).sum(axis=1) <= radius**2 + 0.5]
    rng = np.random.default_rng(0)
    limit = int(POINT_SHARE * side**2 * np.count_nonzero(pixels.part >= 0) / len(offsets))
    for chosen, dot, opacity in ((off_model, POINT_FAR, 0.6), (on_model, POINT_NEAR, 0.85)):
        kept = rng.permutation(chosen)[:limit]
        middle, _ = _projected(points[kept], view, fine)
        rows = middle[:, None] // fine[0] + offsets[:, 0]
        columns = middle[:, None] % fine[0] + offsets[:, 1]
        inside = (rows >= 0) & (rows < fine[1]) & (columns >= 0) & (columns < fine[0])
        covered = np.zeros((fine[1], fine[0]), dtype=bool)
        covered[rows[inside], columns[inside]] = True
        share = covered.reshape(height, side, width, side).mean(axis=(1, 3), dtype=np.float32)
        touched = share > 0.0
        colour[touched] += opacity * share[touched, None] * (to_linear(dot) - colour[touched])
    return len(on_model), len(off_model)


# --- colour ---

_OKLAB_TO_LMS = np.array(
    [
        [1.0, 0.3963377774, 0.2158037573],
        [1.0, -0.1055613458, -0.0638541728],
        [1.0, -0.0894841775, -1.2914855480],
    ]
)
_LMS_TO_LINEAR = np.array(
    [
        [4.0767416621, -3.3077115913, 0.2309699292],
        [-1.2684380046, 2.6097574011, -0.3413193965],
        [-0.0041960863, -0.7034186147, 1.7076147010],
    ]
)


def as_bytes(linear: Singles) -> Image:
    """Return linear light as sRGB bytes."""
    levels = np.rint(255.0 * _to_srgb(np.arange(4096) / 4095.0)).astype(np.uint8)
    return np.asarray(levels[np.rint(4095.0 * np.clip(linear, 0.0, 1.0)).astype(np.int16)])


def _to_srgb(linear: Array) -> Array:
    """Return linear light in [0, 1] encoded as sRGB (IEC 61966-2-1)."""
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 0.0) ** (1.0 / 2.4) - 0.055)


def to_linear(srgb: Array) -> Array:
    """Return sRGB in [0, 1] decoded to linear light (IEC 61966-2-1)."""
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
