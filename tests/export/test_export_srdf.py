"""The SRDF, read back by Pinocchio, and joints of several degrees of freedom."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from boxbot import BOT_VALUES
from lxml import etree
from scipy.spatial.transform import Rotation

from pwralign_kin.export.joints import joint_values
from pwralign_kin.export.srdf import write_srdf
from pwralign_kin.model import ArticulatedModel
from pwralign_kin.state import State

BOX = '<visual><geometry><box size="0.2 0.3 0.4"/></geometry></visual>'

FREE = f"""<robot name="free">
<link name="a">{BOX}</link><link name="b">{BOX}</link><link name="c">{BOX}</link>
<joint name="table" type="planar"><parent link="a"/><child link="b"/><axis xyz="0 0 1"/></joint>
<joint name="fly" type="floating"><parent link="b"/><child link="c"/></joint></robot>"""


def test_pinocchio_reads_the_group_state(
    bot: ArticulatedModel, bot_path: Path, bot_state: State, tmp_path: Path
) -> None:
    write_srdf(tmp_path / "model.srdf", bot, joint_values(bot, bot_state))
    model = pin.buildModelFromUrdf(str(bot_path))
    pin.loadReferenceConfigurations(model, str(tmp_path / "model.srdf"), False)
    q = model.referenceConfigurations["estimate"]
    for name, value in BOT_VALUES.items():
        joint = model.joints[model.getJointId(name)]
        expected = [value] if joint.nq == 1 else [np.cos(value), np.sin(value)]
        assert q[joint.idx_q : joint.idx_q + joint.nq] == pytest.approx(expected, abs=1e-15)


def test_the_group_holds_every_joint_of_its_state(bot: ArticulatedModel, bot_state: State, tmp_path: Path) -> None:
    write_srdf(tmp_path / "model.srdf", bot, joint_values(bot, bot_state))
    root = etree.parse(tmp_path / "model.srdf").getroot()
    group, state = root.find("group"), root.find("group_state")
    assert root.get("name") == "bot"
    assert state.get("group") == group.get("name")
    assert [joint.get("name") for joint in group] == [joint.get("name") for joint in state]
    assert {joint.get("name") for joint in group} == set(BOT_VALUES)


def test_planar_and_floating_joints_have_moveits_variables(
    read: Callable[[str], ArticulatedModel], tmp_path: Path
) -> None:
    model = read(FREE)
    turn = {"roll": 0.3, "pitch": -0.4, "yaw": 1.1}
    joints = {"table.x": 0.1, "table.y": -0.2, "table.yaw": 0.9, "fly.x": 1.0, "fly.y": 2.0, "fly.z": 3.0}
    values = joint_values(model, State(joints={**joints, **{f"fly.{name}": angle for name, angle in turn.items()}}))
    quaternion = Rotation.from_euler("xyz", list(turn.values())).as_quat(canonical=True)
    assert values.single == {}
    assert values.multiple["table"] == (0.1, -0.2, 0.9)
    assert values.multiple["fly"] == pytest.approx((1.0, 2.0, 3.0, *quaternion))
    write_srdf(tmp_path / "model.srdf", model, values)
    state = etree.parse(tmp_path / "model.srdf").getroot().find("group_state")
    assert [len(joint.get("value").split()) for joint in state] == [3, 7]
