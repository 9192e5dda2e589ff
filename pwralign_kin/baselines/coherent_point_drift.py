"""Coherent point drift (Myronenko and Song, TPAMI 2010) by pycpd: rigid, and deformable.

Left at its defaults, as in its examples (https://github.com/siavashk/pycpd/tree/master/examples), but for strays. The
defaults are for clouds of unit variance, to which the paper brings them: both are scaled by the target's. Every point
pairs with every other, so it is fed samples; the other points move with the field that these have found, as in its
example "register with subset of points".
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from pwralign_kin.dependencies import peer
from pwralign_kin.se3 import Array

SAMPLES = 500
"""Points of either cloud that are registered."""

STRAY = 0.1
"""Share of points that belong to nothing, in the sense of pycpd's `w`; 0, its default, makes one stray fatal."""


def rigid_drift(source: Array, target: Array, seed: int = 0) -> Array:
    """Return T_target_source (4, 4) of points (n, 3) and (m, 3), m.

    Raises `DependencyError` where pycpd is missing.
    """
    X, Y, centre, size = _samples(source, target, seed)
    found = peer("pycpd").RigidRegistration(X=X, Y=Y, scale=False, w=STRAY)
    found.register()
    T = np.eye(4)
    T[:3, :3] = found.R.T
    T[:3, 3] = size * found.t.ravel() + centre - T[:3, :3] @ centre
    return T


def deformable_drift(source: Array, target: Array, seed: int = 0) -> Callable[[Array], Array]:
    """Return the field in which points (n, 3) of `source`, m, drift onto those of `target` (m, 3), m.

    It takes any points (p, 3), m, beside the source and returns where they go. Raises `DependencyError` where pycpd is
    missing.
    """
    X, Y, centre, size = _samples(source, target, seed)
    found = peer("pycpd").DeformableRegistration(X=X, Y=Y, w=STRAY)
    found.register()

    def drifted(points: Array) -> Array:
        apart = (((points - centre) / size)[:, None] - Y[None]) ** 2
        return np.asarray(points + size * (np.exp(-apart.sum(axis=2) / (2.0 * found.beta**2)) @ found.W))

    return drifted


def _samples(source: Array, target: Array, seed: int) -> tuple[Array, Array, Array, float]:
    """Return samples of target and source about the target's centre and scaled by its spread, centre and spread."""
    random = np.random.default_rng(seed)
    centre, size = np.asarray(target.mean(axis=0)), float(np.sqrt(target.var(axis=0).mean()))
    X, Y = ((points[random.permutation(len(points))[:SAMPLES]] - centre) / size for points in (target, source))
    return X, Y, centre, size
