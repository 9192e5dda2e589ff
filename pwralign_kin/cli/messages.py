"""Results to stdout; warnings, errors and progress to stderr. An unexpected error leaves a crash report."""

from __future__ import annotations

import logging
import os
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from pwralign_kin.cli.codes import ENOUGH_CONFIDENCE, LOW_CONFIDENCE, OK

if TYPE_CHECKING:
    from pwralign_kin.estimation import SharedBaseEstimate


class _StderrHandler(logging.Handler):
    """Writes each record of the library as one line.

    It looks `sys.stderr` up anew each time, because a running progress display replaces it.
    """

    def emit(self, record: logging.LogRecord) -> None:
        """Write the record."""
        say(record.getMessage(), record.levelname.lower() if record.levelno >= logging.WARNING else "note")


@contextmanager
def to_stderr() -> Iterator[None]:
    """While the block runs, show what this package logs and nothing of what other libraries log."""
    own, root = logging.getLogger("pwralign_kin"), logging.getLogger()
    handler, silence, level = _StderrHandler(), logging.NullHandler(), own.level
    own.addHandler(handler)
    root.addHandler(silence)
    own.setLevel(logging.INFO)
    logging.captureWarnings(True)
    try:
        yield
    finally:
        logging.captureWarnings(False)
        own.setLevel(level)
        own.removeHandler(handler)
        root.removeHandler(silence)


def answer(text: str) -> None:
    """Write a result to stdout; a reader who has gone changes neither what is done after it nor the exit code."""
    try:
        print(text, flush=True)
    except BrokenPipeError:
        give_up_stdout()


def give_up_stdout() -> None:
    """Let the rest of the output go nowhere, and keep Python from complaining of it on its way out."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def say(text: str, kind: str) -> None:
    """Write one line to stderr, whatever line breaks `text` holds."""
    sys.stderr.write(f"pwralign: {kind}: {' '.join(text.split())}\n")
    sys.stderr.flush()


def complain(text: str, code: int) -> int:
    """Write an error as one line and return the exit code."""
    say(text, "error")
    return code


def wrote(paths: Iterable[Path]) -> list[str]:
    """Return a line for each folder that files were written into."""
    files: dict[Path, list[str]] = {}
    for path in paths:
        files.setdefault(path.parent, []).append(path.name)
    return [f"wrote {folder}: {' '.join(names)}" for folder, names in files.items()]


def outcome(confidence: float, result: str) -> int:
    """Return the exit code of a result; one of little confidence is warned about."""
    if confidence >= ENOUGH_CONFIDENCE:
        return OK
    say(f"low confidence, below {ENOUGH_CONFIDENCE}: look at the {result} before you use it", "warning")
    return LOW_CONFIDENCE


def shared_outcome(result: SharedBaseEstimate) -> int:
    """Return the exit code of a result of several scans; warn where they contradict what was given, or each other."""
    if result.contradicted:
        contradiction = "the scans contradict joint values that were given, and the base is wrong with them"
        say(f"{contradiction}: mend the values, or leave them out to have them estimated", "warning")
        return LOW_CONFIDENCE
    strange = [str(i) for i, own in enumerate(result.estimates) if own.confidence < ENOUGH_CONFIDENCE]
    if strange and result.confidence >= ENOUGH_CONFIDENCE:
        which = "scan" if len(strange) == 1 else "scans"
        doubt = "low confidence on the base that the others share; of the same place, with joint values of that moment?"
        say(f"{which} {', '.join(strange)}: {doubt}", "warning")
    return outcome(result.confidence, "result")


@contextmanager
def progress() -> Iterator[Callable[[str], None]]:
    """Yield a function that shows the name of the current stage, on a terminal only."""
    if not sys.stderr.isatty():
        yield lambda stage: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (BarColumn(bar_width=20), TextColumn("{task.description}"), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True, redirect_stdout=False) as display:
        task = display.add_task("", total=None)
        yield lambda stage: display.update(task, description=stage)


def crash_report(error: BaseException) -> str:
    """Write the traceback of `error` into a file of the user's log folder and return where it is."""
    import platformdirs

    name = f"crash-{time.strftime('%Y%m%d-%H%M%S')}-{os.getpid()}.log"
    text = f"{' '.join(sys.argv)}\n\n{''.join(traceback.format_exception(error))}"
    for folder in (Path(platformdirs.user_log_dir("pwralign_kin")), Path(tempfile.gettempdir())):
        try:
            folder.mkdir(parents=True, exist_ok=True)
            (folder / name).write_text(text, encoding="utf-8")
        except OSError:
            continue
        return f"this is a defect of pwralign; please report it with {folder / name}"
    return "this is a defect of pwralign; its traceback could not be written anywhere"
