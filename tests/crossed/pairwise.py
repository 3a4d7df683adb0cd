"""Few rows in which every two features stand together at least once."""

from collections.abc import Callable, Sequence
from itertools import combinations

Row = tuple[int, ...]
Pair = tuple[int, int, int, int]  # axis, level, axis, level


def pairs_of(row: Row) -> set[Pair]:
    """All pairs of levels in a row, one for every axis."""
    return {(i, row[i], j, row[j]) for i, j in combinations(range(len(row)), 2)}


def covering(sizes: Sequence[int], allowed: Callable[[int, int, int, int], bool]) -> list[Row]:
    """Rows of one level for every axis that hold every allowed pair, and none that is not; always the same ones.

    Greedy: a row starts from the first pair that is missing, and every axis takes the level that adds most pairs. A
    pair that fits into no row, as all levels of a third axis are refused beside one of both, is left out.
    """
    axes = range(len(sizes))
    wanted = {
        (i, a, j, b)
        for i, j in combinations(axes, 2)
        for a in range(sizes[i])
        for b in range(sizes[j])
        if allowed(i, a, j, b)
    }
    rows: list[Row] = []
    missing = dict.fromkeys(sorted(wanted, key=lambda p: (-sizes[p[0]] * sizes[p[2]], p)))
    while missing:
        i, a, j, b = next(iter(missing))
        row = _completed({i: a, j: b}, sizes, allowed, missing)
        if row is None:
            missing.pop((i, a, j, b))
            continue
        rows.append(row)
        for pair in pairs_of(row):
            missing.pop(pair, None)
    return rows


def _completed(
    fixed: dict[int, int],
    sizes: Sequence[int],
    allowed: Callable[[int, int, int, int], bool],
    missing: dict[Pair, None],
) -> Row | None:
    """The fixed levels with one for every other axis: depth first, levels that add most pairs before others."""
    if len(fixed) == len(sizes):
        return tuple(fixed[i] for i in range(len(sizes)))

    def fits(axis: int, level: int, chosen: dict[int, int]) -> bool:
        return all(allowed(*_ordered(axis, level, other, own)) for other, own in chosen.items())

    def gain(axis: int, level: int) -> int:
        return sum(_ordered(axis, level, other, own) in missing for other, own in fixed.items())

    open_ = [axis for axis in range(len(sizes)) if axis not in fixed]
    choices = {axis: [level for level in range(sizes[axis]) if fits(axis, level, fixed)] for axis in open_}
    # The axis with the fewest levels left first: dead ends show early.
    axis = min(open_, key=lambda k: (len(choices[k]), k))
    for level in sorted(choices[axis], key=lambda level: (-gain(axis, level), level)):
        found = _completed({**fixed, axis: level}, sizes, allowed, missing)
        if found is not None:
            return found
    return None


def _ordered(i: int, a: int, j: int, b: int) -> Pair:
    return (i, a, j, b) if i < j else (j, b, i, a)
