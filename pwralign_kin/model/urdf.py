"""URDF -> `Description`: read, check and mend.

What is merely sloppy is mended with a warning; what has no sane reading is a fault, and all faults are
reported at once in one `ModelError`. After reading, every joint is fixed, revolute, continuous or prismatic:
planar and floating joints have become chains of such joints over virtual links, and every mimic names an
actuated joint.
"""

from __future__ import annotations

import dataclasses
import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Literal

import numpy as np

from pwralign_kin import se3
from pwralign_kin.exceptions import ModelError
from pwralign_kin.model.description import Color, Description, Joint, Link, Mimic, Origin, Shape, Triple, triple
from pwralign_kin.model.joint_chains import floating_chain, planar_chain, virtual_link
from pwralign_kin.model.packages import NO_FOLDERS, PackageFolders
from pwralign_kin.model.urdf_source import parse_xml, read_source, well_declared

if TYPE_CHECKING:
    from lxml.etree import _Element as Element

GeometryKind = Literal["visual", "collision"]

NO_ARGUMENTS: Mapping[str, str] = MappingProxyType({})

JOINT_TYPES = ("revolute", "continuous", "prismatic", "fixed", "planar", "floating")

LARGEST_NUMBER = 1e9
"""No length, angle or factor of a real model is larger; limits beyond it mean "unlimited"."""


def read_urdf(
    path: Path,
    packages: PackageFolders = NO_FOLDERS,
    geometry: GeometryKind = "visual",
    xacro_args: Mapping[str, str] = NO_ARGUMENTS,
) -> Description:
    """Read the URDF (or the xacro, with `xacro_args`) at `path` with its `geometry`.

    Where the whole URDF has no geometry of that kind, the other kind serves, with a warning. A single link
    that lacks the kind in use has no surface: collision hulls, often padded or crude, would put surface where
    none is. Raises `ModelError` with every fault found, `DependencyError` for a xacro without the xacro
    extra.
    """
    written = read_source(path, packages, xacro_args)
    source = well_declared(written)
    description = _Reader(geometry).read(parse_xml(source, path), path)
    mended = () if source == written else ("its XML declaration is malformed: read as XML 1.0",)
    return dataclasses.replace(description, source=source, warnings=(*mended, *description.warnings))


class _Reader:
    """Collects faults and warnings while reading one URDF."""

    def __init__(self, geometry: GeometryKind) -> None:
        self.geometry = geometry
        self.faults: list[str] = []
        self.warnings: list[str] = []
        self.without_limits: list[str] = []
        self.materials: dict[str, Color] = {}

    def read(self, robot: Element, path: Path) -> Description:
        """Return the description; raises `ModelError` with every fault."""
        name = robot.get("name", "").strip()
        if not name:
            name = path.name.split(".")[0] or "robot"
            self.warnings.append(f"the robot has no name: taken as {name!r}")
        if any("xacro" in str(element.tag) for element in robot.iter()):
            raise ModelError(path, "holds xacro elements under another prefix than xacro: it cannot be expanded")
        self._choose_geometry(robot)
        for material in robot.iterfind(".//material"):
            color = self._color(material)
            if color is not None and material.get("name"):
                self.materials.setdefault(material.get("name", ""), color)
        links = [self._link(element) for element in robot.iterfind("link")]
        joints: list[Joint] = []
        for element in robot.iterfind("joint"):
            chain = self._joint(element)
            joints += chain
            links += [Link(joint.child) for joint in chain if joint.free and joint.child == virtual_link(joint.name)]
        self._check_names("link", [link.name for link in links])
        self._check_names("joint", [joint.name for joint in joints])
        root = self._check_tree([link.name for link in links], joints)
        joints = self._resolve_mimics(joints)
        if self.without_limits:
            self.warnings.append(f"no limits, taken as -pi..pi: {', '.join(map(repr, self.without_limits))}")
        if self.faults or root is None:
            raise ModelError(path, self.faults)
        return Description(name, tuple(links), tuple(joints), root, tuple(self.warnings))

    def _choose_geometry(self, robot: Element) -> None:
        other: GeometryKind = "collision" if self.geometry == "visual" else "visual"
        present = {kind: robot.find(f"link/{kind}/geometry/*") is not None for kind in (self.geometry, other)}
        if not present[self.geometry] and present[other]:
            self.warnings.append(f"no link has {self.geometry} geometry: {other} geometry is used")
            self.geometry = other

    def _numbers(
        self, element: Element, attribute: str, count: int, where: str, default: Sequence[float] | None = None
    ) -> tuple[float, ...]:
        """`count` finite numbers; where they are absent `default`, without one a fault and zeros."""
        text = element.get(attribute)
        if text is None:
            if default is None:
                self.faults.append(f"{where}: <{element.tag}> lacks {attribute}")
            return tuple(default or [0.0] * count)
        values = _floats(text)
        if values is None or len(values) != count or not all(abs(value) <= LARGEST_NUMBER for value in values):
            wanted = "a finite number" if count == 1 else f"{count} finite numbers"
            remedy = ": it is an expression of xacro, give the file the suffix .xacro" if "$" in text else ""
            self.faults.append(f"{where}: {attribute}={text!r} of <{element.tag}> is not {wanted}{remedy}")
            return (0.0,) * count
        return values

    def _origin(self, parent: Element, where: str) -> Origin:
        element = parent.find("origin")
        if element is None:
            return Origin()
        xyz = self._numbers(element, "xyz", 3, where, (0.0, 0.0, 0.0))
        if element.get("quat_xyzw") is None:
            rpy = self._numbers(element, "rpy", 3, where, (0.0, 0.0, 0.0))
        else:
            quaternion = self._numbers(element, "quat_xyzw", 4, where)
            if math.hypot(*quaternion) < 1e-9:
                self.faults.append(f"{where}: quat_xyzw of <origin> is zero")
                quaternion = (0.0, 0.0, 0.0, 1.0)
            rpy = se3.roll_pitch_yaw(se3.from_quaternion(np.zeros(3), np.array(quaternion)))
        return Origin(triple(xyz), triple(rpy))

    # ---- links

    def _link(self, element: Element) -> Link:
        name = element.get("name", "")
        return Link(name, tuple(self._shapes(element.iterfind(self.geometry), f"link {name!r}")))

    def _shapes(self, elements: Iterable[Element], where: str) -> Iterator[Shape]:
        for element in elements:
            form = element.find("geometry/*")
            if form is None:
                self.warnings.append(f"{where}: a <{element.tag}> without geometry is left out")
                continue
            shape = self._mesh(form, where) if form.tag == "mesh" else self._primitive(form, where)
            if shape is not None:
                material = element.find("material")
                rgba = None if material is None else self._color(material)
                if material is not None and rgba is None:
                    rgba = self.materials.get(material.get("name", ""))
                yield dataclasses.replace(shape, origin=self._origin(element, where), rgba=rgba)

    def _primitive(self, form: Element, where: str) -> Shape | None:
        kind = str(form.tag)
        round_ = (("radius", 1), ("length", 1))
        attributes = {"box": (("size", 3),), "sphere": round_[:1], "cylinder": round_, "capsule": round_}
        if kind not in attributes:
            valid = ", ".join((*attributes, "mesh"))
            self.faults.append(f"{where}: unknown geometry <{kind}>; valid: {valid}")
            return None
        size = tuple(
            value for attribute, count in attributes[kind] for value in self._numbers(form, attribute, count, where)
        )
        if min(size) < 0.0:
            self.faults.append(f"{where}: <{kind}> has a negative size")
        if sum(value > 0.0 for value in size) < (2 if kind == "box" else len(size)):
            self.warnings.append(f"{where}: a <{kind}> without extent is left out")
            return None
        return Shape(kind, size)

    def _mesh(self, form: Element, where: str) -> Shape | None:
        filename = form.get("filename", "").strip()
        if not filename:
            self.faults.append(f"{where}: a <mesh> without filename")
            return None
        words = form.get("scale", "").replace(",", " ").split()
        if not words:
            return Shape("mesh", (1.0, 1.0, 1.0), filename)
        scale = self._numbers(form, "scale", 1 if len(words) == 1 else 3, where)
        if 0.0 in scale:
            self.faults.append(f"{where}: mesh {filename!r} has a scale of zero")
        return Shape("mesh", triple(scale * 3 if len(scale) == 1 else scale), filename)

    def _color(self, material: Element) -> Color | None:
        """The colour that the element itself gives; a malformed one tints nothing and is no fault."""
        element = material.find("color")
        values = None if element is None else _floats(element.get("rgba", ""))
        if values is None or len(values) not in (3, 4) or not all(map(math.isfinite, values)):
            return None
        red, green, blue, alpha = (min(max(value, 0.0), 1.0) for value in (*values, 1.0)[:4])
        return (red, green, blue, alpha)

    # ---- joints

    def _joint(self, element: Element) -> list[Joint]:
        """The joint, or the chain that a planar or floating one becomes."""
        name, kind = element.get("name", ""), element.get("type", "")
        where = f"joint {name!r}"
        ends = []
        for tag in ("parent", "child"):
            end = element.find(tag)
            ends.append("" if end is None else end.get("link", ""))
            if not ends[-1]:
                self.faults.append(f"{where}: names no {tag} link")
        joint = Joint(name, kind, ends[0], ends[1], self._origin(element, where))
        if kind not in JOINT_TYPES:
            self.faults.append(f"{where}: unknown type {kind!r}; valid: {', '.join(JOINT_TYPES)}")
            return [joint]
        if kind == "fixed":
            return [joint]
        if kind in ("planar", "floating") and element.find("mimic") is not None:
            self.faults.append(f"{where}: a {kind} joint cannot mimic")
        if kind == "floating":
            return floating_chain(joint)
        joint = dataclasses.replace(joint, axis=self._axis(element, where))
        if kind == "planar":
            return planar_chain(joint)
        joint = dataclasses.replace(joint, mimic=self._mimic(element, where))
        return [self._limited(joint, element.find("limit"), where)]

    def _axis(self, element: Element, where: str) -> Triple:
        """The unit axis; URDF's default is x."""
        axis_element = element.find("axis")
        if axis_element is None:
            if element.get("type") == "planar":
                self.warnings.append(f"{where}: no axis, so its plane is orthogonal to x, URDF's default")
            return (1.0, 0.0, 0.0)
        axis = self._numbers(axis_element, "xyz", 3, where)
        length = math.hypot(*axis)
        if length < 1e-9:
            self.faults.append(f"{where}: its axis is zero")
            return (1.0, 0.0, 0.0)
        if abs(length - 1.0) > 1e-3:
            self.warnings.append(f"{where}: axis of length {length:.4g} normalised")
        return triple([value / length for value in axis])

    def _limited(self, joint: Joint, element: Element | None, where: str) -> Joint:
        """The joint with its limits, mended. Whatever mimics and has no limits of its own is unlimited."""
        if joint.kind == "continuous":
            return joint
        lower, upper = self._limit(element, "lower", where), self._limit(element, "upper", where)
        if (lower is None) != (upper is None):
            self.warnings.append(f"{where}: of its limits one is given; the other is 0, URDF's default")
            lower, upper = lower or 0.0, upper or 0.0
        if lower is not None and upper is not None and lower > upper:
            self.warnings.append(f"{where}: limits {lower:.4g}..{upper:.4g} are inverted: swapped")
            lower, upper = upper, lower
        if lower is None or lower == upper == 0.0:  # exporters write 0..0 where the user gave none
            if joint.kind == "prismatic":
                return joint
            if joint.mimic is not None:
                return dataclasses.replace(joint, kind="continuous")
            self.without_limits.append(joint.name)
            lower, upper = -math.pi, math.pi
        return dataclasses.replace(joint, lower=lower, upper=upper)

    def _limit(self, element: Element | None, key: str, where: str) -> float | None:
        """One limit; None where it is not given."""
        text = None if element is None else element.get(key)
        if text is None:
            return None
        values = _floats(text)
        if values is None or len(values) != 1 or math.isnan(values[0]):
            self.faults.append(f"{where}: limit {key}={text!r} is not a number")
            return None
        return min(max(values[0], -LARGEST_NUMBER), LARGEST_NUMBER)

    def _mimic(self, element: Element, where: str) -> Mimic | None:
        mimic = element.find("mimic")
        if mimic is None:
            return None
        (multiplier,) = self._numbers(mimic, "multiplier", 1, where, (1.0,))
        (offset,) = self._numbers(mimic, "offset", 1, where, (0.0,))
        return Mimic(mimic.get("joint", ""), multiplier, offset)

    # ---- the whole

    def _check_names(self, kind: str, names: list[str]) -> None:
        if "" in names:
            self.faults.append(f"a {kind} has no name")
        for name, count in Counter(names).items():
            if name and count > 1:
                self.faults.append(f"{kind} {name!r} is defined {count} times")

    def _check_tree(self, links: list[str], joints: list[Joint]) -> str | None:
        """The root link, or None with faults."""
        if not links:
            self.faults.append("it has no links")
            return None
        known, above, below = set(links), dict[str, list[str]](), dict[str, list[str]]()
        sound = True
        for joint in joints:
            for end in (joint.parent, joint.child):
                if end not in known:
                    sound = False
                    if end:
                        self.faults.append(f"joint {joint.name!r} names the link {end!r}, which does not exist")
            above.setdefault(joint.child, []).append(joint.name)
            below.setdefault(joint.parent, []).append(joint.child)
        for link, names in above.items():
            if len(names) > 1 and link:
                sound = False
                self.faults.append(f"link {link!r} has several parent joints: {', '.join(map(repr, names))}")
        if not sound:
            return None
        roots = [link for link in links if link not in above]
        if len(roots) > 1:
            self.faults.append(f"it has several roots, so it is not one tree: {', '.join(map(repr, roots))}")
        reached, front = set(roots), list(roots)
        while front:
            children = below.get(front.pop(), [])
            reached.update(children)
            front.extend(children)
        stray = [link for link in links if link not in reached]
        if stray:
            self.faults.append(f"links joined in a cycle: {', '.join(map(repr, stray))}")
        return roots[0] if roots else None

    def _resolve_mimics(self, joints: list[Joint]) -> list[Joint]:
        """Replace chains (a mimic of a mimic) by relations to actuated joints.

        Whatever mimics a joint that is not there, or does not move, moves by itself.
        """
        by_name = {joint.name: joint for joint in joints}
        unled: list[str] = []
        for joint in joints:
            leader = None if joint.mimic is None else by_name.get(joint.mimic.joint)
            if joint.mimic is not None and (leader is None or leader.kind == "fixed"):
                fault = "is fixed" if leader else "is not there"
                unled.append(f"{joint.name!r} of {joint.mimic.joint!r}, which {fault}")
                by_name[joint.name] = dataclasses.replace(joint, mimic=None)
        if unled:
            self.warnings.append(f"mimics of joints that cannot lead, taken as joints of their own: {'; '.join(unled)}")
        return [dataclasses.replace(joint, mimic=self._resolved(joint, by_name)) for joint in by_name.values()]

    def _resolved(self, joint: Joint, by_name: dict[str, Joint]) -> Mimic | None:
        mimic, names = joint.mimic, [joint.name]
        while mimic is not None:
            leader = by_name[mimic.joint]
            if leader.name in names:
                if leader.name == joint.name:
                    self.faults.append(f"joints mimic in a circle: {' -> '.join([*names, leader.name])}")
                return None
            if leader.mimic is None:
                return mimic
            names.append(leader.name)
            mimic = Mimic(
                leader.mimic.joint,
                mimic.multiplier * leader.mimic.multiplier,
                mimic.multiplier * leader.mimic.offset + mimic.offset,
            )
        return None


def _floats(text: str) -> tuple[float, ...] | None:
    """The numbers in the text (commas allowed between them), or None where a word is none."""
    try:
        return tuple(float(word) for word in text.replace(",", " ").split())
    except ValueError:
        return None
