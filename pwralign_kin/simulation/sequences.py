"""Moving models with truth: smooth motion of base and joints, seen by depth cameras that stand still."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pwralign_kin.checked_options import CheckedOptions, NotNegative, Positive
from pwralign_kin.directions import fibonacci_directions
from pwralign_kin.scan import DepthFrame
from pwralign_kin.se3 import Array, transform
from pwralign_kin.simulation.raycasting import MovingBodies, looking_at
from pwralign_kin.simulation.simulator import check_seed, generator, random_state
from pwralign_kin.state import State

if TYPE_CHECKING:
    from pwralign_kin.model import ArticulatedModel

_WAVES = 3
"""Sine waves that make up the motion of each joint and coordinate."""

_PERIODS = (2.0, 6.0)
"""Shortest and longest period of a wave, s."""

_MIDDLE = 0.8
"""Joints move within this share of their range."""

_ROOM = 1.15
"""A camera's image holds this many radii of all that the model ever reaches."""


@dataclass(frozen=True)
class Motion(CheckedOptions):
    """How fast a model moves. Raises `OptionError` for values out of range."""

    joint_speed: NotNegative = 1.0
    """Largest speed of a joint, rad/s; of a slide, model diagonals / 5 s for each rad/s."""

    base_speed: NotNegative = 0.15
    """Largest speed of the base along each axis, model diagonals / s."""

    base_turn: NotNegative = 0.3
    """Largest speed of the base about each axis, rad/s."""

    rate: Positive = 30.0
    """Frames per second."""


@dataclass(frozen=True, eq=False)
class SimulatedFrame:
    """What the cameras see at one moment."""

    time: float
    """s."""

    images: tuple[DepthFrame, ...]
    """One of each camera, float depth in m."""

    state: State
    """The truth."""

    pixels: NDArray[np.int64]
    """(parts,) pixels of all images that show each part."""


def smooth_motion(model: ArticulatedModel, frames: int, motion: Motion, seed: int) -> list[State]:
    """Return the states of a model whose base and joints follow sums of sine waves within the limits and speeds."""
    from scipy.spatial.transform import Rotation

    check_seed(seed)
    rng = generator(seed, "motion")
    times = np.arange(frames) / motion.rate
    start = random_state(model, seed)
    middle, half = (model.lower + model.upper) / 2.0, _MIDDLE * (model.upper - model.lower) / 2.0
    speeds = motion.joint_speed * np.where(model.prismatic, model.diagonal / 5.0, 1.0)
    swings = np.stack([_waves(times, speed, most, rng) for speed, most in zip(speeds, half, strict=True)], axis=-1)
    # The start is drawn where the swings leave room, so that the limits are kept.
    room = half - np.abs(swings).max(axis=0)
    values = middle + rng.uniform(-room, room) + swings
    shifts = np.stack([_waves(times, motion.base_speed, 1.0, rng) for _ in range(3)], axis=-1) * model.diagonal
    turns = np.stack([_waves(times, motion.base_turn, 1.0, rng) for _ in range(3)], axis=-1)
    states = []
    for row, shift, turn in zip(values, shifts, turns, strict=True):
        T = start.T_scan_base.copy()
        T[:3, :3] = Rotation.from_rotvec(turn).as_matrix() @ T[:3, :3]
        T[:3, 3] += shift
        states.append(State(T, dict(zip(model.joint_names, row.tolist(), strict=True)), model.root_link))
    return states


def simulate_sequence(
    model: ArticulatedModel,
    frames: int,
    motion: Motion | None = None,
    cameras: int = 1,
    size: tuple[int, int] = (320, 240),
    noise: float = 0.002,
    occluded: tuple[float, float] | None = None,
    seed: int = 0,
) -> Iterator[SimulatedFrame]:
    """Yield what `cameras` around a moving model see; the same arguments give the same frames.

    `size` is columns and rows of the images, `noise` the standard deviation of the distance in model diagonals.
    Between the two times `occluded` (s) a board hides everything from every camera.
    """
    states = smooth_motion(model, frames, motion or Motion(), seed)
    rate = (motion or Motion()).rate
    reached = np.concatenate([_box(model, state) for state in states[:: max(1, frames // 50)]])
    centre = (reached.min(axis=0) + reached.max(axis=0)) / 2.0
    radius = _ROOM * float(np.linalg.norm(reached - centre, axis=1).max())
    rng = generator(seed, "views")
    around = _directions(cameras, rng)
    distance = 2.5 * radius
    focal = 0.5 * min(size) * np.sqrt(distance**2 - radius**2) / radius
    intrinsics = np.array([[focal, 0, (size[0] - 1) / 2.0], [0, focal, (size[1] - 1) / 2.0], [0, 0, 1.0]])
    placements = []
    for direction in around:
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = looking_at(-direction), centre + distance * direction
        placements.append(T)
    sensed = generator(seed, "noise")
    bodies = MovingBodies([(part.vertices, part.faces) for part in model.parts])
    for index, state in enumerate(states):
        time = index / rate
        if occluded is not None and occluded[0] <= time < occluded[1]:
            board = np.full(size[::-1], 0.3 * distance, np.float32)
            hidden = tuple(DepthFrame(board, intrinsics, T) for T in placements)
            yield SimulatedFrame(time, hidden, state, np.zeros(len(model.parts), np.int64))
            continue
        placed = state.T_scan_base @ model.part_placements(model.values(state.joints))
        images, shown = [], np.zeros(len(model.parts), np.int64)
        for T in placements:
            seen = bodies.camera_image(placed, T[:3, 3], T[:3, :3], focal, size)
            shown += np.bincount(seen.body[seen.body >= 0], minlength=len(model.parts))
            along = seen.distance * (seen.directions @ T[:3, 2])
            along += sensed.normal(scale=noise * model.diagonal, size=along.shape)
            depth = np.where(np.isfinite(along), along, 0.0).astype(np.float32)
            images.append(DepthFrame(depth, intrinsics, T, source=f"simulated {model.name}, frame {index}"))
        yield SimulatedFrame(time, tuple(images), state, shown)


def _waves(times: Array, speed: float, most: float, rng: np.random.Generator) -> Array:
    """Return a sum of sine waves (n,) whose speed and size stay within `speed` and `most`."""
    frequencies = 2.0 * np.pi / rng.uniform(*_PERIODS, size=_WAVES)
    shares = rng.dirichlet(np.ones(_WAVES))
    phases = rng.uniform(0.0, 2.0 * np.pi, _WAVES)
    amplitudes = shares * np.minimum(speed / frequencies, most)
    return np.asarray((amplitudes * np.sin(times[:, None] * frequencies + phases)).sum(axis=1))


def _box(model: ArticulatedModel, state: State) -> Array:
    """Return the corners (n, 3) of the boxes around the placed parts, scan frame."""
    placements = state.T_scan_base @ model.part_placements(model.values(state.joints))
    corners = []
    for T, part in zip(placements, model.parts, strict=True):
        if len(part.vertices):
            ends = np.stack([part.vertices.min(axis=0), part.vertices.max(axis=0)])
            grid = np.stack(np.meshgrid(*ends.T), axis=-1).reshape(-1, 3)
            corners.append(transform(T, grid))
    return np.concatenate(corners)


def _directions(count: int, rng: np.random.Generator) -> Array:
    """Return `count` unit vectors spread evenly over the sphere, turned at random."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_quat(rng.normal(size=4)).apply(fibonacci_directions(count)))
