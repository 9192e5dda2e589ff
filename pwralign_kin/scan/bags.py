"""Frames of ROS 2 bags, through the library rosbags (the ros extra)."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pwralign_kin.dependencies import rosbags
from pwralign_kin.exceptions import PwralignError, ScanError, UnknownNameError
from pwralign_kin.scan.depth import DepthFrame
from pwralign_kin.scan.pinhole import checked_intrinsics
from pwralign_kin.scan.scan import cloud_frame
from pwralign_kin.scan.timed_frame import FrameOptions, TimedFrame

logger = logging.getLogger(__name__)

CLOUD, IMAGE, CAMERA = "sensor_msgs/msg/PointCloud2", "sensor_msgs/msg/Image", "sensor_msgs/msg/CameraInfo"

_DEPTHS: dict[str, np.dtype[Any]] = {"16UC1": np.dtype("u2"), "mono16": np.dtype("u2"), "32FC1": np.dtype("f4")}
"""Encodings of depth images."""

_FLOATS: dict[int, np.dtype[Any]] = {7: np.dtype("f4"), 8: np.dtype("f8")}
"""Data types of PointCloud2 fields that can be coordinates."""


def read_bag(path: Path, options: FrameOptions) -> Iterator[TimedFrame]:
    """Yield the depth images or point clouds of one topic of a bag.

    Times are those of the messages' headers, or of their recording where a header has none. The intrinsics of a depth
    image come from `options`, else from the camera_info beside its topic. Frames that are not later than the one
    before, and clouds of fewer than ten points, are left out.

    Raises `ScanError` for a bag that cannot be read or has no such topic, `UnknownNameError` for a topic that does not
    exist, `DependencyError` without the ros extra.
    """
    highlevel, typesys = rosbags()
    try:
        store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
        with highlevel.AnyReader([path], default_typestore=store) as reader:
            topic = _topic(reader, path, options)
            cameras = _camera_topics(reader, topic)
            intrinsics = options.intrinsics
            last = -np.inf
            for connection, recorded, raw in reader.messages(
                [one for one in reader.connections if one.topic == topic or one.topic in cameras]
            ):
                message: Any = reader.deserialize(raw, connection.msgtype)
                if connection.msgtype == CAMERA:
                    intrinsics = message.k.reshape(3, 3) if options.intrinsics is None else options.intrinsics
                    continue
                stamp = message.header.stamp
                time = stamp.sec + 1e-9 * stamp.nanosec or 1e-9 * recorded
                source = f"{path}: {topic} at {time:.3f} s"
                if time <= last:
                    logger.warning("%s: not later than the frame before: left out", source)
                    continue
                if connection.msgtype == IMAGE:
                    if intrinsics is None:
                        raise ScanError(source, "no camera_info before it: give the intrinsics, fx fy cx cy")
                    K = checked_intrinsics(intrinsics, source)
                    yield time, _depth(message, K, options, source)
                else:
                    points = _points(message, source)
                    yield time, cloud_frame(points, options.sensor_origin, source)
                last = time
    except PwralignError:
        raise
    except Exception as error:  # a corrupt bag raises anything
        raise ScanError(path, f"not a readable ROS 2 bag: {' '.join(str(error).split())[:200]}") from None


def _topic(reader: Any, path: Path, options: FrameOptions) -> str:
    """Return the topic whose messages are the frames."""
    valid: list[str] = sorted({one.topic for one in reader.connections if one.msgtype in (CLOUD, IMAGE)})
    if options.topic is not None:
        if options.topic not in valid:
            raise UnknownNameError("topic of point clouds or images", options.topic, valid)
        return options.topic
    if not valid:
        there = ", ".join(sorted(f"{one.topic} ({one.msgtype})" for one in reader.connections)) or "nothing"
        raise ScanError(path, f"holds neither point clouds ({CLOUD}) nor depth images ({IMAGE}), but {there}")
    if len(valid) > 1:
        raise ScanError(path, f"name the topic of the point clouds or depth images; there are: {', '.join(valid)}")
    return valid[0]


def _camera_topics(reader: Any, topic: str) -> set[str]:
    """Return the topic of the camera of an image: the one beside it, or the only one."""
    cameras = {one.topic for one in reader.connections if one.msgtype == CAMERA}
    beside = f"{topic.rpartition('/')[0]}/camera_info"
    if beside in cameras:
        return {beside}
    return cameras if len(cameras) == 1 else set()


def _depth(message: Any, intrinsics: NDArray[Any], options: FrameOptions, source: str) -> DepthFrame:
    kind = _DEPTHS.get(message.encoding)
    if kind is None:
        raise ScanError(source, f"the encoding {message.encoding!r} is no depth; valid: {' '.join(_DEPTHS)}")
    kind = kind.newbyteorder(">" if message.is_bigendian else "<")
    rows = _rows(message.data, message.height, message.step, message.width * kind.itemsize, source)
    depth = rows.view(kind).astype(kind.newbyteorder("="))
    scale = options.depth_scale if kind.kind == "u" else 1.0
    return DepthFrame(depth, intrinsics, options.T_scan_camera, scale, source)


def _points(message: Any, source: str) -> NDArray[np.float64]:
    """Return all points (n, 3) of a PointCloud2, those without a return too, which are not finite."""
    fields = {field.name: field for field in message.fields}
    if not {"x", "y", "z"} <= set(fields):
        raise ScanError(source, f"the cloud has no x, y, z; its fields are {', '.join(fields)}")
    width = message.point_step
    data = _rows(message.data, message.height, message.row_step, message.width * width, source).reshape(-1, width)
    columns = []
    for name in "xyz":
        kind, offset = _FLOATS.get(fields[name].datatype), fields[name].offset
        if kind is None or offset + kind.itemsize > width:
            raise ScanError(source, f"the field {name} of the cloud is no float within its points")
        column = np.ascontiguousarray(data[:, offset : offset + kind.itemsize])
        columns.append(column.view(kind.newbyteorder(">" if message.is_bigendian else "<"))[:, 0])
    return np.stack(columns, axis=-1).astype(np.float64)


def _rows(data: NDArray[np.uint8], height: int, step: int, used: int, source: str) -> NDArray[np.uint8]:
    """Return the bytes in use (height, used) of rows that are `step` apart."""
    if step < used or len(data) < height * step or height * used == 0:
        raise ScanError(source, f"{len(data)} bytes cannot hold {height} rows of {step}")
    return np.ascontiguousarray(np.asarray(data)[: height * step].reshape(height, step)[:, :used])
