"""The methods that are compared: ours at each effort and while tracking, and what else there is.

Rigid methods get the model in one shape: with the joints of the guess, or 0. What needs a start besides gets the guess
too, or where there is none the result of a rigid registration without a start, for nothing: neither its time nor that
of anything that does not depend on the scan (samples, meshes) counts.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from types import MappingProxyType

import numpy as np

from pwralign_kin.arrays import Indices
from pwralign_kin.baselines.coherent_point_drift import deformable_drift, rigid_drift
from pwralign_kin.baselines.fpfh_ransac_icp import fpfh_ransac_icp
from pwralign_kin.baselines.kiss_matcher import kiss_matcher
from pwralign_kin.baselines.non_rigid_icp import carried, disjoint_mesh, fused_mesh, non_rigid_icp
from pwralign_kin.baselines.part_wise_rigid import PartWiseOptions, part_wise_rigid, rigid_fit
from pwralign_kin.baselines.rigid_gicp import rigid_gicp
from pwralign_kin.baselines.signed_distance_fit import SignedDistanceOptions, signed_distance_fit
from pwralign_kin.benchmark.cases import Case
from pwralign_kin.benchmark.metrics import Reference, Ruler
from pwralign_kin.benchmark.tracking import guess_off
from pwralign_kin.estimation import EstimatorOptions, estimate
from pwralign_kin.se3 import Array, transform
from pwralign_kin.state import State
from pwralign_kin.tracking import Tracker, TrackerOptions

VOXEL = 0.02
"""Cell of the downsampling of rigid methods, model diagonals."""

SOURCE_POINTS = 8000
"""Samples of the model's visible surface that rigid methods get, as many as the scans' points."""

FRAME_BEFORE = (1.0, 0.005, 0.03)
"""How far the frame before is off in the tracking step: base turned (degrees) and shifted (model diagonals), every
joint off (rad)."""


@dataclass(frozen=True)
class Placement:
    """Where a method puts the model."""

    T_scan_parts: Array
    """(parts, 4, 4); of parts that the method bends, their best rigid fits."""

    state: State | None = None
    """None: the method knows no joints."""

    surface: Mapping[int, Array] | None = None
    """By part, where the method puts the ruler's samples (n, 3), m, if it bends them."""


@dataclass(frozen=True)
class Task:
    """One scan as all methods get it."""

    case: Case
    ruler: Ruler
    reference: Reference
    threads: int

    @cached_property
    def target(self) -> Array:
        """(n, 3) points of the scan."""
        return np.array(self.case.scan.points)

    @cached_property
    def shape(self) -> Array:
        """(parts, 4, 4) placements of the parts in the root frame with the joints of the guess, or 0."""
        model, guess = self.ruler.model, self.case.guess
        return model.part_placements(model.values(guess.joints if guess else dict.fromkeys(model.joint_names, 0.0)))

    @cached_property
    def cloud(self) -> tuple[Array, Array]:
        """Points and normals (n, 3) of the visible surface in that shape, evenly spread, root frame, m."""
        random = np.random.default_rng(0)
        model = self.ruler.model
        areas = np.array([surface.area for surface in model.surfaces])
        counts = np.round(SOURCE_POINTS * areas / areas.sum()).astype(int)
        points, normals = [], []
        for T, surface, count in zip(self.shape, model.surfaces, counts, strict=True):
            chosen = random.permutation(len(surface.dense))[:count]
            points.append(transform(T, surface.dense[chosen].astype(float) * model.diagonal))
            normals.append(surface.dense_normals[chosen] @ T[:3, :3].T)
        return np.concatenate(points), np.concatenate(normals).astype(float)

    @cached_property
    def start(self) -> Array:
        """(4, 4) T_scan_root for what needs one: of the guess, or by a rigid registration that needs none."""
        if self.case.guess is not None:
            return self.ruler.model.root_placement(self.case.guess)
        return fpfh_ransac_icp(self.cloud[0], self.target, self.voxel)

    @cached_property
    def meshes(self) -> Mapping[str, tuple[Array, Indices]]:
        """The body in that shape, root frame, m: as one mesh of all parts, and as one connected surface."""
        parts = self.ruler.model.parts
        bodies = [(transform(T, part.vertices), part.faces) for T, part in zip(self.shape, parts, strict=True)]
        return {"disjoint": disjoint_mesh([own for own in bodies if len(own[1])]), "fused": fused_mesh(*self.cloud)}

    @property
    def voxel(self) -> float:
        """Cell of the downsampling, m."""
        return VOXEL * self.ruler.model.diagonal

    def rigid(self, T_scan_root: Array) -> Placement:
        """Return where a rigid method that finds this puts the model."""
        model, guess = self.ruler.model, self.case.guess
        joints = guess.joints if guess else dict.fromkeys(model.joint_names, 0.0)
        return Placement(T_scan_root @ self.shape, State(T_scan_root, joints, model.root_link))

    def posed(self, state: State) -> Placement:
        """Return where a state puts the model."""
        return Placement(self.ruler.placements(state), state)

    def bent(self, move: Callable[[Array], Array]) -> Placement:
        """Return where a method puts the model that moves each point of its surface (n, 3) in the start for itself."""
        started = self.start @ self.shape
        parts = list(self.ruler.samples)
        before = [transform(started[part], self.ruler.samples[part]) for part in parts]
        after = np.split(move(np.concatenate(before)), np.cumsum([len(points) for points in before])[:-1])
        T = started.copy()
        for part, old, new in zip(parts, before, after, strict=True):
            T[part] = rigid_fit(old, new) @ started[part]
        return Placement(T, surface=dict(zip(parts, after, strict=True)))


Run = Callable[[], Placement]


@dataclass(frozen=True)
class Contender:
    """A method that is compared."""

    title: str
    prepare: Callable[[Task, int], Run]
    """Does what does not count, and returns what does; takes a seed."""

    bends: bool = False
    """Whether it moves every point of the surface for itself."""


def _ours(effort: str) -> Callable[[Task, int], Run]:
    options = EstimatorOptions(effort=effort)  # type: ignore[arg-type]  # checked by the estimator

    def prepare(task: Task, seed: int) -> Run:
        own = replace(options, seed=seed, threads=task.threads)
        return lambda: task.posed(estimate(task.ruler.model, task.case.scan, task.case.guess, options=own).state)

    return prepare


def _tracking_step(task: Task, seed: int) -> Run:
    model, scan = task.ruler.model, task.case.scan
    degrees, shift, joint = FRAME_BEFORE
    before = guess_off(model, task.case.truth, (degrees, shift * model.diagonal, joint), seed)
    options = TrackerOptions(estimator=EstimatorOptions(seed=seed, threads=task.threads))
    tracker = Tracker(model, options, before)
    tracker.update(scan, 0.0)
    return lambda: task.posed(tracker.update(scan, 1.0 / 30.0).state)


def _open3d(task: Task, seed: int) -> Run:
    del seed  # it has none
    source = task.cloud[0]
    return lambda: task.rigid(fpfh_ransac_icp(source, task.target, task.voxel))


def _kiss_matcher(task: Task, seed: int) -> Run:
    del seed  # it has none
    source = task.cloud[0]
    return lambda: task.rigid(kiss_matcher(source, task.target, task.voxel))


def _small_gicp(task: Task, seed: int) -> Run:
    del seed  # it has none
    source, start = transform(task.start, task.cloud[0]), task.start
    return lambda: task.rigid(rigid_gicp(source, task.target, task.voxel, task.threads) @ start)


def _rigid_drift(task: Task, seed: int) -> Run:
    source, start = transform(task.start, task.cloud[0]), task.start
    return lambda: task.rigid(rigid_drift(source, task.target, seed) @ start)


def _deformable_drift(task: Task, seed: int) -> Run:
    source = transform(task.start, task.cloud[0])
    return lambda: task.bent(deformable_drift(source, task.target, seed))


def _non_rigid_icp(kind: str) -> Callable[[Task, int], Run]:
    def prepare(task: Task, seed: int) -> Run:
        del seed  # it has none
        vertices, faces = task.meshes[kind]
        placed = transform(task.start, vertices)

        def run() -> Placement:
            moved = non_rigid_icp(placed, faces, task.target)
            return task.bent(lambda points: carried(points, placed, faces, moved))

        return run

    return prepare


def _part_wise(task: Task, seed: int) -> Run:
    options = PartWiseOptions(seed=seed)
    return lambda: Placement(part_wise_rigid(task.ruler.model, task.case.scan, task.case.guess, options).T_scan_parts)


def _signed_distances(task: Task, seed: int) -> Run:
    options = SignedDistanceOptions(seed=seed)
    return lambda: task.posed(signed_distance_fit(task.ruler.model, task.target, task.case.guess, options))


OURS = "default"

CONTENDERS: Mapping[str, Contender] = MappingProxyType(
    {
        "fast": Contender("pwralign_kin, effort fast", _ours("fast")),
        OURS: Contender("pwralign_kin", _ours("default")),
        "thorough": Contender("pwralign_kin, effort thorough", _ours("thorough")),
        "tracking": Contender("pwralign_kin, tracking step", _tracking_step),
        "open3d": Contender("Open3D: FPFH, RANSAC, ICP (rigid)", _open3d),
        "kiss-matcher": Contender("KISS-Matcher (rigid)", _kiss_matcher),
        "small-gicp": Contender("small_gicp (rigid)", _small_gicp),
        "cpd-rigid": Contender("pycpd: rigid drift", _rigid_drift),
        "cpd": Contender("pycpd: deformable drift", _deformable_drift, bends=True),
        "nricp": Contender("trimesh: non-rigid ICP, parts apart", _non_rigid_icp("disjoint"), bends=True),
        "nricp-fused": Contender("trimesh: non-rigid ICP, fused", _non_rigid_icp("fused"), bends=True),
        "part-wise": Contender("part-wise rigid (PWR-Align)", _part_wise),
        "scipy": Contender("SciPy: signed distances", _signed_distances),
    }
)
