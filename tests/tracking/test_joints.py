"""Which joints move which."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import pwralign_kin as pk
from pwralign_kin.tracking.joints import Joints


def test_chains_are_the_joints_above_the_last_ones(arm: pk.ArticulatedModel) -> None:
    joints = Joints.of(arm, ())
    assert [chain.tolist() for chain in joints.chains(np.array([True, True]))] == [[True, True]]
    assert [chain.tolist() for chain in joints.chains(np.array([True, False]))] == [[True, False]]
    assert joints.moves.tolist() == [[True, True], [False, True]]


def test_joints_that_move_one_another_are_one_chain(tmp_path: Path) -> None:
    """The hand mimics the shoulder, whose parts the elbow carries; the finger, named first, hangs on the shoulder."""

    def joint(name: str, parent: str, child: str, more: str = "") -> str:
        return (
            f'<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/>'
            f'<origin xyz="0 0 0.3"/><axis xyz="1 0 0"/><limit lower="-1" upper="1" effort="1" velocity="1"/>'
            f"{more}</joint>"
        )

    links = "".join(
        f'<link name="{name}"><visual><geometry><box size="0.1 0.1 0.3"/></geometry></visual></link>'
        for name in "abcde"
    )
    joints_of_tree = (
        joint("shoulder", "a", "b")
        + joint("finger", "b", "c")
        + joint("elbow", "b", "d")
        + joint("hand", "d", "e", '<mimic joint="shoulder"/>')
    )
    (tmp_path / "loop.urdf").write_text(f'<robot name="loop">{links}{joints_of_tree}</robot>')
    model = pk.ArticulatedModel.from_urdf(tmp_path / "loop.urdf")
    joints, names = Joints.of(model, ()), np.array(model.joint_names)

    def chains(*among: str) -> list[set[str]]:
        return [set(names[chain]) for chain in joints.chains(np.isin(names, among))]

    assert chains("shoulder", "elbow") == [{"shoulder", "elbow"}]
    assert chains("shoulder", "elbow", "finger") == [{"shoulder", "elbow", "finger"}]
    assert chains("elbow") == [{"elbow"}]
    assert joints.moves[names == "elbow"][:, names == "finger"].all()
