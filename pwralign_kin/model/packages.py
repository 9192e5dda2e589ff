"""Folders in which the packages of a URDF are looked for."""

from __future__ import annotations

import re
from collections.abc import Iterable
from functools import cached_property
from pathlib import Path

from pwralign_kin.exceptions import ModelError

DEEPEST = 5
"""Levels below a given folder in which packages are found: an installed workspace has them at the fourth."""
MOST_FOLDERS = 20_000
"""Folders that are looked into, at most: someone may name his home."""


class PackageFolders(tuple[Path, ...]):
    """Absolute folders that were named for packages: each a package, or the parent of some, or a workspace."""

    @cached_property
    def below(self) -> dict[str, Path]:
        """Packages in the folders by the names in their package.xml, and by their folders'; the least deep first."""
        found: dict[str, Path] = {}
        level, looked = list(self), 0
        for _ in range(DEEPEST + 1):
            inside: list[Path] = []
            for folder in level:
                if (folder / "package.xml").is_file():
                    found.setdefault(_declared_name(folder), folder)
                    found.setdefault(folder.name, folder)
                elif looked < MOST_FOLDERS:
                    own = [entry for entry in folders_in(folder) if not entry.name.startswith(".")]
                    looked += len(own)
                    inside += own
            level = inside
        return found


NO_FOLDERS = PackageFolders()


def package_folders(folders: Iterable[Path | str], path: Path) -> PackageFolders:
    """Return the folders, absolute. Raises `ModelError` of the URDF at `path` for what is no folder."""
    if isinstance(folders, str | Path):
        folders = [folders]
    faults, given = [], []
    try:
        given = [Path(folder).absolute() for folder in folders]
    except TypeError:
        faults.append(f"package_dirs takes folders, not {folders!r}")
    for folder in given:
        if not folder.is_dir():
            why = "it is a file" if folder.exists() else "there is no such folder"
            faults.append(f"no packages can be looked for in {folder} (package_dirs / --package-dir): {why}")
    if faults:
        raise ModelError(path, faults)
    return PackageFolders(given)


def folders_in(folder: Path) -> list[Path]:
    """Return the folders in a folder, by name; none where it cannot be read."""
    try:
        return sorted(entry for entry in folder.iterdir() if entry.is_dir())
    except OSError:
        return []


def _declared_name(package: Path) -> str:
    try:
        content = (package / "package.xml").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return package.name
    name = re.search(r"<name>\s*([^<\s]+)\s*</name>", content)
    return name[1] if name else package.name
