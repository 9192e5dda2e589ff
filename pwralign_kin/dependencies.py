"""Libraries that may be missing or may not load, and the command that mends it."""

from __future__ import annotations

import ctypes
import os
import re
import sys
from collections.abc import Iterable
from importlib import import_module
from pathlib import Path
from typing import Any

from pwralign_kin.exceptions import DependencyError

SYSTEM_LIBRARIES = {
    "libEGL.so.1": "libegl1",
    "libGL.so.1": "libgl1",
    "libX11.so.6": "libx11-6",
    "libusb-1.0.so.0": "libusb-1.0-0",
    "libgomp.so.1": "libgomp1",
}
"""Shared libraries that Open3D and Pinocchio expect of the system, with their Debian packages."""

_DISTRIBUTIONS = {
    "PIL": "pillow",
    "collada": "pycollada",
    "kiss_matcher": "kiss-matcher",
    "open3d": "open3d-cpu",
    "pinocchio": "pin",
    "small_gicp": "small-gicp",
    "yaml": "pyyaml",
}
"""Distributions that are not called like their module."""

_SONAME = re.compile(r"lib[\w.+-]+\.so[.\d]*")


def open3d() -> Any:
    """Return the module `open3d`; raises `DependencyError` when it is missing or does not load."""
    return _loaded("open3d")


def pinocchio() -> Any:
    """Return the module `pinocchio`; raises `DependencyError` when it is missing or does not load."""
    return _loaded("pinocchio")


def rosbags() -> tuple[Any, Any]:
    """Return the modules `rosbags.highlevel` and `rosbags.typesys`; raises `DependencyError` where they are missing."""
    try:
        return import_module("rosbags.highlevel"), import_module("rosbags.typesys")
    except ImportError:
        raise DependencyError("ROS bags need the library rosbags", 'pip install "pwralign-kin[ros]"') from None


def peer(module: str) -> Any:
    """Return the module of a library that serves comparison only; raises `DependencyError` where it is missing."""
    try:
        return import_module(module)
    except ImportError as error:
        distribution = _DISTRIBUTIONS.get(module, module)
        extra = 'pip install "pwralign-kin[benchmark]"'
        if isinstance(error, ModuleNotFoundError):
            raise DependencyError(f"{distribution} is not installed", extra) from None
        raise DependencyError(f"{distribution} does not load ({error})", extra) from error


def missing_system_libraries() -> tuple[str, ...]:
    """Return the Debian packages of the system libraries that do not load; only Linux needs any."""
    if sys.platform != "linux":
        return ()
    return tuple(package for library, package in SYSTEM_LIBRARIES.items() if not _loads(library))


def install_command(packages: Iterable[str]) -> str:
    """Return the command line that installs Debian packages, ready to paste."""
    return f"{'' if os.geteuid() == 0 else 'sudo '}apt-get install -y {' '.join(packages)}"


def explained(error: ImportError | OSError) -> DependencyError | None:
    """Return what `error` says of a missing module or system library, or None when it speaks of neither."""
    if isinstance(error, ModuleNotFoundError) and error.name is not None:
        module = error.name.partition(".")[0]
        if module == __package__:
            source = Path(__file__).parents[1]
            where = f"{error.name} is not built in {source}, which is a source folder and not where it is installed"
            return DependencyError(where, "pip install -e . there, or Python in another folder")
        distribution = _DISTRIBUTIONS.get(module, module)
        return DependencyError(f"{module} is not installed", f"pip install {distribution}")
    named = _SONAME.search(str(error))
    if named is None or named[0] not in SYSTEM_LIBRARIES:
        return None
    packages = missing_system_libraries() or (SYSTEM_LIBRARIES[named[0]],)
    return DependencyError(f"the system library {named[0]} does not load", install_command(packages))


def _loaded(module: str) -> Any:
    try:
        return import_module(module)
    except (ImportError, OSError) as error:
        if _was_interrupted(error):
            raise KeyboardInterrupt from error
        problem = explained(error)
        if problem is None:
            distribution = _DISTRIBUTIONS[module]
            problem = DependencyError(
                f"{distribution} does not load ({error})", f"pip install --force-reinstall {distribution}"
            )
        raise problem from error


def _was_interrupted(error: BaseException | None) -> bool:
    """Return whether the user stopped an import: native modules tell that as a failure of their own."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return error is not None


def _loads(library: str) -> bool:
    try:
        ctypes.CDLL(library)
    except OSError:
        return False
    return True
