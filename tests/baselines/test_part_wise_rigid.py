"""The part-wise rigid baseline finds what it can, and its open joints are measured."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pwralign_kin import se3
from pwralign_kin.baselines.part_wise_rigid import openings, part_wise_rigid
from pwralign_kin.exceptions import ScanError
from pwralign_kin.model import ArticulatedModel
from pwralign_kin.scan import Scan
from pwralign_kin.simulation import Sensor, simulate
from pwralign_kin.state import State

ARM = """<?xml version="1.0"?>
<robot name="arm">
  <link name="body">
    <visual><geometry><box size="0.5 0.3 0.1"/></geometry></visual>
    <visual><origin xyz="0.2 0.1 0.1"/><geometry><box size="0.1 0.1 0.15"/></geometry></visual>
  </link>
  <link name="arm">
    <visual><origin xyz="0 0 -0.2"/><geometry><box size="0.08 0.03 0.4"/></geometry></visual>
    <visual><origin xyz="0.09 0 -0.4"/><geometry><box size="0.26 0.05 0.1"/></geometry></visual>
    <visual><origin xyz="-0.1 0 -0.2"/><geometry><cylinder radius="0.04" length="0.15"/></geometry></visual>
    <visual><origin xyz="0.1 0.05 -0.15"/><geometry><box size="0.15 0.15 0.06"/></geometry></visual>
  </link>
  <link name="slider"><visual><geometry><sphere radius="0.06"/></geometry></visual></link>
  <joint name="swing" type="revolute">
    <origin xyz="0 0.17 0"/><parent link="body"/><child link="arm"/><axis xyz="0 1 0"/>
    <limit lower="-1.5" upper="1.5" effort="1" velocity="1"/>
  </joint>
  <joint name="slide" type="prismatic">
    <origin xyz="-0.1 0 0.12"/><parent link="body"/><child link="slider"/><axis xyz="1 0 0"/>
    <limit lower="-0.1" upper="0.1" effort="1" velocity="1"/>
  </joint>
</robot>
"""

TRUTH = State(se3.from_quaternion(np.array([0.4, -1.2, 2.0]), np.array([0.3, -0.5, 0.2, 0.7])), {"swing": 0.3})


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> ArticulatedModel:
    path = tmp_path_factory.mktemp("arm") / "arm.urdf"
    path.write_text(ARM)
    return ArticulatedModel.from_urdf(path)


@pytest.fixture(scope="module")
def scan(arm: ArticulatedModel) -> Scan:
    return simulate(arm, TRUTH, Sensor(points=4000)).scan


def placements(model: ArticulatedModel, state: State) -> se3.Array:
    return np.asarray(model.root_placement(state) @ model.part_placements(model.values(state.joints)))


def test_parts_are_found_from_the_shape_at_zero(arm: ArticulatedModel, scan: Scan) -> None:
    """The arm is turned by 17 degrees from where the whole body's fit leaves it."""
    found = part_wise_rigid(arm, scan)
    offset = found.T_scan_parts[:2, :3, 3] - placements(arm, TRUTH)[:2, :3, 3]
    assert np.linalg.norm(offset, axis=1).max() < 0.02 * arm.diagonal
    assert "arm" not in found.skipped


def test_a_guess_is_where_it_starts(arm: ArticulatedModel, scan: Scan) -> None:
    found = part_wise_rigid(arm, scan, TRUTH)
    offset = found.T_scan_parts - placements(arm, TRUTH)
    assert np.abs(offset[:2]).max() < 0.03  # the third part is a ball
    assert set(found.openings) == {"swing", "slide"}


def test_the_same_scan_gives_the_same_placements(arm: ArticulatedModel, scan: Scan) -> None:
    first, again = (part_wise_rigid(arm, scan) for _ in range(2))
    assert np.array_equal(first.T_scan_parts, again.T_scan_parts)


def test_openings_are_measured_at_the_joints(arm: ArticulatedModel) -> None:
    closed = placements(arm, State(TRUTH.T_scan_base, {"swing": 0.9, "slide": 0.05}))
    assert all(opening.gap < 1e-12 and opening.tilt < 1e-7 for opening in openings(arm, closed).values())
    torn = closed.copy()
    names = [part.name for part in arm.parts]
    torn[names.index("arm"), :3, 3] += [0.0, 0.03, 0.04]
    tilted = np.eye(4)
    tilted[:3, :3] = se3.rotation_about(np.array([1.0, 0.0, 0.0]), 0.2)
    torn[names.index("arm")] = torn[names.index("arm")] @ tilted
    torn[names.index("slider")] = torn[names.index("slider")] @ se3.from_twist(np.array([0, 0, 0, 0.07, 0.02, 0]))
    opened = openings(arm, torn)
    assert opened["swing"].gap == pytest.approx(0.05) and opened["swing"].tilt == pytest.approx(0.2)
    assert opened["slide"].gap == pytest.approx(0.02)  # along the slide nothing opens


def test_joints_without_geometry_between_them_are_one_junction(tmp_path: Path) -> None:
    """A shoulder of two axes through one point, and an elbow whose axes are apart."""
    link = '<link name="{}"><visual><geometry><box size="0.2 0.1 0.1"/></geometry></visual></link>'
    joint = (
        '<joint name="{}" type="continuous"><origin xyz="{}"/><parent link="{}"/><child link="{}"/>'
        '<axis xyz="{}"/></joint>'
    )
    pieces = [
        *(link.format(name) for name in ("body", "upper", "lower")),
        '<link name="twist"/><link name="bend"/>',
        joint.format("j1", "0.2 0 0", "body", "twist", "1 0 0"),
        joint.format("j2", "0 0 0", "twist", "upper", "0 0 1"),
        joint.format("j3", "0.2 0 0", "upper", "bend", "0 1 0"),
        joint.format("j4", "0.1 0 0", "bend", "lower", "0 0 1"),
    ]
    (tmp_path / "limb.urdf").write_text(f'<robot name="limb">{"".join(pieces)}</robot>')
    limb = ArticulatedModel.from_urdf(tmp_path / "limb.urdf")
    placed = placements(limb, State(TRUTH.T_scan_base, {"j1": 0.4, "j2": 1.1, "j3": 0.3, "j4": -0.6}))
    assert set(openings(limb, placed)) == {"j2"}
    assert openings(limb, placed)["j2"].gap < 1e-12
    placed[[part.name for part in limb.parts].index("upper"), :3, 3] += [0.0, 0.03, 0.04]
    assert openings(limb, placed)["j2"].gap == pytest.approx(0.05)


def test_a_scan_that_holds_nothing_is_refused(arm: ArticulatedModel) -> None:
    with pytest.raises(ScanError):
        part_wise_rigid(arm, Scan(np.random.default_rng(0).normal(size=(15, 3))))
