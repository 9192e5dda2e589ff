"""Chains of as many parts, or of as many triangles, as one likes: for what size costs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

MESHES = 6
"""Parts of a chain of meshes."""


def chain(parts: int, meshes: bool = False) -> str:
    """Return the URDF of a chain of links that differ in shape, one joint between any two, their axes in turn."""
    random = np.random.default_rng(parts)
    axes = ("1 0 0", "0 1 0", "0 0 1")
    pieces = []
    for index in range(parts):
        a, b, c, d = random.uniform(0.5, 1.0, 4)
        bar = f'<origin xyz="0.5 0 0"/><geometry><box size="1 {0.4 * a:.4f} {0.3 * b:.4f}"/></geometry>'
        knob = f'<origin xyz="{0.8 * c:.4f} {0.25 * a:.4f} 0"/><geometry><box size="0.2 {0.4 * d:.4f} 0.2"/></geometry>'
        shapes = [f'<geometry><mesh filename="link{index}.stl"/></geometry>'] if meshes else [bar, knob]
        visuals = "".join(f"<visual>{shape}</visual>" for shape in shapes)
        pieces.append(f'<link name="link{index}">{visuals}</link>')
        if index:
            pieces.append(
                f'<joint name="joint{index}" type="revolute"><origin xyz="1.1 0 0"/><parent link="link{index - 1}"/>'
                f'<child link="link{index}"/><axis xyz="{axes[index % 3]}"/>'
                '<limit lower="-0.8" upper="0.8" effort="1" velocity="1"/></joint>'
            )
    return f'<robot name="chain">{"".join(pieces)}</robot>'


def knobbly(triangles: int, seed: int) -> Any:
    """Return a `trimesh.Trimesh` of about so many triangles, 1 m long, without symmetry."""
    import trimesh

    side = max(3, round(np.sqrt(triangles / 4)))
    mesh = trimesh.creation.uv_sphere(count=[side, side])
    x, y, z = mesh.vertices.T
    phase = np.random.default_rng(seed).uniform(0.0, 2.0 * np.pi, 3)
    radius = (
        1.0 + 0.15 * np.sin(3.0 * x + phase[0]) + 0.15 * np.sin(4.0 * y + phase[1]) + 0.1 * np.sin(5.0 * z + phase[2])
    )
    mesh.vertices = mesh.vertices * radius[:, None] * (0.45, 0.2, 0.15) + (0.5, 0.0, 0.0)
    return mesh


def mesh_files(size: int, folder: Path, threads: int) -> None:
    """Write a chain of six meshes with about `size` triangles in all into `folder`."""
    del threads
    for index in range(MESHES):
        knobbly(size // MESHES, index).export(folder / f"link{index}.stl")
    (folder / "chain.urdf").write_text(chain(MESHES, meshes=True), encoding="utf-8")
