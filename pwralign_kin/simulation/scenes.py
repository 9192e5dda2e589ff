"""Whole rooms with truth, as one depth camera sees them: the model on a table or the floor among other things."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import numpy as np
from numpy.typing import NDArray

from pwralign_kin.checked_options import CheckedOptions, Natural, NotNegative, Positive, Range, Share, check_increasing
from pwralign_kin.exceptions import ModelError, ScanError
from pwralign_kin.scan import Scan
from pwralign_kin.se3 import Array, inverse, transform
from pwralign_kin.simulation.raycasting import Body, DepthImage, World, looking_at
from pwralign_kin.simulation.simulator import (
    EDGE_JUMP,
    SimulatedCopy,
    SimulatedScan,
    check_seed,
    complete_state,
    generator,
    part_names,
    posed_parts,
    random_state,
    with_mixed_pixels,
)
from pwralign_kin.state import State

if TYPE_CHECKING:
    from pwralign_kin.model import ArticulatedModel

_TRIES = 12
"""Cameras (and what stands in their way) that are tried until enough of the model is seen."""

_POLE_SHARE = (0.35, 0.65)
"""An occluder stands this share of the way from the camera to the model."""


@dataclass(frozen=True)
class Room(CheckedOptions):
    """What stands around the model, and the depth camera that sees it all.

    Lengths are shares of the model's diagonal at q = 0. Up is the root link's +z. Raises `OptionError` for values out
    of range.
    """

    table: bool = True
    """Whether the model stands on a table, else on the floor."""

    size: tuple[Positive, Positive] = (5.0, 8.0)
    """Least and largest side of the square room."""

    furniture: Natural = 6
    """Boxes and cylinders on the floor and the table, apart from the model."""

    contacts: Natural = 0
    """Boxes and cylinders pushed against the model."""

    occluders: Natural = 0
    """Poles and boxes between the camera and the model."""

    second_copy: bool = False
    """Whether another copy of the model, in another configuration, stands farther from the camera. Its points are
    labelled -1, but answers that find it are right too: see `SimulatedScan.copies`."""

    distance: tuple[Positive, Positive] = (1.6, 2.8)
    """Distance of the camera from the model's middle."""

    columns: Annotated[int, Range(2, 10**4)] = 320
    rows: Annotated[int, Range(2, 10**4)] = 240
    field_of_view: Annotated[float, Range(0.01, 3.1)] = float(np.radians(65.0))
    """Across the columns, rad."""

    noise: NotNegative = 0.002
    """Standard deviation of the distance at two diagonals; it grows with the square of the distance."""

    mixed_pixels: Share = 0.3
    """Share of the pixels at depth edges that show a depth between the two surfaces (flying pixels)."""

    least_seen: Share = 0.5
    """Share of the model's pixels that is neither hidden nor out of the image, where any try reaches it."""

    def __post_init__(self) -> None:
        """Check the values."""
        super().__post_init__()
        check_increasing(self, "size", "distance")


def simulate_scene(
    model: ArticulatedModel, state: State | None = None, room: Room | None = None, seed: int = 0
) -> SimulatedScan:
    """Return one depth image of `model` in a room; the same arguments give the same points.

    Only the joint values of `state` are taken (without one they are drawn by `random_state`): the model stands upright
    on its support. The scan frame is the camera's (x right, y down, z forward), the sensor origin its origin.

    Raises `ModelError` for a model without geometry, `UnknownNameError` for joints that do not exist, and `ScanError`
    when nothing of the model is seen.
    """
    check_seed(seed)
    room = room or Room()
    if not any(len(part.faces) for part in model.parts):
        raise ModelError(model.urdf_path, "the model has no geometry to scan")
    given = random_state(model, seed) if state is None else complete_state(model, state)
    upright = State(np.eye(4), given.joints, model.root_link)
    rng = generator(seed, "scene")
    bodies = posed_parts(model, upright)
    surroundings = _Surroundings(model, bodies, room, rng)
    surroundings.furnish()
    best, axes, origin = _best_view(model, bodies, surroundings, room, generator(seed, "camera"))

    T_room_camera = np.eye(4)
    T_room_camera[:3, :3], T_room_camera[:3, 3] = axes, origin
    noise_rng = generator(seed, "noise")
    image = with_mixed_pixels(best, room.mixed_pixels, EDGE_JUMP * model.diagonal, noise_rng)
    hit = np.isfinite(image.distance)
    deviation = room.noise * model.diagonal * (image.distance[hit] / (2.0 * model.diagonal)) ** 2
    distance = image.distance[hit] + noise_rng.normal(size=deviation.shape) * deviation
    points = transform(inverse(T_room_camera), origin + distance[:, None] * image.directions[hit])
    body = image.body[hit]
    T_camera_room = inverse(T_room_camera)
    scan = Scan(points.astype(np.float32), sensor_origin=np.zeros(3), source=f"simulated scene of {model.name}")
    return SimulatedScan(
        scan=scan,
        state=State(T_camera_room, given.joints, model.root_link),
        labels=_labels(body, 0, len(model.parts))[scan.source_index],
        part_names=part_names(model),
        view=np.zeros(len(scan.points), np.int64),
        view_origins=np.zeros((1, 3)),
        guess=None,
        copies=tuple(
            SimulatedCopy(
                State(T_camera_room @ copy.T_scan_base, copy.joints, model.root_link),
                _labels(body, first + len(bodies), len(model.parts))[scan.source_index],
            )
            for copy, first in surroundings.copies
        ),
    )


def _labels(body: NDArray[np.int64], first: int, count: int) -> NDArray[np.int64]:
    """Return the part of each point whose body is one of `count` from `first` on, -1 for the others."""
    return np.where((body >= first) & (body < first + count), body - first, -1)


class _Surroundings:
    """Bodies around a posed model, in the room's frame: up is +z."""

    def __init__(self, model: ArticulatedModel, posed: list[Body], room: Room, rng: np.random.Generator) -> None:
        self.model = model
        self.room = room
        self.rng = rng
        self.unit = model.diagonal
        self.vertices = np.concatenate([vertices for vertices, _ in posed])
        self.posed = World(posed)
        self.middle = (self.vertices.min(axis=0) + self.vertices.max(axis=0)) / 2.0
        self.support = float(self.vertices[:, 2].min())
        self.floor = self.support - (rng.uniform(0.5, 1.0) * self.unit if room.table else 0.0)
        self.side = rng.uniform(*room.size) * self.unit
        self.corner = self.middle[:2] + rng.uniform(-0.25, 0.25, 2) * self.side - self.side / 2.0
        self.bodies: list[Body] = []
        self.copies: list[tuple[State, int]] = []

    def furnish(self) -> None:
        """Put up walls, floor, support, furniture, contacts and the second copy."""
        low = np.append(self.corner, self.floor)
        high = low + np.array([self.side, self.side, max(2.5, self.room.size[0]) * self.unit])
        self._add_box(low - 0.05 * self.unit, np.append(high[:2] + 0.05 * self.unit, self.floor))
        for axis in (0, 1):
            for end in (low, high):
                wall_low, wall_high = low.copy(), high.copy()
                wall_low[axis] = wall_high[axis] = end[axis]
                wall_low[axis] -= 0.02 * self.unit
                self._add_box(wall_low, wall_high)
        half = np.ptp(self.vertices[:, :2], axis=0) / 2.0
        if self.room.table:
            extent = half + self.rng.uniform(0.15, 0.6, 2) * self.unit
            shift = self.rng.uniform(-0.1, 0.1, 2) * self.unit
            top = np.append(self.middle[:2] + shift + extent, self.support)
            self._add_box(np.append(self.middle[:2] + shift - extent, self.support - 0.05 * self.unit), top)
        self._add_pedestal()
        if self.room.second_copy:
            self._add_copy()
        for _ in range(self.room.furniture):
            self._add_furniture()
        for _ in range(self.room.contacts):
            self._add_contact()

    def occluder(self, origin: Array) -> Body:
        """Return a pole or a box between the camera and the model."""
        share = self.rng.uniform(*_POLE_SHARE)
        aim = self.vertices[self.rng.integers(len(self.vertices))]
        centre = origin + share * (aim - origin)
        width = share * self.rng.uniform(0.05, 0.14) * self.unit
        if self.rng.random() < 0.5:
            size = np.array([width, width, 2.0 * (centre[2] - self.floor)])
        else:
            size = width * self.rng.uniform(0.8, 2.0, 3)
        return _box(centre - size / 2.0, centre + size / 2.0)

    def _add_box(self, low: Array, high: Array) -> None:
        self.bodies.append(_box(low, high))

    def _add_pedestal(self) -> None:
        """Put a block under the root part where it hangs in the air because other parts reach lower."""
        import trimesh.creation

        root = next(part for part in self.model.parts if len(part.faces))
        low = root.vertices.min(axis=0) if root is self.model.parts[0] else self.vertices.min(axis=0)
        height = float(low[2] - self.support)
        if root is not self.model.parts[0] or height < 0.02 * self.unit:
            return
        middle = (root.vertices.min(axis=0) + root.vertices.max(axis=0))[:2] / 2.0
        radius = max(0.04 * self.unit, 0.35 * float(np.ptp(root.vertices[:, :2], axis=0).min()))
        block = trimesh.creation.cylinder(radius=radius, height=height, sections=32)
        self.bodies.append(_moved(block, np.append(middle, self.support + height / 2.0)))

    def _add_copy(self) -> None:
        state = random_state(self.model, int(self.rng.integers(1 << 30)))
        T = _yaw(self.rng.uniform(0.0, 2.0 * np.pi))
        other = posed_parts(self.model, State(T, state.joints, self.model.root_link))
        vertices = np.concatenate([body for body, _ in other])
        away = float(np.linalg.norm(np.ptp(self.vertices[:, :2], axis=0))) / 2.0
        away += float(np.linalg.norm(np.ptp(vertices[:, :2], axis=0))) / 2.0 + 0.05 * self.unit
        angle = self.rng.uniform(0.0, 2.0 * np.pi)
        foot = np.append(self.middle[:2] + away * np.array([np.cos(angle), np.sin(angle)]), self.support)
        middle = (vertices.min(axis=0) + vertices.max(axis=0)) / 2.0
        shift = foot - np.append(middle[:2], vertices[:, 2].min())
        T[:3, 3] = shift
        self.copy_direction = np.array([np.cos(angle), np.sin(angle)])
        self.copies.append((State(T, state.joints, self.model.root_link), len(self.bodies)))
        self.bodies += [(placed + shift, faces) for placed, faces in other]

    def _add_furniture(self) -> None:
        """Put a box or a cylinder on the floor or the table, clear of the model."""
        import trimesh.creation

        on_table = self.room.table and self.rng.random() < 0.4
        largest = 0.35 if on_table else 0.9
        size = self.rng.uniform(0.1, largest, 3) * self.unit
        if self.rng.random() < 0.5:
            solid = trimesh.creation.box(size)
        else:
            solid = trimesh.creation.cylinder(radius=size[0] / 2.0, height=size[2], sections=48)
        radius = float(np.linalg.norm(np.asarray(solid.vertices)[:, :2], axis=1).max())
        reach = float(np.linalg.norm(self.vertices[:, :2] - self.middle[:2], axis=1).max())
        away = reach + radius + self.rng.uniform(0.02, 0.15 if on_table else 1.5) * self.unit
        angle = self.rng.uniform(0.0, 2.0 * np.pi)
        ground = self.support if on_table else self.floor
        foot = self.middle[:2] + away * np.array([np.cos(angle), np.sin(angle)])
        self.bodies.append(_moved(solid, np.append(foot, ground + size[2] / 2.0), self.rng.uniform(0.0, np.pi)))

    def _add_contact(self) -> None:
        """Push a box or a cylinder on the support against the model until they touch."""
        import trimesh.creation

        size = self.rng.uniform(0.08, 0.25, 3) * self.unit
        if self.rng.random() < 0.5:
            solid = trimesh.creation.box(size)
        else:
            solid = trimesh.creation.cylinder(radius=size[0] / 2.0, height=size[2], sections=48)
        angle = self.rng.uniform(0.0, 2.0 * np.pi)
        towards = -np.array([np.cos(angle), np.sin(angle), 0.0])
        # A thing at the height of a point of the model meets it when it is pushed along.
        aim = self.vertices[self.rng.integers(len(self.vertices))]
        height = max(self.support + size[2] / 2.0, min(aim[2], self.support + 0.35 * self.unit))
        start = np.append(aim[:2], height) - 3.0 * self.unit * towards
        vertices, faces = _moved(solid, start, self.rng.uniform(0.0, np.pi))
        travel = self.posed.travel(_face_grid(vertices, faces), towards)
        if np.isfinite(travel):
            if height - size[2] / 2.0 > self.support + 0.01 * self.unit:
                # Nothing hovers: what touches the model above the support reaches down to it.
                vertices[:, 2] = np.where(vertices[:, 2] < height, self.support, vertices[:, 2])
            self.bodies.append((vertices + travel * towards, faces))


def _face_grid(vertices: Array, faces: NDArray[np.int64], steps: int = 6) -> Array:
    """Return points spread over the triangles."""
    weights = np.array([(i, j, steps - i - j) for i in range(steps + 1) for j in range(steps + 1 - i)]) / steps
    return np.asarray(np.einsum("wc,fci->fwi", weights, vertices[faces]).reshape(-1, 3))


def _yaw(angle: float) -> Array:
    T = np.eye(4)
    T[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    return T


def _box(low: Array, high: Array) -> Body:
    import trimesh.creation

    return _moved(trimesh.creation.box(np.maximum(high - low, 1e-6)), (low + high) / 2.0)


def _moved(solid: object, centre: Array, yaw: float = 0.0) -> Body:
    vertices = np.asarray(solid.vertices)  # type: ignore[attr-defined]
    faces = np.asarray(solid.faces, dtype=np.int64)  # type: ignore[attr-defined]
    return vertices @ _yaw(yaw)[:3, :3].T + centre, faces


def _best_view(
    model: ArticulatedModel,
    bodies: list[Body],
    surroundings: _Surroundings,
    room: Room,
    rng: np.random.Generator,
) -> tuple[DepthImage, Array, Array]:
    """Return the image, the camera's axes and its place of the first try that sees enough of the model, or the best."""
    focal = room.columns / 2.0 / np.tan(room.field_of_view / 2.0)
    best: tuple[float, DepthImage, Array, Array] | None = None
    for _ in range(_TRIES):
        azimuth = rng.uniform(0.0, 2.0 * np.pi)
        if room.second_copy:
            # The copy stands behind the model or beside it.
            back = surroundings.copy_direction
            azimuth = float(np.arctan2(-back[1], -back[0])) + rng.uniform(-1.1, 1.1)
        height = rng.uniform(0.1, 0.6)
        flat = np.sqrt(1.0 - height**2)
        direction = np.array([flat * np.cos(azimuth), flat * np.sin(azimuth), height])
        origin = surroundings.middle + rng.uniform(*room.distance) * model.diagonal * direction
        # The model is somewhere in the image, not in its middle.
        axes = looking_at(surroundings.middle + rng.uniform(-0.3, 0.3, 3) * model.diagonal - origin)
        # A camera is held upright: its columns point down.
        right = np.cross(axes[:, 2], [0.0, 0.0, 1.0])
        right /= np.linalg.norm(right)
        axes = np.stack([right, np.cross(axes[:, 2], right), axes[:, 2]], axis=-1)
        way = [surroundings.occluder(origin) for _ in range(room.occluders)]
        size = (room.columns, room.rows)
        image = World([*bodies, *surroundings.bodies, *way]).camera_image(origin, axes, focal, size)
        alone = World(bodies).camera_image(origin, axes, focal / 2.0, size)
        seen = int(((image.body >= 0) & (image.body < len(model.parts))).sum())
        share = seen / max(1, 4 * int((alone.body >= 0).sum()))
        if seen and (best is None or share > best[0]):
            best = (share, image, axes, origin)
        if share >= room.least_seen:
            break
    if best is None:
        raise ScanError(f"simulated scene of {model.name}", "nothing of the model is seen")
    return best[1:]
