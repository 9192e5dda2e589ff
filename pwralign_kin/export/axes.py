"""Names of the scan's up axis."""

from __future__ import annotations

import numpy as np

from pwralign_kin.exceptions import UnknownNameError
from pwralign_kin.se3 import Array

UP_AXES = ("x", "y", "z", "-x", "-y", "-z")


def up_vector(name: str) -> Array:
    """Return the unit vector (3,) of the axis `name` in the scan frame; raises `UnknownNameError` for no
    axis.
    """
    if name not in UP_AXES:
        raise UnknownNameError("up axis", name, UP_AXES)
    return np.asarray(np.eye(3)["xyz".index(name[-1])] * (-1.0 if name.startswith("-") else 1.0))
