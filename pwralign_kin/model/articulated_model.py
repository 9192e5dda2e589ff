"""The articulated model: parts, joints, limits and kinematics of one URDF."""

from __future__ import annotations

import dataclasses
import logging
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pwralign_kin import files, kernels, se3
from pwralign_kin.exceptions import ModelError, StateError, UnknownNameError
from pwralign_kin.model import cache
from pwralign_kin.model.description import Description, Joint
from pwralign_kin.model.kernel_model import kernel_tree, model_reach, set_surfaces
from pwralign_kin.model.kinematics import Kinematics
from pwralign_kin.model.meshes import Geometry, MeshUnits, read_geometry
from pwralign_kin.model.packages import PackageFolders, package_folders
from pwralign_kin.model.part_graph import Part, Weld, assemble_parts, joint_motion, weld_links
from pwralign_kin.model.surface import Surface
from pwralign_kin.model.surface_sampling import VERSION as SURFACE_VERSION
from pwralign_kin.model.surface_sampling import Mesh, sample_surfaces
from pwralign_kin.model.symmetry import VERSION as SYMMETRY_VERSION
from pwralign_kin.model.symmetry import Symmetry, as_arrays, find_symmetry, from_arrays
from pwralign_kin.model.urdf import GeometryKind, read_urdf
from pwralign_kin.model.urdf_writing import as_normalised_urdf
from pwralign_kin.read_only import ReadOnly
from pwralign_kin.se3 import Array
from pwralign_kin.state import State

logger = logging.getLogger(__name__)

FULL_TURN = 2.0 * math.pi
TURN_TOLERANCE = 1e-3
"""A range this close (rad) to a full turn counts as one: URDFs round pi."""

LARGEST = 100.0
"""A model wider than this (m) is warned about: its meshes may be in millimetres."""


@dataclass(frozen=True, eq=False)
class ArticulatedModel(ReadOnly):
    """A URDF as rigid parts in a tree of joints, with kinematics. Made by `from_urdf`; never changes."""

    name: str
    """As the URDF names the robot."""

    urdf_path: Path
    """The file that it was read from."""

    root_link: str
    """The link whose frame is the root frame; a state places it unless it names another link."""

    parts: tuple[Part, ...]
    """parts[0] is the root; parents come before their children."""

    joint_names: tuple[str, ...]
    """The k actuated joints (those that mimic none) in the URDF's order.

    Planar and floating joints appear as their components: name.x, name.y, name.yaw, and name.x, name.y,
    name.z, name.roll, name.pitch, name.yaw (URDF's fixed-axis angles).
    """

    lower: Array
    """(k,) lower limits, rad or m.

    They respect what joints that mimic demand. A joint that turns a full circle or more keeps one turn:
    (-pi, pi), or as near to it as its limits let it.
    """

    upper: Array
    """(k,) upper limits, rad or m."""

    continuous: NDArray[np.bool_]
    """(k,) whether a full turn more changes nothing, so that the value may be wrapped into the limits."""

    units: Mapping[str, str]
    """Unit of each actuated joint: "rad" or "m"."""

    diagonal: float
    """Diagonal of the axis-aligned bounding box of all geometry with all values 0, in the root frame, m."""

    unobservable: tuple[str, ...]
    """Actuated joints that no scan can tell: all geometry hangs on one side of them."""

    warnings: tuple[str, ...]
    """What was mended on reading."""

    source: bytes
    """The URDF as its author wrote it, with its comments; for a xacro, what it expands to."""

    normalised_urdf: str
    """The URDF as understood: mended, planar and floating joints expanded, mimic chains resolved."""

    content_key: str
    """Changes with the normalised URDF, the mesh files and the options, not with the folder they are in."""

    kinematics: Kinematics
    """Pinocchio's model of the URDF."""

    package_dirs: PackageFolders
    """Folders that were given for the URDF's packages and meshes."""

    T_part_link: Mapping[str, tuple[int, Array]]
    """By link: the index of its part, and its (4, 4) placement in that part's frame."""

    def __repr__(self) -> str:
        """Return one line: name, joints and their limits, size."""
        limits = zip(self.joint_names, self.lower, self.upper, strict=True)
        joints = ", ".join(f"{name} {low:.3g}..{high:.3g} {self.units[name]}" for name, low, high in limits)
        return f"ArticulatedModel({self.name}: {len(self.parts)} parts, {self.diagonal:.3g} m; {joints or 'no joints'})"

    @classmethod
    def from_urdf(
        cls,
        path: Path | str,
        *,
        package_dirs: Iterable[Path | str] = (),
        geometry: GeometryKind = "visual",
        mesh_units: MeshUnits = "ignore",
        xacro_args: Mapping[str, object] | None = None,
    ) -> ArticulatedModel:
        """Read a URDF (or xacro, with the xacro extra, its arguments by name in `xacro_args`).

        `package_dirs` are folders that contain packages, or workspaces with packages some levels below; besides
        them packages are looked for in the folders above the URDF, ROS_PACKAGE_PATH and AMENT_PREFIX_PATH.
        `geometry` chooses the visual or the collision elements; where the whole URDF has none of them the other
        serves, with a warning. `mesh_units` says whether a DAE is scaled by its `<unit>` ("apply") or taken to be
        in metres ("ignore", as most readers do).

        Raises `ModelError` listing every fault, `MissingMeshError` naming every mesh that is not found,
        `UnknownNameError` for an argument that the xacro does not have, `DependencyError` for a xacro without the
        extra.
        """
        files.check_path(path, partial(ModelError, "URDF"))
        path = Path(path)
        if geometry not in ("visual", "collision"):
            raise ModelError(path, f"geometry must be 'visual' or 'collision', not {geometry!r}")
        if mesh_units not in ("ignore", "apply"):
            raise ModelError(path, f"mesh_units must be 'ignore' or 'apply', not {mesh_units!r}")
        if not isinstance(xacro_args, Mapping | None):
            raise ModelError(path, f"xacro_args maps names to values, not {xacro_args!r}")
        folders = package_folders(package_dirs, path)
        arguments = {str(name): _as_xacro(value) for name, value in (xacro_args or {}).items()}
        description = read_urdf(path, folders, geometry, arguments)
        welds = weld_links(description)
        shapes = read_geometry(description, path, folders, mesh_units)
        diagonal = _diagonal_at_zero(welds, shapes)
        model = cls._assemble(path, folders, description.with_ranges(diagonal), welds, shapes, diagonal)
        model.kernel_model, model.symmetry, model.reach  # noqa: B018  prepared here, once, so that no estimate pays for it
        return model

    @classmethod
    def _assemble(
        cls,
        path: Path,
        package_dirs: PackageFolders,
        description: Description,
        welds: tuple[Weld, ...],
        shapes: Geometry,
        diagonal: float,
    ) -> ArticulatedModel:
        warnings = [*description.warnings, *shapes.warnings]
        if diagonal > LARGEST:
            warnings.append(f"the model is {diagonal:.4g} m across: are its meshes in millimetres, without a scale?")
        actuated = [joint for joint in description.joints if joint.kind != "fixed" and joint.mimic is None]
        ranges = [_range(joint, description, warnings) for joint in actuated]
        continuous = np.array([turns for _, _, turns in ranges], dtype=bool)
        indices = {joint.name: index for index, joint in enumerate(actuated)}
        parts = assemble_parts(welds, shapes.visuals, indices, continuous)
        xml = as_normalised_urdf(description)
        for warning in warnings:
            logger.warning("%s: %s", path, warning)
        return cls(
            name=description.name,
            urdf_path=path,
            root_link=description.root,
            parts=parts,
            joint_names=tuple(indices),
            lower=_limits([lower for lower, _, _ in ranges]),
            upper=_limits([upper for _, upper, _ in ranges]),
            continuous=continuous,
            units={joint.name: "m" if joint.kind == "prismatic" else "rad" for joint in actuated},
            diagonal=diagonal,
            unobservable=_unobservable(parts, tuple(indices)),
            warnings=tuple(warnings),
            source=description.source,
            normalised_urdf=xml,
            content_key=cache.content_key(xml, shapes.key),
            kinematics=Kinematics(xml, path, [part.joint for part in parts], len(actuated)),
            package_dirs=package_dirs,
            T_part_link={
                link: (index, T)
                for index, weld in enumerate(welds)
                for link, T in zip(weld.links, weld.T_part_links, strict=True)
            },
        )

    @cached_property
    def prismatic(self) -> NDArray[np.bool_]:
        """Which actuated joints (k,) slide."""
        return np.array([self.units[name] == "m" for name in self.joint_names], bool)

    @cached_property
    def joint_scales(self) -> Array:
        """What joint values (k,) are divided by to compare them: the diagonal (m) of joints that slide, else 1 rad."""
        return np.where(self.prismatic, self.diagonal, 1.0)

    @cached_property
    def surfaces(self) -> tuple[Surface, ...]:
        """The outer-visible surface of every part, from the user's cache where it was prepared before.

        Raises `ModelError` when nothing of the model can be seen from outside.
        """
        surfaces = sample_surfaces(self.content_key, self._meshes, self._random_placements)
        if not any(surface.exists for surface in surfaces):
            raise ModelError(self.urdf_path, "no part has any surface that can be seen from outside")
        return surfaces

    @cached_property
    def kernel_model(self) -> kernels.Articulated:
        """The model as the compiled kernels take it."""
        native = kernel_tree(self.parts, self.diagonal, self.joint_scales, self.lower, self.upper, self.continuous)
        set_surfaces(native, self.surfaces)
        return native

    @cached_property
    def kernel_meshes(self) -> list[kernels.TriangleMesh]:
        """The triangles of every part as the compiled kernels take them, lengths in model diagonals."""
        return [
            kernels.TriangleMesh(
                np.ascontiguousarray(vertices, np.float32).reshape(-1, 3),
                np.ascontiguousarray(faces, np.int32).reshape(-1, 3),
            )
            for vertices, faces in self._meshes()
        ]

    @cached_property
    def reach(self) -> float:
        """Largest extent of the model over its joint values, m."""
        return model_reach(self.kernel_model, self.surfaces) * self.diagonal

    @cached_property
    def symmetry(self) -> Symmetry:
        """Which parts look alike and which turns map a part onto itself, lengths in model diagonals; cached on disk."""
        key = f"symmetry-{SYMMETRY_VERSION}-{SURFACE_VERSION}-{self.content_key}"
        return from_arrays(cache.load_or_build(key, lambda: as_arrays(find_symmetry(self.surfaces))))

    def __getstate__(self) -> dict[str, Any]:
        """Return what a pickle holds: the fields. What is prepared from them is found in the cache again."""
        return {own.name: getattr(self, own.name) for own in dataclasses.fields(self)}

    def neutral(self) -> dict[str, float]:
        """Return 0 clamped into the limits, by joint name (rad or m)."""
        return dict(zip(self.joint_names, self._neutral_values.tolist(), strict=True))

    def values(self, joints: Mapping[str, float]) -> Array:
        """Return the (k,) actuated values (rad or m) of `joints`, the missing ones neutral.

        Limits are not imposed.
        Raises `UnknownNameError` for a name that is no actuated joint.
        """
        values = self._neutral_values.copy()
        for name, value in joints.items():
            if name not in self._index:
                raise UnknownNameError("actuated joint", name, self.joint_names)
            values[self._index[name]] = value
        return values

    def within_limits(self, values: Array) -> Array:
        """Return actuated values (k,) within the limits: wrapped where a full turn changes nothing, else clamped."""
        span = np.where(self.continuous, self.upper - self.lower, 1.0)
        wrapped = self.lower + np.mod(values - self.lower, span)
        return np.where(self.continuous, wrapped, np.clip(values, self.lower, self.upper))

    def check_limits(self, joints: Mapping[str, float]) -> None:
        """Raise `UnknownNameError` for a name that is no actuated joint, `StateError` for a value beyond the limits."""
        for name, value in joints.items():
            if name not in self._index:
                raise UnknownNameError("joint", name, self.joint_names)
            if not self._allows(name, value):
                lower, upper = self.lower[self._index[name]], self.upper[self._index[name]]
                fault = f"joint {name!r} cannot be {value:g}: its limits are {lower:g} to {upper:g} {self.units[name]}"
                radians = {own: math.radians(joints[own]) for own in joints if self.units.get(own) == "rad"}
                if name in radians and all(self._allows(*joint) for joint in radians.items()):
                    fault += ", which it is within if it was meant in degrees"
                raise StateError(fault)

    def part_placements(self, values: Array) -> Array:
        """Return (n_parts, 4, 4) placements of the parts in the root frame for the actuated values (k,)."""
        return self.kinematics.placements(self._checked(values))

    def part_placements_and_twists(self, values: Array) -> tuple[Array, Array]:
        """Return part placements (n_parts, 4, 4), and derivatives (n_parts, 6, k) of the parts' twists, by values (k,).

        Rows 0-2: angular velocity; rows 3-5: linear velocity of what is at the root's origin; both in root axes.
        """
        return self.kinematics.placements_and_twists(self._checked(values))

    def part_jacobians(self, values: Array) -> Array:
        """Return (n_parts, 6, k) derivatives of the parts' twists by the actuated values (k,).

        Rows 0-2: angular velocity; rows 3-5: linear velocity of the part frame's origin; both in root axes.
        """
        return self.kinematics.jacobians(self._checked(values))

    def link_placements(self, values: Array) -> dict[str, Array]:
        """Return the (4, 4) placement of every link in the root frame for the actuated values (k,)."""
        placements = self.part_placements(values)
        return {link: placements[index] @ T for link, (index, T) in self.T_part_link.items()}

    def root_placement(self, state: State) -> Array:
        """Return T_scan_root (4, 4) of a state, whichever link it places.

        Raises `UnknownNameError` for a base link or joint that the model lacks.
        """
        if state.base_link in (None, self.root_link):
            return state.T_scan_base
        if state.base_link not in self.T_part_link:
            raise UnknownNameError("link", str(state.base_link), self.T_part_link)
        index, T_part_base = self.T_part_link[state.base_link]
        T_root_base = self.part_placements(self.values(state.joints))[index] @ T_part_base
        return state.T_scan_base @ se3.inverse(T_root_base)

    @cached_property
    def _index(self) -> dict[str, int]:
        return {name: index for index, name in enumerate(self.joint_names)}

    @cached_property
    def _neutral_values(self) -> Array:
        return np.clip(np.zeros(len(self.joint_names)), self.lower, self.upper)

    def _meshes(self) -> list[Mesh]:
        """Return the triangles of every part, lengths in model diagonals."""
        return [(part.vertices / self.diagonal, part.faces) for part in self.parts]

    def _random_placements(self, random: np.random.Generator) -> Array:
        """Return (n_parts, 4, 4) placements in the root frame at random joint values, lengths in model diagonals."""
        placements = self.part_placements(self.lower + (self.upper - self.lower) * random.random(len(self.lower)))
        placements[:, :3, 3] /= self.diagonal
        return placements

    def _allows(self, name: str, value: float) -> bool:
        index = self._index[name]
        return bool(self.continuous[index] or self.lower[index] <= value <= self.upper[index])

    def _checked(self, values: Array) -> Array:
        values = np.asarray(values, dtype=np.float64)
        if values.shape != (len(self.joint_names),):
            raise StateError(f"{self.name}: expected {len(self.joint_names)} joint values, got shape {values.shape}")
        return values


def _as_xacro(value: object) -> str:
    """Return a value as xacro writes it."""
    return str(value).lower() if isinstance(value, bool) else str(value)


def _limits(values: list[float]) -> Array:
    return np.array(values, dtype=np.float64) + 0.0  # no -0.0: NumPy takes a range from 0 to it for reversed


def _diagonal_at_zero(welds: tuple[Weld, ...], shapes: Geometry) -> float:
    """Diagonal (m) of the box around all geometry with every actuated value 0."""
    placements: list[Array] = []
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for weld in welds:
        T_root_part = np.eye(4)
        if weld.joint is not None:
            offset = 0.0 if weld.joint.mimic is None else weld.joint.mimic.offset
            motion = joint_motion(weld.joint.kind, np.array(weld.joint.axis), offset)
            T_root_part = placements[weld.parent] @ weld.T_parent_joint @ motion
        placements.append(T_root_part)
        for link, T_part_link in zip(weld.links, weld.T_part_links, strict=True):
            for visual in shapes.visuals.get(link, ()):
                if len(visual.vertices):
                    points = se3.transform(T_root_part @ T_part_link @ visual.T_link_visual, visual.vertices)
                    low, high = np.minimum(low, points.min(axis=0)), np.maximum(high, points.max(axis=0))
    return float(np.linalg.norm(high - low))


def _range(joint: Joint, description: Description, warnings: list[str]) -> tuple[float, float, bool]:
    """Search range of an actuated joint, and whether it wraps.

    The joints that mimic it narrow the range to where they stay within their own limits. A full turn or more
    becomes one turn, as near to (-pi, pi) as the limits let it; it wraps if the joints that mimic it do with
    it.
    """
    lower = -math.inf if joint.lower is None else joint.lower
    upper = math.inf if joint.upper is None else joint.upper
    wraps = joint.kind != "prismatic"
    for follower in description.joints:
        mimic = follower.mimic
        if mimic is None or mimic.joint != joint.name:
            continue
        wraps = wraps and follower.kind != "prismatic" and float(mimic.multiplier).is_integer()
        if follower.lower is None or follower.upper is None or mimic.multiplier == 0.0:
            continue
        ends = sorted((limit - mimic.offset) / mimic.multiplier for limit in (follower.lower, follower.upper))
        if max(lower, ends[0]) > min(upper, ends[1]):
            warnings.append(f"the limits of {follower.name!r} leave {joint.name!r}, which it mimics, no range: ignored")
        else:
            lower, upper = max(lower, ends[0]), min(upper, ends[1])
    if joint.kind == "prismatic":
        return lower, upper, False
    if wraps and upper - lower >= FULL_TURN - TURN_TOLERANCE:
        middle = min(max(0.0, lower + math.pi), upper - math.pi)
        return max(lower, middle - math.pi), min(upper, middle + math.pi), True
    return (-math.pi if math.isinf(lower) else lower), (math.pi if math.isinf(upper) else upper), False


def _unobservable(parts: tuple[Part, ...], joint_names: tuple[str, ...]) -> tuple[str, ...]:
    """Actuated joints none of whose joints has geometry on both sides."""
    below = [len(part.faces) for part in parts]
    for index in range(len(parts) - 1, 0, -1):
        below[parts[index].parent] += below[index]
    told = {
        part.joint.actuated
        for index, part in enumerate(parts)
        if part.joint is not None and 0 < below[index] < below[0] and part.joint.multiplier != 0.0
    }
    return tuple(name for index, name in enumerate(joint_names) if index not in told)
