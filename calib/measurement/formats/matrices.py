"""Texts of placements as matrices, the rows of one below the other, or all sixteen numbers in a line.

    DataSet_1
    0.221  0.974  -0.050   138.27
    -0.956  0.227  0.185   116.85
    0.191  0.007  0.982  -1133.88
    0 0 0 1

The last row says what it is, and the other three are those of a rotation and a place.
"""

import re
from collections.abc import Sequence

import numpy as np

from calib.foundations import rigid
from calib.foundations.errors import MeasurementError
from calib.foundations.units import NUMBER
from calib.foundations.words import counted
from calib.measurement.cells import Rows, beginning, is_comment, lines
from calib.measurement.orientations import MATRIX

_BETWEEN = re.compile(r"[\s,;]+")
# What no other table begins with is looked for in its beginning alone.
_LOOKED_AT = 40
_WHOLE = 16
# Two digits of a rotation are enough to know it.
_TOLERANCE = 1e-2
TITLES = (*MATRIX[:3], "x", *MATRIX[3:6], "y", *MATRIX[6:], "z")


def from_matrices(data: bytes, where: str) -> Rows | None:
    """Return a row for each placement of a text, its twelve numbers by rows; None for a text of something else.

    Between matrices there may be lines of other things, of which the remarks say how many. Raises MeasurementError for
    a matrix that is torn, or no placement.
    """
    first = [line.text for line in beginning(data, where) if not is_comment(line.text)]
    if not any(_is_last(_numbers(line)) for line in first[:_LOOKED_AT]):
        return None
    rows = [(line.number, _numbers(line.text)) for block in lines(data, where) for line in block]
    found, passed = list[tuple[int, list[str]]](), 0
    for k, numbers in rows:
        is_open = bool(found) and len(found[-1][1]) < _WHOLE
        if len(numbers) == 4 and is_open:
            found[-1][1].extend(numbers)
        elif len(numbers) in (4, _WHOLE) and not is_open:
            found.append((k, list(numbers)))
        elif is_open:
            return None
        else:
            passed += 1
    # Sixteen numbers in a line below a header are a table like any other.
    if len(found[-1][1]) < _WHOLE or (passed and any(len(numbers) == _WHOLE for _, numbers in rows)):
        return None
    T = np.array([[float(number) for number in numbers] for _, numbers in found]).reshape(-1, 4, 4)
    good = rigid.are_placements(T, _TOLERANCE)
    if not good.any():
        return None
    if not good.all():
        raise MeasurementError(
            f"{where}:{found[int(np.argmin(good))][0]}: the matrix that begins here is no placement, as others are: "
            "three rows of a rotation and a place, and 0 0 0 1."
        )
    said = [counted(len(T), "matrix of a placement is a row", "matrices of placements are a row each")]
    said += [counted(passed, "other line is passed over", "other lines are passed over")] if passed else []
    return TITLES, [numbers[: len(TITLES)] for _, numbers in found], tuple(said)


def _numbers(line: str) -> Sequence[str]:
    """Return the numbers of a line of nothing else; none for another one."""
    words = [word for word in _BETWEEN.split(line) if word]
    return words if all(map(NUMBER.fullmatch, words)) else ()


def _is_last(numbers: Sequence[str]) -> bool:
    return len(numbers) in (4, _WHOLE) and [float(number) for number in numbers[-4:]] == [0.0, 0.0, 0.0, 1.0]
