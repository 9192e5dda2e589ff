"""When parts that do not fit are searched for."""

from __future__ import annotations

import numpy as np
import pytest

import pwralign_kin as pk
from pwralign_kin.tracking.fit import FrameFit, Usual
from pwralign_kin.tracking.motion import BelievedMotion
from pwralign_kin.tracking.suspicion import Suspicion


def test_a_search_in_vain_is_repeated_at_once_and_then_ever_less(
    arm: pk.ArticulatedModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    suspicion = pk.Tracker(arm)._suspicion
    times: list[int] = []
    monkeypatch.setattr(Suspicion, "_swept", lambda _, fit, *__: (times.append(frame), fit)[1])
    monkeypatch.setattr(Usual, "suspects", lambda *_: np.array([True]))
    fit = FrameFit(np.eye(4), np.zeros(2))
    usual = Usual.of(fit, 1.0)
    expected = BelievedMotion.at_rest(0.0, np.eye(4), np.zeros(2), 0.0)
    for frame in range(1, 65):
        assert suspicion.searched(fit, expected, usual, np.inf) is fit, frame
    assert times == [1, 2, 4, 8, 16, 32, 48, 64]
