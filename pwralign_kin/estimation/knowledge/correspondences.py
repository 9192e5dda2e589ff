"""Correspondences between model and scan: the built-in FPFH matcher, and the reader for any outside matcher."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from pwralign_kin.arrays import Singles
from pwralign_kin.checked_options import CheckedOptions, Count, Positive
from pwralign_kin.dependencies import open3d
from pwralign_kin.estimation.sensing.observation import Observation
from pwralign_kin.exceptions import CorrespondenceError, ScanError
from pwralign_kin.files import check_path
from pwralign_kin.model import ArticulatedModel
from pwralign_kin.read_only import ReadOnly
from pwralign_kin.scan.readers import member, numpy_content
from pwralign_kin.se3 import Array, inverse, transform

ASTRAY = 0.05
"""Distance (model diagonals) of a pair's points from the model or the prepared scan from which it says nothing."""


@dataclass(frozen=True, eq=False)
class Correspondences(ReadOnly):
    """Pairs of a point on the model and the scan point it is believed to be.

    Raises `CorrespondenceError` when shapes do not match, values are not finite or no weight is positive.
    """

    source: Array
    """(n, 3) on the model with all joint values 0, in the root link's frame, m."""
    target: Array
    """(n, 3) in the scan frame, m."""
    weight: Array
    """(n,) >= 0."""

    def __post_init__(self) -> None:
        """Check and convert the arrays."""
        for name in ("source", "target", "weight"):
            try:
                value = np.array(getattr(self, name), dtype=np.float64)
            except (TypeError, ValueError):
                raise CorrespondenceError("correspondences", f"{name} is not an array of numbers") from None
            if not np.isfinite(value).all():
                raise CorrespondenceError("correspondences", f"{name} holds values that are not finite")
            object.__setattr__(self, name, value)
        super().__post_init__()
        count = self.weight.size
        if self.source.shape != (count, 3) or self.target.shape != (count, 3) or self.weight.shape != (count,):
            raise CorrespondenceError(
                "correspondences",
                f"expected source (n, 3), target (n, 3) and weight (n,), got {self.source.shape}, "
                f"{self.target.shape} and {self.weight.shape}",
            )
        if count < 2 or (self.weight < 0).any() or np.count_nonzero(self.weight) < 2:
            raise CorrespondenceError(
                "correspondences", "at least two pairs of positive weight are needed, none negative"
            )

    @classmethod
    def load(cls, path: Path | str) -> Correspondences:
        """Read an NPZ file with arrays `source`, `target` and optionally `weight`.

        Raises `CorrespondenceError` naming the file and what is wrong.
        """
        check_path(path, partial(CorrespondenceError, "correspondences"))
        try:
            archive = numpy_content(Path(path).read_bytes(), Path(path), b"PK")
            missing = {"source", "target"} - set(archive.files)
            if missing:
                raise CorrespondenceError(path, f"no array named {' or '.join(sorted(missing))}")
            names = {"source", "target", "weight"} & set(archive.files)
            arrays = {name: member(archive, name, Path(path)) for name in names}
            arrays.setdefault("weight", np.ones(arrays["source"].shape[:1]))
            return cls(**arrays)
        except OSError as error:
            raise CorrespondenceError(path, f"cannot read: {error.strerror or error}") from None
        except (CorrespondenceError, ScanError) as error:
            raise CorrespondenceError(path, error.fault) from None


@dataclass(frozen=True)
class FpfhMatcher(CheckedOptions):
    """Fast point feature histograms (Rusu et al., ICRA 2009) of every part on its own, matched to the scan's."""

    radius: Positive = 0.08
    """Feature neighbourhood, model diagonals."""
    samples: Count = 400
    """Model points per part."""
    matches: Count = 3
    """Scan points offered to each model point."""

    def match(self, model: ArticulatedModel, observation: Observation, parts: Sequence[int]) -> Correspondences:
        """Return the nearest scan points in feature space, weighted by how near they are."""
        from scipy.spatial import cKDTree

        # Known surroundings shape the features of what touches them, but are not the model.
        searched = np.flatnonzero(observation.regions >= 0)
        tree = cKDTree(fpfh(observation.points, observation.normals, self.radius)[searched])
        at_zero = model.part_placements(np.zeros(len(model.joint_names)))
        sources, targets, weights = [], [], []
        for part in parts:
            surface = model.surfaces[part]
            step = max(1, len(surface.dense) // self.samples)
            features = fpfh(surface.dense, surface.dense_normals, self.radius)[::step]
            distance, index = tree.query(features, k=self.matches)
            source = transform(at_zero[part], surface.dense[::step].astype(float) * model.diagonal)
            sources.append(np.repeat(source, self.matches, axis=0))
            found = observation.points[searched[index.ravel()]].astype(float)
            targets.append(found * observation.diagonal + observation.centre)
            weights.append(1.0 / (distance.ravel() + 1.0))
        return Correspondences(np.concatenate(sources), np.concatenate(targets), np.concatenate(weights))


def fpfh(points: Singles | Array, normals: Singles | Array, radius: float) -> Array:
    """Return the fast point feature histograms (n, 33) of points (n, 3) with normals (n, 3), by those within `radius`.

    Raises `DependencyError` without Open3D.
    """
    o3d = open3d()
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(np.asarray(points, float)))
    cloud.normals = o3d.utility.Vector3dVector(np.asarray(normals, float))
    neighbours = o3d.geometry.KDTreeSearchParamHybrid(radius=radius, max_nn=100)
    return np.asarray(o3d.pipelines.registration.compute_fpfh_feature(cloud, neighbours).data).T


@dataclass(frozen=True)
class OrientedPairs:
    """The correspondences of one part, as the kernels take them: search units, source in the part frame."""

    part: int
    source: Singles
    source_normals: Singles
    target: Singles
    target_normals: Singles
    weight: Singles


def oriented_pairs(
    correspondences: Correspondences, model: ArticulatedModel, observation: Observation
) -> list[OrientedPairs]:
    """Split correspondences by part and look up the normals at both ends.

    A source belongs to the part whose surface is nearest with all joint values 0. Raises `CorrespondenceError` when
    no source lies near the model or no target near the scan.
    """
    from scipy.spatial import cKDTree

    at_zero = inverse(model.part_placements(np.zeros(len(model.joint_names))))
    distances, samples, local = [], [], []
    for part, surface in enumerate(model.surfaces):
        points = transform(at_zero[part], correspondences.source) / model.diagonal
        local.append(points)
        if surface.exists:
            distance, index = cKDTree(surface.dense).query(points)
        else:
            distance, index = np.full(len(points), np.inf), np.zeros(len(points), int)
        distances.append(distance)
        samples.append(index)
    owner = np.argmin(distances, axis=0)
    target = observation.scaled(correspondences.target)
    scan_distance, scan_index = cKDTree(observation.points).query(target)
    near = (np.min(distances, axis=0) < ASTRAY) & (scan_distance < ASTRAY) & (correspondences.weight > 0)
    if near.sum() < 2:
        raise CorrespondenceError(
            "correspondences",
            "their sources are not on the model (joint values 0, root frame, m) or their targets not on the scan",
        )
    pairs = []
    for part in np.unique(owner[near]):
        own = np.flatnonzero(near & (owner == part))
        surface = model.surfaces[part]
        pairs.append(
            OrientedPairs(
                part=int(part),
                source=np.ascontiguousarray(local[part][own], np.float32),
                source_normals=np.ascontiguousarray(surface.dense_normals[samples[part][own]]),
                target=np.ascontiguousarray(target[own]),
                target_normals=np.ascontiguousarray(observation.normals[scan_index[own]]),
                weight=np.ascontiguousarray(correspondences.weight[own], np.float32),
            )
        )
    return pairs
