"""A table under the model and solids beside it."""

from __future__ import annotations

import numpy as np

from pwralign_kin.se3 import Array
from pwralign_kin.simulation.raycasting import Body

_SOLID_SIZES, _GAPS = (0.15, 0.3), (0.03, 0.15)
"""Least and largest size of the solids, and gap between them and the model, model diagonals."""

_TABLE_MARGIN, _TABLE_THICKNESS, _TABLE_GAP = 0.05, 0.03, 0.01
"""How far the table reaches beyond what is on it, how thick it is, and how far below the model, model diagonals."""


def table_and_solids(vertices: Array, diagonal: float, rng: np.random.Generator) -> list[Body]:
    """Return a square table just below `vertices` (v, 3) and a box, a cylinder and a ball on it around them.

    Up is +z. All sizes scale with `diagonal`, m; the solids touch neither the model nor each other.
    """
    import trimesh.creation

    lower, upper = vertices.min(axis=0), vertices.max(axis=0)
    middle = (lower + upper)[:2] / 2.0
    reach = float(np.linalg.norm(vertices[:, :2] - middle, axis=1).max())
    top = lower[2] - _TABLE_GAP * diagonal
    sizes = rng.uniform(*_SOLID_SIZES, size=(3, 3)) * diagonal
    solids = [
        trimesh.creation.box(sizes[0]),
        trimesh.creation.cylinder(radius=sizes[1, 0] / 2.0, height=sizes[1, 2], sections=48),
        trimesh.creation.icosphere(subdivisions=3, radius=sizes[2, 0] / 2.0),
    ]
    first_angle = rng.uniform(0.0, 2.0 * np.pi)
    bodies: list[Body] = []
    outermost = reach
    for index, solid in enumerate(solids):
        radius = float(np.linalg.norm(solid.vertices[:, :2], axis=1).max())
        angle = first_angle + 2.0 * np.pi * (index + rng.uniform(-0.15, 0.15)) / 3.0
        away = reach + radius + rng.uniform(*_GAPS) * diagonal
        outermost = max(outermost, away + radius)
        turn = rng.uniform(0.0, 2.0 * np.pi)
        R = np.array([[np.cos(turn), -np.sin(turn), 0.0], [np.sin(turn), np.cos(turn), 0.0], [0.0, 0.0, 1.0]])
        foot = np.append(middle + away * np.array([np.cos(angle), np.sin(angle)]), top - solid.bounds[0, 2])
        bodies.append((np.asarray(solid.vertices @ R.T + foot), np.asarray(solid.faces, dtype=np.int64)))

    side = 2.0 * (outermost + _TABLE_MARGIN * diagonal)
    thickness = _TABLE_THICKNESS * diagonal
    table = trimesh.creation.box([side, side, thickness])
    bodies.append(
        (
            np.asarray(table.vertices + np.append(middle, top - thickness / 2.0)),
            np.asarray(table.faces, dtype=np.int64),
        )
    )
    return bodies
