"""Cases with truth: third-party robots scanned in software, and the sample scans of the sample models."""

from __future__ import annotations

import json
import zlib
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from pwralign_kin.exceptions import DependencyError, UnknownNameError
from pwralign_kin.model import ArticulatedModel
from pwralign_kin.render import RayScene
from pwralign_kin.scan import Scan
from pwralign_kin.se3 import inverse, transform
from pwralign_kin.simulation import TIERS, Sensor, random_state, simulate
from pwralign_kin.state import State

ROBOTS: Mapping[str, str] = MappingProxyType(
    {
        "panda": "panda_description/urdf/panda.urdf",
        "ur5": "ur_description/urdf/ur5_robot.urdf",
        "z1": "z1_description/urdf/z1.urdf",
        "allegro": "allegro_hand_description/urdf/allegro_right_hand.urdf",
        "solo12": "solo_description/robots/solo12.urdf",
        "tiago": "tiago_description/robots/tiago_no_hand.urdf",
        "baxter": "baxter_description/urdf/baxter.urdf",
        "pendulum": "double_pendulum_description/urdf/double_pendulum_continuous.urdf",
        "icub": "icub_description/robots/icub_reduced.urdf",
        "go2": "go2_description/urdf/go2.urdf",
        "twodof": "asr_twodof_description/urdf/TwoDofs.urdf",
        "quadruped": "quadruped_description/urdf/quadruped.urdf",
    }
)
"""Robots of the wheel `example-robot-data` by name: 2 to 29 joints, arms, hands, legs and whole bodies."""

PARKED = "parked"
"""A tier of its own: the sensor of "hololens", but about half of the joints rest at one of their limits."""

HARSH: Mapping[str, Sensor] = MappingProxyType(
    {
        "noisy": Sensor(points=2000, noise=0.02, stray=0.2),
        "scant": Sensor(points=250, noise=0.005),
        "torn": replace(TIERS["missing"], missing_share=0.5),
        "torn-single": replace(TIERS["single"], missing_share=0.4),
        "bent": replace(TIERS["single"], bend=0.015),
    }
)
"""Scans that often hold too little, or what is not so: what an estimate should doubt."""

FEW: Mapping[str, Sensor] = MappingProxyType(
    {"few": replace(HARSH["scant"], points=100), "handful": replace(HARSH["scant"], points=40)}
)
"""Scans of hardly any points, for the fit of the confidence only."""

MESHED: Mapping[str, Sensor] = MappingProxyType({"meshed": Sensor(views=5, points=6000, bend=0.01, rounding=0.03)})
"""A mesh fused from a few views, off the surface and round at its edges though hardly noisy; for that too."""

SENSORS: Mapping[str, Sensor] = MappingProxyType({**TIERS, PARKED: TIERS["hololens"], **HARSH, **FEW, **MESHED})
"""The sensor of every tier."""

_LEAST_LABELLED = 0.01
"""A point of a sample scan belongs to the part that truly is within this of it, model diagonals."""


@dataclass(frozen=True)
class Case:
    """A scan with its truth."""

    robot: str
    tier: str
    configuration: int
    """Number of the random configuration of this robot; it looks different in each tier."""

    scan: Scan
    labels: NDArray[np.int64]
    """(n,) index of the part that each point lies on; -1 for none."""

    truth: State
    guess: State | None
    """A guess near the truth where the tier gives one."""

    @property
    def name(self) -> str:
        """Robot, configuration and tier in one word."""
        return f"{self.robot}-{self.configuration}-{self.tier}"


@cache
def wheel_robots() -> Mapping[str, str]:
    """Return the URDF of every robot of the wheel by name: those of `ROBOTS` first, then all others.

    The others go by the name of their file, which their folder stands before where it is taken.
    Raises `DependencyError` where the wheel is not installed.
    """
    robots = _robots_folder()
    found = sorted(path.relative_to(robots) for path in robots.rglob("*.urdf"))
    others = [path for path in found if path.as_posix() not in ROBOTS.values()]
    taken = Counter([*ROBOTS, *(path.stem for path in others)])
    folders = {path: path.parts[0].removesuffix("_description") for path in others}
    names = {p.stem if taken[p.stem] == 1 else f"{folders[p]}_{p.stem}": p.as_posix() for p in others}
    return MappingProxyType({**ROBOTS, **names})


def load_robot(name: str) -> ArticulatedModel:
    """Return the model of a robot of `wheel_robots()`.

    Raises `UnknownNameError` for any other name, `DependencyError` where the wheel is not installed, and
    `ModelError` for those of the wheel that cannot be used.
    """
    urdfs = wheel_robots()
    if name not in urdfs:
        raise UnknownNameError("benchmark robot", name, urdfs)
    robots = _robots_folder()
    return ArticulatedModel.from_urdf(robots / urdfs[name], package_dirs=[robots.parent.parent])


def simulated_case(model: ArticulatedModel, robot: str, tier: str, configuration: int) -> Case:
    """Scan `model`; the same arguments give the same points.

    The tiers of one configuration see the same state ("parked" excepted). Raises `UnknownNameError` for an
    unknown tier.
    """
    if tier not in SENSORS:
        raise UnknownNameError("tier", tier, SENSORS)
    seed = zlib.crc32(f"{robot} {configuration}".encode())
    state = parked_state(model, seed) if tier == PARKED else None
    made = simulate(model, state, SENSORS[tier], seed)
    return Case(robot, tier, configuration, made.scan, made.labels, made.state, made.guess)


def parked_state(model: ArticulatedModel, seed: int) -> State:
    """Draw a state in which each joint that has limits rests at one of them with a chance of one half."""
    drawn = random_state(model, seed)
    random = np.random.default_rng([seed, *PARKED.encode()])
    at_limit = random.integers(2, size=len(model.joint_names)).astype(bool) & ~model.continuous
    limit = np.where(random.integers(2, size=len(model.joint_names)), model.upper, model.lower)
    values = np.where(at_limit, limit, model.values(drawn.joints)).tolist()
    joints = dict(zip(model.joint_names, values, strict=True))
    return State(drawn.T_scan_base, joints, drawn.base_link)


def sample_names(folder: Path) -> list[str]:
    """Return the sample models in `folder` that have scans with truth."""
    return sorted({truth.parent.parent.name for truth in folder.glob("*/scans/*_truth.json")})


def load_sample(folder: Path, name: str) -> ArticulatedModel:
    """Return the sample model `name` in `folder`."""
    return ArticulatedModel.from_urdf(folder / name / f"{name}.urdf")


def sample_cases(model: ArticulatedModel, folder: Path, name: str) -> Iterator[Case]:
    """Yield the sample scans of one model, labelled by the truth."""
    for truth_file in sorted((folder / name / "scans").glob("*_truth.json")):
        tier = truth_file.name.removesuffix("_truth.json")
        truth = State.load(truth_file)
        origin = json.loads(truth_file.read_text(encoding="utf-8")).get("sensor_origin")
        scan = Scan.load(truth_file.with_name(f"{tier}.ply"), sensor_origin=origin)
        yield Case(name, tier, 0, scan, nearest_parts(model, truth, scan), truth, None)


def nearest_parts(model: ArticulatedModel, truth: State, scan: Scan) -> NDArray[np.int64]:
    """Return (n,) the part that truly is nearest to each scan point, -1 for points far from all."""
    placements = model.root_placement(truth) @ model.part_placements(model.values(truth.joints))
    distances = np.full((len(model.parts), len(scan.points)), np.inf)
    for index, part in enumerate(model.parts):
        if len(part.faces):
            local = transform(inverse(placements[index]), scan.points)
            closest, _, _ = RayScene(part.vertices, part.faces).closest(local)
            distances[index] = np.linalg.norm(local - closest, axis=1)
    nearest = distances.argmin(axis=0)
    return np.where(distances.min(axis=0) < _LEAST_LABELLED * model.diagonal, nearest, -1)


def _robots_folder() -> Path:
    """Return the folder `robots` of the installed wheel."""
    from importlib.metadata import PackageNotFoundError, distribution

    wheel = "example-robot-data"
    try:
        return Path(str(distribution(wheel).locate_file(f"cmeel.prefix/share/{wheel}/robots")))
    except PackageNotFoundError:
        raise DependencyError(f"{wheel} is not installed", f"pip install {wheel}") from None
