"""The URDF as its author wrote it."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pwralign_kin.model import ArticulatedModel

if TYPE_CHECKING:
    from lxml.etree import _Element as Element


def source_tree(model: ArticulatedModel) -> Element:
    """Return the root element of the model's URDF with its comments; for a xacro, of what it expands to."""
    from lxml import etree

    # Undeclared prefixes were forgiven when the model was read, and nothing else was.
    parser = etree.XMLParser(resolve_entities=False, no_network=True, load_dtd=False, strip_cdata=False, recover=True)
    return etree.fromstring(model.source, parser)


def joint_types(model: ArticulatedModel) -> dict[str, str]:
    """Return the type of every joint of the URDF by name, as written there."""
    return {str(joint.get("name")): str(joint.get("type")) for joint in source_tree(model).iterfind("joint")}


def end_link(joint: Element, tag: str) -> str:
    """Return the name of the joint's link at the end `tag`: "parent" or "child"."""
    element = joint.find(tag)
    return "" if element is None else element.get("link", "")
