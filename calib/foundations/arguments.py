"""What callers give to public functions, held against the annotations: of another kind, it is refused in a sentence.

Kinds alone, as a number or a list of texts; ranges, names and shapes are for whoever knows what they mean. Without it a
slip shows itself as a TypeError somewhere deep inside.
"""

import functools
import inspect
import sys
from collections import abc
from collections.abc import Callable, Iterable
from dataclasses import fields
from numbers import Integral, Real
from types import MappingProxyType, NoneType, UnionType
from typing import Any, Literal, ParamSpec, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np
import numpy.typing as npt

from calib.foundations.arrays import in_float64
from calib.foundations.errors import JobError
from calib.foundations.words import LONGEST_SHOWN, shortened, shown

_P = ParamSpec("_P")
_R = TypeVar("_R")

# By the letter of a numpy type: what of other types may stand for it.
_STANDS_FOR = {"f": "fiub", "i": "iu", "b": "b"}
_ELEMENTS = {"f": "numbers", "i": "whole numbers", "b": "bools"}
_PLAIN = MappingProxyType({str: "a text", bytes: "bytes", float: "a number", int: "a whole number", bool: "a bool"})
# Lists in lists that NumPy makes an array of.
_DEEPEST = 64
_Test = Callable[[Any], bool]
_IN_ORDER = (abc.Sequence, list)
_SEQUENCES = (*_IN_ORDER, abc.Collection, abc.Iterable)


def checked(function: Callable[_P, _R]) -> Callable[_P, _R]:
    """Make a function raise JobError for an argument that is not of the kind that its annotation says."""
    signature = inspect.signature(function)

    @functools.cache
    def hints() -> dict[str, Any]:
        try:  # when it is first called: names of classes that follow it are known then
            return get_type_hints(function)
        except NameError:  # of a module that type checkers alone load
            return {name: parameter.annotation for name, parameter in signature.parameters.items()}

    @functools.wraps(function)
    def call(*args: _P.args, **kwargs: _P.kwargs) -> _R:
        given = signature.bind(*args, **kwargs)
        for name, value in given.arguments.items():
            hint = hints().get(name, Any)
            if not _test(hint)(value):
                raise _other(value, hint, f"{function.__name__}: {name}")
            given.arguments[name] = _owner(hint)(value)
        return function(*given.args, **given.kwargs)

    return call


def own_fields(made: Any) -> None:
    """Make the fields of a frozen dataclass its own; raise JobError for one that is not of the kind of its annotation.

    Lists become tuples, arrays read-only copies, or tuples where no array is meant, and numbers of all kinds Python's
    own. Whoever made it may change theirs later, and what was asked of it before and after would not agree.
    """
    cls: Any = type(made)
    for name, hint, fits, takes_arrays in _fields(cls):
        value = getattr(made, name)
        if not fits(value):
            raise _other(value, hint, f"{cls.__name__}: {name}")
        if (own := _owned(_owner(hint)(value), takes_arrays)) is not value:
            object.__setattr__(made, name, own)


def _owned(value: Any, takes_arrays: bool) -> Any:
    if isinstance(value, dict | MappingProxyType):
        return {key: _owned(item, takes_arrays) for key, item in value.items()}
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, np.ndarray) and not takes_arrays:
        return _owned(value.tolist(), takes_arrays)
    if isinstance(value, set):
        return frozenset(value)
    if type(value) in (list, tuple):
        own = tuple(_owned(item, takes_arrays) for item in value)
        same = isinstance(value, tuple) and all(a is b for a, b in zip(own, value, strict=True))
        return value if same else own
    if isinstance(value, np.ndarray) and _may_change(value):
        value = value.copy()
        value.flags.writeable = False
    return value


def _may_change(array: npt.NDArray[Any]) -> bool:
    """Tell whether somebody can write to the numbers of an array, be it through what it is a view of."""
    viewed: object = array
    while isinstance(viewed, np.ndarray):
        if viewed.flags.writeable:
            return True
        viewed = viewed.base
    return False


@functools.cache
def _fields(of: Any) -> tuple[tuple[str, Any, _Test, bool], ...]:
    """Return name and hint of every field of a dataclass, what tells whether a value fits, and whether arrays do."""
    hints = get_type_hints(of)
    return tuple(
        (field.name, hints[field.name], _test(hints[field.name]), takes_arrays(hints[field.name]))
        for field in fields(of)
    )


def takes_arrays(hint: Any) -> bool:
    """Tell whether a value of the kind of a hint may be, or hold, an array."""
    if isinstance(hint, type) and issubclass(hint, tuple) and hasattr(hint, "_fields"):
        return any(map(takes_arrays, hint.__annotations__.values()))
    if hint in (Any, object) or _is_array_like(hint) or get_origin(hint) is np.ndarray:
        return True
    return any(map(takes_arrays, get_args(hint)))


def _other(value: object, hint: Any, where: str) -> JobError:
    return JobError(f"{where} is {told(value)}; needs {_joined(_needed(hint))}.")


# ---- does it fit?


@functools.cache
def _test(hint: Any) -> _Test:
    """Return what tells whether a value is of the kind of a hint: read once, since objects of a kind are many."""
    if hint in (Any, object, inspect.Parameter.empty):
        return _anything
    if _is_array_like(hint):
        none_too = NoneType in get_args(hint)
        return lambda value: _is_numbers(value) or (value is None and none_too)
    origin, inner = get_origin(hint), get_args(hint)
    if origin in (Union, UnionType):
        tests = tuple(map(_test, inner))
        return lambda value: any(test(value) for test in tests)
    if origin is Literal:  # which words are allowed, the function says
        types = tuple(map(type, inner))
        return lambda value: isinstance(value, types)
    if origin is not None:
        return _test_of_generic(origin, inner)
    if hint in (None, NoneType):
        return lambda value: value is None
    if hint is float:
        return lambda value: not isinstance(value, bool) and isinstance(value, Real) and _is_float(value)
    if hint is int:  # one that no float holds is no count of anything, and one of thousands of digits cannot be told
        return lambda value: not isinstance(value, bool) and isinstance(value, Integral) and _is_float(value)
    if hint is bool:
        return lambda value: isinstance(value, bool | np.bool_)
    return (lambda value: isinstance(value, hint)) if isinstance(hint, type) else _anything


def _anything(_value: Any) -> bool:
    return True


def _test_of_generic(origin: Any, inner: tuple[Any, ...]) -> _Test:
    if origin is np.ndarray:
        allowed = _STANDS_FOR[np.dtype(get_args(inner[1])[0]).kind]
        return lambda value: isinstance(value, np.ndarray) and not _is_odd(value) and value.dtype.kind in allowed
    if origin is abc.Callable:
        return callable
    if origin is abc.Mapping:
        key, item = map(_test, inner)
        return lambda value: isinstance(value, abc.Mapping) and all(key(k) and item(v) for k, v in value.items())
    if origin is tuple:
        # A list is as good.
        alike, tests = len(inner) == 2 and inner[1] is Ellipsis, tuple(map(_test, inner))

        def of_tuple(value: Any) -> bool:
            own = None if _is_set(value) else elements(value)
            if own is None or not (alike or len(own) == len(tests)):
                return False
            return all(test(one) for one, test in zip(own, tests[:1] * len(own) if alike else tests, strict=True))

        return of_tuple
    if origin in _SEQUENCES:
        of_one, in_order = _test(inner[0]), origin in _IN_ORDER

        def of_sequence(value: Any) -> bool:
            own = None if in_order and _is_set(value) else elements(value)
            return own is not None and all(map(of_one, own))

        return of_sequence
    return lambda value: isinstance(value, origin)


def elements(value: Any) -> list[Any] | None:
    """Return what is in a list or what serves as one; None of a text, a mapping, or what is no collection."""
    if isinstance(value, str | bytes | abc.Mapping) or not isinstance(value, abc.Collection):
        return None
    try:
        return list(value)
    except (TypeError, NotImplementedError):  # an array without dimensions, a view of memory with several
        return None


def _is_set(value: object) -> bool:
    """Tell whether a value has no order of its own: a set of texts has another one in every process."""
    return isinstance(value, set | frozenset)


def _is_array_like(hint: Any) -> bool:
    """Tell whether a hint is, or with None in it is, numpy's own for whatever makes an array."""
    own, inner = get_args(npt.ArrayLike), get_args(hint)
    return hint == npt.ArrayLike or (len(own) > 0 and all(one in inner for one in own))


def _is_numbers(value: Any) -> bool:
    try:
        odd = value is None or is_masked(value) or _in_lists(_has_named_columns, value)
        return not odd and np.asarray(value).dtype.kind in _STANDS_FOR["f"]
    except (TypeError, ValueError, RuntimeError):  # lists of several lengths; RuntimeError: tensors of others
        return False


def _is_odd(value: object) -> bool:
    """Tell whether an array counts or slices otherwise than others; a matrix keeps two dimensions in all it gives."""
    return is_masked(value) or isinstance(value, np.matrix)


def _has_named_columns(value: object) -> bool:
    """Tell whether a value is a table, as pandas's, with columns that have names.

    An array has no names: taken by place, columns in another order or in degrees would be the wrong numbers in silence.
    """
    return any(isinstance(label, str) for label in elements(getattr(value, "columns", None)) or ())


def is_masked(value: object) -> bool:
    """Tell whether an array, or one in a list of rows, says that some of its numbers are none; nobody would listen."""
    # Where nobody has loaded them, there are none: to load them takes a fifth of what all of NumPy does.
    return "numpy.ma" in sys.modules and _in_lists(lambda one: isinstance(one, np.ma.MaskedArray), value)


def _in_lists(test: _Test, value: object, depth: int = _DEEPEST) -> bool:
    """Tell whether a test holds of a value, or of one in its lists: what makes an array of all knows nothing of it."""
    if isinstance(value, list | tuple):
        return depth > 0 and any(_in_lists(test, one, depth - 1) for one in value if not isinstance(one, float | int))
    return bool(test(value))


def _is_float(value: Real) -> bool:
    """Tell whether a float can hold a number; infinity and NaN it can."""
    try:
        float(value)
    except (OverflowError, TypeError):  # a span of time, which NumPy counts among its whole numbers
        return False
    return True


# ---- which number it is


@functools.cache
def _owner(hint: Any) -> Callable[[Any], Any]:
    """Return what makes of a value that fits a hint the number, or the array of float64, that the hint names.

    Others run over (those of NumPy), are refused by NumPy's mathematics (fractions, half and long floats) or by files.
    """
    if hint is float:
        return float
    if hint is int:
        return int
    if hint is bool:
        return bool
    if hint in (str, Any, object, inspect.Parameter.empty):
        return _of_python
    if _is_array_like(hint):
        return lambda value: None if value is None else in_float64(np.asarray(value))
    origin, inner = get_origin(hint), get_args(hint)
    if origin in (Union, UnionType):
        ways = tuple((_test(one), _owner(one)) for one in inner)
        if all(own is _as_it_is for _fits, own in ways):
            return _as_it_is
        return lambda value: next(own for fits, own in ways if fits(value))(value)
    if origin is np.ndarray:
        return in_float64 if np.dtype(get_args(inner[1])[0]) == np.float64 else _as_it_is
    if origin is abc.Mapping:
        of_item = _owner(inner[1])
        if of_item in (_as_it_is, _of_python):  # whoever gave it may see it change
            return _as_it_is
        return lambda value: {key: of_item(item) for key, item in value.items()}
    if origin is tuple and inner[1:] != (Ellipsis,):
        each = tuple(map(_owner, inner))
        return lambda value: tuple(own(one) for own, one in zip(each, value, strict=True))
    if origin is tuple or origin in _SEQUENCES:
        of_one = _owner(inner[0])
        kept = (list, tuple) if of_one is _as_it_is else ()  # an array of none is neither true nor false
        return lambda value: value if type(value) in kept else tuple(map(of_one, value))
    return _as_it_is


def _as_it_is(value: Any) -> Any:
    return value


def _of_python(value: Any) -> Any:
    return value.item() if isinstance(value, np.generic) else value


# ---- words


def told(value: object) -> str:
    """Return what was given, in a few words of one line: its value where that is short, else its kind."""
    simple = bool, float, int, str, bytes, NoneType
    value = _of_python(value)
    if isinstance(value, str):
        return shown(value)
    plain = value if isinstance(value, list | tuple) else [value]
    if len(plain) <= LONGEST_SHOWN and all(isinstance(one, simple) for one in plain):
        try:
            text = repr(value)
        except ValueError:  # a whole number of thousands of digits
            text = ""
        if 0 < len(text) <= LONGEST_SHOWN:
            return text
    name = type(value).__name__
    if isinstance(value, int):
        return f"a whole number of {value.bit_length()} bits, too large"
    if isinstance(value, np.ndarray):
        kind = "a masked array" if is_masked(value) else "a matrix" if _is_odd(value) else "an array"
        return f"{kind} of {value.dtype}"
    if isinstance(value, list | tuple):
        kinds = "masked numbers" if is_masked(value) else ", ".join(dict.fromkeys(type(one).__name__ for one in value))
        return shortened(f"a {name} of {kinds}")
    return f"{_article(name)} {name}{', whose columns have names' if _has_named_columns(value) else ''}"


def _needed(hint: Any) -> list[str]:
    """Return the kinds that are allowed, in words, each once."""
    if _is_array_like(hint):
        return ["an array of numbers", *(["None"] if NoneType in get_args(hint) else [])]
    origin, inner = get_origin(hint), get_args(hint)
    if origin in (Union, UnionType):
        return list(dict.fromkeys(word for one in inner for word in _needed(one)))
    if origin is Literal:
        return [f'"{one}"' if isinstance(one, str) else repr(one) for one in inner]
    if origin is np.ndarray:
        return [f"an array of {_ELEMENTS[np.dtype(get_args(inner[1])[0]).kind]}"]
    if origin is abc.Mapping:
        return [f"a mapping of {_plural(_needed(inner[0])[0])} to {_joined(map(_plural, _needed(inner[1])))}"]
    if origin is tuple and inner[1:] != (Ellipsis,):
        return [f"{len(inner)} {_plural(_needed(inner[0])[0])}"]
    if origin is tuple or origin in _SEQUENCES:
        return [f"a list of {_joined(map(_plural, _needed(inner[0])))}"]
    if origin is abc.Callable:
        return ["a function"]
    if hint in (None, NoneType):
        return ["None"]
    if hint in (Any, object):
        return ["anything"]
    name = getattr(hint, "__name__", str(hint))
    return [_PLAIN.get(hint, f"{_article(name)} {name}")]


def _article(name: str) -> str:
    return "an" if name[0] in "AEIOUaeiou" else "a"


def _plural(words: str) -> str:
    """Return several of ``a number``: ``numbers``; what is no kind but a word of its own stays."""
    for article in ("a ", "an "):
        if words.startswith(article):
            own, of, rest = words.removeprefix(article).partition(" of ")
            return f"{own}{'' if own.endswith('s') else 's'}{of}{rest}"
    return words


def _joined(words: Iterable[str]) -> str:
    """Return alternatives in a row; a comma parts them where one has alternatives of its own."""
    *others, last = words
    if any(" or " in word for word in (*others, last)):
        return ", or ".join((*others, last))
    return f"{', '.join(others)} or {last}" if others else last
