"""The step of a least-squares problem within bounds, by CasADi."""

from __future__ import annotations

import threading
from functools import lru_cache
from typing import Any

import numpy as np

from pwralign_kin.se3 import Array

KEPT = 64
"""Programs that a thread keeps: one for each number of unknowns."""


def bounded_step(H: Array, g: Array, low: Array, high: Array, damping: float) -> Array:
    """Return the x of least 1/2 x'Hx - g'x within bounds, with a little damping.

    Bounds are numbers, none above the other. Raises `LinAlgError` where there is no step: `H` is not positive definite,
    or a number of `H` or `g` not finite.
    """
    program = _PROGRAMS.sized(len(g))
    program.h[:], program.g[:], program.lbx[:], program.ubx[:] = H, -g, low, high
    program.h.flat[:: len(g) + 1] += damping + 1e-4 * H.diagonal()
    if not program.solve():
        raise np.linalg.LinAlgError("a bounded step of the least squares has no solution")
    return program.x.copy()


class _QuadraticProgram:
    """CasADi's solver of a dense quadratic program with simple bounds: 1/2 x'hx + g'x with x from lbx to ubx.

    It reads and writes memory of ours: conversions to its own matrices take ten times as long as the problem.
    """

    def __init__(self, size: int) -> None:
        import casadi

        solver: Any = casadi.conic(
            "step",
            "daqp",
            {"h": casadi.Sparsity.dense(size, size), "a": casadi.Sparsity(0, size)},
            {"error_on_fail": False},
        )
        self.h = np.empty((size, size))
        self.g, self.lbx, self.ubx, self.x = np.empty((4, size))
        self._buffer, self._evaluate = solver.buffer()
        for name in ("h", "g", "lbx", "ubx"):
            self._buffer.set_arg(solver.index_in(name), getattr(self, name).data)
        self._buffer.set_res(solver.index_out("x"), self.x.data)

    def solve(self) -> bool:
        """Set x to the solution; return whether there is one."""
        self._evaluate()
        return bool(np.isfinite(self.x).all() and self._buffer.stats()["success"])


class _Programs(threading.local):
    """The programs of one thread, by their size: no two threads share their memory."""

    def __init__(self) -> None:
        self.sized = lru_cache(maxsize=KEPT)(_QuadraticProgram)


_PROGRAMS = _Programs()
