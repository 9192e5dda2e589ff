"""From where a model and its scan are shown."""

from __future__ import annotations

import numpy as np

from pwralign_kin.render.camera import View, camera_axes, projected, tangents
from pwralign_kin.render.mesh import PosedMesh
from pwralign_kin.render.samples import cast, middles
from pwralign_kin.scan import Scan
from pwralign_kin.se3 import Array, axes_across, rotation_about

NEAR_SURFACE = 0.02
"""Scan points within this distance of the model (relative to its diagonal) count as lying on it."""

_FIELD_OF_VIEW = np.radians(20.0)

_MARGIN = 0.92


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


def frame_of(mesh: PosedMesh, view: View, size: tuple[int, int]) -> tuple[float, float, float, float]:
    """Return left, top, right and bottom (pixels) of what holds `mesh` in a picture from `view`."""
    in_axes = (mesh.outline - view.eye) @ view.axes().T
    slopes = in_axes[:, :2] / np.maximum(in_axes[:, 2:], 1e-9)
    places = (slopes / tangents(size, view.fov) + 1.0) / 2.0 * np.array(size)
    return (*places.min(axis=0).tolist(), *places.max(axis=0).tolist())


def _upward(mesh: PosedMesh, scan: Scan | None, up: Array) -> Array:
    """Return `up` (3,), or what points up in the optical frame of a camera if `up` can only be its direction."""
    if scan is None or scan.sensor_origin is None or np.any(scan.sensor_origin):
        return up
    along = float(mesh.centre @ up) / max(float(np.linalg.norm(mesh.centre) * np.linalg.norm(up)), 1e-12)
    return np.array([0.0, -1.0, 0.0]) if along > np.cos(np.radians(35.0)) else up


def _fitted_view(outline: Array, forward: Array, up: Array, size: tuple[int, int]) -> View:
    """Return the closest view along `forward` that holds `outline` (n, 3).

    A vertex (x, y, z) in camera axes is inside when |x - ex| <= t (z - ez): linear in the eye (ex, ez), so
    the tightest eye is found in closed form.
    """
    axes = camera_axes(forward, up)
    in_axes = outline @ axes.T
    bounds = []
    eye = np.zeros(3)
    for side, tangent in enumerate(_MARGIN * tangents(size, _FIELD_OF_VIEW)):
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
        axes = camera_axes(forward, up)
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
    level = rotation_about(up, azimuth) @ axes_across(up)[0]
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
    pixels = cast(mesh, view, (width, height), middles((width, height)))
    hit = pixels.part >= 0
    areas = np.bincount(pixels.part[hit], pixels.depth[hit] ** 2, minlength=len(mesh.parts))
    seen = 0.0
    if scan is not None and len(scan.points):
        points = scan.points[:: max(1, len(scan.points) // 2000)]
        pixel, depth = projected(points, view, (width, height))
        shown = (pixel >= 0) & (depth < pixels.depth.reshape(-1)[pixel] + NEAR_SURFACE * mesh.diagonal)
        seen = np.count_nonzero(shown) / len(points)
    return float(np.sqrt(areas).sum() * (0.5 + seen))
