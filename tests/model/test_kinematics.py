"""Kinematics against yourdfpy, Pinocchio and finite differences: 12 robots and random trees."""

from __future__ import annotations

import io
import logging
import pickle
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pinocchio
import pytest
import trimesh
import yourdfpy
from urdf_text import joint, link, mimic

from pwralign_kin import se3
from pwralign_kin.exceptions import StateError, UnknownNameError
from pwralign_kin.model import ArticulatedModel
from pwralign_kin.state import State

logging.getLogger("yourdfpy").setLevel(logging.ERROR)


def second_opinion(model: ArticulatedModel, meshes: bool = False) -> yourdfpy.URDF:
    """yourdfpy's reading: of the original file with its meshes, or of the normalised text."""
    source = str(model.urdf_path) if meshes else io.BytesIO(model.normalised_urdf.encode())
    share = next((folder for folder in model.urdf_path.parents if folder.name == "share"), model.urdf_path.parent)

    def resolve(fname: str) -> str:
        name = fname.removeprefix("package://")
        return str((share if name != fname else model.urdf_path.parent) / name)

    return yourdfpy.URDF.load(source, filename_handler=resolve, load_meshes=meshes)


def check_against_yourdfpy(model: ArticulatedModel, opinion: yourdfpy.URDF, rng: np.random.Generator) -> None:
    assert opinion.base_link == model.root_link
    assert tuple(opinion.actuated_joint_names) == model.joint_names
    for _ in range(5):
        values = rng.uniform(model.lower, model.upper)
        opinion.update_cfg(values)
        for name, T in model.link_placements(values).items():
            assert opinion.get_transform(name, model.root_link) == pytest.approx(T, abs=1e-9)


def check_jacobians(model: ArticulatedModel, rng: np.random.Generator) -> None:
    """Central differences of the placements, turned into twists in root axes."""
    values, step = rng.uniform(model.lower, model.upper), 1e-6
    J = model.part_jacobians(values)
    assert J.shape == (len(model.parts), 6, len(values))
    T = model.part_placements(values)
    for index in range(len(values)):
        ahead, behind = values.copy(), values.copy()
        ahead[index] += step
        behind[index] -= step
        dT = (model.part_placements(ahead) - model.part_placements(behind)) / (2 * step)
        spin = dT[:, :3, :3] @ np.swapaxes(T[:, :3, :3], 1, 2)
        angular = np.stack([spin[:, 2, 1], spin[:, 0, 2], spin[:, 1, 0]], axis=1)
        assert J[:, :3, index] == pytest.approx(angular, abs=1e-7)
        assert J[:, 3:, index] == pytest.approx(dT[:, :3, 3], abs=1e-7)


# ---- the 12 robots


def test_robots(robot: Path, rng: np.random.Generator) -> None:
    model = ArticulatedModel.from_urdf(robot)
    opinion = second_opinion(model, meshes=True)
    check_against_yourdfpy(model, opinion, rng)
    check_against_yourdfpy(model, second_opinion(model), rng)
    check_jacobians(model, rng)
    check_geometry(model, opinion)


def check_geometry(model: ArticulatedModel, opinion: yourdfpy.URDF) -> None:
    """The same bounding box and area per part as yourdfpy's scene, and the same diagonal."""
    values = np.zeros(len(model.joint_names))
    opinion.update_cfg(values)
    assert model.diagonal == pytest.approx(float(np.linalg.norm(opinion.scene.extents)), rel=1e-9)
    meshes: dict[int, list[trimesh.Trimesh]] = {}
    placements = model.part_placements(values)
    for node in opinion.scene.graph.nodes_geometry:
        T, name = opinion.scene.graph[node]
        link = node
        while link not in model.T_part_link:
            link = opinion.scene.graph.transforms.parents[link]
        part = model.T_part_link[link][0]
        mesh = trimesh.Trimesh(opinion.scene.geometry[name].vertices, opinion.scene.geometry[name].faces, process=False)
        meshes.setdefault(part, []).append(mesh.apply_transform(se3.inverse(placements[part]) @ T))
    assert set(meshes) == {index for index, part in enumerate(model.parts) if len(part.faces)}
    for index, pieces in meshes.items():
        part, whole = model.parts[index], trimesh.util.concatenate(pieces)
        used = part.vertices[np.unique(part.faces)]
        assert np.array([used.min(axis=0), used.max(axis=0)]) == pytest.approx(whole.bounds, abs=1e-6)
        assert trimesh.Trimesh(part.vertices, part.faces, process=False).area == pytest.approx(whole.area, rel=1e-6)


def test_limits_lie_within_the_urdfs(robot: Path) -> None:
    model = ArticulatedModel.from_urdf(robot)
    opinion = second_opinion(model)
    assert (model.lower <= model.upper).all() and (model.upper - model.lower <= 2 * np.pi + 1e-12).all()
    for name, lower, upper in zip(model.joint_names, model.lower, model.upper, strict=True):
        limit = opinion.joint_map[name].limit
        if opinion.joint_map[name].type != "continuous":
            assert limit.lower - 1e-12 <= lower and upper <= limit.upper + 1e-12


# ---- random trees


def words(numbers: np.ndarray) -> str:
    return " ".join(map(str, numbers))


def random_urdf(rng: np.random.Generator, size: int) -> str:
    """A random tree of all joint types, with mimics of mimics."""
    text = [link(f"l{index}") for index in range(size)]
    followable: list[str] = []
    for index in range(1, size):
        kind = str(rng.choice(["revolute", "revolute", "continuous", "prismatic", "fixed", "planar", "floating"]))
        xyz, rpy, axis = rng.normal(size=3), rng.uniform(-3, 3, size=3), rng.normal(size=3)
        if rng.random() < 0.4:
            axis = rng.choice([-1, 1]) * rng.permutation([1.0, 0.0, 0.0])
        content = '<limit lower="-1.5" upper="2" effort="1" velocity="1"/>'
        content += f'<origin xyz="{words(xyz)}" rpy="{words(rpy)}"/><axis xyz="{words(axis)}"/>'
        if kind in ("revolute", "continuous", "prismatic"):
            if followable and rng.random() < 0.3:
                content += mimic(str(rng.choice(followable)), rng.uniform(-2, 2), rng.uniform(-0.3, 0.3))
            followable.append(f"j{index}")
        text.append(joint(f"j{index}", f"l{rng.integers(index)}", f"l{index}", kind, content))
    return "".join(text)


@pytest.mark.parametrize("seed", range(12))
def test_random_trees(read: Callable[..., ArticulatedModel], seed: int) -> None:
    rng = np.random.default_rng(seed)
    model = read(random_urdf(rng, 14))
    assert model.parts[0].parent == -1 and all(part.parent < index for index, part in enumerate(model.parts))
    check_against_yourdfpy(model, second_opinion(model), rng)
    check_jacobians(model, rng)


@pytest.mark.parametrize("links", [2, 3])
def test_trees_of_a_joint_or_two(read: Callable[..., ArticulatedModel], links: int, rng: np.random.Generator) -> None:
    """Pinocchio's Jacobians of one joint have another shape."""
    model = read(random_urdf(rng, links))
    check_against_yourdfpy(model, second_opinion(model), rng)
    check_jacobians(model, rng)


def test_random_trees_hold_every_kind_of_joint(read: Callable[..., ArticulatedModel]) -> None:
    """Otherwise the tests above would prove less than they say."""
    kinds: set[str] = set()
    for seed in range(12):
        kinematics = read(random_urdf(np.random.default_rng(seed), 14)).kinematics
        kinds |= {joint.shortname().removeprefix("JointModel") for joint in list(kinematics.model.joints)[1:]}
        kinds |= {"mimic"} if (np.abs(kinematics.A) > 0).sum(axis=0).max() > 1 else set()
    assert kinds >= {
        "RX",
        "RevoluteUnaligned",
        "RUBX",
        "RevoluteUnboundedUnaligned",
        "PX",
        "PrismaticUnaligned",
        "mimic",
    }


# ---- the rest of the kinematics


def test_pinocchio_agrees_on_the_original_urdf(wheel_folder: Path, rng: np.random.Generator) -> None:
    """Normalising changed nothing: Pinocchio's own reading of the original gives the same placements."""
    model = ArticulatedModel.from_urdf(wheel_folder / "ur_description/urdf/ur5_robot.urdf")
    original = pinocchio.buildModelFromUrdf(str(model.urdf_path))
    values, data = rng.uniform(model.lower, model.upper), original.createData()
    q = np.array([values[model.joint_names.index(name)] for name in list(original.names)[1:]])
    pinocchio.forwardKinematics(original, data, q)
    for part, T in zip(model.parts[1:], model.part_placements(values)[1:], strict=True):
        assert part.joint is not None
        assert data.oMi[original.getJointId(part.joint.name)].homogeneous == pytest.approx(T, abs=1e-12)


@pytest.fixture
def arm(read: Callable[..., ArticulatedModel]) -> ArticulatedModel:
    return read(random_urdf(np.random.default_rng(3), 8))


def test_values_by_name(arm: ArticulatedModel) -> None:
    first, second = arm.joint_names[:2]
    assert arm.values({second: 0.25}).tolist()[:2] == [arm.neutral()[first], 0.25]
    assert arm.values(arm.neutral()) == pytest.approx(arm.values({}))
    with pytest.raises(UnknownNameError, match="elbow") as caught:
        arm.values({"elbow": 1.0})
    assert caught.value.valid == arm.joint_names


def test_wrong_number_of_values(arm: ArticulatedModel) -> None:
    for method in (arm.part_placements, arm.part_jacobians, arm.link_placements):
        with pytest.raises(StateError, match="joint values"):
            method(np.zeros(len(arm.joint_names) + 1))


def test_root_placement_of_any_base_link(arm: ArticulatedModel, rng: np.random.Generator) -> None:
    values = rng.uniform(arm.lower, arm.upper)
    joints = dict(zip(arm.joint_names, values.tolist(), strict=True))
    T_scan_root = se3.from_twist(rng.normal(size=6))
    for name, T_root_link in arm.link_placements(values).items():
        state = State(T_scan_root @ T_root_link, joints, name)
        assert arm.root_placement(state) == pytest.approx(T_scan_root, abs=1e-9)
    assert arm.root_placement(State(T_scan_root, joints)) == pytest.approx(T_scan_root)
    with pytest.raises(UnknownNameError, match="tail"):
        arm.root_placement(State(T_scan_root, joints, "tail"))


def test_models_are_told_apart_and_print_short(arm: ArticulatedModel) -> None:
    assert len({arm, arm}) == 1 and arm == arm and arm != pickle.loads(pickle.dumps(arm))
    assert "j1" in repr(arm) and "\n" not in repr(arm) and len(repr(arm)) < 3000


def test_models_survive_pickling_and_threads(arm: ArticulatedModel, rng: np.random.Generator) -> None:
    states = [rng.uniform(arm.lower, arm.upper) for _ in range(200)]
    expected = [arm.part_placements(values) for values in states]
    copy = pickle.loads(pickle.dumps(arm))
    with ThreadPoolExecutor(4) as pool:
        for model in (arm, copy):
            assert np.array_equal(list(pool.map(model.part_placements, states)), expected)
