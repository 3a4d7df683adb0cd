"""What was found in files of others, why, and what is asked; and the job file that it makes."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from calib.foundations.arguments import checked
from calib.foundations.brief import brief
from calib.foundations.words import first_of, on_one_line
from calib.job.toml_text import seen_from, toml_text
from calib.measurement.kinds import Kind
from calib.measurement.table import Columns
from calib.robot.robot import Robot
from calib.robot.urdf_writer import CountedZeros, splice_zeros

About = Literal[
    "tip", "joints", "angles", "lengths", "position", "orientation", "observes", "setup", "columns", "zeros"
]


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
        how = " or ".join(first_of([f"{self.option} {choice}" for choice in self.choices], more="one of {} more"))
        return f"{self.text}; answer by {how or self.option}."

    @checked
    def answered(self, choice: str) -> dict[str, Any]:
        """Return one of the choices as an argument of :func:`calib.measuring.propose`."""
        plain = choice.strip("'")
        if self.option == "--column":
            ours, _, theirs = plain.partition("=")
            return {"columns": {ours: theirs}}
        return {self.about: plain}


@dataclass(frozen=True, slots=True, eq=False)
class ProposedTable:
    """How one file is read. ``columns``: our names, with units, for the file's; ``rows``: how many it has.

    ``tool`` and ``setup``: the name of its own one, where it has another one than other tables.
    """

    file: str
    observes: Kind
    columns: Columns
    use: Literal["identify", "validate"]
    hold_out: float | None
    rows: int
    tool: str | None = None
    setup: str | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Proposal:
    """How files of others are read as measurements of an arm.

        found = calib.measuring.propose("arm.urdf", ["measured.csv"])
        print(found.reasons)
        data = calib.read_measurements("measured.csv", found.robot, found.tables[0].observes,
                                       columns=found.tables[0].columns)

    ``reasons``: one sentence for everything that was concluded. ``questions``: what could not be; ``tables`` is
    complete only when there are none. ``urdf``: as it was given. ``placements``: whether link placements are free; else
    joint offsets alone, as of few rows. ``zeros``: where the question is whether the readings have other zeros or signs
    than the URDF, these, by joint: the sign, 1 or -1, and the offset in rad or m; see :meth:`urdf_as_read`.
    """

    __repr__ = brief

    urdf: str
    robot: Robot
    tables: tuple[ProposedTable, ...]
    reasons: tuple[str, ...]
    questions: tuple[Question, ...]
    placements: bool = True
    zeros: CountedZeros | None = None

    def urdf_as_read(self) -> bytes:
        """Return the URDF whose joints count as the readings do: to be written, and proposed with the same tables.

            found = calib.measuring.propose("arm.urdf", ["measured.csv"])
            if found.zeros:
                Path("arm_as_read.urdf").write_bytes(found.urdf_as_read())

        Without :attr:`zeros` it is the URDF as it was.
        """
        return splice_zeros(self.robot.urdf.source, self.zeros or {}, self.robot.urdf.where)

    @checked
    def job(self, folder: Path | None = None) -> str:
        """Return the job file, with paths relative to the ``folder`` in which it will be; None: as they were given."""
        robot = self.robot
        lines = ["schema = 1", ""]
        lines += [f"# {reason}" for reason in map(on_one_line, self.reasons)]
        lines += ["", "[robot]", f"urdf = {_named(self.urdf, folder)}", f"tip = {toml_text(robot.tip)}"]
        if robot.base != robot.urdf.root:
            lines.append(f"base = {toml_text(robot.base)}")
        tool = "pose" if any(table.observes == "pose" for table in self.tables) else "position"
        lines += [
            "",
            "[error_model]",
            'offsets = "all"',
            f'placements = "{"all" if self.placements else "none"}"',
            'base = "pose"',
            f'tool = "{tool}"',
        ]
        for table in self.tables:
            lines += ["", "[[measurements]]", f"file = {_named(table.file, folder)}"]
            lines.append(f'observes = "{table.observes}"')
            lines += [
                f"{key} = {toml_text(name)}" for key, name in (("tool", table.tool), ("setup", table.setup)) if name
            ]
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
        listed = ", ".join(f"{toml_text(ours)} = {toml_text(theirs)}" for ours, theirs in named.items())
        lines.append(f"columns = {{ {listed} }}")
    if columns.ignore:
        lines.append(f"ignore = [{', '.join(map(toml_text, columns.ignore))}]")
    if columns.orientation is not None:
        lines.append(f"orientation = {toml_text(columns.orientation)}")
    return lines


def _named(path: str, folder: Path | None) -> str:
    return toml_text(path if folder is None else seen_from(folder, path))
