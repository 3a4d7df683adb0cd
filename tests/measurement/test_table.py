"""Tables: what is accepted, that every way in gives the same numbers, and one exact sentence for every refusal."""

import re
import time
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from calib.foundations.errors import MeasurementError
from calib.foundations.units import UNITS
from calib.measurement.cells import is_comment
from calib.measurement.layout import name_and_unit
from calib.measurement.table import Columns, Table, _split, read_table, table_from_arrays, table_from_frame

HEADER = "j1 [deg], x [mm], qw, tool"
ROWS = "90, 1.5, 1, tcp\n-45.25, 2e3, 0.5, ball\n"
ALLOWED = ", ".join(UNITS)


def write(folder: Path, content: str | bytes) -> Path:
    path = folder / "t.csv"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def same(a: Table, b: Table) -> bool:
    return list(a.columns) == list(b.columns) and all(
        np.array_equal(column.values, b.columns[name].values) and column.unit == b.columns[name].unit
        for name, column in a.columns.items()
    )


def test_values_are_si_read_only_and_know_their_line(tmp_path: Path) -> None:
    table = read_table(write(tmp_path, f"# a robot\n\n{HEADER}\n  # later\n{ROWS}"))
    assert list(table.columns) == ["j1", "x", "qw", "tool"]
    assert len(table) == 2
    assert table.lines.tolist() == [5, 6]
    np.testing.assert_allclose(table.columns["j1"].values, [np.pi / 2, np.deg2rad(-45.25)], rtol=1e-15)
    np.testing.assert_allclose(table.columns["x"].values, [1.5e-3, 2.0], rtol=1e-15)
    assert table.columns["tool"].values == ("tcp", "ball")
    assert table.columns["tool"].unit is None
    assert table.columns["qw"].unit.symbol == "1"
    with pytest.raises(ValueError, match="read-only"):
        table.columns["x"].values[0] = 0.0
    with pytest.raises(TypeError):
        table.columns["y"] = table.columns["x"]
    with pytest.raises(ValueError, match="read-only"):
        table.lines[0] = 0


PLAIN = f"{HEADER}\n{ROWS}"


@pytest.mark.parametrize(
    "content",
    [
        b"\xef\xbb\xbf" + PLAIN.encode(),
        PLAIN.replace("\n", "\r\n").encode(),
        PLAIN.replace("\n", "\r").encode(),
        PLAIN.rstrip("\n").encode(),
        PLAIN.replace(", ", ",").encode(),
        PLAIN.replace(",", " \t, ").encode(),
        PLAIN.replace("tcp", '"tcp"').replace("x [mm]", '" x  [ mm ] "').encode(),
        ("#;\n\n" + PLAIN.replace("\n", "\n\n  \t\n# x\n")).encode(),
    ],
    ids=["bom", "crlf", "cr", "no-newline", "tight", "wide", "quoted", "comments"],
)
def test_spellings_of_one_table(tmp_path: Path, content: bytes) -> None:
    plain = read_table(write(tmp_path, PLAIN))
    assert same(read_table(write(tmp_path, content)), plain)


@pytest.mark.parametrize(
    "content",
    [
        PLAIN.replace(",", "\t").encode(),
        PLAIN.replace(",", "|").encode(),
        PLAIN.encode("utf-16"),
        PLAIN.replace("[mm]", "(MM)").replace("[deg]", "/\u00b0").encode("cp1252"),
        PLAIN.replace(" [mm]", "_mm").replace(" [deg]", " deg").encode(),
        ("Exported by somebody\n// 2024\n% x\n" + PLAIN).encode(),
        PLAIN.replace(" [mm]", "").replace(" [deg]", "").replace("\n", "\ndeg,mm,,\n", 1).encode(),
    ],
    ids=["tabs", "bars", "UTF-16", "cp1252", "suffixes", "exporter", "line of units"],
)
def test_dialects_of_one_table(tmp_path: Path, content: bytes) -> None:
    plain = read_table(write(tmp_path, PLAIN))
    found = read_table(write(tmp_path, content))
    assert found.columns.keys() == plain.columns.keys()
    assert all(np.array_equal(found.columns[name].values, plain.columns[name].values) for name in plain.columns)


@pytest.mark.parametrize(
    "cell",
    [
        *("#N/A", "#NV", "#DIV/0!", "#WERT!", "#NAME?", "#####"),
        *("#¡VALOR!", "#ИМЯ?", "#NÉV?", "#N/D", "#Н/Д", "#n/a", "#GETTING_DATA"),  # of other languages, and programs
    ],
)
@pytest.mark.parametrize("separator", [",", ";", "\t", "|"])
def test_a_row_that_begins_with_an_error_of_a_spreadsheet_is_no_comment(
    tmp_path: Path, cell: str, separator: str
) -> None:
    """Else the row would be left out, and nobody told."""
    rows = (HEADER, "90, 1.5, 1, tcp", f"{cell}, 2e3, 0.5, ball")
    path = write(tmp_path, "\n".join(row.replace(", ", separator) for row in rows))
    with pytest.raises(MeasurementError, match=rf":3: column 'j1': '{re.escape(cell)}' is not a number"):
        read_table(path)


@pytest.mark.parametrize(
    "comment", ["#x, y, z", "#m/s, deg", "#Achtung!, neu", "# N/A, 1", "#rate 30", "#gravity, 0, 0, -9.81", "#90, 1, 2"]
)
def test_comments_without_a_blank_stay_comments(comment: str) -> None:
    assert is_comment(comment)
    assert not is_comment("#DIV/0! 1 2")  # cells may be separated by blanks


def test_a_unit_below_the_header_that_contradicts_it_is_refused(tmp_path: Path) -> None:
    for title in ("x [mm]", "x (mm)", "x_mm"):
        path = write(tmp_path, f"j1,{title},y\ndeg,m,mm\n1,2,3\n2,3,4\n")
        with pytest.raises(MeasurementError, match=r":2: column 'x.*' has the unit mm in its title, and m below; keep"):
            read_table(path)
    assert read_table(write(tmp_path, "j1,x [mm]\ndeg,mm\n1,2\n2,3\n")).columns["x"].values.tolist() == [2e-3, 3e-3]


def test_all_that_is_wrong_with_a_header_is_said_at_once(tmp_path: Path) -> None:
    path = write(tmp_path, "J1,J2,x [foot],y [mm],y [m]\n1,2,3,4,5\n")
    with pytest.raises(MeasurementError) as caught:
        read_table(path, Columns({"z [mm]": "Z"}, ("nothing",)))
    said = str(caught.value)
    for part in (
        "'J1', 'J2' have no unit",
        "unit 'foot'",
        "'y' appears more than once",
        "no column 'Z'",
        "'nothing' to",
    ):
        assert part in said


def test_columns_are_passed_over_when_they_are_named(tmp_path: Path) -> None:
    path = write(tmp_path, "x [mm],Remark,No\n1,ok,\n2,,7\n")
    table = read_table(path, Columns(ignore=("Remark", "No")))
    assert list(table.columns) == ["x"]
    assert table.columns["x"].values.tolist() == [1e-3, 2e-3]


def test_a_title_that_stands_twice_is_passed_over_as_often_as_it_is_named(tmp_path: Path) -> None:
    """The second was refused, with the advice to ignore what was ignored already."""
    path = write(tmp_path, "x [mm],N,N\n1,2,3\n")
    assert list(read_table(path, Columns(ignore=("N", "N"))).columns) == ["x"]
    with pytest.raises(MeasurementError, match="column 'N' has no unit"):
        read_table(path, Columns(ignore=("N",)))
    once = write(tmp_path, "x [mm],N\n1,2\n")
    assert list(read_table(once, Columns(ignore=("N", "N"))).columns) == ["x"]


@pytest.mark.parametrize("title", ["[mm]", " [deg] ", "x [mm] [deg]", "n" * 300])
def test_a_column_that_is_no_name_with_a_unit_can_be_passed_over_or_named(title: str, tmp_path: Path) -> None:
    """It was said not to be there, with the advice to ignore it."""
    path = tmp_path / "t.csv"
    path.write_text(f"a [mm],{title}\n1,2\n")
    assert list(read_table(path, Columns(ignore=(title.strip(),))).columns) == ["a"]
    named = read_table(path, Columns({"b [deg]": title.strip()}))
    assert named.columns["b"].values == pytest.approx([np.radians(2.0)])
    with pytest.raises(MeasurementError, match="column 'b' has no unit"):
        read_table(path, Columns({"b": title.strip()}))
    with pytest.raises(MeasurementError, match=r"^[^;]*$"):
        read_table(path)


def test_words_may_be_unicode_and_hold_commas_when_quoted(tmp_path: Path) -> None:
    table = read_table(write(tmp_path, 'x [m], group\n1, "a, b"\n2, Größe\n'))
    assert table.columns["group"].values == ("a, b", "Größe")


def test_frame_arrays_and_file_agree(tmp_path: Path) -> None:
    path = write(tmp_path, PLAIN)
    table = read_table(path)
    frame = pd.read_csv(path, skipinitialspace=True)
    arrays = {"j1 [deg]": [90, -45.25], "x [mm]": (1.5, 2e3), "qw": np.array([1, 0.5]), "tool": ["tcp", "ball"]}
    assert same(table_from_frame(frame), table)
    assert same(table_from_frame(frame.set_index("tool", drop=False).astype(object)), table)
    assert same(table_from_frame(pd.read_csv(path, skipinitialspace=True, dtype=str)), table)
    assert same(table_from_arrays(arrays), table)
    assert table_from_frame(frame).lines.tolist() == [0, 1]
    assert table_from_frame(pd.DataFrame({"group": [1, 2]})).columns["group"].values == ("1", "2")


def test_the_arrays_given_are_copied() -> None:
    values = np.array([1.0, 2.0])
    table = table_from_arrays({"x [m]": values})
    values[0] = 9.0
    assert table.columns["x"].values.tolist() == [1.0, 2.0]


@pytest.mark.parametrize(("coarse", "fine", "factor"), [("m", "mm", 1e3), ("rad", "deg", 180 / np.pi)])
def test_the_unit_does_not_change_the_value(coarse: str, fine: str, factor: float) -> None:
    values = np.random.default_rng(1).normal(size=500)
    a = table_from_arrays({f"c [{coarse}]": values}).columns["c"].values
    b = table_from_arrays({f"c [{fine}]": factor * values}).columns["c"].values
    np.testing.assert_allclose(a, b, rtol=1e-15, atol=0.0)


def test_doubles_survive_the_file(tmp_path: Path) -> None:
    values = np.random.default_rng(2).normal(size=100) * 10.0 ** np.arange(-96, 4)
    path = write(tmp_path, "x [m]\n" + "\n".join(map(repr, values.tolist())))
    assert np.array_equal(read_table(path).columns["x"].values, values)


def test_renaming_reads_headers_of_somebody_else(tmp_path: Path) -> None:
    path = write(tmp_path, "Joint A1, measurement_x [mm], Q.W, station\n90, 1.5, 1, tcp\n-45.25, 2e3, 0.5, ball\n")
    columns = {"j1 [deg]": "Joint A1", "x": "measurement_x", "qw": "Q.W", "tool": "station"}
    assert same(read_table(path, columns), read_table(write(tmp_path, PLAIN)))
    frame = pd.DataFrame({"Tx (mm)": [1.0]})
    assert table_from_frame(frame, columns={"x [mm]": "Tx (mm)"}).columns["x"].values.tolist() == [1e-3]


def test_a_later_table_may_state_a_unit_that_the_measurements_did_not(tmp_path: Path) -> None:
    """A job says the unit of a column called `j1`; one that is called `j1 [deg]` in another table has its own."""
    columns = Columns({"j1 [rad]": "j1", "x [mm]": "x"}, where_present=True)
    path = write(tmp_path, "j1 [deg], x\n180, 1\n")
    found = read_table(path, columns).columns
    assert found["j1"].values.tolist() == [np.pi] and found["x"].values.tolist() == [1e-3]
    with pytest.raises(MeasurementError, match="has another unit"):
        read_table(path, {"j1 [rad]": "j1", "x [mm]": "x"})


@pytest.mark.parametrize(
    ("columns", "sentence"),
    [
        ({"x": "mesurement_x"}, "there is no column 'mesurement_x' to read as 'x'; near is 'measurement_x [mm]'."),
        ({"x": "nothing"}, "there is no column 'nothing' to read as 'x'."),
        ({"x [m]": "measurement_x"}, "column 'measurement_x [mm]' is renamed to 'x [m]', which has another unit."),
        ({"y": "measurement_x"}, "column 'y' appears more than once."),
        (
            {"x": "measurement_x", "z": "measurement_x"},
            "the renaming gives one column two names: {'x': 'measurement_x', 'z': 'measurement_x'}.",
        ),
    ],
)
def test_renaming_is_refused(columns: dict[str, str], sentence: str) -> None:
    with pytest.raises(MeasurementError) as caught:
        table_from_arrays({"measurement_x [mm]": [1.0], "y [mm]": [1.0]}, columns=columns)
    assert str(caught.value) == f"arrays: {sentence}"


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        ("", ": is empty; a table starts with a header line."),
        ("# only\n\n", ": has comments, and no rows."),
        ("#\n" * 220_000 + "x [m]\n1\n", ": begins with comments, and no header line is among the first 200 lines."),
        ("x [m]\n# none\n", ": has a header and no rows."),
        (
            "x [mm],reached,reason\n1,yes,\n",
            ":1: 'reached' and 'reason' are words of commands, as calib compensate writes them; give the table it was "
            "made of.",
        ),
        ("x\n1\n", ":1: column 'x' has no unit; write one in brackets, like 'x [mm]' or '[deg]'."),
        ("time\n1\n", ":1: column 'time' has no unit; write one in brackets, like 'time [s]' or '[ms]'."),
        ("point\n1\n", ":1: column 'point' has no unit; write one in brackets, like 'point [mm]' or '[deg]'."),
        ("x []\n1\n", ":1: column 'x' has no unit; write one in brackets, like 'x [mm]' or '[deg]'."),
        ("x [foot]\n1\n", f":1: column 'x': unit 'foot' is not known; allowed are {ALLOWED}."),
        ("tool [mm]\na\n", ":1: column 'tool' holds words and takes no unit, but has [mm]."),
        ("x [m\n1\n", ":1: the header 'x [m' is not a name with a unit, like 'x [mm]'."),
        ("x [m] [m]\n1\n", ":1: the header 'x [m] [m]' is not a name with a unit, like 'x [mm]'."),
        ("x [m],,y [m]\n1,2,3\n", ":1: a column has no name (is there a comma too many?)."),
        ("x [m], [m]\n1,2\n", ":1: a column has no name (is there a comma too many?)."),
        ("\n#\nx [m], y [m], x [mm]\n1,2,3\n", ":3: column 'x' appears more than once."),
        ("x [m], y [m]\n1,2\n\n3\n5,6\n", ":4: the header has 2 cells and this row has 1."),
        ("x [m], y [m]\n1,2,\n", ":2: the header has 2 cells and this row has 3."),
        (
            "x [m], y [m]\n1,5,2,5\n",
            ":2: the header has 2 cells and this row has 4; if these are decimal commas, write points, or separate the "
            "cells by semicolons.",
        ),
        (
            "x [m], y [m]\n1,2\n3",
            ":3: the header has 2 cells and this row has 1, and the file ends within this row: it seems truncated.",
        ),
        ("x [m], y [m]\n1,2\n3,\n", ":3: column 'y': the cell is empty."),
        ("x [m], tool\n1,tcp\n3,\n", ":3: column 'tool': the cell is empty."),
        ('x [m], y [m]\n"1,5",2\n', ":2: column 'x': '1,5' has a decimal comma; write a point."),
        ('x [m], y [m]\n"1, 2\n3,4\n', ":2: a quote is not closed, or something follows it."),
        ('x [m], y [m]\n"1"1, 2\n3,4\n', ":2: a quote is not closed, or something follows it."),
        (b"x [m]\n1\n\x81\n", ":3: is not UTF-8 text; save it as UTF-8."),
        (b"\xef\xbb\xbf# \x81\nx [m]\n1\n", ":1: is not UTF-8 text; save it as UTF-8."),
        (b"x [m]\r1\r\0\n", ":3: has a NUL byte; a table is UTF-8 text."),
        ("x [m]\n1\n".encode("utf-16")[:-1], ": is not whole UTF-16 text; save it as UTF-8."),
        ("x [m]\n1\n".encode("utf-16-le"), ":1: has a NUL byte; a table is UTF-8 text."),
        ("x [m]\n" + "1" * 200_000 + "\n", ":2: is longer than the 100000 characters that are allowed."),
        ("x [m]\n1\n" + '"' + "1\n" * 100, ":3: a quote is not closed, or something follows it."),
        ("x [m]\n1\n1e999\n", ":3: column 'x': 1e999 is not a finite number."),
        *(
            (f"x [m]\n1\n{cell}\n", f":3: column 'x': {cell!r} is not a number like 12.5 or 1.25e1.")
            for cell in (
                "nan",
                "inf",
                "-Infinity",
                "1_0",
                "１２",
                "0x10",
                "1e",
                "1 2",
                "--1",
                "1.5mm",
                "1d5",
                "tcp",
                "1;2",
            )
        ),
    ],
)
def test_bad_files_give_one_sentence(tmp_path: Path, content: str | bytes, sentence: str) -> None:
    path = write(tmp_path, content)
    with pytest.raises(MeasurementError) as caught:
        read_table(path)
    assert str(caught.value) == f"{path}{sentence}"


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    for path, sentence in ((tmp_path / "no.csv", "there is no such file."), (tmp_path, "is not a regular file.")):
        with pytest.raises(MeasurementError) as caught:
            read_table(path)
        assert str(caught.value) == f"{path}: {sentence}"


@pytest.mark.parametrize(
    ("frame", "sentence"),
    [
        (pd.DataFrame({"x [m]": [1.0, np.nan]}), "DataFrame:1: column 'x': nan is not a finite number."),
        (pd.DataFrame({"x [m]": [1.0, np.inf]}), "DataFrame:1: column 'x': inf is not a finite number."),
        (pd.DataFrame({"x [m]": [1, "a"]}), "DataFrame:1: column 'x': 'a' is not a number like 12.5 or 1.25e1."),
        (
            pd.DataFrame({"x [m]": [1, None]}, dtype=object),
            "DataFrame:1: column 'x': 'None' is not a number like 12.5 or 1.25e1.",
        ),
        (pd.DataFrame({"x [m]": [True]}), "DataFrame:0: column 'x': 'True' is not a number like 12.5 or 1.25e1."),
        (pd.DataFrame({"x [m]": [1 + 0j]}), "DataFrame:0: column 'x': '(1+0j)' is not a number like 12.5 or 1.25e1."),
        (pd.DataFrame({"group": ["a", np.nan]}, dtype=object), "DataFrame:1: column 'group': nan is not a word."),
        (pd.DataFrame({"group": [1.0]}), "DataFrame:0: column 'group': 1.0 is not a word."),
        (pd.DataFrame({"group": ["a", " "]}), "DataFrame:1: column 'group': the cell is empty."),
        (pd.DataFrame({0: [1.0]}), "DataFrame: the column label 0 is not text."),
        (pd.DataFrame([[1, 2]], columns=["x [m]", "x [m]"]), "DataFrame: column 'x [m]' appears more than once."),
        (pd.DataFrame({"x [m]": [1.0], "x [mm]": [1.0]}), "DataFrame: column 'x' appears more than once."),
        (pd.DataFrame({"x [m]": []}), "DataFrame: has a header and no rows."),
        (pd.DataFrame(), "DataFrame: has a header and no rows."),
    ],
)
def test_bad_frames_give_one_sentence(frame: pd.DataFrame, sentence: str) -> None:
    with pytest.raises(MeasurementError) as caught:
        table_from_frame(frame)
    assert str(caught.value) == sentence


@pytest.mark.parametrize(
    ("arrays", "shapes"),
    [
        ({"x [m]": [1.0], "y [m]": [1.0, 2.0]}, "'x [m]' (1,), 'y [m]' (2,)"),
        ({"x [m]": 1.0}, "'x [m]' ()"),
        ({"x [m]": [[1.0]]}, "'x [m]' (1, 1)"),
    ],
)
def test_arrays_of_other_shapes_are_refused(arrays: dict[str, object], shapes: str) -> None:
    with pytest.raises(MeasurementError) as caught:
        table_from_arrays(arrays)
    assert str(caught.value) == f"arrays: the columns are not one-dimensional and equally long: {shapes}."


def test_a_long_table_is_read(tmp_path: Path) -> None:
    row = ",".join(map(repr, np.random.default_rng(3).normal(size=12).tolist()))
    header = ",".join(f"c{i} [m]" for i in range(12)) + ",group"
    path = write(tmp_path, header + "\n" + f"{row},a\n" * 20_000)
    assert len(read_table(path)) == 20_000


def test_names_may_have_brackets(tmp_path: Path) -> None:
    """As joints of models that number their fingers: what is in the last brackets is the unit."""
    file = tmp_path / "table.csv"
    file.write_text("finger[0] [deg],[a-c]? [mm],b[1]x[2][m]\n180,2,3\n", encoding="utf-8")
    table = read_table(file)
    assert list(table.columns) == ["finger[0]", "[a-c]?", "b[1]x[2]"]
    # A number behind a name is its own, and no unit; what has none anyway may say so.
    file.write_text("j[1] [deg],j[2] [deg],qw[1],qx [1]\n180,2,3,4\n", encoding="utf-8")
    assert list(read_table(file).columns) == ["j[1]", "j[2]", "qw", "qx"]
    file.write_text("j[1],j[2],x [mm]\n180,2,3\n", encoding="utf-8")
    with pytest.raises(MeasurementError, match=r"columns 'j\[1\]', 'j\[2\]' have no unit"):
        read_table(file)
    renamed = {"a [deg]": "j[1]", "b [deg]": "j[2]"}
    assert list(read_table(file, renamed).columns) == ["a", "b", "x"]
    # Words have no unit, and all brackets are of the name.
    file.write_text("direction_finger[0],direction_finger[1],tau_finger[0] [Nm]\n+,-,3\n", encoding="utf-8")
    assert list(read_table(file).columns) == ["direction_finger[0]", "direction_finger[1]", "tau_finger[0]"]
    file.write_text("direction_finger[0] [deg]\n+\n", encoding="utf-8")
    with pytest.raises(MeasurementError, match=r"column 'direction_finger\[0\]' holds words and takes no unit"):
        read_table(file)
    start = time.process_time()
    with pytest.raises(MeasurementError):
        _split("[a]" * 200_000 + "[")
    assert time.process_time() - start < 5.0


def test_headers_of_blanks_are_read_at_once(tmp_path: Path) -> None:
    """An expression whose parts share characters would take hours of these."""
    blanks = " " * 45_000
    for title in (f"y{blanks}[{blanks}", f"{blanks}y{blanks}]", f"y{blanks}({blanks}", f"y{'_' * 90_000}!"):
        begun = time.process_time()
        with pytest.raises(MeasurementError):
            read_table(write(tmp_path, f"x [mm],{title}\n1,2\n"))
        assert time.process_time() - begun < 5.0


@pytest.mark.parametrize(
    ("title", "found"),
    [
        ("x [ mm ]", ("x", "mm")),
        ("x ( mm )", ("x", "mm")),
        ("x / mm", ("x", "mm")),
        ("x (a) (mm)", ("x (a)", "mm")),
        ("J1 \u00b0", ("J1", "deg")),
        ("x__ mm", ("x", "mm")),
        ("_mm", ("_mm", None)),
        ("(mm)", ("(mm)", None)),
    ],
)
def test_units_behind_names(title: str, found: tuple[str, str | None]) -> None:
    assert (_split(title) if "[" in title else name_and_unit(title)) == found
