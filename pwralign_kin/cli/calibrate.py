"""`pwralign calibrate`: where a robot with encoders stands in the frame of a sensor."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from pwralign_kin import files
from pwralign_kin.cli import arguments, messages
from pwralign_kin.cli.arguments import AsJson, EffortChoice, Seed, Threads
from pwralign_kin.cli.base_options import Gravity, upwards
from pwralign_kin.cli.codes import UsageError
from pwralign_kin.cli.model_options import MODEL_OPTIONS, ModelOptions, Urdf
from pwralign_kin.cli.scan_options import SCAN_OPTIONS, ScanOptions

if TYPE_CHECKING:
    from pwralign_kin.estimation import SharedBaseEstimate


def calibrate(
    urdf: Urdf,
    /,
    *pairs: Annotated[
        str, Parameter(help="SCAN=JOINTS: a scan and a JSON file of its joint values (such as a state.json).")
    ],
    out: Annotated[Path | None, Parameter(help="JSON file for the result.")] = None,
    scan_options: ScanOptions = SCAN_OPTIONS,
    gravity: Gravity = None,
    effort: EffortChoice = "default",
    seed: Seed = 0,
    json: AsJson = False,
    model_options: ModelOptions = MODEL_OPTIONS,
    threads: Threads = 0,
) -> int:
    """Find where a robot stands in a sensor's frame, from scans with known joint values.

    Robot base and sensor stay where they are; the robot moves between the scans. No guess is needed.
    """
    paths = [_split(pair) for pair in pairs]
    if not paths:
        raise UsageError("calibrate takes at least one SCAN=JOINTS.")
    if out is not None:
        arguments.check_folder(out.absolute().parent)
    with messages.progress() as show:
        from pwralign_kin.estimation import BasePrior, EstimatorOptions
        from pwralign_kin.estimation import calibrate as calibrated

        show("reading the scans")
        scans = [scan_options.read(scan) for scan, _ in paths]
        joints = [arguments.read_joints(values) for _, values in paths]
        show("reading the model")
        model = model_options.read(urdf)
        for (_, values), own in zip(paths, joints, strict=True):
            for name in model.joint_names:
                if name not in own:
                    messages.say(f"{values} does not tell {name}: it is estimated", "note")
        scans, hints = scan_options.in_metres(scans, model.diagonal)
        known = BasePrior(up=upwards(gravity))
        options = EstimatorOptions(seed=seed, effort=effort, threads=threads, base=known, **hints)
        result = calibrated(model, scans, joints, options, progress=show)
    _report(result, out, json)
    return messages.outcome(result.confidence, "result")


def _split(pair: str) -> tuple[Path, Path]:
    scan, equals, joints = pair.rpartition("=")
    if not scan or not equals or not joints:
        raise UsageError(f"calibrate takes SCAN=JOINTS, two files, not {pair!r}.")
    return Path(scan), Path(joints)


def _report(result: SharedBaseEstimate, out: Path | None, as_json: bool) -> None:
    from json import dumps

    text = dumps(result.to_dict(), indent=2, allow_nan=False)
    if out is not None:
        files.write_text(out, text + "\n")
    wrote = "" if out is None else f"\nwrote {out}"
    messages.answer(text if as_json else f"{result}{wrote}")
