"""Closed triangle meshes from a few generators, in plain numpy so that every rebuild gives the same bytes."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Mesh:
    """A union of closed solids: `vertices` (v, 3) in m, `faces` (f, 3) counter-clockwise from outside."""

    vertices: Array
    faces: NDArray[np.int64]

    def __add__(self, other: Mesh) -> Mesh:
        return Mesh(
            np.vstack([self.vertices, other.vertices]),
            np.vstack([self.faces, other.faces + len(self.vertices)]),
        )

    def at(self, x: float, y: float, z: float) -> Mesh:
        return Mesh(self.vertices + np.array([x, y, z]), self.faces)

    def turned(self, axis: str, angle: float) -> Mesh:
        """Rotate about the coordinate axis "x", "y" or "z" through the origin by `angle` (rad)."""
        return Mesh(self.vertices @ rotation(axis, angle).T, self.faces)

    def scaled(self, factor: float) -> Mesh:
        return Mesh(self.vertices * factor, self.faces)

    def mirrored(self, axis: str) -> Mesh:
        """Mirror by negating the coordinate "x", "y" or "z"; the faces keep pointing outwards."""
        signs = np.ones(3)
        signs["xyz".index(axis)] = -1.0
        return Mesh(self.vertices * signs, self.faces[:, ::-1])


def rotation(axis: str, angle: float) -> Array:
    """Return the (3, 3) rotation by `angle` (rad) about a coordinate axis."""
    first, second = {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
    R = np.eye(3)
    R[first, first] = R[second, second] = np.cos(angle)
    R[first, second], R[second, first] = -np.sin(angle), np.sin(angle)
    return R


def join(meshes: Sequence[Mesh]) -> Mesh:
    total = meshes[0]
    for mesh in meshes[1:]:
        total = total + mesh
    return total


def box(size: ArrayLike, centre: ArrayLike = (0.0, 0.0, 0.0), bevel: float = 0.0) -> Mesh:
    """Return a box of `size` (3,) about `centre`, its edges bevelled by `bevel`."""
    x, y, z = np.asarray(size, dtype=float)
    outline = [(-x / 2, -y / 2), (x / 2, -y / 2), (x / 2, y / 2), (-x / 2, y / 2)]
    return prism(outline, z, bevel).at(*np.asarray(centre, dtype=float))


def span(low: ArrayLike, high: ArrayLike, bevel: float = 0.0) -> Mesh:
    """Return the box between two opposite corners."""
    low, high = np.asarray(low, dtype=float), np.asarray(high, dtype=float)
    return box(high - low, (low + high) / 2.0, bevel)


def prism(outline: ArrayLike, height: float, bevel: float = 0.0, along: str = "z") -> Mesh:
    """Extrude a counter-clockwise simple polygon (n, 2) by `height` about the middle plane.

    along: "z" takes the outline as (x, y); "y" as (x, z); "x" as (y, z).
    bevel: cut off every convex edge by this length; bevelled outlines must be wider than twice the bevel.
    """
    polygon = np.asarray(outline, dtype=float)
    half = height / 2.0
    if bevel > 0.0:
        polygon = _chamfered(polygon, bevel)
        small = _inset(polygon, bevel)
        rings = [(small, -half), (polygon, -half + bevel), (polygon, half - bevel), (small, half)]
    else:
        rings = [(polygon, -half), (polygon, half)]
    n = len(polygon)
    vertices = np.vstack([np.column_stack([ring, np.full(n, z)]) for ring, z in rings])
    cap = _triangulated(rings[0][0])
    faces = [cap[:, ::-1], cap + (len(rings) - 1) * n]
    faces += [_band(level * n, (level + 1) * n, n) for level in range(len(rings) - 1)]
    mesh = Mesh(vertices, np.vstack(faces))
    if along == "x":
        return Mesh(mesh.vertices[:, [2, 0, 1]], mesh.faces)
    if along == "y":
        return Mesh(mesh.vertices[:, [0, 2, 1]], mesh.faces[:, ::-1])
    return mesh


def lathe(profile: ArrayLike, segments: int = 24, closed: bool = False) -> Mesh:
    """Turn a profile of (radius, z) about the z axis.

    An open profile runs from the axis (radius 0) at the bottom, round the outside, to the axis at the top.
    A closed one is a counter-clockwise loop off the axis and makes a ring.
    """
    points = np.asarray(profile, dtype=float)
    angles = 2.0 * np.pi * np.arange(segments) / segments
    circle = np.column_stack([np.cos(angles), np.sin(angles)])
    rings = points if closed else points[1:-1]
    vertices = [np.column_stack([radius * circle, np.full(segments, z)]) for radius, z in rings]
    faces = [_band(k * segments, (k + 1) * segments, segments) for k in range(len(rings) - 1)]
    if closed:
        faces.append(_band((len(rings) - 1) * segments, 0, segments))
    else:
        bottom = len(rings) * segments
        top, last = bottom + 1, (len(rings) - 1) * segments
        vertices.append(np.array([[0.0, 0.0, points[0, 1]], [0.0, 0.0, points[-1, 1]]]))
        around = np.arange(segments)
        following = (around + 1) % segments
        faces.append(np.column_stack([np.full(segments, bottom), following, around]))
        faces.append(np.column_stack([np.full(segments, top), last + around, last + following]))
    return Mesh(np.vstack(vertices), np.vstack(faces))


def cylinder(radius: float, length: float, segments: int = 20, top_radius: float | None = None) -> Mesh:
    """Return a cylinder, or a truncated cone, along z about the origin."""
    top = radius if top_radius is None else top_radius
    half = length / 2.0
    return lathe([(0, -half), (radius, -half), (top, half), (0, half)], segments)


def sphere(radius: float, segments: int = 20) -> Mesh:
    rings = segments // 2
    angles = np.pi * np.arange(rings + 1) / rings
    profile = np.column_stack([np.sin(angles), -np.cos(angles)]) * radius
    profile[[0, -1], 0] = 0.0
    return lathe(profile, segments)


def rod(start: ArrayLike, end: ArrayLike, radius: float, segments: int = 10) -> Mesh:
    """Return a round rod between two points."""
    return tube(np.array([start, end], dtype=float), radius, segments)


def tube(path: ArrayLike, radius: float, segments: int = 10) -> Mesh:
    """Return a round tube swept along a polyline (n, 3), mitred at its corners, closed by flat ends."""
    points = np.asarray(path, dtype=float)
    directions = np.diff(points, axis=0)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    side = np.cross(directions[0], np.eye(3)[int(np.argmin(np.abs(directions[0])))])
    side /= np.linalg.norm(side)
    angles = 2.0 * np.pi * np.arange(segments) / segments
    up = np.cross(directions[0], side)
    ring = points[0] + radius * (np.outer(np.cos(angles), side) + np.outer(np.sin(angles), up))
    rings = [ring]
    for k in range(1, len(points)):
        before = directions[k - 1]
        after = directions[k] if k < len(directions) else before
        normal = before + after
        # Slide the ring along the segment onto the plane that halves the corner: the mitre.
        ring = ring + np.outer((points[k] - ring) @ normal / (before @ normal), before)
        rings.append(ring)
    n = len(rings)
    around = np.arange(segments)
    following = (around + 1) % segments
    faces = [_band(k * segments, (k + 1) * segments, segments) for k in range(n - 1)]
    start, end = n * segments, n * segments + 1
    faces.append(np.column_stack([np.full(segments, start), following, around]))
    faces.append(np.column_stack([np.full(segments, end), (n - 1) * segments + around, (n - 1) * segments + following]))
    return Mesh(np.vstack([*rings, points[:1], points[-1:]]), np.vstack(faces))


def frame(low: ArrayLike, high: ArrayLike, depth: tuple[float, float], border: tuple[float, ...]) -> Mesh:
    """Return a rectangular ring in the (y, z) plane between the corners, extruded over `depth` in x.

    border: width of the left (-y), right (+y), bottom and top bars.
    """
    (y0, z0), (y1, z1) = np.asarray(low, dtype=float), np.asarray(high, dtype=float)
    left, right, bottom, top = border
    outer = np.array([(y0, z0), (y1, z0), (y1, z1), (y0, z1)])
    inner = np.array(
        [(y0 + left, z0 + bottom), (y1 - right, z0 + bottom), (y1 - right, z1 - top), (y0 + left, z1 - top)]
    )
    rings = [(outer, depth[0]), (outer, depth[1]), (inner, depth[1]), (inner, depth[0])]
    vertices = np.vstack([np.column_stack([np.full(4, x), ring]) for ring, x in rings])
    return Mesh(vertices, np.vstack([_band(4 * k, 4 * ((k + 1) % 4), 4) for k in range(4)]))


def write_stl(mesh: Mesh, path: Path) -> None:
    """Write binary STL, rounded to 1e-7 m, so that the last bits of a cosine do not matter."""
    corners = (np.round(mesh.vertices, 7) + 0.0)[mesh.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    record = np.zeros(len(corners), dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    record["normal"] = np.round(normals, 5) + 0.0
    record["corners"] = corners
    path.write_bytes(b"pwralign_kin sample model".ljust(80) + struct.pack("<I", len(record)) + record.tobytes())


def _band(lower: int, upper: int, n: int) -> NDArray[np.int64]:
    """Faces between two rings of n vertices that start at the indices `lower` and `upper`."""
    around = np.arange(n)
    following = (around + 1) % n
    return np.vstack(
        [
            np.column_stack([lower + around, lower + following, upper + following]),
            np.column_stack([lower + around, upper + following, upper + around]),
        ]
    )


def _turn(before: Array, corner: Array, after: Array) -> float:
    """Twice the signed area of a corner: positive where a counter-clockwise polygon is convex."""
    first, second = corner - before, after - corner
    return float(first[0] * second[1] - first[1] * second[0])


def _chamfered(polygon: Array, length: float) -> Array:
    """Cut off a polygon's convex corners by `length` along both edges; leave the blunt ones."""
    points: list[Array] = []
    for k, corner in enumerate(polygon):
        before, after = polygon[k - 1], polygon[(k + 1) % len(polygon)]
        lengths = np.linalg.norm(corner - before) * np.linalg.norm(after - corner)
        if _turn(before, corner, after) <= 0.35 * lengths:
            points.append(corner)
            continue
        points += [corner + length * (end - corner) / np.linalg.norm(end - corner) for end in (before, after)]
    return np.array(points)


def _inset(polygon: Array, distance: float) -> Array:
    """Move every edge of a counter-clockwise polygon inwards by `distance`."""
    edges = np.roll(polygon, -1, axis=0) - polygon
    normals = np.column_stack([-edges[:, 1], edges[:, 0]]) / np.linalg.norm(edges, axis=1, keepdims=True)
    previous = np.roll(normals, 1, axis=0)
    bisector = normals + previous
    moved = polygon + distance * bisector / (1.0 + (normals * previous).sum(axis=1, keepdims=True))
    if (((np.roll(moved, -1, axis=0) - moved) * edges).sum(axis=1) <= 0.0).any():
        raise ValueError(f"an edge of the outline is too short for a bevel of {distance:g}")
    return np.asarray(moved)


def _triangulated(polygon: Array) -> NDArray[np.int64]:
    """Triangulate a counter-clockwise simple polygon by clipping ears."""
    remaining = list(range(len(polygon)))
    triangles: list[tuple[int, int, int]] = []
    while len(remaining) > 3:
        for k, corner in enumerate(remaining):
            before, after = remaining[k - 1], remaining[(k + 1) % len(remaining)]
            ear = polygon[[before, corner, after]]
            if _turn(*ear) > 1e-12 and not any(
                _inside(ear, polygon[other]) for other in remaining if other not in (before, corner, after)
            ):
                triangles.append((before, corner, after))
                remaining.pop(k)
                break
        else:
            raise ValueError("the outline is not a simple counter-clockwise polygon")
    return np.array([*triangles, tuple(remaining)], dtype=np.int64)


def _inside(triangle: Array, point: Array) -> bool:
    return all(_turn(triangle[k], triangle[(k + 1) % 3], point) >= 0.0 for k in range(3))
