"""The estimated state and joint values as JSON and YAML."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from pwralign_kin import files
from pwralign_kin.estimation.result import Estimate
from pwralign_kin.export.joints import JointValues


def write_estimate(path: Path, estimate: Estimate) -> None:
    """Write the summary of an estimate as JSON."""
    files.write_text(path, json.dumps(estimate.to_dict(), indent=2, allow_nan=False) + "\n")


def write_joint_state(path: Path, values: JointValues) -> None:
    """Write a ROS sensor_msgs/JointState with every one-axis joint, those that mimic included.

    Joints with several degrees of freedom have no place in that message and are left out.
    """
    message = {
        "header": {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""},
        "name": list(values.single),
        "position": list(values.single.values()),
        "velocity": [],
        "effort": [],
    }
    _write_yaml(path, message)


def write_initial_positions(path: Path, values: JointValues) -> None:
    """Write MoveIt's `initial_positions.yaml`: the one-axis joints that have an actuator of their own."""
    _write_yaml(path, {"initial_positions": {name: values.single[name] for name in values.actuated}})


def _write_yaml(path: Path, content: dict[str, Any]) -> None:
    import yaml

    files.write_text(path, yaml.safe_dump(content, sort_keys=False, allow_unicode=True, width=100))
