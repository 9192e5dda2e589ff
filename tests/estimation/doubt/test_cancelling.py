"""Telescopes: where a sleeve is between two slides that cancel."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import pwralign_kin as pk
from pwralign_kin.estimation.doubt.cancelling import cancelling
from pwralign_kin.se3 import Array
from pwralign_kin.simulation import FULL, TIERS

SLEEVE = """
<link name="sleeve{number}">
  <visual><origin xyz="0 0 0.2"/><geometry><cylinder radius="{radius}" length="0.4"/></geometry></visual>
</link>
<joint name="slide{number}" type="prismatic">
  <parent link="{parent}"/><child link="sleeve{number}"/><origin xyz="0 0 0.02"/><axis xyz="{axis}"/>
  <limit lower="0" upper="0.34" effort="1" velocity="1"/>
</joint>
"""
ENDS = """
<link name="foot">
  <visual><origin xyz="0 0 0.02"/><geometry><box size="0.3 0.24 0.04"/></geometry></visual>
  <visual><origin xyz="0 0 0.24"/><geometry><cylinder radius="0.06" length="0.4"/></geometry></visual>
</link>
<link name="tool">
  <visual><origin xyz="0.08 0 0.03"/><geometry><box size="0.26 0.1 0.06"/></geometry></visual>
</link>
<joint name="weld" type="fixed"><parent link="sleeve1"/><child link="tool"/><origin xyz="0 0 0.4"/></joint>
"""


def telescope(folder: Path, wall: float, second_axis: str = "0 0 1") -> pk.ArticulatedModel:
    """Two sleeves in a foot, each thinner by `wall` (m) than the last; a tool on the thinner."""
    sleeves = [
        SLEEVE.format(number=0, radius=0.06 - wall, parent="foot", axis="0 0 1"),
        SLEEVE.format(number=1, radius=0.06 - 2 * wall, parent="sleeve0", axis=second_axis),
    ]
    urdf = folder / "telescope.urdf"
    urdf.write_text(f'<robot name="telescope">{ENDS}{"".join(sleeves)}</robot>')
    return pk.ArticulatedModel.from_urdf(urdf)


def twists(model: pk.ArticulatedModel) -> Array:
    placements, J = model.part_placements_and_twists(np.full(2, 0.1))
    return np.concatenate([np.tile(np.eye(6), (len(placements), 1, 1)), J], axis=2)


def test_parallel_slides_cancel_but_for_what_is_between(tmp_path: Path) -> None:
    model = telescope(tmp_path, 0.004)
    (pair,) = cancelling(twists(model), np.ones(3, bool), np.ones(2, bool))
    assert [model.joint_names[pair.inner], model.joint_names[pair.outer]] == ["slide0", "slide1"]
    assert [model.parts[part].name for part in pair.between] == ["sleeve0"]
    assert pair.ratio == pytest.approx(-1.0)
    before, after = (model.part_placements(np.full(2, 0.1) + move * pair.direction(2)[6:]) for move in (0.0, 0.05))
    assert np.abs(after - before).max(axis=(1, 2)) == pytest.approx([0.0, 0.05, 0.0], abs=1e-12)


def test_other_slides_do_not_cancel(tmp_path: Path) -> None:
    model = telescope(tmp_path, 0.004, second_axis="0 0.1 1")
    assert cancelling(twists(model), np.ones(3, bool), np.ones(2, bool)) == []
    model = telescope(tmp_path, 0.004)
    assert cancelling(twists(model), np.ones(3, bool), np.array([True, False])) == []
    assert cancelling(twists(model), np.array([True, False, True]), np.ones(2, bool)) == []


@pytest.mark.parametrize(("tier", "seed"), [("full", 1), ("full", 2), ("full", 5), ("single", 2), ("single", 4)])
def test_a_sleeve_is_found_where_its_ends_are(tmp_path: Path, tier: str, seed: int) -> None:
    model = telescope(tmp_path, 0.006)
    made = pk.simulate(model, sensor=TIERS[tier], seed=seed)
    estimate = pk.estimate(model, made.scan)
    for name in model.joint_names:
        off = abs(estimate.state.joints[name] - made.state.joints[name])
        assert off < 0.02 * model.diagonal, name
        assert off < 3.0 * estimate.std[name], name
    # Where one slide goes the other goes back.
    one, other = 6, 7
    assert estimate.covariance[one, other] < -0.5 * estimate.covariance[one, one]


def test_noise_hides_the_ends_of_thin_sleeves(tmp_path: Path) -> None:
    model = telescope(tmp_path, 0.001)
    estimate = pk.estimate(model, pk.simulate(model, sensor=replace(FULL, points=2000, noise=0.01), seed=1).scan)
    assert estimate.undetermined == ("slide0", "slide1")


@pytest.mark.parametrize("slide", [0.0, 0.34])
def test_a_telescope_at_its_end_has_nothing_to_share_out(tmp_path: Path, slide: float) -> None:
    model = telescope(tmp_path, 0.006)
    state = pk.State(np.eye(4), dict.fromkeys(model.joint_names, slide))
    made = pk.simulate(model, state=state, sensor=TIERS["single"], seed=2)
    values = pk.estimate(model, made.scan).state.joints
    assert list(values.values()) == pytest.approx([slide, slide], abs=0.02 * model.diagonal)
