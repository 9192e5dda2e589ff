"""Depth images of triangle meshes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pwralign_kin.dependencies import open3d
from pwralign_kin.se3 import Array, axes_across

Body = tuple[Array, NDArray[np.int64]]
"""Vertices (v, 3), m, and faces (f, 3) of one rigid body in the world."""


@dataclass(frozen=True, eq=False)
class DepthImage:
    """What one camera sees."""

    origin: Array
    """(3,) centre of the camera."""

    directions: Array
    """(h, w, 3) unit direction of each pixel's ray."""

    distance: Array
    """(h, w) distance along the ray to what it hits, infinite where nothing."""

    body: NDArray[np.int64]
    """(h, w) index of the body hit, -1 where nothing."""

    @property
    def points(self) -> Array:
        """(h, w, 3) points hit; only where `distance` is finite."""
        with np.errstate(invalid="ignore"):
            return np.asarray(self.origin + self.distance[..., None] * self.directions)


class World:
    """Rigid bodies that cameras can look at; bodies without faces are not there."""

    def __init__(self, bodies: Sequence[Body]) -> None:
        """Take over `bodies`, at least one of them with faces. Raises `DependencyError` without Open3D."""
        library = open3d()
        self._scene = library.t.geometry.RaycastingScene()
        self._tensor = library.core.Tensor
        owners = []
        for index, (vertices, faces) in enumerate(bodies):
            if len(faces):
                self._scene.add_triangles(
                    self._tensor(vertices.astype(np.float32)), self._tensor(faces.astype(np.uint32))
                )
                owners.append(index)
        self._owners = np.array(owners)
        self.vertices = np.concatenate([bodies[index][0] for index in owners])
        lower, upper = self.vertices.min(axis=0), self.vertices.max(axis=0)
        self.centre = (lower + upper) / 2.0
        self.radius = float(np.linalg.norm(self.vertices - self.centre, axis=1).max())

    def depth_image(self, origin: Array, pixels: int) -> DepthImage:
        """Return the view from `origin` (3,), outside the bodies' sphere, towards their middle.

        The image is cut to what it shows and has about `pixels` square pixels.
        """
        axes = looking_at(self.centre - origin)
        seen = (self.vertices - origin) @ axes
        slopes = seen[:, :2] / seen[:, 2:]
        lower, upper = slopes.min(axis=0), slopes.max(axis=0)
        size = np.maximum(upper - lower, 1e-6)
        pitch = float(np.sqrt(size.prod() / pixels))
        columns, rows = (lower[i] + pitch * (np.arange(np.ceil(size[i] / pitch)) + 0.5) for i in (0, 1))
        grid = np.stack([*np.meshgrid(columns, rows), np.ones((len(rows), len(columns)))], axis=-1)
        return self._cast(origin, grid / np.linalg.norm(grid, axis=-1, keepdims=True) @ axes.T)

    def camera_image(self, origin: Array, axes: Array, focal: float, size: tuple[int, int]) -> DepthImage:
        """Return what a pinhole camera at `origin` (3,) sees.

        The columns of `axes` (3, 3) are its directions right, down and forward; `focal` is in pixels and `size` the
        columns and rows of its image.
        """
        return self._cast(origin, pinhole_directions(axes, focal, size))

    def travel(self, points: Array, direction: Array) -> float:
        """Return how far `points` (n, 3) can move along the unit `direction` (3,) until one meets a body."""
        rays = np.concatenate([points, np.broadcast_to(direction, points.shape)], axis=-1)
        return float(self._scene.cast_rays(self._tensor(rays.astype(np.float32)))["t_hit"].numpy().min())

    def _cast(self, origin: Array, directions: Array) -> DepthImage:
        rays = np.concatenate([np.broadcast_to(origin, directions.shape), directions], axis=-1)
        answer = self._scene.cast_rays(self._tensor(rays.astype(np.float32)))
        distance = answer["t_hit"].numpy().astype(np.float64)
        geometry = answer["geometry_ids"].numpy().astype(np.int64)
        hit = np.isfinite(distance)
        body = np.full(distance.shape, -1)
        body[hit] = self._owners[geometry[hit]]
        return DepthImage(origin=origin, directions=directions, distance=distance, body=body)


class MovingBodies:
    """Rigid bodies that move between looks: each is prepared once, in its own frame."""

    def __init__(self, bodies: Sequence[Body]) -> None:
        """Take over `bodies`, each in its own frame. Raises `DependencyError` without Open3D."""
        library = open3d()
        self._tensor = library.core.Tensor
        self._bodies = []
        for index, (vertices, faces) in enumerate(bodies):
            if len(faces):
                scene = library.t.geometry.RaycastingScene()
                scene.add_triangles(self._tensor(vertices.astype(np.float32)), self._tensor(faces.astype(np.uint32)))
                centre = (vertices.min(axis=0) + vertices.max(axis=0)) / 2.0
                self._bodies.append((index, scene, centre, float(np.linalg.norm(vertices - centre, axis=1).max())))

    def camera_image(
        self, placements: Array, origin: Array, axes: Array, focal: float, size: tuple[int, int]
    ) -> DepthImage:
        """Return what a pinhole camera, as in `World.camera_image`, sees of the bodies at `placements` (n, 4, 4)."""
        directions = pinhole_directions(axes, focal, size)
        rays = directions.reshape(-1, 3)
        distance, body = np.full(len(rays), np.inf), np.full(len(rays), -1)
        for index, scene, middle, radius in self._bodies:
            R, t = placements[index][:3, :3], placements[index][:3, 3]
            to_middle = R @ middle + t - origin
            along = rays @ to_middle
            near = np.flatnonzero(to_middle @ to_middle - along**2 <= radius**2)
            local = np.concatenate([np.broadcast_to((origin - t) @ R, (len(near), 3)), rays[near] @ R], axis=-1)
            hit = scene.cast_rays(self._tensor(local.astype(np.float32)))["t_hit"].numpy().astype(np.float64)
            first = hit < distance[near]
            distance[near[first]], body[near[first]] = hit[first], index
        shape = directions.shape[:2]
        return DepthImage(origin, directions, distance.reshape(shape), body.reshape(shape))


def pinhole_directions(axes: Array, focal: float, size: tuple[int, int]) -> Array:
    """Return the unit directions (rows, columns, 3) of a pinhole camera's pixels."""
    slopes = [(np.arange(count) - (count - 1) / 2.0) / focal for count in size]
    grid = np.stack([*np.meshgrid(*slopes), np.ones(size[::-1])], axis=-1)
    return np.asarray(grid / np.linalg.norm(grid, axis=-1, keepdims=True) @ axes.T)


def looking_at(forward: Array) -> Array:
    """Return the axes right, down, forward of a camera that looks along `forward` (3,), as columns."""
    z = forward / np.linalg.norm(forward)
    return np.stack([*axes_across(z), z], axis=-1)
