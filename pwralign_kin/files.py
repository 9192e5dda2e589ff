"""Files, and folders of them, that are written whole or not at all."""

from __future__ import annotations

import os
import secrets
import shutil
import tempfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from pwralign_kin.exceptions import ExportError, PwralignError


def check_path(path: object, error: Callable[[str], PwralignError]) -> None:
    """Raise `error` of a text where `path` cannot name a file or folder."""
    if not isinstance(path, str | os.PathLike):
        raise error(f"expected a path, got {type(path).__name__}")


@contextmanager
def atomic_write(path: Path | str) -> Iterator[Path]:
    """Yield a temporary path beside `path` that replaces it when the block succeeds and vanishes when it fails.

    The temporary name keeps the suffix of `path`, for writers that choose the format by it.
    Raises `ExportError` when the folder cannot be written.
    """
    path = Path(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary = path.parent / f".{path.stem}-{secrets.token_hex(6)}{path.suffix}"
        os.close(os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
    except OSError as error:
        raise ExportError(path, f"cannot write here: {error.strerror}") from None
    try:
        yield temporary
        temporary.replace(path)
    except OSError as error:
        raise ExportError(path, f"cannot write: {error.strerror}") from None
    finally:
        temporary.unlink(missing_ok=True)


def write_text(path: Path | str, text: str) -> None:
    """Write `text` to `path`, whole or not at all."""
    with atomic_write(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def write_bytes(path: Path | str, content: bytes) -> None:
    """Write `content` to `path`, whole or not at all."""
    with atomic_write(path) as temporary:
        temporary.write_bytes(content)


@contextmanager
def atomic_folder(folder: Path | str, optional: Iterable[str] = ()) -> Iterator[Path]:
    """Yield an empty temporary folder beside `folder`, whose files, those in folders within it too, move into
    `folder` when the block succeeds.

    Files of the same name are replaced, and `optional` ones that are not written again go, for they tell of something
    earlier; others in `folder` stay. When the block or the move fails, `folder` is as it was before. Raises
    `ExportError` for whatever the file system refuses.
    """
    folder = Path(folder)
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        temporary = Path(tempfile.mkdtemp(prefix=f".{folder.name}-", dir=folder.parent))
    except OSError as error:
        raise ExportError(folder, f"cannot write here: {error.strerror}") from None
    try:
        new = temporary / "new"
        new.mkdir()
        yield new
        _move_files(new, folder, temporary / "old", optional)
    except OSError as error:
        raise ExportError(folder, f"cannot write: {error.strerror}") from None
    except ExportError as error:
        if error.path.is_relative_to(temporary):  # a name that nobody has seen
            raise ExportError(folder / error.path.name, error.fault) from None
        raise
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def files_in(folder: Path) -> list[Path]:
    """Return the files in `folder` and in the folders within it, by their names from `folder`, in order."""
    return sorted(path.relative_to(folder) for path in folder.rglob("*") if not path.is_dir())


def _move_files(new: Path, folder: Path, old: Path, optional: Iterable[str]) -> None:
    """Move the files of `new` into `folder`, and `optional` ones that it does not have out of it.

    On failure the files that were there, kept in `old`, are put back.
    """
    if not folder.exists():
        new.rename(folder)
        return
    written = files_in(new)
    blocked = [name for name in written if (folder / name).is_dir()]
    if blocked:
        raise ExportError(folder, f"cannot write {blocked[0]}: a folder has that name")
    gone = [Path(name) for name in optional if Path(name) not in written and (folder / name).is_file()]
    touched: list[Path] = []
    made: list[Path] = []
    try:
        for name in (*written, *gone):
            target = folder / name
            missing = [above for above in target.parents if not above.exists()]
            made += reversed(missing)
            target.parent.mkdir(parents=True, exist_ok=True)
            if target.exists():
                (old / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(target, old / name)
            touched.append(name)
            if name in gone:
                target.unlink()
            else:
                (new / name).replace(target)
    except BaseException:
        for name in touched:
            if (old / name).exists():
                (old / name).replace(folder / name)
            else:
                (folder / name).unlink(missing_ok=True)
        for above in reversed(made):
            if above.is_dir():
                above.rmdir()
        raise
