"""Frozen data whose arrays are read-only however they come about: made, replaced, copied, or read from a pickle."""

import functools
from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any, TypeVar

import numpy as np

from calib.foundations.arguments import takes_arrays
from calib.foundations.arrays import read_only_view

_C = TypeVar("_C")


def sealed(cls: type[_C]) -> type[_C]:
    """Let nobody write to arrays through the fields of a frozen dataclass; stands right above its name.

    The fields have views: whoever made an array may go on with it. Which fields may hold arrays, the hints say.
    """
    own: Any = cls
    before = vars(cls).get("__post_init__")

    def after_init(made: Any) -> None:
        if before is not None:
            before(made)
        of: Any = type(made)
        _take(made, {name: getattr(made, name) for name in _with_arrays(of)})

    def set_state(made: Any, state: Mapping[str, Any] | Sequence[Any]) -> None:
        """Take what a copy or a pickle holds: of a class with slots, the fields in a row."""
        in_a_row = not isinstance(state, Mapping)
        _take(made, dict(zip((f.name for f in fields(made)), state, strict=True) if in_a_row else state))

    own.__post_init__, own.__setstate__ = after_init, set_state
    return cls


def _take(made: Any, values: Mapping[str, Any]) -> None:
    cls: Any = type(made)
    for name, value in values.items():
        object.__setattr__(made, name, _read_only(value) if name in _with_arrays(cls) else value)


@functools.cache
def _with_arrays(of: Any) -> frozenset[str]:
    """Return the names of the fields of a dataclass that may hold arrays."""
    return frozenset(field.name for field in fields(of) if takes_arrays(field.type))


def _read_only(value: Any) -> Any:
    """Return a value with read-only views of the arrays that it is, or has in its tuples and mappings."""
    if isinstance(value, np.ndarray):
        return read_only_view(value) if value.flags.writeable else value
    if isinstance(value, tuple):
        own = tuple(map(_read_only, value))
        if all(a is b for a, b in zip(own, value, strict=True)):
            return value
        return own if type(value) is tuple else type(value)(*own)
    if type(value) is dict:
        return {key: _read_only(item) for key, item in value.items()}
    return value
