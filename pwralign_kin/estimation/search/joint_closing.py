"""Joint values that two placed parts take: the joints between them closed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pwralign_kin import kernels
from pwralign_kin.model import ArticulatedModel
from pwralign_kin.model.part_graph import MovingJoint
from pwralign_kin.se3 import Array, skew

OPEN_TURN, OPEN_SLIDE = 0.12, 0.015
"""How far a joint may be open (rad, model diagonals) before refinement: parts only nearly look alike."""
BEYOND = 0.05
"""How far beyond its limits (rad, model diagonals) a joint may be before refinement."""


@dataclass(frozen=True)
class Chain:
    """One or two joints between two parts with surface; the part between two joints has none."""

    above: int
    held: tuple[int, ...]
    """The parts that its joints hold, from that above on."""
    joints: tuple[MovingJoint, ...]

    @property
    def below(self) -> int:
        """The part at its lower end."""
        return self.held[-1]

    @property
    def actuated(self) -> list[int]:
        """The actuated joints that move its joints."""
        return [joint.actuated for joint in self.joints]

    def other(self, part: int) -> int:
        """Return the part at the other end."""
        return self.below if part == self.above else self.above


def chains_between(model: ArticulatedModel) -> tuple[Chain, ...]:
    """Return the connections between parts with surface that can be solved for their joints."""
    chains = []
    for below, part in enumerate(model.parts):
        if model.symmetry.kind[below] < 0 or part.joint is None:
            continue
        joints: tuple[MovingJoint, ...] = (part.joint,)
        held: tuple[int, ...] = (below,)
        above = part.parent
        between = model.parts[above].joint
        if model.symmetry.kind[above] < 0 and between is not None:
            joints, held, above = (between, *joints), (above, below), model.parts[above].parent
        turning = all(joint.kind != "prismatic" for joint in joints)
        if model.symmetry.kind[above] >= 0 and (len(joints) == 1 or turning):
            chains.append(Chain(above, held, joints))
    return tuple(chains)


class JointClosing:
    """Closes the joints of chains, in search units (lengths in model diagonals)."""

    def __init__(self, model: ArticulatedModel, native: kernels.Articulated) -> None:
        """Take the model, and its kernel form with the limits."""
        self.model = model
        self.kernel_model = native

    def values(self, chain: Chain, above: Array, below: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Return the actuated values (a, b, joints) that the chain's joints take between each of the placements of the
        part above (a, 4, 4) and each of those of the part below (b, 4, 4), and whether (a, b) they close within their
        limits."""
        found, fits = self.kernel_model.closed(chain.held, above, below, OPEN_TURN, OPEN_SLIDE, BEYOND)
        return found, fits.astype(bool)

    def placed(self, joints: tuple[MovingJoint, ...], above: Array, values: Array) -> Array:
        """Return the placements (..., 4, 4) of the part below for those of the part above and `values` (..., joints),
        which broadcast."""
        T = above
        for column, joint in enumerate(joints):
            value = joint.multiplier * values[..., column] * self.model.joint_scales[joint.actuated] + joint.offset
            if joint.kind == "prismatic":
                move = np.tile(np.eye(4), (*value.shape, 1, 1))
                move[..., :3, 3] = value[..., None] / self.model.diagonal * joint.axis
            else:
                move = _turns(joint.axis, value)
            T = T @ self._offset(joint) @ move
        return T

    def _offset(self, joint: MovingJoint) -> Array:
        """Return the joint's placement in the part above."""
        T = joint.T_parent_joint.copy()
        T[:3, 3] /= self.model.diagonal
        return T


def _turns(axis: Array, angle: Array) -> Array:
    """Return the placements (..., 4, 4) turned by `angle` (...) about `axis` (Rodrigues' formula)."""
    K = skew(axis)
    T = np.tile(np.eye(4), (*angle.shape, 1, 1))
    T[..., :3, :3] += np.sin(angle)[..., None, None] * K + (1.0 - np.cos(angle))[..., None, None] * (K @ K)
    return T
