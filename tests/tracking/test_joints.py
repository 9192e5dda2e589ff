"""Which joints move which."""

from __future__ import annotations

import numpy as np

import pwralign_kin as pk
from pwralign_kin.tracking.joints import Joints


def test_chains_are_the_joints_above_the_last_ones(arm: pk.ArticulatedModel) -> None:
    joints = Joints.of(arm, ())
    assert [chain.tolist() for chain in joints.chains(np.array([True, True]))] == [[True, True]]
    assert [chain.tolist() for chain in joints.chains(np.array([True, False]))] == [[True, False]]
    assert joints.moves.tolist() == [[True, True], [False, True]]
