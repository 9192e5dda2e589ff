"""A robot of boxes with every kind of joint, scans of a model, and estimates made from the truth."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from good_evidence import GOOD

from pwralign_kin import se3
from pwralign_kin.estimation.result import Estimate, PartEstimate
from pwralign_kin.model import ArticulatedModel, articulated_model
from pwralign_kin.render import posed_mesh
from pwralign_kin.scan import Scan
from pwralign_kin.state import State

STL = """solid wedge
facet normal 0 0 -1\nouter loop\nvertex 0 0 0\nvertex 0 .1 0\nvertex .2 0 0\nendloop\nendfacet
facet normal 0 -1 0\nouter loop\nvertex 0 0 0\nvertex .2 0 0\nvertex 0 0 .1\nendloop\nendfacet
facet normal -1 0 0\nouter loop\nvertex 0 0 0\nvertex 0 0 .1\nvertex 0 .1 0\nendloop\nendfacet
facet normal 1 1 1\nouter loop\nvertex .2 0 0\nvertex 0 .1 0\nvertex 0 0 .1\nendloop\nendfacet
endsolid wedge
"""

BOT = """<?xml version="1.0"?>
<!-- made by hand -->
<robot name="bot" xmlns:xacro="http://www.ros.org/wiki/xacro">
    <!-- what it is painted with -->
    <material name="paint"><color rgba="0.8 0.4 0.2 1"/></material>
    <link name="base">
        <visual>
            <geometry><box size="0.4 0.3 0.1"/></geometry>
            <material name="paint"/>
        </visual>
    </link>
    <link name="flange">
        <visual>
            <origin xyz="0 0 0.02" rpy="0 0 0.3"/>
            <geometry><mesh filename="meshes/wedge.stl"/></geometry>
        </visual>
    </link>
    <link name="arm">
        <visual><origin xyz="0.15 0 0"/><geometry><box size="0.3 0.05 0.06"/></geometry></visual>
    </link>
    <link name="slide"><visual><geometry><box size="0.1 0.12 0.14"/></geometry></visual></link>
    <link name="left"><visual><geometry><box size="0.05 0.02 0.02"/></geometry></visual></link>
    <link name="right"><visual><geometry><box size="0.02 0.02 0.05"/></geometry></visual></link>
    <joint name="mount" type="fixed"> <!-- bolted -->
        <origin xyz="0.1 0.05 0.06" rpy="0.1 -0.2 0.7"/>
        <parent link="base"/>
        <child link="flange"/>
    </joint>
    <joint name="shoulder" type="revolute">
        <origin xyz="0 0 0.2" rpy="1.2 0.4 -0.3"/>
        <parent link="flange"/>
        <child link="arm"/>
        <axis xyz="0 0.6 0.8"/>
        <limit lower="-2" upper="2" effort="1" velocity="1"/>
    </joint>
    <joint name="wrist" type="continuous">
        <origin xyz="0.35 0 0"/>
        <parent link="arm"/>
        <child link="slide"/>
        <axis xyz="1 0 0"/>
    </joint>
    <joint name="finger" type="prismatic">
        <origin xyz="0.1 0 0"/>
        <parent link="slide"/>
        <child link="left"/>
        <axis xyz="0 1 0"/>
        <limit lower="0" upper="0.2" effort="1" velocity="1"/>
    </joint>
    <joint name="thumb" type="prismatic">
        <origin xyz="0.1 0 0" rpy="0 0 3.1"/>
        <parent link="slide"/>
        <child link="right"/>
        <axis xyz="0 1 0"/>
        <limit lower="-0.2" upper="0.5" effort="1" velocity="1"/>
        <mimic joint="finger" multiplier="2" offset="0.01"/>
    </joint>
</robot>
"""

BOT_JOINTS = {"shoulder": 0.7, "wrist": -2.2, "finger": 0.05}
BOT_VALUES = {**BOT_JOINTS, "thumb": 0.11}


def placement(seed: int) -> se3.Array:
    """A placement with a random rotation, a metre or so from the origin."""
    rng = np.random.default_rng(seed)
    return se3.from_quaternion(rng.normal(size=3), rng.normal(size=4))


def scan_of(model: ArticulatedModel, state: State, count: int = 400, noise: float = 1e-3) -> tuple[Scan, np.ndarray]:
    """Points on the surface of every part, some without a part, one of them twice; with labels as given."""
    mesh = posed_mesh(model, state)
    rng = np.random.default_rng(5)
    corners = mesh.vertices[mesh.faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    face = rng.choice(len(area), count, p=area / area.sum())
    weights = rng.dirichlet([1.0, 1.0, 1.0], count)
    points = np.einsum("nc,nci->ni", weights, corners[face]) + rng.normal(scale=noise, size=(count, 3))
    points = np.concatenate([points[:1], points, points[:1] + 3.0])
    return Scan(points), np.concatenate([mesh.face_part[face[:1]], mesh.face_part[face], [-1]])


def estimate_from(model: ArticulatedModel, state: State, labels: np.ndarray) -> Estimate:
    """An estimate that is the truth."""
    placements = model.root_placement(state) @ model.part_placements(model.values(state.joints))
    counts = np.bincount(labels[labels >= 0], minlength=len(model.parts))
    size = 6 + len(model.joint_names)
    return Estimate(
        state=state,
        cost=0.1,
        confidence=0.9,
        inlier_rmse=1e-3,
        scan_coverage=0.99,
        model_support=0.8,
        viewpoint_known=False,
        parts={
            part.name: PartEstimate(T, 1e-3 if count else np.nan, int(count), 0.8 if len(part.faces) else np.nan)
            for part, T, count in zip(model.parts, placements, counts, strict=True)
        },
        scan_labels=labels,
        undetermined=("wrist",),
        std={name: np.inf if name == "wrist" else 1e-3 for name in model.joint_names},
        evidence=GOOD,
        covariance=np.diag(np.arange(1.0, size + 1.0)),
        alternatives=(),
        converged=True,
        iterations=3,
        timings={"search": 0.1},
        options={"seed": 0},
        units=model.units,
    )


def read_quickly(path: Path, package_dirs: Sequence[Path] = ()) -> ArticulatedModel:
    """Read a model without its sampled surfaces, which export does not need and which take long to make."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(articulated_model.ArticulatedModel, "surfaces", ())
        patch.setattr(articulated_model, "set_surfaces", lambda native, surfaces: None)
        patch.setattr(articulated_model, "model_reach", lambda native, surfaces: 0.0)
        return ArticulatedModel.from_urdf(path, package_dirs=package_dirs)
