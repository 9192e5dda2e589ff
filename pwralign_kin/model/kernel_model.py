"""The model as the compiled kernels take it, lengths in model diagonals."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pwralign_kin import kernels
from pwralign_kin.model.part_graph import Part
from pwralign_kin.model.surface import Surface, part_weights, triple
from pwralign_kin.se3 import Array

REACH_CONFIGURATIONS = 60  # random ones, that tell how far the model reaches


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
    limits, wraps = (lower / joint_scales, upper / joint_scales), continuous.astype(np.uint8)
    return kernels.Articulated(parent, actuated, placement, axis, prismatic, multiplier, offset, *limits, wraps)


def set_surfaces(native: kernels.Articulated, surfaces: Sequence[Surface]) -> None:
    """Give every part of the kinematic tree its surface, and what it weighs in scores."""
    for i, (surface, weight) in enumerate(zip(surfaces, part_weights(surfaces), strict=True)):
        cell, spacing, radius, size, area = map(float, surface.scalars)
        native.set_surface(
            i, surface.samples, surface.normals, surface.weights, surface.dense, surface.dense_normals,
            surface.apparent_normals, surface.grid, triple(surface.origin), cell, spacing, triple(surface.centre),
            radius, size, area, float(weight),
        )  # fmt: skip


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
