"""Articulated-model pose estimation: a URDF and a scan in, base placement and every joint value out."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pwralign_kin.estimation import (
        Alternative,
        BasePrior,
        Correspondences,
        Estimate,
        EstimatorOptions,
        PartEstimate,
        SharedBaseEstimate,
        calibrate,
        estimate,
    )
    from pwralign_kin.exceptions import PwralignError
    from pwralign_kin.model import ArticulatedModel
    from pwralign_kin.scan import DepthFrame, Scan
    from pwralign_kin.simulation import Sensor, simulate
    from pwralign_kin.state import State
    from pwralign_kin.tracking import TrackedFrame, Tracker, TrackerOptions

_HOME = {
    "Alternative": "estimation",
    "ArticulatedModel": "model",
    "BasePrior": "estimation",
    "Correspondences": "estimation",
    "DepthFrame": "scan",
    "Estimate": "estimation",
    "EstimatorOptions": "estimation",
    "PartEstimate": "estimation",
    "PwralignError": "exceptions",
    "Scan": "scan",
    "Sensor": "simulation",
    "SharedBaseEstimate": "estimation",
    "State": "state",
    "TrackedFrame": "tracking",
    "Tracker": "tracking",
    "TrackerOptions": "tracking",
    "calibrate": "estimation",
    "estimate": "estimation",
    "simulate": "simulation",
}

__version__: str

__all__ = [
    "Alternative",
    "ArticulatedModel",
    "BasePrior",
    "Correspondences",
    "DepthFrame",
    "Estimate",
    "EstimatorOptions",
    "PartEstimate",
    "PwralignError",
    "Scan",
    "Sensor",
    "SharedBaseEstimate",
    "State",
    "TrackedFrame",
    "Tracker",
    "TrackerOptions",
    "__version__",
    "calibrate",
    "estimate",
    "simulate",
]


def __getattr__(name: str) -> Any:
    """Import public names on first use, so that `pwralign --help` loads none of the heavy libraries."""
    if name == "__version__":
        from importlib.metadata import version

        return version("pwralign-kin")
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    try:
        return getattr(import_module(f"{__name__}.{_HOME[name]}"), name)
    except ImportError as error:
        from pwralign_kin.dependencies import explained

        raise explained(error) or error from None


def __dir__() -> list[str]:
    """Return the public names, imported or not."""
    return sorted(__all__)
