"""The joints of a tracked model, in rad or model diagonals, and what a frame tells of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pwralign_kin.model import ArticulatedModel
from pwralign_kin.se3 import Array
from pwralign_kin.tracking.fit import FrameFit
from pwralign_kin.tracking.motion import BelievedMotion

UNDETERMINED = float(np.radians(2.5))
"""A joint whose standard deviation is larger (rad; of slides this share of a diagonal) is undetermined, ..."""

MUCH_DOUBT = 0.5
"""... or larger than this share of that of a value that may be anywhere within the limits."""

TOLD, VAGUE = 0.75, float(np.radians(8.0))
"""A frame tells a joint when it takes away this share of its variance and leaves a smaller deviation than the second;
others keep their value."""


@dataclass(frozen=True)
class Joints:
    """The actuated joints (k,) of a model; values in rad or model diagonals."""

    unit: Array
    """What a value is of those that the model has, rad or m."""
    lower: Array
    """Limits: least values, ..."""
    upper: Array
    """... and largest."""
    turns: Array
    """Range of joints that wrap, else infinite."""
    free: NDArray[np.bool_]
    """Those that are not locked."""
    moves: NDArray[np.bool_]
    """(k, k) whether the first of two moves the second, each itself too."""

    @classmethod
    def of(cls, model: ArticulatedModel, locked: Sequence[str]) -> Joints:
        """Return the joints of a model."""
        unit = model.joint_scales
        lower, upper = model.lower / unit, model.upper / unit
        turns = np.where(model.continuous, upper - lower, np.inf)
        return cls(unit, lower, upper, turns, ~np.isin(model.joint_names, locked), _moves(model))

    @property
    def most_doubt(self) -> Array:
        """(k,) standard deviations of values that may be anywhere within the limits."""
        return np.asarray((self.upper - self.lower) / np.sqrt(12.0))

    @property
    def much_doubt(self) -> Array:
        """(k,) standard deviations above which joints are undetermined."""
        return np.minimum(UNDETERMINED, MUCH_DOUBT * self.most_doubt)

    def within(self, values: Array) -> Array:
        """Return values (..., k) turned or moved into the limits."""
        turned = self.lower + (values - self.lower) % np.maximum(self.upper - self.lower, 1e-9)
        return np.where(np.isfinite(self.turns), turned, np.clip(values, self.lower, self.upper))

    def apart(self, values: Array, others: Array) -> Array:
        """Return how far values (..., k) are from others, the short way round."""
        apart = np.abs(values - others)
        return np.minimum(apart, np.abs(self.turns - apart))

    def chains(self, among: NDArray[np.bool_]) -> list[NDArray[np.bool_]]:
        """Return some joints as chains (k,): each that moves none but those that move it too, with those that move it.

        Joints that move one another, as mimics can, are in one chain together.
        """
        last = among & ~(self.moves & ~self.moves.T & among).any(axis=1)
        mutual = self.moves & self.moves.T & among
        first = mutual.argmax(axis=1) == np.arange(len(among))
        return [among & self.moves[:, joint] for joint in np.flatnonzero(last & first)]

    def untold(self, fit: FrameFit, expected: BelievedMotion) -> NDArray[np.bool_]:
        """Return the joints (k,) that a frame does not tell; those that are locked need not be told."""
        if not fit.iterations:
            return self.free
        variance = np.diag(fit.covariance)[6:]
        told = (variance < (1.0 - TOLD) * np.diag(expected.covariance)[6:]) | (variance < UNDETERMINED**2)
        return np.asarray(self.free & ~(told & (variance < VAGUE**2)))


def _moves(model: ArticulatedModel) -> NDArray[np.bool_]:
    moves = np.eye(len(model.joint_names), dtype=bool)
    for part in model.parts:
        above = None if part.joint is None else model.parts[part.parent].joint
        if part.joint is not None and above is not None:
            moves[above.actuated, part.joint.actuated] = True
    while True:  # what a joint moves can move more, by its mimics anywhere in the tree
        further = moves @ moves
        if (further == moves).all():
            return moves
        moves = further
