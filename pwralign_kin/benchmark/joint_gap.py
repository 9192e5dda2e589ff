"""Do the parts hang together? Gaps at the joints of an estimate, and of its export read back by others."""

from __future__ import annotations

import tempfile
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pwralign_kin.benchmark.cases import Case
from pwralign_kin.benchmark.runs import Progress
from pwralign_kin.benchmark.table import markdown
from pwralign_kin.estimation import Estimate, EstimatorOptions, estimate
from pwralign_kin.export import export
from pwralign_kin.model import ArticulatedModel
from pwralign_kin.model.part_graph import MovingJoint
from pwralign_kin.se3 import Array, inverse, rotation_angle

Placements = Mapping[str, Array]
"""(4, 4) by link."""


@dataclass(frozen=True)
class Gaps:
    """Largest gaps (m) of one estimate, measured in three ways."""

    robot: str
    tier: str
    joints: int
    """Joints that move, those that mimic included."""

    parts: float
    """At the joints between the part placements of the estimate."""

    pinocchio: float
    """At the joints of the exported URDF, placed by Pinocchio at the exported joint values."""

    yourdfpy: float
    """The same by yourdfpy."""

    pinocchio_offset: float
    """Largest offset of a part's placement by Pinocchio in the export from that of the estimate.

    Turns count by what they move at the end of a lever as long as the model's diagonal.
    """

    yourdfpy_offset: float
    """The same by yourdfpy."""

    @property
    def metres(self) -> tuple[float, ...]:
        """All figures in their order."""
        return self.parts, self.pinocchio, self.yourdfpy, self.pinocchio_offset, self.yourdfpy_offset


def measure(cases: Iterable[tuple[ArticulatedModel, Case]], threads: int, progress: Progress) -> list[Gaps]:
    """Estimate and export every case, and read the export back."""
    found = []
    for model, case in cases:
        result = estimate(model, case.scan, case.guess, options=EstimatorOptions(threads=threads))
        with tempfile.TemporaryDirectory() as folder:
            export(result, model, case.scan, folder)
            found.append(gaps_of_export(case, model, result, Path(folder)))
        progress(" ".join(_row(found[-1])))
    return found


def table(found: Iterable[Gaps]) -> str:
    """Return the largest gap of all, and a table of the gaps."""
    found = list(found)
    heads = [
        "robot", "tier", " joints", " gap of the estimate's parts", " gap by Pinocchio", " gap by yourdfpy",
        " parts against Pinocchio", " parts against yourdfpy",
    ]  # fmt: skip
    largest = max(max(own.metres) for own in found)
    return f"Largest of all: {largest:.1e} m.\n\n{markdown(heads, map(_row, found))}"


def _row(own: Gaps) -> list[str]:
    return [own.robot, own.tier, str(own.joints), *(f"{value:.1e} m" for value in own.metres)]


def gaps_of_export(case: Case, model: ArticulatedModel, result: Estimate, folder: Path) -> Gaps:
    """Return the gaps of an estimate and of its export in `folder`."""
    own = {name: part.T_scan_part for name, part in result.parts.items()}
    values = _exported_values(folder)
    by_pinocchio = by_part(model, read_by_pinocchio(folder / "aligned.urdf", values))
    by_yourdfpy = by_part(model, read_by_yourdfpy(folder / "aligned.urdf", values))
    return Gaps(
        robot=case.robot,
        tier=case.tier,
        joints=len(model.parts) - 1,
        parts=largest_gap(model, own),
        pinocchio=largest_gap(model, by_pinocchio),
        yourdfpy=largest_gap(model, by_yourdfpy),
        pinocchio_offset=_largest_offset(own, by_pinocchio, model.diagonal),
        yourdfpy_offset=_largest_offset(own, by_yourdfpy, model.diagonal),
    )


def by_part(model: ArticulatedModel, links: Placements) -> Placements:
    """Return the placement of every part, told by the last of the links welded into it.

    The first may be a root `world`, which in the export is the scan itself.
    """
    return {part.name: links[part.links[-1]] @ inverse(model.T_part_link[part.links[-1]][1]) for part in model.parts}


def largest_gap(model: ArticulatedModel, placements: Placements) -> float:
    """Return the largest gap (m) at the joints between parts placed by name."""
    gaps = [0.0]
    for part in model.parts:
        if part.joint is not None:
            T_parent, T_child = placements[model.parts[part.parent].name], placements[part.name]
            gaps.append(joint_gap(part.joint, T_parent, T_child, model.diagonal))
    return max(gaps)


def joint_gap(joint: MovingJoint, T_parent: Array, T_child: Array, lever: float) -> float:
    """Return by how much (m) the two sides of a joint fail to meet.

    Turning joints must share their origin and axis, sliding ones their line and orientation; an angle counts
    by what it moves at the end of `lever` (m).
    """
    between = inverse(T_parent @ joint.T_parent_joint) @ T_child
    R, offset = between[:3, :3], between[:3, 3]
    if joint.kind == "prismatic":
        apart = offset - (offset @ joint.axis) * joint.axis
        twist = 2.0 * lever * np.sin(rotation_angle(R) / 2.0)
    else:
        apart, twist = offset, lever * np.linalg.norm(R @ joint.axis - joint.axis)
    return float(max(np.linalg.norm(apart), twist))


def read_by_pinocchio(urdf: Path, values: Mapping[str, float]) -> Placements:
    """Return the placement of every link by Pinocchio; `values` (rad, m) name the joints that mimic too."""
    import pinocchio as pin

    model = pin.buildModelFromUrdf(str(urdf))
    q = pin.neutral(model)
    for name, index in zip(model.names, model.idx_qs, strict=True):
        if name in values:
            value, size = values[name], model.joints[model.getJointId(name)].nq
            # A continuous joint takes cosine and sine.
            q[index : index + size] = [np.cos(value), np.sin(value)] if size == 2 else value
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    bodies = [(i, frame) for i, frame in enumerate(model.frames) if frame.type == pin.FrameType.BODY]
    return {frame.name: np.array(data.oMf[i].homogeneous) for i, frame in bodies}


def read_by_yourdfpy(urdf: Path, values: Mapping[str, float]) -> Placements:
    """Return the placement of every link by yourdfpy, which follows the mimic tags itself."""
    import yourdfpy

    robot = yourdfpy.URDF.load(str(urdf), load_meshes=False, build_scene_graph=True)
    robot.update_cfg({name: values[name] for name in robot.actuated_joint_names})
    return {link: np.array(robot.get_transform(link)) for link in robot.link_map}


def _exported_values(folder: Path) -> dict[str, float]:
    import yaml

    message = yaml.safe_load((folder / "joint_state.yaml").read_text(encoding="utf-8"))
    return dict(zip(message["name"], message["position"], strict=True))


def _largest_offset(own: Placements, other: Placements, lever: float) -> float:
    between = np.array([inverse(T) @ other[name] - np.eye(4) for name, T in own.items()])
    shift = np.linalg.norm(between[:, :3, 3], axis=1)
    turn = lever * np.linalg.norm(between[:, :3, :3], ord=2, axis=(1, 2))
    return float(np.maximum(shift, turn).max())
