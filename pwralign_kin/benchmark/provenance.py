"""Where figures come from: machine, versions, commit, date, command."""

from __future__ import annotations

import os
import platform
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from types import MappingProxyType

PACKAGES = (
    "pwralign-kin", "numpy", "scipy", "casadi", "pin", "open3d-cpu", "open3d", "trimesh", "yourdfpy",
    "example-robot-data", "small-gicp", "kiss-matcher", "pycpd",
)  # fmt: skip

REPORT = "BENCHMARKS.md"
"""The document that holds the figures, ..."""

DOCUMENTS: Mapping[str, str] = MappingProxyType({"profile": "docs/profile.md"})
"""... but for those of some tables, ..."""

PICTURES = "docs/*.png"
"""... and its plots. Writing figures does not make the tree dirty."""


@dataclass(frozen=True)
class Provenance:
    """Everything a stranger needs to know to measure the same again."""

    processor: str
    cores: int
    threads: int
    system: str
    versions: dict[str, str]
    commit: str
    """Short hash, with `-dirty` where files differ from it; `unknown` outside a repository."""

    date: str
    command: str

    def __str__(self) -> str:
        """Return one paragraph."""
        packages = ", ".join(f"{name} {number}" for name, number in self.versions.items())
        return (
            f"Measured {self.date} at commit {self.commit} by `{self.command}` on {self.processor}, "
            f"{self.cores} cores, {self.threads} thread{'s' * (self.threads != 1)}, {self.system}; {packages}."
        )


def provenance(repository: Path, threads: int, command: str) -> Provenance:
    """Return where figures measured now come from."""
    return Provenance(
        processor=_processor(),
        cores=os.cpu_count() or 1,
        threads=threads,
        system=f"{platform.system()} {platform.machine()}",
        versions={"Python": platform.python_version(), **_versions()},
        commit=_commit(repository),
        date=datetime.now(UTC).strftime("%Y-%m-%d"),
        command=command,
    )


def _processor() -> str:
    if sys.platform == "linux":
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def _versions() -> dict[str, str]:
    found = {}
    for name in PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found


def _commit(repository: Path) -> str:
    def git(*arguments: str) -> str:
        return subprocess.run(
            ["git", "-C", str(repository), *arguments], check=True, capture_output=True, text=True
        ).stdout.strip()

    try:
        written = [REPORT, *DOCUMENTS.values(), PICTURES]
        dirty = git("status", "--porcelain", "--", ".", *(f":!{path}" for path in written))
        return git("rev-parse", "--short", "HEAD") + ("-dirty" if dirty else "")
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
