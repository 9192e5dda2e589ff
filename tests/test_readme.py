"""The README's examples run, and its tables tell the truth."""

from __future__ import annotations

import dataclasses
import importlib
import json
import re
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pwralign_kin as pk
from pwralign_kin.cli import VERBS, main
from pwralign_kin.cli.estimate import estimate
from pwralign_kin.simulation import simulate_sequence


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


def test_the_output_shown_has_the_form_of_what_is_printed(readme: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["estimate", "robots/laptop/laptop.urdf", "robots/laptop/scans/full.ply"]) == 0
    printed = capsys.readouterr().out
    (shown,) = re.findall(r"^```\n(confidence .*?)^```", readme, flags=re.MULTILINE | re.DOTALL)
    assert re.sub(r"[-\d]+", "0", printed).startswith(re.sub(r"[-\d]+", "0", shown))


def test_commands_of_the_documents_are_of_the_right_use(repository: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Their files are placeholders: that these are missing is all that is wrong."""
    for document in (repository / "docs").glob("*.md"):
        for line in "".join(_blocks(document.read_text(encoding="utf-8"), "sh")).splitlines():
            if line.startswith("pwralign "):
                code = main(shlex.split(line, comments=True)[1:])
                assert code == 1, f"{document.name}: {line}\n{capsys.readouterr().err}"
                assert re.search("no such|does not exist|cannot", capsys.readouterr().err), line


def test_the_notebook_of_the_recipes_runs(repository: Path) -> None:
    model = pk.ArticulatedModel.from_urdf("robots/laptop/laptop.urdf")
    Path("machine.urdf").symlink_to("robots/laptop/laptop.urdf")
    image = next(iter(simulate_sequence(model, 1, seed=1))).images[0]
    np.save("depth.npy", np.rint(1e3 * np.asarray(image.depth)).astype(np.uint16))
    names: dict[str, Any] = {}
    for block in _blocks((repository / "docs" / "recipes.md").read_text(encoding="utf-8"), "python"):
        exec(compile(block, "recipes.md", "exec"), names)
    assert set(names["table"]["std"]) == {"lid_hinge"}


def _measured(benchmarks: str, table: str) -> list[tuple[str, str]]:
    """Overlays and median time of the rows over all cases of a table."""
    section = benchmarks.partition(f"<!-- table:{table} -->")[2].partition("<!-- end -->")[0]
    found = []
    heads: list[str] = []
    for line in section.splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if "overlay" in cells:
            heads = cells
        elif cells[0] == "all" and "overlay" in heads and len(cells) == len(heads):
            right, of = re.findall(r"\d+", cells[heads.index("overlay")])[1:]
            found.append((f"{right} of {of}", cells[heads.index("time median")]))
    return list(dict.fromkeys(found))  # by tier and by robot


def test_figures_are_those_of_the_benchmarks(readme: str, repository: Path) -> None:
    benchmarks = (repository / "BENCHMARKS.md").read_text(encoding="utf-8")
    measured = [row for table in ("overlay", "further", "scenes") for row in _measured(benchmarks, table)]
    assert len(measured) == 4
    assert re.findall(r"\| (\d+ of \d+) \| ([\d.]+ s) \|", readme) == measured


def test_links_lead_somewhere(repository: Path) -> None:
    for document in (repository / "README.md", *(repository / "docs").glob("*.md")):
        for target, anchor in re.findall(r"\]\((?!https?:)([^)#]*)(#[^)]*)?\)", document.read_text(encoding="utf-8")):
            file = document.parent / target if target else document
            assert file.exists(), f"{document.name}: {target}"
            if anchor:
                heads = re.findall(r"^#+ (.*)$", file.read_text(encoding="utf-8"), flags=re.MULTILINE)
                anchors = {re.sub(r"[^\w -]", "", head.lower()).replace(" ", "-") for head in heads}
                assert anchor[1:] in anchors, f"{document.name}: {target}{anchor}"


def _options(verb: Callable[..., object]) -> set[str]:
    """Names of the options of a verb, those in dataclasses one by one."""

    def names(name: str, default: object) -> set[str]:
        if not dataclasses.is_dataclass(default):
            return {name.replace("_", "-")}
        return set().union(*(names(field.name, field.default) for field in dataclasses.fields(default)))

    return set().union(*(names(*option) for option in (verb.__kwdefaults__ or {}).items()))


def test_every_option_of_estimate_is_in_its_table(repository: Path) -> None:
    told = (repository / "docs" / "command-line.md").read_text(encoding="utf-8")
    section = told.partition("## `estimate")[2].partition("\n## ")[0]
    assert set(re.findall(r"^\| `--([a-z-]+)", section, flags=re.MULTILINE)) == _options(estimate)


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
