"""Pictures of a posed model and a scan."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from pwralign_kin.arrays import Bools, Image, Singles
from pwralign_kin.model import ArticulatedModel
from pwralign_kin.render.camera import View, projected
from pwralign_kin.render.colours import as_bytes, to_linear
from pwralign_kin.render.mesh import PosedMesh, posed_mesh
from pwralign_kin.render.samples import SAMPLES_PER_PIXEL, Samples, cast, middles, middles_within
from pwralign_kin.render.shading import ambient_openness, busy_pixels, lines, shaded
from pwralign_kin.render.views import NEAR_SURFACE, default_views
from pwralign_kin.scan import Scan
from pwralign_kin.se3 import Array
from pwralign_kin.state import State

POINT_SHARE = 0.16
"""Largest share of the model's silhouette that scan points may hide; more of them are thinned out."""

MOST_POINTS = 200_000
"""Of the points about the model, and of the others, so many are looked at for a picture: far more than it has dots."""

POINT_NEAR = np.array([0.06, 0.07, 0.12])
"""sRGB colour of scan points on the model."""

POINT_FAR = np.array([0.62, 0.62, 0.64])
"""sRGB colour of scan points off the model."""


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
    scan = None if scan is None else drawable(scan, mesh)
    return draw(mesh, default_views(mesh, scan, size=size)[0] if view is None else view, scan, size=size)


def drawable(scan: Scan, mesh: PosedMesh) -> Scan:
    """Return `scan`, thinned at random where it has more points than pictures of `mesh` need."""
    if len(scan) <= MOST_POINTS:
        return scan
    margin = 2.0 * NEAR_SURFACE * mesh.diagonal
    low, high = mesh.vertices.min(axis=0) - margin, mesh.vertices.max(axis=0) + margin
    about = ((scan.points >= low) & (scan.points <= high)).all(axis=1)
    rng = np.random.default_rng(0)
    rows = [np.flatnonzero(about), np.flatnonzero(~about)]
    kept = np.concatenate([rng.choice(own, min(len(own), MOST_POINTS), replace=False) for own in rows])
    origin = scan.sensor_origin
    origin = origin[kept] if origin is not None and origin.ndim == 2 else origin
    return Scan(scan.points[kept], sensor_origin=origin, source=scan.source)


@dataclass(frozen=True)
class Drawing:
    """A picture and what is to be seen in it."""

    image: Image
    """(height, width, 3)."""

    shown: Bools
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
    pixels = cast(mesh, view, size, middles(size))
    busy = busy_pixels(pixels, mesh.diagonal)
    finer = cast(mesh, view, size, middles_within(busy))
    openness = ambient_openness(mesh, pixels, view)
    stripes = np.isin(np.arange(len(mesh.parts)), list(striped))
    colour = np.ones((size[1], size[0], 3), dtype=np.float32)
    plain = (pixels.face >= 0) & ~busy
    colour[plain] = shaded(mesh, pixels.at(plain), openness[plain], view, stripes)
    light = np.ones((*finer.face.shape, 3), dtype=np.float32)
    hit = finer.face >= 0
    open_there = np.broadcast_to(openness[busy][:, None], hit.shape)
    light[hit] = shaded(mesh, finer.at(hit), open_there[hit], view, stripes)
    light *= 1.0 - 0.75 * lines(pixels, busy, finer, mesh.diagonal)[..., None]
    colour[busy] = light.mean(axis=1)
    near = far = 0
    if scan is not None and len(scan.points):
        dot = 1.5e-3 * float(np.sqrt(size[0] * size[1])) if dot is None else dot
        near, far = _paint_points(colour, mesh, pixels, view, scan.points, dot)
    shown = np.bincount(pixels.part[pixels.part >= 0], minlength=len(mesh.parts)) > 0
    return Drawing(as_bytes(colour), shown, near, far)


def splat(points: Array, view: View, size: tuple[int, int]) -> Image:
    """Return a picture (height, width, 3) of `points` (n, 3) alone, the nearer the darker."""
    pixel, depth = projected(points, view, size)
    inside = pixel >= 0
    shade = np.ones(size[0] * size[1], dtype=np.float32)
    if inside.any():
        nearest = np.full(len(shade), np.inf)
        np.minimum.at(nearest, pixel[inside], depth[inside])
        low, high = np.percentile(depth[inside], [2.0, 98.0])
        hit = np.isfinite(nearest)
        shade[hit] = 0.22 + 0.5 * np.clip((nearest[hit] - low) / max(high - low, 1e-9), 0.0, 1.0)
    return as_bytes(np.repeat(shade.reshape(size[1], size[0], 1), 3, axis=2))


def _paint_points(
    colour: Singles, mesh: PosedMesh, pixels: Samples, view: View, points: Array, dot_radius: float
) -> tuple[int, int]:
    """Paint dots into `colour` (height, width, 3) where the model does not hide them; return how many on and off it.

    A point on the model is shown where its closest place on the surface is: noise must not hide it behind the
    surface.
    """
    height, width = pixels.face.shape
    reach = NEAR_SURFACE * mesh.diagonal
    surface = pixels.depth.reshape(-1)
    pixel, depth = projected(points, view, (width, height))
    shown = np.flatnonzero((pixel >= 0) & (depth <= surface[pixel] + reach))
    local = points[shown] - mesh.centre
    closest, _, _ = mesh.scene.closest(local)
    near = np.linalg.norm(closest - local, axis=1) < reach
    place, place_depth = projected(closest[near] + mesh.centre, view, (width, height))
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
        middle, _ = projected(points[kept], view, fine)
        rows = middle[:, None] // fine[0] + offsets[:, 0]
        columns = middle[:, None] % fine[0] + offsets[:, 1]
        inside = (rows >= 0) & (rows < fine[1]) & (columns >= 0) & (columns < fine[0])
        covered = np.zeros((fine[1], fine[0]), dtype=bool)
        covered[rows[inside], columns[inside]] = True
        share = covered.reshape(height, side, width, side).mean(axis=(1, 3), dtype=np.float32)
        touched = share > 0.0
        colour[touched] += opacity * share[touched, None] * (to_linear(dot) - colour[touched])
    return len(on_model), len(off_model)
