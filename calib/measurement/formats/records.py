"""Records as rows: JSON lines, and lists or mappings of records, or of columns, in JSON and YAML.

Lists in a record are numbered. A ``sensor_msgs/JointState`` is one record: its ``name`` s are titles, its
``position`` s their cells.
"""

import itertools
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

from calib.foundations.csv_text import text_of
from calib.foundations.errors import MeasurementError
from calib.foundations.json_text import UnreadableError, unique_names, whole_number
from calib.foundations.words import counted, listed, shown
from calib.measurement.cells import Rows
from calib.measurement.formats.yaml_events import read_yaml, written
from calib.measurement.layout import is_number, refuse_long_name

_DEEPEST = 8
_MOST_CELLS = 5_000_000
_LONGEST_LIST = 1000
_OF_JOINTS = ("name", "position", "velocity", "effort")
# What lists of joints' names are called, and of where they are: of ROS, MoveIt, robot_calibration.
_NAMES, _READINGS = ("name", "joint_names", "joints"), ("joint_positions", "positions", "position")
# As many numbers may be a point as well, which only a sensor_msgs/JointState calls otherwise.
_OF_A_POINT = 3
# What pandas writes with orient="split".
_SPLIT = ({"columns", "data"}, {"columns", "index", "data"})
# A list of no more values may be one vector or one matrix of 4 by 4, as well as a column.
_LONGEST_VECTOR = 16
_ALLOWED = 'allowed is a list of records, as [{"x": 1, "y": 2}, {"x": 3, "y": 4}]'


def from_json_lines(data: bytes, where: str) -> Rows:
    """Return titles and cells of one JSON object a line."""
    found = []
    for number, line in enumerate(_text(data, where).split("\n"), start=1):
        if line.strip():
            found.append(_loaded(line, f"{where}:{number}"))
    return _rows(found, (), where)


def from_json(data: bytes, where: str) -> Rows:
    """Return titles and cells of a JSON list, or mapping, of records, or of columns."""
    return _rows(*_records(_loaded(_text(data, where), where), where), where)


def from_yaml(data: bytes, where: str) -> Rows:
    """Return titles and cells of records in YAML, in one document or several. Needs the package pyyaml.

    Raises MeasurementError where that is not there, and for what is no YAML or holds no records.
    """
    if data.startswith(b"%YAML:"):
        raise MeasurementError(
            f"{where}: is of OpenCV, whose YAML is not read; numpy.savez writes an .npz, of which calib import makes a "
            "table."
        )

    def documents_of(yaml: Any, text: str, loader: Any) -> list[Any]:
        nodes = yaml.compose_all(text, loader)
        return [found for node in nodes if node is not None and (found := written(node))]

    documents = read_yaml(_text(data, where), where, MeasurementError, documents_of)
    found, said = _records(documents[0], where) if len(documents) == 1 else (documents, ())
    return _rows(found, said, where)


def _text(data: bytes, where: str) -> str:
    return text_of(data, where, MeasurementError).replace("\r\n", "\n")


def _loaded(text: str, where: str) -> Any:
    try:
        return json.loads(text, parse_int=whole_number, object_pairs_hook=unique_names)
    except UnreadableError as e:
        raise MeasurementError(f"{where}: is not JSON that can be read: {e}.") from e
    except (ValueError, RecursionError) as e:
        raise MeasurementError(f"{where}: is not JSON.") from e


def _records(found: Any, where: str) -> tuple[list[Any], tuple[str, ...]]:
    """Return the records of a list, of a mapping of records, of the only list in a mapping, or of columns, and remarks.

    Those of a mapping have its names in a column: rows of two files are joined by such.
    """
    if isinstance(found, list):
        return found, ()
    if not isinstance(found, Mapping):
        return [found], ()
    if set(found) in _SPLIT and (split := _of_split(found, where)) is not None:
        return split, ()
    inside = [key for key, value in found.items() if isinstance(value, list) and value and isinstance(value[0], dict)]
    if len(inside) == 1:
        others = [key for key in found if key != inside[0]]
        said = (f"{shown(inside[0])} is read, and not {listed(others)}",) if others else ()
        return list(found[inside[0]]), said
    if found and all(isinstance(value, Mapping) for value in found.values()):
        if len(found) == 1:
            _refuse_records_inside(found, where)
        return _of_mappings(found, where), ()
    if (columns := _of_columns(found, where)) is not None:
        return columns, ()
    _refuse_records_inside(found, where)
    return [found], ()


def _refuse_records_inside(found: Mapping[str, Any], where: str) -> None:
    """Raise MeasurementError where one record, which would be one row, holds lists of records below its names."""
    inside = next(_lists_of_records(found, "", 0), None)
    if inside is not None:
        raise MeasurementError(
            f"{where}: {shown(inside)} is a list of records that lies below other names; {_ALLOWED}."
        )


def _lists_of_records(node: Any, name: str, depth: int) -> Iterator[str]:
    if isinstance(node, Mapping) and depth <= _DEEPEST:
        for key, value in node.items():
            yield from _lists_of_records(value, f"{name}.{key}" if name else str(key), depth + 1)
    elif isinstance(node, list) and len(node) > 1 and all(isinstance(one, Mapping) for one in node):
        yield name


def _of_split(found: Mapping[str, Any], where: str) -> list[Any] | None:
    """Return the records of rows below titles, as pandas writes them with ``orient="split"``; None where it is none."""
    titles, rows = found["columns"], found["data"]
    if not (isinstance(titles, list) and isinstance(rows, list) and _are_words(titles)):
        return None
    if len(set(titles)) < len(titles):
        raise MeasurementError(f"{where}: has two columns of one name.")
    for number, row in enumerate(rows, start=1):
        if not isinstance(row, list) or len(row) != len(titles):
            raise MeasurementError(f"{where}: row {number} of 'data' is no list of {len(titles)} values, as 'columns'.")
    names = found.get("index")
    if not isinstance(names, list) or len(names) != len(rows) or _are_numbered(list(map(str, names))):
        return [dict(zip(titles, row, strict=True)) for row in rows]
    title = _free_title([dict.fromkeys(titles)])
    return [{title: name, **dict(zip(titles, row, strict=True))} for name, row in zip(names, rows, strict=True)]


def _of_mappings(found: Mapping[str, Mapping[str, Any]], where: str) -> list[Any]:
    """Return the records of a mapping of records, or of columns, which have numbers for the names of their rows."""
    inside = dict.fromkeys(name for value in found.values() for name in value)
    if inside and all(map(_is_numeral, inside)):
        if all(map(_is_numeral, found)):
            raise MeasurementError(
                f"{where}: numbers are the names of rows and of columns, so that it tells neither; write a list of "
                'records (in pandas to_json with orient="records").'
            )
        rows: dict[str, dict[str, Any]] = {name: {} for name in inside}
        for title, column in found.items():
            for name, value in column.items():
                rows[name][title] = value
        if _are_numbered(list(rows)):
            return list(rows.values())
        title = _free_title([found])
        return [{title: name, **row} for name, row in rows.items()]
    first, *others = found.values()
    if others and not any(name in first for value in others for name in value):
        raise MeasurementError(
            f"{where}: entries as {listed(list(found)[:2])} have no name in common, and are not rows; {_ALLOWED}."
        )
    title = _free_title(found.values())
    return [{title: key, **value} for key, value in found.items()]


def _of_columns(found: Mapping[str, Any], where: str) -> list[Any] | None:
    """Return the records of columns, lists of one length; None where this is one record that has lists."""
    counts = {len(value) if isinstance(value, list) else -1 for value in found.values()}
    if len(counts) != 1 or (count := counts.pop()) < 1 or _names_and_readings(found) is not None:
        return None
    if count <= _LONGEST_VECTOR:
        raise MeasurementError(
            f"{where}: has lists of {counted(count, 'value')}, and does not tell whether they are rows or one record; "
            f"{_ALLOWED}."
        )
    return [{title: column[k] for title, column in found.items()} for k in range(count)]


def _is_numeral(name: str) -> bool:
    return is_number(name, ",")


def _are_numbered(names: Sequence[str]) -> bool:
    """Return whether rows have no names but their numbers, from 0 or 1 on."""
    return any(all(name == str(k) for k, name in enumerate(names, start)) for start in (0, 1))


def _free_title(records: Iterable[Mapping[str, Any]]) -> str:
    """Return a title for the names of rows that none of their columns has."""
    taken = {name for record in records for name in record}
    title = "record"
    while title in taken:
        title += "_"
    return title


def _rows(found: Sequence[Any], said: tuple[str, ...], where: str) -> Rows:
    titles: dict[str, None] = {}
    rows: list[dict[str, str]] = []
    count = 0
    for number, record in enumerate(found, start=1):
        if not isinstance(record, Mapping):
            raise MeasurementError(f"{where}: record {number} is no mapping of names to values; {_ALLOWED}.")
        row: dict[str, str] = {}
        for name, cell in _flat(record, "", 0, where):
            if name in row:
                raise MeasurementError(f"{where}: record {number} has two values of the name {shown(name)}.")
            row[name] = cell
            titles[name] = None
            # At every value: each has a name of its own, which in lists of lists may be far longer than what it names.
            if len(titles) > _LONGEST_LIST:
                raise MeasurementError(f"{where}: has more than {_LONGEST_LIST} columns.")
            count += 1
            if count > _MOST_CELLS:
                raise MeasurementError(f"{where}: has more than {_MOST_CELLS} values.")
        rows.append(row)
    if count and len(rows) * len(titles) > _MOST_CELLS:
        raise MeasurementError(f"{where}: has more than {_MOST_CELLS} values.")
    return list(titles), [[row.get(title, "") for title in titles] for row in rows], said


def _flat(node: Any, name: str, depth: int, where: str) -> Iterator[tuple[str, str]]:
    """Yield the name and the text of every value of a record."""
    if depth > _DEEPEST:
        raise MeasurementError(f"{where}: is nested too deep.")
    refuse_long_name(name, where)
    if isinstance(node, Mapping):
        if (of_joints := _names_and_readings(node)) is not None:
            yield from ((one, _cell(value)) for one, value in zip(*(node[key] for key in of_joints), strict=True))
            own = _OF_JOINTS if of_joints == _OF_JOINTS[:2] else of_joints
            node = {key: value for key, value in node.items() if key not in own}
        for key, value in node.items():
            yield from _flat(value, f"{name}.{key}" if name else str(key), depth + 1, where)
    elif isinstance(node, list):
        if len(node) > _LONGEST_LIST:
            raise MeasurementError(f"{where}: {name!r} is a list of {len(node)} values; allowed are {_LONGEST_LIST}.")
        for k, value in enumerate(node):
            yield from _flat(value, f"{name}_{k}", depth + 1, where)
    else:
        yield name, _cell(node)


def _names_and_readings(node: Mapping[str, Any]) -> tuple[str, str] | None:
    """Return under which keys the names of joints stand, and as many numbers for them; None where they do not."""
    for names, readings in itertools.product(_NAMES, _READINGS):
        called, numbers = node.get(names), node.get(readings)
        if not (isinstance(called, list) and isinstance(numbers, list) and len(called) == len(numbers)):
            continue
        if readings == "position" and names != "name" and len(numbers) == _OF_A_POINT:
            continue
        if _are_words(called) and not any(isinstance(one, list | Mapping) for one in numbers):
            return names, readings
    return None


def _are_words(names: Sequence[Any]) -> bool:
    return bool(names) and all(isinstance(name, str) for name in names)


def _cell(value: object) -> str:
    if value is None:
        return ""
    text = repr(value) if isinstance(value, float) else str(value)
    return " ".join(text.split())[:200]
