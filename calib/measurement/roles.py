"""What the columns of somebody else's table may be, by their names alone: joints, points, orientations, words.

Nothing is decided here: candidates are listed, and what the arm follows decides (:mod:`calib.job.propose`).
"""

import itertools
import re
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple
from unicodedata import normalize

import numpy as np

from calib.foundations import rigid
from calib.foundations.arrays import Array
from calib.measurement.raw import RawTable

_TOKEN = re.compile(r"[^\W\d_]+|\d+")


def _words(text: str) -> frozenset[str]:
    return frozenset(text.split())


_MEASURED = _words("measured measurement measure meas actual act real feedback fbk tracker leica faro cmm")
_COMMANDED = _words(
    "goal target cmd command commanded desired des setpoint set ref reference nominal theoretical planned model ctrl "
    "action"
)
# Numbers of a joint, or along an axis, that are no position.
_NO_POSITION = _words(
    "velocity vel speed v qd dq torque tau effort current i acc acceleration force f temp temperature std sigma unc "
    "uncertainty u dev deviation error err normal n delta d tilt var variance gyro accel"
)
# What columns of torques are called.
TORQUES = _words("tau torque torques effort")
# What columns of standard deviations are called.
SPREADS = _words("std stdev stddev sigma sd")
# What as many numbers of an orientation are.
_SIZES: dict[int, Literal["angles", "quaternion", "matrix"]] = {3: "angles", 4: "quaternion", 9: "matrix"}
_TURNS = _words("r rot rotation phi theta euler ang angle angles orientation ori orn rv rvec rotvec w o")
_PLACES = _words("p pos position t trans translation")
_QUATERNION = frozenset(("q", "quat", "quaternion"))
_POSE = frozenset(("pose", "tcp", "cartesian", "cart"))
# Of three or four numbers in a list, what is called so is a vector; what is called as joints are is none.
_VECTORS = (
    _PLACES | _MEASURED | _words("tvec xyz point coord coords coordinate coordinates location ee eef tcp tip marker")
)
_VECTORS_OF_TURNS = _TURNS - _words("r w o")
_OF_JOINTS = _words("joint joints j q axis axes angle angles theta thetas motor servo encoder a")
# A target that is named beside these is what they see.
_SEES = _words("cam camera sensor eye optical")
# Titles of what is neither a joint nor measured: never joints by their place alone.
_BESIDE = _words(
    "time t timestamp stamp sec secs nsec date no nr id idx index number row seq count point temperature temp "
    "humidity pressure rms image user tool ecokey"
)
_LETTERS: tuple[tuple[tuple[str, str, str], str | None], ...] = (
    (("a", "b", "c"), "abc"),
    (("w", "p", "r"), "wpr"),
    (("o", "a", "t"), "ZYZ"),
    (("roll", "pitch", "yaw"), "rpy"),
    (("alpha", "beta", "gamma"), None),
    (("phi", "theta", "psi"), None),
)
_TARGETS = frozenset(("target", "socket", "hole", "anchor", "ball", "sphere"))
_LENGTHS = frozenset(("length", "distance", "dist", "range"))
_NAME_OF, _POSITION_OF = (
    re.compile(rf"(?i)(|.*[^a-z]){word}s?([^a-z]*[0-9]+[^a-z0-9]*)") for word in ("name", "position")
)
_CELL = re.compile(r"(.*?)\[?([0-4])[,_ ]?([0-4])\]?")

Rank = Literal[0, 1, 2]  # said to be measured; nothing said; said to be commanded


class Orientation(NamedTuple):
    """Columns that may be one: ``form`` and, where the names say it, the convention; of quaternions w is the first."""

    columns: tuple[int, ...]
    form: Literal["angles", "quaternion", "matrix"]
    convention: str | None
    words: frozenset[str]


class Point(NamedTuple):
    """Columns of x, y, z."""

    columns: tuple[int, int, int]
    words: frozenset[str]
    rank: Rank


class Joints(NamedTuple):
    """Columns of the joints in the order of an arm, and why they may be these."""

    columns: tuple[int, ...]
    rank: Rank
    why: str
    exact: bool


@dataclass(frozen=True, slots=True)
class Roles:
    """What columns may be beside joints. ``spoken``: all columns of these, and those that are surely none."""

    points: tuple[Point, ...]
    orientations: tuple[Orientation, ...]
    targets: tuple[int, ...]
    lengths: tuple[int, ...]
    pixels: tuple[int, int] | None
    spoken: frozenset[int]


def tokens(name: str) -> tuple[str, ...]:
    """Return the parts of a name: ``joint_1_position`` has joint, 1 and position."""
    return tuple(token.lower() for token in _as_written(name))


def _as_written(name: str) -> list[str]:
    """Return the parts with their capitals; accents that are characters of their own (NFD) belong to their letters."""
    return _TOKEN.findall(normalize("NFC", name))


def _rank(words: Iterable[str]) -> Rank:
    words = set(words)
    commanded = _COMMANDED - {"target"} if words & _SEES else _COMMANDED
    return 2 if words & commanded else 0 if words & _MEASURED else 1


def roles(table: RawTable) -> Roles:
    """Return what the names say of the columns of a table with a header."""
    parts = [tokens(column.name) for column in table.columns]
    numeric = [k for k, column in enumerate(table.columns) if column.numbers is not None]
    points: list[Point] = []
    orientations: list[Orientation] = []
    spoken = {k for k in range(len(parts)) if k not in numeric}
    for key, found in _by_axis([column.name for column in table.columns], numeric):
        words = frozenset(itertools.chain(key.before, key.behind, [key.stem] if key.stem else []))
        columns = (found["x"], found["y"], found["z"])
        spoken.update(found.values())
        kind = _kind_of_axes(key.stem, words)
        if kind == "point" and "w" in found and not _is_of_unit_length(table, [*columns, found["w"]]):
            spoken.discard(found.pop("w"))
        if kind == "quaternion" or (kind != "other" and "w" in found):
            if "w" in found:
                orientations.append(Orientation((found["w"], *columns), "quaternion", None, words))
        elif kind == "turns":
            vector = "rotation_vector" if words & {"rvec", "rotvec", "rv"} else None
            orientations.append(Orientation(columns, "angles", vector, words))
        elif kind == "point":
            points.append(Point(columns, words, _rank(words)))
    orientations += _by_letters(parts, numeric)
    for family in _families(parts, numeric):
        if family.is_pose and len(family.columns) in (6, 7) and not family.words & _NO_POSITION:
            first, rest = family.columns[:3], family.columns[3:]
            points.append(Point((first[0], first[1], first[2]), family.words, _rank(family.words)))
            form: Literal["angles", "quaternion"] = "angles" if len(rest) == 3 else "quaternion"
            orientations.append(Orientation(rest, form, None, family.words))
        elif len(family.columns) == 4 and family.words and family.words <= _QUATERNION:
            orientations.append(Orientation(family.columns, "quaternion", None, family.words))
        elif isinstance(of_list := _vector(table, family), Point):
            points.append(of_list)
        elif of_list is not None:
            orientations.append(of_list)
    for matrix, point in (
        *matrices([column.name for column in table.columns], numeric),
        *_flat_matrices(table, _families(parts, numeric)),
    ):
        orientations.append(matrix)
        if point is not None:
            points.append(point)
    # A matrix with a fourth column has its point; what else looks like one is not sought among its cells.
    spoken.update(k for point in points for k in point.columns)
    spoken.update(k for orientation in orientations for k in orientation.columns)
    # Joined to joints, a file of points without a header: columns that have numbers for names.
    nameless = [k for k in numeric if len(parts[k]) == 2 and parts[k][0] == "column" and parts[k][1].isdigit()]
    for point, turned in points_among(nameless) if not points else ():
        word = frozenset((f"column {point.columns[0]}",))
        points.append(point._replace(words=word))
        orientations += [one._replace(words=word) for one in turned]
    if len(nameless) == 3:
        spoken.update(nameless)
    single = {p[0]: k for k, p in enumerate(parts) if len(p) == 1}
    pixels = (single["u"], single["v"]) if {"u", "v"} <= single.keys() else None
    spoken.update(pixels or ())
    spoken |= {k for k, part in enumerate(parts) if set(part) & (_NO_POSITION | _BESIDE)}
    lengths = tuple(k for k in numeric if set(parts[k]) & _LENGTHS and not set(parts[k]) & _NO_POSITION)
    targets = tuple(k for k in range(len(parts)) if set(parts[k]) & _TARGETS and k not in spoken - set(_texts(table)))
    return Roles(tuple(points), tuple(orientations), targets, lengths, pixels, frozenset(spoken | set(lengths)))


def would_be_points(table: RawTable) -> list[int]:
    """Return the columns that have names of a point, and cells that are no numbers."""
    every = _by_axis([column.name for column in table.columns], range(len(table.columns)))
    points = [
        found
        for key, found in every
        if _kind_of_axes(key.stem, frozenset((*key.before, *key.behind, *filter(None, [key.stem])))) == "point"
    ]
    return sorted({k for found in points for k in found.values() if table.columns[k].numbers is None})


def would_be_joints(table: RawTable, counts: Collection[int]) -> list[int]:
    """Return the columns that differ by a number, as many as one of ``counts``, whatever their cells hold."""
    parts = [tokens(column.name) for column in table.columns]
    families = _families(parts, range(len(parts))) if table.named else ()
    joints = [f for f in families if len(f.columns) in counts and not (f.words & _NO_POSITION or f.is_pose)]
    return sorted({k for family in joints for k in family.columns})


def _is_of_unit_length(table: RawTable, columns: Sequence[int]) -> bool:
    numbers = [table.columns[k].numbers for k in columns]
    size = np.sqrt(sum(np.square(np.clip(values, -2.0, 2.0)) for values in numbers if values is not None))
    return bool(np.nanmax(np.abs(size - 1.0), initial=0.0) < 1e-2)


def numbers_of(table: RawTable, columns: Sequence[int]) -> Array:
    """Return columns of numbers (N, k), nan where a cell is empty."""
    found = [table.columns[k].numbers for k in columns]
    return np.column_stack([values for values in found if values is not None])


def _turns(table: RawTable, nine: Sequence[int]) -> bool:
    """Return whether nine columns are rotations by rows."""
    R = numbers_of(table, nine).reshape(-1, 3, 3)
    R = R[np.isfinite(R).all(axis=(1, 2))]
    return bool(len(R) and rigid.are_orthogonal(R, 1e-2).all())


def _texts(table: RawTable) -> list[int]:
    return [k for k, column in enumerate(table.columns) if column.numbers is None]


class _Axis(NamedTuple):
    before: tuple[str, ...]
    stem: str
    behind: tuple[str, ...]


def _by_axis(names: Sequence[str], numeric: Iterable[int]) -> Iterator[tuple[_Axis, dict[str, int]]]:
    """Yield columns whose names differ by an x, y, z, and perhaps a w, at the end of a part or at its beginning.

    Capitals and small letters are columns of their own where either are whole: a gantry's joints X, Y, Z stand beside
    the measured x, y, z.
    """
    found: dict[_Axis, tuple[dict[str, int], ...]] = {}
    for k in numeric:
        written = _as_written(names[k])
        parts = tokens(names[k])
        for i, part in enumerate(parts):
            for letter, stem, own in {(part[-1], part[:-1], written[i][-1]), (part[0], part[1:], written[i][0])}:
                if letter in "xyzw":
                    # Mx is a moment, and Xm a point.
                    behind_m = stem == "m" and part[0] == letter
                    key = _Axis(parts[:i], "" if behind_m else stem, (*("m" * behind_m), *parts[i + 1 :]))
                    both, *cases = found.setdefault(key, ({}, {}, {}))
                    both.setdefault(letter, k)
                    cases[own.isupper()].setdefault(letter, k)
    for key, (both, *cases) in found.items():
        whole = [one for one in cases if {"x", "y", "z"} <= one.keys()]
        for one in whole or [both]:
            if {"x", "y", "z"} <= one.keys():
                yield key, {**{letter: k for letter, k in both.items() if letter == "w"}, **one}


def _kind_of_axes(stem: str, words: frozenset[str]) -> Literal["point", "turns", "quaternion", "other"]:
    if words & _QUATERNION:
        return "quaternion"
    if stem in _NO_POSITION or words & _NO_POSITION:
        return "other"
    if words & _TURNS and stem not in _PLACES:  # px_r stands beside rx_r
        return "turns"
    return "other" if stem == "m" and not words & {"coord", "coordinate"} else "point"


def _by_letters(parts: Sequence[Sequence[str]], numeric: Sequence[int]) -> Iterator[Orientation]:
    """Yield three angles that are called by their makers' letters, in the order of the file."""
    for letters, convention in _LETTERS:
        found: dict[tuple[str, ...], dict[str, int]] = {}
        for k in numeric:
            for i, part in enumerate(parts[k]):
                if part in letters:
                    rest = (*parts[k][:i], *parts[k][i + 1 :])
                    if not any(word.isdigit() for word in rest):
                        found.setdefault(rest, {}).setdefault(part, k)
        for rest, of in found.items():
            if len(of) == 3:
                columns = tuple(sorted(of.values()))
                in_order = columns == tuple(of[letter] for letter in letters)
                yield Orientation(columns, "angles", convention if in_order else None, frozenset(rest))


def _vector(table: RawTable, family: "Family") -> Point | Orientation | None:
    """Return the point, or the orientation, that a list of three or four numbers is by its name; None for others."""
    columns, words = family.columns, family.words
    if len(columns) not in (3, 4) or words & (_NO_POSITION | _OF_JOINTS - _VECTORS_OF_TURNS):
        return None
    if len(columns) == 4:
        turns = words & (_VECTORS_OF_TURNS | _QUATERNION - {"q"}) and _is_of_unit_length(table, columns)
        return Orientation(columns, "quaternion", None, words) if turns else None
    if words & _VECTORS_OF_TURNS:
        vector = "rotation_vector" if words & {"rvec", "rotvec", "rv"} else None
        return Orientation(columns, "angles", vector, words)
    return Point((columns[0], columns[1], columns[2]), words, _rank(words)) if words & _VECTORS else None


class Family(NamedTuple):
    """Columns that differ by a number, in its order, which runs without gaps from 0 or 1."""

    columns: tuple[int, ...]
    words: frozenset[str]
    called: str

    @property
    def is_pose(self) -> bool:
        """Whether it is called a pose; one of the joints is their readings."""
        return bool(self.words & _POSE) and not self.words & {"joint", "joints"}


def _families(parts: Sequence[Sequence[str]], numeric: Iterable[int]) -> Iterator[Family]:
    found: dict[tuple[tuple[str, ...], tuple[str, ...]], dict[int, int]] = {}
    for k in numeric:
        for i, part in enumerate(parts[k]):
            if part.isdecimal() and len(part) <= 3:  # a superscript is a digit, and no number
                found.setdefault((tuple(parts[k][:i]), tuple(parts[k][i + 1 :])), {}).setdefault(int(part), k)
    for (before, behind), of in found.items():
        numbers = sorted(of)
        if len(numbers) > 1 and numbers[0] in (0, 1) and numbers == list(range(numbers[0], numbers[0] + len(numbers))):
            yield Family(
                tuple(of[n] for n in numbers), frozenset((*before, *behind)), "_".join((*before, "N", *behind))
            )


def matrices(names: Sequence[str], numeric: Iterable[int]) -> Iterator[tuple[Orientation, Point | None]]:
    """Yield the nine numbers of rotations, and the point of a fourth column, from names like r11 or T[0,3]."""
    found: dict[str, dict[tuple[int, int], int]] = {}
    for k in numeric:
        match = _CELL.fullmatch(names[k].strip())
        if match is not None:
            found.setdefault(match[1].lower().strip(" _"), {})[int(match[2]), int(match[3])] = k
    for called, of in found.items():
        for first in (0, 1):
            rows = range(first, first + 3)
            if all((i, j) in of for i in rows for j in rows):
                words = frozenset(tokens(called)) - {"r", "t", "m", "rot"}
                nine = Orientation(tuple(of[i, j] for i in rows for j in rows), "matrix", "matrix", words)
                last = [of.get((i, first + 3)) for i in rows]
                point = None
                if None not in last:
                    x, y, z = (k for k in last if k is not None)
                    point = Point((x, y, z), words, _rank(words))
                yield nine, point
                break


def _flat_matrices(table: RawTable, families: Iterable[Family]) -> Iterator[tuple[Orientation, Point]]:
    """Yield rotation and point of placements in a list, of 12 or 16 numbers, by rows or by columns: numbers tell which.

    Sixteen have a last row of 0 0 0 1.
    """
    for family in families:
        if len(family.columns) not in (12, 16):
            continue
        numbers = numbers_of(table, family.columns)
        T = numbers[np.isfinite(numbers).all(axis=1)].reshape(-1, len(family.columns) // 4, 4)
        order = np.arange(len(family.columns)).reshape(-1, 4)
        for M, cells in ((T, order), (np.swapaxes(T, 1, 2), order.T)) if T.shape[1] == 4 else ((T, order),):
            is_whole = M.shape[1] < 4 or bool((M[:, 3] == (0.0, 0.0, 0.0, 1.0)).all())
            if len(M) and is_whole and rigid.are_rotations(M[:, :3, :3], 1e-2).all():
                x, y, z = (family.columns[k] for k in cells[:3, 3].tolist())
                nine = tuple(family.columns[k] for k in cells[:3, :3].ravel().tolist())
                yield (
                    Orientation(nine, "matrix", "matrix", family.words),
                    Point((x, y, z), family.words, _rank(family.words)),
                )
                break


def joints_by_name(table: RawTable, readings: Sequence[str], among: frozenset[int]) -> list[Joints]:
    """Return the columns that have the names of readings, with words around them that are the same for all.

    Where none have, those for which other columns state these names. ``among``: the columns that may be joints.
    """
    # A column that is called just as a reading goes before one that only capitals tell apart.
    in_order = sorted(among, key=lambda k: (table.columns[k].name not in readings, k))
    parts = {k: tokens(table.columns[k].name) for k in in_order}
    for short in (False, True):
        wanted = [_core(tokens(name)) if short else tokens(name) for name in readings]
        if len(set(wanted)) < len(wanted):
            continue
        number = {want: j for j, want in enumerate(wanted)}
        lengths = sorted(set(map(len, wanted)))
        found: dict[tuple[str, ...], dict[int, int]] = {}
        for k, part in parts.items():
            own = _core(part) if short else part
            runs = (own[i : i + n] for n in lengths for i in range(len(own) - n + 1))
            for j in sorted({number[run] for run in runs if run in number}):
                rest = _without(own, wanted[j])
                if rest is not None and not set(rest) & _NO_POSITION and not any(w.isdigit() for w in rest):
                    found.setdefault(rest, {}).setdefault(j, k)
        whole = [
            Joints(tuple(of[j] for j in range(len(readings))), _rank(rest), "by their names", True)
            for rest, of in found.items()
            if len(of) == len(readings) and len(set(of.values())) == len(readings)
        ]
        if whole:
            return whole
    # Of readings that only capitals or signs tell apart, the columns are those that are called just so.
    called = {table.columns[k].name: k for k in reversed(in_order)}
    if readings and all(name in called for name in readings):
        return [Joints(tuple(called[name] for name in readings), _rank(()), "by their names", True)]
    stated = {name: k for k, name in _stated_names(table).items() if k in among}
    if readings and all(name in stated for name in readings):
        return [Joints(tuple(stated[name] for name in readings), 1, "by the names that columns beside them have", True)]
    return []


def named_among(table: RawTable, readings: Iterable[str], among: frozenset[int]) -> frozenset[str]:
    """Return the readings that some column has the name of."""
    parts = [tokens(table.columns[k].name) for k in among]
    cores = {_core(part) for part in parts}
    wanted = {name: tokens(name) for name in readings}
    stated = {name for k, name in _stated_names(table).items() if k in among}
    # Every run of words in a column's name that is as long as a reading's.
    runs = {part[i : i + n] for n in set(map(len, wanted.values())) for part in parts for i in range(len(part) - n + 1)}
    return frozenset(name for name, words in wanted.items() if name in stated or words in runs or _core(words) in cores)


def _stated_names(table: RawTable) -> dict[int, str]:
    """Return the names of columns of positions for which others have one word in all rows.

    ``rostopic echo -p`` writes the names of joints so: elbow_joint below ``field.name0``, of ``field.position0``.
    """
    words = {
        (match[1], match[2]): column.words[0]
        for column in table.columns
        if column.numbers is None and len(set(column.words)) == 1 and (match := _NAME_OF.fullmatch(column.name))
    }
    matches = {
        k: _POSITION_OF.fullmatch(column.name) for k, column in enumerate(table.columns) if column.numbers is not None
    }
    found = {k: words[match[1], match[2]] for k, match in matches.items() if match and (match[1], match[2]) in words}
    return found if len(set(found.values())) == len(found) else {}


def _core(part: Sequence[str]) -> tuple[str, ...]:
    """Return a name without the word joint, as far as a word is left."""
    rest = tuple(word for word in part if word not in ("joint", "position", "pos"))
    return rest if any(not word.isdigit() for word in rest) else tuple(part)


def _without(part: Sequence[str], want: Sequence[str]) -> tuple[str, ...] | None:
    """Return the words around ``want``, which stands in one piece; None where it does not."""
    n = len(want)
    for i in range(len(part) - n + 1):
        if tuple(part[i : i + n]) == tuple(want):
            return (*part[:i], *part[i + n :])
    return None


def joints_by_order(table: RawTable, count: int, known: Roles) -> list[Joints]:
    """Return families of ``count`` numbered columns; or, where there are none, all columns that nothing else is."""
    parts = [tokens(column.name) for column in table.columns]
    numeric = [k for k, column in enumerate(table.columns) if column.numbers is not None]
    found, families = [], list(_families(parts, numeric))
    # What may be joints where four numbers called q are a quaternion: no velocities, no cells or last row of a matrix.
    told = {k for point in known.points for k in point.columns}
    told |= {k for turned in known.orientations if turned.form != "quaternion" for k in turned.columns}
    sizes = [
        len(family.columns)
        for family in families
        if told.isdisjoint(family.columns)
        and not (family.words & _NO_POSITION or family.is_pose)
        and any(changes(table, k) for k in family.columns)
    ]
    for family in families:
        if any(changes(table, k) for k in family.columns[count:]):  # else of axes that the arm does not have
            continue
        # Three numbers in a list may be a vector, or the joints of an arm that has three.
        axes = {k for point in known.points if point.columns != family.columns for k in point.columns} | {
            k
            for turned in known.orientations
            if turned.form != "quaternion" and turned.columns != family.columns
            for k in turned.columns
        }
        if (
            len(family.columns) >= count
            and not (family.words & _NO_POSITION or family.is_pose)
            and not axes & set(family.columns)
            and not (family.words <= _QUATERNION and count == 4 and sizes.count(count) > 1)
        ):
            found.append(Joints(family.columns[:count], _rank(family.words), "by their numbers", False))
    found = [one for one in found if any(changes(table, k) for k in one.columns)] or found
    if not found:
        left = [k for k in numeric if k not in known.spoken and not set(parts[k]) & set("xyz")]
        if len(left) == count and left == list(range(left[0], left[0] + count)):
            found.append(Joints(tuple(left), 1, "by their order, as the only columns left", False))
    return found


def changes(table: RawTable, column: int) -> bool:
    """Return whether a column has two values."""
    numbers = table.columns[column].numbers
    return numbers is None or len(set(numbers[np.isfinite(numbers)].tolist())) > 1


def numbered_columns(table: RawTable, known: Roles | None = None) -> list[int]:
    """Return how many columns each family has that may be joints, for a sentence; none that are ``known`` otherwise."""
    parts = [tokens(column.name) for column in table.columns]
    numeric = [k for k, column in enumerate(table.columns) if column.numbers is not None]
    spoken = frozenset() if known is None else known.spoken
    return [
        len(f.columns)
        for f in _families(parts, numeric)
        if not (f.words & _NO_POSITION or f.is_pose or spoken.intersection(f.columns))
    ]


class Unnamed(NamedTuple):
    """One way to share out the columns of a table without a header. ``target``: may name what was touched."""

    joints: Joints
    point: Point | None = None
    orientations: tuple[Orientation, ...] = ()
    target: int | None = None


def without_names(table: RawTable, count: int, joints: Sequence[int] = (), point: Sequence[int] = ()) -> list[Unnamed]:
    """Return the ways in which joints, a point and an orientation, or what was touched, may stand in a row.

    ``joints``, ``point``: the columns of all joints, and of x, y and z, where a person named them.
    """
    numeric = [k for k, column in enumerate(table.columns) if column.numbers is not None]
    columns = [k for k in numeric if k not in {*joints, *point}]
    first = table.columns[columns[0]].numbers if columns else None
    skips = [0]
    if first is not None and len(first) > 1 and bool(np.all(np.diff(first) > 0.0)):
        skips.append(1)

    def names_again(k: int) -> bool:
        """Whether a column has words, or whole numbers, of which most come more than once."""
        column = table.columns[k]
        whole = column.numbers is None or bool(np.all(column.numbers == np.round(column.numbers)))
        return whole and 2 * len(set(column.words)) <= len(column.words)

    shared: list[tuple[Joints, list[int]]] = []
    for own in (columns[skip:] for skip in skips):
        if joints:
            shared.append((Joints(tuple(joints), 0, "as answered", True), own))
            continue
        rest = len(own) - count
        if rest >= 0:
            shared.append((Joints(tuple(own[:count]), 1, "by their place", False), own[count:]))
        if rest > 0:
            shared.append((Joints(tuple(own[rest:]), 1, "by their place", False), own[:rest]))
    found = []
    for those, other in shared:
        if point:
            behind = [k for k in other if k > max(point)]
            found.append(Unnamed(those, _point(point[0], point[1], point[2]), _turned_behind(behind)))
        elif not other:
            found += [Unnamed(those, target=k) for k in (None, *filter(names_again, _texts(table)))]
        elif len(other) == 1 and names_again(other[0]):
            found.append(Unnamed(those, target=other[0]))
        elif len(other) in (3, 6, 7):
            form = _SIZES.get(len(other) - 3)
            own_turn = (Orientation(tuple(other[3:]), form, None, frozenset()),) if form is not None else ()
            found.append(Unnamed(those, _point(*other[:3]), own_turn))
        elif len(other) in (12, 16):
            nine = tuple(other[4 * i + j] for i in range(3) for j in range(3))
            if _turns(table, nine):
                matrix = Orientation(nine, "matrix", "matrix", frozenset())
                found.append(Unnamed(those, _point(other[3], other[7], other[11]), (matrix,)))
        else:
            found += [Unnamed(those, point, turned) for point, turned in points_among(other)]
    if joints and not found:
        found = [Unnamed(shared[0][0])]
    return found


def points_among(columns: Sequence[int]) -> Iterator[tuple[Point, tuple[Orientation, ...]]]:
    """Yield each three columns side by side as a point, with the orientations that may stand behind it.

    What was commanded may stand beside what was measured, and how far both are apart.
    """
    for k in range(len(columns) - 2):
        if columns[k + 2] - columns[k] == 2:
            yield _point(columns[k], columns[k + 1], columns[k + 2]), _turned_behind(columns[k + 3 :])


def _turned_behind(columns: Sequence[int]) -> tuple[Orientation, ...]:
    """Return the orientations that the columns behind a point may begin with."""
    return tuple(
        Orientation(tuple(columns[:size]), form, "matrix" if form == "matrix" else None, frozenset())
        for size, form in _SIZES.items()
        if len(columns) >= size
    )


def _point(x: int, y: int, z: int) -> Point:
    return Point((x, y, z), frozenset(), 1)
