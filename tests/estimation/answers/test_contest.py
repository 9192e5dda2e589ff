"""Rivals that no step of a search leads to, and answers that only the model's own triangles tell apart."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

import pwralign_kin as pk
from pwralign_kin.estimation.answers.contest import contested
from pwralign_kin.estimation.estimator import Estimator
from pwralign_kin.estimation.evidence.evidence import gathered
from pwralign_kin.estimation.search.candidates import Candidates
from pwralign_kin.estimation.stages import Fit
from pwralign_kin.se3 import rotation_about

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


def fitted(model: pk.ArticulatedModel, truth: pk.State) -> Fit:
    scan = pk.simulate(model, truth, seed=0).scan
    return Estimator(model, pk.EstimatorOptions(threads=1)).fit(scan, truth, None)


def held_at(fit: Fit, model: pk.ArticulatedModel, truth: pk.State, value: float) -> Candidates:
    base = fit.solver.search.observation.to_search(model.root_placement(truth))
    return Candidates.single(base, np.array([value]))


def several(fit: Fit, model: pk.ArticulatedModel, truth: pk.State) -> tuple[Candidates, Candidates]:
    """A wrong answer, and it before the right one of `truth` with scores a little lower."""
    right = held_at(fit, model, truth, truth.joints["turn"])
    turned = right.bases[0].copy()
    turned[:3, :3] = turned[:3, :3] @ rotation_about(np.array([0.0, 0.0, 1.0]), np.pi)
    wrong = Candidates.single(turned, np.array([truth.joints["turn"] - np.pi + 0.3]))
    return wrong, Candidates(
        np.concatenate([wrong.bases, right.bases]), np.concatenate([wrong.values, right.values]),
        np.array([1.0, 0.995], np.float32),
    )  # fmt: skip


def contest(fit: Fit, final: Candidates, finished: Candidates) -> Candidates | None:
    evidence = gathered(fit.solver.search, final, finished)
    return contested(fit.solver, final, evidence, finished, final.take(slice(0, 0)), pk.EstimatorOptions())


def test_a_joint_held_at_one_limit_may_be_meant_beyond_the_other(tmp_path: Path) -> None:
    model, truth = swivel(tmp_path, -3.0, 3.0), pk.State(np.eye(4), {"turn": -2.9})
    fit = fitted(model, truth)
    final = held_at(fit, model, truth, 3.0)
    better = contest(fit, final, final)
    assert better is not None
    assert better.values[0, 0] == pytest.approx(-2.9, abs=0.02)


def test_limits_far_apart_are_not_taken_for_each_other(tmp_path: Path) -> None:
    model, truth = swivel(tmp_path, -1.0, 1.0), pk.State(np.eye(4), {"turn": 1.0})
    fit = fitted(model, truth)
    final = held_at(fit, model, truth, 1.0)
    assert contest(fit, final, final) is None


def test_of_nearly_equal_scores_the_points_decide(tmp_path: Path) -> None:
    """Scores a hundredth apart say less than thousands of points."""
    model, truth = swivel(tmp_path, -3.0, 3.0), pk.State(np.eye(4), {"turn": 0.5})
    fit = fitted(model, truth)
    wrong, finished = several(fit, model, truth)
    better = contest(fit, wrong, finished)
    assert better is not None
    assert better.values[0, 0] == pytest.approx(0.5, abs=0.02)


def test_what_the_points_prefer_keeps_its_score(tmp_path: Path) -> None:
    """It is the cost of the estimate, which its alternatives are held against."""
    model, truth = swivel(tmp_path, -3.0, 3.0), pk.State(np.eye(4), {"turn": 0.5})
    fit = fitted(model, truth)
    wrong, finished = several(fit, model, truth)
    plain = dataclasses.replace(gathered(fit.solver.search, wrong, finished), distinct=40.0)
    better = contested(fit.solver, wrong, plain, finished, wrong.take(slice(0, 0)), pk.EstimatorOptions())
    assert better is not None
    assert better.values[0, 0] == pytest.approx(0.5, abs=0.02)
    assert better.scores == pytest.approx([0.995, 1.0, 0.995])
