"""Placements and Jacobians of the parts by Pinocchio.

Pinocchio's model is built without mimic joints; values of all moving joints follow from the actuated ones by
value = A u + b. A continuous joint stands in Pinocchio's configuration as (cos, sin); users see angles only.
"""

from __future__ import annotations

import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pwralign_kin.dependencies import pinocchio
from pwralign_kin.exceptions import ModelError
from pwralign_kin.model.part_graph import MovingJoint
from pwralign_kin.se3 import Array, skew


class Kinematics:
    """Kinematics of a tree of parts.

    `joints` are the parts' moving joints in the order of the parts (None for the root, which comes first);
    `actuated` is the number k of actuated joints.
    """

    def __init__(self, xml: str, path: Path, joints: Sequence[MovingJoint | None], actuated: int) -> None:
        """Build Pinocchio's model from the normalised URDF; raises `ModelError` where it refuses."""
        library = pinocchio()
        try:
            self.model: Any = library.buildModelFromXML(xml)
        except Exception as error:  # Boost.Python maps any C++ exception to any Python one
            raise ModelError(path, f"Pinocchio does not read it: {' '.join(str(error).split())}") from None
        self._xml, self._path, self._joints, self._count = xml, path, tuple(joints), actuated
        moving = [joint for joint in joints if joint is not None]
        self.ids = np.array([0, *(self.model.getJointId(joint.name) for joint in moving)])
        """(n_parts,) Pinocchio's joint of each part; 0, the universe, for the root."""

        if self.model.njoints != len(self.ids) or (self.ids >= self.model.njoints).any():
            raise ModelError(path, "Pinocchio reads other joints in it than this package")
        self.A = np.zeros((len(moving), actuated))
        """(n_parts - 1, k) and `b` (n_parts - 1,): values of the moving joints = A u + b."""

        self.b = np.array([joint.offset for joint in moving])
        for row, joint in enumerate(moving):
            self.A[row, joint.actuated] = joint.multiplier
        pinocchio_joints = [self.model.joints[int(index)] for index in self.ids[1:]]
        self._idx_q = np.array([joint.idx_q for joint in pinocchio_joints], dtype=np.int64)
        self._idx_v = np.array([joint.idx_v for joint in pinocchio_joints], dtype=np.int64)
        self._circle = np.array([joint.nq == 2 for joint in pinocchio_joints], dtype=bool)
        # The moving joints in the order of the actuated ones that move them, where those of each begin, and where the
        # entries of their twists, turns first, stand in Pinocchio's Jacobian.
        moved_by = np.array([joint.actuated for joint in moving], dtype=np.int64)
        order = np.argsort(moved_by, kind="stable")
        self._starts = np.searchsorted(moved_by[order], np.arange(actuated))
        self._entries = self._idx_v[order] + self.model.nv * np.array([3, 4, 5, 0, 1, 2])[:, None]
        supports = np.zeros((len(self.ids), self.model.nv))
        for part, index in enumerate(self.ids):
            for joint in self.model.supports[int(index)]:
                first = self.model.joints[joint].idx_v
                supports[part, first : first + self.model.joints[joint].nv] = joint > 0
        self._rates = supports[:, None, self._idx_v[order]] * np.array([joint.multiplier for joint in moving])[order]
        """(n_parts, 1, n_parts - 1) by how much each of them moves each part, against its own value."""

        self._local = threading.local()

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle as the recipe: Pinocchio's objects stay in their process."""
        return (Kinematics, (self._xml, self._path, self._joints, self._count))

    def configuration(self, values: Array) -> Array:
        """Return Pinocchio's q (nq,) for the actuated values (k,)."""
        moving = self.A @ values + self.b
        q = np.empty(self.model.nq)
        q[self._idx_q] = np.where(self._circle, np.cos(moving), moving)
        q[self._idx_q[self._circle] + 1] = np.sin(moving[self._circle])
        return q

    def placements(self, values: Array) -> Array:
        """Return (n_parts, 4, 4) placements of the parts in the root link's frame."""
        workspace = self._workspace_here()
        pinocchio().forwardKinematics(self.model, workspace.data, self.configuration(values))
        return workspace.placements()

    def placements_and_twists(self, values: Array) -> tuple[Array, Array]:
        """Return (n_parts, 4, 4) placements, and (n_parts, 6, k) twists of the parts by the actuated values.

        Rows 0-2 are angular, 3-5 linear velocity of what is at the root link's origin, root axes.
        """
        workspace = self._workspace_here()
        # Each column is the twist of one joint; a part has those of the joints between it and the root.
        columns = pinocchio().computeJointJacobians(self.model, workspace.data, self.configuration(values))
        twists = columns.ravel()[self._entries] * self._rates
        if len(self._starts) < twists.shape[2]:  # mimic joints
            twists = np.add.reduceat(twists, self._starts, axis=2)
        return workspace.placements(), twists

    def jacobians(self, values: Array) -> Array:
        """Return (n_parts, 6, k): rows 0-2 angular, 3-5 linear velocity of each part's origin, root axes."""
        placements, J = self.placements_and_twists(values)
        J[:, 3:] -= skew(placements[:, :3, 3]) @ J[:, :3]
        return J

    def _workspace_here(self) -> _Workspace:
        """Return the workspace of this thread: making one costs as much as the kinematics."""
        if not hasattr(self._local, "workspace"):
            self._local.workspace = _Workspace(self.model, self.ids)
        workspace: _Workspace = self._local.workspace
        return workspace


class _Workspace:
    """What Pinocchio computes with."""

    def __init__(self, model: Any, ids: NDArray[np.int64]) -> None:
        self.data: Any = model.createData()
        # Pinocchio's own placements of the parts, not copies: to look one up takes longer than to read it.
        self._placed = [self.data.oMi[int(index)] for index in ids]

    def placements(self) -> Array:
        """Return the placements (n_parts, 4, 4) that were computed last."""
        return np.array([placement.homogeneous for placement in self._placed])
