"""Texts that are no tables, though the numbers that are wanted are in them: what they are, and what to do.

Nothing is read here. A text that cannot be read as a table is looked at once more, so that what can be is not touched.
"""

import re
from collections.abc import Sequence

from calib.foundations.errors import MeasurementError
from calib.measurement.cells import Line, beginning

_BETWEEN = re.compile(r"[\s,;|=]+")
_NUMBER = re.compile(r"[+-]?[0-9]+(?:[.,][0-9]+)?")
# The letter of a coordinate is the first word of its line, or stands behind the name of its point.
_NAME = 4
_POINTS = 2
_LOOKED_AT = 200


def of_report(data: bytes, where: str, refused: MeasurementError) -> MeasurementError:
    """Return what to raise for a text that was refused as a table: what it is, where that is known.

    A job of Yaskawa, and what may be a report with a line for each coordinate of a point, as of PC-DMIS and PolyWorks:
    a table may have a row for each as well, one of which is wrong.
    """
    try:
        first = beginning(data, where)[:_LOOKED_AT]
    except MeasurementError:
        return refused
    if first and first[0].text.strip() == "/JOB":
        return MeasurementError(f"{where}: is a job of Yaskawa{_of_job(first)}.")
    if (line := _by_coordinates(first)) is None:
        return refused
    return MeasurementError(
        f"{str(refused).removesuffix('.')}; if this is a report with a line for each coordinate of a point, as of "
        f"PC-DMIS and PolyWorks (from line {line} on), export the points there as a table, in which each has one row "
        "with its measured X, Y and Z."
    )


def _of_job(first: Sequence[Line]) -> str:
    kind = next((line.text.split()[-1] for line in first if line.text.startswith("///POSTYPE ")), "")
    if kind == "PULSE":
        return (
            ", whose positions are pulses of the motors; divide those of each axis by its pulses per degree, and write "
            "the angles into a table, a row for each position"
        )
    if kind == "ANGLE":
        return "; write the numbers of its positions into a table, a row for each"
    return (
        ", whose positions are places of the tool, and no joints; write the joints of each position into a table, as "
        "the pendant shows them"
    )


def _by_coordinates(first: Sequence[Line]) -> int | None:
    """Return the line of the first X of a report whose lines are of X, Y and Z in turn, two points or more."""
    found = [(line.number, letter) for line in first if (letter := _coordinate(line.text))]
    letters = "".join(letter for _, letter in found)
    at = letters.find("XYZ" * _POINTS)
    return None if at < 0 else found[at][0]


def _coordinate(line: str) -> str:
    """Return which coordinate a line is of: X, Y or Z with numbers behind it; nothing where it is of none, or several.

    >>> _coordinate("X 12.010  12.000 0.010"), _coordinate("point 1, Y, 3.2, 3.1"), _coordinate("X Y Z 1 2")
    ('X', 'Y', '')
    """
    words = [word for word in _BETWEEN.split(line.strip()) if word]
    letters = [k for k, word in enumerate(words) if word in ("X", "Y", "Z")]
    if len(letters) != 1 or letters[0] >= _NAME:
        return ""
    behind = words[letters[0] + 1 :]
    return words[letters[0]] if any(map(_NUMBER.fullmatch, behind)) else ""
