"""Which parts look alike, and which turns map a part onto itself: what makes answers equal.

Surfaces are compared as they are seen: two parts look alike when a rigid motion lays the visible surface of each on
that of the other. Mirror images do not.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import permutations, product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pwralign_kin.model.surface import Surface
from pwralign_kin.se3 import Array, inverse, rotation_about, transform

VERSION = 3  # part of the cache key: raise it when the comparison changes
SAME = 0.003
"""Mean distance (model diagonals) of two surfaces that look the same, ..."""
SAME_SHARE = 0.03
"""... and at most this share of the part's size."""
WORTH_ALIGNING = 8.0
"""Motions that leave a mean distance of this many times `SAME` are aligned and looked at again."""
NEARLY = 0.01
"""Mean distance (model diagonals) up to which a turn nearly maps a surface onto itself."""
ALIKE_SIZE, ALIKE_AREA = 0.03, 0.1
"""Relative differences of size and visible area up to which parts are compared at all."""
ALIGNMENTS = 6
PROBES, FEW_PROBES = 150, 30


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

    def replacements(self, part: int, place: int) -> Array:
        """Return the motions (m, 4, 4) after which `part`, in the frame of `place`, looks as `place` does."""
        turns = self.turns[self.kind[part]]
        return np.asarray(inverse(self.to_kind[place]) @ turns @ self.to_kind[part])


def find_symmetry(surfaces: Sequence[Surface]) -> Symmetry:
    """Compare all parts, each with the first that looks like it."""
    count = len(surfaces)
    kind = np.full(count, -1)
    to_kind = np.tile(np.eye(4), (count, 1, 1))
    turns = [np.zeros((0, 4, 4)) for _ in surfaces]
    nearly, nearly_off = [np.zeros((0, 4, 4)) for _ in surfaces], [np.zeros(0) for _ in surfaces]
    looks: dict[int, _Look] = {}
    for i, surface in enumerate(surfaces):
        if not surface.exists:
            continue
        own = _Look(surface)
        for other, look in looks.items():
            found = list(_motions(own, look, first=True)) if own.may_be(look) else []
            if found:
                kind[i], to_kind[i] = other, found[0]
                break
        else:
            kind[i], looks[i] = i, own
            turns[i] = np.array([np.eye(4), *_turns(own)])
        exact = inverse(to_kind[i]) @ turns[kind[i]] @ to_kind[i]
        nearly[i], nearly_off[i] = _near_turns(own, exact)
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
        self.spacing = float(surface.scalars[1])
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
        """Return points (m, 3) of `other` after `T`, the normals there, and how far they are off this surface."""
        points = transform(T, other.probes[:count])
        distance, near = self.tree.query(points)
        normals = self.surface.dense_normals[near].astype(float)
        height = np.einsum("md,md->m", points - self.dense[near], normals)
        facing = np.einsum("md,md->m", normals, other.normals[:count] @ T[:3, :3].T)
        off = np.maximum(np.abs(height), distance - self.spacing)
        return points, normals, np.where(facing > 0, off, np.maximum(off, 2 * self.tolerance)) * np.sign(height)


def _frame(axes: Array, origin: Array) -> Array:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = axes, origin
    return T


def _turns(look: _Look) -> Iterator[Array]:
    """Yield the distinct motions that map a surface onto itself, but for the identity."""
    found = [np.eye(4)]
    for T in _motions(look, look, first=False):
        moved = [
            np.linalg.norm(transform(T, look.probes) - transform(other, look.probes), axis=1).mean() for other in found
        ]
        if min(moved) > 4 * look.tolerance:
            found.append(T)
            yield T


def _near_turns(look: _Look, exact: Array) -> tuple[Array, Array]:
    """Return the turns (m, 4, 4) that nearly map a surface onto itself, unlike `exact` ones, and how far off (m,)."""
    found, off = list(exact), []
    for frame, turn in product(look.frames, _cube_turns()):
        T = frame @ turn @ inverse(frame)
        apart = [
            np.linalg.norm(transform(T, look.probes) - transform(other, look.probes), axis=1).mean() for other in found
        ]
        if min(apart) > 2 * NEARLY:
            distance = max(float(np.abs(look.offsets(look, motion)[2]).mean()) for motion in (T, inverse(T)))
            if distance < NEARLY:
                found.append(T)
                off.append(distance)
    return np.array(found[len(exact) :]).reshape(-1, 4, 4), np.array(off)


def _motions(source: _Look, target: _Look, *, first: bool) -> Iterator[Array]:
    """Yield motions that lay one surface on the other: turns of a cube about either frame, then aligned."""
    for one, other in zip(source.frames, target.frames, strict=True):
        for turn in _cube_turns():
            T = _aligned(source, target, other @ turn @ inverse(one))
            if T is not None:
                yield T
                if first:
                    return


def _cube_turns() -> list[Array]:
    """Return the 24 rotations of a cube, the identity first."""
    turns = []
    for order in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            R = np.zeros((3, 3))
            R[range(3), order] = signs
            if np.linalg.det(R) > 0:
                turns.append(_frame(R, np.zeros(3)))
    return turns


def _aligned(source: _Look, target: _Look, T: Array) -> Array | None:
    """Return the motion near `T` that lays `source` on `target` (point to plane), None if there is none."""
    if float(np.abs(target.offsets(source, T, FEW_PROBES)[2]).mean()) > WORTH_ALIGNING * target.tolerance:
        return None
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
    back = source.offsets(target, inverse(T))[2]
    return T if max(mean, float(np.abs(back).mean())) < target.tolerance else None


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
