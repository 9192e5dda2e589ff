"""Joint values that two placed parts take: those that placed them, and none where no value does."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import pwralign_kin as pk
from pwralign_kin import se3
from pwralign_kin.estimation.search.joint_closing import BEYOND, OPEN_SLIDE, OPEN_TURN, JointClosing, chains_between

LINK = '<link name="{name}"><visual><geometry><box size="0.3 0.2 0.1"/></geometry></visual></link>'
JOINT = """
  <joint name="{name}" type="{kind}">
    <parent link="{parent}"/><child link="{child}"/><origin xyz="0.3 0.1 0" rpy="0.3 -0.2 0.5"/><axis xyz="{axis}"/>
    <limit lower="-1.2" upper="0.9" effort="1" velocity="1"/>{mimic}
  </joint>"""
BENT = (
    '<robot name="bent">'
    + "".join(LINK.format(name=name) for name in ("body", "arm", "rail", "follower"))
    + '<link name="cross"/>'
    + JOINT.format(name="pan", kind="revolute", parent="body", child="cross", axis="0 0.6 0.8", mimic="")
    + JOINT.format(name="tilt", kind="continuous", parent="cross", child="arm", axis="1 0 0", mimic="")
    + JOINT.format(name="slide", kind="prismatic", parent="body", child="rail", axis="0 0.8 0.6", mimic="")
    + JOINT.format(
        name="follow", kind="revolute", parent="rail", child="follower", axis="0 0 1",
        mimic='<mimic joint="pan" multiplier="-0.5" offset="0.2"/>',
    )
    + "</robot>"
)  # fmt: skip
"""Two turns with no surface between them, a slide, and a turn that follows another."""


@pytest.fixture(scope="module")
def bent(tmp_path_factory: pytest.TempPathFactory) -> pk.ArticulatedModel:
    path: Path = tmp_path_factory.mktemp("bent") / "bent.urdf"
    path.write_text(BENT)
    return pk.ArticulatedModel.from_urdf(path)


def test_chains_close_at_the_values_that_placed_their_parts(bent: pk.ArticulatedModel) -> None:
    native, random = bent.kernel_model, np.random.default_rng(0)
    values = random.uniform(*native.limits, (20, len(bent.joint_names)))
    placements = native.forward(np.tile(np.eye(4), (20, 1, 1)), values)
    chains = chains_between(bent)
    assert [chain.held for chain in chains] == [(1, 2), (3,), (4,)]
    for chain in chains:
        above, below = (np.ascontiguousarray(placements[:, part]) for part in (chain.above, chain.below))
        found, fits = JointClosing(bent, native).values(chain, above, below)
        assert fits.shape == (20, 20)
        assert fits.diagonal().all()
        np.testing.assert_allclose(found[range(20), range(20)], values[:, chain.actuated], atol=1e-7)


@pytest.mark.parametrize("much", [0.5, 2.0])
def test_chains_do_not_close_where_parts_are_turned_or_moved_too_far(bent: pk.ArticulatedModel, much: float) -> None:
    native = bent.kernel_model
    at = native.forward(np.eye(4)[None], np.zeros((1, len(bent.joint_names))))[0]
    for chain in chains_between(bent):
        axis = chain.joints[-1].axis
        across = np.cross(axis, [0.36, 0.48, 0.8])
        across /= np.linalg.norm(across)
        turn, move = np.eye(4), np.eye(4)
        turn[:3, :3] = se3.rotation_about(across, much * OPEN_TURN)
        move[:3, 3] = much * OPEN_SLIDE * across
        below = at[chain.below] @ np.array([turn, move])
        _, fits = JointClosing(bent, native).values(chain, at[[chain.above]], below)
        # Two turns take up some of what one alone does not.
        assert fits[0, 1] == (much < 1.0)
        assert fits[0, 0] == (much < 1.0) or len(chain.joints) == 2


def test_chains_close_little_beyond_their_limits_and_are_held_there(bent: pk.ArticulatedModel) -> None:
    native, slide = bent.kernel_model, bent.joint_names.index("slide")
    chain = next(chain for chain in chains_between(bent) if chain.actuated == [slide])
    upper = native.limits[1][slide]
    values = np.zeros((2, len(bent.joint_names)))
    values[:, slide] = upper + BEYOND * np.array([0.5, 2.0])
    placements = native.forward(np.tile(np.eye(4), (2, 1, 1)), values)
    below = np.ascontiguousarray(placements[:, chain.below])
    found, fits = JointClosing(bent, native).values(chain, placements[:1, chain.above], below)
    assert fits.tolist() == [[True, False]]
    np.testing.assert_allclose(found[0, :, 0], upper)
