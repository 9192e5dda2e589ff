"""A model's meshes, and what these refer to, copied to where its URDF goes."""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Iterable, Mapping
from pathlib import Path
from urllib.parse import unquote

FOLDER = "meshes"
"""Where the copies lie beside the URDF."""

LONGEST_NAME = 1024
"""Characters of a name of a file; longer ones are data within the mesh."""

_REFERENCES = {
    ".obj": rb"^\s*mtllib\s+(.+)$",
    ".mtl": rb"^\s*(?:map_\w+|bump|disp|decal|refl|norm)\s+(.+)$",
    ".dae": rb"<init_from>\s*(?:<ref>)?\s*([^<]+)",
    ".gltf": rb'"uri"\s*:\s*"([^"]+)"',
    ".ply": rb"^comment TextureFile (.+)$",
}
"""What names other files, by suffix."""

_COMPANIONS = {
    ".mtl", ".bin", ".png", ".jpg", ".jpeg", ".tga", ".bmp", ".gif", ".tif", ".tiff", ".dds", ".webp", ".hdr", ".exr",
}  # fmt: skip
"""Suffixes of materials, buffers and textures: whatever else a mesh names does not belong into a bundle."""


def bundle(files: Iterable[Path], folder: Path) -> Mapping[Path, Path]:
    """Copy `files` and all that they refer to into `folder`; return by file the name of its copy, from `folder`.

    The copies stand to each other as the files do, so that they find each other. What is referred to and does not
    exist is left out.
    """
    wanted: dict[Path, None] = {}
    waiting = [file.resolve() for file in files]
    while waiting:
        file = waiting.pop()
        if file not in wanted:
            wanted[file] = None
            waiting += _referred_to(file)
    if not wanted:
        return {}
    above = Path(os.path.commonpath([file.parent for file in wanted]))
    names = {file: Path(FOLDER) / file.relative_to(above) for file in wanted}
    for file, name in names.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(file, folder / name)
    return names


def _referred_to(file: Path) -> list[Path]:
    """Return the files that exist of those that `file` names."""
    pattern = _REFERENCES.get(file.suffix.lower())
    if pattern is None:
        return []
    found = []
    for match in re.findall(pattern, file.read_bytes(), re.MULTILINE):
        text = match.decode("utf-8", "replace").strip()
        # Names in XML and JSON are URIs; in an MTL options may stand before the name, which may hold spaces.
        for name in (text, unquote(text), text.split()[-1] if text else ""):
            path = file.parent / name.replace("\\", "/")
            if path.suffix.lower() in _COMPANIONS and len(name) < LONGEST_NAME and path.is_file():
                found.append(path.resolve())
                break
    return found
