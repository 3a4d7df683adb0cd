"""Array types, and arrays that nobody changes behind your back."""

from collections.abc import Hashable, Iterable
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.intp]
BoolArray = npt.NDArray[np.bool_]

Word = TypeVar("Word", bound=Hashable)


def read_only(values: npt.ArrayLike) -> Array:
    """Return a read-only float64 copy of ``values``."""
    copy = np.array(values, dtype=np.float64)
    copy.flags.writeable = False
    return copy


def in_float64(values: npt.NDArray[Any]) -> Array:
    """Return numbers as float64; a longer float beyond its range becomes infinite without a warning."""
    with np.errstate(over="ignore"):
        return values.astype(np.float64, copy=False)


def read_only_view(values: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return a view of ``values`` that cannot be written through."""
    view = values.view()
    view.flags.writeable = False
    return view


def as_slice(those: IntArray) -> slice | IntArray:
    """Return numbers, ascending, as a slice where none is left out: what it takes is read and written faster."""
    if not len(those):
        return slice(0)
    first, end = int(those[0]), int(those[-1]) + 1
    return slice(first, end) if end - first == len(those) else those


def evenly(count: int, most: int) -> slice:
    """Return the slice that takes no more than ``most`` of ``count`` things: the first one, and evenly those behind."""
    return slice(None, None, max(1, -(-count // most)))


def evenly_spread(count: int, most: int) -> IntArray:
    """Return which of ``count`` things to take: all, or ``most`` spread evenly, the first and the last among them."""
    return np.linspace(0, count - 1, min(count, most)).astype(np.intp)


def evenly_in_runs(count: int, most: int, run: int) -> IntArray:
    """Return which of ``count`` things to take: all, or of more than ``most`` runs of neighbours, spread evenly."""
    if count <= most:
        return np.arange(count)
    starts = np.linspace(0, count - run, most // run).astype(np.intp)
    return np.unique(starts[:, None] + np.arange(run))


def evenly_ranked(values: Array, most: int) -> IntArray:
    """Return which of the values (N,) to take: all, or ``most`` spread evenly over their ranks, the largest among them.

    They are in the order of the values.
    """
    if len(values) <= most:
        return np.arange(len(values))
    return np.sort(np.argsort(values)[np.linspace(0, len(values) - 1, most).round().astype(np.intp)])


def number_in_kind(*kinds: IntArray) -> IntArray:
    """Return the number (N,) of every row among those before it that are alike in all ``kinds`` (N,) each."""
    order = np.lexsort(kinds)
    first = np.concatenate([[True], np.any([np.diff(kind[order]) != 0 for kind in kinds], axis=0)])[: len(order)]
    number = np.arange(len(order))
    found = np.empty_like(number)
    found[order] = number - np.maximum.accumulate(np.where(first, number, 0))
    return found


def rows_by_word(words: Iterable[Word]) -> dict[Word, IntArray]:
    """Return the rows of every word, words in the order of their first row."""
    found: dict[Word, list[int]] = {}
    for n, word in enumerate(words):
        found.setdefault(word, []).append(n)
    return {word: np.array(rows, dtype=np.intp) for word, rows in found.items()}
