"""Rigid registration by Open3D: FPFH features, RANSAC over their matches, point-to-plane ICP.

Set up as in Open3D's tutorial "Global registration"
(https://www.open3d.org/docs/release/tutorial/pipelines/global_registration.html), all lengths multiples of one voxel.
Open3D's RANSAC does not repeat exactly, seeded or not.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pwralign_kin.dependencies import open3d
from pwralign_kin.se3 import Array


def fpfh_ransac_icp(source: Array, target: Array, voxel: float) -> Array:
    """Return T_target_source (4, 4) of points (n, 3) and (m, 3), m; `voxel` is the cell of the downsampling, m."""
    o3d = open3d()
    with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):  # it warns on stdout
        return _registered(o3d.pipelines.registration, source, target, voxel)


def _registered(registration: Any, source: Array, target: Array, voxel: float) -> Array:
    sources, source_features = _prepared(source, voxel)
    targets, target_features = _prepared(target, voxel)
    near = 1.5 * voxel
    coarse = registration.registration_ransac_based_on_feature_matching(
        sources, targets, source_features, target_features, True, near,
        registration.TransformationEstimationPointToPoint(False), 3,
        [
            registration.CorrespondenceCheckerBasedOnEdgeLength(0.9),
            registration.CorrespondenceCheckerBasedOnDistance(near),
        ],
        registration.RANSACConvergenceCriteria(100000, 0.999),
    )  # fmt: skip
    fine = registration.registration_icp(
        _cloud(source), _with_normals(_cloud(target), voxel), 0.4 * voxel, coarse.transformation,
        registration.TransformationEstimationPointToPlane(),
    )  # fmt: skip
    return np.array(fine.transformation)


def _prepared(points: Array, voxel: float) -> tuple[Any, Any]:
    """Return the downsampled cloud with normals, and its features (Rusu et al., ICRA 2009)."""
    o3d = open3d()
    cloud = _with_normals(_cloud(points).voxel_down_sample(voxel), voxel)
    near = o3d.geometry.KDTreeSearchParamHybrid(radius=5.0 * voxel, max_nn=100)
    return cloud, o3d.pipelines.registration.compute_fpfh_feature(cloud, near)


def _with_normals(cloud: Any, voxel: float) -> Any:
    cloud.estimate_normals(open3d().geometry.KDTreeSearchParamHybrid(radius=2.0 * voxel, max_nn=30))
    return cloud


def _cloud(points: Array) -> Any:
    o3d = open3d()
    return o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
