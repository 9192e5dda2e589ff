"""The array cache: content keys, corruption, parallel writers, folders that cannot be written, speed."""

from __future__ import annotations

import logging
import multiprocessing
import os
import time
from pathlib import Path

import numpy as np
import pytest

from pwralign_kin.model import cache
from pwralign_kin.model.cache import Arrays, content_key, load_or_build

KEY = "0123abcd"


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("PWRALIGN_CACHE_DIR", str(tmp_path / "cache"))
    return tmp_path / "cache"


def arrays() -> Arrays:
    return {
        "points": np.arange(12.0).reshape(4, 3),
        "faces": np.array([[0, 1, 2]], np.int32),
        "grid": np.arange(24, dtype=np.uint16).reshape(2, 3, 4),
        "empty": np.empty((0, 3), np.float32),
        "scalar": np.array(2.5),
        "transposed": np.arange(6.0).reshape(2, 3).T,
    }


def never() -> Arrays:
    raise AssertionError("built again")


def the_file(folder: Path) -> Path:
    (path,) = folder.iterdir()
    return path


def test_arrays_come_back_as_they_were(folder: Path) -> None:
    built, loaded = load_or_build(KEY, arrays), load_or_build(KEY, never)
    for result in (built, loaded):
        assert list(result) == list(arrays())
        for name, array in arrays().items():
            assert result[name].dtype == array.dtype and np.array_equal(result[name], array)
            assert result[name].shape == array.shape
            assert result[name].flags.c_contiguous and not result[name].flags.writeable


def test_entries_of_other_keys_do_not_serve(folder: Path) -> None:
    load_or_build(KEY, arrays)
    the_file(folder).rename(folder / "other.arrays")
    assert load_or_build("other", lambda: {"a": np.zeros(1)}).keys() == {"a"}


@pytest.mark.parametrize(
    "damage", ["empty", "cut", "cut header", "longer", "header bit", "data bit", "foreign", "folder"]
)
def test_damaged_entries_are_rebuilt(folder: Path, damage: str, caplog: pytest.LogCaptureFixture) -> None:
    load_or_build(KEY, arrays)
    path = the_file(folder)
    content = bytearray(path.read_bytes())
    if damage == "header bit":
        content[content.index(b'"key"') + 2] ^= 1
    elif damage == "data bit":
        content[-50] ^= 16
    changed = {
        "empty": b"", "cut": content[:-1], "cut header": content[:40], "longer": content + b"\0", "foreign":
        b"\x80pickle" * 30
    }  # fmt: skip
    path.unlink()
    if damage == "folder":
        path.mkdir()
    else:
        path.write_bytes(changed.get(damage, content))
    with caplog.at_level(logging.WARNING, "pwralign_kin"):
        result = load_or_build(KEY, arrays)
    assert np.array_equal(result["points"], arrays()["points"]) and "built anew" in caplog.text
    if damage != "folder":
        assert np.array_equal(load_or_build(KEY, never)["grid"], arrays()["grid"])


def test_a_folder_that_cannot_be_written_costs_only_the_next_load(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "file").write_text("in the way")
    monkeypatch.setenv("PWRALIGN_CACHE_DIR", str(tmp_path / "file"))
    with caplog.at_level(logging.WARNING, "pwralign_kin"):
        for _ in range(2):
            assert np.array_equal(load_or_build(KEY, arrays)["faces"], [[0, 1, 2]])
    assert caplog.text.count("cannot be written") == 1


def test_what_was_not_used_for_longest_makes_room(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    load_or_build("first", arrays)
    monkeypatch.setattr(cache, "MOST_BYTES", 3 * (folder / "first.arrays").stat().st_size + 10)
    for number, key in enumerate(["first", "second", "third"]):
        load_or_build(key, arrays)
        os.utime(folder / f"{key}.arrays", (number, number))
    (folder / "notes.txt").write_text("not of the cache")
    load_or_build("first", never)  # used: the second is older now
    load_or_build("fourth", arrays)
    assert sorted(path.stem for path in folder.iterdir()) == ["first", "fourth", "notes", "third"]


def test_failed_builds_leave_nothing(folder: Path) -> None:
    with pytest.raises(AssertionError, match="built again"):
        load_or_build(KEY, never)
    with pytest.raises(TypeError, match="objects"):
        load_or_build(KEY, lambda: {"a": np.array([{}])})
    assert not folder.exists() or not list(folder.iterdir())


def test_the_users_cache_folder_is_the_default(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("PWRALIGN_CACHE_DIR")
    assert "pwralign_kin" in str(cache.cache_dir()) and cache.cache_dir().is_absolute()


def _hammer(seed: int, rounds: int) -> bool:
    for _ in range(rounds):
        value = np.full(20000, 7.0)
        result = load_or_build(KEY, lambda value=value: {"a": value, "b": value[:10]})
        if not (result["a"] == 7).all() or len(result["b"]) != 10:
            return False
        if seed % 2:
            for path in cache.cache_dir().glob("*.arrays"):
                path.unlink(missing_ok=True)
    return True


def test_parallel_writers_and_readers(folder: Path, caplog: pytest.LogCaptureFixture) -> None:
    with multiprocessing.get_context("fork").Pool(4) as pool:
        assert all(pool.starmap(_hammer, [(seed, 60) for seed in range(4)]))
    assert not list(folder.glob(".*"))
    assert "built anew" not in caplog.text


def test_fifty_megabytes_load_fast(folder: Path) -> None:
    load_or_build(KEY, lambda: {"a": np.random.default_rng(0).random(6_250_000)})
    times = []
    for _ in range(5):
        start = time.perf_counter()
        load_or_build(KEY, never)
        times.append(time.perf_counter() - start)
    assert min(times) < 0.3  # a tenth of a second on a machine that does nothing else


def test_keys_tell_contents_apart() -> None:
    items = [
        (), ("a",), (b"a",), ("a", ""), ("", "a"), ("ab",), ("a", "b"), ("b", "a"), (np.zeros(2),),
        (np.zeros(2, np.float32),), (np.zeros((2, 1)),), (np.zeros(2).tobytes(),),
    ]  # fmt: skip
    keys = [content_key(*own) for own in items]
    assert len(set(keys)) == len(keys) and keys == [content_key(*own) for own in items]
    assert content_key(np.arange(6).reshape(2, 3).T) == content_key(np.arange(6).reshape(2, 3).T.copy())
