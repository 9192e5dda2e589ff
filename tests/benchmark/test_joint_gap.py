"""Gaps are found where there are any, and exports read back by other libraries have none."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pwralign_kin import estimate, se3
from pwralign_kin.benchmark.cases import simulated_case
from pwralign_kin.benchmark.joint_gap import by_part, gaps_of_export, joint_gap, table
from pwralign_kin.estimation import EstimatorOptions
from pwralign_kin.export.joints import joint_values
from pwralign_kin.export.states import write_joint_state
from pwralign_kin.export.urdf import write_aligned_urdf
from pwralign_kin.model import ArticulatedModel
from pwralign_kin.state import State

Vector = tuple[float, float, float]


def placed(T: se3.Array, shift: Vector = (0, 0, 0), turn: Vector = (0, 0, 0)) -> se3.Array:
    return np.asarray(T @ se3.from_twist(np.array([*turn, *shift])))


def test_a_turning_joint_holds_its_origin_and_axis(twins: ArticulatedModel, truth: State) -> None:
    joint = twins.parts[1].joint
    assert joint is not None
    parent = truth.T_scan_base
    child = parent @ joint.T_parent_joint
    assert joint_gap(joint, parent, placed(child, turn=(0, 0.8, 0)), 1.0) < 1e-12
    assert joint_gap(joint, parent, placed(child, shift=(0, 1e-3, 0)), 1.0) == pytest.approx(1e-3)
    assert joint_gap(joint, parent, placed(child, turn=(1e-3, 0, 0)), 2.0) == pytest.approx(2e-3, rel=1e-3)


def test_a_slide_holds_its_line_and_orientation(twins: ArticulatedModel, truth: State) -> None:
    joint = twins.parts[4].joint
    assert joint is not None
    parent = truth.T_scan_base
    child = parent @ joint.T_parent_joint
    assert joint_gap(joint, parent, placed(child, shift=(0, 0, 0.2)), 1.0) < 1e-12
    assert joint_gap(joint, parent, placed(child, shift=(1e-3, 0, 0.2)), 1.0) == pytest.approx(1e-3)
    assert joint_gap(joint, parent, placed(child, turn=(0, 0, 1e-3)), 2.0) == pytest.approx(2e-3, rel=1e-3)


def test_an_export_has_no_gap_and_a_tampered_one_has(twins: ArticulatedModel, tmp_path: Path) -> None:
    case = simulated_case(twins, "twins", "sparse", 0)
    result = estimate(twins, case.scan, options=EstimatorOptions(threads=1))
    write_aligned_urdf(tmp_path / "aligned.urdf", twins, result.state, tmp_path)
    write_joint_state(tmp_path / "joint_state.yaml", joint_values(twins, result.state))
    gaps = gaps_of_export(case, twins, result, tmp_path)
    assert max(gaps.metres) < 1e-9
    assert "| twins | sparse | 4 |" in table([gaps])

    plate = result.parts["plate"]
    torn = replace(plate, T_scan_part=placed(plate.T_scan_part, shift=(1e-4, 0, 0)))
    gaps = gaps_of_export(case, twins, replace(result, parts={**result.parts, "plate": torn}), tmp_path)
    assert gaps.parts == pytest.approx(1e-4, rel=1e-3)
    assert gaps.pinocchio_offset == pytest.approx(1e-4, rel=1e-3)
    assert gaps.pinocchio < 1e-9 and gaps.yourdfpy < 1e-9


def test_a_part_named_after_a_root_world_is_told_by_its_other_links(tmp_path: Path) -> None:
    box = '<visual><geometry><box size="0.3 0.2 0.1"/></geometry></visual>'
    (tmp_path / "arm.urdf").write_text(
        f"""<robot name="arm"><link name="world"/><link name="base">{box}</link><link name="arm">{box}</link>
        <joint name="stand" type="fixed"><parent link="world"/><child link="base"/><origin xyz="0 0 1"/></joint>
        <joint name="turn" type="continuous"><parent link="base"/><child link="arm"/>
        <origin xyz="0 0 0.2"/><axis xyz="0 0 1"/></joint></robot>"""
    )
    model = ArticulatedModel.from_urdf(tmp_path / "arm.urdf")
    T_scan_base = placed(np.eye(4), shift=(1, 2, 3))
    links = {name: T_scan_base @ T for name, T in model.link_placements(np.array([0.4])).items()}
    links["world"] = np.eye(4)
    parts = by_part(model, links)
    expected = T_scan_base @ model.part_placements(np.array([0.4]))
    np.testing.assert_allclose([parts[part.name] for part in model.parts], expected, atol=1e-12)
