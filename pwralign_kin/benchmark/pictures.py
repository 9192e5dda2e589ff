"""Plots as files, all in one style."""

from __future__ import annotations

import io
from typing import Any

DPI = 200

COLOURS = ("#2563a8", "#d1662b", "#2f8f6b", "#8a5aa8", "#b8912a")
"""Easy to tell apart, also with poor colour vision; the first is for ours."""

PALE = "#8b8f98"
"""What is there for comparison."""


def new_figure(width: float, height: float) -> Any:
    """Return an empty matplotlib figure of a size in inches."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), dpi=DPI, layout="constrained")


def tidy(axes: Any) -> None:
    """Give a panel a pale grid and no frame but its two axes."""
    axes.grid(color="0.9", linewidth=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)


def as_png(picture: Any) -> bytes:
    """Return a matplotlib figure as a PNG that has no date in it."""
    buffer = io.BytesIO()
    picture.savefig(buffer, format="png", metadata={"Software": None})
    return buffer.getvalue()
