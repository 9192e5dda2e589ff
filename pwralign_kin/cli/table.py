"""Plain tables: aligned columns that survive pipes and narrow terminals."""

from __future__ import annotations

from collections.abc import Sequence


def table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return the lines of a table; a head that begins with a blank marks a column aligned to the right."""
    lines = [tuple(head.strip() for head in heads), *map(tuple, rows)]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    aligned = [str.rjust if head.startswith(" ") else str.ljust for head in heads]
    return "\n".join(
        "  ".join(align(cell, width) for align, cell, width in zip(aligned, line, widths, strict=True)).rstrip()
        for line in lines
    )
