"""How results show themselves in a line or a few: shapes in the place of arrays, counts in the place of long lists."""

from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass

import numpy as np

# Longest text of one value, and of all.
_ONE, _ALL = 60, 1200
_LISTED = 4


def brief(thing: object) -> str:
    """Return ``<Name field=value, ...>`` of a dataclass, on less than a screen: its ``__repr__``."""
    names = [field.name for field in fields(thing) if field.repr] if is_dataclass(thing) else []
    shown = [f"{name}={_shown(getattr(thing, name))}" for name in names]
    text = f"<{type(thing).__name__} {', '.join(shown)}>"
    return text if len(text) <= _ALL else text[: _ALL - 4] + "...>"


def _shown(value: object) -> str:
    if isinstance(value, np.ndarray):
        return f"array{value.shape}"
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, bytes):
        return f"{len(value)} bytes"
    if isinstance(value, str):
        return repr(value if len(value) <= _ONE else value[:_ONE] + "...")
    if isinstance(value, Mapping):
        return _several(list(map(str, value)), "{", "}")
    if isinstance(value, tuple | list):
        return _several([_shown(one) for one in value[: _LISTED + 1]], "(", ")", len(value))
    text = repr(value)
    return text if len(text) <= _ONE else f"<{type(value).__name__}>"


def _several(texts: Sequence[str], begin: str, end: str, count: int | None = None) -> str:
    number = len(texts) if count is None else count
    joined = begin + ", ".join(texts) + end
    return joined if number <= _LISTED and len(joined) <= _ONE else f"{number} of them"
