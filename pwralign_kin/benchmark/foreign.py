"""Scans that the model is not in: whatever an estimate answers is wrong, and it should say so."""

from __future__ import annotations

import tempfile
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from pwralign_kin.benchmark.cases import Case, simulated_case
from pwralign_kin.benchmark.evidence import evidence
from pwralign_kin.benchmark.methods import DEFAULT, answer
from pwralign_kin.benchmark.metrics import Reference, Ruler, Score
from pwralign_kin.benchmark.runs import Models, Outcome, Progress
from pwralign_kin.benchmark.scenes import scene
from pwralign_kin.model import ArticulatedModel
from pwralign_kin.scan import Scan

METHOD = "something else"

SOLIDS = {
    "ball": '<sphere radius="0.3"/>',
    "box": '<box size="0.8 0.5 0.3"/>',
    "pole": '<cylinder radius="0.08" length="1.2"/>',
    "bottle": '<cylinder radius="0.25" length="0.7"/>',
}
"""Shapes of one part, URDF."""

SOLID_TIERS = ("full", "single", "sparse")
ROBOT_TIERS = ("full", "single", "hololens", "meshed")
OTHERS = 4
"""Other robots that each model is looked for in, ..."""
SIZES = (1.0, 0.5)
"""... and sizes of solids, as shares of the model's."""
WRONG_SIZES = {"wrong size": (0.7, 1.4, 1.4, 0.7), "nearly the size": (0.87, 1.15, 1.15, 0.87)}
"""Sizes of the model itself, one for each of these tiers: a wrong unit, or a wrong variant."""


def measure(models: Models, threads: int, progress: Progress) -> list[Outcome]:
    """Estimate every model in scans of solids, of the others, of itself at a wrong size, and of what is about it."""
    named = list(models)
    outcomes = []
    for name, model in named:
        ruler = Ruler(model)
        for case in cases(name, model, named):
            outcomes.append(_outcome(ruler, case, threads))
            progress(str(outcomes[-1]))
    return outcomes


def cases(name: str, model: ArticulatedModel, others: Sequence[tuple[str, ArticulatedModel]]) -> Iterator[Case]:
    """Yield the scans in which one model is looked for; `others` may hold it too."""
    for solid, shape in solids():
        for number, tier in enumerate(SOLID_TIERS):
            size = SIZES[(zlib.crc32(f"{name} {solid}".encode()) + number) % len(SIZES)]
            yield _scaled(simulated_case(shape, solid, tier, 0), name, solid, size * model.diagonal / shape.diagonal)
    place = [other for other, _ in others].index(name)
    for step in range(1, min(OTHERS, len(others) - 1) + 1):
        other, shape = others[(place + step) % len(others)]
        tier = ROBOT_TIERS[step % len(ROBOT_TIERS)]
        yield _scaled(simulated_case(shape, other, tier, 0), name, other, model.diagonal / shape.diagonal)
    for what, sizes in WRONG_SIZES.items():
        for tier, size in zip(ROBOT_TIERS, sizes, strict=True):
            yield _scaled(simulated_case(model, name, tier, 0), name, what, size)
    yield _without_model(simulated_case(model, name, "clutter", 0), "clutter alone")
    made = scene(model, name, "furniture", 0)
    yield _without_model(Case(name, "room", 0, made.scan, made.labels, made.state, None), "room alone")


def solids() -> Iterator[tuple[str, ArticulatedModel]]:
    """Yield the solids as models of one part."""
    with tempfile.TemporaryDirectory() as folder:
        for name, shape in SOLIDS.items():
            urdf = Path(folder) / f"{name}.urdf"
            urdf.write_text(
                f'<robot name="{name}"><link name="solid"><visual><geometry>{shape}</geometry></visual></link></robot>',
                encoding="utf-8",
            )
            yield name, ArticulatedModel.from_urdf(urdf)


def _scaled(case: Case, robot: str, what: str, factor: float) -> Case:
    """Return the scan of another thing, `factor` as large, as a case of one model."""
    return replace(case, robot=robot, tier=f"{what}, {case.tier}", scan=case.scan.scaled(factor), guess=None)


def _without_model(case: Case, what: str) -> Case:
    """Return the case without the points on the model."""
    left = case.labels < 0
    origin = case.scan.sensor_origin
    if origin is not None and origin.ndim == 2:
        origin = origin[left]
    scan = Scan(case.scan.points[left], sensor_origin=origin, source=what)
    return replace(case, tier=what, scan=scan, guess=None)


def _outcome(ruler: Ruler, case: Case, threads: int) -> Outcome:
    """Return what the estimator makes of a scan without the model: wrong, whatever it is."""
    parts = [ruler.model.parts[i].name for i in ruler.samples]
    nothing = Reference(case.truth, np.empty((0, 4, 4)), (), ())
    given = answer(DEFAULT, case, ruler, nothing, threads)
    found = given.estimate
    return Outcome(
        robot=case.robot,
        tier=case.tier,
        configuration=case.configuration,
        method=METHOD,
        score=Score(False, False, False, dict.fromkeys(parts, float("inf")), {}),
        told=(),
        undetermined=() if found is None else found.undetermined,
        confidence=0.0 if found is None else found.confidence,
        evidence={} if found is None else evidence(found, case.scan, ruler),
        joints=(),
        seconds=given.seconds,
        fault=given.fault,
    )
