"""Every method on every case."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass

from pwralign_kin.benchmark.cases import Case, simulated_case
from pwralign_kin.benchmark.evidence import JointDoubt, evidence, joint_doubts
from pwralign_kin.benchmark.methods import Answer, Method, answer
from pwralign_kin.benchmark.metrics import Reference, Ruler, Score
from pwralign_kin.model import ArticulatedModel

Progress = Callable[[str], None]
Models = Iterable[tuple[str, ArticulatedModel]]
"""Names and models; best read one by one, for large ones take memory."""

Cases = Iterable[tuple[Ruler, Case]]


@dataclass(frozen=True)
class Run:
    """A case, what measures it, and what one method makes of it."""

    case: Case
    ruler: Ruler
    reference: Reference
    method: str
    answer: Answer


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

    confidence: float
    """By the estimate; 0 without one."""

    evidence: Mapping[str, float]
    """What the estimate says for itself; empty without one."""

    joints: tuple[JointDoubt, ...]
    """What the estimate says of its joints; empty without one."""

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


def tier_cases(models: Models, tiers: Iterable[str], configurations: int) -> Iterator[tuple[Ruler, Case]]:
    """Yield the cases of the models in the tiers."""
    tiers = tuple(tiers)
    for robot, model in models:
        ruler = Ruler(model)
        for tier in tiers:
            for configuration in range(configurations):
                yield ruler, simulated_case(model, robot, tier, configuration)


def evaluate(cases: Cases, methods: Mapping[str, Method], threads: int, progress: Progress) -> list[Outcome]:
    """Run all methods on all cases."""
    outcomes = []
    for run in answers(cases, methods, threads):
        outcomes.append(outcome(run))
        progress(str(outcomes[-1]))
    return outcomes


def answers(cases: Cases, methods: Mapping[str, Method], threads: int) -> Iterator[Run]:
    """Yield what all methods make of all cases.

    Every method's first case is run twice and counts once: no time includes the loading of libraries.
    """
    warm = set()
    for ruler, case in cases:
        reference = ruler.reference(case.truth, case.labels)
        for name, method in methods.items():
            if name not in warm:
                answer(method, case, ruler, reference, threads)
                warm.add(name)
            yield Run(case, ruler, reference, name, answer(method, case, ruler, reference, threads))


def outcome(run: Run) -> Outcome:
    """Return how right an answer is."""
    case, given = run.case, run.answer
    found = given.estimate
    return Outcome(
        robot=case.robot,
        tier=case.tier,
        configuration=case.configuration,
        method=run.method,
        score=run.ruler.score(run.reference, None if found is None else found.state),
        told=run.reference.told,
        undetermined=() if found is None else found.undetermined,
        confidence=0.0 if found is None else found.confidence,
        evidence={} if found is None else evidence(found, case.scan, run.ruler),
        joints=() if found is None else joint_doubts(run.ruler, run.reference, found),
        seconds=given.seconds,
        fault=given.fault,
    )
