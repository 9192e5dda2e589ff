"""Tracks: states over time as files that plots, robots and trajectory tools read."""

from __future__ import annotations

import csv
import io
import json
import shutil
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pwralign_kin import files, se3
from pwralign_kin.dependencies import rosbags
from pwralign_kin.export.joints import joint_values
from pwralign_kin.model import ArticulatedModel
from pwralign_kin.se3 import Array
from pwralign_kin.state import State


@dataclass(frozen=True)
class TrackPoint:
    """The state of a model at one time."""

    time: float
    """s."""
    state: State
    lost: bool
    """Whether the state is a guess."""
    std: Mapping[str, float]
    """Standard deviation of each joint, rad or m."""
    details: Mapping[str, Any]
    """What else there is to tell, as JSON."""


def export_track(
    track: Sequence[TrackPoint], model: ArticulatedModel, folder: Path | str, *, mcap: bool = False
) -> list[Path]:
    """Write a track into `folder`, all files or none, and return their paths.

    - `joints.csv`: time, lost (0 or 1) and every actuated joint and its standard deviation, rad or m, a row per frame;
    - `base.tum`: `time x y z qx qy qz qw` of the root link in the scan frame (TUM format), without frames in which the
      model is lost;
    - `track.json`: all figures of every frame;
    - with `mcap`, `track.mcap`: ROS 2 messages, sensor_msgs/JointState on /joint_states and tf2_msgs/TFMessage on /tf,
      of every frame in which the model is not lost. The scan frame is called `scan`.

    Raises `ExportError` when files cannot be written, `DependencyError` for `mcap` without the ros extra.
    """
    folder = Path(folder)
    with files.atomic_folder(folder, optional=["track.mcap"]) as new:
        _write_joints(new / "joints.csv", track, model)
        _write_base(new / "base.tum", track, model)
        rows = [{"time": point.time, "lost": point.lost, **point.details} for point in track]
        files.write_text(new / "track.json", json.dumps(rows, indent=1, allow_nan=False) + "\n")
        if mcap:
            _write_mcap(new / "track.mcap", track, model)
        names = sorted(path.name for path in new.iterdir())
    return [folder / name for name in names]


def _write_joints(path: Path, track: Sequence[TrackPoint], model: ArticulatedModel) -> None:
    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(["time", "lost", *model.joint_names, *(f"std({name})" for name in model.joint_names)])
    for point in track:
        values = [f"{value:.9g}" for value in model.values(point.state.joints)]
        doubts = [f"{point.std[name]:.4g}" for name in model.joint_names]
        table.writerow([f"{point.time:.9f}", int(point.lost), *values, *doubts])
    files.write_text(path, text.getvalue())


def _write_base(path: Path, track: Sequence[TrackPoint], model: ArticulatedModel) -> None:
    lines = []
    for point in track:
        if not point.lost:
            T = model.root_placement(point.state)
            figures = (*T[:3, 3], *se3.quaternion_xyzw(T))
            lines.append(" ".join([f"{point.time:.9f}", *(f"{figure:.9f}" for figure in figures)]) + "\n")
    files.write_text(path, "".join(lines))


def _write_mcap(path: Path, track: Sequence[TrackPoint], model: ArticulatedModel) -> None:
    from rosbags.rosbag2 import StoragePlugin, Writer

    _, typesys = rosbags()
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    message = {name.rpartition("/")[2]: kind for name, kind in store.types.items()}
    with tempfile.TemporaryDirectory(dir=path.parent) as scratch:
        bag = Path(scratch) / "bag"
        with Writer(bag, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
            joints = writer.add_connection("/joint_states", "sensor_msgs/msg/JointState", typestore=store)
            frames = writer.add_connection("/tf", "tf2_msgs/msg/TFMessage", typestore=store)
            for point in track:
                if point.lost:
                    continue
                stamp = round(point.time * 1e9)
                at = message["Time"](stamp // 10**9, stamp % 10**9)
                values = joint_values(model, point.state).single
                state = message["JointState"](
                    message["Header"](at, ""), list(values), np.array(list(values.values())), np.zeros(0), np.zeros(0)
                )
                writer.write(joints, stamp, store.serialize_cdr(state, joints.msgtype))
                placed = [_transform(message, at, parent, child, T) for parent, child, T in _edges(model, point.state)]
                writer.write(frames, stamp, store.serialize_cdr(message["TFMessage"](placed), frames.msgtype))
        shutil.move(next(bag.glob("*.mcap")), path)


def _edges(model: ArticulatedModel, state: State) -> list[tuple[str, str, Array]]:
    """Return parent, child and placement of every link in the scan frame: all hang on it side by side."""
    T_scan_root = model.root_placement(state)
    links = model.link_placements(model.values(state.joints))
    return [("scan", link, T_scan_root @ T) for link, T in links.items()]


def _transform(message: Mapping[str, Any], at: Any, parent: str, child: str, T: Array) -> Any:
    x, y, z = T[:3, 3].tolist()
    return message["TransformStamped"](
        message["Header"](at, parent),
        child,
        message["Transform"](message["Vector3"](x, y, z), message["Quaternion"](*se3.quaternion_xyzw(T).tolist())),
    )
