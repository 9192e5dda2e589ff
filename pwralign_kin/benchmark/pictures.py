"""Plots as files."""

from __future__ import annotations

import io
from typing import Any


def as_png(picture: Any) -> bytes:
    """Return a matplotlib figure as a PNG that has no date in it."""
    buffer = io.BytesIO()
    picture.savefig(buffer, format="png", metadata={"Software": None})
    return buffer.getvalue()
