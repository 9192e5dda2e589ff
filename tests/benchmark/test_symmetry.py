"""Joint values of an answer, read in the words of the truth."""

from __future__ import annotations

import pytest

from pwralign_kin.benchmark.metrics import Reference, Ruler
from pwralign_kin.benchmark.symmetry import in_words_of_truth
from pwralign_kin.state import State


def test_swapped_limbs_say_the_same(ruler: Ruler, reference: Reference, truth: State, swapped: State) -> None:
    said = in_words_of_truth(ruler, reference, swapped)
    assert dict(said.joints) == pytest.approx(dict(truth.joints), abs=1e-5)


def test_errors_survive_the_reading(ruler: Ruler, reference: Reference, truth: State, swapped: State) -> None:
    """What `swapped` calls the right leg is truly the left one."""
    moved = {"right_hip": swapped.joints["right_hip"] - 0.03, "lift": 0.11}
    wrong = State(swapped.T_scan_base, {**swapped.joints, **moved})
    said = in_words_of_truth(ruler, reference, wrong)
    assert said.joints["left_hip"] - truth.joints["left_hip"] == pytest.approx(0.03, abs=1e-4)
    assert said.joints["right_hip"] - truth.joints["right_hip"] == pytest.approx(0.0, abs=1e-4)
    assert said.joints["lift"] - truth.joints["lift"] == pytest.approx(0.01, abs=1e-5)


def test_a_turn_about_the_own_axis_is_no_error(ruler: Ruler, reference: Reference, truth: State) -> None:
    """The roller is a prism of many sides: it comes to rest within half a side."""
    turned = State(truth.T_scan_base, {**truth.joints, "spin": 2.0})
    said = in_words_of_truth(ruler, reference, turned)
    assert said.joints["spin"] == pytest.approx(truth.joints["spin"], abs=0.1)
