"""Errors survive the way between processes, with all that they carry."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import pytest

import pwralign_kin as pk
from pwralign_kin import exceptions

ERRORS = [
    exceptions.PwralignError("what is wrong"),
    exceptions.ModelError("a.urdf", ["no robot", "no link"]),
    exceptions.MissingMeshError("a.urdf", {"package://a/b.stl": [Path("b.stl")]}),
    exceptions.ScanError("a.ply", "no points"),
    exceptions.EmptyScanError(Path("a.ply"), "no points"),
    exceptions.UnitError("a.ply", "too large", 0.001),
    exceptions.StateError("not rigid"),
    exceptions.OptionError("SearchOptions.beam", 0, "a whole number"),
    exceptions.ArgumentError("estimate", "a Scan", "int"),
    exceptions.UnknownNameError("joint", "elbov", ["elbow"]),
    exceptions.CorrespondenceError("a.npz", "no pairs"),
    exceptions.ExportError("out", "a file"),
    exceptions.DependencyError("no Open3D", "pip install open3d"),
]


def _kinds(kind: type[Exception]) -> Iterator[type[Exception]]:
    yield kind
    for below in kind.__subclasses__():
        yield from _kinds(below)


def _raise(error: Exception) -> None:
    raise error


def test_every_error_is_tried() -> None:
    own = {kind for kind in _kinds(pk.PwralignError) if kind.__module__ == exceptions.__name__}
    assert {type(error) for error in ERRORS} == own


@pytest.mark.parametrize("error", ERRORS, ids=lambda error: type(error).__name__)
def test_errors_are_pickled_and_copied_whole(error: pk.PwralignError) -> None:
    protocols = range(pickle.HIGHEST_PROTOCOL + 1)
    for other in (*(pickle.loads(pickle.dumps(error, protocol)) for protocol in protocols), copy.deepcopy(error)):
        assert type(other) is type(error) and str(other) == str(error) and vars(other) == vars(error)


def test_errors_of_another_process_arrive() -> None:
    with (
        ProcessPoolExecutor(1, get_context("spawn")) as pool,
        pytest.raises(exceptions.UnitError, match="too large") as caught,
    ):
        pool.submit(_raise, exceptions.UnitError("a.ply", "too large", 0.001)).result(timeout=60)
    assert caught.value.scale == 0.001
