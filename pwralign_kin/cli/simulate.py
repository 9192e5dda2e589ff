"""`pwralign simulate`: scans with truth."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from cyclopts import Group, Parameter

from pwralign_kin.cli import arguments, messages
from pwralign_kin.cli.arguments import SCAN, Joints, Seed
from pwralign_kin.cli.codes import UsageError
from pwralign_kin.cli.model_options import MODEL_OPTIONS, ModelOptions, Urdf

if TYPE_CHECKING:
    from pwralign_kin.simulation import Room, Sensor

POSE, ROOM = Group("Pose", sort_key=2), Group("Room", sort_key=3.5)


@Parameter(name="*", group=SCAN)
@dataclass(frozen=True)
class SensorOptions:
    """How a model is scanned: as a tier says, but for what is given."""

    tier: Annotated[
        Literal["full", "single", "hololens", "sparse", "missing", "clutter", "warm"] | None,
        Parameter(help="What the scan is like, by default full; the options below change one thing each."),
    ] = None
    views: Annotated[int | None, Parameter(help="Depth images to fuse, from all sides.")] = None
    points: Annotated[int | None, Parameter(help="Points to keep.")] = None
    noise: Annotated[float | None, Parameter(help="Standard deviation, in model diagonals.")] = None
    outliers: Annotated[float | None, Parameter(help="Stray points to add, share of --points.")] = None
    missing_part: Annotated[list[str] | None, Parameter(help="A part to leave out; may be repeated.", negative=())] = (
        None
    )
    known_origin: Annotated[
        bool | None, Parameter(help="Whether truth.json tells where the (single) view was taken from.")
    ] = None

    @property
    def changes(self) -> dict[str, Any]:
        """What is given besides tier and noise, by the names of `Sensor`."""
        return _given(
            views=self.views,
            points=self.points,
            stray=self.outliers,
            missing_parts=tuple(self.missing_part) if self.missing_part else None,
            known_origin=self.known_origin,
        )

    @property
    def sensor(self) -> Sensor:
        """The sensor; raises `OptionError` for values that none has."""
        from pwralign_kin.simulation import TIERS

        return dataclasses.replace(TIERS[self.tier or "full"], **self.changes, **_given(noise=self.noise))


@Parameter(name="*", group=ROOM)
@dataclass(frozen=True)
class RoomOptions:
    """What stands around a model that is seen by one depth camera."""

    scene: Annotated[
        bool,
        Parameter(
            help="A whole room instead, with the model upright in it, seen by one depth camera and in its frame (x "
            "right, y down, z ahead).",
            negative=(),
            show_default=False,
        ),
    ] = False
    furniture: Annotated[int | None, Parameter(help="With --scene: boxes and cylinders apart from the model.")] = None
    contacts: Annotated[int | None, Parameter(help="With --scene: things pushed against the model.")] = None
    occluders: Annotated[int | None, Parameter(help="With --scene: things between camera and model.")] = None
    second_copy: Annotated[
        bool | None, Parameter(help="With --scene: another copy of the model in another pose.", negative=())
    ] = None
    table: Annotated[bool | None, Parameter(help="With --scene: whether the model stands on a table.")] = None

    @property
    def changes(self) -> dict[str, Any]:
        """What is given of the things around the model, by the names of `Room`."""
        own = dataclasses.asdict(self)
        del own["scene"]
        return _given(**own)

    def check(self, sensor: SensorOptions) -> None:
        """Raise `UsageError` where the options of a room and of a sensor exclude each other."""
        if self.scene and (sensor.tier or sensor.changes):
            raise UsageError("--scene is seen by one depth camera: of the options of a scan it takes --noise only.")
        if not self.scene and self.changes:
            raise UsageError("what stands around the model needs --scene.")

    def room(self, noise: float | None) -> Room | None:
        """Return the room, seen with `noise`; None without --scene. Raises `OptionError` for values that none has."""
        from pwralign_kin.simulation import Room

        return Room(**self.changes, **_given(noise=noise)) if self.scene else None


SENSOR_OPTIONS, ROOM_OPTIONS = SensorOptions(), RoomOptions()


def simulate(
    urdf: Urdf,
    /,
    *,
    out: Annotated[Path, Parameter(help="Folder for scan.ply, truth.json and labels.npz.", group=arguments.OUTPUT)],
    sensor_options: SensorOptions = SENSOR_OPTIONS,
    room_options: RoomOptions = ROOM_OPTIONS,
    state: Annotated[Path | None, Parameter(help="A state.json of the model's pose; else random.", group=POSE)] = None,
    joint: Annotated[Joints, Parameter(help="name=value, rad or m; may be repeated.", group=POSE)] = None,
    seed: Annotated[
        Seed, Parameter(help="Of pose and scan: the same seed, below 2**32, gives the same.", group=POSE)
    ] = 0,
    model_options: ModelOptions = MODEL_OPTIONS,
) -> None:
    """Scan a model in software, alone or in a room: points with the truth beside them.

    In a room the model stands upright; of a --state it takes the joint values.
    """
    values = arguments.joint_values(joint)
    room_options.check(sensor_options)
    arguments.check_folder(out)
    with messages.progress() as show:
        from pwralign_kin.simulation import random_state, simulate_scene
        from pwralign_kin.simulation.simulator import simulate as scanned
        from pwralign_kin.state import State

        room, sensor = room_options.room(sensor_options.noise), sensor_options.sensor
        given_pose = None if state is None else State.load(state)
        show("reading the model")
        model = model_options.read(urdf)
        model.check_limits(values)
        show("scanning")
        pose = given_pose or random_state(model, seed)
        pose = State(pose.T_scan_base, {**pose.joints, **values}, pose.base_link)
        result = scanned(model, pose, sensor, seed) if room is None else simulate_scene(model, pose, room, seed)
        result.save(out)
    own = result.labels[result.labels >= 0]
    points_seen = f"{len(result.scan)} points" + (f", {len(own)} of them" if room is not None else "")
    parts_seen = f"{len(set(own.tolist()))} of {len(model.parts)} parts"
    messages.answer(f"{points_seen} on {parts_seen} of {model.name}, in {out}")


def _given(**options: Any) -> dict[str, Any]:
    return {name: value for name, value in options.items() if value is not None}
