"""The estimate as a named state in MoveIt's semantic description (SRDF)."""

from __future__ import annotations

from pathlib import Path

from pwralign_kin import files
from pwralign_kin.export.joints import JointValues
from pwralign_kin.model import ArticulatedModel

GROUP = "all"
STATE = "estimate"


def write_srdf(path: Path, model: ArticulatedModel, values: JointValues) -> None:
    """Write an SRDF with the group `all` of every moving joint and its state `estimate`.

    A planar joint has the value "x y theta" and a floating one "x y z qx qy qz qw", as MoveIt orders them.
    """
    from lxml import etree

    robot = etree.Element("robot", name=model.name)
    group = etree.SubElement(robot, "group", name=GROUP)
    state = etree.SubElement(robot, "group_state", name=STATE, group=GROUP)
    for name, numbers in {
        **{name: (value,) for name, value in values.single.items()},
        **values.multiple,
    }.items():
        etree.SubElement(group, "joint", name=name)
        etree.SubElement(state, "joint", name=name, value=" ".join(map(repr, numbers)))
    text = etree.tostring(robot, xml_declaration=True, encoding="utf-8", pretty_print=True)
    files.write_text(path, text.decode("utf-8"))
