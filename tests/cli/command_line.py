"""A two-link arm, and what a call of the command line leaves behind."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

ARM = """
  <link name="base"><visual><geometry><box size="0.5 0.4 0.1"/></geometry></visual></link>
  <link name="upper">
    <visual><origin xyz="0 0 0.2"/><geometry><box size="0.12 0.08 0.4"/></geometry></visual>
  </link>
  <link name="lower">
    <visual><origin xyz="0.15 0 0"/><geometry><box size="0.3 0.06 0.05"/></geometry></visual>
    <visual><origin xyz="0.3 0.05 0"/><geometry><sphere radius="0.05"/></geometry></visual>
  </link>
  <joint name="shoulder" type="revolute">
    <parent link="base"/><child link="upper"/><origin xyz="0.1 0.05 0.05"/><axis xyz="1 0 0"/>
    {shoulder_limit}
  </joint>
  <joint name="elbow" type="revolute">
    <parent link="upper"/><child link="lower"/><origin xyz="0 0 0.4"/><axis xyz="0 1 0"/>
    <limit lower="-1" upper="1" effort="1" velocity="1"/>
  </joint>
"""
LIMIT = '<limit lower="-1.2" upper="1.2" effort="1" velocity="1"/>'


@dataclass(frozen=True)
class Outcome:
    """What one call of the command line left behind."""

    code: int
    out: str
    err: str

    def error(self) -> str:
        """The error, having checked that it is one line, the last on stderr, and stdout empty."""
        *before, last = self.err.splitlines()
        assert last.startswith("pwralign: error: "), self.err
        assert all(line.startswith(("pwralign: warning: ", "pwralign: note: ")) for line in before), self.err
        assert self.out == ""
        return last.removeprefix("pwralign: error: ")


Call = Callable[..., Outcome]
