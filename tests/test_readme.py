"""The README's examples run, and its tables tell the truth."""

from __future__ import annotations

import dataclasses
import importlib
import json
import re
import shlex
from collections.abc import Callable
from pathlib import Path

import pytest

from pwralign_kin.cli import VERBS, main
from pwralign_kin.cli.estimate import estimate


@pytest.fixture(scope="module")
def readme(repository: Path) -> str:
    return (repository / "README.md").read_text(encoding="utf-8")


@pytest.fixture(autouse=True)
def _beside_the_robots(repository: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Run where `robots/` can be read and `out/` be written without touching the repository."""
    (tmp_path / "robots").symlink_to(repository / "robots")
    monkeypatch.chdir(tmp_path)


def _blocks(readme: str, language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", readme, flags=re.MULTILINE | re.DOTALL)


def test_python_examples_run_one_after_the_other(readme: str, capsys: pytest.CaptureFixture[str]) -> None:
    names: dict[str, object] = {}
    blocks = _blocks(readme, "python")
    assert len(blocks) >= 3
    for block in blocks:
        exec(compile(block, "README.md", "exec"), names)
    assert "lid_hinge" in capsys.readouterr().out
    assert Path("out/laptop/overlay.png").stat().st_size > 0


def test_commands_run(readme: str, capsys: pytest.CaptureFixture[str]) -> None:
    commands = [line for block in _blocks(readme, "sh") for line in block.splitlines() if line.startswith("pwralign ")]
    assert {shlex.split(command)[1] for command in commands} == set(VERBS)
    for command in commands:
        code = main(shlex.split(command)[1:])
        assert code == 0, f"{command}\n{capsys.readouterr().err}"


def _options(verb: Callable[..., object]) -> set[str]:
    """Names of the options of a verb, those in dataclasses one by one."""

    def names(name: str, default: object) -> set[str]:
        if not dataclasses.is_dataclass(default):
            return {name.replace("_", "-")}
        return set().union(*(names(field.name, field.default) for field in dataclasses.fields(default)))

    return set().union(*(names(*option) for option in (verb.__kwdefaults__ or {}).items()))


def test_every_option_of_estimate_is_in_the_table(readme: str) -> None:
    listed = set(re.findall(r"^\| `--([a-z-]+)", readme, flags=re.MULTILINE))
    assert listed == _options(estimate)


def test_every_option_of_the_other_verbs_is_documented(readme: str, repository: Path) -> None:
    documents = [repository / "docs" / name for name in ("command-line.md", "tracking.md")]
    told = readme + "".join(document.read_text(encoding="utf-8") for document in documents)
    for verb in VERBS:
        function = getattr(importlib.import_module(f"pwralign_kin.cli.{verb}"), verb)
        for name in _options(function):
            assert f"--{name}" in told, verb


def test_every_file_and_figure_of_the_result_is_explained(readme: str, repository: Path) -> None:
    assert main(["estimate", "robots/laptop/laptop.urdf", "robots/laptop/scans/full.ply", "--out", "out"]) == 0
    for path in Path("out").iterdir():
        assert f"`{path.name}`" in readme
    told = (repository / "docs" / "outputs.md").read_text(encoding="utf-8")
    result = json.loads(Path("out/estimate.json").read_text(encoding="utf-8"))
    with Path("out/deviation.csv").open(encoding="utf-8") as table:
        measures = table.readline().strip().split(",")[3:]
    for key in (*result, *result["evidence"], *measures):
        assert f"`{key}`" in told
