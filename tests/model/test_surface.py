"""What parts weigh in scores, and the normals of their surface as scans tell them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pwralign_kin.model import ArticulatedModel
from pwralign_kin.model.surface import Surface, part_weights
from pwralign_kin.model.surface_sampling import build_surfaces

SIDE, RIB, DEPTH = 1.0, 0.02, 0.008


def surface_of(area: float) -> Surface:
    one, number = np.zeros((1, 3), np.float32), np.ones(1, np.float32)
    return Surface(
        samples=one, normals=one, weights=number, dense=one, dense_normals=one, apparent_normals=one,
        grid=np.zeros((1, 1, 1), np.uint16), origin=one[0], centre=one[0], faces=np.zeros((0, 4, 4)),
        face_sizes=np.zeros((0, 2)), scalars=np.array([1, 0, 0, 0, area], np.float32),
    )  # fmt: skip


@pytest.mark.parametrize("fingers", [4, 100])
def test_small_parts_count_each_but_do_not_outweigh_the_rest_together(fingers: int) -> None:
    weights = part_weights([surface_of(1.0), *(surface_of(1e-4) for _ in range(fingers))])
    assert weights.sum() == pytest.approx(1.0)
    assert weights[0] > 0.6
    assert weights[1] > 10 * 1e-4 / (1.0 + 1e-4 * fingers)


def ribbed_plate() -> str:
    """Return an OBJ mesh of a plate whose upper side is folded into ribs too fine for any scan to show."""
    x = np.arange(0.0, SIDE + RIB / 4, RIB / 2)
    top = np.where(np.arange(len(x)) % 2, DEPTH, 0.0)
    rows = [[(a, y, z) for a, z in zip(x, height, strict=True)] for height in (top, top * 0 - 0.1) for y in (0.0, SIDE)]
    vertices = "\n".join(f"v {a:.5f} {y:.5f} {z:.5f}" for row in rows for a, y, z in row)
    n, quads = len(x), []
    for i in range(1, n):
        quads += [(i, i + 1, n + i + 1, n + i), (2 * n + i, 3 * n + i, 3 * n + i + 1, 2 * n + i + 1)]
    faces = "\n".join(f"f {a} {b} {c}\nf {a} {c} {d}" for a, b, c, d in quads)
    return f"{vertices}\n{faces}\n"


def test_fine_ribs_have_normals_as_a_scan_tells_them(tmp_path: Path) -> None:
    (tmp_path / "plate.obj").write_text(ribbed_plate())
    urdf = tmp_path / "plate.urdf"
    urdf.write_text(
        '<robot name="plate"><link name="plate"><visual><geometry><mesh filename="plate.obj"/></geometry></visual>'
        "</link></robot>"
    )
    model = ArticulatedModel.from_urdf(urdf)
    plate = model.parts[0].vertices / model.diagonal, model.parts[0].faces
    (surface,) = build_surfaces([plate], lambda random: np.eye(4)[None])
    inner = (np.abs(surface.dense[:, :2] - surface.dense[:, :2].mean(axis=0)) < 0.2).all(axis=1)
    ribs = inner & (surface.dense[:, 2] > -0.01)
    assert surface.dense_normals[ribs, 2].max() < 0.9
    assert surface.apparent_normals[ribs, 2].min() > 0.95
    shown = (np.abs(surface.samples[:, :2] - surface.dense[:, :2].mean(axis=0)) < 0.2).all(axis=1)
    assert np.abs(surface.normals[shown, 2]).min() > 0.95
