"""Units of length that scans come in."""

from __future__ import annotations

from typing import Literal

Unit = Literal["m", "cm", "mm", "in", "ft"]
Units = Literal["m", "cm", "mm", "in", "ft", "auto"]

METRES: dict[str, float] = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "in": 0.0254, "ft": 0.3048}
"""Length of each unit, m."""

PLURALS = {"cm": "centimetres", "mm": "millimetres", "in": "inches", "ft": "feet"}
"""What the units other than m are called."""
