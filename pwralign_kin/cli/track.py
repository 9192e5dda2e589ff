"""`pwralign track`: a URDF and a stream of frames in, a state per frame out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter
from cyclopts.validators import Number

from pwralign_kin.cli import arguments, messages
from pwralign_kin.cli.arguments import GUESS, OUTPUT, SCAN, SEARCH, AsJson, Seed, Threads, Triple
from pwralign_kin.cli.codes import UsageError
from pwralign_kin.cli.joint_options import JOINT_OPTIONS, JointOptions
from pwralign_kin.cli.model_options import MODEL_OPTIONS, ModelOptions, Urdf
from pwralign_kin.cli.scan_options import CAMERA_OPTIONS, CameraOptions, in_metres, refuse_urdf

if TYPE_CHECKING:
    from collections.abc import Iterator

    from pwralign_kin.model import ArticulatedModel
    from pwralign_kin.scan import DepthFrame, Scan
    from pwralign_kin.se3 import Array
    from pwralign_kin.tracking import TrackedFrame


@Parameter(name="*", group=SCAN)
@dataclass(frozen=True)
class StreamOptions:
    """What the files of a stream do not tell of themselves."""

    rate: Annotated[
        float, Parameter(help="Frames per second, where the files tell no times.", validator=Number(gt=0))
    ] = 30.0
    camera: CameraOptions = CAMERA_OPTIONS
    sensor_origin: Annotated[
        Triple | None, Parameter(help="x y z: where scans were seen from; unit of the scans.", negative=())
    ] = None
    topic: Annotated[str | None, Parameter(help="Of a bag: the topic of the point clouds or depth images.")] = None
    units: Annotated[Literal["m", "cm", "mm", "in", "ft"], Parameter(help="Unit of scan files.")] = "m"

    def read(self, paths: Sequence[Path]) -> Iterator[tuple[float, Scan | DepthFrame | Array]]:
        """Yield time (s) and frame, in the unit of its file; raises what `read_frames` raises."""
        from pwralign_kin.scan import FrameOptions, read_frames

        return read_frames(
            paths,
            FrameOptions(
                rate=self.rate,
                sensor_origin=self.sensor_origin,
                intrinsics=self.camera.intrinsics,
                depth_scale=self.camera.depth_scale,
                T_scan_camera=self.camera.placement,
                topic=self.topic,
            ),
        )

    def in_metres(self, frame: Scan | DepthFrame | Array, diagonal: float) -> Scan | DepthFrame | Array:
        """Return the frame in m, beside a model of `diagonal` m; raises `UnitError`."""
        from pwralign_kin.scan import Scan

        return in_metres(frame, self.units, diagonal)[0] if isinstance(frame, Scan) else frame


STREAM_OPTIONS = StreamOptions()


def track(
    urdf: Urdf,
    /,
    *frames: Annotated[
        Path,
        Parameter(help="Scans or 16-bit PNG depth images, a folder of them, an NPZ sequence, or a ROS 2 bag."),
    ],
    out: Annotated[Path | None, Parameter(help="Folder for joints.csv, base.tum and track.json.", group=OUTPUT)] = None,
    mcap: Annotated[
        bool,
        Parameter(
            help="With --out, also write joint states and TF as track.mcap (ros extra).",
            negative=(),
            show_default=False,
            group=OUTPUT,
        ),
    ] = False,
    initial: Annotated[
        Path | None, Parameter(help="A state.json: where the model is in the first frame.", group=GUESS)
    ] = None,
    joint_options: JointOptions = JOINT_OPTIONS,
    stream_options: StreamOptions = STREAM_OPTIONS,
    time_limit: Annotated[
        float | None,
        Parameter(
            help="Seconds that a frame may take; results then depend on the machine.",
            validator=Number(gt=0),
            group=SEARCH,
        ),
    ] = None,
    seed: Seed = 0,
    json: AsJson = False,
    model_options: ModelOptions = MODEL_OPTIONS,
    threads: Threads = 0,
) -> int:
    """Follow a model through a stream of frames: base placement and joint values of each.

    No guess is needed; a lost model is searched for. Results go to stdout, everything else to stderr.
    """
    if not frames:
        raise UsageError("track takes at least one frame.")
    for path in frames:
        refuse_urdf(path)
    if mcap and out is None:
        raise UsageError("--mcap is one of the files that --out writes: give --out.")
    values, locked = joint_options.values, joint_options.locked
    if out is not None:
        arguments.check_folder(out)
    with messages.progress() as show:
        import numpy as np

        from pwralign_kin import dependencies
        from pwralign_kin.estimation import EstimatorOptions
        from pwralign_kin.state import State
        from pwralign_kin.tracking import Tracker, TrackerOptions

        if mcap:
            dependencies.rosbags()
        start = None if initial is None else joint_options.over(State.load(initial))
        stream = stream_options.read(frames)
        show("reading the model")
        model = model_options.read(urdf)
        estimator = EstimatorOptions(seed=seed, threads=threads, locked=locked, prior=values)
        tracker = Tracker(model, TrackerOptions(estimator=estimator, time_limit=time_limit), start)
        tracked: list[TrackedFrame] = []
        written: list[Path] = []
        try:
            for time, frame in stream:
                show(f"frame {len(tracked) + 1}")
                tracked.append(tracker.update(stream_options.in_metres(frame, model.diagonal), time))
        finally:
            # A bad frame, or who has seen enough, does not take away what was tracked before.
            if out is not None and tracked:
                written = _written(tracked, model, out, mcap)
    messages.answer(_as_json(tracked) if json else _summary(tracked, written, model.units))
    return messages.outcome(float(np.median([own.confidence for own in tracked])) if tracked else 0.0, "track")


def _written(tracked: Sequence[TrackedFrame], model: ArticulatedModel, out: Path, mcap: bool) -> list[Path]:
    from pwralign_kin.export.tracks import TrackPoint, export_track

    points = [TrackPoint(own.time, own.state, own.lost, own.std, own.to_dict()) for own in tracked]
    return export_track(points, model, out, mcap=mcap)


def _as_json(tracked: Sequence[TrackedFrame]) -> str:
    from json import dumps

    return dumps([own.to_dict() for own in tracked], indent=1, allow_nan=False)


def _summary(tracked: Sequence[TrackedFrame], written: Sequence[Path], units: Mapping[str, str]) -> str:
    import numpy as np

    from pwralign_kin.estimation.result import joint_table

    lost, searched = sum(own.lost for own in tracked), sum(own.searched for own in tracked)
    lines = [f"{len(tracked)} frame{'s' * (len(tracked) != 1)}, {lost} of them lost, {searched} searched"]
    if tracked:
        seconds = [own.seconds for own in tracked if not own.searched]
        figures = [f"confidence {np.median([own.confidence for own in tracked]):.2f}"]
        figures += [f"{1e3 * np.median(seconds):.1f} ms a frame"] if seconds else []
        lines.append(f"median: {', '.join(figures)}")
        last = tracked[-1]
        lines.append(f"last frame, at {last.time:.3f} s{' (lost)' if last.lost else ''}:")
        lines += joint_table(last.state.joints, last.std, last.undetermined, units)
    return "\n".join([*lines, *messages.wrote(written)])
