"""What the first use costs: imports, help, preparing a robot, the first estimate. All in fresh processes."""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path

from pwralign_kin.benchmark.empty_cache import empty_cache
from pwralign_kin.benchmark.runs import Progress
from pwralign_kin.benchmark.table import figure, markdown

REPEATS = 5

HELP = "from pwralign_kin.cli import main; raise SystemExit(main(['--help']))"


@dataclass(frozen=True)
class Preparation:
    """One robot in a process of its own, the cache empty at first."""

    robot: str
    triangles: int
    libraries: float
    """Loading the libraries, s."""

    empty_cache: float
    """Reading and preparing the robot for the first time, s."""

    from_cache: float
    """Reading it again, s."""

    first_estimate: float
    """The first estimate of the process, s; ..."""

    second_estimate: float
    """... and the same once more."""


@dataclass(frozen=True)
class FirstUse:
    """What the first use costs."""

    import_seconds: float
    """`import pwralign_kin` in a fresh interpreter beyond the interpreter's own start, median."""

    help_seconds: float
    """`pwralign --help` from start to end, median."""

    kernels: str
    """File of the compiled kernels."""

    preparations: list[Preparation]


def measure(robots: Iterable[str], threads: int, progress: Progress) -> FirstUse:
    """Measure imports and help, and prepare each robot."""
    from pwralign_kin.kernels import _native

    bare = _median_seconds([sys.executable, "-c", ""])
    imported = _median_seconds([sys.executable, "-c", "import pwralign_kin"]) - bare
    helped = _median_seconds(_help_command())
    progress(f"import {imported:.3f} s, --help {helped:.3f} s")
    preparations = []
    for robot in robots:
        with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as fresh:
            preparations.append(fresh.submit(_prepare, robot, threads).result())
        progress(" ".join(_row(preparations[-1])))
    return FirstUse(imported, helped, Path(_native.__file__).name, preparations)


def table(costs: FirstUse) -> str:
    """Return the costs as a list and a table."""
    heads = [
        "robot", " triangles", " loading libraries", " preparing, empty cache", " preparing, from the cache",
        " first estimate", " the same again",
    ]  # fmt: skip
    return (
        f"- `import pwralign_kin`: {costs.import_seconds:.3f} s beyond the interpreter's own start\n"
        f"- `pwralign --help`: {costs.help_seconds:.3f} s from start to end\n"
        f"- compiling kernels at first use: nothing; `{costs.kernels}` was built at installation\n\n"
        f"{markdown(heads, map(_row, costs.preparations))}"
    )


def _row(own: Preparation) -> list[str]:
    seconds = (own.libraries, own.empty_cache, own.from_cache, own.first_estimate, own.second_estimate)
    return [own.robot, str(own.triangles), *(figure(value, " s") for value in seconds)]


def _help_command() -> list[str]:
    """Return the command that a user types, or the same by the interpreter where it is not installed."""
    script = Path(sys.executable).with_name("pwralign")
    return [str(script), "--help"] if script.exists() else [sys.executable, "-c", HELP]


def _median_seconds(command: list[str]) -> float:
    seconds = []
    for _ in range(REPEATS):
        start = time.perf_counter()
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        seconds.append(time.perf_counter() - start)
    return sorted(seconds)[REPEATS // 2]


def _prepare(robot: str, threads: int) -> Preparation:
    """Run in a fresh process."""
    import logging

    logging.getLogger("pwralign_kin").setLevel(logging.ERROR)
    with tempfile.TemporaryDirectory() as folder, empty_cache(Path(folder)):
        start = time.perf_counter()
        import casadi  # noqa: F401
        import open3d  # noqa: F401
        import pinocchio  # noqa: F401
        import trimesh  # noqa: F401

        from pwralign_kin.benchmark.cases import load_robot, simulated_case
        from pwralign_kin.estimation import EstimatorOptions, estimate

        loaded = time.perf_counter()
        model = load_robot(robot)
        prepared = time.perf_counter()
        load_robot(robot)
        read_again = time.perf_counter()
        scan = simulated_case(model, robot, "full", 0).scan
        estimates = []
        for _ in range(2):
            begun = time.perf_counter()
            estimate(model, scan, options=EstimatorOptions(threads=threads))
            estimates.append(time.perf_counter() - begun)
    return Preparation(
        robot=robot,
        triangles=sum(len(part.faces) for part in model.parts),
        libraries=loaded - start,
        empty_cache=prepared - loaded,
        from_cache=read_again - prepared,
        first_estimate=estimates[0],
        second_estimate=estimates[1],
    )
