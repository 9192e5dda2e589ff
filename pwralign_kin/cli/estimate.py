"""`pwralign estimate`: a URDF and a scan in, the aligned model out."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from pwralign_kin.cli import arguments, messages
from pwralign_kin.cli.arguments import GUESS, OUTPUT, SEARCH, AsJson, EffortChoice, Seed, Threads
from pwralign_kin.cli.base_options import BASE_OPTIONS, BaseOptions
from pwralign_kin.cli.codes import UsageError
from pwralign_kin.cli.joint_options import JOINT_OPTIONS, JointOptions
from pwralign_kin.cli.model_options import MODEL_OPTIONS, ModelOptions, Urdf
from pwralign_kin.cli.scan_options import SCAN_OPTIONS, ScanOptions, ScanPath

if TYPE_CHECKING:
    from pwralign_kin.estimation import Estimate, SharedBaseEstimate
    from pwralign_kin.model import ArticulatedModel
    from pwralign_kin.scan import Scan
    from pwralign_kin.se3 import Array
    from pwralign_kin.state import State


@Parameter(name="*", group=OUTPUT)
@dataclass(frozen=True)
class OutputOptions:
    """Which files are written, and how. Raises `UsageError` for what is about files where none are."""

    out: Annotated[
        Path | None, Parameter(help="Folder for report.html, overlay.png, aligned.urdf, model.glb and more.")
    ] = None
    up: Annotated[
        Literal["x", "y", "z", "-x", "-y", "-z"] | None,
        Parameter(
            help="Up axis of the scan, for GLB and pictures alone (--gravity tells the search); by default against "
            "--gravity, else z."
        ),
    ] = None
    bundle: Annotated[
        bool,
        Parameter(
            help="With --out, also copy the meshes, so that aligned.urdf can go elsewhere.",
            negative=(),
            show_default=False,
        ),
    ] = False

    def __post_init__(self) -> None:
        """Check what belongs together."""
        if self.out is not None:
            return
        if self.bundle:
            raise UsageError("--bundle is about the files that --out writes: give --out.")
        if self.up is not None:
            raise UsageError("--up is about the files that --out writes: give --out. --gravity is for the search.")


OUTPUT_OPTIONS = OutputOptions()


def estimate(
    urdf: Urdf,
    scan: ScanPath,
    /,
    *more: Annotated[Path, Parameter(help="Further scans of the same model, sensor and base in the same places.")],
    output: OutputOptions = OUTPUT_OPTIONS,
    initial: Annotated[Path | None, Parameter(help="A state.json to start from.", group=GUESS)] = None,
    joint_options: JointOptions = JOINT_OPTIONS,
    base_options: BaseOptions = BASE_OPTIONS,
    scan_options: ScanOptions = SCAN_OPTIONS,
    correspondences: Annotated[
        Path | None,
        Parameter(help="NPZ of an outside matcher: source and target (n, 3), weight (n,).", group=GUESS),
    ] = None,
    solid: Annotated[
        bool,
        Parameter(
            help="Parts that no joint connects may not be inside each other.",
            negative=(),
            show_default=False,
            group=SEARCH,
        ),
    ] = False,
    effort: EffortChoice = "default",
    seed: Seed = 0,
    json: AsJson = False,
    model_options: ModelOptions = MODEL_OPTIONS,
    threads: Threads = 0,
) -> int:
    """Find where a model is in a scan: its base placement and every joint value.

    No guess is needed. Results go to stdout, everything else to stderr.
    """
    if more and correspondences is not None:
        raise UsageError("--correspondences are of one scan, but several are given.")
    guess = _guess(initial, base_options.start, joint_options)
    if output.out is not None:
        from pwralign_kin.export import FILES

        for folder in _folders(output.out, (scan, *more)):
            arguments.check_folder(folder, FILES)
    begun = time.perf_counter()
    with messages.progress() as show:
        from pwralign_kin.estimation import Correspondences, EstimatorOptions, SearchOptions, SharedBaseEstimate
        from pwralign_kin.estimation import estimate as estimated

        show("reading the scan")
        read = [scan_options.read(path) for path in (scan, *more)]
        pairs = None if correspondences is None else Correspondences.load(correspondences)
        show("reading the model")
        model = model_options.read(urdf)
        scans, hints = scan_options.in_metres(read, model.diagonal)
        options = EstimatorOptions(
            seed=seed,
            effort=effort,
            threads=threads,
            locked=joint_options.locked,
            prior=joint_options.values,
            base=base_options.known,
            search=SearchOptions(solid=solid),
            **hints,
        )
        read_all = time.perf_counter()
        result: Estimate | SharedBaseEstimate
        if more:
            result = estimated(model, scans, initial=guess, options=options, progress=show)
        else:
            result = estimated(model, scans[0], initial=guess, correspondences=pairs, options=options, progress=show)
    found = time.perf_counter()
    written: list[Path] = []
    try:
        if output.out is not None:
            places = dict(zip(_folders(output.out, (scan, *more)), scans, strict=True))
            written = _written(result, places, model, output.up or base_options.up_axis, output.bundle)
    finally:  # what was found is told where it cannot be written, too
        messages.answer(_as_json(result) if json else str(result))
    if not json:
        times = _times(begun, read_all, found, time.perf_counter() if written else None)
        messages.answer("\n".join([*messages.wrote(written), times]))
    if isinstance(result, SharedBaseEstimate):
        return messages.shared_outcome(result)
    return messages.outcome(result.confidence, "result")


def _folders(out: Path, scans: tuple[Path, ...]) -> list[Path]:
    """Return where the result of each scan goes: `out` itself for one, a numbered folder in it for each of several."""
    if len(scans) == 1:
        return [out]
    return [out / f"{i}_{path.stem}" for i, path in enumerate(scans)]


def _written(
    result: Estimate | SharedBaseEstimate, places: Mapping[Path, Scan], model: ArticulatedModel, up: str, bundle: bool
) -> list[Path]:
    """Write the files of each scan's estimate into its folder, and what several tell of one base beside these folders;
    return their paths."""
    with messages.progress() as show:
        from pwralign_kin import files
        from pwralign_kin.estimation import SharedBaseEstimate
        from pwralign_kin.export import export

        show("writing the result")
        estimates = result.estimates if isinstance(result, SharedBaseEstimate) else (result,)
        written = [
            path
            for own, (place, scan) in zip(estimates, places.items(), strict=True)
            for path in export(own, model, scan, place, up=up, bundle=bundle)
        ]
        if isinstance(result, SharedBaseEstimate):
            written.append(next(iter(places)).parent / "shared.json")
            files.write_text(written[-1], _as_json(result) + "\n")
        return written


def _guess(initial: Path | None, base: Array | None, joint_options: JointOptions) -> State | None:
    """Return the state to start from, or None to search; given values go before those of a file."""
    from pwralign_kin.state import State

    if initial is not None and base is not None:
        raise UsageError("--initial and --base exclude each other.")
    if base is not None:
        return State(base, joint_options.values)
    return None if initial is None else joint_options.over(State.load(initial))


def _times(begun: float, read: float, found: float, written: float | None) -> str:
    """Return where the time of the user went, from the moments (s) at which the stages ended."""
    stages = [f"read in {read - begun:.2f} s", f"found in {found - read:.2f} s"]
    stages += [] if written is None else [f"files in {written - found:.2f} s"]
    return ", ".join(stages)


def _as_json(result: Estimate | SharedBaseEstimate) -> str:
    from json import dumps

    return dumps(result.to_dict(), indent=2, allow_nan=False)
