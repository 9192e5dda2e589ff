"""All options of an estimate, one section a stage."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, is_dataclass
from functools import cache
from numbers import Integral
from typing import Any, Literal, get_args

from pwralign_kin.estimation.knowledge.correspondences import FpfhMatcher
from pwralign_kin.estimation.knowledge.prior import BasePrior, Vector, checked_box, checked_numbers
from pwralign_kin.estimation.refinement.joint_least_squares import LeastSquaresOptions
from pwralign_kin.estimation.search.face_hypotheses import FaceOptions
from pwralign_kin.estimation.search.reinterpretation import ReinterpretationOptions
from pwralign_kin.estimation.search.repair import RepairOptions
from pwralign_kin.estimation.search.scene_search import SceneSearchOptions
from pwralign_kin.estimation.search.tree_search import SearchOptions
from pwralign_kin.estimation.sensing.observation import ObservationOptions
from pwralign_kin.estimation.sensing.scene import SceneOptions
from pwralign_kin.exceptions import StateError, UnknownNameError
from pwralign_kin.state import checked_joints

EffortName = Literal["fast", "default", "thorough"]

SOURCES = ("pairs", "faces", "fpfh")
"""Names of what makes part hypotheses."""


@dataclass(frozen=True)
class EstimatorOptions:
    """Options of `pwralign_kin.estimate`. The defaults serve any robot and sensor.

    Raises `StateError` for values out of range and `UnknownNameError` for an effort or a source that there is not.
    """

    seed: int = 0
    """The same seed gives the same answer, bit for bit, at any number of threads."""
    effort: EffortName = "default"
    """How long answers are looked for: with little repair ("fast"), with one more search where the first is not
    convincing ("default"), or from other samples again until two searches agree ("thorough")."""
    threads: int = 0
    """Threads of the compiled kernels; 0 = one per core."""
    locked: tuple[str, ...] = ()
    """Joints that keep their initial, else their prior value."""
    prior: Mapping[str, float] = field(default_factory=dict)
    """Values (rad or m) that joints keep where the scan does not tell them; 0 within the limits where not given."""
    prior_std: Mapping[str, float] = field(default_factory=dict)
    """Standard deviations (rad or m) of joints about their `prior` values, which must be given; others may have any."""
    base: BasePrior = field(default_factory=BasePrior)
    """What is known of the base placement."""
    sources: tuple[str, ...] = ("pairs", "faces")
    """Where part hypotheses come from: "pairs" (oriented point pairs), "faces" (the edges of flat faces), "fpfh"
    (built-in feature correspondences). Correspondences that are passed to `estimate` count besides; with () they are
    the only source."""
    region: tuple[Vector, Vector] | None = None
    """Least and greatest corner (scan frame, m) of a box that the model is in. What is outside still hides and
    frees space, other than after `Scan.cropped`."""
    near: Vector | None = None
    """A point (scan frame, m) on the model or close to its surface."""
    observation: ObservationOptions = field(default_factory=ObservationOptions)
    faces: FaceOptions = field(default_factory=FaceOptions)
    fpfh: FpfhMatcher = field(default_factory=FpfhMatcher)
    scene: SceneOptions = field(default_factory=SceneOptions)
    scene_search: SceneSearchOptions = field(default_factory=SceneSearchOptions)
    search: SearchOptions = field(default_factory=SearchOptions)
    repair: RepairOptions = field(default_factory=RepairOptions)
    reinterpretation: ReinterpretationOptions = field(default_factory=ReinterpretationOptions)
    least_squares: LeastSquaresOptions = field(default_factory=LeastSquaresOptions)

    def __post_init__(self) -> None:
        """Check what does not depend on the model."""
        if not isinstance(self.seed, Integral) or not 0 <= self.seed < 2**64:
            raise StateError(f"the seed must be a whole number from 0 to 2**64 - 1, not {self.seed!r}")
        if not isinstance(self.threads, Integral) or self.threads < 0:
            raise StateError(f"threads must be 1 or more, or 0 for one per core, not {self.threads!r}")
        if self.effort not in get_args(EffortName):
            raise UnknownNameError("effort", self.effort, get_args(EffortName))
        for name in ("locked", "sources"):
            if isinstance(getattr(self, name), str):
                raise StateError(f"{name} takes several names, not one string: ({getattr(self, name)!r},)")
            object.__setattr__(self, name, tuple(getattr(self, name)))
        for source in self.sources:
            if source not in SOURCES:
                raise UnknownNameError("source", source, SOURCES)
        for name in ("prior", "prior_std"):
            object.__setattr__(self, name, checked_joints(getattr(self, name), name))
        for name in self.prior_std:
            if name not in self.prior:
                raise StateError(
                    f"prior_std says how sure the prior of {name!r} is: give its value too, prior={{{name!r}: ...}}"
                )
        for section in fields(self):
            kind = section.default_factory
            if isinstance(kind, type) and is_dataclass(kind) and not isinstance(getattr(self, section.name), kind):
                raise StateError(f"{section.name} must be {kind.__name__}, not {getattr(self, section.name)!r}")
        if self.region is not None:
            object.__setattr__(self, "region", checked_box(self.region, "region"))
        if self.near is not None:
            object.__setattr__(self, "near", tuple(checked_numbers(self.near, "near", (3,)).tolist()))


def changed(options: Any) -> dict[str, Any]:
    """Return the options that differ from their defaults, as nested plain values."""
    kind: type = type(options)
    defaults = vars(_defaults(kind))
    given = {name: value for name, value in vars(options).items() if value != defaults[name]}
    return {name: changed(value) if is_dataclass(value) else value for name, value in given.items()}


@cache
def _defaults(kind: type) -> Any:
    return kind()
