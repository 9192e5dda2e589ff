"""Tracking: simulated sequences, recovery after an occlusion, refinement from a guess, and the time of a step.

The time of a step stands beside that of a rigid alignment by small_gicp of the same clouds, taken in turn in the same
process, on one thread each.
"""

from __future__ import annotations

import time
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pwralign_kin.benchmark.metrics import Reference, Ruler, wrapped
from pwralign_kin.benchmark.runs import Models, Progress
from pwralign_kin.benchmark.table import figure, markdown, median, quantile, share
from pwralign_kin.dependencies import peer
from pwralign_kin.model import ArticulatedModel
from pwralign_kin.scan import DepthFrame
from pwralign_kin.se3 import Array, rotation_about, transform
from pwralign_kin.simulation import SimulatedFrame, simulate_sequence
from pwralign_kin.simulation.sequences import Motion
from pwralign_kin.state import State
from pwralign_kin.tracking import TrackedFrame, Tracker

FRAMES = 1000
"""Frames of a sequence at 30 Hz, ..."""

SLOW, SLOW_SHARE = 5.0, 10
"""... and frames per second of a sequence with so many times fewer."""

WRONG = 0.05
"""Mean surface distance above which an observed part is wrong, model diagonals, unless one of its joints is called
undetermined."""

RIG, RIG_SIZE = 4, (160, 120)
"""Cameras around the model whose images are fused, and the size of their images."""

SINGLE_SIZE = (320, 240)
"""Size of the image of a single camera."""

MEASURED_EVERY = 5
"""Errors and times are taken of every so many frames."""

RIGID_POINTS = 2000
"""Points of source and target of the rigid alignment."""

HIDDEN = (1.0, 2.0)
"""When everything is hidden in a sequence of three seconds, s."""

RECOVERED = 0.02
"""Mean surface displacement below which a model is found again, model diagonals."""

GUESSES = ((5.0, 0.02, 0.1), (10.0, 0.04, 0.2), (20.0, 0.08, 0.4))
"""How far guesses are off: base turned (degrees) and shifted (m), every joint off (rad)."""

GUESS_NOISE, GUESS_SIZE, CLOSE = 0.003, (640, 480), 0.02
"""Of the depth frames that are refined from a guess: noise, m, and size; a mean displacement below the last (m) is
right."""


@dataclass(frozen=True)
class Track:
    """One sequence."""

    robot: str
    sensor: str
    rate: float
    """Frames per second."""
    frames: int
    lost: int
    """Frames in which the model counts as lost."""
    wrong: int
    """Measured frames in which it does not, but a part is wrong (see `WRONG`)."""
    undetermined: float
    """Share of the joints that the frames tell, but the tracker calls undetermined."""
    joint_rmse: float
    """Of the joints that the frames tell, degrees; slides apart."""
    sure_rmse: float
    """The same of those that the tracker does not call undetermined."""
    worst_joint: float
    """Largest error of these, degrees."""
    slide_rmse: float
    """Of slides that the frames tell, percent of the diagonal."""
    base_rmse: float
    """Of the base's position, percent of the diagonal."""
    points: int
    """Points of a frame that are used, median."""
    seconds: tuple[float, ...]
    """Time of single steps from frame to state, s."""
    rigid_seconds: tuple[float, ...]
    """Time of rigid alignments by small_gicp of 2000 model samples to 2000 points of the same frames, s; ..."""
    rigid_prepared_seconds: tuple[float, ...]
    """... with the preparation of both clouds."""


@dataclass(frozen=True)
class Recovery:
    """A model found again after everything was hidden."""

    robot: str
    sensor: str
    declared_lost: bool
    frames: int | None
    """Frames after the occlusion until the model is found; None: not in that second."""
    seconds: float
    """Longest frame of the search, s."""


@dataclass(frozen=True)
class Guessed:
    """One depth frame refined from a guess."""

    robot: str
    guess: tuple[float, float, float]
    before: float
    """Mean surface displacement of the guess, m."""
    after: float
    seconds: float
    searched: bool


def tracks(models: Models, frames: int, progress: Progress) -> Iterable[Track]:
    """Yield tracks of each robot with a rig of cameras, and with one camera; at 30 Hz, and fewer frames at 5 Hz."""
    for robot, model in models:
        for sensor, cameras, size in (("rig", RIG, RIG_SIZE), ("single", 1, SINGLE_SIZE)):
            for motion, count in ((Motion(), frames), (Motion(rate=SLOW), max(frames // SLOW_SHARE, 1))):
                sequence = simulate_sequence(model, count, motion, cameras=cameras, size=size)
                track = followed(robot, model, sensor, sequence, motion.rate)
                progress(" ".join(_row(track)))
                yield track


def recoveries(models: Models, progress: Progress) -> Iterable[Recovery]:
    """Yield how each robot is found again after a second in which everything is hidden."""
    for robot, model in models:
        for sensor, cameras, size in (("rig", RIG, RIG_SIZE), ("single", 1, SINGLE_SIZE)):
            frames = simulate_sequence(model, 90, cameras=cameras, size=size, occluded=HIDDEN, seed=1)
            recovery = _recovered(robot, model, sensor, frames)
            progress(f"{robot} {sensor}: found after {recovery.frames} frames")
            yield recovery


def guesses(robot: str, model: ArticulatedModel, count: int, progress: Progress) -> Iterable[Guessed]:
    """Yield depth frames refined from guesses, `count` of each kind."""
    for kind in GUESSES:
        for index in range(count):
            noise = GUESS_NOISE / model.diagonal
            frame = next(iter(simulate_sequence(model, 1, size=GUESS_SIZE, noise=noise, seed=index)))
            guess = guess_off(model, frame.state, kind, index)
            tracked = Tracker(model, initial=guess).update(frame.images[0], 0.0)
            before, after = (displacement(model, state, frame.state) for state in (guess, tracked.state))
            progress(f"{robot} {kind}: {100 * before:.1f} cm to {100 * after:.2f} cm")
            yield Guessed(robot, kind, before, after, tracked.seconds, tracked.searched)


def displacement(model: ArticulatedModel, state: State, truth: State) -> float:
    """Return the mean distance (m) between corresponding points of the visible surface in two states."""
    total, weights = 0.0, 0.0
    for one, other, surface in zip(_placements(model, state), _placements(model, truth), model.surfaces, strict=True):
        if surface.exists:
            points = surface.samples.astype(float) * model.diagonal
            apart = np.linalg.norm(transform(one, points) - transform(other, points), axis=1)
            total += surface.area * float(apart @ surface.weights)
            weights += surface.area
    return total / weights


def followed(robot: str, model: ArticulatedModel, sensor: str, frames: Iterable[SimulatedFrame], rate: float) -> Track:
    """Return how well a sequence is followed from its first state, which is known, and how fast."""
    ruler, rigid = Ruler(model), _Rigid(model)
    tracker: Tracker | None = None
    every = MEASURED_EVERY if rate > SLOW else 1
    lost, count = 0, 0
    measured: list[_MeasuredFrame] = []
    for count, frame in enumerate(frames, start=1):
        seen = _seen(frame)
        if tracker is None:
            tracker, before = Tracker(model, initial=frame.state), frame.state
        tracked = tracker.update(seen, frame.time)
        lost += tracked.lost
        if count % every == 0:
            measured.append(_measured_frame(model, ruler, frame, tracked, rigid.align(before, _cloud(frame))))
        before = tracked.state
    turns = [turn for own in measured for turn in own.turns]
    undetermined = [is_so for own in measured for is_so in own.undetermined]
    return Track(
        robot=robot,
        sensor=sensor,
        rate=rate,
        frames=count,
        lost=lost,
        wrong=sum(own.wrong for own in measured),
        undetermined=float(np.mean(undetermined)) if undetermined else float("nan"),
        joint_rmse=_rms(turns),
        sure_rmse=_rms([turn for own in measured for turn in own.sure_turns]),
        worst_joint=max(turns, default=float("nan")),
        slide_rmse=_rms([slide for own in measured for slide in own.slides]),
        base_rmse=_rms([own.shift for own in measured]),
        points=int(np.median([own.points for own in measured])),
        seconds=tuple(own.seconds for own in measured),
        rigid_seconds=tuple(own.rigid_seconds[0] for own in measured),
        rigid_prepared_seconds=tuple(own.rigid_seconds[1] for own in measured),
    )


@dataclass(frozen=True)
class _MeasuredFrame:
    """One frame of a track beside its truth. Joints are those that the frame tells."""

    seconds: float
    """That the tracker took, ..."""
    rigid_seconds: tuple[float, float]
    """... and rigid alignment: see `_Rigid.align`."""
    points: int
    """That the tracker used."""
    turns: list[float]
    """Errors of joints that turn, degrees, ..."""
    sure_turns: list[float]
    """... and of those that the tracker does not call undetermined."""
    slides: list[float]
    """Errors of joints that slide, % of the diagonal."""
    undetermined: list[bool]
    """Of each joint whether the tracker calls it that."""
    wrong: bool
    """Whether the model is not where the tracker has it."""
    shift: float
    """Of the base, % of the diagonal."""


def _measured_frame(
    model: ArticulatedModel, ruler: Ruler, frame: SimulatedFrame, tracked: TrackedFrame, rigid: tuple[float, float]
) -> _MeasuredFrame:
    """Return a tracked frame beside its truth, and the times of `rigid` alignment (s)."""
    reference = ruler.reference(frame.state, np.repeat(np.arange(len(model.parts)), frame.pixels))
    turns, slides = _joint_errors(model, reference.told, reference.truth, tracked.state)
    sure = [name for name in reference.told if name not in tracked.undetermined]
    shift = tracked.state.T_scan_base[:3, 3] - frame.state.T_scan_base[:3, 3]
    return _MeasuredFrame(
        seconds=tracked.seconds,
        rigid_seconds=rigid,
        points=tracked.points,
        turns=turns,
        sure_turns=_joint_errors(model, sure, reference.truth, tracked.state)[0],
        slides=slides,
        undetermined=[name in tracked.undetermined for name in reference.told],
        wrong=not tracked.lost and _wrong(ruler, reference, tracked),
        shift=100.0 * float(np.linalg.norm(shift)) / model.diagonal,
    )


def _recovered(robot: str, model: ArticulatedModel, sensor: str, frames: Iterable[SimulatedFrame]) -> Recovery:
    tracker: Tracker | None = None
    declared, found, after, longest = False, None, 0, 0.0
    for frame in frames:
        if tracker is None:
            tracker = Tracker(model, initial=frame.state)
        tracked = tracker.update(_seen(frame), frame.time)
        declared |= tracked.lost
        if frame.time >= HIDDEN[1]:
            after += 1
            longest = max(longest, tracked.seconds)
            right = displacement(model, tracked.state, frame.state) < RECOVERED * model.diagonal
            if found is None and right and not tracked.lost:
                found = after
    return Recovery(robot, sensor, declared, found, longest)


class _Rigid:
    """Rigid alignment by small_gicp (GICP, its default) of the model as it was to points."""

    def __init__(self, model: ArticulatedModel) -> None:
        self.model = model
        self.library = peer("small_gicp")
        random = np.random.default_rng(0)
        areas = np.array([surface.area for surface in model.surfaces])
        counts = np.round(RIGID_POINTS * areas / areas.sum()).astype(int)
        self.samples = [
            surface.dense[random.choice(len(surface.dense), count, replace=count > len(surface.dense))].astype(float)
            * model.diagonal
            for surface, count in zip(model.surfaces, counts, strict=True)
            if count
        ]
        self.parts = np.flatnonzero(counts)
        self.random = random

    def align(self, before: State, cloud: Array) -> tuple[float, float]:
        """Return the seconds of the alignment alone, and with the preparation of both clouds."""
        placements = _placements(self.model, before)
        source = np.concatenate([transform(placements[i], p) for i, p in zip(self.parts, self.samples, strict=True)])
        target = cloud[self.random.permutation(len(cloud))[:RIGID_POINTS]]
        finest = 1e-4 * self.model.diagonal  # keeps all points: they are as few as they should be already
        start = time.perf_counter()
        targets, tree = self.library.preprocess_points(target, downsampling_resolution=finest, num_threads=1)
        sources, _ = self.library.preprocess_points(source, downsampling_resolution=finest, num_threads=1)
        prepared = time.perf_counter()
        self.library.align(targets, sources, tree, max_correspondence_distance=0.1 * self.model.diagonal, num_threads=1)
        end = time.perf_counter()
        return end - prepared, end - start


def _seen(frame: SimulatedFrame) -> DepthFrame | NDArray[np.float64]:
    """Return what the tracker gets: the image of a single camera, or the points of several."""
    return frame.images[0] if len(frame.images) == 1 else _cloud(frame)


def _cloud(frame: SimulatedFrame) -> Array:
    return np.concatenate([image.to_scan().points for image in frame.images])


def guess_off(model: ArticulatedModel, truth: State, kind: tuple[float, float, float], seed: int) -> State:
    """Return a state that is off by exactly so much, in random directions, but within the limits."""
    degrees, shift, joint = kind
    random = np.random.default_rng([seed, 1])
    axis, direction = (vector / np.linalg.norm(vector) for vector in random.normal(size=(2, 3)))
    T = truth.T_scan_base.copy()
    T[:3, :3] = rotation_about(axis, np.radians(degrees)) @ T[:3, :3]
    T[:3, 3] += shift * direction
    sizes = np.where(model.prismatic, 0.1 * (model.upper - model.lower), joint)
    values = model.values(truth.joints) + sizes * random.choice([-1.0, 1.0], len(sizes))
    values = np.clip(values, model.lower, model.upper)
    return State(T, dict(zip(model.joint_names, values.tolist(), strict=True)), model.root_link)


def _wrong(ruler: Ruler, reference: Reference, tracked: TrackedFrame) -> bool:
    """Return whether an observed part is elsewhere, though none of the joints that carry it is called undetermined."""
    model = ruler.model
    errors = ruler.part_errors(reference, ruler.placements(tracked.state))
    for part, error in zip(reference.observed, errors, strict=True):
        carriers, at = set(), model.parts[part]
        while at.joint is not None:
            carriers.add(model.joint_names[at.joint.actuated])
            at = model.parts[at.parent]
        if error > WRONG and not carriers & set(tracked.undetermined):
            return True
    return False


def _joint_errors(
    model: ArticulatedModel, names: Iterable[str], truth: State, state: State
) -> tuple[list[float], list[float]]:
    """Return the errors of joints: turns (degrees) and slides (percent of the diagonal)."""
    turns, slides = [], []
    for name in names:
        apart = state.joints[name] - truth.joints[name]
        if model.units[name] == "m":
            slides.append(100.0 * abs(apart) / model.diagonal)
        else:
            turns.append(abs(float(np.degrees(wrapped(apart)))))
    return turns, slides


def _placements(model: ArticulatedModel, state: State) -> Array:
    return np.asarray(model.root_placement(state) @ model.part_placements(model.values(state.joints)))


def _rms(values: list[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values)))) if values else float("nan")


def tracks_table(results: Iterable[Track]) -> str:
    """Return accuracy and times."""
    heads = [
        "robot", "sensor", " frames", " lost", " wrong", " undetermined", " joint RMSE", " determined",
        " worst joint", " slide RMSE", " base RMSE", " points",
        " step, median", " 90% below", " small_gicp", " ratio (5 to 95%)", " with preparation", " ratio",
    ]  # fmt: skip
    return markdown(heads, map(_row, results))


def _row(track: Track) -> list[str]:
    ratios = np.array(track.seconds) / np.array(track.rigid_seconds)
    low, high = quantile(ratios.tolist(), 0.05), quantile(ratios.tolist(), 0.95)
    rigid, prepared, step = median(track.rigid_seconds), median(track.rigid_prepared_seconds), median(track.seconds)
    return [
        track.robot, f"{track.sensor}, {track.rate:g} Hz", str(track.frames), str(track.lost), str(track.wrong),
        f"{100 * track.undetermined:.0f}%", figure(track.joint_rmse, "°"), figure(track.sure_rmse, "°"),
        figure(track.worst_joint, "°"), figure(track.slide_rmse, "%"), figure(track.base_rmse, "%"), str(track.points),
        figure(1e3 * step, " ms"), figure(1e3 * quantile(track.seconds, 0.9), " ms"), figure(1e3 * rigid, " ms"),
        f"{figure(median(ratios.tolist()))} ({figure(low)} to {figure(high)})", figure(1e3 * prepared, " ms"),
        figure(step / prepared),
    ]  # fmt: skip


def recoveries_table(results: Iterable[Recovery]) -> str:
    """Return how models are found again."""
    heads = ["robot", "sensor", "declared lost", " frames until found again", " longest frame"]
    rows = []
    for own in results:
        declared, frames = "yes" if own.declared_lost else "no", "never" if own.frames is None else str(own.frames)
        rows.append([own.robot, own.sensor, declared, frames, figure(own.seconds, " s")])
    return markdown(heads, rows)


def guesses_table(results: Iterable[Guessed]) -> str:
    """Return how well frames are refined from guesses."""
    results = list(results)
    heads = ["guess off by", " displaced by", " right", " median displacement", " median time", " searched"]
    rows = []
    for kind in GUESSES:
        own = [one for one in results if one.guess == kind]
        rows.append(
            [
                f"{kind[0]:g}°, {100 * kind[1]:g} cm, {kind[2]:g} rad",
                figure(100 * median([one.before for one in own]), " cm", 1),
                share([one.after < CLOSE for one in own]),
                figure(1e3 * median([one.after for one in own]), " mm"),
                figure(1e3 * median([one.seconds for one in own]), " ms", 1),
                share([one.searched for one in own]),
            ]
        )
    return markdown(heads, rows)
