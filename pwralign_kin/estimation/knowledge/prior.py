"""What is known of the answer before the scan is looked at: of the base, and by `EstimatorOptions.prior` of the joints.

Whatever is known narrows the search (part hypotheses that no joint values bring into agreement with it are dropped,
configurations are grown from a known base, joints are swept only where they may be), counts in the two-way score, and
enters refinement and joint least squares as residuals divided by their standard deviations.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pwralign_kin import kernels
from pwralign_kin.checked_options import CheckedOptions, NotNegative
from pwralign_kin.estimation.sensing.observation import Observation
from pwralign_kin.exceptions import OptionError, UnknownNameError
from pwralign_kin.model import ArticulatedModel
from pwralign_kin.se3 import Array, as_floats, checked_placement, inverse, rotation_about

Vector = tuple[float, float, float]

JOINT_REACH = 4.0
"""Standard deviations about its prior value that a joint is searched in."""
INDEPENDENT_POINTS = 1000
"""Neighbouring points share the sensor's error: beside a prior, a scan is worth about this many independent ones."""
LEAST_STD = 1e-4
"""Smallest standard deviation of a base (rad, model diagonals) that is told from an exact one."""
REGION_STD = 0.005
"""How sharp the faces of a region are (model diagonals)."""
NEAR_TURN, NEAR_DISTANCE = 0.35, 0.15
"""A base known to these standard deviations (rad, model diagonals) is near enough to grow the model from."""
SURE_TURN, SURE_DISTANCE = 0.03, 0.01
"""A base known to no more than these (rad, model diagonals) is grown from as it is, others from bases ..."""
ASIDE = 1.5
"""... so many standard deviations aside as well."""


@dataclass(frozen=True)
class BasePrior(CheckedOptions):
    """What is known of the base placement; every part of it may be left out.

    A fixed base is `T_scan_base` alone, a rough guess `T_scan_base` with standard deviations, a known position
    `T_scan_base` with `rotation_std=None`. Raises `OptionError` for values that make no sense, `StateError` for
    a placement that is not rigid.
    """

    T_scan_base: Sequence[Sequence[float]] | Array | None = None
    """(4, 4) where `base_link` is, m."""
    base_link: str | None = None
    """The link that `T_scan_base` and `base_up` speak of, one that no joint moves; None: the root link."""
    translation_std: NotNegative = 0.0
    """Standard deviation of each coordinate of the translation, m; 0: exact."""
    rotation_std: NotNegative | None = 0.0
    """Standard deviation of the rotation about each axis, rad; 0: exact; None: nothing is known of the rotation."""
    up: Vector | None = None
    """Direction in the scan frame that is up (against gravity), of any length."""
    base_up: Vector = (0.0, 0.0, 1.0)
    """Direction in the base link's frame that is up."""
    up_std: NotNegative = float(np.radians(3.0))
    """Standard deviation of the angle between the two, rad."""
    region: tuple[Vector, Vector] | None = None
    """Least and greatest corner of a box in the scan frame that holds the root link's origin, m."""

    def __post_init__(self) -> None:
        """Check the fields and turn them into plain values."""
        super().__post_init__()
        if self.T_scan_base is not None:
            T = checked_placement(self.T_scan_base, "T_scan_base of the base's prior")
            object.__setattr__(self, "T_scan_base", tuple(map(tuple, T.tolist())))
        for name in ("up", "base_up"):
            if getattr(self, name) is not None:
                direction = checked_numbers(getattr(self, name), name, (3,))
                if np.linalg.norm(direction) < 1e-9:
                    raise OptionError(name, getattr(self, name), "a direction of some length")
                object.__setattr__(self, name, tuple(direction.tolist()))
        if self.region is not None:
            object.__setattr__(self, "region", checked_box(self.region, "the base's region"))

    def in_search_units(
        self, model: ArticulatedModel, observation: Observation, values: Array, std: Array
    ) -> SearchPrior:
        """Return what the search takes, with the prior `values` and `std` (k,) of the joints in search units.

        Raises `OptionError` and `UnknownNameError` when the link does not fit the model.
        """
        T_root_base = placement_in_root(model, self.base_link)
        placement = None
        if self.T_scan_base is not None:
            placement = observation.to_search(np.asarray(self.T_scan_base) @ inverse(T_root_base))
        up = None
        if self.up is not None:
            up = np.concatenate([_unit(self.up), _unit(T_root_base[:3, :3] @ np.asarray(self.base_up))])
        region = None
        if self.region is not None:
            region = (np.asarray(self.region) - observation.centre) / model.diagonal
        return SearchPrior(
            placement,
            max(self.translation_std / model.diagonal, LEAST_STD),
            None if self.rotation_std is None else max(self.rotation_std, LEAST_STD),
            self.translation_std == 0 and self.rotation_std == 0 and placement is not None,
            up,
            max(self.up_std, LEAST_STD),
            region,
            values,
            std,
        )


@dataclass(frozen=True)
class SearchPrior:
    """All that is known, in search units; the base is that of the root part."""

    placement: Array | None
    translation_std: float
    rotation_std: float | None
    held: bool
    """Whether the placement is exact."""
    up: Array | None
    """(6,) unit vectors: up in the scan, up in the root part."""
    up_std: float
    region: Array | None
    """(2, 3) corners."""
    values: Array
    """(k,) prior values of the joints, which unseen ones keep."""
    std: Array
    """(k,) their standard deviations; infinite where nothing is known."""

    @classmethod
    def nothing(cls, values: Array) -> SearchPrior:
        """Return the prior of a search that knows nothing; `values` (k,) only say how many joints there are."""
        return cls(None, 1.0, None, False, None, 1.0, None, values, np.full(len(values), np.inf))

    @property
    def near(self) -> bool:
        """Whether the base is known well enough to grow the model from it."""
        if self.placement is None or self.rotation_std is None:
            return False
        return self.rotation_std <= NEAR_TURN and self.translation_std <= NEAR_DISTANCE

    def tell(self, native: kernels.Search) -> None:
        """Tell the search's kernels what is known."""
        none = np.zeros(0)
        position = none if self.placement is None else np.ascontiguousarray(self.placement[:3, 3])
        turn = none
        if self.placement is not None and self.rotation_std is not None:
            turn = np.ascontiguousarray(self.placement[:3, :3]).ravel()
        native.set_prior(
            position=position,
            position_deviation=self.translation_std,
            turn=turn,
            turn_deviation=self.rotation_std or 1.0,
            up=none if self.up is None else self.up,
            up_deviation=self.up_std,
            region=none if self.region is None else self.region.ravel(),
            region_deviation=REGION_STD,
            values=self.values,
            inverse_deviations=1.0 / self.std,
        )

    def bases(self) -> Array:
        """Return the known base and, where it is uncertain, bases `ASIDE` of it (m, 4, 4)."""
        if self.placement is None:
            return np.zeros((0, 4, 4))
        out = [self.placement]
        for axis in np.eye(3):
            for deviations in (-ASIDE, ASIDE):
                if self.translation_std > SURE_DISTANCE:
                    moved = self.placement.copy()
                    moved[:3, 3] += deviations * self.translation_std * axis
                    out.append(moved)
                if self.rotation_std is not None and self.rotation_std > SURE_TURN:
                    turned = self.placement.copy()
                    turned[:3, :3] = rotation_about(axis, deviations * self.rotation_std) @ turned[:3, :3]
                    out.append(turned)
        return np.array(out)


def placement_in_root(model: ArticulatedModel, link: str | None) -> Array:
    """Return T_root_link (4, 4) of a link welded to the root; raises `UnknownNameError` or `OptionError` for others."""
    if link in (None, model.root_link):
        return np.eye(4)
    if link not in model.T_part_link:
        raise UnknownNameError("link", str(link), model.T_part_link)
    part, T_root_base = model.T_part_link[link]
    if part != 0:
        raise OptionError("base_link", link, "a link that no joint moves: only those say where the base is")
    return np.asarray(T_root_base)


def checked_box(value: Any, name: str) -> tuple[Vector, Vector]:
    """Return a least and a greatest corner as plain numbers. Raises `OptionError` for anything else."""
    low, high = checked_numbers(value, name, (2, 3)).tolist()
    if any(least > most for least, most in zip(low, high, strict=True)):
        raise OptionError(name, value, "a least and a greatest corner, in this order")
    return tuple(low), tuple(high)


def checked_numbers(value: Any, name: str, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Return `value` as an array of the given shape. Raises `OptionError` for anything else."""
    try:
        array = as_floats(value)
    except (TypeError, ValueError):
        array = np.empty(0)
    if array.shape != shape or not np.isfinite(array).all():
        raise OptionError(name, value, f"{' x '.join(map(str, shape))} finite numbers")
    return array


def _unit(vector: Any) -> Array:
    direction = np.asarray(vector, dtype=np.float64)
    return np.asarray(direction / np.linalg.norm(direction))
