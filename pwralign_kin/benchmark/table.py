"""Figures as Markdown tables, and the marked sections of a document that they are written into."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import asdict, is_dataclass
from typing import Any

import numpy as np

from pwralign_kin.exceptions import UnknownNameError

NONE = "–"
"""What stands where there is no figure."""

_SECTION = re.compile(r"<!-- table:([\w-]+) -->\n(.*?)<!-- end -->", re.DOTALL)


def markdown(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a Markdown table; a head that begins with a blank marks a column aligned to the right."""
    rules = ["---:" if head.startswith(" ") else "---" for head in heads]
    lines = [[head.strip() for head in heads], rules, *rows]
    return "\n".join(f"| {' | '.join(cell.replace('|', '/') for cell in line)} |" for line in lines) + "\n"


def sections(text: str) -> list[str]:
    """Return the names of the marked sections of a document, in order."""
    return [found[1] for found in _SECTION.finditer(text)]


def with_section(text: str, name: str, body: str) -> str:
    """Return the document `text` with the content of its section `name` replaced.

    A section stands between the lines `<!-- table:name -->` and `<!-- end -->`. Raises `UnknownNameError`
    where the document has none of that name.
    """
    if name not in sections(text):
        raise UnknownNameError("section", name, sections(text))

    def replaced(found: re.Match[str]) -> str:
        return f"<!-- table:{name} -->\n\n{body.strip()}\n\n<!-- end -->" if found[1] == name else found[0]

    return _SECTION.sub(replaced, text)


def plain(value: Any) -> Any:
    """Return results as JSON knows them: dataclasses as objects, numbers that are not finite as null."""
    if is_dataclass(value) and not isinstance(value, type):
        return plain(asdict(value))
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value


def share(truths: Sequence[bool]) -> str:
    """Return how many are true, as percentage and count."""
    return f"{100 * float(np.mean(truths)):.0f}% ({sum(truths)}/{len(truths)})" if truths else NONE


def figure(value: float, unit: str = "", digits: int = 2) -> str:
    """Return a number with its unit, or a dash where it is not finite."""
    return f"{value:.{digits}f}{unit}" if math.isfinite(value) else NONE


def median(values: Sequence[float]) -> float:
    """Return the median; NaN of nothing."""
    return quantile(values, 0.5)


def quantile(values: Sequence[float], share_below: float) -> float:
    """Return the value below which a share of `values` lies; NaN of nothing."""
    return float(np.quantile(values, share_below)) if len(values) else float("nan")
