"""The two functions that everything else is called from: `estimate` and `calibrate`."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import overload

from pwralign_kin.estimation.estimator import Estimator
from pwralign_kin.estimation.knowledge.correspondences import Correspondences
from pwralign_kin.estimation.options import EstimatorOptions
from pwralign_kin.estimation.result import Estimate
from pwralign_kin.estimation.second_looks import estimated
from pwralign_kin.estimation.shared_base.result import SharedBaseEstimate
from pwralign_kin.estimation.shared_base.shared_base import estimate_shared_base
from pwralign_kin.exceptions import ArgumentError
from pwralign_kin.model import ArticulatedModel
from pwralign_kin.scan import Scan
from pwralign_kin.state import State


@overload
def estimate(
    model: ArticulatedModel,
    scan: Scan,
    initial: State | None = None,
    correspondences: Correspondences | None = None,
    options: EstimatorOptions | None = None,
    progress: Callable[[str], None] | None = None,
) -> Estimate: ...
@overload
def estimate(
    model: ArticulatedModel,
    scan: Sequence[Scan],
    initial: State | Sequence[State | None] | None = None,
    correspondences: Sequence[Correspondences | None] | None = None,
    options: EstimatorOptions | None = None,
    progress: Callable[[str], None] | None = None,
) -> SharedBaseEstimate: ...
def estimate(
    model: ArticulatedModel,
    scan: Scan | Sequence[Scan],
    initial: State | Sequence[State | None] | None = None,
    correspondences: Correspondences | Sequence[Correspondences | None] | None = None,
    options: EstimatorOptions | None = None,
    progress: Callable[[str], None] | None = None,
) -> Estimate | SharedBaseEstimate:
    """Estimate base placement and joint values of `model` in a scan, or one base and joints per scan in several.

    Several scans are of a model and a sensor that both stay where they are, in one frame. `initial` is a guess to
    start from, for several scans one for all or one a scan; without one the whole space is searched. `correspondences`
    from an outside matcher (for several scans one a scan) become part hypotheses. `progress` is called with the name
    of each stage as it begins. What is known beforehand of base and joints is told by `options`.

    Raises `ArgumentError` for arguments of a wrong kind or number, `ScanError` when a scan holds too little at the
    model's scale, `StateError`, `OptionError` or `UnknownNameError` when a guess or an option does not fit the model,
    `CorrespondenceError` when correspondences fit neither model nor scan or nothing at all was given to make
    hypotheses from.
    """
    options = _checked_options(options)
    _check_scans([scan] if isinstance(scan, Scan) else scan)
    if isinstance(scan, Scan):
        if not isinstance(initial, State | None) or not isinstance(correspondences, Correspondences | None):
            raise ArgumentError(
                "estimate",
                "one guess (a State) and one set of Correspondences for one scan",
                f"{type(initial).__name__} and {type(correspondences).__name__}",
            )
        return estimated(Estimator(model, options, progress), scan, initial, correspondences)
    if isinstance(correspondences, Correspondences):
        raise ArgumentError("estimate", "one set of Correspondences for each of several scans", "one for all")
    initials = initial if isinstance(initial, Sequence) else [initial] * len(scan)
    pairs = correspondences or [None] * len(scan)
    if len(initials) != len(scan) or len(pairs) != len(scan):
        raise ArgumentError(
            "estimate",
            f"as many guesses and sets of Correspondences as scans, {len(scan)}",
            f"{len(initials)} and {len(pairs)}",
        )
    return estimate_shared_base(model, scan, initials, pairs, [options] * len(scan), progress)


def calibrate(
    model: ArticulatedModel,
    scans: Sequence[Scan],
    joints: Sequence[Mapping[str, float] | State],
    options: EstimatorOptions | None = None,
    progress: Callable[[str], None] | None = None,
) -> SharedBaseEstimate:
    """Estimate where a robot stands in a sensor's frame from scans with known joint values: no guess is needed.

    `joints` holds the values (rad or m) of each scan by name, as encoders give them, or a `State` with them; joints
    that are not named are estimated. Raises what `estimate` raises, and `ArgumentError` when there is not one set
    of values a scan.
    """
    sets = isinstance(joints, Sequence) and all(isinstance(values, Mapping | State) for values in joints)
    if isinstance(scans, Scan) or not sets:
        raise ArgumentError(
            "calibrate",
            "a sequence of scans and one of joint values, a set by name for each scan",
            f"{type(scans).__name__} and {type(joints).__name__}",
        )
    _check_scans(scans)
    if len(joints) != len(scans):
        raise ArgumentError("calibrate", f"as many sets of joint values as scans, {len(scans)}", str(len(joints)))
    options = _checked_options(options)
    encoders = [values.joints if isinstance(values, State) else values for values in joints]
    known = [
        replace(options, prior={**options.prior, **values}, locked=tuple(dict.fromkeys((*options.locked, *values))))
        for values in encoders
    ]
    none = [None] * len(scans)
    return estimate_shared_base(model, scans, none, none, known, progress)


def _checked_options(options: EstimatorOptions | None) -> EstimatorOptions:
    if not isinstance(options, EstimatorOptions | None):
        raise ArgumentError("options", "EstimatorOptions", type(options).__name__)
    return options or EstimatorOptions()


def _check_scans(scans: object) -> None:
    members = scans if isinstance(scans, Sequence) and not isinstance(scans, str) else [scans]
    strange = [one for one in members if not isinstance(one, Scan)]
    if strange:
        got = type(strange[0]).__name__ + ("" if strange[0] is scans else " among them")
        raise ArgumentError("scan", "a Scan (of points (n, 3), m, make Scan(points)) or a sequence of them", got)
