"""The shipped case in a folder of its own, to be run as a user runs it, and to be broken."""

import contextlib
import csv
import hashlib
import io
import shutil
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple
from unittest import mock

import numpy as np

from calib import cli
from calib.job.inputs import load
from calib.job.run import run as identify
from tests.support import machines

ROOT = Path(__file__).resolve().parents[2]
CASE = ROOT / "robots" / "arm_cmm"
JOB = "calibration.toml"
URDF = "arm_cmm.urdf"
TABLE = "identification.csv"

Edit = Callable[[Path], None]


class Said(NamedTuple):
    code: int
    out: str
    err: str


def run(*arguments: str | Path) -> Said:
    """Run ``calib`` with arguments as the console script does."""
    out, err = io.StringIO(), io.StringIO()
    code: object = 0
    with (
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
        mock.patch.object(sys, "argv", ["calib", *map(str, arguments)]),
    ):
        try:
            cli.main()
        except SystemExit as e:
            code = e.code
    assert code is None or isinstance(code, int)
    return Said(code or 0, out.getvalue(), err.getvalue())


def copy_case(folder: Path) -> Path:
    """Copy the files of the case into a folder and return the job's path."""
    folder.mkdir(parents=True, exist_ok=True)
    for name in (JOB, URDF, TABLE, "validation.csv"):
        shutil.copyfile(CASE / name, folder / name)
    return folder / JOB


def edit(name: str, *changes: tuple[str, str], everywhere: bool = False) -> Edit:
    """Return an edit that replaces texts in one file, each the first time it is there or everywhere."""

    def apply(folder: Path) -> None:
        path = folder / name
        text = path.read_text(encoding="utf-8")
        for old, new in changes:
            assert old in text, old
            text = text.replace(old, new, -1 if everywhere else 1)
        path.write_text(text, encoding="utf-8")

    return apply


def job(*changes: tuple[str, str]) -> Edit:
    """Return an edit of the job."""
    return edit(JOB, *changes)


def append(text: str, *changes: tuple[str, str]) -> Edit:
    """Return an edit that adds sections to the end of the job, after other changes."""

    def apply(folder: Path) -> None:
        job(*changes)(folder)
        path = folder / JOB
        path.write_text(path.read_text(encoding="utf-8") + text, encoding="utf-8")

    return apply


def write(name: str, contents: str | bytes) -> Edit:
    """Return an edit that replaces a file."""
    data = contents.encode() if isinstance(contents, str) else contents

    def apply(folder: Path) -> None:
        (folder / name).write_bytes(data)

    return apply


def write_table(path: Path, columns: Mapping[str, object]) -> None:
    """Write columns as a CSV file."""
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        writer.writerows(zip(*columns.values(), strict=True))


def cut(name: str, end: int) -> Edit:
    """Return an edit that truncates a file to its first bytes, or for a negative end takes away its last ones."""

    def apply(folder: Path) -> None:
        (folder / name).write_bytes((folder / name).read_bytes()[:end])

    return apply


def keep_rows(name: str, n: int) -> Edit:
    """Return an edit that leaves comments, header and the first n rows of a table."""

    def apply(folder: Path) -> None:
        lines = (folder / name).read_text(encoding="utf-8").splitlines(keepends=True)
        comments = [line for line in lines if line.startswith("#")]
        (folder / name).write_text(
            "".join([*comments, *lines[len(comments) : len(comments) + 1 + n]]), encoding="utf-8"
        )

    return apply


def tree(folder: Path) -> dict[str, str]:
    """Return every file and folder below a folder with the hash of its contents."""
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else "folder"
        for path in sorted(folder.rglob("*"))
    }


def by_another_machine(folder: Path) -> None:
    """Write a validation table by a machine that is just as its URDF says: calibration makes that one worse."""
    fit = identify(load(folder / JOB)).fit
    arm = machines.arm(str(folder / "arm_cmm.urdf"), "probe")
    machine = machines.Machine(arm, fit.nominal.frames.base, {"tool": fit.nominal.frames.tools[0]})
    readings = np.random.default_rng(1).uniform(-1.5, 1.5, (30, 6))
    columns = machines.table(arm, readings, machine.see(readings), "position")
    rows = np.column_stack([np.asarray(column) for column in columns.values()])
    lines = [", ".join(columns), *(", ".join(map(repr, map(float, row))) for row in rows)]
    write("validation.csv", "\n".join(lines) + "\n")(folder)
