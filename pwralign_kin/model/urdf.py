"""URDF text -> `Description`: read, check, mend, and write again as a normalised URDF.

What is merely sloppy is mended with a warning; what has no sane reading is a fault, and all faults are
reported at once in one `ModelError`. After reading, every joint is fixed, revolute, continuous or prismatic:
planar and floating joints have become chains of such joints over virtual links, and every mimic names an
actuated joint.
"""

from __future__ import annotations

import codecs
import dataclasses
import math
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from pwralign_kin import se3
from pwralign_kin.exceptions import DependencyError, ModelError
from pwralign_kin.se3 import Array

if TYPE_CHECKING:
    from lxml.etree import _Element as Element

GeometryKind = Literal["visual", "collision"]
Triple = tuple[float, float, float]
Color = tuple[float, float, float, float]

JOINT_TYPES = ("revolute", "continuous", "prismatic", "fixed", "planar", "floating")

FREE_REACH = 3.0
"""Range of the translations of planar and floating joints, in model diagonals each way."""

SLIDE_REACH = 1.0
"""Range of a prismatic joint without limits, in model diagonals each way."""

LARGEST_NUMBER = 1e9
"""No length, angle or factor of a real model is larger; limits beyond it mean "unlimited"."""

DECLARED_WITHIN = 4096
"""Bytes at the start of a file in which its XML declaration is looked for."""

LONGEST_SLIDE = 10.0
"""Prismatic limits beyond so many model diagonals mean "unlimited" and are cut to `FREE_REACH`."""


@dataclass(frozen=True)
class Origin:
    """A placement as URDF writes it."""

    xyz: Triple = (0.0, 0.0, 0.0)
    """Translation, m."""

    rpy: Triple = (0.0, 0.0, 0.0)
    """Fixed-axis roll, pitch, yaw, rad."""

    @property
    def matrix(self) -> Array:
        """(4, 4) placement: R = Rz(yaw) Ry(pitch) Rx(roll)."""
        x, y, z = np.eye(3)
        roll, pitch, yaw = self.rpy
        T = np.eye(4)
        T[:3, :3] = se3.rotation_about(z, yaw) @ se3.rotation_about(y, pitch) @ se3.rotation_about(x, roll)
        T[:3, 3] = self.xyz
        return T


@dataclass(frozen=True)
class Shape:
    """One visual or collision element."""

    kind: str
    """box, cylinder, sphere, capsule or mesh."""

    size: tuple[float, ...]
    """box: x y z; cylinder and capsule: radius, length; sphere: radius (m); mesh: scale x y z.

    A capsule's length is that of its cylinder, without the two caps.
    """

    filename: str = ""
    """The mesh's name as the URDF gives it."""

    origin: Origin = Origin()
    """Placement in the link's frame."""

    rgba: Color | None = None
    """Colour of the URDF's material, each in [0, 1]."""


@dataclass(frozen=True)
class Link:
    """One link with its geometry of the kind in use."""

    name: str
    shapes: tuple[Shape, ...] = ()


@dataclass(frozen=True)
class Mimic:
    """value = multiplier * (value of `joint`) + offset; `joint` is actuated once chains are resolved."""

    joint: str
    multiplier: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True)
class Joint:
    """One joint with at most one degree of freedom."""

    name: str
    kind: str
    """fixed, revolute, continuous or prismatic."""

    parent: str
    child: str
    origin: Origin = Origin()
    """Placement of the joint (and child link at value 0) in the parent link's frame."""

    axis: Triple = (1.0, 0.0, 0.0)
    """Unit axis in the joint's frame."""

    lower: float | None = None
    upper: float | None = None
    """Limits, rad or m. None: unlimited (fixed, continuous), or a slide that waits for the model's size."""

    free: bool = False
    """Whether it is a component of a planar or floating joint."""

    mimic: Mimic | None = None


@dataclass(frozen=True)
class Description:
    """A checked URDF: a tree of links with one root."""

    name: str
    links: tuple[Link, ...]
    joints: tuple[Joint, ...]
    root: str
    warnings: tuple[str, ...] = ()
    """What was mended, one line each."""
    source: bytes = field(default=b"", repr=False)
    """The URDF as its author wrote it, after xacro."""

    def with_ranges(self, diagonal: float) -> Description:
        """Return the description with every slide's limits finite and sane for a model of `diagonal` (m)."""
        warnings = list(self.warnings)
        joints = {joint.name: _with_range(joint, diagonal, warnings) for joint in self.joints}
        for joint in joints.values():
            if joint.kind == "prismatic" and joint.lower is None and joint.mimic is not None:
                leader = joints[joint.mimic.joint]
                ends = (
                    (-math.pi, math.pi)
                    if leader.lower is None or leader.upper is None
                    else (leader.lower, leader.upper)
                )
                lower, upper = sorted(joint.mimic.multiplier * end + joint.mimic.offset for end in ends)
                joints[joint.name] = dataclasses.replace(joint, lower=lower, upper=upper)
        return dataclasses.replace(self, joints=tuple(joints.values()), warnings=tuple(warnings))

    def to_xml(self) -> str:
        """Return a normalised URDF that strict readers (urdfdom, Pinocchio, yourdfpy) accept.

        Mesh names stay as they were given; capsules, which URDF 1.0 does not know, are left out.
        """
        from lxml import etree

        robot = etree.Element("robot", name=self.name)
        for link in self.links:
            element = etree.SubElement(robot, "link", name=link.name)
            for shape in link.shapes:
                if shape.kind != "capsule":
                    _write_shape(etree.SubElement(element, "visual"), shape)
        for joint in self.joints:
            _write_joint(etree.SubElement(robot, "joint", name=joint.name, type=joint.kind), joint)
        return etree.tostring(robot, encoding="unicode", pretty_print=True)


def read_urdf(path: Path, package_dirs: Sequence[Path] = (), geometry: GeometryKind = "visual") -> Description:
    """Read the URDF (or, with suffix .xacro, the xacro) at `path` with its `geometry`.

    Where the whole URDF has no geometry of that kind, the other kind serves, with a warning. A single link
    that lacks the kind in use has no surface: collision hulls, often padded or crude, would put surface where
    none is. Raises `ModelError` with every fault found, `DependencyError` for a xacro without the xacro
    extra.
    """
    written = _source(path, package_dirs)
    source = _well_declared(written)
    description = _Reader(geometry).read(_parse_xml(source, path), path)
    mended = () if source == written else ("its XML declaration is malformed: read as XML 1.0",)
    return dataclasses.replace(description, source=source, warnings=(*mended, *description.warnings))


def _source(path: Path, package_dirs: Sequence[Path]) -> bytes:
    """The bytes of the URDF, after xacro where the suffix says so."""
    if not path.exists():
        raise ModelError(path, "no such file")
    if not path.is_file():
        raise ModelError(path, "not a file")
    if path.suffix == ".xacro":
        return _expand_xacro(path, package_dirs)
    try:
        return path.read_bytes()
    except OSError as error:
        raise ModelError(path, f"cannot read: {error.strerror}") from None


def _expand_xacro(path: Path, package_dirs: Sequence[Path]) -> bytes:
    try:
        import xacrodoc
    except ImportError:
        remedy = 'pip install "pwralign-kin[xacro]"'
        raise DependencyError(f"{path.name} is a xacro, and xacrodoc is not installed", remedy) from None
    try:
        xacrodoc.packages.reset()
        xacrodoc.packages.update_package_cache(_packages(path, package_dirs))
        return str(xacrodoc.XacroDoc.from_file(str(path)).to_urdf_string()).encode()
    except Exception as error:  # xacro evaluates the file's own expressions: anything may come out
        raise ModelError(path, f"xacro fails: {' '.join(str(error).split())}") from None


def _packages(path: Path, package_dirs: Sequence[Path]) -> dict[str, Path]:
    """Packages by name: those in `package_dirs`, those beside the folders above the file, and those folders.

    Distributions of robots often leave out `package.xml`.
    """
    above = path.absolute().parents[:4]
    beside = [entry for folder in above for entry in _folders(folder)]
    marked = {entry.name: entry for entry in beside if (entry / "package.xml").is_file()}
    given = {entry.name: entry for folder in package_dirs for entry in (folder, *_folders(folder))}
    return {entry.name: entry for entry in (*beside, *above)} | marked | given


def _folders(folder: Path) -> list[Path]:
    try:
        return sorted(entry for entry in folder.iterdir() if entry.is_dir())
    except OSError:
        return []


def _well_declared(source: bytes) -> bytes:
    """The source with its XML declaration at the start and of version 1.0, which readers of URDFs do not insist on."""
    declaration = re.search(rb"<\?xml\s([^>]*)\?>", source[:DECLARED_WITHIN])
    if declaration is None:
        return source
    before = source[: declaration.start()].removeprefix(codecs.BOM_UTF8)
    if not before and re.search(rb"version\s*=\s*[\"']1\.\d[\"']", declaration[1]):
        return source
    encoding = re.search(rb"encoding\s*=\s*[\"']([\w.-]+)[\"']", declaration[1])
    start = b'<?xml version="1.0" encoding="%s"?>' % (encoding[1] if encoding else b"utf-8")
    return start + before.lstrip() + source[declaration.end() :]


def _parse_xml(source: bytes, path: Path) -> Element:
    """The root element, with nothing outside the file read and no entity expanded."""
    from lxml import etree

    def parser(recover: bool) -> etree.XMLParser:
        return etree.XMLParser(
            resolve_entities=False, no_network=True, remove_comments=True, remove_pis=True, recover=recover
        )

    strict = parser(recover=False)
    try:
        root = etree.fromstring(source, strict)
    except etree.XMLSyntaxError as error:
        # Old URDFs hold simulator tags with undeclared prefixes: those alone are forgiven.
        if any(entry.domain_name != "NAMESPACE" for entry in strict.error_log):
            raise ModelError(path, f"not XML: {error}") from None
        root = etree.fromstring(source, parser(recover=True))
    if root.getroottree().docinfo.internalDTD is not None:
        raise ModelError(path, "declares a document type; none is read, remove it")
    if root.tag != "robot":
        raise ModelError(path, f"not a URDF: its root element is <{root.tag}>, not <robot>")
    return root


class _Reader:
    """Collects faults and warnings while reading one URDF."""

    def __init__(self, geometry: GeometryKind) -> None:
        self.geometry = geometry
        self.faults: list[str] = []
        self.warnings: list[str] = []
        self.without_effort: list[str] = []
        self.without_limits: list[str] = []
        self.materials: dict[str, Color] = {}

    def read(self, robot: Element, path: Path) -> Description:
        """Return the description; raises `ModelError` with every fault."""
        name = robot.get("name", "").strip()
        if not name:
            name = path.name.split(".")[0] or "robot"
            self.warnings.append(f"the robot has no name: taken as {name!r}")
        if any("xacro" in str(element.tag) for element in robot.iter()):
            raise ModelError(path, "holds xacro macros: give it the suffix .xacro")
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
            links += [Link(joint.child) for joint in chain if joint.free and joint.child == _virtual_link(joint.name)]
        self._check_names("link", [link.name for link in links])
        self._check_names("joint", [joint.name for joint in joints])
        root = self._check_tree([link.name for link in links], joints)
        joints = self._resolve_mimics(joints)
        for problem, names in (
            ("no limits, taken as -pi..pi", self.without_limits),
            ("limits without effort or velocity, taken as 0", self.without_effort),
        ):
            if names:
                self.warnings.append(f"{problem}: {', '.join(map(repr, names))}")
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
            self.faults.append(f"{where}: {attribute}={text!r} of <{element.tag}> is not {wanted}")
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
        return Origin(_triple(xyz), _triple(rpy))

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
        return Shape("mesh", _triple(scale * 3 if len(scale) == 1 else scale), filename)

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
            return _floating_chain(joint)
        joint = dataclasses.replace(joint, axis=self._axis(element, where))
        if kind == "planar":
            return _planar_chain(joint)
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
        return _triple([value / length for value in axis])

    def _limited(self, joint: Joint, element: Element | None, where: str) -> Joint:
        """The joint with its limits, mended. Whatever mimics and has no limits of its own is unlimited."""
        if element is not None and not {"effort", "velocity"} <= set(element.keys()):
            self.without_effort.append(joint.name)
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
        """Replace chains (a mimic of a mimic) by relations to actuated joints."""
        by_name = {joint.name: joint for joint in joints}
        return [dataclasses.replace(joint, mimic=self._resolved(joint, by_name)) for joint in joints]

    def _resolved(self, joint: Joint, by_name: dict[str, Joint]) -> Mimic | None:
        mimic, names = joint.mimic, [joint.name]
        while mimic is not None:
            leader = by_name.get(mimic.joint)
            if leader is None or leader.kind == "fixed":
                problem = "does not exist" if leader is None else "is fixed"
                if len(names) == 1:
                    self.faults.append(f"joint {joint.name!r} mimics {mimic.joint!r}, which {problem}")
                return None
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


def _with_range(joint: Joint, diagonal: float, warnings: list[str]) -> Joint:
    """The joint with finite and sane limits if it is a slide that follows no other."""
    if joint.kind != "prismatic" or joint.mimic is not None:
        return joint
    if joint.lower is None or joint.upper is None:
        reach = (FREE_REACH if joint.free else SLIDE_REACH) * diagonal
        if not joint.free:
            warnings.append(
                f"joint {joint.name!r}: no limits, taken as {-reach:.3g}..{reach:.3g} m by the model's size"
            )
        return dataclasses.replace(joint, lower=-reach, upper=reach)
    if max(-joint.lower, joint.upper) <= LONGEST_SLIDE * diagonal:
        return joint
    reach = FREE_REACH * diagonal
    lower, upper = max(joint.lower, -reach), min(joint.upper, reach)
    if lower >= upper:
        return joint
    warnings.append(
        f"joint {joint.name!r}: limits {joint.lower:.3g}..{joint.upper:.3g} m are far beyond the model's "
        f"size: cut to {lower:.3g}..{upper:.3g} m"
    )
    return dataclasses.replace(joint, lower=lower, upper=upper)


def _planar_chain(joint: Joint) -> list[Joint]:
    """Slides along two directions orthogonal to the axis, then a turn about the axis.

    The directions are the next two coordinate axes in cyclic order (for the axis z: x and y), made orthogonal
    to the axis.
    """
    axis = np.array(joint.axis)
    first = np.eye(3)[(int(np.argmax(np.abs(axis))) + 1) % 3]
    first = first - axis * (axis @ first)
    first /= np.linalg.norm(first)
    second = np.cross(axis, first)
    return _chain(joint, [("x", "prismatic", first), ("y", "prismatic", second), ("yaw", "continuous", axis)])


def _floating_chain(joint: Joint) -> list[Joint]:
    """Slides along x, y, z, then turns in the order that makes roll, pitch, yaw URDF's fixed-axis angles."""
    x, y, z = np.eye(3)
    slides = [("x", "prismatic", x), ("y", "prismatic", y), ("z", "prismatic", z)]
    turns = [("yaw", "continuous", z), ("pitch", "revolute", y), ("roll", "continuous", x)]
    chain = _chain(joint, [*slides, *turns])
    return [*chain[:3], *reversed(chain[3:])]


def _chain(joint: Joint, steps: Sequence[tuple[str, str, Array]]) -> list[Joint]:
    """One-axis joints over virtual links that together move like `joint`."""
    chain, parent, origin = [], joint.parent, joint.origin
    for position, (suffix, kind, axis) in enumerate(steps, start=1):
        name = f"{joint.name}.{suffix}"
        child = joint.child if position == len(steps) else _virtual_link(name)
        limit = math.pi / 2 if kind == "revolute" else None
        lower = None if limit is None else -limit
        chain.append(Joint(name, kind, parent, child, origin, _triple(axis), lower, limit, free=True))
        parent, origin = child, Origin()
    return chain


def _virtual_link(joint: str) -> str:
    return f"{joint}.link"


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


def _triple(values: Sequence[float] | Array) -> Triple:
    return (float(values[0]), float(values[1]), float(values[2]))


def _floats(text: str) -> tuple[float, ...] | None:
    """The numbers in the text (commas allowed between them), or None where a word is none."""
    try:
        return tuple(float(word) for word in text.replace(",", " ").split())
    except ValueError:
        return None
