"""What the simulated sensor is like, with the settings of the benchmark's tiers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Annotated

import numpy as np

from pwralign_kin.checked_options import (
    CheckedOptions,
    Count,
    Natural,
    NotNegative,
    Positive,
    Range,
    Share,
    check_increasing,
)


@dataclass(frozen=True)
class GuessOffset(CheckedOptions):
    """How far a guess lies off the truth at most; the actual offsets are uniform below."""

    rotation: NotNegative = float(np.radians(15.0))
    """Turn of the base about a random axis, rad."""

    translation: NotNegative = 0.08
    """Shift of the base in a random direction, share of the model's diagonal."""

    joint_angle: NotNegative = 0.35
    """Offset of a revolute joint, rad; the guess stays within the limits."""

    joint_slide: Share = 0.15
    """Offset of a prismatic joint, share of its range; the guess stays within the limits."""


@dataclass(frozen=True)
class Sensor(CheckedOptions):
    """A simulated depth sensor, its flaws, and what stands around the model.

    Lengths are shares of the model's diagonal at q = 0. Raises `OptionError` for values out of range.
    """

    views: Count = 8
    """Depth images fused into the scan, taken from directions spread evenly over the sphere."""

    points: Count = 8000
    """Points kept of those seen, at random; all of them where fewer are seen."""

    distance: tuple[Positive, Positive] = (1.5, 2.5)
    """Nearest and farthest distance of a camera from the middle of the scene; farther where it would stand
    inside."""

    noise: NotNegative = 0.002
    """Standard deviation of the noise: of each coordinate, or of the distance where `noise_along_ray`."""

    noise_along_ray: bool = False
    """Whether noise moves a point only along its ray, as in one depth image."""

    bend: NotNegative = 0.0
    """Standard deviation of an error of the distance that changes smoothly from place to place: what depth cameras
    make of surfaces."""

    rounding: Annotated[float, Range(0, 0.1)] = 0.0
    """Radius of the ball whose points are averaged into each of its own: what fusing many views into one mesh makes of
    edges, corners and thin parts, and of the noise."""

    mixed_pixels: Share = 0.0
    """Share of the pixels at depth edges that show a depth between the two surfaces."""

    stray: NotNegative = 0.0
    """Stray points added, as a share of `points`, uniform in the box around the model and a quarter diagonal
    beyond."""

    missing_parts: tuple[str, ...] = ()
    """Names of parts whose points are left out; they still hide what is behind them."""

    missing_random_parts: Natural = 0
    """Number of parts, drawn by the seed among those with points, whose points are left out."""

    missing_share: Annotated[float, Range(0, 0.99)] = 0.0
    """Share of the model's remaining points that is left out in one piece, around a random one."""

    clutter: bool = False
    """Whether the model is on a table (normal +z of the scan frame) with three solids beside it, seen from
    above."""

    known_origin: bool = False
    """Whether the scan tells where it was seen from."""

    guess: GuessOffset | None = None
    """How good a guess comes with the scan; None for none."""

    def __post_init__(self) -> None:
        """Check the values."""
        super().__post_init__()
        check_increasing(self, "distance")


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
        "warm": replace(_SINGLE, guess=GuessOffset()),
        "clutter": Sensor(views=4, points=12000, noise=0.005, clutter=True),
    }
)
"""The tiers of the benchmark by name. "single" and "warm" of one seed are the same scan."""
