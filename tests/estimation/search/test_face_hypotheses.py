"""Flat faces: rectangles found on surfaces, laid onto those of the scan, and what only they find."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import pwralign_kin as pk
from pwralign_kin.benchmark.cases import load_sample, simulated_case
from pwralign_kin.benchmark.metrics import Ruler
from pwralign_kin.estimation.search.face_hypotheses import FaceOptions, matching
from pwralign_kin.model.flat_faces import flat_faces
from pwralign_kin.se3 import transform

ROBOTS = Path(__file__).parents[3] / "robots"
SIDES = np.array([0.5, 0.3, 0.2])


def turned(seed: int) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3] = Rotation.random(random_state=seed).as_matrix()
    T[:3, 3] = np.random.default_rng(seed).normal(size=3)
    return T


def box(T: np.ndarray, seed: int) -> tuple[np.ndarray, np.ndarray]:
    random = np.random.default_rng(seed)
    points, normals = [], []
    for axis in range(3):
        for sign in (-1, 1):
            count = int(20000 * np.prod(np.delete(SIDES, axis)))
            own = random.uniform(-0.5, 0.5, (count, 3)) * SIDES
            own[:, axis] = sign * SIDES[axis] / 2
            points.append(own)
            normals.append(np.tile(sign * np.eye(3)[axis], (count, 1)))
    placed = transform(T, np.concatenate(points)) + 0.001 * random.normal(size=(sum(map(len, points)), 3))
    return placed.astype(np.float32), (np.concatenate(normals) @ T[:3, :3].T).astype(np.float32)


@pytest.mark.parametrize("seed", range(4))
def test_the_faces_of_a_box_are_found_however_it_lies(seed: int) -> None:
    T = turned(seed)
    points, normals = box(T, seed)
    faces = flat_faces(points, normals, np.full(len(points), 1 / 20000), 0.03, 0.005, 0.01)
    assert len(faces) == 6
    expected = [[0.5, 0.3], [0.5, 0.3], [0.5, 0.2], [0.5, 0.2], [0.3, 0.2], [0.3, 0.2]]
    np.testing.assert_allclose(faces.sizes, expected, atol=0.02)
    np.testing.assert_allclose(faces.areas, np.prod(expected, axis=1), rtol=0.1)
    local = np.linalg.inv(T) @ faces.frames
    outwards = np.einsum("fi,fi->f", local[:, :3, 3], local[:, :3, 2])
    np.testing.assert_allclose(outwards, [0.1, 0.1, 0.15, 0.15, 0.25, 0.25], atol=0.01)
    np.testing.assert_allclose(np.abs(local[:, :3, 0]).max(axis=1), 1.0, atol=0.01)


def test_what_is_round_has_no_faces() -> None:
    normals = np.random.default_rng(0).normal(size=(4000, 3))
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    ball = (0.3 * normals).astype(np.float32)
    area = np.full(4000, 1.13 / 4000)
    assert len(flat_faces(ball, normals.astype(np.float32), area, 0.04, 0.005, 0.08)) == 0


def test_a_whole_patch_fits_both_ways_round_and_a_part_of_it_to_either_end() -> None:
    size = np.array([0.5, 0.3])
    whole = matching(size, size, FaceOptions())
    assert len(whole) == 2
    assert all(np.allclose(motion[:2, 3], 0) for motion in whole)
    hidden = matching(np.array([0.4, 0.3]), size, FaceOptions())
    assert sorted(round(float(motion[0, 3]), 3) for motion in hidden) == [-0.05, -0.05, 0.05, 0.05]


def test_a_patch_may_hold_a_little_other_surface_beside_a_face() -> None:
    size = np.array([0.5, 0.3])
    beside = matching(np.array([0.56, 0.3]), size, FaceOptions())
    assert sorted(round(float(motion[0, 3]), 3) for motion in beside) == [-0.03, -0.03, 0.03, 0.03]
    assert matching(np.array([0.7, 0.3]), size, FaceOptions()) == []


@pytest.mark.parametrize(("name", "configuration"), [("cabinet", 0), ("laptop", 0), ("laptop", 2)])
def test_a_single_view_of_plates_and_boxes_is_found(name: str, configuration: int) -> None:
    model = load_sample(ROBOTS, name)
    case = simulated_case(model, name, "single", configuration)
    ruler = Ruler(model)
    answer = pk.estimate(model, case.scan).state
    assert ruler.score(ruler.reference(case.truth, case.labels), answer).overlay
