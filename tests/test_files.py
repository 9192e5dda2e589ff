"""Folders that are written whole or not at all."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest

from pwralign_kin import files
from pwralign_kin.exceptions import ExportError
from pwralign_kin.files import atomic_folder


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


def _failing_at_c(move: Callable[[Path, Path], Path]) -> Callable[[Path, Path], Path]:
    def moved(path: Path, target: Path) -> Path:
        if Path(target).name == "c":
            raise OSError(5, "Input/output error")
        return move(path, target)

    return moved


def test_a_failure_while_moving_puts_old_files_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "b").write_text("old")
    monkeypatch.setattr(Path, "replace", _failing_at_c(Path.replace))
    with pytest.raises(ExportError, match="Input/output"), atomic_folder(tmp_path / "out") as new:
        for name in "abc":
            (new / name).write_text("new")
    assert names(tmp_path) == {"out"}
    assert names(tmp_path / "out") == {"b"}
    assert (tmp_path / "out" / "b").read_text() == "old"


def test_folders_within_move_too_and_go_again_on_failure(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "out" / "kept").mkdir(parents=True)
    for name in ("kept/a", "made/deep/b"):
        with atomic_folder(tmp_path / "out") as new:
            (new / name).parent.mkdir(parents=True)
            (new / name).write_text("new")
        assert (tmp_path / "out" / name).read_text() == "new"
    monkeypatch.setattr(Path, "replace", _failing_at_c(Path.replace))
    with pytest.raises(ExportError, match="Input/output"), atomic_folder(tmp_path / "out") as new:
        (new / "other" / "deep").mkdir(parents=True)
        (new / "kept").mkdir()
        for name in ("kept/a", "kept/b", "other/b", "other/deep/c"):
            (new / name).write_text("newer")
    assert names(tmp_path / "out") == {"kept", "made"}
    assert names(tmp_path / "out" / "kept") == {"a"}
    assert (tmp_path / "out" / "kept" / "a").read_text() == "new"


def test_what_is_not_written_again_goes_and_comes_back_on_failure(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "out").mkdir()
    for name in ("mine", "optional"):
        (tmp_path / "out" / name).write_text("old")
    with pytest.raises(KeyboardInterrupt), atomic_folder(tmp_path / "out", ["optional"]):
        raise KeyboardInterrupt
    assert names(tmp_path / "out") == {"mine", "optional"}

    def refused(path: Path, missing_ok: bool = False) -> None:
        raise OSError(5, "Input/output error")

    with monkeypatch.context() as patch:
        patch.setattr(Path, "unlink", refused)
        with pytest.raises(ExportError, match="Input/output"), atomic_folder(tmp_path / "out", ["optional"]) as new:
            (new / "mine").write_text("new")
    assert {(tmp_path / "out" / name).read_text() for name in ("mine", "optional")} == {"old"}

    with atomic_folder(tmp_path / "out", ["optional"]) as new:
        (new / "a").write_text("new")
    assert names(tmp_path / "out") == {"a", "mine"}


def test_written_files_have_the_usual_permissions_and_the_umask_is_left_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = os.umask(0o027)
    try:
        monkeypatch.setattr(os, "umask", lambda mask: pytest.fail("other threads write files, too"))
        files.write_text(tmp_path / "a.txt", "a")
    finally:
        monkeypatch.undo()
        os.umask(before)
    assert (tmp_path / "a.txt").stat().st_mode & 0o777 == 0o640
