"""Part-wise rigid registration in the manner of PWR-Align (Jha and Banerjee, arXiv:2306.06717), for comparison.

A graph of rigid parts; corresponding points by features; a rigid fit of the whole body; then part by part in
decreasing size RANSAC and ICP, each in its region of interest, with the junctions to parts placed before tied. The
parts stay bodies of their own: nothing holds them at their joints but the tie, so joints open.

Lengths are in model diagonals about the scan's centre until the result is put together.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pwralign_kin.checked_options import Cell, CheckedOptions, Count, NotNegative, Positive, Seed, Share
from pwralign_kin.estimation.knowledge.correspondences import fpfh
from pwralign_kin.estimation.sensing.observation import Observation, ObservationOptions
from pwralign_kin.estimation.sensing.preparation import observe
from pwralign_kin.exceptions import ScanError
from pwralign_kin.model import ArticulatedModel
from pwralign_kin.scan import Scan
from pwralign_kin.se3 import Array, inverse, transform
from pwralign_kin.state import State

_MOST_SCORED = 3000
"""Minimal samples that a RANSAC scores."""

_NO_TIES = np.empty((0, 2, 3))


@dataclass(frozen=True)
class PartWiseOptions(CheckedOptions):
    """Settings. Lengths in model diagonals."""

    spacing: Cell = 0.015
    """Cell of the model's downsampling; ..."""
    least_points: Count = 50
    """... a part keeps at least so many points where it has them."""
    feature_radius: Positive = 0.1
    least_correspondences: Count = 8
    """Below this a part is skipped: it moves with the neighbour placed before."""
    largest_gap: NotNegative = 0.03
    """A part whose junction would open wider is skipped."""
    tie: NotNegative = 0.5
    """Weight of a junction in ICP, against 1 of all points of the part together."""
    inlier: Positive = 0.03
    """Distance at which RANSAC counts a correspondence."""
    samples: Count = 40000
    """Minimal samples of the whole body's RANSAC; a part draws a quarter."""
    edge_similarity: Share = 0.9
    """Samples whose side lengths agree less are dropped unseen."""
    icp_distances: tuple[Positive, ...] = (0.08, 0.04, 0.02)
    """Farthest pairs of ICP, coarse to fine, ..."""
    icp_iterations: Count = 15
    """... with so many iterations each, or fewer when no entry of the placement changes by this."""
    icp_tolerance: NotNegative = 1e-4
    seed: Seed = 0


@dataclass(frozen=True)
class Opening:
    """How far one joint is open."""

    gap: float
    """Distance of the joint's two sides, m; for a slide, across its axis."""
    tilt: float
    """Angle between the joint's axis on both sides, rad; NaN where several joints follow each other."""


@dataclass(frozen=True)
class PartWiseRigid:
    """Where the parts were put."""

    T_scan_parts: Array
    """(parts, 4, 4)."""
    skipped: tuple[str, ...]
    """Parts that moved with a neighbour."""
    openings: Mapping[str, Opening]
    """By the joint (the last of several) between two parts with geometry."""


@dataclass(frozen=True)
class _Body:
    """The model in its starting shape, as points."""

    points: Array
    """(n, 3) in the root frame."""
    local: Array
    """(n, 3) in the frames of their parts."""
    part: NDArray[np.int64]
    """(n,)."""
    target: Array
    """(n, 3) the scan point with the most similar feature."""
    matched: NDArray[np.bool_]
    """(n,) whether that scan point's most similar feature is of the same part."""


def part_wise_rigid(
    model: ArticulatedModel, scan: Scan, initial: State | None = None, options: PartWiseOptions | None = None
) -> PartWiseRigid:
    """Place the parts of `model` in `scan`.

    The body starts with all joints 0, or as `initial` has it; then its whole-body fit is ICP from there. Raises
    `ScanError` when the scan holds too little. The same seed gives the same placements.
    """
    options = options or PartWiseOptions()
    random = np.random.default_rng(options.seed)
    observation = observe(scan, model.diagonal, ObservationOptions(), 1)
    values = model.values(initial.joints if initial else dict.fromkeys(model.joint_names, 0.0))
    start = _scaled(model.part_placements(values), model.diagonal)
    body = _body(model, start, observation, options)
    whole = _whole_body(model, body, observation, initial, options, random)
    placed, skipped = _part_by_part(model, body, whole @ start, observation, options, random)
    T_scan_parts = observation.to_scan(placed)
    return PartWiseRigid(T_scan_parts, tuple(model.parts[i].name for i in skipped), openings(model, T_scan_parts))


def openings(model: ArticulatedModel, T_scan_parts: Array) -> dict[str, Opening]:
    """Return how far the joints between placed parts (parts, 4, 4) are open.

    Of joints in a row without geometry between them the last stands for all.
    """
    found = {}
    for junction in _junctions(model):
        part = model.parts[junction.child]
        joint = part.joint
        assert joint is not None  # every part below another has one
        T_scan_parent, T_scan_child = T_scan_parts[junction.parent], T_scan_parts[junction.child]
        tilt = float("nan")
        gap = np.linalg.norm(transform(T_scan_parent, junction.pivot[None])[0] - T_scan_child[:3, 3])
        if part.parent == junction.parent:
            T = inverse(T_scan_parent @ joint.T_parent_joint) @ T_scan_child
            axis = T[:3, :3] @ joint.axis
            tilt = float(np.arctan2(np.linalg.norm(np.cross(axis, joint.axis)), axis @ joint.axis))
            if joint.kind == "prismatic":
                gap = np.linalg.norm(np.cross(T[:3, 3], joint.axis))
        elif not junction.fixed:
            continue
        found[joint.name] = Opening(float(gap), tilt)
    return found


@dataclass(frozen=True)
class _Junction:
    """Two parts with geometry that hang together, over one joint or several."""

    parent: int
    child: int
    pivot: Array
    """(3,) the origin of the child in the frame of the parent, with all joints 0, m."""
    fixed: bool
    """Whether it stays there whatever the joints do."""


def _junctions(model: ArticulatedModel) -> list[_Junction]:
    """Return the junctions of all parts with geometry."""
    found = []
    random = np.random.default_rng(0)
    count = len(model.joint_names)
    at_zero, *moved = (model.part_placements(values) for values in (np.zeros(count), *random.normal(size=(2, count))))
    for index, part in enumerate(model.parts):
        parent = part.parent
        while parent >= 0 and not len(model.parts[parent].faces):
            parent = model.parts[parent].parent
        if parent >= 0 and len(part.faces):
            pivot, *others = ((inverse(T[parent]) @ T[index])[:3, 3] for T in (at_zero, *moved))
            fixed = all(np.allclose(other, pivot, atol=1e-6 * model.diagonal) for other in others)
            found.append(_Junction(parent, index, pivot, fixed))
    return found


def _body(model: ArticulatedModel, start: Array, observation: Observation, options: PartWiseOptions) -> _Body:
    """Downsample the model and match its features to the scan's."""
    from scipy.spatial.distance import cdist

    points, local, normals, part = [], [], [], []
    for index, surface in enumerate(model.surfaces):
        if surface.exists:
            kept = _thinned(surface.dense, options)
            local.append(surface.dense[kept].astype(float))
            points.append(transform(start[index], local[-1]))
            normals.append(surface.dense_normals[kept] @ start[index][:3, :3].T)
            part.append(np.full(len(kept), index))
    source, owner = np.concatenate(points), np.concatenate(part)
    of_model = fpfh(source, np.concatenate(normals), options.feature_radius)
    of_scan = fpfh(observation.points, observation.normals, options.feature_radius)
    apart = cdist(of_model, of_scan)
    nearest, back = apart.argmin(axis=1), apart.argmin(axis=0)
    mutual = owner[back[nearest]] == owner
    return _Body(source, np.concatenate(local), owner, observation.points[nearest].astype(float), mutual)


def _thinned(points: NDArray[np.float32], options: PartWiseOptions) -> NDArray[np.int64]:
    """Return one point of each cell; of smaller cells where a part would keep too few."""
    cell = options.spacing
    while True:
        _, kept = np.unique(np.floor(points / cell).astype(np.int64), axis=0, return_index=True)
        if len(kept) >= min(options.least_points, len(points)):
            return np.sort(kept)
        cell /= 1.5


def _whole_body(
    model: ArticulatedModel,
    body: _Body,
    observation: Observation,
    initial: State | None,
    options: PartWiseOptions,
    random: np.random.Generator,
) -> Array:
    """Return the placement of the body as one rigid thing."""
    from scipy.spatial import cKDTree

    if initial is not None:
        T = observation.to_search(model.root_placement(initial))
    else:
        own = body.matched
        T, inliers = _ransac(body.points[own], body.target[own], _NO_TIES, options.samples, options, random)
        if inliers < options.least_correspondences:
            raise ScanError("scan", "too few features of the model are found in it")
    return _icp(body.points, cKDTree(observation.points), T, _NO_TIES, options)


def _part_by_part(
    model: ArticulatedModel,
    body: _Body,
    whole: Array,
    observation: Observation,
    options: PartWiseOptions,
    random: np.random.Generator,
) -> tuple[Array, list[int]]:
    """Return the placements (parts, 4, 4) of all parts, `whole` as tuned, and which parts were skipped."""
    placed, done, skipped = whole.copy(), list[int](), list[int]()
    junctions = _junctions(model)
    surfaces = [part for part, own in enumerate(model.parts) if len(own.faces)]
    for part in sorted(surfaces, key=lambda part: -model.parts[part].size):
        own = [junction for junction in junctions if part in (junction.parent, junction.child)]
        tied = [junction for junction in own if {junction.parent, junction.child} <= {part, *done}]
        ties = np.array([_tie(model, junction, part, placed) for junction in tied if junction.fixed])
        if tied:
            beside = tied[0].child if tied[0].parent == part else tied[0].parent
            placed[part] = placed[beside] @ inverse(whole[beside]) @ whole[part]
        T = _tuned(body, part, whole[part], placed[part], observation, ties.reshape(-1, 2, 3), options, random)
        if T is None:
            skipped.append(part)
        else:
            placed[part] = T
        done.append(part)
    return placed, skipped


def _tuned(
    body: _Body,
    part: int,
    whole: Array,
    beside: Array,
    observation: Observation,
    ties: Array,
    options: PartWiseOptions,
    random: np.random.Generator,
) -> Array | None:
    """Return the placement of one part, None where it is to be skipped.

    Kinder to the method than its description: what RANSAC finds must lie on the scan better than the part does
    where its neighbour takes it (`beside`).
    """
    from scipy.spatial import cKDTree

    own = body.part == part
    paired = own & body.matched
    if paired.sum() < options.least_correspondences:
        return None
    seeds = np.concatenate([transform(whole, body.local[own]), body.target[paired]])
    scan = observation.points.astype(float)
    region = scan[((scan >= seeds.min(axis=0)) & (scan <= seeds.max(axis=0))).all(axis=1)]
    samples = options.samples // 4
    T, inliers = _ransac(body.local[paired], body.target[paired], ties, samples, options, random)
    if inliers < options.least_correspondences:
        return None
    tree = cKDTree(region)
    choices = [_icp(body.local[own], tree, start, ties, options) for start in (T, beside)]
    T = max(choices, key=lambda choice: _overlap(body.local[own], tree, choice, options))
    gaps = np.linalg.norm(transform(T, ties[:, 0]) - ties[:, 1], axis=1)
    return None if (gaps > options.largest_gap).any() else T


def _tie(model: ArticulatedModel, junction: _Junction, part: int, placed: Array) -> Array:
    """Return (2, 3) where the junction is in the frame of `part`, and where the part placed before has it."""
    pivot, origin = junction.pivot / model.diagonal, np.zeros(3)
    own, other, T_other = (
        (pivot, origin, placed[junction.child]) if junction.parent == part else (origin, pivot, placed[junction.parent])
    )
    return np.stack([own, transform(T_other, other[None])[0]])


def _ransac(
    source: Array, target: Array, ties: Array, samples: int, options: PartWiseOptions, random: np.random.Generator
) -> tuple[Array, int]:
    """Return the motion (4, 4) that most of the pairs (n, 3) agree on, and how many do.

    Every minimal sample holds the ties (k, 2, 3) and as many pairs as three points need.
    """
    drawn = random.integers(len(source), size=(samples, max(3 - len(ties), 1)))
    tied = np.broadcast_to(ties, (samples, *ties.shape))
    sources = np.concatenate([tied[:, :, 0], source[drawn]], axis=1)
    targets = np.concatenate([tied[:, :, 1], target[drawn]], axis=1)
    sides = [np.linalg.norm(points - np.roll(points, 1, axis=1), axis=2) for points in (sources, targets)]
    shorter, longer = np.minimum(*sides), np.maximum(*sides)
    alike = np.flatnonzero(((shorter >= options.edge_similarity * longer) & (shorter > 1e-6)).all(axis=1))
    alike = alike[:_MOST_SCORED]
    if len(alike) == 0:
        return np.eye(4), 0
    motions = _rigid(sources[alike], targets[alike], np.ones(sources.shape[1]))
    counts = np.concatenate([_agreeing(source, target, T, options.inlier).sum(axis=1) for T in _chunks(motions)])
    best = motions[int(counts.argmax())]
    agreeing = _agreeing(source, target, best[None], options.inlier)[0]
    if agreeing.sum() < 3:
        return best, int(agreeing.sum())
    pairs = np.concatenate([np.stack([source, target], axis=1)[agreeing], ties])
    return _rigid(pairs[None, :, 0], pairs[None, :, 1], np.ones(len(pairs)))[0], int(agreeing.sum())


def _chunks(motions: Array, size: int = 100) -> list[Array]:
    return [motions[start : start + size] for start in range(0, len(motions), size)]


def _agreeing(source: Array, target: Array, motions: Array, distance: float) -> NDArray[np.bool_]:
    """Return (m, n) which pairs (n, 3) each motion (m, 4, 4) brings together."""
    moved = np.einsum("mij,nj->mni", motions[:, :3, :3], source) + motions[:, None, :3, 3]
    return np.asarray(((moved - target) ** 2).sum(axis=2) < distance**2)


def _icp(source: Array, tree: Any, T: Array, ties: Array, options: PartWiseOptions) -> Array:
    """Return `T` tuned by point-to-point ICP (Besl and McKay, 1992), the junctions held by their weight."""
    for distance in options.icp_distances:
        for _ in range(options.icp_iterations):
            away, nearest = tree.query(transform(T, source), distance_upper_bound=distance)
            near = np.isfinite(away)
            if near.sum() < 3:
                return T
            pairs = np.concatenate([np.stack([source[near], tree.data[nearest[near]]], axis=1), ties])
            weights = np.concatenate([np.full(near.sum(), 1.0 / near.sum()), np.full(len(ties), options.tie)])
            before, T = T, _rigid(pairs[None, :, 0], pairs[None, :, 1], weights)[0]
            if np.abs(T - before).max() < options.icp_tolerance:
                break
    return T


def _overlap(source: Array, tree: Any, T: Array, options: PartWiseOptions) -> float:
    """Return the share of the placed points that lie on the scan."""
    away, _ = tree.query(transform(T, source), distance_upper_bound=options.icp_distances[-1])
    return float(np.isfinite(away).mean())


def rigid_fit(source: Array, target: Array) -> Array:
    """Return the motion (4, 4) that brings points (n, 3) nearest to others (n, 3)."""
    return np.asarray(_rigid(source[None], target[None], np.ones(len(source)))[0])


def _rigid(source: Array, target: Array, weights: Array) -> Array:
    """Return the motions (m, 4, 4) that bring points (m, n, 3) nearest to others (Kabsch, 1976; Umeyama, 1991)."""
    share = weights / weights.sum()
    middle, goal = np.einsum("n,mni->mi", share, source), np.einsum("n,mni->mi", share, target)
    spread = np.einsum("n,mni,mnj->mij", share, target - goal[:, None], source - middle[:, None])
    U, _, Vt = np.linalg.svd(spread)
    U[:, :, 2] *= np.linalg.det(U @ Vt)[:, None]
    T = np.tile(np.eye(4), (len(source), 1, 1))
    T[:, :3, :3] = U @ Vt
    T[:, :3, 3] = goal - np.einsum("mij,mj->mi", T[:, :3, :3], middle)
    return T


def _scaled(T: Array, diagonal: float) -> Array:
    """Return placements (..., 4, 4) with lengths in diagonals."""
    out = T.copy()
    out[..., :3, 3] /= diagonal
    return out
