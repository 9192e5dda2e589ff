"""Answers that no step of a search leads to."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from unittest import mock

import numpy as np
import pytest

import pwralign_kin as pk
from pwralign_kin.estimation.answers import contest
from pwralign_kin.estimation.answers.contest import contested
from pwralign_kin.estimation.comparison.candidates import Candidates
from pwralign_kin.estimation.estimator import Estimator
from pwralign_kin.estimation.search.voting import VoteOptions
from pwralign_kin.estimation.stages import SearchedScan

SWIVEL = """
<robot name="swivel">
  <link name="base">
    <visual><origin xyz="0 0 0.05"/><geometry><box size="0.3 0.2 0.1"/></geometry></visual>
    <visual><origin xyz="0.12 0.05 0.13"/><geometry><box size="0.05 0.05 0.06"/></geometry></visual>
  </link>
  <link name="arm">
    <visual><origin xyz="0.1 0 0.25"/><geometry><box size="0.4 0.1 0.1"/></geometry></visual>
    <visual><origin xyz="0.28 0.03 0.35"/><geometry><box size="0.06 0.1 0.1"/></geometry></visual>
  </link>
  <joint name="turn" type="revolute">
    <parent link="base"/><child link="arm"/><origin xyz="0 0 0"/><axis xyz="0 0 1"/>
    <limit lower="{lower}" upper="{upper}" effort="1" velocity="1"/>
  </joint>
</robot>
"""


def swivel(folder: Path, lower: float, upper: float) -> pk.ArticulatedModel:
    (folder / "swivel.urdf").write_text(SWIVEL.format(lower=lower, upper=upper))
    return pk.ArticulatedModel.from_urdf(folder / "swivel.urdf")


def searched_near(model: pk.ArticulatedModel, truth: pk.State) -> SearchedScan:
    scan = pk.simulate(model, truth, seed=0).scan
    return Estimator(model, pk.EstimatorOptions(threads=1)).searched(scan, truth, None)


def held_at(searched: SearchedScan, model: pk.ArticulatedModel, truth: pk.State, value: float) -> Candidates:
    base = searched.solver.comparison.observation.to_search(model.root_placement(truth))
    return Candidates.single(base, np.array([value]))


def against_rivals(searched: SearchedScan, final: Candidates) -> Candidates | None:
    return contested(searched.solver, final, final, pk.EstimatorOptions())


def test_a_joint_held_at_one_limit_may_be_meant_beyond_the_other(tmp_path: Path) -> None:
    model, truth = swivel(tmp_path, -3.0, 3.0), pk.State(np.eye(4), {"turn": -2.9})
    searched = searched_near(model, truth)
    final = held_at(searched, model, truth, 3.0)
    better = against_rivals(searched, final)
    assert better is not None
    assert better.values[0, 0] == pytest.approx(-2.9, abs=0.02)


def test_limits_far_apart_are_not_taken_for_each_other(tmp_path: Path) -> None:
    model, truth = swivel(tmp_path, -1.0, 1.0), pk.State(np.eye(4), {"turn": 1.0})
    searched = searched_near(model, truth)
    final = held_at(searched, model, truth, 1.0)
    assert against_rivals(searched, final) is None


def test_votes_about_parts_off_their_points_are_cast_as_the_options_say(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    model, truth = swivel(tmp_path, -1.0, 1.0), pk.State(np.eye(4), {"turn": 0.0})
    searched = searched_near(model, truth)
    mended = mock.Mock(return_value=None)
    monkeypatch.setattr(contest, "mended", mended)
    options = pk.EstimatorOptions()
    options = replace(options, repair=replace(options.repair, votes=VoteOptions(starts=3)))
    contested(searched.solver, *2 * [searched.finished.take([0])], options)
    assert mended.call_args.args[-1].starts == 3


def test_what_mending_leaves_off_its_points_is_repaired_and_mended_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    model, truth = swivel(tmp_path, -1.0, 1.0), pk.State(np.eye(4), {"turn": 0.0})
    searched = searched_near(model, truth)
    half = held_at(searched, model, truth, 0.2)
    mended = mock.Mock(side_effect=[half, None])
    monkeypatch.setattr(contest, "mended", mended)
    better = against_rivals(searched, held_at(searched, model, truth, 0.4))
    assert better is not None and mended.call_count == 2
    assert better.values[0, 0] == pytest.approx(0.0, abs=0.02)
