"""The draw: everyone draws the same, and what is refused is told."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from pwralign_kin.benchmark import further
from pwralign_kin.benchmark.cases import ROBOTS, wheel_robots
from pwralign_kin.benchmark.suite import FIT_ROBOTS
from pwralign_kin.exceptions import DependencyError, ModelError
from pwralign_kin.model import ArticulatedModel

RIGID = '<robot name="rigid"><link name="body"><visual><geometry><box size="1 2 3"/></geometry></visual></link></robot>'


@pytest.fixture
def wheel(twins_path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, str]:
    """A wheel of one known robot, a copy of it, larger ones, a rigid body and a file that is no URDF."""
    twins = twins_path.read_text()
    texts = {
        "known": twins,
        "copy": twins.replace('"twins"', '"copy"'),
        "large": twins.replace("0.5 0.3 0.1", "0.7 0.3 0.1"),
        "larger": twins.replace("0.5 0.3 0.1", "0.9 0.3 0.1"),
        "rigid": RIGID,
        "torn": "<robot",
    }
    for name, text in texts.items():
        (tmp_path / f"{name}.urdf").write_text(text)
    names = {name: f"{name}.urdf" for name in texts}
    monkeypatch.setattr(further, "ROBOTS", {"known": "known.urdf"})
    monkeypatch.setattr(further, "wheel_robots", lambda: names)
    monkeypatch.setattr(further, "load_robot", lambda name: ArticulatedModel.from_urdf(tmp_path / names[name]))
    return names


def test_refusals_are_told(wheel: dict[str, str]) -> None:
    drawn = {draw.name: draw for draw in further.draws()}
    assert set(drawn) == set(wheel) - {"known"}
    assert drawn["copy"].refused == "the same as known"
    assert drawn["rigid"].refused == "has no joint with geometry on both sides"
    assert drawn["torn"].refused.startswith("cannot be read: ")
    assert set(further.accepted(list(drawn.values()))) == {"large", "larger"}
    assert drawn["large"].joints == 4 and drawn["large"].parts == 5


@pytest.mark.usefixtures("wheel")
def test_the_same_seed_draws_the_same_and_stops_when_enough_are_found() -> None:
    orders = {tuple(draw.name for draw in further.draws(seed=seed)) for seed in (0, 0, 1, 2)}
    assert 1 < len(orders) <= 3
    drawn = list(further.draws(count=1))
    assert len(further.accepted(drawn)) == 1 and not drawn[-1].refused
    table = further.draws_table(drawn)
    assert all(f"| {number} | {draw.name} |" in table for number, draw in enumerate(drawn, 1))


def test_faults_name_no_folder_of_this_machine(wheel: dict[str, str], monkeypatch: pytest.MonkeyPatch) -> None:
    def failing(name: str) -> ArticulatedModel:
        raise ModelError("/home/me/robots/a/a.urdf", "mesh /home/me/robots/a/foot.dae cannot be read")

    usual = further.load_robot
    monkeypatch.setattr(further, "load_robot", lambda name: usual(name) if name == "known" else failing(name))
    assert {draw.refused for draw in further.draws()} == {"cannot be read: mesh a/foot.dae cannot be read"}


def test_every_file_of_the_wheel_has_a_name_of_its_own() -> None:
    try:
        names = wheel_robots()
    except DependencyError as error:
        pytest.skip(str(error))
    assert {name: names[name] for name in ROBOTS} == ROBOTS
    assert len(set(names.values())) == len(names) > 40
    assert names["ur10_robot"].endswith("/ur10_robot.urdf")


def test_the_confidence_is_fitted_to_no_robot_that_it_is_measured_on() -> None:
    report = Path(__file__).parents[2] / "BENCHMARKS.md"
    drawn = re.findall(r"^\| \d+ \| (\S+) \| \S+\.urdf \|.*\|  \|$", report.read_text(encoding="utf-8"), re.MULTILINE)
    assert len(drawn) == further.COUNT
    assert not {*FIT_ROBOTS} & {*ROBOTS, *drawn}
