"""An arm as the instrument: its readings become positions in its base, and bad ones one sentence."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import calib
from calib.foundations.errors import MeasurementError
from calib.job.arm import read_arm
from calib.job.inputs import load
from calib.job.read import read_job
from calib.machine.calibrated import CalibratedMachine
from calib.machine.grid import grid_from_residuals
from calib.machine.touching import TouchingArm, touched
from calib.measurement.measurements import Measurements
from calib.measurement.table import read_table
from calib.robot.conditions import in_order
from calib.robot.joint_terms import with_joint_terms
from calib.robot.terms import JointTerm
from tests.support.cases import CASE as ARM_CASE
from tests.support.cases import ROOT, Edit, edit, run, tree, write

CASE = ROOT / "robots" / "positioner"
JOB = "calibration.toml"
TABLE = "touched.csv"
ARM = 'urdf = "welder.urdf"       # or model = "out/", the folder that its own calibration wrote\ntip = "flange"\n'
PIVOT = 'pivot = "pivot.csv"        # the tip comes first: one point touched in several orientations\n'
FILES = (JOB, TABLE, "validation.csv", "pivot.csv", "welder.urdf", "positioner.urdf")


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "job").mkdir()
    for name in FILES:
        shutil.copyfile(CASE / name, tmp_path / "job" / name)
    monkeypatch.chdir(tmp_path / "job")
    return tmp_path / "job"


def arm_readings(name: str) -> np.ndarray:
    table = read_table(CASE / name)
    return np.column_stack([np.asarray(table.columns[f"joint_{k}"].values, dtype=float) for k in range(1, 7)])


def test_positions_are_the_arms_tool_point_in_its_base(folder: Path) -> None:
    point = np.array([0.004, -0.003, 0.21])
    edit(JOB, (PIVOT, 'point = ["4 mm", "-3 mm", "210 mm"]\n'))(folder)
    (touched,) = load(folder / JOB).identify
    T = calib.load_robot(CASE / "welder.urdf", "flange").tips(arm_readings(TABLE))
    assert np.abs(touched.position - (T[:, :3, :3] @ point + T[:, :3, 3])).max() < 1e-15
    assert np.unique(touched.sigma).tolist() == [1e-4]
    assert touched.reading_names == ("tilt", "rotary")
    assert touched.tools == ("A", "B")


def test_what_a_table_says_of_the_touched_robot_is_not_lost(folder: Path) -> None:
    """Its link, and the order of its rows, which tells from which side joints were reached."""
    whole = load(folder / JOB).identify[0]
    for file in ("touched", "validation"):
        table = f'file = "{file}.csv"\n'
        edit(JOB, (table, f'{table}in_order = true\ntip = "cradle"\n'))(folder)
    data = load(folder / JOB).identify[0]
    assert data.tip == "cradle"
    assert data.conditions.approach is not None
    # But for the first rows, in which one joint moves alone: nothing says from where the other one was reached.
    sides = in_order(whole.readings)
    assert np.array_equal(data.conditions.approach, sides[np.all(sides != 0.0, axis=1)])
    assert len(data) > 0.8 * len(whole)


def test_pivot_finds_the_spike(folder: Path) -> None:
    inputs = load(folder / JOB)
    # The script's spike; the pivot's cone seats it to 0.05 mm per coordinate.
    spike = np.array([5.3, -3.8, 212.4]) * 1e-3
    T = calib.load_robot(CASE / "welder.urdf", "flange").tips(arm_readings(TABLE))
    off = inputs.identify[0].position - (T[:, :3, :3] @ spike + T[:, :3, 3])
    assert np.linalg.norm(off, axis=1).max() < 0.15e-3
    assert {"pivot.csv", "welder.urdf"} <= set(inputs.hashes)
    assert {path.name for path in inputs.files} == set(FILES)
    # The tables have a tenth of a degree, as dials show it.
    assert {finding.code for finding in inputs.findings} == {"rounded-readings"}


def test_folder_of_results_as_the_arm(folder: Path) -> None:
    """The arm CMM, calibrated by its own job with a tracker, touches: what its model predicts is what counts."""
    arm = folder.parent / "arm"
    assert run("calibrate", ARM_CASE / JOB, "-o", arm).code == 0
    model = calib.load_machine(arm)
    readings = np.random.default_rng(0).uniform(-1.0, 1.0, (12, 6))
    lines = [", ".join([*(f"joint_{k} [rad]" for k in range(1, 7)), "tilt [rad]", "rotary [rad]"])]
    lines += [", ".join(map(repr, [*map(float, row), float(row[0]), float(row[1])])) for row in readings]
    write(TABLE, "\n".join([*lines, ""]))(folder)
    shutil.copyfile(folder / TABLE, folder / "validation.csv")
    edit(JOB, (ARM + PIVOT, 'model = "../arm"\ntool = "tool"\n'))(folder)
    section = read_job(folder / JOB).instruments["welder"]
    found = read_arm("welder", section, folder)
    in_tracker = model.predict(readings)
    expected = np.linalg.inv(model.base) @ in_tracker
    assert np.abs(found.arm.points(readings) - expected[:, :3, 3]).max() < 1e-12
    assert sorted(found.files) == ["../arm/model.json", "../arm/nominal.urdf"]
    edit(JOB, ('tool = "tool"', 'tool = "spike"'))(folder)
    said = run("check", JOB)
    assert said.err == (
        "Error: calibration.toml: instruments.welder.tool: 'spike' is not a tool of the arm; it has 'tool'.\n"
    )


def test_residual_grid_of_the_arm_counts() -> None:
    """What a grid adds in the instrument's frame is carried to the arm's base."""
    robot = calib.load_robot(CASE / "welder.urdf", "flange")
    rng = np.random.default_rng(1)
    nodes = np.array([(a, b) for a in (-1.0, 0.0, 1.0) for b in (-1.0, 0.0, 1.0)])
    readings = np.column_stack([nodes, np.zeros((9, 4))])
    errors = rng.normal(scale=1e-3, size=(9, 3))
    grid = grid_from_residuals(readings, errors, robot.readings, ["joint_1", "joint_2"], "base")
    base = np.array([[0.0, -1.0, 0.0, 3.0], [1.0, 0.0, 0.0, -2.0], [0.0, 0.0, 1.0, 0.5], [0.0, 0.0, 0.0, 1.0]])
    model = CalibratedMachine(robot, robot.no_deviations(), base, {}, None)
    plain = TouchingArm(model, np.zeros(3), 1e-4)
    bent = replace(plain, machine=replace(model, residual_model=grid))
    assert np.abs(bent.points(readings) - plain.points(readings) - errors).max() < 1e-12


def test_backlash_and_a_grid_of_the_arm_count_in_its_table(folder: Path) -> None:
    """The arm takes its own sides of approach from the table, the robot those of its own joints."""
    half = 1e-3  # of the gap
    robot = with_joint_terms(calib.load_robot(CASE / "welder.urdf", "flange"), [JointTerm("joint_2", "backlash")])
    coefficients = replace(robot.no_deviations(), terms=np.array([half]))
    nodes = np.array([(a, b) for a in (-4.0, 0.0, 4.0) for b in (-4.0, 0.0, 4.0)])
    errors = np.random.default_rng(2).normal(scale=1e-3, size=(9, 3))
    grid = grid_from_residuals(
        np.column_stack([nodes, np.zeros((9, 4))]), errors, robot.readings, ["joint_1", "joint_2"], "base"
    )
    point = np.array([0.0, 0.0, 0.2])
    arm = TouchingArm(CalibratedMachine(robot, coefficients, np.eye(4), {}, grid), point, 1e-4)
    positioner = calib.load_robot(CASE / "positioner.urdf", "table")
    rows = [row for row in (folder / TABLE).read_text(encoding="utf-8").splitlines() if not row.startswith("#")]
    path = folder / "sides.csv"

    def seen(titles: str, cells: tuple[str, ...]) -> Measurements:
        lines = [rows[0] + titles, *(row + cells[k % len(cells)] for k, row in enumerate(rows[1:]))]
        path.write_text("\n".join([*lines, ""]), encoding="utf-8")
        return touched(path, arm, positioner, {})[0]

    found = seen(", direction_joint_2, direction_tilt", (", +, -", ", -, +"))
    q = arm_readings(TABLE)
    side = np.where(np.arange(len(q)) % 2, -1.0, 1.0)
    q_true = q + half * side[:, None] * (np.arange(6) == 1)
    T = robot.tips(q_true)
    expected = T[:, :3, :3] @ point + T[:, :3, 3] + grid.at(q)
    assert np.abs(found.position - expected).max() < 1e-12
    assert found.conditions.approach is not None
    assert found.conditions.approach[:, 0].tolist() == (-side).tolist()
    with pytest.raises(MeasurementError, match=r"sides.csv: there is no column 'direction_joint_2'"):
        seen(", direction_tilt", (", -",))


SENTENCES: dict[str, tuple[Edit, str]] = {
    "both models": (edit(JOB, (ARM, ARM + 'model = "arm"\n')), "calibration.toml: instruments.welder: an arm has "
                    "either a model, the folder of its results, or a urdf."),
    "no model": (edit(JOB, (ARM, "")), "calibration.toml: instruments.welder: an arm has either a model, the folder of "
                 "its results, or a urdf."),
    "no tool": (edit(JOB, (ARM + PIVOT, 'model = "arm"\n')), "calibration.toml: instruments.welder: where the arm's "
                "tool point is, one of tool, point and pivot says."),
    "two tools": (edit(JOB, (PIVOT, PIVOT + 'point = ["0 m", "0 m", "0 m"]\n')), "calibration.toml: "
                  "instruments.welder: where the arm's tool point is, one of tool, point and pivot says."),
    "tool of a urdf": (edit(JOB, (PIVOT, 'tool = "spike"\n')), "calibration.toml: instruments.welder.tool: a urdf has "
                       "no tools; give a point on its tip, or a pivot."),
    "tracker's key": (edit(JOB, (PIVOT, PIVOT + 'station = ["0 m", "0 m", "0 m"]\n')), "calibration.toml: "
                      'instruments.welder.station: has no effect with kind = "arm"; leave it out.'),
    "arm's key": (edit(JOB, ('kind = "arm"', 'kind = "laser_tracker"')), "calibration.toml: instruments.welder.urdf: "
                  'has no effect with kind = "laser_tracker"; leave it out.'),
    "poses": (edit(JOB, ('file = "touched.csv"\n', 'file = "touched.csv"\nobserves = "pose"\n')), "calibration.toml: "
              'measurements[0].observes: an arm that touches sees positions only; write "position".'),
    "no such folder": (edit(JOB, (ARM + PIVOT, 'model = "arm"\ntool = "tool"\n')),
                       "arm/model.json: there is no such file."),
    "joint missing": (edit(TABLE, ("joint_4 [deg]", "joint_7 [deg]")), "touched.csv: there is no column 'joint_4' of "
                      "the arm that touches; the columns are 'joint_1', 'joint_2', 'joint_3', 'joint_7', 'joint_5', "
                      "'joint_6', 'tilt', 'rotary', 'tool'."),
    "position twice": (edit(TABLE, ("tool\n", "x [mm]\n"), (", A", ", 0"), (", B", ", 0"), everywhere=True),
                       "touched.csv: column 'x' is there, and the instrument, an arm, gives it as well; keep one of "
                       "them."),
    "common joint": (edit("positioner.urdf", ("tilt", "joint_1"), everywhere=True),
                     "touched.csv: 'joint_1' is a joint of the arm that touches and of the robot; rename one in its "
                     "URDF."),
    "degrees as radians": (edit(TABLE, *((f"joint_{k} [deg]", f"joint_{k} [rad]") for k in range(1, 7))),
                           "divided by 57.3 all its rows fit: the numbers seem to be degrees, not [rad]"),
    "pivot of lengths": (write("pivot.csv", (ARM_CASE / "lengths.csv").read_bytes()),
                         "pivot.csv: is a length test; a pivot is one point, touched in many orientations."),
}  # fmt: skip


@pytest.mark.parametrize("name", SENTENCES)
def test_bad_arms_are_one_sentence(folder: Path, name: str) -> None:
    spoil, sentence = SENTENCES[name]
    spoil(folder)
    before = tree(folder)
    said = run("calibrate", JOB, "-o", "out")
    assert (said.code, said.out) == (1, "")
    assert said.err.startswith("Error: ")
    assert said.err.endswith(f"{sentence}\n") or (name == "degrees as radians" and sentence in said.err)
    assert tree(folder) == before


def test_pivot_about_one_axis_is_refused(folder: Path) -> None:
    lines = (folder / "pivot.csv").read_text(encoding="utf-8").splitlines()
    *_, first = lines[3].split(", ")
    cells = lines[3].split(", ")
    turned = [", ".join([*cells[:5], f"{float(cells[5]) + 20 * k:.4f}", first]) for k in range(6)]
    write("pivot.csv", "\n".join([*lines[:3], *turned, ""]))(folder)
    said = run("check", JOB)
    assert said.code == 1
    assert said.err == (
        "Error: pivot.csv: the orientations turn about one axis only, and do not show where the tool point is along "
        "it; touch the point with the tool tilted in several ways.\n"
    )


def test_pivot_that_scatters_is_told(folder: Path) -> None:
    edit(JOB, ('sigma = "0.1 mm" ', 'sigma = "0.01 mm" '))(folder)
    said = run("check", JOB)
    assert said.code == 0
    assert "pivot.csv: the touches scatter by" in said.out


def test_job_is_written_out_and_results_do_not_replace_the_arm(folder: Path) -> None:
    assert run("calibrate", JOB, "-o", "../out", "-q").code == 0
    job = json.loads((folder.parent / "out" / "job.json").read_text(encoding="utf-8"))
    assert job["instruments"]["welder"]["pivot"] == "pivot.csv"
    result = json.loads((folder.parent / "out" / "result.json").read_text(encoding="utf-8"))
    assert {"pivot.csv", "welder.urdf"} <= set(result["inputs"])
    table = job["measurements"][0]["file"]
    said = run("verify", "../out", table)
    assert (said.code, said.out) == (1, "")
    assert f"{table}: rows that 'welder' touched are not verified; name this table" in said.err
