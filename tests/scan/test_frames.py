"""Streams of frames: folders, lists, sequences, bags, and their faults."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from pwralign_kin.exceptions import OptionError, ScanError, StateError, UnknownNameError
from pwralign_kin.scan import DepthFrame, FrameOptions, Scan, read_frames

CAMERA = (100.0, 100.0, 9.5, 4.5)


def _cloud(seed: int, count: int = 30) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(count, 3))


def test_a_folder_is_read_in_natural_order_at_a_rate(tmp_path: Path) -> None:
    for number in (10, 9, 1):
        np.save(tmp_path / f"scan{number}.npy", _cloud(number))
    frames = list(read_frames([tmp_path], FrameOptions(rate=10.0)))
    assert [time for time, _ in frames] == pytest.approx([0.0, 0.1, 0.2])
    for number, (_, frame) in zip((1, 9, 10), frames, strict=True):
        assert isinstance(frame, Scan)
        np.testing.assert_array_equal(frame.points, _cloud(number))


def test_names_that_are_seconds_are_times(tmp_path: Path) -> None:
    depth = np.arange(200, dtype=np.uint16).reshape(10, 20)
    for name in ("100.5", "100.25"):
        Image.fromarray(depth).save(tmp_path / f"{name}.png")
    frames = list(read_frames([tmp_path], FrameOptions(intrinsics=CAMERA, depth_scale=0.01)))
    assert [time for time, _ in frames] == [100.25, 100.5]
    frame = frames[0][1]
    assert isinstance(frame, DepthFrame)
    np.testing.assert_array_equal(frame.depth, depth)
    scan = frame.to_scan()
    assert len(scan) == 199  # the pixel of depth 0 is no return
    np.testing.assert_allclose(scan.points[-1], np.array([(19 - 9.5) / 100, (9 - 4.5) / 100, 1.0]) * 1.99)


def test_sequences_in_one_file(tmp_path: Path) -> None:
    clouds = [_cloud(seed, 20 + seed) for seed in range(3)]
    path = tmp_path / "sequence.npz"
    np.savez(
        path, points=np.concatenate(clouds), counts=[len(c) for c in clouds], sensor_origin=np.eye(3), time=[1, 3, 4]
    )
    frames = list(read_frames([path]))
    assert [time for time, _ in frames] == [1.0, 3.0, 4.0]
    for (_, frame), cloud, origin in zip(frames, clouds, np.eye(3), strict=True):
        assert isinstance(frame, Scan) and frame.sensor_origin is not None
        np.testing.assert_array_equal(frame.points, cloud)
        np.testing.assert_array_equal(frame.sensor_origin, origin)
    depth = np.random.default_rng(0).uniform(1.0, 2.0, (2, 10, 20))
    np.savez(path, depth=depth, intrinsics=CAMERA)
    images = [frame for _, frame in read_frames([path])]
    assert all(isinstance(image, DepthFrame) and image.depth_scale == 1.0 for image in images)


def test_a_file_that_is_one_scan_is_one_frame(tmp_path: Path) -> None:
    np.savez(tmp_path / "scan.npz", points=_cloud(0))
    assert len(list(read_frames([tmp_path / "scan.npz"]))) == 1


def test_clouds_of_too_few_points_are_frames_without_returns(tmp_path: Path) -> None:
    for index, points in enumerate((_cloud(0), np.full((20, 3), np.nan), _cloud(0)[:3])):
        np.save(tmp_path / f"{index}.npy", points)
    counts = [len(_cloud(0)), 0, 3]
    np.savez(tmp_path / "all.npz", counts=counts, points=np.concatenate([_cloud(0), _cloud(0)[:3]]))
    named = [tmp_path / f"{index}.npy" for index in range(3)]
    for files in (named, [tmp_path / "all.npz"]):
        frames = [frame for _, frame in read_frames(files)]
        assert [len(frame.points) if isinstance(frame, Scan) else frame.shape for frame in frames] == [
            len(_cloud(0)), (0, 3), (0, 3),
        ]  # fmt: skip


@pytest.mark.parametrize(
    ("arrays", "fault"),
    [
        ({"counts": [10, 30], "points": _cloud(0)}, "add up to 40"),
        ({"counts": [30]}, "points"),
        ({"counts": [15, 15], "points": _cloud(0), "time": [1.0, 1.0]}, "increasing"),
        ({"depth": np.ones((2, 4, 4))}, "intrinsics"),
        ({"depth": np.ones((4, 4)), "intrinsics": CAMERA}, "shape"),
        ({"depth": 1.0, "intrinsics": CAMERA}, "shape"),
        ({"depth": np.ones((2, 4, 4)), "intrinsics": CAMERA, "depth_scale": "mm"}, "depth_scale"),
        ({"depth": np.ones((2, 4, 4)), "intrinsics": CAMERA, "depth_scale": np.ones(3)}, "depth_scale"),
        ({"counts": 30, "points": _cloud(0)}, "counts"),
        ({"counts": [15, 15], "points": _cloud(0), "time": ["a", "b"]}, "time"),
        ({"counts": [15, 15], "points": _cloud(0), "sensor_origin": np.zeros((1, 3))}, "sensor_origin"),
    ],
)
def test_malformed_sequences(arrays: dict[str, object], fault: str, tmp_path: Path) -> None:
    np.savez(tmp_path / "bad.npz", **arrays)  # type: ignore[arg-type]
    with pytest.raises(ScanError, match=fault):
        list(read_frames([tmp_path / "bad.npz"]))


def test_what_is_no_frame(tmp_path: Path) -> None:
    with pytest.raises(ScanError, match="no frames in this folder"):
        read_frames([tmp_path])
    (tmp_path / "a.png").write_bytes(b"no picture")
    with pytest.raises(ScanError, match="intrinsics"):
        list(read_frames([tmp_path]))
    with pytest.raises(ScanError, match="not a readable PNG"):
        list(read_frames([tmp_path], FrameOptions(intrinsics=CAMERA)))
    Image.new("RGB", (4, 4)).save(tmp_path / "a.png")
    with pytest.raises(ScanError, match="16 bits"):
        list(read_frames([tmp_path], FrameOptions(intrinsics=CAMERA)))
    np.save(tmp_path / "b.npy", _cloud(0))
    with pytest.raises(ScanError, match="several kinds"):
        read_frames([tmp_path])
    with pytest.raises(OptionError, match="rate"):
        FrameOptions(rate=0.0)
    with pytest.raises(ScanError, match=r"\(h, w\)"):
        DepthFrame(np.ones(5), np.array(CAMERA))
    with pytest.raises(ScanError, match="depth_scale"):
        DepthFrame(np.ones((5, 5)), np.array(CAMERA), depth_scale=0.0)
    with pytest.raises(ScanError, match="millimetres"):
        DepthFrame(np.ones((5, 5), np.uint16), np.array(CAMERA))
    with pytest.raises(StateError, match="T_scan_camera"):
        DepthFrame(np.ones((5, 5)), np.array(CAMERA), T_scan_camera=2 * np.eye(4))


@pytest.mark.parametrize("plugin", ["MCAP", "SQLITE3"])
def test_bags(plugin: str, tmp_path: Path) -> None:
    rosbag2 = pytest.importorskip("rosbags.rosbag2", reason="the ros extra is not installed")
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    kinds = {name.rpartition("/")[2]: kind for name, kind in store.types.items()}
    depth = np.arange(1, 201, dtype=np.uint16).reshape(10, 20)
    padded = np.zeros((10, 24), np.uint16)  # rows may be longer than what they hold
    padded[:, :20] = depth
    cloud = np.concatenate([_cloud(1).astype(np.float32), np.ones((30, 1), np.float32)], axis=1)
    K = np.array([[100.0, 0.0, 9.5], [0.0, 100.0, 4.5], [0.0, 0.0, 1.0]])
    with rosbag2.Writer(tmp_path / "bag", version=9, storage_plugin=rosbag2.StoragePlugin[plugin]) as writer:
        topics = {"/depth/camera_info": "CameraInfo", "/depth/image": "Image", "/points": "PointCloud2"}
        names = {topic: f"sensor_msgs/msg/{kind}" for topic, kind in topics.items()}
        connections = {t: writer.add_connection(t, name, typestore=store) for t, name in names.items()}
        for second in (5, 6):
            header = kinds["Header"](kinds["Time"](second, 500_000_000), "camera")
            region = kinds["RegionOfInterest"](0, 0, 0, 0, False)
            camera = (header, 10, 20, "plumb_bob", np.zeros(5), K.reshape(-1), np.eye(3).reshape(-1), np.zeros(12))
            fields = [kinds["PointField"](name, 4 * i, 7, 1) for i, name in enumerate("xyz")]
            messages = {
                "/depth/camera_info": kinds["CameraInfo"](*camera, 0, 0, region),
                "/depth/image": kinds["Image"](header, 10, 20, "16UC1", 0, 48, padded.view(np.uint8).reshape(-1)),
                "/points": kinds["PointCloud2"](
                    header, 1, 30, fields, False, 16, 480, cloud.view(np.uint8).reshape(-1), True
                ),
            }
            for topic, message in messages.items():
                writer.write(connections[topic], second * 10**9, store.serialize_cdr(message, names[topic]))

    images = list(read_frames([tmp_path / "bag"], FrameOptions(topic="/depth/image")))
    assert [time for time, _ in images] == [5.5, 6.5]
    assert isinstance(images[0][1], DepthFrame)
    np.testing.assert_array_equal(images[0][1].depth, depth)
    np.testing.assert_array_equal(images[0][1].intrinsics, K)
    clouds = [frame for _, frame in read_frames([tmp_path / "bag"], FrameOptions(topic="/points"))]
    assert isinstance(clouds[1], Scan)
    np.testing.assert_array_equal(clouds[1].points, cloud[:, :3].astype(float))
    with pytest.raises(ScanError, match="/depth/image, /points"):
        list(read_frames([tmp_path / "bag"]))
    with pytest.raises(UnknownNameError, match="/points"):
        list(read_frames([tmp_path / "bag"], FrameOptions(topic="/point")))
    with pytest.raises(StateError, match="T_scan_camera"):
        list(read_frames([tmp_path / "bag"], FrameOptions(topic="/depth/image", T_scan_camera=2 * np.eye(4))))


def test_rays_without_a_return_are_no_news_in_a_stream(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level("INFO", logger="pwralign_kin")
    points = np.concatenate([_cloud(0), np.full((5, 3), np.nan)])
    np.savez(tmp_path / "sequence.npz", points=points, counts=[len(points)])
    ((_, frame),) = read_frames([tmp_path / "sequence.npz"])
    assert isinstance(frame, Scan) and len(frame) == len(points) - 5
    assert not caplog.messages


def test_a_bag_without_clouds_or_images_says_what_it_holds(tmp_path: Path) -> None:
    rosbag2 = pytest.importorskip("rosbags.rosbag2", reason="the ros extra is not installed")
    from rosbags.typesys import Stores, get_typestore

    store, name = get_typestore(Stores.ROS2_HUMBLE), "std_msgs/msg/String"
    with rosbag2.Writer(tmp_path / "bag", version=9) as writer:
        connection = writer.add_connection("/chatter", name, typestore=store)
        writer.write(connection, 1, store.serialize_cdr(store.types[name]("hello"), name))
    with pytest.raises(ScanError, match=r"neither point clouds .* but /chatter \(std_msgs/msg/String\)"):
        list(read_frames([tmp_path / "bag"]))


def test_a_broken_bag(tmp_path: Path) -> None:
    pytest.importorskip("rosbags", reason="the ros extra is not installed")
    (tmp_path / "bag.mcap").write_bytes(b"\x89MCAP0\r\n" + bytes(50))
    with pytest.raises(ScanError, match="not a readable ROS 2 bag"):
        list(read_frames([tmp_path / "bag.mcap"]))
