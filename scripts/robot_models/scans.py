"""Sample scans of the models, with truth: one fused from all sides, one from a single view."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from pwralign_kin import files
from pwralign_kin.model import ArticulatedModel
from pwralign_kin.scan import write_ply
from pwralign_kin.se3 import rotation_about
from pwralign_kin.simulation import TIERS, SimulatedScan, simulate
from pwralign_kin.state import State

Range = tuple[float, float]


@dataclass(frozen=True)
class Scene:
    """How a model is found in the wild."""

    joints: dict[str, Range]
    """Range from which each joint is drawn, rad or m."""

    upright: bool = True
    """Whether the model stands on the ground, its root turned about z only."""

    front: float = math.pi
    """The single view comes from within this angle (rad) of the model's front (+x), seen from above."""


def _cubebot_joints() -> dict[str, Range]:
    """Return ranges that pose a figure: limbs turned and bent, but not so far that neighbours cut deep."""
    ranges = {"pelvis_twist": (-0.7, 0.7), "head_twist": (-1.2, 1.2), "head_fold": (-0.4, 0.4)}
    bends = {
        "upper_arm": (1.5, 0.7), "lower_arm": (1.2, 0.8), "hand": (1.0, 0.6),
        "upper_leg": (0.5, 0.7), "lower_leg": (0.6, 0.7), "foot": (0.6, 0.3),
    }  # fmt: skip
    for side in ("left", "right"):
        for name, (twist, fold) in bends.items():
            ranges[f"{side}_{name}_twist"] = (-twist, twist)
            ranges[f"{side}_{name}_fold"] = (-fold, fold)
    return ranges


def _degrees(lower: float, upper: float) -> Range:
    return math.radians(lower), math.radians(upper)


SCENES = {
    "cubebot": Scene(_cubebot_joints(), upright=False),
    "viking_lander": Scene(
        {
            "antenna_azimuth": _degrees(-160, 160),
            "antenna_elevation": _degrees(5, 70),
            "sampler_azimuth": _degrees(-70, 70),
            "sampler_elevation": _degrees(-20, 12),
            "sampler_extension": (0.5, 2.2),
            "meteorology_hinge": _degrees(95, 128),
        }
    ),
    "door": Scene({"leaf_hinge": _degrees(35, 100), "handle_turn": _degrees(0, 35)}, front=1.0),
    "cabinet": Scene(
        {
            "left_door_hinge": _degrees(20, 100),
            "right_door_hinge": _degrees(20, 85),
            "upper_drawer_slide": (0.06, 0.28),
            "lower_drawer_slide": (0.06, 0.28),
        },
        front=0.9,
    ),
    "laptop": Scene({"lid_hinge": _degrees(75, 125)}, front=1.0),
    "excavator": Scene(
        {
            "swing": _degrees(-170, 170),
            "boom_lift": (-0.45, 0.40),
            "stick_reach": (-0.70, 0.60),
            "bucket_curl": (-0.50, 1.00),
            "blade_lift": (0.0, 0.35),
        }
    ),
}

FIRST_SEED = {"full": 1, "single": 2}
_SEED_STEP = 1000
_MAX_DRAWS = 500
_GROUND = -0.001


def write_scans(folder: Path) -> None:
    """Write full.ply and single.ply with their truths into `folder`/scans, for the model in `folder`."""
    model = ArticulatedModel.from_urdf(folder / f"{folder.name}.urdf")
    collides = collision_check(model)
    for tier, seed in FIRST_SEED.items():
        scene = SCENES[folder.name]
        state = draw_state(model, scene, seed, collides)
        simulated = _scan(model, scene, state, tier, seed)
        origin = simulated.view_origins[0].tolist() if tier == "single" else None
        points = simulated.scan.points.astype(np.float32)
        write_ply(folder / "scans" / f"{tier}.ply", points, sensor_origin=origin)
        truth = simulated.state.to_dict()
        if origin is not None:
            truth["sensor_origin"] = origin
        files.write_text(folder / "scans" / f"{tier}_truth.json", json.dumps(truth, indent=2) + "\n")


def draw_state(model: ArticulatedModel, scene: Scene, seed: int, collides: Callable[[dict[str, float]], bool]) -> State:
    """Draw joints until no two parts meet and nothing is under the ground, then a base placement."""
    rng = np.random.default_rng([seed, *model.name.encode()])
    for _ in range(_MAX_DRAWS):
        joints = {name: round(float(rng.uniform(low, high)), 6) for name, (low, high) in scene.joints.items()}
        if not collides(joints) and not (scene.upright and _lowest(model, joints) < _GROUND):
            return State(_base(scene, rng), joints, model.root_link)
    raise RuntimeError(f"{model.name}: no pose without a collision in {_MAX_DRAWS} draws")


def _base(scene: Scene, rng: np.random.Generator) -> np.ndarray:
    T = np.eye(4)
    if scene.upright:
        T[:3, :3] = rotation_about(np.array([0.0, 0.0, 1.0]), rng.uniform(-np.pi, np.pi))
        T[:3, 3] = [*rng.uniform(-2.0, 2.0, 2), rng.uniform(-1.5, 0.0)]
    else:
        T[:3, :3] = Rotation.from_quat(rng.normal(size=4)).as_matrix()
        T[:3, 3] = rng.uniform(-0.5, 0.5, 3)
    return T


def _lowest(model: ArticulatedModel, joints: dict[str, float]) -> float:
    placements = model.part_placements(model.values(joints))
    return min(
        float((part.vertices @ T[2, :3] + T[2, 3]).min())
        for part, T in zip(model.parts, placements, strict=True)
        if len(part.vertices)
    )


def _scan(model: ArticulatedModel, scene: Scene, state: State, tier: str, seed: int) -> SimulatedScan:
    """Scan from all sides, or from the first view that a person standing before the model could have."""
    simulated = simulate(model, state, TIERS[tier], seed)
    while tier == "single" and not _is_view_of_a_person(scene, state, simulated):
        seed += _SEED_STEP
        simulated = simulate(model, state, TIERS[tier], seed)
    return simulated


def _is_view_of_a_person(scene: Scene, state: State, simulated: SimulatedScan) -> bool:
    if not scene.upright:
        return True
    towards = state.T_scan_base[:3, :3].T @ (simulated.view_origins[0] - simulated.scan.points.mean(axis=0))
    elevation = math.atan2(towards[2], math.hypot(towards[0], towards[1]))
    return 0.15 < elevation < 0.8 and abs(math.atan2(towards[1], towards[0])) <= scene.front


def collision_check(model: ArticulatedModel) -> Callable[[dict[str, float]], bool]:
    """Return a test of whether two parts' surfaces meet at given joint values.

    Neighbours in the tree and parts that touch at rest are let off: hinges, nested tubes, adjoining thighs.
    """
    import coal  # type: ignore[import-untyped]

    bodies: dict[int, coal.BVHModelOBBRSS] = {}
    for index, part in enumerate(model.parts):
        if len(part.faces):
            body = coal.BVHModelOBBRSS()
            body.beginModel(len(part.faces), len(part.vertices))
            body.addVertices(part.vertices)
            body.addTriangles(part.faces)
            body.endModel()
            bodies[index] = body

    def solid_parent(index: int) -> int:
        parent = model.parts[index].parent
        return parent if parent < 0 or parent in bodies else solid_parent(parent)

    def meeting(joints: dict[str, float], pairs: list[tuple[int, int]]) -> list[tuple[int, int]]:
        placements = [coal.Transform3s(T[:3, :3], T[:3, 3]) for T in model.part_placements(model.values(joints))]
        found = []
        for first, second in pairs:
            result = coal.CollisionResult()
            coal.collide(
                bodies[first],
                placements[first],
                bodies[second],
                placements[second],
                coal.CollisionRequest(),
                result,
            )
            if result.isCollision():
                found.append((first, second))
        return found

    pairs = [(i, j) for i in bodies for j in bodies if i < j and solid_parent(j) != i]
    at_rest = set(meeting(model.neutral(), pairs))
    pairs = [pair for pair in pairs if pair not in at_rest]
    return lambda joints: bool(meeting(joints, pairs))
