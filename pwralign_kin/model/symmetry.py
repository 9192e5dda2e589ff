"""Which parts look alike, and which turns map a part onto itself: what makes answers equal.

Surfaces are compared as they are seen: two parts look alike when a rigid motion lays the visible surface of each on
that of the other. Mirror images do not.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from itertools import permutations, product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pwralign_kin.model.surface import Surface
from pwralign_kin.se3 import Array, inverse, rotation_about

VERSION = 3
"""Part of the cache key: raise it when the comparison changes."""
SAME = 0.003
"""Mean distance (model diagonals) of two surfaces that look the same, ..."""
SAME_SHARE = 0.03
"""... and at most this share of the part's size."""
WORTH_ALIGNING = 8.0
"""Motions that leave a mean distance of this many times `SAME` are aligned and looked at again."""
NEARLY = 0.01
"""Mean distance (model diagonals) up to which a turn nearly maps a surface onto itself."""
WORTH_MEASURING = 3.0
"""Turns that take a few points this many times as far off are not measured."""
ALIKE_SIZE, ALIKE_AREA = 0.03, 0.1
"""Relative differences of size and visible area up to which parts are compared at all."""
ALIGNMENTS = 6
"""Steps at most in which a motion is aligned."""
PROBES, FEW_PROBES = 150, 30
"""Samples of a part that a motion is measured with, and with which it is seen whether that is worth it."""


@dataclass(frozen=True)
class Symmetry:
    """The parts of a model sorted by their looks; lengths in model diagonals."""

    kind: NDArray[np.int64]
    """(n,) the part that each part looks like (the first of them), -1 without surface."""
    to_kind: Array
    """(n, 4, 4) motions from each part's frame to that part's, which lay one surface on the other."""
    turns: tuple[Array, ...]
    """Per part (m, 4, 4) the motions that map its surface onto itself, the identity first; empty for other kinds."""
    nearly: tuple[Array, ...]
    """Per part (m, 4, 4) the other turns about its middle that nearly do, ..."""
    nearly_off: tuple[Array, ...]
    """... and (m,) the mean distances that they leave."""
    _replacements: dict[tuple[int, int], Array] = field(default_factory=dict, init=False, compare=False, repr=False)

    def replacements(self, part: int, place: int) -> Array:
        """Return the motions (m, 4, 4) after which `part`, in the frame of `place`, looks as `place` does."""
        if (part, place) not in self._replacements:
            turns = self.turns[self.kind[part]]
            motions = np.asarray(inverse(self.to_kind[place]) @ turns @ self.to_kind[part])
            motions.flags.writeable = False
            self._replacements[part, place] = motions
        return self._replacements[part, place]


def find_symmetry(surfaces: Sequence[Surface]) -> Symmetry:
    """Compare all parts, each with the first that looks like it."""
    count = len(surfaces)
    kind = np.full(count, -1)
    to_kind = np.tile(np.eye(4), (count, 1, 1))
    turns = [np.zeros((0, 4, 4)) for _ in surfaces]
    nearly, nearly_off = [np.zeros((0, 4, 4)) for _ in surfaces], [np.zeros(0) for _ in surfaces]
    looks = {i: _Look(surface) for i, surface in enumerate(surfaces) if surface.exists}
    for i, own in looks.items():
        kind[i] = i
        for other in dict.fromkeys(kind[:i][kind[:i] >= 0].tolist()):
            found = next(_motions(own, looks[other]), None) if own.may_be(looks[other]) else None
            if found is not None:
                kind[i], to_kind[i] = other, found
                break
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        kinds = [i for i in looks if kind[i] == i]
        for i, own_turns in zip(kinds, pool.map(_turns, (looks[i] for i in kinds)), strict=True):
            turns[i] = own_turns
        exact = [inverse(to_kind[i]) @ turns[kind[i]] @ to_kind[i] for i in looks]
        for i, near in zip(looks, pool.map(_near_turns, looks.values(), exact), strict=True):
            nearly[i], nearly_off[i] = near
    return Symmetry(kind, to_kind, tuple(turns), tuple(nearly), tuple(nearly_off))


class _Look:
    """A surface ready to be compared."""

    def __init__(self, surface: Surface) -> None:
        from scipy.spatial import cKDTree

        self.surface = surface
        self.probes = surface.samples[:PROBES].astype(float)
        self.normals = surface.normals[:PROBES].astype(float)
        self.dense = surface.dense.astype(float)
        self.tree = cKDTree(self.dense)
        self.spacing = surface.spacing
        self.tolerance = min(SAME, SAME_SHARE * surface.size)
        low, high = self.dense.min(axis=0), self.dense.max(axis=0)
        axes = np.linalg.svd(self.probes - self.probes.mean(axis=0), full_matrices=False)[2].T
        axes[:, 2] *= np.sign(np.linalg.det(axes))
        along = self.dense @ axes
        middle = axes @ ((along.min(axis=0) + along.max(axis=0)) / 2)
        # Turns are about the middle of the box along the part's own axes, or along its frame's.
        self.frames = (_frame(np.eye(3), (low + high) / 2), _frame(axes, middle))

    def may_be(self, other: _Look) -> bool:
        sizes, areas = (np.array([getattr(look.surface, name) for look in (self, other)]) for name in ("size", "area"))
        return bool(np.ptp(sizes) < ALIKE_SIZE * sizes.max() and np.ptp(areas) < ALIKE_AREA * areas.max())

    def offsets(self, other: _Look, T: Array, count: int = PROBES) -> tuple[Array, Array, Array]:
        """Return of motions `T` (..., 4, 4) how far points of `other` are off this surface.

        The points (..., m, 3) after the motion, the surface's normals there, and the signed distances (..., m).
        """
        points = _moved(T, other.probes[:count])
        distance, near = self.tree.query(points)
        normals = self.surface.dense_normals[near].astype(float)
        height = np.einsum("...md,...md->...m", points - self.dense[near], normals)
        facing = np.einsum("...md,...md->...m", normals, other.normals[:count] @ np.swapaxes(T[..., :3, :3], -1, -2))
        off = np.maximum(np.abs(height), distance - self.spacing)
        return points, normals, np.where(facing > 0, off, np.maximum(off, 2 * self.tolerance)) * np.sign(height)

    def off(self, other: _Look, T: Array, count: int = PROBES) -> Array:
        """Return the mean distances (...) from this surface that motions `T` (..., 4, 4) leave `other` at."""
        return np.asarray(np.abs(self.offsets(other, T, count)[2]).mean(axis=-1))

    def apart(self, one: Array, several: Array) -> Array:
        """Return how far apart (mean over the surface) motion `one` (4, 4) takes it from `several` (m, 4, 4)."""
        moved = _moved(several, self.probes) - _moved(one, self.probes)
        return np.asarray(np.linalg.norm(moved, axis=-1).mean(axis=-1))


def _moved(T: Array, points: Array) -> Array:
    """Return `points` (m, 3) after motions (..., 4, 4), as (..., m, 3)."""
    return np.asarray(points @ np.swapaxes(T[..., :3, :3], -1, -2) + T[..., None, :3, 3])


def _frame(axes: Array, origin: Array) -> Array:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = axes, origin
    return T


def _turns(look: _Look) -> Array:
    """Return the distinct motions (m, 4, 4) that map a surface onto itself, the identity first."""
    found = [np.eye(4)]
    for T in _motions(look, look):
        if look.apart(T, np.array(found)).min() > 4 * look.tolerance:
            found.append(T)
    return np.array(found)


def _near_turns(look: _Look, exact: Array) -> tuple[Array, Array]:
    """Return the turns (m, 4, 4) that nearly map a surface onto itself, unlike `exact` ones, and how far off (m,)."""
    tried = _starts(look, look)
    tried = tried[look.off(look, tried, FEW_PROBES) < WORTH_MEASURING * NEARLY]
    tried = tried[[look.apart(T, exact).min() > 2 * NEARLY for T in tried]]
    off = np.maximum(look.off(look, tried), look.off(look, inverse(tried)))
    chosen: list[int] = []
    for i in np.flatnonzero(off < NEARLY).tolist():
        if not chosen or look.apart(tried[i], tried[chosen]).min() > 2 * NEARLY:
            chosen.append(i)
    return tried[chosen], off[chosen]


def _motions(source: _Look, target: _Look) -> Iterator[Array]:
    """Yield motions that lay one surface on the other: turns of a cube about either frame, then aligned."""
    starts = _starts(source, target)
    for T in starts[target.off(source, starts, FEW_PROBES) <= WORTH_ALIGNING * target.tolerance]:
        aligned = _aligned(source, target, T)
        if aligned is not None:
            yield aligned


def _starts(source: _Look, target: _Look) -> Array:
    """Return the motions (48, 4, 4) that turn `source` as a cube is turned, about its frames onto the target's."""
    frames = zip(source.frames, target.frames, strict=True)
    return np.concatenate([other @ CUBE_TURNS @ inverse(one) for one, other in frames])


def _cube_turns() -> Array:
    """Return the 24 rotations (24, 4, 4) of a cube, the identity first."""
    turns = []
    for order in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            R = np.zeros((3, 3))
            R[range(3), order] = signs
            if np.linalg.det(R) > 0:
                turns.append(_frame(R, np.zeros(3)))
    return np.array(turns)


CUBE_TURNS = _cube_turns()


def _aligned(source: _Look, target: _Look, T: Array) -> Array | None:
    """Return the motion near `T` that lays `source` on `target` (point to plane), None if there is none."""
    for iteration in range(ALIGNMENTS):
        points, normals, off = target.offsets(source, T)
        mean = float(np.abs(off).mean())
        if mean > WORTH_ALIGNING * target.tolerance:
            return None
        if iteration == ALIGNMENTS - 1 or mean < 0.2 * target.tolerance:
            break
        centre = points.mean(axis=0)
        J = np.concatenate([np.cross(points - centre, normals), normals], axis=1)
        weight = 1.0 / (1.0 + (off / target.tolerance) ** 2)
        step = np.linalg.solve((J * weight[:, None]).T @ J + 1e-6 * np.eye(6), -J.T @ (weight * off))
        angle = float(np.linalg.norm(step[:3]))
        move = _frame(rotation_about(step[:3] / angle, angle) if angle > 1e-12 else np.eye(3), np.zeros(3))
        move[:3, 3] = centre + step[3:] - move[:3, :3] @ centre
        T = move @ T
    return T if max(mean, float(source.off(target, inverse(T)))) < target.tolerance else None


def as_arrays(symmetry: Symmetry) -> dict[str, NDArray[Any]]:
    """Return what the cache keeps."""
    counts = np.array([len(turns) for turns in symmetry.turns])
    return {
        "kind": symmetry.kind,
        "to_kind": symmetry.to_kind,
        "counts": counts,
        "turns": np.concatenate([np.zeros((0, 4, 4)), *symmetry.turns]),
        "nearly_counts": np.array([len(turns) for turns in symmetry.nearly]),
        "nearly": np.concatenate([np.zeros((0, 4, 4)), *symmetry.nearly]),
        "nearly_off": np.concatenate([np.zeros(0), *symmetry.nearly_off]),
    }


def from_arrays(arrays: dict[str, NDArray[Any]]) -> Symmetry:
    """Return what the cache kept."""
    ends, near = (np.cumsum(arrays[counts].astype(int))[:-1] for counts in ("counts", "nearly_counts"))
    return Symmetry(
        arrays["kind"],
        arrays["to_kind"],
        tuple(np.split(arrays["turns"], ends)),
        tuple(np.split(arrays["nearly"], near)),
        tuple(np.split(arrays["nearly_off"], near)),
    )
