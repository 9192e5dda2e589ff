"""A folder of files that is written whole or not at all."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from pwralign_kin.exceptions import ExportError


@contextmanager
def atomic_folder(folder: Path | str) -> Iterator[Path]:
    """Yield an empty temporary folder beside `folder`, whose files, those in folders within it too, move into
    `folder` when the block succeeds.

    Files of the same name are replaced, others in `folder` stay. When the block or the move fails, `folder`
    is as it was before. Raises `ExportError` for whatever the file system refuses.
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
        _move_files(new, folder, temporary / "old")
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


def _move_files(new: Path, folder: Path, old: Path) -> None:
    """Move the files of `new` into `folder`; on failure put the files that they replaced, kept in `old`, back."""
    if not folder.exists():
        new.rename(folder)
        return
    blocked = [name for name in files_in(new) if (folder / name).is_dir()]
    if blocked:
        raise ExportError(folder, f"cannot write {blocked[0]}: a folder has that name")
    placed: list[Path] = []
    made: list[Path] = []
    try:
        for name in files_in(new):
            target = folder / name
            missing = [above for above in target.parents if not above.exists()]
            made += reversed(missing)
            target.parent.mkdir(parents=True, exist_ok=True)
            if target.exists():
                (old / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(target, old / name)
            placed.append(name)
            (new / name).replace(target)
    except BaseException:
        for name in placed:
            if (old / name).exists():
                (old / name).replace(folder / name)
            else:
                (folder / name).unlink(missing_ok=True)
        for above in reversed(made):
            if above.is_dir():
                above.rmdir()
        raise
