"""The model as the compiled kernels take it, lengths in model diagonals."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pwralign_kin import kernels
from pwralign_kin.model.part_graph import Part
from pwralign_kin.model.surface import Surface, part_weights, triple
from pwralign_kin.se3 import Array

REACH_CONFIGURATIONS = 60
"""Random ones, that tell how far the model reaches."""


def kernel_tree(
    parts: Sequence[Part],
    diagonal: float,
    joint_scales: Array,
    lower: Array,
    upper: Array,
    continuous: NDArray[np.bool_],
) -> kernels.Articulated:
    """Return the kinematic tree (`kernels.Articulated`), without surfaces; arguments as in `ArticulatedModel`."""
    count = len(parts)
    placement = np.tile(np.eye(4), (count, 1, 1))
    axis, multiplier, offset = np.zeros((count, 3)), np.ones(count), np.zeros(count)
    parent, actuated, prismatic = np.full(count, -1, np.int32), np.zeros(count, np.int32), np.zeros(count, np.uint8)
    for i, part in enumerate(parts):
        joint = part.joint
        if joint is None:
            continue
        placement[i] = joint.T_parent_joint
        placement[i, :3, 3] /= diagonal
        parent[i], actuated[i], prismatic[i] = part.parent, joint.actuated, joint.kind == "prismatic"
        axis[i] = joint.axis
        # value = multiplier * u + offset, each side in its own unit: metres become diagonals
        output = diagonal if prismatic[i] else 1.0
        multiplier[i] = joint.multiplier * joint_scales[joint.actuated] / output
        offset[i] = joint.offset / output
    return kernels.Articulated(
        parent=parent,
        actuated=actuated,
        placement=placement,
        axis=axis,
        prismatic=prismatic,
        multiplier=multiplier,
        offset=offset,
        lower=lower / joint_scales,
        upper=upper / joint_scales,
        wraps=continuous.astype(np.uint8),
    )


def set_surfaces(native: kernels.Articulated, surfaces: Sequence[Surface]) -> None:
    """Give every part of the kinematic tree its surface, and what it weighs in scores."""
    for i, (surface, weight) in enumerate(zip(surfaces, part_weights(surfaces), strict=True)):
        native.set_surface(
            part=i,
            samples=surface.samples,
            normals=surface.normals,
            weights=surface.weights,
            dense=surface.dense,
            dense_normals=surface.dense_normals,
            apparent_normals=surface.apparent_normals,
            grid=surface.grid,
            origin=triple(surface.origin),
            cell=surface.cell,
            slack=surface.spacing,
            centre=triple(surface.centre),
            radius=surface.radius,
            size=surface.size,
            area=surface.area,
            weight=float(weight),
        )


def model_reach(native: kernels.Articulated, surfaces: Sequence[Surface]) -> float:
    """Return the largest diagonal of the box around the model over random joint values, in model diagonals."""
    random = np.random.default_rng(0)
    lower, upper = native.limits
    values = random.uniform(lower, upper, (REACH_CONFIGURATIONS, len(lower)))
    T = np.asarray(native.forward(np.tile(np.eye(4), (REACH_CONFIGURATIONS, 1, 1)), values))
    placed = np.concatenate(
        [
            surface.samples[:12] @ np.swapaxes(T[:, i, :3, :3], 1, 2) + T[:, i, None, :3, 3]
            for i, surface in enumerate(surfaces)
            if surface.exists
        ],
        axis=1,
    )
    return float(np.linalg.norm(np.ptp(placed, axis=1), axis=1).max())
