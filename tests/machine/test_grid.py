"""The residual grid: exact where it must be, silent nowhere else."""

import io
import itertools
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.interpolate import RegularGridInterpolator

from calib.foundations.errors import CalibError, JobError, MeasurementError, OutputError
from calib.machine import grid
from calib.machine.grid import SectorGrid, grid_from_residuals, load_grid
from calib.measurement.table import read_table
from calib.robot.robot import Reading

Array = NDArray[np.float64]

READINGS = (
    Reading("j1", "angle", -3.0, 3.0),
    Reading("slide", "length", 0.0, 1.0),
    Reading("j3", "angle", None, None),
    Reading("j4", "angle", -2.0, 2.0),
)
AXES = {"j1": np.radians(np.arange(-60, 61, 20)), "slide": np.array([0.1, 0.3, 0.5]), "j4": np.radians([-30, 0, 30])}
JOINTS = ("j1", "slide", "j4")
NODES = Path(__file__).parents[2] / "robots" / "irb2400" / "nodes.csv"


def nodes() -> Array:
    rows = np.array(list(itertools.product(*AXES.values())))
    return np.column_stack([rows[:, :2], np.full(len(rows), 0.7), rows[:, 2]])


def multilinear(readings: Array) -> Array:
    a, b, c = readings[:, 0], readings[:, 1], readings[:, 3]
    return 1e-4 * np.stack([1 + a - 2 * b + 3 * a * b * c, a * c, b - c + 0.5], axis=1)


def smooth(readings: Array) -> Array:
    a, b, c = readings[:, 0], readings[:, 1], readings[:, 3]
    return 1e-4 * np.stack([np.sin(a + b), np.cos(c) * b, np.sin(a) * np.cos(c)], axis=1)


def made(field: Callable[[Array], Array] = multilinear, **options: Any) -> SectorGrid:
    rows = nodes()
    return grid_from_residuals(rows, field(rows), READINGS, JOINTS, **options)


def inside(n: int = 300, seed: int = 3) -> Array:
    rng = np.random.default_rng(seed)
    low, high = np.array([(axis[0], axis[-1]) for axis in AXES.values()]).T
    points = rng.uniform(low, high, (n, 3))
    return np.column_stack([points[:, :2], rng.uniform(-3, 3, n), points[:, 2]])


def test_exact_on_multilinear_fields_and_at_nodes() -> None:
    known, points, rows = made(), inside(), nodes()
    assert np.abs(known.at(points) - multilinear(points)).max() < 1e-12
    assert np.abs(made(smooth).at(rows) - smooth(rows)).max() < 1e-18
    assert known.outside(points) == ("",) * len(points)
    assert np.nan_to_num(known.reference, nan=9.0).tolist() == [9.0, 9.0, 0.7, 9.0]
    assert [len(axis) for axis in known.axes] == [7, 3, 3]


def test_the_order_of_rows_does_not_matter() -> None:
    rows, order = nodes(), np.random.default_rng(4).permutation(63)
    shuffled = grid_from_residuals(rows[order], smooth(rows)[order], READINGS, JOINTS)
    assert np.array_equal(shuffled.errors, made(smooth).errors)
    # The order of the joints is that of the axes only.
    turned = grid_from_residuals(rows, smooth(rows), READINGS, ("j4", "j1", "slide"))
    assert np.abs(turned.at(inside()) - made(smooth).at(inside())).max() < 1e-18


def test_readings_that_jitter_are_on_the_grid() -> None:
    rows = nodes()
    jitter = np.random.default_rng(5).uniform(-1e-5, 1e-5, rows.shape)
    jittered = grid_from_residuals(rows + jitter, smooth(rows), READINGS, JOINTS)
    assert np.abs(jittered.at(inside(), clamp=True) - made(smooth).at(inside())).max() < 1e-8


def test_uneven_nodes_when_given() -> None:
    uneven = {**AXES, "slide": np.array([0.1, 0.15, 0.5])}
    rows = np.array(list(itertools.product(*uneven.values())))
    rows = np.column_stack([rows[:, :2], np.zeros(len(rows)), rows[:, 2]])
    known = grid_from_residuals(rows, multilinear(rows), READINGS, JOINTS, axes={"slide": uneven["slide"]})
    assert np.abs(known.at(inside()) - multilinear(inside())).max() < 1e-12
    with pytest.raises(MeasurementError, match=r"not on the grid|are missing"):
        grid_from_residuals(rows, multilinear(rows), READINGS, JOINTS)


def test_smooth_fields_are_nearly_reproduced() -> None:
    known, points = made(smooth), inside()
    assert np.linalg.norm(known.at(points) - smooth(points), axis=1).max() < 5e-6


def test_cells_are_interpolated_as_scipy_does() -> None:
    known, points = made(smooth), np.concatenate([inside(), nodes()])
    interpolated = RegularGridInterpolator(known.axes, known.errors)(points[:, list(known.joints)])
    assert np.array_equal(known.at(points), interpolated)


def test_outside() -> None:
    known = made()
    points = inside(4)
    points[1, 0], points[2, 1] = np.radians(61.0), 0.05
    points[3, 0] = np.radians(60.0) + 1e-12
    values = known.at(points)
    assert np.isnan(values).all(axis=1).tolist() == [False, True, True, False]
    assert known.outside(points) == (
        "",
        "j1 at 61 deg is outside the grid, from -60 deg to 60 deg",
        "slide at 50 mm is outside the grid, from 100 mm to 500 mm",
        "",
    )
    edge = points.copy()
    edge[1, 0], edge[2, 1] = np.radians(60.0), 0.1
    assert np.abs(known.at(points, clamp=True) - known.at(edge)).max() < 1e-12


def test_whole_turns_do_not_lead_out_of_it_where_they_bring_back_all_that_follows(tmp_path: Path) -> None:
    rows = nodes()
    turning = [replace(reading, turns=reading.name == "j1") for reading in READINGS]
    known = grid_from_residuals(rows, multilinear(rows), turning, JOINTS)
    (tmp_path / "grid.npz").write_bytes(grid.grid_bytes(known))
    points = inside(4)
    away = points + 2.0 * np.pi * np.outer([0, 1, -1, 2], [1, 0, 0, 0])
    for one in (known, load_grid(tmp_path / "grid.npz", turning)):
        assert np.abs(one.at(away) - one.at(points)).max() < 1e-15
        assert one.outside(away) == ("",) * 4
        assert np.abs(one.leaning(away).weights - one.leaning(points).weights).max() < 1e-12
    beyond = away[1:2].copy()
    beyond[0, 0] = 2.0 * np.pi + np.radians(61.0)
    assert known.outside(beyond) == ("j1 at 421 deg is outside the grid, from -60 deg to 60 deg",)
    # What follows j1 by half, say, is elsewhere after one turn.
    assert all(made().outside(away)[1:])


def test_missing_nodes() -> None:
    rows = nodes()
    some = np.ones(len(rows), dtype=bool)
    some[[0, 30]] = False
    with pytest.raises(MeasurementError) as caught:
        grid_from_residuals(rows[some], smooth(rows)[some], READINGS, JOINTS, where="nodes.csv")
    assert str(caught.value) == (
        "nodes.csv: 2 of the 63 nodes of the grid are missing, the first at j1 -60 deg, slide 100 mm, j4 -30 deg."
    )
    known = grid_from_residuals(rows[some], smooth(rows)[some], READINGS, JOINTS, partial=True)
    full, points = made(smooth), inside()
    values = known.at(points)
    there = ~np.isnan(values[:, 0])
    assert 0.4 < there.mean() < 0.95
    assert np.abs(values - full.at(points))[there].max() < 1e-18
    reason = known.outside(points)[int(np.argmin(there))]
    assert reason.startswith("the cell j1 ")
    assert reason.endswith(" has a corner that was not measured")
    # Faces of whole cells belong to them.
    face = np.array([[AXES["j1"][1], 0.2, 0.0, AXES["j4"][0] + 0.1]])
    assert not np.isnan(known.at(face)).any()
    assert np.isfinite(known.at(points, clamp=True)).all()


def test_the_nodes_of_the_irb2400() -> None:
    table = read_table(NODES)
    names = [f"joint_{k}" for k in range(1, 7)]
    rows = np.stack([np.asarray(table.columns[name].values, dtype=float) for name in names], axis=1)
    robot = [Reading(name, "angle", None, None) for name in names]
    with pytest.raises(MeasurementError, match=r"\d+ of the \d+ nodes of the grid are missing"):
        grid_from_residuals(rows, np.zeros((600, 3)), robot, names[:3])
    field = 1e-4 * np.stack([rows[:, 0], rows[:, 1], rows[:, 2]], axis=1)
    known = grid_from_residuals(rows, field, robot, names[:3], partial=True)
    assert np.count_nonzero(known.measured) == 600
    assert np.abs(known.at(rows) - field).max() < 1e-15
    test = read_table(NODES.with_name("test.csv"))
    points = np.stack([np.asarray(test.columns[name].values, dtype=float) for name in names], axis=1)
    assert np.isfinite(known.at(points)).all()


def changed(change: Callable[[Array, Array], tuple[Array, Array] | None], **options: Any) -> str:
    rows, errors = nodes(), smooth(nodes())
    rows, errors = change(rows, errors) or (rows, errors)
    lines = np.arange(len(rows)) + 2
    joints = options.pop("joints", JOINTS)
    with pytest.raises(CalibError) as caught:
        grid_from_residuals(rows, errors, READINGS, joints, where=[f"n.csv:{line}" for line in lines], **options)
    said = str(caught.value)
    assert said.endswith(".")
    return said


def put(row: int, column: int, value: float) -> Callable[[Array, Array], None]:
    def apply(rows: Array, errors: Array) -> None:
        rows[row, column] = value

    return apply


def test_rows_that_are_no_grid() -> None:
    assert changed(put(4, 0, np.radians(-53.0))) == (
        "n.csv:6: j1 at -53 deg is not on the grid, which starts at -60 deg with steps of 20 deg."
    )
    assert changed(put(4, 2, 0.8)) == (
        "n.csv:6: j3 stands at 45.8366 deg and elsewhere at 40.107 deg; "
        "a joint that is not one of the grid's must stand still."
    )
    assert changed(put(0, 2, 0.8)).startswith("n.csv:2: j3 stands at 45.8366 deg")
    again = changed(lambda rows, errors: (np.vstack([rows, rows[5]]), np.vstack([errors, errors[5]])))
    assert again == "n.csv:65: the node j1 -60 deg, slide 300 mm, j4 30 deg appears twice, first at n.csv:7."
    assert changed(lambda rows, errors: (rows[:3], errors[:3])) == (
        "n.csv:2: j1 stands at -60 deg in all rows; a joint of the grid must have at least two nodes."
    )
    many = np.tile(nodes()[0], (2001, 1))
    many[:, 0] = np.linspace(-1.0, 1.0, 2001)
    assert changed(lambda rows, errors: (many, np.zeros((2001, 3)))) == (
        "n.csv:2: j1 stands anywhere between -57.2958 deg and 57.2958 deg; "
        "a joint of the grid must have at least two nodes."
    )
    assert "must be finite numbers" in changed(put(0, 0, np.nan))
    assert "must have the shapes (N, 4) and (N, 3)" in changed(lambda rows, errors: (rows[:, :3], errors))
    assert "must have the shapes" in changed(lambda rows, errors: (rows[:0], errors[:0]))


def test_options_that_cannot_be_used() -> None:
    def same(rows: Array, errors: Array) -> None:
        return None

    assert changed(same, frame="world") == "the frame of a residual model is 'world'; allowed are base, tip."
    assert "cannot follow 'j2'" in changed(same, joints=("j2",))
    assert "each named once" in changed(same, joints=("j1", "j1"))
    assert "must be at least one" in changed(same, joints=())
    assert "nodes are given for 'j3'" in changed(same, axes={"j3": [0.0, 1.0]})
    assert "two ascending numbers" in changed(same, axes={"j1": [1.0, 0.0]})
    with pytest.raises(JobError):
        made(frame="nowhere")


def test_a_grid_over_many_joints_is_refused_where_it_is_made_and_read(tmp_path: Path) -> None:
    """A cell has 2^k corners: of a grid of twenty joints, packed 30 kB, a dozen readings took minutes and 5 GB."""
    readings = tuple(Reading(f"j{k}", "angle", -3.0, 3.0) for k in range(9))
    corners = np.array(list(itertools.product((-1.0, 1.0), repeat=9)))
    names, errors = [reading.name for reading in readings], np.zeros((len(corners), 3))
    with pytest.raises(JobError, match="a grid of residuals spans 8 joints at most, and 9 are named"):
        grid_from_residuals(corners, errors, readings, names)
    known = grid_from_residuals(corners[::2], errors[::2], readings, names[:8])
    assert np.array_equal(known.at(corners[:5], clamp=True), errors[:5])
    shape = (2,) * 9
    axes, measured = known.axes + known.axes[:1], np.ones(shape, dtype=bool)
    wide = replace(known, joints=tuple(range(9)), axes=axes, errors=np.zeros((*shape, 3)), measured=measured)
    (tmp_path / "grid.npz").write_bytes(grid.grid_bytes(replace(wide, reference=np.full(9, np.nan))))
    with pytest.raises(OutputError, match="it spans more than 8 joints"):
        load_grid(tmp_path / "grid.npz")


# ---- files


def arrays(known: SectorGrid) -> dict[str, Any]:
    with np.load(io.BytesIO(grid.grid_bytes(known)), allow_pickle=False) as file:
        return dict(file)


def test_round_trip(tmp_path: Path) -> None:
    rows = nodes()
    known = grid_from_residuals(rows[1:], smooth(rows)[1:], READINGS, JOINTS, "tip", partial=True)
    (tmp_path / "grid.npz").write_bytes(grid.grid_bytes(known))
    again = load_grid(tmp_path / "grid.npz")
    assert (again.readings, again.joints, again.frame) == (known.readings, known.joints, "tip")
    assert np.array_equal(again.errors, known.errors)
    assert np.array_equal(again.measured, known.measured)
    assert np.array_equal(again.at(inside()), known.at(inside()), equal_nan=True)
    assert not again.errors.flags.writeable
    assert not again.measured.flags.writeable
    assert grid.grid_bytes(again) == (tmp_path / "grid.npz").read_bytes()


def test_the_grid_of_another_robot(tmp_path: Path) -> None:
    (tmp_path / "grid.npz").write_bytes(grid.grid_bytes(made()))
    assert load_grid(tmp_path / "grid.npz", READINGS).joints == (0, 1, 3)
    with pytest.raises(OutputError) as caught:
        load_grid(tmp_path / "grid.npz", READINGS[:3])
    assert str(caught.value).endswith(
        "is the grid of a robot with the joints j1, slide, j3, j4, and this one has j1, slide, j3."
    )


HOSTILE: dict[str, tuple[dict[str, Any], str]] = {
    "another schema": ({"schema": np.array(2)}, "its schema is not 1"),
    "text for the schema": ({"schema": np.array("1")}, "schema has a wrong type"),
    "another frame": ({"frame": np.array("world")}, "its frame is not one of base, tip"),
    "a key more": ({"code": np.zeros(3)}, "and nothing else"),
    "a key less": ({"axes": None}, "and nothing else"),
    "objects": ({"errors": np.array([{}, print], dtype=object)}, "an array is not what its header says"),
    "complex": ({"errors": np.zeros((7, 3, 3, 3), dtype=complex)}, "holds no numbers"),
    "integers": ({"errors": np.zeros((7, 3, 3, 3), dtype=int)}, "errors has a wrong type"),
    "NaN": ({"errors": np.full((7, 3, 3, 3), np.nan)}, "an error is not a finite number"),
    "a node less": ({"errors": np.zeros((6, 3, 3, 3))}, "its errors are not those of its nodes"),
    "nothing measured": ({"measured": np.zeros((7, 3, 3), dtype=bool)}, "its errors are not those of its nodes"),
    "descending": ({"axes": np.arange(13.0)[::-1].copy()}, "its nodes do not ascend"),
    "lengths": ({"lengths": np.array([7, 3, 4])}, "its axes are not"),
    "negative lengths": ({"lengths": np.array([-7, 10, 10])}, "its axes are not"),
    "a joint too far": ({"joints": np.array([0, 1, 4])}, "its joints are not different ones"),
    "a joint twice": ({"joints": np.array([0, 1, 1])}, "its joints are not different ones"),
    "dimension": ({"dimensions": np.array([["j1", "mass"]] * 4)}, "no names and dimensions"),
    "reference": ({"reference": np.zeros(4)}, "its reference is not"),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_contents(name: str, tmp_path: Path) -> None:
    change, why = HOSTILE[name]
    contents = {key: value for key, value in (arrays(made()) | change).items() if value is not None}
    np.savez(tmp_path / "grid.npz", **contents)
    with pytest.raises(OutputError) as caught:
        load_grid(tmp_path / "grid.npz")
    said = str(caught.value)
    assert said.startswith(f"{tmp_path / 'grid.npz'}: is not a residual grid of this toolkit: ")
    assert why in said
    assert said.endswith(".")


def test_files_that_are_none(tmp_path: Path) -> None:
    path, whole = tmp_path / "grid.npz", grid.grid_bytes(made())
    bent = bytearray(whole)
    bent[whole.index(made().errors.tobytes()) + 100] ^= 0xFF
    empty = io.BytesIO()
    with zipfile.ZipFile(empty, "w"):
        pass
    for data in (b"", b"x,y\n1,2\n", whole[:-30], whole[: len(whole) // 2], bytes(bent), empty.getvalue()):
        path.write_bytes(data)
        with pytest.raises(OutputError, match="is not a residual grid of this toolkit"):
            load_grid(path)
    with pytest.raises(OutputError, match="there is no such file"):
        load_grid(tmp_path / "no.npz")


def test_a_header_that_promises_more_than_there_is(tmp_path: Path) -> None:
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": "<f8", "fortran_order": False, "shape": (10**15,)})
    with zipfile.ZipFile(tmp_path / "grid.npz", "w") as archive:
        for key in arrays(made()):
            archive.writestr(f"{key}.npy", header.getvalue())
    with pytest.raises(OutputError, match="an array is not what its header says"):
        load_grid(tmp_path / "grid.npz")
