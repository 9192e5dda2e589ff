"""What is known of the base, as a start or for sure."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from pwralign_kin.cli.arguments import GUESS, Box, Pose, Triple, placement
from pwralign_kin.cli.codes import UsageError

if TYPE_CHECKING:
    from pwralign_kin.estimation import BasePrior
    from pwralign_kin.se3 import Array

Gravity = Annotated[
    Triple | None,
    Parameter(
        help="x y z: the direction in the scan in which things fall (0 -1 0 where y is up), against the model's z.",
        negative=(),
        group=GUESS,
    ),
]


@Parameter(name="*", group=GUESS)
@dataclass(frozen=True)
class BaseOptions:
    """Where the root link is. Raises `UsageError` for a standard deviation of nothing."""

    base: Annotated[
        Pose | None, Parameter(help="x y z qx qy qz qw: where the root link is to start with, m.", negative=())
    ] = None
    base_std: Annotated[
        tuple[float, float] | None,
        Parameter(help="Standard deviations of --base, m and degrees; 0 0: it is exact.", negative=()),
    ] = None
    base_region: Annotated[
        Box | None,
        Parameter(help="xmin ymin zmin xmax ymax zmax: a box that holds the root link's origin, m.", negative=()),
    ] = None
    gravity: Gravity = None

    def __post_init__(self) -> None:
        """Check what belongs together."""
        if self.base_std is not None and self.base is None:
            raise UsageError("--base-std says how sure --base is: give both.")

    @property
    def start(self) -> Array | None:
        """(4, 4) the placement to start from, if one is given that is not known."""
        return None if self.base is None or self.base_std is not None else placement(self.base)

    @property
    def up_axis(self) -> str:
        """The axis of the scan that points up, as `export` names it: z where gravity is not given."""
        if self.gravity is None:
            return "z"
        along, axis = max(zip(map(abs, self.gravity), "xyz", strict=True), key=lambda pair: pair[0])
        return f"-{axis}" if along == self.gravity["xyz".index(axis)] else axis

    @property
    def known(self) -> BasePrior:
        """What is known of the base."""
        from pwralign_kin.estimation import BasePrior

        translation, rotation = self.base_std or (0.0, 0.0)
        return BasePrior(
            T_scan_base=None if self.base is None or self.base_std is None else placement(self.base),
            translation_std=translation,
            rotation_std=math.radians(rotation),
            up=upwards(self.gravity),
            region=None if self.base_region is None else (self.base_region[:3], self.base_region[3:]),
        )


BASE_OPTIONS = BaseOptions()


def upwards(gravity: Triple | None) -> Triple | None:
    """Return the direction that is up, of any length; raises `UsageError` for numbers that are no direction."""
    if gravity is None:
        return None
    if not 1e-9 < math.hypot(*gravity) < math.inf:
        given = " ".join(f"{value:g}" for value in gravity)
        raise UsageError(f"--gravity takes the direction in which things fall, such as 0 0 -1, not {given}.")
    return -gravity[0], -gravity[1], -gravity[2]
