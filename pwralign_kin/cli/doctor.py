"""`pwralign doctor`: is everything here that the program needs?"""

from __future__ import annotations

import importlib
import importlib.metadata
import importlib.util
import os
import platform
from collections.abc import Iterator
from dataclasses import dataclass

from pwralign_kin import dependencies, files
from pwralign_kin.cli import messages
from pwralign_kin.cli.codes import BAD_INPUT, OK
from pwralign_kin.exceptions import ExportError

MODULES = (
    "numpy",
    "scipy",
    "pinocchio",
    "casadi",
    "open3d",
    "trimesh",
    "yourdfpy",
    "collada",
    "lxml",
    "PIL",
    "platformdirs",
    "rich",
    "yaml",
)
"""Libraries without which something does not work."""


EXTRAS = {"xacro": "xacrodoc", "ros": "rosbags", "benchmark": "small_gicp"}
"""Extras of the distribution, and a module that each brings."""


@dataclass(frozen=True)
class Finding:
    """One thing looked at."""

    what: str
    state: str
    remedy: str = ""
    """The command that mends it; empty when all is well."""


def doctor() -> int:
    """Check that everything this program needs is installed, and say how to mend it."""
    sick = 0
    for check in (_program, _system_libraries, _open3d_twice, _modules, _extras, _kernels_and_cache):
        for finding in check():
            messages.answer(f"{'!!' if finding.remedy else 'ok'}  {finding.what}: {finding.state}")
            if finding.remedy:
                sick += 1
                messages.answer(f"    mend it with: {finding.remedy}")
    messages.answer(f"{sick} to mend" if sick else "all well")
    return BAD_INPUT if sick else OK


def _program() -> Iterator[Finding]:
    machine = f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores"
    python = f"Python {platform.python_version()}"
    yield Finding("pwralign-kin", f"{_version('pwralign-kin')}, {python}, {machine}")


def _system_libraries() -> Iterator[Finding]:
    missing = dependencies.missing_system_libraries()
    if missing:
        remedy = dependencies.install_command(missing)
        yield Finding("system libraries", f"missing {' '.join(missing)}", remedy)
    else:
        yield Finding("system libraries", "present")


def _open3d_twice() -> Iterator[Finding]:
    """Open3D comes as two distributions that overwrite each other's files."""
    if _version("open3d") and _version("open3d-cpu"):
        remedy = "pip uninstall -y open3d open3d-cpu && pip install open3d-cpu"
        yield Finding("Open3D", "open3d and open3d-cpu are both installed and overwrite each other", remedy)


def _modules() -> Iterator[Finding]:
    for name in MODULES:
        try:
            module = importlib.import_module(name)
        except (ImportError, OSError) as error:
            yield _broken(name, error)
        else:
            yield Finding(name, str(getattr(module, "__version__", "present")))


def _extras() -> Iterator[Finding]:
    """What `pip install "pwralign-kin[extra]"` adds: nothing to mend where it is missing."""
    for extra, module in EXTRAS.items():
        found = importlib.util.find_spec(module) is not None
        missing = f'not installed; pip install "pwralign-kin[{extra}]" adds it'
        yield Finding(f"extra {extra}", "present" if found else missing)


def _kernels_and_cache() -> Iterator[Finding]:
    try:
        importlib.import_module("pwralign_kin.kernels")
    except (ImportError, OSError) as error:
        yield _broken("compiled kernels", error)
        return
    yield Finding("compiled kernels", "present")
    from pwralign_kin.model.cache import cache_dir

    folder = cache_dir()
    try:
        with files.atomic_write(folder / "probe"):
            pass
        (folder / "probe").unlink()
    except ExportError as error:
        yield Finding("cache", str(error), "export PWRALIGN_CACHE_DIR=FOLDER, a folder that can be written")
    else:
        size = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
        yield Finding("cache", f"{folder}, {size / 1e6:.1f} MB; it may be deleted at any time")


def _broken(what: str, error: ImportError | OSError) -> Finding:
    problem = dependencies.explained(error)
    if problem is None:
        return Finding(
            what,
            f"does not load: {error}",
            "pip install --force-reinstall . in the source folder of pwralign-kin",
        )
    return Finding(what, problem.what, problem.remedy)


def _version(distribution: str) -> str | None:
    try:
        return importlib.metadata.version(distribution)
    except importlib.metadata.PackageNotFoundError:
        return None
