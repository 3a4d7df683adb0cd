"""Several points in a row that belong to one body: reflectors on a flange, markers on a tool.

Their distances are the same in all rows while the body turns. Nothing else in a row does that: a commanded point beside
the measured one, or one point in two frames, comes nearer and goes away.
"""

import itertools
from collections.abc import Iterable, Sequence

import numpy as np

from calib.foundations.arrays import Array
from calib.foundations.errors import MeasurementError
from calib.foundations.words import counted, listed
from calib.measurement.formats.sheet import Sheet, most_values
from calib.measurement.raw import RawTable, raw_table
from calib.measurement.roles import numbers_of, points_among, roles

Triple = tuple[int, int, int]

# Of how far one point moves about another, their distance changes no more than this share in nearly all rows.
_SAME, _NEARLY_ALL = 0.02, 90.0
# About a body that hardly turns nothing is told: the other point moves as a whole.
_TURNS = 0.1
# In fewer rows distances are the same by chance; of more points no table has been seen.
_FEWEST_ROWS, _MOST_POINTS = 6, 200


def points_of_one_body(table: RawTable) -> tuple[Triple, ...]:
    """Return the columns of the points, two or more, that keep their distances; none where no points do."""
    numeric = [k for k, column in enumerate(table.columns) if column.numbers is not None]
    every = roles(table).points if table.named else [point for point, _ in points_among(numeric)]
    found = list(dict.fromkeys(point.columns for point in every))[:_MOST_POINTS]
    places = [numbers_of(table, columns) for columns in found]
    beside: dict[Triple, list[Triple]] = {columns: [columns] for columns in found}
    for (a, p), (b, q) in itertools.combinations(zip(found, places, strict=True), 2):
        if not set(a) & set(b) and _keep_their_distance(p, q):
            beside[a].append(b)
            beside[b].append(a)
    most = max(beside.values(), key=len, default=[])
    of_one = all(b in beside[a] for a, b in itertools.combinations(most, 2))
    return tuple(sorted(most)) if len(most) > 1 and of_one else ()


def _keep_their_distance(p: Array, q: Array) -> bool:
    """Return whether points (N, 3) of a body that turns are as far apart in all rows."""
    way = 0.5 * q - 0.5 * p  # halves, so that no number is too large for their difference
    way = way[np.isfinite(way).all(axis=1)]
    if len(way) < _FEWEST_ROWS:
        return False
    way = way / (np.abs(way).max() or 1.0)
    far = np.linalg.norm(way, axis=1)
    turned = float(np.sqrt(np.mean(np.sum((way - way.mean(axis=0)) ** 2, axis=1))))
    off = float(np.percentile(np.abs(far - np.median(far)), _NEARLY_ALL))
    return turned > _TURNS * float(np.median(far)) and off < _SAME * turned


def a_row_for_each_point(sheet: Sheet) -> Sheet:
    """Return a sheet with a row for every point of a row: ``measured_x`` to ``measured_z``, and as ``tool`` its name.

    Rows in which a point has an empty cell have none of it. Raises MeasurementError where no points keep their
    distances.
    """
    table = raw_table(sheet.csv().encode(), sheet.where)
    points = points_of_one_body(table)
    if not points:
        raise MeasurementError(
            f"{sheet.where}: has no two points that keep their distance while they turn, as points of one body do; "
            f"the columns are {listed(sheet.titles)}."
        )
    names = _names([[table.columns[k].name for k in columns] for columns in points])
    symbols = {table.columns[k].symbol for columns in points for k in columns}
    if len(symbols) > 1:
        said = listed([table.columns[k].title for columns in points for k in columns])
        raise MeasurementError(f"{sheet.where}: {said} are points of one body in several units; give them one.")
    symbol = symbols.pop()
    unit = "" if symbol is None else f" [{symbol}]"
    taken = {k for columns in points for k in columns}
    rest = [k for k in range(len(sheet.titles)) if k not in taken]
    titles = [sheet.titles[k] if table.named else f"column {i + 1}" for i, k in enumerate(rest)]
    ours = [*(f"measured_{axis}{unit}" for axis in "xyz"), "tool"]
    if both := {title.split("[")[0].strip() for title in titles} & {title.split("[")[0].strip() for title in ours}:
        raise MeasurementError(f"{sheet.where}: has a column {min(both)!r} already; call it otherwise.")
    if (count := len(sheet.rows) * len(points) * (len(rest) + len(ours))) > most_values(sheet.size):
        raise MeasurementError(
            f"{sheet.where}: with a row for each of {len(points)} points it has {count} values; allowed are "
            f"{most_values(sheet.size)}; leave out columns that are not needed."
        )
    rows = [
        (*(row[k] for k in rest), *(row[k] for k in columns), name)
        for row in sheet.rows
        for columns, name in zip(points, names, strict=True)
        if all(row[k] for k in columns)
    ]
    remarks = [f"{listed(names)} keep their distances: points of one body, with a row each; 'tool' has their names"]
    if lost := len(points) * len(sheet.rows) - len(rows):
        empty = counted(lost, "point has an empty cell and is left out", "points have empty cells and are left out")
        remarks.append(empty)
    return Sheet((*titles, *ours), tuple(rows), sheet.where, (*sheet.remarks, *remarks), sheet.of_part, sheet.size)


def _names(of: Iterable[Sequence[str]]) -> list[str]:
    """Return what points are called: what the names of their columns have in common, or else their numbers."""
    names = [_common(columns) for columns in of]
    apart = len(set(names)) == len(names) and all(any(letter.isalpha() for letter in name) for name in names)
    return names if apart else [f"point {k + 1}" for k in range(len(names))]


def _common(columns: Sequence[str]) -> str:
    """Return the letters that names have alike at the same places: all but x, y and z."""
    return "".join(letters[0] for letters in zip(*columns, strict=False) if len(set(letters)) == 1).strip(" _-.()[]")
