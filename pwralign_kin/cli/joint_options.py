"""What is known of the joints, as a guess or for sure."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from pwralign_kin.cli.arguments import GUESS, Joints, joint_values
from pwralign_kin.cli.codes import UsageError

if TYPE_CHECKING:
    from pwralign_kin.state import State


@Parameter(name="*", group=GUESS)
@dataclass(frozen=True)
class JointOptions:
    """Values that joints have where the scan does not tell, and joints that keep them whatever it tells."""

    joint: Joints = None
    lock: Annotated[
        list[str] | None,
        Parameter(
            help="A joint that keeps its --joint or --initial value, else 0 or the limit nearest to it; may be "
            "repeated.",
            negative=(),
        ),
    ] = None

    def __post_init__(self) -> None:
        """Raise `UsageError` for values of another form than name=value, and for locks of that form."""
        joint_values(self.joint)
        for name in self.lock or ():
            if "=" in name:
                raise UsageError(f"--lock takes the name of a joint alone; its value comes with --joint {name}.")

    @property
    def values(self) -> dict[str, float]:
        """{name: value}, rad or m."""
        return joint_values(self.joint)

    @property
    def locked(self) -> tuple[str, ...]:
        """Names of the joints to lock."""
        return tuple(self.lock or ())

    def over(self, state: State) -> State:
        """Return a state with the given values before its own."""
        from pwralign_kin.state import State

        return State(state.T_scan_base, {**state.joints, **self.values}, state.base_link)


JOINT_OPTIONS = JointOptions()
