"""Measure how well and how fast estimates are, on robots and seeds that anyone can get. Tables go to stdout.

pip install "pwralign-kin[benchmark]", then: python scripts/benchmark.py [--table NAME ...] [--write]
"""

from __future__ import annotations

import argparse
import json
import logging
import shlex
import sys
import time
from collections.abc import Callable, Collection
from pathlib import Path

from pwralign_kin import files
from pwralign_kin.benchmark.cases import ROBOTS, SENSORS, sample_names, wheel_robots
from pwralign_kin.benchmark.provenance import DOCUMENTS, REPORT, provenance
from pwralign_kin.benchmark.suite import TABLES, Settings
from pwralign_kin.benchmark.table import plain, with_section
from pwralign_kin.exceptions import PwralignError

REPOSITORY = Path(__file__).resolve().parent.parent
SAMPLES = REPOSITORY / "robots"
PICTURES = REPOSITORY / "docs"


def main() -> int:
    try:
        options = _options()
    except PwralignError as error:  # the wheel of robots is not installed
        return _failed(error)
    for name in ("pwralign_kin", "yourdfpy", "trimesh"):  # what these robots need mended is known
        logging.getLogger(name).setLevel(logging.ERROR)
    settings = Settings(SAMPLES, options.robots, options.tiers, options.configurations, options.threads, options.frames)
    # Where the single results go is of no interest to those who read the tables.
    words = [word for word in sys.argv[1:] if word != str(options.json) and not word.startswith("--json")]
    command = shlex.join(["python", "scripts/benchmark.py", *words])
    report = {}
    try:
        for name in options.table:
            source = provenance(REPOSITORY, options.threads, command)
            start = time.perf_counter()
            result = TABLES[name](settings, _say)
            minutes = (time.perf_counter() - start) / 60
            body = f"{source} The run took {minutes:.1f} min.\n\n{result.text}"
            print(f"## {name}\n\n{body}", flush=True)
            report[name] = {"source": plain(source), "results": plain(result.records)}
            if options.json:
                files.write_text(options.json, json.dumps(report, indent=1) + "\n")
            if options.write:
                for picture, content in result.pictures.items():
                    files.write_bytes(PICTURES / picture, content)
                document = REPOSITORY / DOCUMENTS.get(name, REPORT)
                files.write_text(document, with_section(document.read_text(encoding="utf-8"), name, body))
    except PwralignError as error:
        return _failed(error)
    return 0


def _failed(error: PwralignError) -> int:
    print(f"error: {error}", file=sys.stderr)
    return 1


def _options() -> argparse.Namespace:
    robots = [*wheel_robots(), *sample_names(SAMPLES)]
    parser = argparse.ArgumentParser(description="Measure how well and how fast estimates are.", allow_abbrev=False)
    parser.add_argument("--table", nargs="+", choices=TABLES, default=list(TABLES), help="by default all")
    parser.add_argument("--robots", type=_names(robots), metavar="A,B", help=f"{', '.join(ROBOTS)}, or others")
    parser.add_argument("--tiers", type=_names(SENSORS), metavar="A,B", help=f"of {', '.join(SENSORS)}")
    parser.add_argument("--configurations", type=_positive, help="random states of each robot (3 or 10)")
    parser.add_argument("--frames", type=_positive, help="frames of a tracked sequence (1000)")
    parser.add_argument("--threads", type=_positive, default=2, help="threads of an estimate (2)")
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write every single result")
    parser.add_argument("--write", action="store_true", help=f"put the figures into {REPORT} and docs")
    return parser.parse_args()


def _names(valid: Collection[str]) -> Callable[[str], tuple[str, ...]]:
    def names(text: str) -> tuple[str, ...]:
        chosen = tuple(text.split(","))
        unknown = [name for name in chosen if name not in valid]
        if unknown:
            raise argparse.ArgumentTypeError(f"no {', '.join(unknown)}; there are {', '.join(valid)}")
        return chosen

    return names


def _positive(text: str) -> int:
    number = int(text)
    if number < 1:
        raise argparse.ArgumentTypeError(f"{number} is not positive")
    return number


def _say(line: str) -> None:
    print(line, file=sys.stderr, flush=True)


if __name__ == "__main__":
    sys.exit(main())
