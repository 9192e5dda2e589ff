"""Honest doubt, measured: ranks, bins, standard deviations, and joints that look right when turned."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from pwralign_kin.benchmark.calibration import (
    auroc,
    calibration_error,
    coefficients_table,
    confidence_table,
    doubt_table,
    filled,
    reliability,
    reliability_diagram,
    reliability_table,
)
from pwralign_kin.benchmark.evidence import JointDoubt, joint_doubts
from pwralign_kin.benchmark.metrics import Ruler, Score
from pwralign_kin.benchmark.runs import Outcome
from pwralign_kin.estimation import Estimate
from pwralign_kin.estimation.evidence import confidence
from pwralign_kin.estimation.evidence.evidence import Evidence, logistic
from pwralign_kin.model import ArticulatedModel
from pwralign_kin.state import State

ROD = """<?xml version="1.0"?>
<robot name="rod">
  <link name="body"><visual><geometry><box size="0.5 0.3 0.1"/></geometry></visual></link>
  <link name="rod">
    <visual><origin xyz="0 0 0.25"/><geometry><box size="0.2 0.2 0.4"/></geometry></visual>
  </link>
  <joint name="twist" type="continuous">
    <origin xyz="0.1 0 0.05"/><parent link="body"/><child link="rod"/><axis xyz="0 0 1"/>
  </joint>
</robot>
"""


def outcome(confidence: float, right: bool, joints: tuple[JointDoubt, ...] = ()) -> Outcome:
    score = Score(right, right, right, {"part": 0.0}, {})
    return Outcome("robot", "full", 0, "default", score, (), (), confidence, {}, joints, 1.0, "")


def cells(table: str, row: str) -> list[str]:
    (line,) = [line for line in table.splitlines() if line.startswith(f"| {row} |")]
    return [cell.strip() for cell in line.strip("|").split("|")]


def test_auroc_is_the_chance_that_right_ranks_above_wrong() -> None:
    assert auroc([0.9, 0.8, 0.1], [True, True, False]) == 1.0
    assert auroc([0.1, 0.9], [True, False]) == 0.0
    assert auroc([0.5, 0.5], [True, False]) == 0.5
    assert auroc([0.9, 0.5, 0.5, 0.1], [True, False, True, False]) == pytest.approx(3.5 / 4)
    assert np.isnan(auroc([0.9], [True]))


def test_reliability_compares_confidence_with_the_share_that_is_right() -> None:
    outcomes = [outcome(1.0, True), outcome(0.92, False), outcome(0.15, False), outcome(0.0, False)]
    bins = reliability(outcomes)
    assert bins[9] == (pytest.approx(0.96), [True, False])
    assert bins[1] == (pytest.approx(0.15), [False])
    assert calibration_error(outcomes) == pytest.approx((2 * 0.46 + 0.15) / 4)
    groups = {"all": outcomes}
    assert cells(reliability_table(groups), "0.9 to 1.0")[1:] == ["0.96", "50% (1/2)"]
    assert cells(confidence_table(groups), "all")[1:7] == ["4", "25% (1/4)", "1.000", "2", "50% (1/2)", "2"]
    assert reliability_diagram(groups).startswith(b"\x89PNG")


def test_doubt_counts_the_joints_of_successes() -> None:
    joints = (
        JointDoubt("a", 0.15, 0.1, True, True),
        JointDoubt("b", 0.25, 0.1, True, False),
        JointDoubt("c", 3.0, float("inf"), False, True),
    )
    row = cells(doubt_table({"all": [outcome(1.0, True, joints), outcome(1.0, False, joints)]}), "all")
    assert row[1:] == ["2", "0% (0/2)", "50% (1/2)", "100% (2/2)", "100% (1/1)", "2", "50% (1/2)"]


def test_a_square_rod_turned_by_a_right_angle_is_right(tmp_path: Path) -> None:
    (tmp_path / "rod.urdf").write_text(ROD)
    ruler = Ruler(ArticulatedModel.from_urdf(tmp_path / "rod.urdf"))
    reference = ruler.reference(State(np.eye(4), {"twist": 0.2}), np.repeat([0, 1], 100))

    def doubt(value: float) -> JointDoubt:
        found = SimpleNamespace(state=State(np.eye(4), {"twist": value}), std={"twist": 0.01}, undetermined=())
        (joint,) = joint_doubts(ruler, reference, cast(Estimate, found))
        return joint

    assert doubt(0.23).error == pytest.approx(0.03)
    assert doubt(0.23 + np.pi / 2).error == pytest.approx(0.03, abs=0.003)
    assert doubt(0.2 + np.pi / 4).error > 0.5
    assert doubt(0.2).told and doubt(0.2).determined


def test_coefficients_are_found_again_from_answers_that_are_as_often_right_as_they_say() -> None:
    random = np.random.default_rng(0)

    def drawn(present: bool) -> Outcome:
        found = Evidence(
            nearby=random.uniform(0.0, 0.05), lacking=random.uniform(0.0, 0.6), uneven=random.uniform(1.0, 3.0),
            margin=0.0, distinct=random.uniform(-4.0, 12.0), told=random.uniform(-4.0, 12.0),
            ahead=random.uniform(0.0, 0.3), noise=0.002, borne_out=0.5,
            shown=random.uniform(0.5, 0.7) if present else random.uniform(0.02, 0.3),
            in_sight=random.uniform(0.7, 0.9) if present else random.uniform(0.2, 0.5),
            agreed=0.95, explained=1.0 if present else 0.5,
            strange=0.0, astray=0.0 if present else random.uniform(0.0, 0.5), refuted=0.0, continued=0.0,
            points_per_part=random.uniform(1.0, 30.0), size=1.0, size_gain=0.0, mirrored=0.0,
        )  # fmt: skip
        right = present and random.random() < logistic(confidence.RIGHT, confidence.features(found))
        return dataclasses.replace(outcome(0.5, right), evidence=dataclasses.asdict(found))

    table = coefficients_table([drawn(True) for _ in range(4000)], [drawn(False) for _ in range(1000)])
    rows = [row.strip("| ").split(" | ") for row in table.splitlines()[2:] if row.startswith("| ")]
    assert len(rows) == len(confidence.PRESENT) + len(confidence.RIGHT)
    for name, fitted, used in rows[len(confidence.PRESENT) :]:
        assert float(fitted) == pytest.approx(float(used), rel=0.35, abs=0.1), name


def test_bins_of_few_answers_are_drawn_together() -> None:
    bins = [(0.1, [True] * 3), (0.2, [False] * 9), (float("nan"), []), (0.5, [True] * 10), (0.9, [True, False])]
    drawn = filled(bins)
    assert [len(right) for _, right in drawn] == [12, 12]
    assert [mean for mean, _ in drawn] == pytest.approx([(3 * 0.1 + 9 * 0.2) / 12, (10 * 0.5 + 2 * 0.9) / 12])
    assert sum(drawn[0][1]) == 3
    assert filled([(0.4, [True])]) == [(0.4, [True])]
