"""Rigid methods of other libraries bring a body back onto a scan of it, each from as far as it promises."""

from __future__ import annotations

import sys
from collections.abc import Callable

import numpy as np
import pytest

from pwralign_kin import se3
from pwralign_kin.baselines.coherent_point_drift import rigid_drift
from pwralign_kin.baselines.fpfh_ransac_icp import fpfh_ransac_icp
from pwralign_kin.baselines.kiss_matcher import kiss_matcher
from pwralign_kin.baselines.rigid_gicp import rigid_gicp
from pwralign_kin.benchmark.chains import knobbly
from pwralign_kin.exceptions import DependencyError, ScanError

FAR = se3.from_twist(np.array([0.7, -1.9, 0.4, 2.0, -1.0, 0.5]))
ASIDE = se3.from_twist(np.array([0.3, -0.2, 0.25, 0.1, -0.1, 0.05]))
NEAR = se3.from_twist(np.array([0.04, -0.03, 0.05, 0.02, -0.01, 0.02]))

Method = Callable[[se3.Array, se3.Array], se3.Array]


@pytest.fixture(scope="module")
def points() -> se3.Array:
    """Points (6000, 3) of a smooth body that no turn maps onto itself."""
    import trimesh

    return np.asarray(trimesh.sample.sample_surface(knobbly(20000, 0), 6000, seed=0)[0])


def scan_of(points: se3.Array, T: se3.Array) -> se3.Array:
    """Other points of the same body, placed by T, with a little noise."""
    random = np.random.default_rng(1)
    kept = random.permutation(len(points))[: len(points) // 2]
    return se3.transform(T, points[kept]) + random.normal(scale=0.001, size=(len(kept), 3))


def off(found: se3.Array, T: se3.Array, points: se3.Array) -> float:
    """Largest distance of a point to where it should be."""
    return float(np.linalg.norm(se3.transform(found, points) - se3.transform(T, points), axis=1).max())


@pytest.mark.parametrize(
    ("library", "method", "T", "most"),
    [
        ("open3d", lambda source, target: fpfh_ransac_icp(source, target, 0.03), FAR, 0.01),
        ("kiss_matcher", lambda source, target: kiss_matcher(source, target, 0.02), FAR, 0.05),
        ("small_gicp", lambda source, target: rigid_gicp(source, target, 0.03), NEAR, 0.01),
        ("pycpd", lambda source, target: rigid_drift(source, target), ASIDE, 0.04),
    ],
    ids=["open3d", "kiss-matcher", "small-gicp", "pycpd"],
)
def test_the_body_is_brought_back(points: se3.Array, library: str, method: Method, T: se3.Array, most: float) -> None:
    pytest.importorskip(library, reason="the benchmark extra is not installed")
    found = method(points, scan_of(points, T))
    assert off(np.eye(4), T, points) > 2 * most
    assert off(found, T, points) < most


def test_no_solution_is_an_error() -> None:
    pytest.importorskip("kiss_matcher", reason="the benchmark extra is not installed")
    random = np.random.default_rng(0)
    with pytest.raises(ScanError, match="no solution"):
        kiss_matcher(random.normal(size=(30, 3)), random.normal(size=(30, 3)), 0.03)


@pytest.mark.parametrize(
    ("library", "method"),
    [
        ("small_gicp", rigid_gicp),
        ("kiss_matcher", kiss_matcher),
        ("pycpd", lambda source, target, voxel: rigid_drift(source, target)),
    ],
)
def test_a_missing_library_is_named_with_the_way_out(
    monkeypatch: pytest.MonkeyPatch, library: str, method: Callable[[se3.Array, se3.Array, float], se3.Array]
) -> None:
    monkeypatch.setitem(sys.modules, library, None)
    points = np.random.default_rng(0).normal(size=(50, 3))
    with pytest.raises(DependencyError, match=r'pip install "pwralign-kin\[benchmark\]"'):
        method(points, points, 0.1)
