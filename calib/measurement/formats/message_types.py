"""What messages of recordings are, told by the definitions that recordings carry: joints, poses, points, or others.

rosbags makes Python of every definition, and objects of whatever a message says it has. A definition of some lines asks
for a thousand million strings, a message of four bytes for as many empty parts. So definitions are looked at before
rosbags parses them, and only messages that can become a table are read, as many values of them as the recording's size
allows. Types are those of rosbags: constants and fields of every name, and of a field its description.
"""

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from calib.foundations.errors import MeasurementError
from calib.foundations.words import shown

# Steps of the parsers, of some 70 µs each: a line of a definition, or a value in it, is one.
MOST_STEPS = 20_000
# To make a class of a type takes as long as so many.
_CLASS = 9
# What takes the parser of IDL so many steps: it tries every rule of the grammar for sizes and values.
_DEAR = 60
# All values of messages that are read, for each byte of the recording, and at least; and of one message.
VALUES_PER_BYTE, LEAST_VALUES, MOST_IN_MESSAGE = 10, 5_000_000, 1_000_000
# A message by itself costs as much as so many values.
_MESSAGE = 20
# Fields of a type, and values that a message has whatever its bytes say: code is made for each.
_MOST_FIXED = 1000
_DEEPEST = 20

_BASE, _NAME, _ARRAY, _SEQUENCE = 1, 2, 3, 4
_INTEGERS = frozenset(f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64))
_NUMBERS = _INTEGERS | {"float32", "float64"}
# Where a point, and where an orientation, may be in a message, and which numbers it has.
_POINT = (("position", "translation", "point", "vector"), ("x", "y", "z"))
_TURN = (("orientation", "rotation"), ("w", "x", "y", "z"))
_INSIDE = ("pose", "transform")
# As in pose.pose.position, and no type that is a pose of poses without end.
_MOST_INSIDE = 4
_TF = "tf2_msgs/msg/TFMessage"
_JOINTS = "sensor_msgs/msg/JointState"
# rosbags gives one to what has no fields.
_NO_FIELD = "structure_needs_at_least_one_member"

# Of a type by rosbags: constants and fields; of every field its name and description.
Types = Mapping[str, tuple[Any, Any]]
_Fields = dict[str, Any]


class Told(NamedTuple):
    """What messages of a type can become: ``of`` is "joints", "pose", "point", or "" for none of them.

    ``point`` and ``turn`` are the fields to go through to a point and to a quaternion, ``stamped`` says whether a
    header has a time, ``framed`` whether it names a frame, ``frames`` whether all this is of every transform in it.
    """

    of: str
    point: tuple[str, ...] = ()
    turn: tuple[str, ...] = ()
    stamped: bool = False
    framed: bool = False
    frames: bool = False


class _Size(NamedTuple):
    """Values and bytes that a type has at least, and how many more values a byte more can be."""

    values: int
    length: int
    of_a_byte: float


def told_by(types: Types, kind: str) -> Told:
    """Return what messages of a type can become."""
    fields = _fields(types, kind)
    if kind == _TF:
        description = fields.get("transforms")
        inside = description[1][0] if description and description[0] == _SEQUENCE else (_BASE, "")
        parts = _fields(types, inside[1]) if inside[0] == _NAME else {}
        if not _is_text(parts.get("child_frame_id")):
            return Told("")
        return _placed(types, parts)._replace(frames=True)
    if kind == _JOINTS:
        names, positions = fields.get("name"), fields.get("position")
        if _are_many(names, frozenset(("string",))) and _are_many(positions, _NUMBERS):
            return Told("joints", stamped=_stamped(types, fields))
        return Told("")
    return _placed(types, fields)


def _placed(types: Types, fields: _Fields) -> Told:
    point, turn = _within(types, fields, *_POINT), _within(types, fields, *_TURN)
    if point is None:
        return Told("")
    framed = _is_text(_part(types, fields, "header").get("frame_id"))
    return Told("point" if turn is None else "pose", point, turn or (), _stamped(types, fields), framed)


def _within(
    types: Types, fields: _Fields, names: tuple[str, ...], needed: tuple[str, ...], deep: int = 0
) -> tuple[str, ...] | None:
    """Return the way to the part of a message, or of the pose or transform in it, that has these numbers, or None."""

    def has(found: _Fields) -> bool:
        return all(_is_number(found.get(axis), _NUMBERS) for axis in needed)

    for name in names:
        if has(_part(types, fields, name)):
            return (name,)
    # A point by itself is its own place; a quaternion by itself is none.
    if "position" in names and has(fields) and "w" not in fields:
        return ()
    for name in _INSIDE if deep < _MOST_INSIDE else ():
        if part := _part(types, fields, name):
            found = _within(types, part, names, needed, deep + 1)
            if found is not None:
                return (name, *found)
    return None


def _stamped(types: Types, fields: _Fields) -> bool:
    stamp = _part(types, _part(types, fields, "header"), "stamp")
    return all(_is_number(stamp.get(name), _INTEGERS) for name in ("sec", "nanosec"))


def _part(types: Types, fields: _Fields, name: str) -> _Fields:
    description = fields.get(name)
    return _fields(types, description[1]) if description and description[0] == _NAME else {}


def _fields(types: Types, kind: str) -> _Fields:
    return dict(types[kind][1]) if kind in types else {}


def _is_text(description: Any) -> bool:
    return _is_number(description, frozenset(("string",)))


def _are_many(description: Any, kinds: frozenset[str]) -> bool:
    return bool(description) and description[0] == _SEQUENCE and _is_number(description[1][0], kinds)


def _is_number(description: Any, kinds: frozenset[str]) -> bool:
    return bool(description) and description[0] == _BASE and description[1][0] in kinds


class Definitions:
    """Gives rosbags the types of the definitions of one recording, as long as they are not too many.

    ``parsers``: the module of rosbags that has its own.
    """

    def __init__(self, where: Path, parsers: Any) -> None:
        self._where = where
        self._of_messages, self._of_idl = parsers.get_types_from_msg, parsers.get_types_from_idl
        self._wrong: type[Exception] = parsers.TypesysError
        self._left = MOST_STEPS
        self._known: dict[tuple[str, ...], Any] = {}

    def legible(self, topic: Any) -> Any:
        """Return a topic without its definition where that cannot be parsed: others may be of use."""
        form, text = topic.msgdef
        try:
            if form.name == "MSG":
                self.of_messages(text, topic.msgtype)
            elif form.name == "IDL":
                parts = text.split(_RULE)[1:] if text.startswith(f"{_RULE}IDL: ") else [f"\n{text}"]
                for part in parts:
                    self.of_idl(part.partition("\n")[2])
        except self._wrong:
            return topic._replace(msgdef=topic.msgdef._replace(format=type(form).NONE, data=""), digest="")
        return topic

    def of_messages(self, text: str, name: str) -> Any:
        """Return the types of a definition in ROS's own language."""
        if (text, name) not in self._known:
            every = text.replace("\r\n", "\n").split("\n")
            lines = [line for line in every if line.strip() and not line.lstrip().startswith("#")]
            self._take(_CLASS + len(lines) + sum(line.count(",") for line in lines))
            self._known[text, name] = self._narrow(self._of_messages("".join(f"{line}\n" for line in lines), name))
        return self._known[text, name]

    def of_idl(self, text: str) -> Any:
        """Return the types of a definition in OMG's language, without its notes; it may compute nothing.

        The parser looks a hundred times longer for the end of every bracket that is inside of another.
        """
        if (text,) not in self._known:
            bare = _NOTES.sub(" ", _INCLUDES.sub("", _COMMENTS.sub(_blanked, text)))
            if computed := _COMPUTES.search(_STRINGS.sub("", bare)):
                raise MeasurementError(f"{self._where}: computes a number in a definition ({shown(computed[0])}).")
            self._take(sum(map(bare.count, ";,{+-")) + _DEAR * len(_LOOKED_FOR.findall(bare)))
            self._known[(text,)] = self._narrow(self._of_idl(bare))
        return self._known[(text,)]

    def _narrow(self, types: Types) -> Types:
        """Return types as they are, unless one is so wide that to make a class of it takes long."""
        for kind, parts in types.items():
            if sum(map(len, parts)) > _MOST_FIXED:
                raise MeasurementError(f"{self._where}: messages of {shown(kind)} have more than {_MOST_FIXED} fields.")
        return types

    def _take(self, steps: int) -> None:
        self._left -= steps
        if self._left < 0:
            raise MeasurementError(
                f"{self._where}: defines too much: its messages have more than {MOST_STEPS} fields, or are of too many "
                "kinds."
            )


# Between the definitions of a type in OMG's language and of those that are parts of it.
_RULE = f"{'=' * 80}\n"
_STRINGS = re.compile(r'"(?:\\.|[^"\\])*"')
_COMMENTS = re.compile(rf"{_STRINGS.pattern}|/\*.*?\*/|//[^\n]*", re.DOTALL)
_INCLUDES = re.compile(r"^[^\S\n]*#[^\n]*", re.MULTILINE)
_NOTES = re.compile(rf"@\s*[\w:]+(?:\s*\((?:{_STRINGS.pattern}|[^()\"])*\))?")
_COMPUTES = re.compile(r"[(*/%~^&|]|<<")
_LOOKED_FOR = re.compile(r"\b(?:const|typedef|struct|enum|union|bitset|bitmask|map)\b|[<\[]")


def _blanked(found: re.Match[str]) -> str:
    return found[0] if found[0].startswith('"') else " "


class Values:
    """Counts the values that messages of a recording of ``size`` bytes have, as far as its limits go."""

    def __init__(self, where: Path, size: int, types: Types) -> None:
        self._where, self._types = where, types
        self._left = max(LEAST_VALUES, VALUES_PER_BYTE * size)
        self._sizes: dict[str, _Size] = {}

    def pass_by(self) -> None:
        """Count a message that is not read."""
        self._take(_MESSAGE)

    def read(self, kind: str, raw: bytes) -> None:
        """Count a message, before anything is made of its bytes."""
        size = self._size(kind, 0)
        values = size.values + round(size.of_a_byte * len(raw))
        if values > MOST_IN_MESSAGE:
            raise MeasurementError(
                f"{self._where}: a message of {shown(kind)} may have more than {MOST_IN_MESSAGE} values."
            )
        self._take(_MESSAGE + values)

    def _take(self, values: int) -> None:
        self._left -= values
        if self._left < 0:
            raise MeasurementError(
                f"{self._where}: has more messages than a recording of its size can have; cut it into parts, or write "
                "it unpacked."
            )

    def _size(self, kind: str, deep: int) -> _Size:
        if kind in self._sizes:
            return self._sizes[kind]
        if deep > _DEEPEST:
            raise MeasurementError(f"{self._where}: messages have parts in parts without end ({shown(kind)}).")
        values, length, of_a_byte = 1, 0, 0.0
        for name, description in _fields(self._types, kind).items():
            if name == _NO_FIELD:
                continue
            part = self._of_field(description, deep)
            values, length = values + part.values, length + part.length
            of_a_byte = max(of_a_byte, part.of_a_byte)
            if values > _MOST_FIXED:
                raise MeasurementError(f"{self._where}: messages of {shown(kind)} have more than {_MOST_FIXED} values.")
        self._sizes[kind] = _Size(values, length, of_a_byte)
        return self._sizes[kind]

    def _of_field(self, description: Any, deep: int) -> _Size:
        node, of = description
        if node == _BASE:
            return _Size(1, 4 if of[0] == "string" else 1, 0.0)
        if node == _NAME:
            return self._size(of, deep + 1)
        (inside, many) = of
        # Of numbers, arrays are made at once.
        if inside[0] == _BASE and inside[1][0] != "string":
            return _Size(1, many if node == _ARRAY else 4, 0.0)
        one = self._of_field(inside, deep)
        if node == _ARRAY:
            return _Size(1 + max(many, 1) * one.values, many * one.length, one.of_a_byte)
        return _Size(1, 4, max(one.of_a_byte, one.values / one.length if one.length else float(MOST_IN_MESSAGE)))
