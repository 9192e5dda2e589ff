"""Values that never change: results, states, scans and models may be shared and copied without a thought."""

from __future__ import annotations

from typing import Any, TypeVar

import numpy as np

Key = TypeVar("Key")
Value = TypeVar("Value")


class ReadOnlyDict(dict[Key, Value]):
    """A mapping that never changes, for JSON a dict; everything that would change it raises `TypeError`."""

    def _refused(self, *_: Any, **__: Any) -> Any:
        raise TypeError("these values never change: make another State, result or options")

    __setitem__ = __delitem__ = __ior__ = _refused
    clear = pop = popitem = setdefault = update = _refused

    def __hash__(self) -> int:  # type: ignore[override]
        """Equal values have equal hashes."""
        return hash(frozenset(self.items()))

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle and copy as made anew: the usual way would fill an empty one."""
        return type(self), (dict(self),)


class ReadOnly:
    """What frozen dataclasses of arrays and dicts are derived from, so that these do not change either."""

    def __post_init__(self) -> None:
        """Keep views of the arrays that cannot be written to, and dicts that refuse it."""
        vars(self).update({name: read_only(value) for name, value in vars(self).items()})

    def __setstate__(self, fields: dict[str, Any]) -> None:
        """Take the fields of a pickle or a copy, which forget that arrays are read-only."""
        vars(self).update({name: read_only(value) for name, value in fields.items()})


def read_only(value: Any) -> Any:
    """Return an array or a dict such that it cannot be changed, anything else as it is."""
    if isinstance(value, np.ndarray) and value.flags.writeable:
        value = value.view()
        value.flags.writeable = False
    return ReadOnlyDict(value) if type(value) is dict else value
