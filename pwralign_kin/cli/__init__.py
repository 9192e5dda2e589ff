"""The command `pwralign`: verbs, exit codes, and one line on stderr for everything that goes wrong."""

from __future__ import annotations

import errno
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING

import pwralign_kin
from pwralign_kin import dependencies
from pwralign_kin.cli import messages
from pwralign_kin.cli.codes import BAD_INPUT, DEFECT, INTERRUPTED, OK, USAGE, UsageError
from pwralign_kin.exceptions import PwralignError

if TYPE_CHECKING:
    from cyclopts import App

VERBS = {
    "estimate": "Find where a model is in a scan: its base placement and every joint value.",
    "calibrate": "Find where a robot with known joint values stands in a sensor's frame, from several scans.",
    "track": "Follow a model through a stream of scans or depth images: a state per frame.",
    "inspect": "Show the parts and joints of a URDF, what is missing or was mended, and what a scan holds.",
    "simulate": "Scan a model in software: points with the truth beside them.",
    "benchmark": "Compare this estimator with other methods: how right and how fast on the same scans.",
    "doctor": "Check that everything this program needs is installed, and say how to mend it.",
}
"""Each verb is a module of this package with a function of the same name."""


USAGES = {
    "estimate": "[OPTIONS] URDF SCAN [SCAN ...]",
    "calibrate": "[OPTIONS] URDF SCAN=JOINTS [SCAN=JOINTS ...]",
    "track": "[OPTIONS] URDF FRAME [FRAME ...]",
    "inspect": "[OPTIONS] URDF [SCAN]",
}
"""How verbs are called of which the parser does not name all arguments."""

EXAMPLES = {
    "estimate": (
        "pwralign estimate robot.urdf scan.ply --out result",
        "pwralign estimate robot.urdf room.ply --gravity 0 0 -1 --near 1 0 0.8",
    ),
    "calibrate": ("pwralign calibrate robot.urdf one.ply=one.yaml two.ply=two.yaml --out camera.json",),
    "track": (
        "pwralign track robot.urdf scans --out track",
        "pwralign track robot.urdf depth --intrinsics 600 600 319.5 239.5 --out track",
    ),
    "inspect": ("pwralign inspect robot.urdf scan.ply",),
    "simulate": (
        "pwralign simulate robot.urdf --tier single --joint elbow=1.2 --out simulated",
        "pwralign simulate robot.urdf --scene --contacts 1 --out room",
    ),
    "benchmark": ("pwralign benchmark --robots robot.urdf --tiers full,single",),
}
"""What the help of a verb shows besides its options."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run `pwralign` with `arguments` (those of the process by default) and return its exit code."""
    tokens = sys.argv[1:] if arguments is None else list(arguments)
    with messages.to_stderr():
        try:
            return _run(tokens)
        except KeyboardInterrupt:  # while libraries load, too
            return messages.complain("interrupted", INTERRUPTED)


def _run(tokens: Sequence[str]) -> int:
    """Return the exit code of a command; everything that goes wrong is one line on stderr."""
    from cyclopts import CycloptsError

    try:
        code = _app()(tokens, exit_on_error=False, print_error=False, result_action="return_value")
        sys.stdout.flush()
    except (CycloptsError, UsageError) as error:
        verb = f"{tokens[0]} " if tokens and tokens[0] in VERBS else ""
        return messages.complain(f"{error} See pwralign {verb}--help.", USAGE)
    except PwralignError as error:
        return messages.complain(str(error), BAD_INPUT)
    except (BrokenPipeError, SystemExit) as error:
        if isinstance(error, SystemExit) and not isinstance(error.__context__, BrokenPipeError):
            return _unexpected(error)  # only Rich, which prints the help, ends a process, where it cannot be read
        messages.give_up_stdout()  # whoever read the output has had enough
        return OK
    except OSError as error:
        if error.errno != errno.ENOSPC:
            return _unexpected(error)
        messages.give_up_stdout()
        return messages.complain(f"the output cannot be written: {error.strerror}", BAD_INPUT)
    except Exception as error:
        return _unexpected(error)
    return OK if code is None else int(code)


def _app() -> App:
    """Return the parser. The verbs' modules are imported when called, so that help comes at once."""
    from cyclopts import App

    app = App(
        name="pwralign",
        help="A URDF and a scan in; the model's base placement and every joint value out.",
        help_epilogue="Exit codes: 0 ok, 1 bad input, 2 usage, 3 low confidence, 70 a defect, 130 interrupted.",
        help_format="plaintext",
        suppress_keyboard_interrupt=False,
        version=lambda: pwralign_kin.__version__,
    )
    for place, (verb, summary) in enumerate(VERBS.items()):
        text = "\n\n".join([summary, *(f"Example: {example}" for example in EXAMPLES.get(verb, ()))])
        usage = f"Usage: pwralign {verb} {USAGES[verb]}" if verb in USAGES else None
        app.command(f"{__name__}.{verb}:{verb}", name=verb, help=text, usage=usage, sort_key=place)
    return app


def _unexpected(error: BaseException) -> int:
    """Complain of an error that nobody raised on purpose: a library does not load, or a defect."""
    if isinstance(error, ImportError | OSError):
        problem = dependencies.explained(error)
        if problem is not None:
            return messages.complain(str(problem), BAD_INPUT)
    return messages.complain(f"unexpected {type(error).__name__}: {error} ({messages.crash_report(error)})", DEFECT)
