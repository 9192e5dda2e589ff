"""Model + state + sensor -> scan with truth."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pwralign_kin import files
from pwralign_kin.checked_options import Seed, checked_number
from pwralign_kin.exceptions import ArgumentError, ModelError, ScanError, UnknownNameError
from pwralign_kin.model import ArticulatedModel
from pwralign_kin.scan import Scan, write_ply
from pwralign_kin.se3 import Array, rotation_about, transform
from pwralign_kin.simulation.clutter import table_and_solids
from pwralign_kin.simulation.raycasting import Body, DepthImage, World
from pwralign_kin.simulation.sensor import FULL, GuessOffset, Sensor
from pwralign_kin.state import State

_PLACEMENT_RANGE = 2.0
"""A random base lies within this many diagonals of the scan's origin, along each axis."""

_CLEARANCE = 1.3
"""A camera stays this many radii of the scene's sphere away from its middle."""

_TRIAL_PIXELS, _MAX_PIXELS = 16_000, 2_000_000
"""Pixels of a first image, which tells how many show the model, and at most of the one that the scan is made from."""

_OVERSAMPLING = 3.0
"""Rays that hit per point kept, so that the pixel grid does not show in the scan."""

EDGE_JUMP = 0.02
"""Neighbouring pixels farther apart in depth than this share of the diagonal form a depth edge."""

_STRAY_MARGIN = 0.25
"""Stray points are drawn from the box of the points on the model and so much around it, diagonals."""

_WAVES, _WAVE_LENGTH = 8, 0.4
"""Waves, and their usual length (diagonals), that a bent surface is made of."""

_MIN_PART_SHARE = 0.01
"""A part drawn to be missing has at least this share of the points, so that its loss is one."""


@dataclass(frozen=True, eq=False)
class SimulatedCopy:
    """Another copy of the model in a simulated scene: finding it is as right as finding the first."""

    state: State
    labels: NDArray[np.int64]
    """(n,) as `SimulatedScan.labels`, but of this copy."""


@dataclass(frozen=True, eq=False)
class SimulatedScan:
    """A scan with its truth."""

    scan: Scan
    """The points, exact in single precision."""

    state: State
    """The true placement of the root link and every actuated joint's value."""

    labels: NDArray[np.int64]
    """(n,) index in `part_names` (the order of `model.parts`) of each point's part; -1 for stray points,
    clutter and mixed pixels, which lie on no part."""

    part_names: tuple[str, ...]
    """Names of the model's parts."""

    view: NDArray[np.int64]
    """(n,) index in `view_origins` of the camera that saw each point."""

    view_origins: Array
    """(v, 3) where the cameras were, scan frame, m; also known here where the scan does not tell."""

    guess: State | None
    """A guess near the truth, where the sensor asks for one."""

    copies: tuple[SimulatedCopy, ...] = ()
    """Other copies of the model in the scene."""

    def save(self, folder: Path | str) -> None:
        """Write `scan.ply`, `truth.json`, `labels.npz` and, with a guess, `guess.json` into `folder`, all or none.

        `truth.json` is a state file with three more entries, `sensor_origin` ((3,) or null, as the scan tells), `parts`
        (the names that the labels index) and `copies` (the states of other copies of the model). `labels.npz` holds
        `part` (n,), `view` (n,), `view_origins` (v, 3) and `copies` (c, n), the labels of the other copies. Raises
        `ExportError`.
        """
        with files.atomic_folder(folder, optional=["guess.json"]) as new:
            self._write(new)

    def _write(self, folder: Path) -> None:
        origin = self.scan.sensor_origin
        seen_from = origin if origin is not None and origin.ndim == 1 else None
        write_ply(folder / "scan.ply", self.scan.points.astype(np.float32), sensor_origin=seen_from)
        copies = np.array([copy.labels for copy in self.copies], np.int64).reshape(-1, len(self.labels))
        np.savez_compressed(
            folder / "labels.npz", part=self.labels, view=self.view, view_origins=self.view_origins, copies=copies
        )
        if self.guess is not None:
            self.guess.save(folder / "guess.json")
        truth = {
            **self.state.to_dict(),
            "sensor_origin": None if seen_from is None else seen_from.tolist(),
            "parts": list(self.part_names),
            "copies": [copy.state.to_dict() for copy in self.copies],
        }
        files.write_text(folder / "truth.json", json.dumps(truth, indent=2) + "\n")


@dataclass(frozen=True)
class _Returns:
    """Points in the making, one row each."""

    points: Array
    labels: NDArray[np.int64]
    view: NDArray[np.int64]
    directions: Array

    def only(self, rows: NDArray[np.int64] | NDArray[np.bool_]) -> _Returns:
        return _Returns(self.points[rows], self.labels[rows], self.view[rows], self.directions[rows])


def simulate(
    model: ArticulatedModel, state: State | None = None, sensor: Sensor = FULL, seed: int = 0
) -> SimulatedScan:
    """Scan `model` in `state` with `sensor`; the same arguments give the same points.

    Without a state one is drawn by `random_state`. Different sensors with one seed see the same state, and
    sensors that differ in their flaws only the same views.

    Raises `ModelError` for a model without geometry, `UnknownNameError` for joints, links or missing parts
    that do not exist, `OptionError` for a seed out of range, and `ScanError` when too few points are left to make a
    scan.
    """
    check_seed(seed)
    for value, kind in ((model, ArticulatedModel), (state, State | None), (sensor, Sensor)):
        if not isinstance(value, kind):
            raise ArgumentError("simulate", getattr(kind, "__name__", "State"), type(value).__name__)
    if not any(len(part.faces) for part in model.parts):
        raise ModelError(model.urdf_path, "the model has no geometry to scan")
    unknown = [name for name in sensor.missing_parts if name not in part_names(model)]
    if unknown:
        raise UnknownNameError("part", unknown[0], part_names(model))
    truth = random_state(model, seed) if state is None else complete_state(model, state)
    bodies = posed_parts(model, truth)
    if sensor.clutter:
        placed = np.concatenate([vertices for vertices, _ in bodies])
        bodies += table_and_solids(placed, model.diagonal, generator(seed, "clutter"))

    images = _depth_images(World(bodies), model.diagonal, sensor, seed)
    returns = _fused(images, model, sensor, seed)
    returns = _without_missing(returns, model, sensor, seed)
    returns = _bent(returns, model.diagonal, sensor, seed)
    returns = _noisy(returns, model.diagonal, sensor, seed)
    returns = _rounded(returns, model.diagonal, sensor)
    returns = _with_strays(returns, model.diagonal, sensor, seed)

    view_origins = np.stack([image.origin for image in images])
    origin = None
    if sensor.known_origin:
        origin = view_origins[0] if sensor.views == 1 else view_origins[returns.view]
    scan = Scan(returns.points.astype(np.float32), sensor_origin=origin, source=f"simulated {model.name}")
    return SimulatedScan(
        scan=scan,
        state=truth,
        labels=returns.labels[scan.source_index],
        part_names=part_names(model),
        view=returns.view[scan.source_index],
        view_origins=view_origins,
        guess=None if sensor.guess is None else _perturbed(model, truth, sensor.guess, seed),
    )


def random_state(model: ArticulatedModel, seed: int) -> State:
    """Draw joints uniform within their limits and a base uniform over rotations, within two diagonals of the
    origin."""
    from scipy.spatial.transform import Rotation

    check_seed(seed)
    rng = generator(seed, "state")
    values = rng.uniform(model.lower, model.upper)
    T = np.eye(4)
    T[:3, :3] = Rotation.from_quat(rng.normal(size=4)).as_matrix()
    T[:3, 3] = rng.uniform(-_PLACEMENT_RANGE, _PLACEMENT_RANGE, 3) * model.diagonal
    return State(T, dict(zip(model.joint_names, values.tolist(), strict=True)), model.root_link)


_PURPOSES = (
    "state", "clutter", "views", "returns", "missing", "noise", "stray", "guess", "scene", "camera", "motion", "bend",
)  # fmt: skip
"""What random numbers are drawn for. Places count: a new purpose stands last, or all simulated scans change."""


def generator(seed: int, purpose: str) -> np.random.Generator:
    """Return the random numbers of one purpose, so that an option of one does not change those of another."""
    return np.random.default_rng([seed, _PURPOSES.index(purpose)])


def check_seed(seed: int) -> None:
    """Raise `OptionError` for a seed that cannot be one."""
    checked_number("seed", seed, Seed)


def part_names(model: ArticulatedModel) -> tuple[str, ...]:
    """Return the names that labels index."""
    return tuple(part.name for part in model.parts)


def complete_state(model: ArticulatedModel, state: State) -> State:
    """Return `state` with its base at the root link and a value for every joint.

    Raises `UnknownNameError` and `StateError` for joints that the model has not or that are beyond their limits.
    """
    model.check_limits(state.joints)
    values = model.values(state.joints)
    joints = dict(zip(model.joint_names, values.tolist(), strict=True))
    return State(model.root_placement(state), joints, model.root_link)


def posed_parts(model: ArticulatedModel, state: State) -> list[Body]:
    """Return the body of every part where the state places it."""
    placements = state.T_scan_base @ model.part_placements(model.values(state.joints))
    return [(transform(T, part.vertices), part.faces) for T, part in zip(placements, model.parts, strict=True)]


def _depth_images(world: World, diagonal: float, sensor: Sensor, seed: int) -> list[DepthImage]:
    """Look at the world from all sides with as many rays as the points asked for need."""
    rng = generator(seed, "views")
    directions = _directions(sensor.views, sensor.clutter, rng)
    distances = rng.uniform(*sensor.distance, size=sensor.views) * diagonal
    distances = np.maximum(distances, _CLEARANCE * world.radius)
    origins = world.centre + distances[:, None] * directions
    trial = [world.depth_image(origin, _TRIAL_PIXELS) for origin in origins]
    hits = sum(int(np.isfinite(image.distance).sum()) for image in trial)
    wanted = _OVERSAMPLING * sensor.points * _TRIAL_PIXELS / max(hits, 1)
    return [world.depth_image(origin, int(np.clip(wanted, _TRIAL_PIXELS, _MAX_PIXELS))) for origin in origins]


def _directions(count: int, from_above: bool, rng: np.random.Generator) -> Array:
    """Return `count` unit vectors spread evenly (a Fibonacci lattice), turned at random; or above the horizon
    only."""
    from scipy.spatial.transform import Rotation

    steps = (np.arange(count) + 0.5) / count
    height = 0.1 + 0.4 * steps if from_above else 1.0 - 2.0 * steps
    azimuth = np.pi * (3.0 - np.sqrt(5.0)) * np.arange(count) + rng.uniform(0.0, 2.0 * np.pi)
    flat = np.sqrt(1.0 - height**2)
    lattice = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), height], axis=-1)
    return lattice if from_above else np.asarray(Rotation.from_quat(rng.normal(size=4)).apply(lattice))


def _fused(images: list[DepthImage], model: ArticulatedModel, sensor: Sensor, seed: int) -> _Returns:
    """Return the points of all images, thinned to the number asked for."""
    rng = generator(seed, "returns")
    pieces = []
    for index, seen in enumerate(images):
        image = with_mixed_pixels(seen, sensor.mixed_pixels, EDGE_JUMP * model.diagonal, rng)
        hit = np.isfinite(image.distance)
        body = image.body[hit]
        labels = np.where(body < len(model.parts), body, -1)
        pieces.append(_Returns(image.points[hit], labels, np.full(len(labels), index), image.directions[hit]))
    fused = _Returns(
        points=np.concatenate([piece.points for piece in pieces]),
        labels=np.concatenate([piece.labels for piece in pieces]),
        view=np.concatenate([piece.view for piece in pieces]),
        directions=np.concatenate([piece.directions for piece in pieces]),
    )
    if len(fused.points) <= sensor.points:
        return fused
    return fused.only(np.sort(rng.choice(len(fused.points), sensor.points, replace=False)))


def with_mixed_pixels(image: DepthImage, share: float, jump: float, rng: np.random.Generator) -> DepthImage:
    """Return the image with `share` of its edge pixels, to the right or below, moved towards the neighbour's
    depth."""
    distance, body = image.distance.copy(), image.body.copy()
    for axis in (0, 1):
        here = (slice(None, -1), slice(None)) if axis == 0 else (slice(None), slice(None, -1))
        there = (slice(1, None), slice(None)) if axis == 0 else (slice(None), slice(1, None))
        near, far = image.distance[here], image.distance[there]
        chance, between = rng.random((2, *near.shape))
        seen = np.isfinite(near) & np.isfinite(far)
        step = np.where(seen, far, 0.0) - np.where(seen, near, 0.0)
        mixed = (np.abs(step) > jump) & (chance < share)
        distance[here][mixed] = (near + between * step)[mixed]
        body[here][mixed] = -1
    return DepthImage(origin=image.origin, directions=image.directions, distance=distance, body=body)


def _without_missing(returns: _Returns, model: ArticulatedModel, sensor: Sensor, seed: int) -> _Returns:
    """Leave out the points of missing parts, then one contiguous piece of the model's other points."""
    rng = generator(seed, "missing")
    missing = {part_names(model).index(name) for name in sensor.missing_parts}
    counts = np.bincount(returns.labels[returns.labels >= 0], minlength=len(model.parts))
    seen = [int(i) for i in np.flatnonzero(counts >= _MIN_PART_SHARE * counts.sum()) if i not in missing]
    if sensor.missing_random_parts and sensor.missing_random_parts >= len(seen):
        raise ScanError(
            f"simulated {model.name}",
            f"cannot leave out {sensor.missing_random_parts} of the {len(seen)} parts seen and keep any",
        )
    missing |= set(rng.choice(seen, sensor.missing_random_parts, replace=False).tolist())
    returns = returns.only(~np.isin(returns.labels, list(missing)))

    on_model = np.flatnonzero(returns.labels >= 0)
    bite = round(sensor.missing_share * len(on_model))
    if bite == 0:
        return returns
    centre = returns.points[rng.choice(on_model)]
    nearest = np.argsort(np.linalg.norm(returns.points[on_model] - centre, axis=1), kind="stable")[:bite]
    return returns.only(np.delete(np.arange(len(returns.points)), on_model[nearest]))


def _bent(returns: _Returns, diagonal: float, sensor: Sensor, seed: int) -> _Returns:
    """Move the points along their rays by random waves through space, those of every view alike."""
    if sensor.bend == 0.0:
        return returns
    rng = generator(seed, "bend")
    waves = rng.normal(size=(_WAVES, 3)) * 2.0 * np.pi / (_WAVE_LENGTH * diagonal)
    phases = rng.uniform(0.0, 2.0 * np.pi, _WAVES)
    offset = np.sqrt(2.0 / _WAVES) * np.cos(returns.points @ waves.T + phases).sum(axis=1)
    bent = returns.points + sensor.bend * diagonal * offset[:, None] * returns.directions
    return _Returns(bent, returns.labels, returns.view, returns.directions)


def _noisy(returns: _Returns, diagonal: float, sensor: Sensor, seed: int) -> _Returns:
    rng = generator(seed, "noise")
    sigma = sensor.noise * diagonal
    if sensor.noise_along_ray:
        offset = rng.normal(scale=sigma, size=(len(returns.points), 1)) * returns.directions
    else:
        offset = rng.normal(scale=sigma, size=returns.points.shape)
    return _Returns(returns.points + offset, returns.labels, returns.view, returns.directions)


def _rounded(returns: _Returns, diagonal: float, sensor: Sensor) -> _Returns:
    """Move each point to the mean of those about it, as a mesh fused from many views does."""
    if sensor.rounding == 0.0 or len(returns.points) == 0:
        return returns
    from scipy.spatial import cKDTree

    tree, radius = cKDTree(returns.points), sensor.rounding * diagonal
    # One by one: all neighbours of dense scans together do not fit into memory.
    means = np.array([returns.points[tree.query_ball_point(point, radius)].mean(axis=0) for point in returns.points])
    return _Returns(means, returns.labels, returns.view, returns.directions)


def _with_strays(returns: _Returns, diagonal: float, sensor: Sensor, seed: int) -> _Returns:
    count = round(sensor.stray * sensor.points)
    on_model = returns.points[returns.labels >= 0]
    if count == 0 or len(on_model) == 0:
        return returns
    rng = generator(seed, "stray")
    margin = _STRAY_MARGIN * diagonal
    strays = rng.uniform(on_model.min(axis=0) - margin, on_model.max(axis=0) + margin, size=(count, 3))
    return _Returns(
        points=np.concatenate([returns.points, strays]),
        labels=np.concatenate([returns.labels, np.full(count, -1)]),
        view=np.concatenate([returns.view, rng.integers(sensor.views, size=count)]),
        directions=np.concatenate([returns.directions, np.zeros((count, 3))]),
    )


def _perturbed(model: ArticulatedModel, truth: State, most: GuessOffset, seed: int) -> State:
    """Return a state off `truth` by random offsets up to `most`, within the joint limits."""
    rng = generator(seed, "guess")
    axis, shift = (vector / np.linalg.norm(vector) for vector in rng.normal(size=(2, 3)))
    T = truth.T_scan_base.copy()
    T[:3, :3] = T[:3, :3] @ rotation_about(axis, rng.uniform(0.0, most.rotation))
    T[:3, 3] += rng.uniform(0.0, most.translation) * model.diagonal * shift
    joints = {}
    for index, name in enumerate(model.joint_names):
        lower, upper = float(model.lower[index]), float(model.upper[index])
        reach = most.joint_slide * (upper - lower) if model.units[name] == "m" else most.joint_angle
        joints[name] = float(np.clip(truth.joints[name] + rng.uniform(-reach, reach), lower, upper))
    return State(T, joints, truth.base_link)
