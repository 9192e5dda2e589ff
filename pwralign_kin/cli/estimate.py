"""`pwralign estimate`: a URDF and a scan in, the aligned model out."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import Parameter

from pwralign_kin.cli import arguments, messages
from pwralign_kin.cli.arguments import (
    AsJson,
    Box,
    EffortChoice,
    GeometryChoice,
    Gravity,
    Joints,
    MeshUnitsChoice,
    PackageDirs,
    Pose,
    ScanPath,
    Seed,
    Threads,
    Triple,
    Units,
    Urdf,
)
from pwralign_kin.cli.codes import UsageError

if TYPE_CHECKING:
    from pwralign_kin.estimation import Estimate, SharedBaseEstimate
    from pwralign_kin.state import State


def estimate(
    urdf: Urdf,
    scan: ScanPath,
    /,
    *more: Annotated[Path, Parameter(help="Further scans of the same model, sensor and base in the same places.")],
    out: Annotated[Path | None, Parameter(help="Folder for the files of the result.")] = None,
    initial: Annotated[Path | None, Parameter(help="A state.json to start from.")] = None,
    joint: Annotated[
        Joints,
        Parameter(help="name=value, rad or m: what a joint is where the scan does not tell; may be repeated."),
    ] = None,
    lock: Annotated[
        list[str] | None,
        Parameter(help="A joint that keeps its --joint or --initial value, else 0; may be repeated.", negative=()),
    ] = None,
    base: Annotated[
        Pose | None,
        Parameter(help="x y z qx qy qz qw: where the root link is to start with, m.", negative=()),
    ] = None,
    base_std: Annotated[
        tuple[float, float] | None,
        Parameter(help="Standard deviations of --base, m and degrees; 0 0: it is exact.", negative=()),
    ] = None,
    base_region: Annotated[
        Box | None,
        Parameter(help="xmin ymin zmin xmax ymax zmax: a box that holds the root link's origin, m.", negative=()),
    ] = None,
    gravity: Gravity = None,
    crop: arguments.Crop = None,
    sensor_origin: Annotated[
        Triple | None, Parameter(help="x y z: where the scan was seen from; unit of the scan.", negative=())
    ] = None,
    camera: arguments.Camera = arguments.NO_CAMERA,
    near: arguments.Near = None,
    region: arguments.Region = None,
    correspondences: Annotated[
        Path | None, Parameter(help="NPZ of an outside matcher: source and target (n, 3), weight (n,).")
    ] = None,
    units: Units = "m",
    solid: Annotated[
        bool, Parameter(help="Parts that no joint connects may not be inside each other.", negative=())
    ] = False,
    effort: EffortChoice = "default",
    seed: Seed = 0,
    json: AsJson = False,
    package_dir: PackageDirs = None,
    geometry: GeometryChoice = "visual",
    mesh_units: MeshUnitsChoice = "ignore",
    up: Annotated[
        Literal["x", "y", "z", "-x", "-y", "-z"], Parameter(help="Up axis of the scan, for GLB and picture.")
    ] = "z",
    threads: Threads = 0,
) -> int:
    """Find where a model is in a scan: its base placement and every joint value.

    No guess is needed. Results go to stdout, everything else to stderr.
    """
    values = arguments.joint_values(joint)
    if more and correspondences is not None:
        raise UsageError("--correspondences are of one scan, but several are given.")
    if base_std is not None and base is None:
        raise UsageError("--base-std says how sure --base is: give both.")
    guess = _guess(initial, None if base_std is not None else base, values)
    if out is not None:
        arguments.check_folder(out)
    begun = time.perf_counter()
    with messages.progress() as show:
        from pwralign_kin import files
        from pwralign_kin.estimation import BasePrior, Correspondences, EstimatorOptions, SearchOptions
        from pwralign_kin.estimation import estimate as estimated
        from pwralign_kin.export import export

        show("reading the scan")
        read = [arguments.read_scan(path, camera, sensor_origin, crop) for path in (scan, *more)]
        pairs = None if correspondences is None else Correspondences.load(correspondences)
        show("reading the model")
        model = arguments.read_model(urdf, package_dir, geometry, mesh_units)
        scans, hints = arguments.all_in_metres(read, units, model.diagonal, near, region)
        known = BasePrior(
            T_scan_base=None if base is None or base_std is None else arguments.placement(base),
            translation_std=base_std[0] if base_std else 0.0,
            rotation_std=math.radians(base_std[1]) if base_std else 0.0,
            up=arguments.upwards(gravity),
            region=None if base_region is None else (base_region[:3], base_region[3:]),
        )
        options = EstimatorOptions(
            seed=seed,
            effort=effort,
            threads=threads,
            locked=arguments.locked_names(lock),
            prior=values,
            base=known,
            search=SearchOptions(solid=solid),
            **hints,
        )
        result: Estimate | SharedBaseEstimate
        read_all = time.perf_counter()
        if more:
            shared = estimated(model, scans, initial=guess, options=options, progress=show)
            results, result = shared.estimates, shared
        else:
            single = estimated(model, scans[0], initial=guess, correspondences=pairs, options=options, progress=show)
            results, result = (single,), single
    found = time.perf_counter()
    if not json:
        print(result, flush=True)
    with messages.progress() as show:
        show("writing the result")
        written = []
        for place, one, points in zip(_folders(out, (scan, *more)), results, scans, strict=True):
            written += [] if place is None else export(one, model, points, place, up=up)
        if out is not None and more:
            files.write_text(out / "shared.json", _as_json(result) + "\n")
            written.append(out / "shared.json")
    if json:
        print(_as_json(result))
    else:
        print("".join(f"wrote {path}\n" for path in written), end="")
        print(_times(begun, read_all, found, time.perf_counter() if written else None))
    return messages.outcome(result.confidence, "result")


def _folders(out: Path | None, scans: tuple[Path, ...]) -> list[Path | None]:
    """Return where the result of each scan goes: `out` itself for one, a numbered folder in it for each of several."""
    if out is None or len(scans) == 1:
        return [out] * len(scans)
    return [out / f"{i}_{path.stem}" for i, path in enumerate(scans)]


def _guess(initial: Path | None, base: Pose | None, values: Mapping[str, float]) -> State | None:
    """Return the state to start from, or None to search; `values` go before those of a file."""
    from pwralign_kin.state import State

    if initial is not None and base is not None:
        raise UsageError("--initial and --base exclude each other.")
    if base is not None:
        return State(arguments.placement(base), values)
    if initial is None:
        return None
    given = State.load(initial)
    return State(given.T_scan_base, {**given.joints, **values}, given.base_link)


def _times(begun: float, read: float, found: float, written: float | None) -> str:
    """Return where the time of the user went, from the moments (s) at which the stages ended."""
    stages = [f"read in {read - begun:.2f} s", f"found in {found - read:.2f} s"]
    stages += [] if written is None else [f"files in {written - found:.2f} s"]
    return ", ".join(stages)


def _as_json(result: Estimate | SharedBaseEstimate) -> str:
    from json import dumps

    return dumps(result.to_dict(), indent=2, allow_nan=False)
