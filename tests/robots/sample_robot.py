"""A sample model read by yourdfpy and trimesh alone, independently of the package."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

import numpy as np

REPOSITORY = Path(__file__).resolve().parents[2]
ROBOTS = REPOSITORY / "robots"
NAMES = ("cubebot", "viking_lander", "door", "cabinet", "laptop", "excavator")

logging.getLogger("yourdfpy").setLevel(logging.ERROR)


class Sample:
    """A sample model read by yourdfpy: placements and meshes in the root frame at given joint values."""

    def __init__(self, name: str) -> None:
        import yourdfpy

        self.path = ROBOTS / name / f"{name}.urdf"
        self.urdf = yourdfpy.URDF.load(str(self.path))
        self.joints = {joint.name: joint for joint in self.urdf.robot.joints}
        self.pose({})

    def pose(self, joints: dict[str, float]) -> None:
        names = self.urdf.actuated_joint_names
        assert set(joints) <= set(names)
        self.urdf.update_cfg(np.array([joints.get(name, 0.0) for name in names]))

    def placement(self, link: str) -> np.ndarray:
        return np.asarray(self.urdf.get_transform(link))

    def meshes(self, link: str, material: str | None = None) -> list[tuple[np.ndarray, np.ndarray]]:
        """Return vertices (v, 3) in the root frame and faces (f, 3) of the visuals of a link."""
        import trimesh

        T = self.placement(link)
        found = []
        for visual in self.urdf.link_map[link].visuals:
            if material is None or visual.material.name == material:
                mesh: Any = trimesh.load_mesh(self.path.parent / visual.geometry.mesh.filename)
                found.append((mesh.vertices @ T[:3, :3].T + T[:3, 3], np.asarray(mesh.faces)))
        return found

    def vertices(self, link: str, material: str | None = None) -> np.ndarray:
        return np.vstack([vertices for vertices, _ in self.meshes(link, material)])
