"""Exit codes."""

from __future__ import annotations

OK = 0
BAD_INPUT = 1
USAGE = 2
LOW_CONFIDENCE = 3
DEFECT = 70
"""Something that should not happen: EX_SOFTWARE of sysexits.h."""
INTERRUPTED = 130
"""128 + SIGINT, as shells have it."""

ENOUGH_CONFIDENCE = 0.5
"""An estimate below this confidence exits with LOW_CONFIDENCE."""


class UsageError(Exception):
    """The arguments contradict each other or one is malformed."""
