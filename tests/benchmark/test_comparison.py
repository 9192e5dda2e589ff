"""Methods in one run: the order goes round, failures count, bent surfaces are judged by their points."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pwralign_kin.baselines import coherent_point_drift, non_rigid_icp
from pwralign_kin.benchmark import comparison
from pwralign_kin.benchmark.cases import Case, simulated_case
from pwralign_kin.benchmark.metrics import Ruler
from pwralign_kin.benchmark.peers import CONTENDERS, Contender, Placement, Run, Task
from pwralign_kin.exceptions import DependencyError, ScanError
from pwralign_kin.se3 import from_twist


@pytest.fixture(scope="module")
def case(ruler: Ruler) -> Case:
    return simulated_case(ruler.model, "twins", "warm", 0)


@pytest.fixture
def contenders(monkeypatch: pytest.MonkeyPatch) -> dict[str, Contender]:
    """Methods that know the truth, and one that fails."""

    def truth(task: Task, seed: int) -> Run:
        return lambda: task.posed(task.case.truth)

    def shifted(task: Task, seed: int) -> Run:
        parts = task.ruler.placements(task.case.truth)
        parts[0, :3, 3] += [0.0, 0.0, 0.1 * task.ruler.model.diagonal]
        return lambda: Placement(parts)

    def bent(task: Task, seed: int) -> Run:
        """Every point in its place, along the surface as far as the guess, and 1% D besides."""
        offset = np.array([0.01 * task.ruler.model.diagonal, 0.0, 0.0])
        back = task.case.truth.T_scan_base @ np.linalg.inv(task.start)
        return lambda: task.bent(lambda points: points @ back[:3, :3].T + back[:3, 3] + offset)

    def failing(task: Task, seed: int) -> Run:
        def run() -> Placement:
            raise ScanError("scan", "out of luck")

        return run

    made = {
        "default": Contender("truth", truth),
        "shifted": Contender("shifted", shifted),
        "bent": Contender("bent", bent, bends=True),
        "failing": Contender("failing", failing),
    }
    monkeypatch.setattr(comparison, "CONTENDERS", made)
    return made


def test_order_and_verdicts(ruler: Ruler, case: Case, contenders: dict[str, Contender]) -> None:
    # With the joints of the guess at their true values the bent surface is right up to its offset.
    known = replace(case, guess=replace(case.truth, T_scan_base=case.truth.T_scan_base @ from_twist(np.full(6, 0.1))))
    measured = comparison.compare([(ruler, known)], contenders, 3, 0, 1, lambda line: None)
    names = [own.method for own in measured]
    assert names == [*contenders, *[*contenders][1:], "default", *[*contenders][2:], *[*contenders][:2]]
    truth, shifted, bent, failing = (next(own for own in measured if own.method == name) for name in contenders)
    assert truth.overlay and truth.right == 1.0 and truth.error < 1e-6 and truth.gap < 1e-12
    assert not shifted.overlay and shifted.right < 1.0 and shifted.gap == pytest.approx(0.1)
    assert np.isnan(shifted.joints) and truth.joints == pytest.approx(0.0, abs=1e-9)
    assert bent.overlay is None and 0.001 < bent.error < 0.0101 and bent.bend < 1e-6
    assert failing.fault == "ScanError: scan: out of luck" and not failing.overlay


def test_table_has_ratios_and_counts_failures(ruler: Ruler, case: Case, contenders: dict[str, Contender]) -> None:
    measured = comparison.compare([(ruler, case)], contenders, 2, 0, 1, lambda line: None)
    timed = [replace(own, seconds={"default": 0.5, "shifted": 2.0}.get(own.method, 1.0)) for own in measured]
    table = {line[0]: dict(zip(comparison.HEADS, line, strict=True)) for line in comparison.rows(timed)}
    assert table["shifted"][" ratio"] == "4.00" and table["truth"][" ratio"] == "1.00"
    assert table["failing"][" failures"] == "2" and table["failing"][" time median"] == "–"
    assert table["bent"][" overlay"] == "–" and table["shifted"][" overlay"] == "0% (0/2)"
    slow = {line[0]: line for line in comparison.rows(timed, "shifted")}
    assert "0.25" in slow["truth"]


def test_a_missing_library_stops_the_run(
    ruler: Ruler, case: Case, contenders: dict[str, Contender], monkeypatch: pytest.MonkeyPatch
) -> None:
    def absent(task: Task, seed: int) -> Run:
        raise DependencyError("library is not installed", "pip install library")

    monkeypatch.setitem(contenders, "absent", Contender("absent", absent))
    with pytest.raises(DependencyError):
        comparison.compare([(ruler, case)], ["default", "absent"], 1, 0, 1, lambda line: None)


SMALL = ("fast", "tracking", "open3d", "small-gicp", "cpd-rigid", "cpd", "nricp", "nricp-fused", "scipy")
"""Not KISS-Matcher, whom plain boxes tell nothing, nor what other tests run."""


def test_methods_stay_near_a_near_start(ruler: Ruler, monkeypatch: pytest.MonkeyPatch) -> None:
    for library in ("small_gicp", "pycpd"):
        pytest.importorskip(library, reason="the benchmark extra is not installed")
    monkeypatch.setattr(coherent_point_drift, "SAMPLES", 150)
    monkeypatch.setattr(non_rigid_icp, "TRIANGLES", 400)
    scanned = simulated_case(ruler.model, "twins", "full", 0)
    guess = replace(
        scanned.truth, T_scan_base=scanned.truth.T_scan_base @ from_twist(np.array([0.03, 0.03, 0, 0.01, 0, 0]))
    )
    near = replace(scanned, guess=guess)
    task = Task(near, ruler, ruler.reference(near.truth, near.labels), 1)
    for name in SMALL:
        own = comparison.once(task, name, 0, 0)
        assert not own.fault and own.error < 0.03, own
        assert (own.overlay is None) == CONTENDERS[name].bends
