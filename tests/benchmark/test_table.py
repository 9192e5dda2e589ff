"""Tables, sections of a document, JSON, and where figures come from."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from pwralign_kin.benchmark.metrics import Score
from pwralign_kin.benchmark.provenance import DOCUMENTS, REPORT, provenance
from pwralign_kin.benchmark.runs import Outcome
from pwralign_kin.benchmark.suite import TABLES
from pwralign_kin.benchmark.summaries import (
    ablation_table,
    determined_table,
    least_squares_table,
    overlay_table,
)
from pwralign_kin.benchmark.table import markdown, plain, sections, share, with_section
from pwralign_kin.exceptions import UnknownNameError

DOCUMENT = """# Title

before
<!-- table:one -->
old
<!-- end -->
between
<!-- table:two -->
<!-- end -->
after
"""


def outcome(
    robot: str,
    method: str = "default",
    error: float = 0.001,
    joint: float = 0.2,
    undetermined: tuple[str, ...] = (),
) -> Outcome:
    found = error < 0.02
    score = Score(found, found, error < 0.005, {"part": error}, {"hip": joint, "spin": 90.0})
    return Outcome(robot, "full", 0, method, score, ("hip",), undetermined, 0.8, {}, (), 1.5, "")


def cells(table: str, row: str) -> list[str]:
    (line,) = [line for line in table.splitlines() if line.startswith(f"| {row} |")]
    return [cell.strip() for cell in line.strip("|").split("|")]


def test_a_table_has_heads_rules_and_rows() -> None:
    assert markdown(["name", " figure"], [["a|b", "1"]]) == "| name | figure |\n| --- | ---: |\n| a/b | 1 |\n"


def test_a_section_is_replaced_and_nothing_else() -> None:
    written = with_section(DOCUMENT, "two", r"new \1 figures")
    assert written == DOCUMENT.replace("two -->\n", "two -->\n\n" + r"new \1 figures" + "\n\n")
    assert with_section(written, "two", r"new \1 figures") == written
    assert sections(written) == ["one", "two"]
    assert "old" not in with_section(DOCUMENT, "one", "fresh")


def test_an_unknown_section_is_told() -> None:
    with pytest.raises(UnknownNameError, match="no section named 'three'"):
        with_section(DOCUMENT, "three", "")


def test_every_table_has_a_section(repository: Path) -> None:
    found = []
    for document in (REPORT, *DOCUMENTS.values()):
        text = (repository / document).read_text(encoding="utf-8")
        assert text.count("<!-- table:") == len(sections(text))
        found += [(name, document) for name in sections(text)]
    assert found == [(name, DOCUMENTS.get(name, REPORT)) for name in TABLES]


def test_json_knows_no_infinity() -> None:
    content = json.loads(json.dumps(plain([outcome("a", error=float("inf"))]), allow_nan=False))
    assert content[0]["score"]["part_errors"] == {"part": None}
    assert content[0]["told"] == ["hip"]


def test_shares_name_their_counts() -> None:
    assert share([True, True, False, True]) == "75% (3/4)"
    assert share([]) == "–"


def test_overlay_counts_all_and_joints_of_successes_only() -> None:
    table = overlay_table("robot", [outcome("a"), outcome("b", error=0.5, joint=50.0)], lambda own: own.robot)
    assert cells(table, "a")[1:4] == ["1", "100% (1/1)", "100% (1/1)"]
    assert cells(table, "b")[2] == "0% (0/1)"
    assert cells(table, "b")[9:11] == ["–", "–"]
    assert cells(table, "all")[1:3] == ["2", "50% (1/2)"]
    assert cells(table, "all")[9] == "0.20"


def test_ablations_are_compared_on_the_same_cases() -> None:
    outcomes = [
        outcome("a"),
        outcome("b", joint=0.6),
        outcome("a", "no-repair", joint=0.4),
        outcome("b", "no-repair", error=1.0),
    ]
    row = cells(ablation_table(outcomes), "no repair")
    assert row[1] == "50% (1/2)"
    assert row[4] == "0.400 (0.200)"


def test_least_squares_are_compared_where_all_variants_succeed() -> None:
    outcomes = [outcome(robot, method) for robot in "ab" for method in ("default", "no-least-squares")]
    outcomes += [outcome("a", "no-bounds", joint=0.7), outcome("b", "no-bounds", error=1.0)]
    row = cells(least_squares_table(outcomes), "full")
    assert row[1] == "1"
    assert row[4].startswith("0.700 / ")


def test_undetermined_joints_are_held_against_the_truth() -> None:
    outcomes = [outcome("a", undetermined=("spin",)), outcome("b", undetermined=("hip",))]
    row = cells(determined_table(outcomes), "full")
    assert row[1:5] == ["2", "50% (1/2)", "2", "50% (1/2)"]
    assert row[7] == "50% (1/2)"  # "spin" of b: 90 degrees off, not called undetermined


@pytest.mark.skipif(shutil.which("git") is None, reason="git is not installed")
def test_figures_name_the_commit_and_whether_files_differ_from_it(tmp_path: Path) -> None:
    def git(*arguments: str) -> None:
        identity = ["-c", "user.name=a", "-c", "user.email=a@b"]
        subprocess.run(["git", "-C", str(tmp_path), *identity, *arguments], check=True, capture_output=True)

    assert provenance(tmp_path, 2, "x").commit == "unknown"
    git("init")
    (tmp_path / "code.py").write_text("1")
    git("add", ".")
    git("commit", "-m", "first")
    clean = provenance(tmp_path, 2, "python scripts/benchmark.py")
    assert re.fullmatch(r"[0-9a-f]{7,}", clean.commit)
    (tmp_path / "BENCHMARKS.md").write_text("figures")
    assert provenance(tmp_path, 2, "x").commit == clean.commit
    (tmp_path / "code.py").write_text("2")
    assert provenance(tmp_path, 2, "x").commit == f"{clean.commit}-dirty"
    assert "`python scripts/benchmark.py`" in str(clean) and "2 threads" in str(clean)


def test_the_command_refuses_what_it_does_not_know(repository: Path) -> None:
    script = [sys.executable, str(repository / "scripts/benchmark.py")]
    done = subprocess.run([*script, "--robots", "panda,c3po"], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "no c3po; there are panda" in done.stderr
