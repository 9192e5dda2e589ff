"""How far points lie from the visible surface of a posed model, in front of it or behind."""

from __future__ import annotations

import numpy as np

from pwralign_kin import kernels
from pwralign_kin.arrays import Bools, Indices
from pwralign_kin.directions import fibonacci_directions
from pwralign_kin.render import PosedMesh, RayScene
from pwralign_kin.se3 import Array

_FEW_RAYS, _MANY_RAYS = 16, 64  # rays from a place, and where they do not tell its sides apart
_CLEAR = 0.25  # a place is told by few rays where this share leaves on one side and none on the other
_STEP = 1e-4  # of the diagonal: how far off the surface its two sides are looked at
_SEEN = 0.05  # a place is seen from outside where more of its half sphere is free
_EVEN = 0.1  # difference in openness up to which neither side counts as the outer one
_SPACING = 0.01  # of the diagonal: large faces are looked at in as many places
_MOST_PLACES = 2000  # per face, of which the others are looked at ...
_SOME = 20  # ... where none of so many is seen
_REACH = 0.01  # of the diagonal: how far around a hidden place other hidden faces are looked for
_ROUNDS = 6  # in which hidden faces are left out and the closest of the others is looked for
_CHUNK = 20_000  # places whose rays are cast together, for the memory they take
_FAR, _COARSE = 0.2, 0.02  # of the diagonal: what is further away is measured together with what is this near to it


def signed_distances(mesh: PosedMesh, points: Array) -> Array:
    """Return the distance (n,) of points (n, 3) to the posed model's visible surface, m, positive outside.

    Neither closed meshes nor consistent normals are needed: rays tell what is outside. On the line through a
    point and its closest place on the surface, rays go out from just before and just behind that place, and
    the side where more of them leave the model is the outer one. Where hardly any do on either side (walls
    and fittings within a hollow link) the place cannot have been scanned, and the closest place on faces that
    can be seen counts instead. A sheet without thickness, as open on one side as on the other, takes the sign
    from its face normals.

    Points further away than a fifth of the model's diagonal share closest places with their neighbours: their
    distances may be too large by 3% of the diagonal.
    """
    local = np.asarray(points, dtype=np.float64) - mesh.centre
    if not len(local):
        return np.empty(0)
    queries, query = _thinned_far_away(mesh, local)
    closest, sign = _closest_seen(mesh, queries)
    offsets = local - closest[query]
    return np.asarray(sign[query] * np.sqrt(np.einsum("ni,ni->n", offsets, offsets)))


def _thinned_far_away(mesh: PosedMesh, local: Array) -> tuple[Array, Indices]:
    """Return the places (q, 3) to look from, and which of them (n,) stands for each of `local` (n, 3)."""
    means, _, cell = kernels.voxel_means(local.astype(np.float32), _COARSE * mesh.diagonal)
    closest, _, _ = mesh.scene.closest(means)
    far = np.linalg.norm(means - closest, axis=1) > _FAR * mesh.diagonal
    near = np.flatnonzero(~far[cell])
    query = (np.cumsum(far) - 1)[cell]
    query[near] = np.count_nonzero(far) + np.arange(len(near))
    return np.concatenate([means[far], local[near]]), query


def _closest_seen(mesh: PosedMesh, local: Array) -> tuple[Array, Array]:
    """Return the closest places (n, 3) that can be seen, and on which side of the surface (n,) `local` (n, 3) are."""
    closest, normals, faces = mesh.scene.closest(local)
    towards = _towards(local, closest, normals)
    front, back = _sides_by_place(mesh, closest, towards, faces)
    around = _Surroundings(mesh)
    for _ in range(_ROUNDS):
        unseen = np.flatnonzero(np.maximum(front, back) < _SEEN)
        around.look(closest[unseen], faces[unseen])
        again = unseen[around.hidden[faces[unseen]]]
        kept = np.flatnonzero(~around.hidden)
        if not len(again) or not len(kept):
            break
        rest = RayScene(mesh.vertices - mesh.centre, mesh.faces[kept])
        closest[again], normals[again], index = rest.closest(local[again])
        faces[again] = kept[index]
        towards[again] = _towards(local[again], closest[again], normals[again])
        front[again], back[again] = _sides_by_place(mesh, closest[again], towards[again], faces[again])

    # A place on an edge is closest only to points outside; elsewhere the offset lies along the normal.
    along = np.einsum("ni,ni->n", towards, normals)
    by_normal = np.where(along < -0.999, -1.0, 1.0)
    return closest, np.where(np.abs(front - back) <= _EVEN, by_normal, np.where(front > back, 1.0, -1.0))


class _Surroundings:
    """Which faces can be seen from outside, found out where it matters only."""

    hidden: Bools
    """(f,) faces known to be hidden."""

    def __init__(self, mesh: PosedMesh) -> None:
        """Spread places over the faces: the centroid, and on large faces more as their area asks for."""
        corners = mesh.vertices[mesh.faces] - mesh.centre
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        double_area = np.linalg.norm(normals, axis=1)
        normals /= np.where(double_area > 0.0, double_area, 1.0)[:, None]
        counts = np.clip(np.ceil(double_area / (_SPACING * mesh.diagonal) ** 2), 1, _MOST_PLACES).astype(int)
        owner = np.repeat(np.arange(len(counts)), counts)
        number = np.arange(len(owner)) - np.repeat(np.cumsum(counts) - counts, counts)
        # The sequence of the plastic number, begun at the centroid and folded into the triangle.
        weights = (1.0 / 3.0 + number[:, None] * [0.7548776662466927, 0.5698402909980532]) % 1.0
        weights = np.where(weights.sum(axis=1, keepdims=True) > 1.0, 1.0 - weights, weights)
        edges = corners[owner, 1:] - corners[owner, :1]
        self._mesh = mesh
        self._places = corners[owner, 0] + np.einsum("ne,nei->ni", weights, edges)
        self._normals = normals
        self._owner = owner
        self._rank = number
        self._looked_at = np.zeros(len(mesh.faces), dtype=bool)
        self.hidden = np.zeros(len(mesh.faces), dtype=bool)

    def look(self, hidden: Array, faces: Indices) -> None:
        """Find out about the faces (n,) that hidden places (n, 3) lie on, and about all others near them."""
        from scipy.spatial import cKDTree

        if not len(hidden):
            return
        near, _ = cKDTree(hidden).query(self._places, distance_upper_bound=_REACH * self._mesh.diagonal)
        asked = np.zeros(len(self.hidden), dtype=bool)
        asked[self._owner[np.isfinite(near)]] = True
        asked[faces] = True
        asked &= ~self._looked_at
        self.hidden |= asked
        self._looked_at |= asked
        for first, last in ((0, 1), (1, _SOME), (_SOME, _MOST_PLACES)):  # most faces are told by one place
            within = (self._rank >= first) & (self._rank < last)
            rows = np.flatnonzero(within & (asked & self.hidden)[self._owner])
            if first >= _SOME:
                rows = self._with_a_free_ray(rows)
            owner = self._owner[rows]
            seen = np.maximum(*_open_sides(self._mesh, self._places[rows], self._normals[owner])) >= _SEEN
            self.hidden[owner[seen]] = False

    def _with_a_free_ray(self, rows: Indices) -> Indices:
        """Return those of many places from which any ray leaves, each tried with a quarter of the directions.

        A face that can be seen is seen from several neighbouring places, which have different quarters.
        """
        free = np.zeros(len(rows), dtype=bool)
        quarter = self._rank[rows] % 4
        for which in range(4):
            own = rows[quarter == which]
            directions = fibonacci_directions(_MANY_RAYS)[which::4]
            shares = _free_shares(self._mesh, self._places[own], self._normals[self._owner[own]], directions)
            free[quarter == which] = np.maximum(*shares) > 0.0
        return rows[free]


def _towards(local: Array, closest: Array, normals: Array) -> Array:
    """Return unit directions (n, 3) from closest places to points, normals where they coincide."""
    offsets = local - closest
    length = np.sqrt(np.einsum("ni,ni->n", offsets, offsets))
    offsets /= np.maximum(length, 1e-7)[:, None]
    same = length <= 1e-7
    offsets[same] = normals[same]
    return np.asarray(offsets)


def _sides_by_place(mesh: PosedMesh, places: Array, towards: Array, faces: Indices) -> tuple[Array, Array]:
    """Return what `_open_sides` does for places (n, 3) on `faces` (n,), looking from one of those that hardly differ.

    These lie on the same face, near each other, and look the same way.
    """
    key = faces
    for column in (*np.floor(places / (_SPACING * mesh.diagonal)).T, *np.rint(1.5 * towards).T):
        low = column.min(initial=0.0)
        key = key * int(column.max(initial=0.0) - low + 1.0) + (column - low).astype(np.int64)
    _, first, group = np.unique(key, return_index=True, return_inverse=True)
    front, back = _open_sides(mesh, places[first], towards[first])
    return front[group], back[group]


def _open_sides(mesh: PosedMesh, places: Array, towards: Array) -> tuple[Array, Array]:
    """Return which share of rays leaves the model freely from places (n, 3) on its surface.

    The first (n,) is of the half sphere around `towards` (n, 3), the second of the other; places are given
    relative to the centre of the mesh.
    """
    front, back = _free_shares(mesh, places, towards, fibonacci_directions(_FEW_RAYS))
    unclear = np.flatnonzero((np.maximum(front, back) < _CLEAR) | (np.minimum(front, back) > 0.0))
    front[unclear], back[unclear] = _free_shares(
        mesh, places[unclear], towards[unclear], fibonacci_directions(_MANY_RAYS)
    )
    return front, back


def _free_shares(mesh: PosedMesh, places: Array, towards: Array, directions: Array) -> tuple[Array, Array]:
    """Return what `_open_sides` does, told by rays in `directions` (d, 3)."""
    front, back = np.empty(len(places)), np.empty(len(places))
    for start in range(0, len(places), _CHUNK):
        rows = slice(start, start + _CHUNK)
        ahead = towards[rows] @ directions.T > 0.0
        step = _STEP * mesh.diagonal * towards[rows]
        before, behind = (places[rows] + step).astype(np.float32), (places[rows] - step).astype(np.float32)
        rays = np.empty((*ahead.shape, 6), dtype=np.float32)
        rays[..., :3] = np.where(ahead[..., None], before[:, None], behind[:, None])
        rays[..., 3:] = directions
        free = ~mesh.scene.blocked(rays)
        front[rows] = (free & ahead).sum(axis=1) / np.maximum(ahead.sum(axis=1), 1)
        back[rows] = (free & ~ahead).sum(axis=1) / np.maximum((~ahead).sum(axis=1), 1)
    return front, back
