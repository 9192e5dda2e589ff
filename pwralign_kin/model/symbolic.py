"""Forward kinematics in CasADi symbols, built from Pinocchio's model.

PyPI's Pinocchio comes without its CasADi bindings, so the chain is rebuilt here from what Pinocchio's model
holds: joint placements and motion subspaces. Tests compare it with Pinocchio's own kinematics.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pwralign_kin.model.kinematics import Kinematics


def placement_function(kinematics: Kinematics) -> Any:
    """Return the `casadi.Function` placements(base, u) -> T.

    `base` (6,) is the root link's twist in the sense of `se3.exp` (rotation vector, then translation; rad and
    m), `u` (k,) are the actuated joint values. `T` (4, 4 n_parts) holds the placements of the parts side by
    side, in the order of the parts, in the frame that `base` is given in.
    """
    import casadi

    base, u = casadi.SX.sym("base", 6), casadi.SX.sym("u", kinematics.A.shape[1])
    placements = part_placements(kinematics, _placement(base[:3], base[3:]), u)
    return casadi.Function("placements", [base, u], [casadi.horzcat(*placements)], ["base", "u"], ["T"])


def part_placements(kinematics: Kinematics, T_base: Any, u: Any) -> list[Any]:
    """Return the (4, 4) symbolic placements of the parts for a base placement and actuated values (k,)."""
    import casadi

    model = kinematics.model
    part_of = {int(index): part for part, index in enumerate(kinematics.ids)}
    placements = [casadi.SX(T_base)]
    for part, index in enumerate(map(int, kinematics.ids[1:]), start=1):
        subspace = _motion_subspace(model.joints[index])
        value = casadi.DM(kinematics.A[part - 1]).T @ u + kinematics.b[part - 1]
        motion = _placement(subspace[3:] * value, subspace[:3] * value)
        fixed = casadi.DM(model.jointPlacements[index].homogeneous)
        placements.append(placements[part_of[model.parents[index]]] @ fixed @ motion)
    return placements


def _motion_subspace(joint: Any) -> Any:
    """The joint's unit twist (6,), linear first, as Pinocchio has it; for URDF's joints it is constant."""
    data, q = joint.createData(), np.zeros(joint.idx_q + joint.nq)
    if joint.nq == 2:
        q[joint.idx_q] = 1.0  # a continuous joint rests at (cos, sin) = (1, 0)
    joint.calc(data, q)
    return np.asarray(data.S).reshape(6)


def _placement(rotation_vector: Any, translation: Any) -> Any:
    """Rotate by Rodrigues' formula, then translate; smooth at no rotation, where its terms are 0 / 0."""
    import casadi

    w = casadi.SX(rotation_vector)
    angle = casadi.sqrt(casadi.sumsqr(w) + 1e-30)
    K = casadi.skew(w)
    half_sine = casadi.sin(angle / 2) / (angle / 2)
    R = casadi.SX.eye(3) + casadi.sin(angle) / angle * K + half_sine**2 / 2 * K @ K
    return casadi.vertcat(casadi.horzcat(R, translation), casadi.DM([[0, 0, 0, 1]]))
