"""`pwralign calibrate`: where a robot with encoders stands in the frame of a sensor."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from pwralign_kin import files
from pwralign_kin.cli import arguments, messages
from pwralign_kin.cli.arguments import OUTPUT, AsJson, EffortChoice, Seed, Threads
from pwralign_kin.cli.base_options import Gravity, upwards
from pwralign_kin.cli.codes import UsageError
from pwralign_kin.cli.model_options import MODEL_OPTIONS, ModelOptions, Urdf
from pwralign_kin.cli.scan_options import SCAN_OPTIONS, ScanOptions
from pwralign_kin.exceptions import StateError, UnknownNameError

if TYPE_CHECKING:
    from pwralign_kin.estimation import SharedBaseEstimate
    from pwralign_kin.model import ArticulatedModel


def calibrate(
    urdf: Urdf,
    /,
    *pairs: Annotated[
        str, Parameter(help="SCAN=JOINTS: a scan and a file of its joint values (state.json, or a JointState in YAML).")
    ],
    out: Annotated[Path | None, Parameter(help="JSON file for the result.", group=OUTPUT)] = None,
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
        told = [arguments.read_joints(values) for _, values in paths]
        show("reading the model")
        model = model_options.read(urdf)
        joints = [_of_model(model, values, own) for (_, values), own in zip(paths, told, strict=True)]
        _note_differences(model, [values for _, values in paths], told)
        scans, hints = scan_options.in_metres(scans, model.diagonal)
        known = BasePrior(up=upwards(gravity))
        options = EstimatorOptions(seed=seed, effort=effort, threads=threads, base=known, **hints)
        result = calibrated(model, scans, joints, options, progress=show)
    _report(result, out, json)
    return messages.shared_outcome(result)


def _split(pair: str) -> tuple[Path, Path]:
    scan, equals, joints = pair.rpartition("=")
    if not scan or not equals or not joints:
        raise UsageError(f"calibrate takes SCAN=JOINTS, two files, not {pair!r}.")
    return Path(scan), Path(joints)


def _of_model(model: ArticulatedModel, path: Path, told: dict[str, float]) -> dict[str, float]:
    """Return what a file tells of the model's actuated joints.

    Raises `StateError` for values beyond the limits, `UnknownNameError` where the file names none of the joints.
    """
    known = {name: value for name, value in told.items() if name in model.joint_names}
    strange = _strange(model, told)
    if strange and not known:
        raise UnknownNameError("joint", strange[0], model.joint_names)
    try:
        model.check_limits(known)
    except StateError as error:
        raise StateError(f"{path}: {error}") from None
    return known


def _strange(model: ArticulatedModel, told: Collection[str]) -> list[str]:
    """Return the names that are of no joint of the model, nor of one that mimics."""
    followers = {part.joint.name for part in model.parts if part.joint is not None}
    return [name for name in told if name not in model.joint_names and name not in followers]


def _note_differences(model: ArticulatedModel, paths: Sequence[Path], told: Sequence[Collection[str]]) -> None:
    """Note what files tell besides the model's joints, and what they do not tell: a line for all that agree in it."""
    notes: dict[str, list[str]] = {}
    for path, names in zip(paths, told, strict=True):
        for name in _strange(model, names):
            notes.setdefault(f"{name} is no joint of the model: left out", []).append(str(path))
        for name in model.joint_names:
            if name not in names:
                notes.setdefault(f"{name} is not told: estimated", []).append(str(path))
    for note, names_of_files in notes.items():
        messages.say(f"{', '.join(dict.fromkeys(names_of_files))}: {note}", "note")


def _report(result: SharedBaseEstimate, out: Path | None, as_json: bool) -> None:
    from json import dumps

    from pwralign_kin import se3

    T_base_scan = se3.inverse(result.T_scan_base)
    text = dumps({**result.to_dict(), "T_base_scan": T_base_scan.tolist()}, indent=2, allow_nan=False)
    if out is not None:
        files.write_text(out, text + "\n")
    if as_json:
        messages.answer(text)
        return
    lines = [str(result), "", f"sensor in the frame of {result.base_link}: {se3.placement_text(T_base_scan, 6)}"]
    if out is not None:
        numbers = (*T_base_scan[:3, 3], *se3.quaternion_xyzw(T_base_scan))
        keys = ("x", "y", "z", "qx", "qy", "qz", "qw")
        placed = " ".join(f"--{key} {value:.6f}" for key, value in zip(keys, numbers, strict=True))
        frames = f"--frame-id {result.base_link} --child-frame-id sensor"
        lines += [f"wrote {out}; for ROS 2:", f"ros2 run tf2_ros static_transform_publisher {placed} {frames}"]
    messages.answer("\n".join(lines))
