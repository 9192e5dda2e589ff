"""URDF -> `ArticulatedModel`: reading and checking, geometry, part graph, kinematics, cache."""

from pwralign_kin.model.articulated_model import ArticulatedModel
from pwralign_kin.model.part_graph import MovingJoint, Part, Visual

__all__ = ["ArticulatedModel", "MovingJoint", "Part", "Visual"]
