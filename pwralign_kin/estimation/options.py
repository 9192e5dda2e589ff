"""All options of an estimate, one section a stage."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, is_dataclass
from functools import cache
from typing import Any, Literal, get_args

from pwralign_kin.checked_options import CheckedOptions, Seed, Threads
from pwralign_kin.estimation.comparison.search_options import SearchOptions
from pwralign_kin.estimation.knowledge.correspondences import FpfhMatcher
from pwralign_kin.estimation.knowledge.prior import BasePrior, Vector, checked_box, checked_numbers
from pwralign_kin.estimation.refinement.joint_least_squares import LeastSquaresOptions
from pwralign_kin.estimation.search.face_hypotheses import FaceOptions
from pwralign_kin.estimation.search.reinterpretation import ReinterpretationOptions
from pwralign_kin.estimation.search.repair import RepairOptions
from pwralign_kin.estimation.search.scene_search import SceneSearchOptions
from pwralign_kin.estimation.sensing.observation import ObservationOptions
from pwralign_kin.estimation.sensing.scene_options import SceneOptions
from pwralign_kin.exceptions import OptionError, UnknownNameError
from pwralign_kin.read_only import ReadOnlyDict
from pwralign_kin.state import checked_joints

EffortName = Literal["fast", "default", "thorough"]

SOURCES = ("pairs", "faces", "fpfh")
"""Names of what makes part hypotheses."""


@dataclass(frozen=True)
class EstimatorOptions(CheckedOptions):
    """Options of `pwralign_kin.estimate`. The defaults serve any robot and sensor.

    Raises `OptionError` for values out of range and `UnknownNameError` for an effort or a source that there is not,
    `StateError` for a prior that does not map names to numbers.
    """

    seed: Seed = 0
    """The same seed, a whole number below 2**32, gives the same answer, bit for bit, at any number of threads."""
    effort: EffortName = "default"
    """How long answers are looked for: with little repair ("fast"), with one more search where the first is not
    convincing ("default"), or from other samples again until two searches agree ("thorough")."""
    threads: Threads = 0
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
        super().__post_init__()
        if self.effort not in get_args(EffortName):
            raise UnknownNameError("effort", self.effort, get_args(EffortName))
        for source in self.sources:
            if source not in SOURCES:
                raise UnknownNameError("source", source, SOURCES)
        for name in ("prior", "prior_std"):
            object.__setattr__(self, name, ReadOnlyDict(checked_joints(getattr(self, name), name)))
        for name in self.prior_std:
            if name not in self.prior:
                valid = f"about joints of the prior: give the value of {name!r} too, prior={{{name!r}: ...}}"
                raise OptionError("EstimatorOptions.prior_std", dict(self.prior_std), valid)
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
