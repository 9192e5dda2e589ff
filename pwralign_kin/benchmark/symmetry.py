"""Joint errors up to what a model's own symmetry hides.

A square limb turned by a right angle, or a figure whose arms are taken for each other, looks the same with
joint values that are far from the truth. So the answer's surface is read again, starting at the truth: the
joint values that place the true parts on it are what the answer says in the truth's words.
"""

from __future__ import annotations

import numpy as np

from pwralign_kin import se3
from pwralign_kin.benchmark.metrics import Reference, Ruler
from pwralign_kin.render import RayScene, posed_mesh
from pwralign_kin.se3 import Array, transform
from pwralign_kin.state import State

_ITERATIONS = 40
"""Gauss-Newton steps at most."""
_REACH = 0.05
"""Surface farther than this does not pull, model diagonals."""
_DAMPING = 1e-6
"""Share of the mean curvature that keeps what no surface tells at its true value."""
_LARGEST_STEP, _TOLERANCE = 0.1, 1e-7
"""Largest component of a step, and of one that is the last, model diagonals and rad."""


def in_words_of_truth(ruler: Ruler, reference: Reference, answer: State) -> State:
    """Return the state near the truth whose observed parts lie on the surface of the model posed by `answer`.

    Gauss-Newton on point-to-plane distances from the parts' samples to that surface, over base and joints.
    """
    model = ruler.model
    mesh = posed_mesh(model, answer)
    centre = mesh.vertices.mean(axis=0)
    surface = RayScene(mesh.vertices - centre, mesh.faces)
    base = model.root_placement(reference.truth).copy()
    base[:3, 3] -= centre
    values = model.values(reference.truth.joints)
    for _ in range(_ITERATIONS):
        step = _step(ruler, reference, surface, base, values)
        base[:3, 3] += step[3:6] * model.diagonal
        base[:3, :3] = se3.from_twist(step[:6])[:3, :3] @ base[:3, :3]
        values = values + step[6:] * model.joint_scales
        if np.abs(step).max() < _TOLERANCE:
            break
    base[:3, 3] += centre
    return State(se3.orthonormalised(base), dict(zip(model.joint_names, values.tolist(), strict=True)))


def _step(ruler: Ruler, reference: Reference, surface: RayScene, base: Array, values: Array) -> Array:
    """Return the step (6 + k,) of base twist about its own origin and of joints, rad and model diagonals."""
    model, R = ruler.model, base[:3, :3]
    placements = base @ model.part_placements(values)
    jacobians = model.part_jacobians(values)
    size = 6 + len(values)
    H, g = np.zeros((size, size)), np.zeros(size)
    for part in reference.observed:
        points = transform(placements[part], ruler.samples[part])
        closest, normals, _ = surface.closest(points)
        residual = np.einsum("ni,ni->n", normals, closest - points) / model.diagonal
        near = np.linalg.norm(closest - points, axis=1) < _REACH * model.diagonal
        arm = points - placements[part][:3, 3]
        angular, linear = R @ jacobians[part][:3], R @ jacobians[part][3:]
        about_base = np.cross(points - base[:3, 3], normals) / model.diagonal
        by_joints = normals @ linear + np.cross(arm, normals) @ angular
        J = np.concatenate([about_base, normals, by_joints * model.joint_scales / model.diagonal], axis=1)[near]
        H += J.T @ J / len(points)
        g += J.T @ residual[near] / len(points)
    H += _DAMPING * np.trace(H) / size * np.eye(size)
    return np.clip(np.linalg.solve(H, g), -_LARGEST_STEP, _LARGEST_STEP)
