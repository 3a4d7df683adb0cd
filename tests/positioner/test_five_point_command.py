"""``calib five-point``: the axes from a table of five places."""

import json
from pathlib import Path

import numpy as np
import pytest

import calib
from tests.positioner.test_positioner import points
from tests.support.cases import run

HEAD = "tilt [deg],rotary [deg],x [mm],y [mm],z [mm]"
TURNS = ((0, 0), (0, 60), (0, -60), (60, 0), (-60, 0))


def table(folder: Path, order: tuple[int, ...] = (0, 1, 2, 3, 4), **changed: str) -> Path:
    rows = [",".join([*map(str, TURNS[k]), *(f"{1e3 * x:.9f}" for x in points()[k])]) for k in order]
    path = folder / "five.csv"
    path.write_text("\n".join([HEAD, *rows, *changed.values()]) + "\n", encoding="utf-8")
    return path


@pytest.mark.parametrize("order", [(0, 1, 2, 3, 4), (4, 2, 0, 3, 1)])
def test_rows_say_by_their_readings_which_they_are(tmp_path: Path, order: tuple[int, ...]) -> None:
    said = run("five-point", table(tmp_path, order), "-o", tmp_path / "positioner.urdf", "--json")
    assert (said.code, said.err) == (0, "")
    found = json.loads(said.out)
    by_points = calib.positioner.five_point(*points())
    np.testing.assert_allclose(found["frames"]["B_R"], by_points.B_R, atol=1e-9)
    assert found["axes"]["tilt"]["direction"] == pytest.approx(by_points.B_L[:3, 2], abs=1e-9)
    machine = calib.load_robot(tmp_path / "positioner.urdf", "table")
    assert [reading.name for reading in machine.readings] == ["tilt", "rotary"]
    shown = run("five-point", table(tmp_path, order))
    assert "Axes in the robot's base" in shown.out


def test_an_axis_that_rests_need_not_read_zero(tmp_path: Path) -> None:
    path = table(tmp_path)
    exact = calib.positioner.five_point_of(path)
    resting = path.read_text(encoding="utf-8").replace("\n0,0,", "\n1e-90,-0.0002,").replace("\n60,0,", "\n60,1e-90,")
    path.write_text(resting, encoding="utf-8")
    np.testing.assert_array_equal(calib.positioner.five_point_of(path).B_R, exact.B_R)


@pytest.mark.parametrize(
    ("order", "more", "said"),
    [
        ((0, 1, 2, 3), "", "there is no P5 (tilt turned in its negative sense)."),
        ((0, 1, 2, 3, 4, 1), "", "five.csv:7: tilt 0 deg, rotary 60 deg: appears twice, as P2;"),
        ((0, 1, 2, 3, 4), "10,20,0,0,0", "five.csv:7: tilt 10 deg, rotary 20 deg: both axes are turned;"),
    ],
)
def test_other_rows_are_refused(tmp_path: Path, order: tuple[int, ...], more: str, said: str) -> None:
    path = table(tmp_path, order, **({"more": more} if more else {}))
    code, _, err = run("five-point", path, "-o", tmp_path / "positioner.urdf")
    assert code == 1
    assert said in err.replace("\n", " ")
    assert not (tmp_path / "positioner.urdf").exists()
