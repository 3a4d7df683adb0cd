"""Tables as spreadsheets, other continents and other people write them."""

import os
import shutil
import subprocess
import sys
import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from calib import dh
from calib.foundations.errors import MeasurementError, RobotError
from calib.job.inputs import load
from calib.job.run import run as calibrate
from calib.measurement.table import Table, read_table
from calib.results.folder import residual_table, result_json
from tests.support.cases import CASE, JOB, ROOT

HEADER = "joint_1 [deg], x [mm], tool\n"


def read(tmp_path: Path, contents: str | bytes) -> Table:
    path = tmp_path / "t.csv"
    path.write_bytes(contents.encode() if isinstance(contents, str) else contents)
    return read_table(path)


def said(tmp_path: Path, contents: str | bytes) -> str:
    with pytest.raises(MeasurementError) as caught:
        read(tmp_path, contents)
    sentence = str(caught.value).removeprefix(str(tmp_path / "t.csv"))
    assert "\n" not in sentence
    assert len(sentence) < 1000
    return sentence


def test_a_table_as_a_german_spreadsheet_saves_it(tmp_path: Path) -> None:
    german = read(tmp_path, "\ufeffjoint_1 [deg];x [mm];tool\r\n12,5;-1,25e2;links\r\n-3;,5;rechts\r\n")
    plain = read(tmp_path, "joint_1 [deg],x [mm],tool\n12.5,-125,links\n-3,.5,rechts\n")
    for name in ("joint_1", "x"):
        np.testing.assert_array_equal(german.columns[name].values, plain.columns[name].values)
    assert german.columns["tool"].values == ("links", "rechts")
    with_points = read(tmp_path, "joint_1 [deg];x [mm];tool\n12.5;-125;links\n-3;.5;rechts\n")
    np.testing.assert_array_equal(with_points.columns["x"].values, plain.columns["x"].values)


@pytest.mark.parametrize(
    ("contents", "sentence"),
    [
        # 1.234 is a thousand or one and a quarter: whoever mixes has to say which.
        (
            "x [mm];y [mm]\n1,5;2\n3;1.234\n",
            ":3: column 'y': '1.234' has a decimal point, and {}:2, column 'x', has a decimal comma; use one of "
            "them in the whole file, and no mark between thousands.",
        ),
        (
            "x [mm];y [mm]\n1;2\n1.234,5;3\n",
            ":3: column 'x': '1.234,5' has a decimal comma, and the same cell has a decimal point; use one of them in "
            "the whole file, and no mark between thousands.",
        ),
        ("x [mm];y [mm]\n1,2,3;4\n", ":2: column 'x': '1.2.3' is not a number like 12.5 or 1.25e1."),
        ("x [mm];y [mm]\n1,5\n", ":2: the header has 2 cells and this row has 1."),
        (
            "x [mm],y [mm]\n1,5,2,5\n",
            ":2: the header has 2 cells and this row has 4; if these are decimal commas, write points, or separate the "
            "cells by semicolons.",
        ),
    ],
)
def test_decimal_commas_that_leave_doubts(tmp_path: Path, contents: str, sentence: str) -> None:
    assert said(tmp_path, contents) == sentence.format(tmp_path / "t.csv")


MATLAB = ": is of MATLAB, and no text; calib import makes a table of it, where its name ends with .mat."


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("mark", ["", "\ufeff"])
def test_line_ends_and_marks(tmp_path: Path, end: str, mark: str) -> None:
    table = read(tmp_path, mark + end.join(["joint_1 [deg]", "# it's fine", "", "1", "2", ""]))
    assert table.lines.tolist() == [4, 5]


@pytest.mark.parametrize(
    ("contents", "sentence"),
    [
        ((HEADER + "1, 2, a\n").encode("utf-16")[:-1], ": is not whole UTF-16 text; save it as UTF-8."),
        (b"MATLAB 5.0 MAT-file, Platform: PCWIN64" + bytes(90), MATLAB),
        (b"MATLAB 7.3 MAT-file, Platform: GLNXA64" + bytes(90), MATLAB),
        (
            b"\x89HDF\r\n\x1a\n" + bytes(20),
            ": is HDF5, and no text; numpy.savez writes an .npz, of which calib import makes a table.",
        ),
        (b"\x1f\x8b\x08" + bytes(20), ": is packed by gzip, and no text; unpack it: gzip -d."),
        (
            b"\x93NUMPY\x01\0" + bytes(20),
            ": is an array of NumPy, and no text; numpy.savez writes an .npz, of which calib import makes a table.",
        ),
        ((HEADER + "1, 2, a\n").encode("utf-16-le"), ":1: has a NUL byte; a table is UTF-8 text."),
        ((HEADER + "1, 2, M\u0081ller\n").encode("latin-1"), ":2: is not UTF-8 text; save it as UTF-8."),
        (HEADER + "1, 2, a\0b\n", ":2: has a NUL byte; a table is UTF-8 text."),
        (HEADER + '1, 2, "a\n', ":2: a quote is not closed, or something follows it."),
        (HEADER + '1, 2, "a"b\n', ":2: a quote is not closed, or something follows it."),
        (HEADER + "1, 1e400, a\n", ":2: column 'x': 1e400 is not a finite number."),
        (HEADER + "1, 1e300, a\n", ":2: column 'x': 1e300 is out of range; allowed is -10000 to 10000 m."),
        (HEADER + f"1, {'9' * 5000}, a\n", f":2: column 'x': {'9' * 60}... is not a finite number."),
        (HEADER + "1, nan, a\n", ":2: column 'x': 'nan' is not a number like 12.5 or 1.25e1."),
        (HEADER + "1, -inf, a\n", ":2: column 'x': '-inf' is not a number like 12.5 or 1.25e1."),
        (HEADER + "1, \u0661\u0662, a\n", ":2: column 'x': '\u0661\u0662' is not a number like 12.5 or 1.25e1."),
        (HEADER + f"1, 2, {'a' * 201}\n", f":2: column 'tool': '{'a' * 60}...' is longer than 200 characters."),
        (f"{'a' * 201} [mm]\n1\n", f":1: the header '{'a' * 60}...' is longer than 200 characters."),
        (",".join(f"c{k} [mm]" for k in range(5000)) + "\n", ":1: has 5000 columns; allowed are 1000."),
        (HEADER + "1" * 3_000_000, ":2: is longer than the 100000 characters that are allowed."),
        ("1" * 3_000_000, ":1: is longer than the 100000 characters that are allowed."),
    ],
)
def test_what_cannot_be_read_is_said(tmp_path: Path, contents: str | bytes, sentence: str) -> None:
    assert said(tmp_path, contents) == sentence


@pytest.mark.parametrize("block", [7, 64, 1000])
def test_lines_are_counted_over_blocks_and_their_ends(
    tmp_path: Path, block: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A table is read in blocks, which must not split a line, a character or a CRLF."""
    monkeypatch.setattr("calib.measurement.cells._BLOCK", block)
    row = '1.5, 2.5, "\u00e9, \U0001f916"'
    for end in ("\n", "\r\n", "\r"):
        rows = [row] * 600
        table = read(tmp_path, end.join([HEADER.rstrip(), *rows]))
        assert table.lines.tolist() == list(range(2, 602))
        assert set(table.columns["tool"].values) == {"\u00e9, \U0001f916"}
        rows[500] = "1.5, 2.5"
        assert said(tmp_path, end.join([HEADER.rstrip(), *rows])) == (
            ":502: the header has 3 cells and this row has 2."
        )
        rows[500], rows[-1] = row, "1.5, 2.5"
        assert said(tmp_path, end.join([HEADER.rstrip(), *rows])).endswith("it seems truncated.")


def test_memory_is_the_file_and_its_numbers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Twice the rows, twice the numbers, the same memory beside; scripts/benchmarks/large_table.py reads more."""

    monkeypatch.setattr("calib.measurement.cells._BLOCK", 50_000)

    def peak(rows: int) -> tuple[int, int]:
        path = tmp_path / f"{rows}.csv"
        path.write_text("x [mm],y [mm],z [mm]\n" + "-123.456789,2345.6789,0.00012\n" * rows, encoding="utf-8")
        tracemalloc.start()
        try:
            table = read_table(path)
            return tracemalloc.get_traced_memory()[1], path.stat().st_size + 8 * len(table) * 4
        finally:
            tracemalloc.stop()

    (few, least), (many, most) = peak(5_000), peak(20_000)
    assert many - few < 1.7 * (most - least)


def test_a_row_of_a_dh_table_that_begins_with_an_error_of_a_spreadsheet_is_no_comment() -> None:
    """The arm would have a joint less, and nobody be told."""
    rows = "a [mm],d [mm],alpha [deg],theta [deg]\n0,100,90,0\n#DIV/0!,0,0,0\n# 1,2,3,4\n0,100,0,0\n"
    with pytest.raises(RobotError, match=r"^dh\.csv:3: column 'a': '#DIV/0!' is not a number"):
        dh.parse_dh(rows.encode(), "dh.csv")
    assert len(dh.parse_dh(rows.replace("#DIV/0!", "# 0").encode(), "dh.csv").rows) == 2


def test_a_dh_table_of_another_encoding_and_without_end() -> None:
    good = b"joint, type, a [mm], d [mm], alpha [deg], theta [deg]\n"
    row = b"j%d, revolute, 0, 0, 0, 0\n"
    for source, why in (
        (good.decode().encode("utf-16"), "is not UTF-8 text; save it as UTF-8."),
        (good + b"j\0, revolute, 0, 0, 0, 0\n", "has a NUL byte after 55 characters; a DH table is UTF-8 text."),
        (good + b"\xe4, revolute, 0, 0, 0, 0\n", "is not UTF-8 text; save it as UTF-8."),
        (good + b"j, revolute, 1e999, 0, 0, 0\n", "DH table: joint 'j' has a number that is not finite."),
        (good + b"1" * 5000, "is longer than the 2000 characters that are allowed."),
        (good + b"".join(row % k for k in range(201)), "has 201 rows; allowed are 200."),
    ):
        with pytest.raises(RobotError) as caught:
            dh.parse_dh(source, "t.csv")
        assert str(caught.value).endswith(why)


_PROGRAM = f"""
from pathlib import Path
from calib.job.inputs import load
from calib.results.folder import residual_table, result_json
from calib.job.run import run
outcome = run(load(Path({str(CASE / JOB)!r})))
print(result_json(outcome), residual_table(outcome), sep="", end="")
"""


@pytest.mark.skipif(shutil.which("localedef") is None, reason="makes the locale by localedef")
def test_a_german_process_writes_the_same_numbers(tmp_path: Path) -> None:
    made = subprocess.run(
        ["localedef", "-i", "de_DE", "-f", "UTF-8", str(tmp_path / "de_DE.UTF-8")], capture_output=True, check=False
    )
    if made.returncode and not (tmp_path / "de_DE.UTF-8").is_dir():
        pytest.skip("the system has no sources of locales")
    ran = subprocess.run(
        [sys.executable, "-c", f"import locale; locale.setlocale(locale.LC_ALL, ''); print(f'{{1.5:n}}'); {_PROGRAM}"],
        env=os.environ | {"LOCPATH": str(tmp_path), "LC_ALL": "de_DE.UTF-8", "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=True,
    )
    outcome = calibrate(load(CASE / JOB))
    expected = [*result_json(outcome).splitlines(), *residual_table(outcome).splitlines()]
    assert ran.stdout.splitlines() == ["1,5", *expected]
