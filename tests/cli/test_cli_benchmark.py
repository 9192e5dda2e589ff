"""`pwralign benchmark`: what it prints, writes and refuses."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from command_line import Call


def test_methods_side_by_side(arm: Path, tmp_path: Path, pwralign: Call) -> None:
    pytest.importorskip("small_gicp", reason="the benchmark extra is not installed")
    out, plots = tmp_path / "out.json", tmp_path / "plots"
    outcome = pwralign(
        "benchmark", "--robots", arm, "--tiers", "sparse,warm", "--methods", "default,tracking,small-gicp",
        "--baseline", "small-gicp", "--repeats", 2, "--json", out, "--plots", plots,
    )  # fmt: skip
    assert outcome.code == 0, outcome.err
    assert "small-gicp 1." in outcome.out.splitlines()[0]
    record = json.loads(out.read_text())
    measured = record["measurements"]
    assert len(measured) == 2 * 2 * 3
    assert [own["method"] for own in measured[:6]] == [
        "default", "tracking", "small-gicp", "tracking", "small-gicp", "default",
    ]  # fmt: skip
    assert all(own["seconds"] > 0 and not own["fault"] for own in measured)
    ours = [own for own in measured if own["method"] == "default"]
    assert all(own["overlay"] and own["right"] == 1.0 and own["gap"] < 1e-9 for own in ours)
    rigid = next(line for line in outcome.out.splitlines() if line.startswith("small_gicp"))
    assert rigid.split()[-5:] == ["1.00", "1.00", "to", "1.00", "0"]
    assert (plots / "peers.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (("--methods", "defualt"), "did you mean 'default'"),
        (("--methods", "nope"), "valid: fast, default"),
        (("--tiers", "fulll"), "did you mean 'full'"),
        (("--methods", "fast", "--baseline", "default"), "no method named 'default'"),
        (("--repeats", "0"), "--repeats"),
        (("--robots", "no_such.urdf"), "no_such.urdf"),
    ],
)
def test_refusals(pwralign: Call, arguments: tuple[str, ...], word: str) -> None:
    outcome = pwralign("benchmark", *arguments)
    assert outcome.code in (1, 2)
    assert word in outcome.error()


def test_a_model_that_is_not_found_says_where_it_was_looked_for(
    tmp_path: Path, pwralign: Call, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    outcome = pwralign("benchmark", "--robots", "laptop", "--tiers", "full", "--methods", "default")
    assert outcome.code == 1 and f"{tmp_path / 'robots'} (another folder: --samples DIR)" in outcome.error()
