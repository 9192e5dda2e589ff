"""`Description` -> normalised URDF."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

from pwralign_kin.model.description import Description, Joint, Origin, Shape

if TYPE_CHECKING:
    from lxml.etree import _Element as Element


def as_normalised_urdf(description: Description) -> str:
    """Return a normalised URDF that strict readers (urdfdom, Pinocchio, yourdfpy) accept.

    Mesh names stay as they were given; capsules, which URDF 1.0 does not know, are left out.
    """
    from lxml import etree

    robot = etree.Element("robot", name=description.name)
    for link in description.links:
        element = etree.SubElement(robot, "link", name=link.name)
        for shape in link.shapes:
            if shape.kind != "capsule":
                _write_shape(etree.SubElement(element, "visual"), shape)
    for joint in description.joints:
        _write_joint(etree.SubElement(robot, "joint", name=joint.name, type=joint.kind), joint)
    return etree.tostring(robot, encoding="unicode", pretty_print=True)


def _write_shape(element: Element, shape: Shape) -> None:
    from lxml import etree

    _write_origin(element, shape.origin)
    geometry = etree.SubElement(element, "geometry")
    if shape.kind == "mesh":
        etree.SubElement(geometry, "mesh", filename=shape.filename, scale=_text(shape.size))
    elif shape.kind == "box":
        etree.SubElement(geometry, "box", size=_text(shape.size))
    elif shape.kind == "sphere":
        etree.SubElement(geometry, "sphere", radius=repr(shape.size[0]))
    else:
        etree.SubElement(geometry, "cylinder", radius=repr(shape.size[0]), length=repr(shape.size[1]))
    if shape.rgba is not None:
        etree.SubElement(etree.SubElement(element, "material", name=""), "color", rgba=_text(shape.rgba))


def _write_joint(element: Element, joint: Joint) -> None:
    from lxml import etree

    _write_origin(element, joint.origin)
    etree.SubElement(element, "parent", link=joint.parent)
    etree.SubElement(element, "child", link=joint.child)
    if joint.kind == "fixed":
        return
    etree.SubElement(element, "axis", xyz=_text(joint.axis))
    if joint.lower is not None and joint.upper is not None:
        limits = {"lower": joint.lower, "upper": joint.upper, "effort": 0.0, "velocity": 0.0}
        etree.SubElement(element, "limit", {key: repr(value) for key, value in limits.items()})
    if joint.mimic is not None:
        factors = {"multiplier": repr(joint.mimic.multiplier), "offset": repr(joint.mimic.offset)}
        etree.SubElement(element, "mimic", {"joint": joint.mimic.joint, **factors})


def _write_origin(element: Element, origin: Origin) -> None:
    from lxml import etree

    etree.SubElement(element, "origin", xyz=_text(origin.xyz), rpy=_text(origin.rpy))


def _text(values: Iterable[float]) -> str:
    return " ".join(repr(float(value)) for value in values)
