"""Scores of answers whose verdict is known by hand."""

from __future__ import annotations

import numpy as np
import pytest

from pwralign_kin.benchmark.metrics import Reference, Ruler, surface_samples
from pwralign_kin.model import ArticulatedModel
from pwralign_kin.state import State


def with_joint(state: State, name: str, offset: float) -> State:
    return State(state.T_scan_base, {**state.joints, name: state.joints[name] + offset}, state.base_link)


def shifted(state: State, offset: float) -> State:
    T = state.T_scan_base.copy()
    T[:3, 3] += [offset, 0.0, 0.0]
    return State(T, state.joints)


def test_the_truth_is_perfect(ruler: Ruler, reference: Reference, truth: State) -> None:
    score = ruler.score(reference, truth)
    assert score.success and score.overlay and score.fine
    assert score.recall == 1.0
    assert max(score.part_errors.values()) < 1e-5
    assert set(score.joint_errors.values()) == {0.0}


def test_no_answer_is_wrong_in_everything(ruler: Ruler, reference: Reference) -> None:
    score = ruler.score(reference, None)
    assert not (score.success or score.overlay or score.fine)
    assert score.recall == 0.0
    assert score.mean_error == 1.0
    assert score.joint_errors == {}


def test_interchangeable_limbs_are_an_overlay_but_no_success(
    ruler: Ruler, reference: Reference, swapped: State
) -> None:
    score = ruler.score(reference, swapped)
    assert score.overlay and not score.success
    assert score.part_errors["body"] < 1e-5
    assert score.recall == pytest.approx(3 / 5)


@pytest.mark.parametrize(
    ("share", "success", "fine"), [(0.004, True, True), (0.015, True, False), (0.03, False, False)]
)
def test_a_part_may_be_off_by_two_percent(
    ruler: Ruler, reference: Reference, truth: State, share: float, success: bool, fine: bool
) -> None:
    score = ruler.score(reference, with_joint(truth, "lift", share * ruler.model.diagonal))
    assert (score.success, score.fine, score.overlay) == (success, fine, success)
    half_thickness = 0.001 / ruler.model.diagonal
    assert score.part_errors["plate"] == pytest.approx(share - half_thickness, rel=0.02)
    assert score.part_errors["left"] < 1e-5


def test_an_overlay_must_be_right_everywhere(ruler: Ruler, reference: Reference, swapped: State) -> None:
    assert not ruler.score(reference, with_joint(swapped, "left_hip", 0.2)).overlay
    assert not ruler.score(reference, shifted(swapped, 0.05 * ruler.model.diagonal)).overlay


def test_what_the_scan_lacks_is_not_asked_for(ruler: Ruler, truth: State) -> None:
    labels = np.concatenate([np.repeat([0, 1, 2, 3], 100), np.full(14, 4), np.full(50, -1)])
    reference = ruler.reference(truth, labels)
    assert reference.observed == (0, 1, 2, 3)
    assert ruler.score(reference, with_joint(truth, "lift", 0.2)).success
    assert "lift" not in reference.told


def test_few_points_among_many_are_not_an_observation(ruler: Ruler, truth: State) -> None:
    labels = np.concatenate([np.repeat([0, 1, 2, 3], 2000), np.full(30, 4)])
    assert 4 not in ruler.reference(truth, labels).observed
    assert 4 in ruler.reference(truth, labels[4000:]).observed


def test_turning_a_roller_costs_nothing(ruler: Ruler, reference: Reference, truth: State) -> None:
    score = ruler.score(reference, with_joint(truth, "spin", 2.1))
    assert score.fine
    assert score.part_errors["roller"] < 5e-4
    assert score.joint_errors["spin"] == pytest.approx(np.degrees(2.1))


def test_the_scan_tells_joints_that_move_surface(reference: Reference) -> None:
    assert reference.told == ("left_hip", "right_hip", "lift")


def test_joint_errors_are_degrees_modulo_turns_and_percent_of_the_range(
    ruler: Ruler, reference: Reference, truth: State
) -> None:
    moved = with_joint(with_joint(truth, "spin", 2 * np.pi - 0.1), "lift", -0.02)
    errors = ruler.score(reference, moved).joint_errors
    assert errors["spin"] == pytest.approx(np.degrees(0.1))
    assert errors["lift"] == pytest.approx(5.0)
    assert errors["left_hip"] == 0.0


def test_errors_do_not_depend_on_where_the_scan_is(ruler: Ruler, truth: State) -> None:
    labels = np.repeat(np.arange(5), 100)
    here, there = (
        ruler.score(ruler.reference(state, labels), with_joint(state, "left_hip", 0.1))
        for state in (truth, State(np.eye(4), truth.joints))
    )
    assert here.part_errors == pytest.approx(there.part_errors, abs=1e-6)


def test_samples_lie_on_the_surface_in_proportion_to_its_area(twins: ArticulatedModel) -> None:
    body = twins.parts[0]
    samples = surface_samples(body.vertices, body.faces, 4000, 0)
    half = np.array([0.25, 0.15, 0.05])
    assert np.abs(samples / half).max(axis=1) == pytest.approx(np.ones(4000))
    on_top = np.isclose(np.abs(samples[:, 2]), half[2]).mean()
    assert on_top == pytest.approx(0.15 / (0.15 + 0.05 + 0.03), abs=0.03)
