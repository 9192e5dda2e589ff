"""What the simulated sensor is like, with the settings of the benchmark's tiers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from numbers import Integral, Real
from types import MappingProxyType

import numpy as np

from pwralign_kin.exceptions import ScanError


@dataclass(frozen=True)
class GuessError:
    """How far a guess lies off the truth at most; the actual offsets are uniform below."""

    rotation: float = float(np.radians(15.0))
    """Turn of the base about a random axis, rad."""

    translation: float = 0.08
    """Shift of the base in a random direction, share of the model's diagonal."""

    joint_angle: float = 0.35
    """Offset of a revolute joint, rad; the guess stays within the limits."""

    joint_slide: float = 0.15
    """Offset of a prismatic joint, share of its range; the guess stays within the limits."""


@dataclass(frozen=True)
class Sensor:
    """A simulated depth sensor, its flaws, and what stands around the model.

    Lengths are shares of the model's diagonal at q = 0. Raises `ScanError` for values out of range.
    """

    views: int = 8
    """Depth images fused into the scan, taken from directions spread evenly over the sphere."""

    points: int = 8000
    """Points kept of those seen, at random; all of them where fewer are seen."""

    distance: tuple[float, float] = (1.5, 2.5)
    """Nearest and farthest distance of a camera from the middle of the scene; farther where it would stand
    inside."""

    noise: float = 0.002
    """Standard deviation of the noise: of each coordinate, or of the distance where `noise_along_ray`."""

    noise_along_ray: bool = False
    """Whether noise moves a point only along its ray, as in one depth image."""

    bend: float = 0.0
    """Standard deviation of an error of the distance that changes smoothly from place to place: what depth cameras
    make of surfaces."""

    mixed_pixels: float = 0.0
    """Share of the pixels at depth edges that show a depth between the two surfaces."""

    stray: float = 0.0
    """Stray points added, as a share of `points`, uniform in the box around the model and a quarter diagonal
    beyond."""

    missing_parts: tuple[str, ...] = ()
    """Names of parts whose points are left out; they still hide what is behind them."""

    missing_random_parts: int = 0
    """Number of parts, drawn by the seed among those with points, whose points are left out."""

    missing_share: float = 0.0
    """Share of the model's remaining points that is left out in one piece, around a random one."""

    clutter: bool = False
    """Whether the model is on a table (normal +z of the scan frame) with three solids beside it, seen from
    above."""

    known_origin: bool = False
    """Whether the scan tells where it was seen from."""

    guess: GuessError | None = None
    """How good a guess comes with the scan; None for none."""

    def __post_init__(self) -> None:
        """Check the values."""
        for own in fields(self):
            value = getattr(self, own.name)
            kind = {"int": Integral, "float": Real}.get(str(own.type), object)
            if not isinstance(value, kind):
                raise ScanError("simulated sensor", f"{own.name} must be a number ({own.type}), not {value!r}")
        bounds = self.distance if isinstance(self.distance, Sequence) else ()
        if len(bounds) != 2 or not all(isinstance(bound, Real) for bound in bounds):
            raise ScanError("simulated sensor", f"distance must be the nearest and the farthest, not {self.distance!r}")
        near, far = self.distance
        faults = {
            "views must be at least 1": self.views < 1,
            "points must be at least 1": self.points < 1,
            "distance must be positive and increasing": not 0.0 < near <= far < np.inf,
            "noise must not be negative": not 0.0 <= self.noise < np.inf,
            "bend must not be negative": not 0.0 <= self.bend < np.inf,
            "stray must not be negative": not 0.0 <= self.stray < np.inf,
            "mixed_pixels must be in [0, 1]": not 0.0 <= self.mixed_pixels <= 1.0,
            "missing_random_parts must not be negative": self.missing_random_parts < 0,
            "missing_share must be in [0, 1)": not 0.0 <= self.missing_share < 1.0,
        }
        if any(faults.values()):
            raise ScanError("simulated sensor", "; ".join(fault for fault, holds in faults.items() if holds))


FULL = Sensor()
"""Eight views fused, hardly any noise."""

_SINGLE = Sensor(views=1, noise=0.003, noise_along_ray=True, mixed_pixels=0.1, known_origin=True)

TIERS: Mapping[str, Sensor] = MappingProxyType(
    {
        "full": FULL,
        "hololens": Sensor(points=2000, noise=0.01, stray=0.05),
        "sparse": Sensor(points=600, noise=0.005),
        "missing": Sensor(missing_random_parts=1, missing_share=0.2),
        "single": _SINGLE,
        "warm": replace(_SINGLE, guess=GuessError()),
        "clutter": Sensor(views=4, points=12000, noise=0.005, clutter=True),
    }
)
"""The tiers of the benchmark by name. "single" and "warm" of one seed are the same scan."""
