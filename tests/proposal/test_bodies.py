"""Several points in a row: which of them belong to one body, and a table with a row for each."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat
from scipy.spatial.transform import Rotation

import calib
from calib.foundations.arrays import Array
from calib.measurement.bodies import _keep_their_distance, a_row_for_each_point, points_of_one_body
from calib.measurement.formats.sheet import Sheet, joined, read_sheet
from calib.measurement.raw import raw_table
from tests.support.cases import run
from tests.support.people import UR10, session, text

J = [f"J{k}" for k in range(1, 7)]
PLACES = np.array([[0.0, 0.0, 0.0], [0.05, 0.0, 0.01], [-0.02, 0.06, 0.03]])


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def reflectors(n: int = 40) -> list[Array]:
    """Return three points (N, 3) in mm of a flange, with noise of 0.02 mm."""
    s, chance = session(n=n), np.random.default_rng(3)
    return [1e3 * (s.position + s.rotation @ place) + 0.02 * chance.standard_normal((n, 3)) for place in PLACES]


def titles(form: str) -> list[str]:
    return [form.format(axis=axis, k=k) for k in (1, 2, 3) for axis in "xyz"]


@pytest.mark.parametrize(
    ("form", "names"),
    [
        ("{axis}{k} [mm]", ["point 1", "point 2", "point 3"]),
        ("SMR{k}_{axis} [mm]", ["SMR1", "SMR2", "SMR3"]),
        ("T{k} {axis} (mm)", ["T1", "T2", "T3"]),
        (None, ["point 1", "point 2", "point 3"]),
    ],
)
def test_a_row_for_each_reflector(folder: Path, form: str | None, names: list[str]) -> None:
    s, points = session(), reflectors()
    head = None if form is None else [*J, *titles(form)]
    (folder / "m.csv").write_text(text(head, [np.degrees(s.readings), *points]))
    asked = run("init", UR10, "m.csv", "--yes", "-o", "job.toml")
    assert asked.code == 1
    assert "3 points keep their distances, as reflectors on one body do: calib import m.csv --each-point" in asked.err
    said = run("import", "m.csv", "--each-point", "-o", "rows.csv")
    assert (said.code, said.err) == (0, "")
    found = read_sheet("rows.csv")
    assert [row[-1] for row in found.rows] == names * 40
    rows = np.array([row[6:9] for row in found.rows], dtype=float)
    np.testing.assert_allclose(rows, np.stack(points, axis=1).reshape(-1, 3), atol=1e-6)
    if form is None:
        tools_are_found(names)


def tools_are_found(names: list[str]) -> None:
    assert run("init", UR10, "rows.csv", "--yes", "-q", "-o", "job.toml") == (0, "", "")
    assert run("calibrate", "job.toml", "-o", "out", "-q").code == 0
    tools = calib.load_machine("out").tools
    assert sorted(tools) == sorted(names)
    places = np.stack([tools[name][:3, 3] for name in names])
    sides = np.linalg.norm(places - np.roll(places, 1, axis=0), axis=1)
    np.testing.assert_allclose(sides, np.linalg.norm(PLACES - np.roll(PLACES, 1, axis=0), axis=1), atol=1e-4)


def test_poses_are_held_out_whole_although_a_reflector_was_not_seen_in_some(folder: Path) -> None:
    s, (a, b, _) = session(), reflectors()
    rows = text([*J, "x1", "y1", "z1", "x2", "y2", "z2"], [np.degrees(s.readings), a, b]).splitlines()
    rows[3] = ",".join([*rows[3].split(",")[:-3], "", "", ""])
    (folder / "m.csv").write_text("\n".join(rows) + "\n")
    said = run("import", "m.csv", "--each-point", "-o", "rows.csv")
    assert "1 point has an empty cell and is left out." in said.out
    found = calib.measuring.propose(UR10, ["rows.csv"])
    data = calib.read_measurements("rows.csv", found.robot, columns=found.tables[0].columns, sigma=2e-5)
    assert len(data) == 79
    kept, held_out = calib.hold_out(data)
    own = {tuple(row) for row in kept.readings}
    assert held_out.tools == ("point 1", "point 2")
    assert not own & {tuple(row) for row in held_out.readings}


def test_what_is_beside_a_measured_point_is_no_second_one_of_its_body(folder: Path) -> None:
    """Commanded, in another frame, moved as a whole, or of a body that does not turn."""
    s, (a, b, _) = session(), reflectors()
    turned = a @ Rotation.from_rotvec([0.2, 0.1, 1.0]).as_matrix().T + [100.0, 20.0, 5.0]
    still = a + (b - a)[0]
    commanded = 1e3 * s.position + np.random.default_rng(2).normal(scale=2.0, size=a.shape)
    for other in (commanded, turned, still, a[::-1]):
        for head in ([*J, "x1", "y1", "z1", "x2", "y2", "z2"], None):
            raw = raw_table(text(head, [np.degrees(s.readings), a, other]).encode(), "m.csv")
            assert points_of_one_body(raw) == ()
    assert points_of_one_body(raw_table(text(None, [s.readings, a, b]).encode(), "m.csv")) == ((6, 7, 8), (9, 10, 11))
    few = [column[:5] for column in (s.readings, a, b)]
    assert points_of_one_body(raw_table(text(None, few).encode(), "m.csv")) == ()


@pytest.mark.parametrize(
    ("head", "said"),
    [
        (["x1", "y1", "z1", "x2 [mm]", "y2 [mm]", "z2 [mm]"], "are points of one body in several units"),
        (["a", "b", "c", "d", "e", "f"], "has no two points that keep their distance while they turn"),
    ],
)
def test_what_has_no_points_of_one_body_is_refused(folder: Path, head: list[str], said: str) -> None:
    (folder / "m.csv").write_text(text([*J, *head], [session().readings, *reflectors()[:2]]))
    code, out, err = run("import", "m.csv", "--each-point", "-o", "rows.csv")
    assert (code, out) == (1, "")
    assert said in err
    assert not (folder / "rows.csv").exists()


def test_many_points_beside_many_columns_make_no_table_without_end(folder: Path) -> None:
    """An archive of 180 kB, of rows that come again and again, asked for 320 million cells, and minutes."""
    turned = Rotation.random(8, random_state=1).as_matrix()
    places = np.einsum("nij,kj->nki", turned, np.random.default_rng(0).normal(size=(60, 3)))
    savemat(folder / "m.mat", {f"p{k}": np.tile(places[:, k], (250, 1)) for k in range(60)}, do_compression=True)
    titles = [f"rest {k}" for k in range(50)]
    sheet = joined(read_sheet("m.mat"), Sheet(tuple(titles), (("0",) * 50,) * 2000, "rest"))
    with pytest.raises(
        calib.MeasurementError,
        match=r"with a row for each of 61 points it has 6222000 values; allowed are 5000000; leave out columns that ",
    ):
        a_row_for_each_point(sheet)
    assert len(a_row_for_each_point(replace(sheet, size=6_222_000)).rows) == 122_000


def test_a_column_that_is_there_already_is_refused(folder: Path) -> None:
    words = np.array(["T"] * 40)
    titles = [*J, "tool", "x1", "y1", "z1", "x2", "y2", "z2"]
    (folder / "m.csv").write_text(text(titles, [session().readings, words, *reflectors()[:2]]))
    expected = "Error: m.csv: has a column 'tool' already; call it otherwise.\n"
    assert run("import", "m.csv", "--each-point", "-o", "rows.csv") == (1, "", expected)


def test_numbers_as_large_as_floats_are_no_points_of_a_body() -> None:
    rng = np.random.default_rng(0)
    p, q = rng.choice([1.7e308, -1.7e308], size=(2, 30, 3))
    assert not _keep_their_distance(p, q)
