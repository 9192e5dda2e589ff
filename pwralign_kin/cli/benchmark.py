"""`pwralign benchmark`: this estimator beside other methods, on simulated scans with truth, in one run."""

from __future__ import annotations

import json as json_format
import sys
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter
from cyclopts.validators import Number

from pwralign_kin.cli import arguments, messages
from pwralign_kin.cli.arguments import Seed, Threads
from pwralign_kin.cli.codes import OK
from pwralign_kin.cli.table import table

Count = Annotated[int, Parameter(validator=Number(gte=1))]


def benchmark(
    *,
    robots: Annotated[
        str | None,
        Parameter(help="Names or URDF files, with commas between: sample models, and robots of example-robot-data."),
    ] = None,
    tiers: Annotated[str, Parameter(help="Kinds of scans, with commas between; warm comes with a guess.")] = (
        "full,single,warm"
    ),
    methods: Annotated[str | None, Parameter(help="Methods, with commas between; by default all.")] = None,
    baseline: Annotated[
        str | None, Parameter(help="The method whose time is 1; default where it runs, else the first.")
    ] = None,
    configurations: Annotated[Count, Parameter(help="Random states of each robot in each tier.")] = 1,
    repeats: Annotated[Count, Parameter(help="How often each method runs on each scan.")] = 3,
    seed: Seed = 0,
    samples: Annotated[Path, Parameter(help="Folder of the sample models.")] = Path("robots"),
    json: Annotated[Path | None, Parameter(help="Also write every single measurement into this file.")] = None,
    plots: Annotated[Path | None, Parameter(help="Also draw the plots into this folder.")] = None,
    threads: Threads = 0,
) -> int:
    """Compare this estimator with other methods on the same scans: how right, and how fast.

    Scans are simulated, the same for the same names. All methods run in one process, in an order that goes round; what
    does not depend on the scan is made beforehand. Needs the benchmark extra.
    """
    import os

    from pwralign_kin import files
    from pwralign_kin.benchmark import comparison
    from pwralign_kin.benchmark.cases import SENSORS, sample_names
    from pwralign_kin.benchmark.peers import CONTENDERS
    from pwralign_kin.benchmark.provenance import provenance
    from pwralign_kin.benchmark.runs import tier_cases
    from pwralign_kin.benchmark.suite import COMPARED, FIGURES, models
    from pwralign_kin.benchmark.table import plain
    from pwralign_kin.dependencies import peer

    chosen = arguments.known_names("method", methods, CONTENDERS) or tuple(CONTENDERS)
    if baseline is None:
        baseline = "default" if "default" in chosen else chosen[0]
    arguments.known_names("method", baseline, chosen)
    kinds = arguments.known_names("tier", tiers, SENSORS)
    if plots is not None:
        peer("matplotlib")
        arguments.check_folder(plots)
    if robots is None and not sample_names(samples):
        messages.say(f"{samples} has no sample models (--samples): only robots of example-robot-data", "note")
        names = tuple(name for name in COMPARED if name not in FIGURES)
    else:
        names = COMPARED if robots is None else tuple(name.strip() for name in robots.split(",") if name.strip())
    count = threads or os.cpu_count() or 1
    with messages.progress() as show:
        cases = tier_cases(models(samples, names), kinds, configurations)
        measured = comparison.compare(cases, chosen, repeats, seed, count, show)
    source = provenance(Path(__file__).parents[2], count, " ".join(["pwralign", *sys.argv[1:]]))
    messages.answer(str(source))
    for tier, own in comparison.by_tier(measured):
        messages.answer(f"\n{tier}\n{table(comparison.HEADS, comparison.rows(own, baseline))}")
    messages.answer(f"\n{table(*comparison.overlays_by_robot(measured))}")
    if json is not None:
        record = {"source": plain(source), "baseline": baseline, "measurements": plain(measured)}
        files.write_text(json, json_format.dumps(record, indent=1, allow_nan=False) + "\n")
    if plots is not None:
        for name, content in comparison.pictures(measured).items():
            files.write_bytes(plots / name, content)
    return OK
