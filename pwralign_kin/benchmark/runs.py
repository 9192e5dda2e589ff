"""Every method on every case."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

from pwralign_kin.benchmark.cases import Case, load_robot, simulated_case
from pwralign_kin.benchmark.methods import Method, answer
from pwralign_kin.benchmark.metrics import Reference, Ruler, Score

Progress = Callable[[str], None]


@dataclass(frozen=True)
class Outcome:
    """What one method made of one case."""

    robot: str
    tier: str
    configuration: int
    method: str
    score: Score
    told: tuple[str, ...]
    """Joints that the scan can tell, by the truth."""

    undetermined: tuple[str, ...]
    """Joints that the estimate calls undetermined."""

    seconds: float
    fault: str

    @property
    def case(self) -> tuple[str, str, int]:
        """What tells the case from the others."""
        return self.robot, self.tier, self.configuration

    def __str__(self) -> str:
        """Return one line for the progress display."""
        verdict = "found" if self.score.success else "overlaid" if self.score.overlay else "MISSED"
        error = self.fault or f"{100 * self.score.mean_error:.2f}% D"
        case = f"{self.robot}-{self.configuration}-{self.tier}"
        return f"{case} [{self.method}] {verdict} {error} {self.seconds:.2f} s"


def evaluate(
    robots: Iterable[str],
    tiers: Iterable[str],
    configurations: int,
    methods: Mapping[str, Method],
    threads: int,
    progress: Progress,
) -> list[Outcome]:
    """Run all methods on all cases of the robots in the tiers.

    The first estimate of all is made twice and counts once: no time includes the loading of libraries.
    """
    outcomes: list[Outcome] = []
    tiers = tuple(tiers)
    for robot in robots:
        ruler = Ruler(load_robot(robot))
        for tier in tiers:
            for configuration in range(configurations):
                case = simulated_case(ruler.model, robot, tier, configuration)
                reference = ruler.reference(case.truth, case.labels)
                for name, method in methods.items():
                    if not outcomes:
                        answer(method, case, ruler, reference, threads)
                    outcomes.append(_outcome(name, method, case, ruler, reference, threads))
                    progress(str(outcomes[-1]))
    return outcomes


def _outcome(name: str, method: Method, case: Case, ruler: Ruler, reference: Reference, threads: int) -> Outcome:
    given = answer(method, case, ruler, reference, threads)
    found = given.estimate
    return Outcome(
        robot=case.robot,
        tier=case.tier,
        configuration=case.configuration,
        method=name,
        score=ruler.score(reference, None if found is None else found.state),
        told=reference.told,
        undetermined=() if found is None else found.undetermined,
        seconds=given.seconds,
        fault=given.fault,
    )
