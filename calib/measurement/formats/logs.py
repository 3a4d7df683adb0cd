"""Logs of others, text with headers of their own: Universal Robots' RTDE, and rigid bodies of Motive."""

from collections.abc import Callable, Sequence

from calib.foundations.errors import MeasurementError
from calib.foundations.units import NO_NUMBER, NUMBER
from calib.foundations.words import counted, listed, shown
from calib.measurement.layout import name_and_unit
from calib.measurement.table import COMMANDED

_Rows = tuple[Sequence[str], Sequence[Sequence[str]], str]
_JOINTS = tuple(f"{name}_joint" for name in ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3"))
_OF_RTDE = ("timestamp", "actual_q_", "target_q_")
_BODY, _MARKER = "Rigid Body", "Marker"
_UNITS = {"meters": "m", "millimeters": "mm", "centimeters": "cm"}


def of_rtde(titles: Sequence[str], rows: Sequence[Sequence[str]]) -> _Rows | None:
    """Return time and joints of a log of the UR client library, None for other titles.

    Its ``timestamp`` is in s, ``actual_q_0`` to ``actual_q_5`` in rad, and so is ``target_q``, what was commanded,
    where it is there; what else there is, is left out.
    """
    number = {title.strip().split(" ")[0]: k for k, title in enumerate(titles)}
    units = {
        name_and_unit(title.replace("[", "(").replace("]", ")"))[1] for title in titles if title.startswith(_OF_RTDE)
    }
    if not units <= {None, "rad", "s"}:  # somebody's table of the same names
        return None
    columns = ["timestamp", *(f"actual_q_{k}" for k in range(6))]
    if not all(name in number for name in columns):
        return None
    named = ["time [s]", *(f"{joint} [rad]" for joint in _JOINTS)]
    targets = [f"target_q_{k}" for k in range(6)]
    if there := all(name in number for name in targets):
        columns += targets
        named += [f"{COMMANDED}{joint} [rad]" for joint in _JOINTS]
    chosen = [number[name] for name in columns]
    left = len(titles) - len(chosen)
    what = "actual_q and target_q" if there else "actual_q"
    said = f"joint readings of a UR by RTDE, {what}; {counted(left, 'other column is', 'other columns are')} left out"
    return named, [[row[k] for k in chosen] for row in rows], said


def is_motive(text: str) -> bool:
    """Return whether a text begins as an export of Motive (OptiTrack)."""
    return text.lstrip("\ufeff").startswith("Format Version,") and "Take Name," in text[:500]


def of_motive(text: str, where: str, body: str | None = None) -> _Rows:
    """Return time, points and quaternions of a rigid body in an export of Motive; frames that lost it are left out.

    Where there are no rigid bodies, or ``body`` names one, the points of a marker. ``body``: its name, where there are
    several. Raises MeasurementError where there is none of that name.
    """
    lines = [line.split(",") for line in text.lstrip("\ufeff").replace("\r\n", "\n").split("\n")]
    about = dict(zip(lines[0][::2], lines[0][1::2], strict=False))
    kinds, names, parts, axes = _header(lines, where)
    kind, own = _chosen(kinds, names, body, where)

    def column(part: str, axis: str) -> int:
        for k, found in enumerate(zip(kinds, names, parts, axes, strict=False)):
            if found == (kind, own, part, axis):
                return k
        raise MeasurementError(f"{where}: the {kind.lower()} {shown(own)} has no column {part} {axis}.")

    unit = _UNITS.get(about.get("Length Units", "").lower(), "")
    if not unit:
        raise MeasurementError(f"{where}: its length units are {shown(about.get('Length Units', ''))}; not known.")
    places = [column("Position", axis) for axis in "XYZ"]
    is_turned = kind == _BODY and about.get("Rotation Type") == "Quaternion"
    turns = [column("Rotation", axis) for axis in "WXYZ"] if is_turned else []
    time = next((k for k, axis in enumerate(axes) if axis in ("Time", "Time (Seconds)")), None)
    if time is None:
        raise MeasurementError(f"{where}: begins as an export of Motive, and has no column 'Time (Seconds)'.")
    chosen = [time, *places, *turns]
    begin = next(k for k, line in enumerate(lines) if line[0].strip() == "Frame") + 1
    rows: list[list[str]] = []
    for number, line in enumerate(lines[begin:], start=begin + 1):
        if len(line) <= max(chosen) and any(cell.strip() for cell in line):
            raise MeasurementError(f"{where}:{number}: has {len(line)} cells, and its columns are {len(axes)}.")
        rows += [[line[k].strip() for k in chosen]] if len(line) > max(chosen) else []
        if wrong := next((cell for cell in rows[-1] if cell and NUMBER.fullmatch(cell) is None), "") if rows else "":
            raise MeasurementError(f"{where}:{number}: {shown(wrong)} {NO_NUMBER}.")
    seen = [row for row in rows if all(row)]
    titles = ("time [s]", *(f"{axis} [{unit}]" for axis in "xyz"), *(("qw", "qx", "qy", "qz") if turns else ()))
    frames = counted(len(rows) - len(seen), "frame that lost it is", "frames that lost it are")
    angles = (
        ""
        if turns or kind != _BODY
        else f"; its rotations are {shown(about.get('Rotation Type', ''))}, not Quaternion, and left out"
    )
    return titles, seen, f"the {kind.lower()} {own!r} of Motive; {frames} left out{angles}"


def _chosen(kinds: Sequence[str], names: Sequence[str], wanted: str | None, where: str) -> tuple[str, str]:
    """Return kind and name of the rigid body that is meant, or, where there is none, of the marker."""
    found = {
        kind: dict.fromkeys(n for k, n in zip(kinds, names, strict=False) if k == kind) for kind in (_BODY, _MARKER)
    }
    if wanted is not None and (kind := next((kind for kind in found if wanted in found[kind]), None)):
        return kind, wanted
    kind = _BODY if found[_BODY] or not found[_MARKER] else _MARKER
    there, what = found[kind], "rigid bodies" if kind == _BODY else "markers"
    if not there:
        raise MeasurementError(f"{where}: has no rigid bodies, and no markers.")
    if wanted is not None or len(there) > 1:
        said = f"several {what}; say which one by topic" if wanted is None else f"no {kind.lower()} {shown(wanted)}"
        raise MeasurementError(f"{where}: has {said}; there are {listed(there)}.")
    return kind, next(iter(there))


def _header(lines: Sequence[Sequence[str]], where: str) -> tuple[list[str], ...]:
    """Return kind, name, part and axis of every column: the lines Type, Name, two of parts, and that of the axes."""
    lacking = MeasurementError(f"{where}: begins as an export of Motive, and lacks the lines of its header.")

    def line(found: Callable[[Sequence[str]], bool]) -> int:
        for k, cells in enumerate(lines[:20]):
            if found(cells):
                return k
        raise lacking

    kind = line(lambda cells: "Type" in cells[:2])
    axis = line(lambda cells: cells[0].strip() == "Frame")
    if kind + 1 >= axis:
        raise lacking
    # Names of markers stand in quotes in some versions.
    return tuple([cell.strip().strip('"') for cell in lines[k]] for k in (kind, kind + 1, axis - 1, axis))
