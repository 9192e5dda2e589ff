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
    """Yield an empty temporary folder beside `folder`, whose files move into `folder` when the block
    succeeds.

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
        _move_files(new, folder, backup=temporary)
    except OSError as error:
        raise ExportError(folder, f"cannot write: {error.strerror}") from None
    except ExportError as error:
        if error.path.is_relative_to(temporary):  # a name that nobody has seen
            raise ExportError(folder / error.path.name, error.fault) from None
        raise
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def _move_files(new: Path, folder: Path, backup: Path) -> None:
    """Move the files of `new` into `folder`; on failure put the files that they replaced back."""
    if not folder.exists():
        new.rename(folder)
        return
    blocked = [path.name for path in new.iterdir() if (folder / path.name).is_dir()]
    if blocked:
        raise ExportError(folder, f"cannot write {blocked[0]}: a folder has that name")
    old = backup / "old"
    old.mkdir()
    placed: list[Path] = []
    try:
        for path in sorted(new.iterdir()):
            target = folder / path.name
            if target.exists():
                shutil.copy2(target, old / path.name)
            placed.append(target)
            path.replace(target)
    except BaseException:
        for target in placed:
            if (old / target.name).exists():
                (old / target.name).replace(target)
            else:
                target.unlink(missing_ok=True)
        raise
