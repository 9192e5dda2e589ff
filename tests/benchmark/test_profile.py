"""Stages and kernels add up to the time, and the kernels are themselves again afterwards."""

from __future__ import annotations

import pytest

from pwralign_kin import kernels
from pwralign_kin.benchmark import profile
from pwralign_kin.benchmark.runs import tier_cases
from pwralign_kin.model import ArticulatedModel


def test_time_is_split(twins: ArticulatedModel) -> None:
    before = kernels.Search.score, kernels.voxel_means
    (timed,) = profile.measure(tier_cases([("twins", twins)], ["sparse"], 1), 1, lambda line: None)
    assert (kernels.Search.score, kernels.voxel_means) == before
    assert 0 < sum(timed.stages.values()) < 1.2 * timed.seconds
    assert timed.kernels["score"][0] > 0 and timed.kernels["voxel_means"][0] > 0
    assert 0 < sum(seconds for _, seconds in timed.kernels.values()) < timed.seconds
    text = profile.tables([timed])
    assert "| sparse |" in text and "| twins |" in text and "Python and libraries" in text


def test_kernels_are_restored_after_a_failure() -> None:
    before = kernels.Search.refine
    with pytest.raises(RuntimeError), profile.timed_kernels():
        assert kernels.Search.refine is not before
        raise RuntimeError
    assert kernels.Search.refine is before
