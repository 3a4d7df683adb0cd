"""What was found in files of others, why, and what is asked; and the job file that it makes."""

import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from calib.foundations.brief import brief
from calib.measurement.kinds import Kind
from calib.measurement.table import Columns
from calib.robot.robot import Robot

About = Literal["tip", "joints", "angles", "lengths", "position", "orientation", "observes", "setup", "columns"]


@dataclass(frozen=True, slots=True)
class Question:
    """What cannot be known from the files: ``text``, the answers to choose from, and the option that gives one.

    ``choices`` are the values of ``option``; empty where the answer is no choice.
    """

    about: About
    text: str
    choices: tuple[str, ...]
    option: str

    @property
    def sentence(self) -> str:
        """The question with the option that answers it."""
        how = " or ".join(f"{self.option} {choice}" for choice in self.choices) or self.option
        return f"{self.text}; answer by {how}."

    def answered(self, choice: str) -> dict[str, Any]:
        """Return one of the choices as an argument of :func:`calib.measuring.propose`."""
        plain = choice.strip("'")
        if self.option == "--column":
            ours, _, theirs = plain.partition("=")
            return {"columns": {ours: theirs}}
        return {self.about: plain}


@dataclass(frozen=True, slots=True, eq=False)
class ProposedTable:
    """How one file is read. ``columns``: our names, with units, for the file's; ``rows``: how many it has."""

    file: str
    observes: Kind
    columns: Columns
    use: Literal["identify", "validate"]
    hold_out: float | None
    rows: int


@dataclass(frozen=True, slots=True, eq=False)
class Proposal:
    """How files of others are read as measurements of an arm.

        found = calib.measuring.propose("arm.urdf", ["measured.csv"])
        print(found.reasons)
        data = calib.read_measurements("measured.csv", found.robot, found.tables[0].observes,
                                       columns=found.tables[0].columns)

    ``reasons``: one sentence for everything that was concluded. ``questions``: what could not be; ``tables`` is
    complete only when there are none. ``urdf``: as it was given.
    """

    __repr__ = brief

    urdf: str
    robot: Robot
    tables: tuple[ProposedTable, ...]
    reasons: tuple[str, ...]
    questions: tuple[Question, ...]

    def job(self, folder: Path | None = None) -> str:
        """Return the job file, with paths relative to the ``folder`` in which it will be; None: as they were given."""
        robot = self.robot
        lines = ["schema = 1", ""]
        lines += [f"# {reason}" for reason in map(_on_one_line, self.reasons)]
        lines += ["", "[robot]", f"urdf = {_toml(_path(self.urdf, folder))}", f"tip = {_toml(robot.tip)}"]
        if robot.base != robot.urdf.root:
            lines.append(f"base = {_toml(robot.base)}")
        tool = "pose" if any(table.observes == "pose" for table in self.tables) else "position"
        lines += [
            "",
            "[error_model]",
            'offsets = "all"',
            'placements = "all"',
            'base = "pose"',
            f'tool = "{tool}"',
        ]
        for table in self.tables:
            lines += ["", "[[measurements]]", f"file = {_toml(_path(table.file, folder))}"]
            lines.append(f'observes = "{table.observes}"')
            lines += table_lines(table.columns)
            if table.use != "identify":
                lines.append(f'use = "{table.use}"')
            if table.hold_out is not None:
                lines.append(f"hold_out = {table.hold_out}")
        return "\n".join(lines) + "\n"


def table_lines(columns: Columns) -> list[str]:
    """Return the lines of a job that say how a table is read; columns that are called as ours need none."""
    named = {ours: theirs for ours, theirs in columns.names.items() if ours != theirs}
    lines = []
    if named:
        listed = ", ".join(f"{_toml(ours)} = {_toml(theirs)}" for ours, theirs in named.items())
        lines.append(f"columns = {{ {listed} }}")
    if columns.ignore:
        lines.append(f"ignore = [{', '.join(map(_toml, columns.ignore))}]")
    if columns.orientation is not None:
        lines.append(f"orientation = {_toml(columns.orientation)}")
    return lines


def _path(path: str, folder: Path | None) -> str:
    if folder is None or ":" in path.partition("/")[0]:
        return path
    return os.path.relpath(path, folder)


def _toml(text: str) -> str:
    """Return a text as a TOML string, whole: it is read again. JSON's differs in one character alone."""
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def _on_one_line(text: str) -> str:
    return "".join(letter if letter.isprintable() else "?" for letter in text)
