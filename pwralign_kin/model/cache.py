"""Arrays kept on disk under the user's cache folder, keyed by content.

One file an entry: a JSON header, then the raw arrays. A digest of the header and a checksum of the data tell
a whole file from a truncated or corrupt one, which is rebuilt; writers rename whole files into place, so
readers never see half of one. Nothing is unpickled. Entries that were not used for longest make room for new
ones.
"""

from __future__ import annotations

import hashlib
import json
import logging
import os
import struct
import zlib
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pwralign_kin import files
from pwralign_kin.exceptions import PwralignError

logger = logging.getLogger(__name__)

_complained: set[Path] = set()
"""Folders that were found not to be writable: once is enough."""

Arrays = dict[str, NDArray[Any]]

MOST_BYTES = 2**30
"""What all entries together may take: a model takes 1 to 30 MB."""

_MAGIC = b"pwralign-arrays-1\n"
_PREFIX = struct.Struct("<QI32s")  # header length, checksum of the data, digest of the header
_ALIGNMENT = 64  # bytes, a cache line: arrays are used where they are read to


def cache_dir() -> Path:
    """Return the cache folder: the environment variable PWRALIGN_CACHE_DIR, else the user's cache folder."""
    override = os.environ.get("PWRALIGN_CACHE_DIR")
    if override:
        return Path(override)
    import platformdirs

    return Path(platformdirs.user_cache_dir("pwralign_kin"))


def content_key(*items: str | bytes | NDArray[Any]) -> str:
    """Return a key (64 hexadecimal digits) that any change of any item changes.

    SHA-256, which processors compute two to three times as fast as blake2b; meshes are tens of megabytes.
    """
    digest = hashlib.sha256()
    for item in items:
        if isinstance(item, np.ndarray):
            label, data = f"array {item.dtype.str} {item.shape}", item.tobytes()
        elif isinstance(item, str):
            label, data = "text", item.encode()
        else:
            label, data = "bytes", item
        digest.update(f"{label} {len(data)}\n".encode())
        digest.update(data)
    return digest.hexdigest()


def load_or_build(key: str, build: Callable[[], Mapping[str, NDArray[Any]]]) -> Arrays:
    """Return the arrays stored under `key`, or build and store them. All are contiguous and read-only.

    `key` becomes the file's name. A corrupt entry is rebuilt; a folder that cannot be written is logged and
    costs only the next load. What `build` raises is passed on, and nothing is stored.
    """
    path = cache_dir() / f"{key}.arrays"
    stored = _read(path, key)
    if stored is not None:
        return stored
    arrays = {name: np.asarray(array, order="C").view() for name, array in build().items()}
    for name, array in arrays.items():
        if array.dtype.hasobject:
            raise TypeError(f"array {name!r} holds Python objects, which the cache never stores")
        array.flags.writeable = False
    _write(path, key, arrays)
    return arrays


def _read(path: Path, key: str) -> Arrays | None:
    """The arrays of the file, or None where there is no whole one."""
    try:
        with path.open("rb") as handle:
            if handle.read(len(_MAGIC)) != _MAGIC:
                raise ValueError("unknown format")
            length, checksum, digest = _PREFIX.unpack(handle.read(_PREFIX.size))
            size = os.fstat(handle.fileno()).st_size
            if length > size:
                raise ValueError("truncated header")
            header_bytes = handle.read(length)
            if hashlib.sha256(header_bytes).digest() != digest:
                raise ValueError("corrupt header")
            header = json.loads(header_bytes)
            if header["key"] != key or handle.tell() + header["size"] != size:
                raise ValueError("wrong size or key")
            data = np.empty(header["size"], np.uint8)
            if handle.readinto(data.data) != header["size"] or zlib.crc32(data.data) != checksum:
                raise ValueError("corrupt data")
        with suppress(OSError):  # of others, or on a medium that is not writable
            os.utime(path)
    except (FileNotFoundError, NotADirectoryError):
        return None
    except (OSError, ValueError, KeyError, TypeError, struct.error) as error:
        logger.warning("cache entry %s is built anew: %s", path, error)
        return None
    data.flags.writeable = False
    return {
        name: data[start : start + nbytes].view(np.dtype(dtype)).reshape(shape)
        for name, dtype, shape, start, nbytes in header["arrays"]
    }


def _write(path: Path, key: str, arrays: Arrays) -> None:
    table, offset = [], 0
    for name, array in arrays.items():
        table.append((name, array.dtype.str, array.shape, offset, array.nbytes))
        offset += -(-array.nbytes // _ALIGNMENT) * _ALIGNMENT
    header = json.dumps({"key": key, "size": offset, "arrays": table}).encode()
    data = np.zeros(offset, np.uint8)
    for (_, _, _, start, nbytes), array in zip(table, arrays.values(), strict=True):
        data[start : start + nbytes] = array.reshape(-1).view(np.uint8)
    try:
        with files.atomic_write(path) as temporary, temporary.open("wb") as handle:
            handle.write(_MAGIC)
            handle.write(_PREFIX.pack(len(header), zlib.crc32(data.data), hashlib.sha256(header).digest()))
            handle.write(header)
            handle.write(data.data)
        _make_room(path)
    except (OSError, PwralignError) as error:
        if path.parent not in _complained:
            _complained.add(path.parent)
            logger.warning(
                "%s cannot be written, so that the next run prepares the model again: %s", path.parent, error
            )


def _make_room(newest: Path) -> None:
    """Remove the entries beside the newest that were not used for longest, until all fit."""
    entries = []
    for path in newest.parent.glob("*.arrays"):
        with suppress(FileNotFoundError):  # removed meanwhile
            stat = path.stat()
            entries.append((path == newest, stat.st_mtime, stat.st_size, path))
    left = sum(size for *_, size, _ in entries)
    for kept, _, size, path in sorted(entries):
        if left <= MOST_BYTES or kept:
            return
        with suppress(OSError):  # of others, or being read
            path.unlink()
        left -= size
