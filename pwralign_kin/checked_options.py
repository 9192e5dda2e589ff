"""Options that check themselves: what a field may hold stands in its type, and anything else raises `OptionError`."""

from __future__ import annotations

import math
import sys
from collections.abc import Iterable
from dataclasses import dataclass, fields, is_dataclass
from functools import cache
from numbers import Real
from types import UnionType
from typing import Annotated, Any, Union, get_args, get_origin, get_type_hints

from pwralign_kin.exceptions import OptionError

SEED_LIMIT = 2**32
"""Seeds are whole numbers from 0 to less than this."""


@dataclass(frozen=True)
class Range:
    """The numbers that an option may be."""

    least: float = 0
    most: float = sys.float_info.max
    beyond_least: bool = False
    """Whether `least` itself is none of them."""

    def __contains__(self, number: float) -> bool:
        """Whether a number is one of them; NaN never is."""
        return bool(self.least <= number <= self.most) and not (self.beyond_least and number == self.least)

    def described(self, kind: type) -> str:
        """Say which they are, as "a whole number from 1 to 10"."""
        unbounded = self.most >= sys.float_info.max
        noun = "whole number" if kind is int else "finite number" if self.most == sys.float_info.max else "number"
        least = f"above {self.least:.12g}" if self.beyond_least else f"from {self.least:.12g}"
        most = f" to {self.most:.12g}" if not unbounded else "" if self.beyond_least else " on"
        return f"a {noun} {least}{most}"


LARGEST_COUNT = 10**6
"""No count is larger: kernels take them in 32 bits."""

Count = Annotated[int, Range(1, LARGEST_COUNT)]
Natural = Annotated[int, Range(0, LARGEST_COUNT)]
Seed = Annotated[int, Range(0, SEED_LIMIT - 1)]
Threads = Annotated[int, Range(0, 10**4)]
"""0: one per core."""
Positive = Annotated[float, Range(beyond_least=True)]
NotNegative = Annotated[float, Range()]
Threshold = Annotated[float, Range(0, math.inf)]
"""Infinite: never reached."""
Share = Annotated[float, Range(0, 1)]
Cell = Annotated[float, Range(1e-3, 1)]
"""Side of the cells of a grid, model diagonals: halved, a grid takes up to eight times the memory."""


class CheckedOptions:
    """What sections of options, frozen dataclasses, are derived from."""

    def __post_init__(self) -> None:
        """Check the fields and turn NumPy's numbers into plain ones, which JSON takes. Raises `OptionError`."""
        hints = _hints(type(self))  # type: ignore[arg-type]
        for own in fields(self):  # type: ignore[arg-type]
            value = getattr(self, own.name)
            if value is not own.default:
                name = f"{type(self).__name__}.{own.name}"
                object.__setattr__(self, own.name, _checked(name, value, hints[own.name]))


def check_increasing(options: CheckedOptions, *names: str) -> None:
    """Raise `OptionError` where the second of two numbers is less than the first."""
    for name in names:
        numbers = getattr(options, name)
        if numbers[0] > numbers[1]:
            raise OptionError(f"{type(options).__name__}.{name}", numbers, "the lesser number, then the greater")


@cache
def _hints(kind: type) -> dict[str, Any]:
    return get_type_hints(kind, include_extras=True)


def checked_number(name: str, value: Any, hint: Any) -> Any:
    """Return `value` as the plain number that `hint`, one of the types above, says. Raises `OptionError`."""
    kind, valid = get_args(hint)
    plain = _plain(value)
    is_kind = isinstance(plain, int if kind is int else Real) and not isinstance(plain, bool)
    # Whole numbers of hundreds of digits are no floats, not even infinite ones.
    if not is_kind or plain not in valid or (plain > sys.float_info.max and plain != math.inf):
        raise OptionError(name, value, valid.described(kind))
    return kind(plain)


def _plain(value: Any) -> Any:
    """Return NumPy's scalars as Python's own, anything else as it is."""
    return value.item() if getattr(value, "shape", None) == () and hasattr(value, "item") else value


def _checked(name: str, value: Any, hint: Any) -> Any:
    """Return `value` as `hint` says where it says anything that is checked here, else as it is."""
    arguments = get_args(hint)
    if get_origin(hint) is Annotated:
        return checked_number(name, value, hint)
    if get_origin(hint) in (Union, UnionType) and len(arguments) == 2 and arguments[1] is type(None):
        return None if value is None else _checked(name, value, arguments[0])
    if get_origin(hint) is tuple and all(part in (str, ...) or get_origin(part) is Annotated for part in arguments):
        return _checked_tuple(name, value, arguments)
    if hint is bool:
        if not isinstance(_plain(value), bool):
            raise OptionError(name, value, "True or False")
        return _plain(value)
    if is_dataclass(hint) and not isinstance(value, hint):  # type: ignore[arg-type]
        raise OptionError(name, value, f"{hint.__name__}(...)")  # type: ignore[union-attr]
    return value


def _checked_tuple(name: str, value: Any, arguments: tuple[Any, ...]) -> tuple[Any, ...]:
    """Return several names, several numbers, or as many numbers as there are `arguments`, as a tuple."""
    what = "names" if arguments[0] is str else "numbers"
    any_number = arguments[1:] == (...,)
    members = tuple(value) if isinstance(value, Iterable) and not isinstance(value, str | bytes) else None
    if members is None or not (any_number or len(members) == len(arguments)):
        raise OptionError(name, value, f"{'several' if any_number else len(arguments)} {what}")
    if what == "numbers":
        return tuple(checked_number(f"{name}[{i}]", member, arguments[0]) for i, member in enumerate(members))
    if not all(isinstance(member, str) for member in members):
        raise OptionError(name, value, "several names")
    return members
