"""Lines that name their numbers themselves: the first one was taken for the header, and a row was lost."""

from pathlib import Path

import pytest

from calib.foundations.errors import MeasurementError
from calib.measurement.formats.pairs import from_pairs
from calib.measurement.formats.sheet import read_sheet
from calib.measurement.raw import raw_table


@pytest.mark.parametrize(
    "text",
    [
        "J1=3.2;J2=-10.5;X=512.3\nJ1=4;J2=-1.5e1;X=-.5\n",
        "# a log\nJ1: 3.2 J2: -10.5 X: 512.3\n\nJ1: 4 J2: -1.5e1 X: -.5",
        "J1 = 3.2, J2 = -10.5, X = 512.3\r\nJ1 = 4, J2 = -1.5e1, X = -.5\r\n",
        "J1=3,2;J2=-10,5;X=512,3\nJ1=4;J2=-1,5e1;X=-.5\n",
    ],
)
def test_every_line_is_a_row(text: str, tmp_path: Path) -> None:
    (tmp_path / "log.txt").write_text(text)
    sheet = read_sheet(tmp_path / "log.txt")
    assert sheet.titles == ("J1", "J2", "X")
    assert [tuple(map(float, row)) for row in sheet.rows] == [(3.2, -10.5, 512.3), (4.0, -15.0, -0.5)]
    with pytest.raises(
        MeasurementError, match=r"log: has no header, as every line names its numbers; calib import log"
    ):
        raw_table(text.encode(), "log")


def test_units_behind_numbers_are_those_of_the_columns() -> None:
    found = from_pairs(b"J1=3.2\xc2\xb0 J2=-10.5 deg X=512.3mm\n", "log")
    assert found is not None
    assert found[0] == ["J1 [deg]", "J2 [deg]", "X [mm]"]


def test_names_may_have_points_and_a_number_may_be_none() -> None:
    found = from_pairs(b"p.x=1. p.y=NaN J1=3\np.x=2 p.y=-1 J1=4\n", "log")
    assert found is not None
    assert found[0] == ["p.x", "p.y", "J1"]
    assert list(map(tuple, found[1])) == [("1.", "", "3"), ("2", "-1", "4")]


def test_a_line_of_other_names_is_a_sentence() -> None:
    with pytest.raises(MeasurementError, match=r"log:3: has not the names of the first line, 'a, b, c'\."):
        from_pairs(b"a=1 b=2 c=3\na=1 b=2 c=3\na=1 c=2 b=3\n", "log")


@pytest.mark.parametrize(
    "text",
    [
        b"",
        b"a=1 b=2\n",
        b"rows=5 rate=10 dt=0.1\nJ1,J2,J3\n1,2,3\n",
        b"rows=5 rate=10 dt=0.1\nx=1 y=2 z=3\nJ1,J2,J3\n1,2,3\n",
        b"a=1 b=2 c=x\n",
        b"a=1 b=2 c=3 furlongs\n",
        b"1,2,3\n",
    ],
)
def test_other_texts_are_left_to_others(text: bytes) -> None:
    assert from_pairs(text, "log") is None
