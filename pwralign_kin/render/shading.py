"""Light, stripes and lines on a model."""

from __future__ import annotations

import numpy as np

from pwralign_kin.arrays import Bools, Singles
from pwralign_kin.render.camera import View
from pwralign_kin.render.colours import to_linear
from pwralign_kin.render.mesh import PosedMesh
from pwralign_kin.render.samples import SAMPLES_PER_PIXEL, Samples

_BEND, _STEP = 0.7, 0.03  # cosine between normals and step in depth (of the diagonal) that make a line

_OCCLUSION_RAYS, _COARSE = 12, 3  # from every third pixel in each direction; the others are interpolated

_STRIPES, _STRIPED = 9.0, 0.62  # pixels from stripe to stripe, and how white they are


def shaded(mesh: PosedMesh, met: Samples, openness: Singles, view: View, striped: Bools) -> Singles:
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


def ambient_openness(mesh: PosedMesh, pixels: Samples, view: View) -> Singles:
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


def busy_pixels(pixels: Samples, diagonal: float) -> Bools:
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


def lines(pixels: Samples, busy: Bools, finer: Samples, diagonal: float) -> Singles:
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
    both = Samples(
        *(
            np.concatenate([values.reshape(-1, *tail), more.reshape(-1, *tail)])
            for values, more, tail in (
                (getattr(pixels, name), getattr(finer, name), getattr(pixels, name).shape[2:])
                for name in Samples.__dataclass_fields__
            )
        )
    )
    darkness = np.zeros(finer.face.shape, dtype=np.float32)
    for down, right in ((-1, 0), (1, 0), (0, -1), (0, 1)):
        beside = index[np.clip(row + down, 0, len(index) - 1), np.clip(column + right, 0, index.shape[1] - 1)]
        differ = np.nonzero(both.face[beside] != finer.face)
        darkness[differ] = np.maximum(darkness[differ], _line(finer.at(differ), both.at(beside[differ]), diagonal))
    return darkness


def _line(one: Samples, two: Samples, diagonal: float) -> Singles:
    """Return how dark (...) a line between neighbours is: 1 between parts and at depth steps, less on creases."""
    bend = np.einsum("...i,...i->...", one.normal, two.normal)
    apart = np.minimum(one.depth, 1e3 * diagonal) - np.minimum(two.depth, 1e3 * diagonal)
    outline = (one.part != two.part) | (np.abs(apart) > _STEP * diagonal)
    crease = (one.face >= 0) & (two.face >= 0) & (bend < _BEND)
    return np.where(outline, 1.0, np.where(crease, 0.35, 0.0)).astype(np.float32)
