"""Other ways through a job: DH parameters, and the total differential as solver."""

import json
from pathlib import Path

import numpy as np
import pytest

import calib
from tests.support.cases import CASE, copy_case, edit, run


def test_dh_parameters_come_back_as_a_table(tmp_path: Path) -> None:
    job = copy_case(tmp_path / "job")
    edit("calibration.toml", ('offsets = "all"\n', ""), ('placements = "all"', 'dh = "all"'))(job.parent)
    assert run("calibrate", job, "-o", tmp_path / "out", "-q") == (0, "", "")
    model = calib.load_machine(tmp_path / "out")
    table = calib.dh.read_dh(tmp_path / "out" / "calibrated_dh.csv")
    assert run("dh", tmp_path / "out" / "calibrated_dh.csv", "-o", tmp_path / "again.urdf", "-q") == (0, "", "")
    again = calib.load_robot(tmp_path / "again.urdf")
    q = np.random.default_rng(0).uniform(-2.0, 2.0, (20, 6))
    expected = np.linalg.inv(table.base) @ model.tips(q) @ np.linalg.inv(table.tool)
    np.testing.assert_allclose(again.tips(q), expected, atol=1e-11)
    names = [record["name"] for record in json.loads((tmp_path / "out" / "result.json").read_text())["parameters"]]
    assert {"joint_1.a", "joint_1.d", "joint_1.alpha", "joint_1.offset"} <= set(names)


def test_the_total_differential_tells_its_iterations(tmp_path: Path) -> None:
    job = copy_case(tmp_path / "job")
    edit(
        "calibration.toml",
        ('placements = "all"', 'placements = "none"'),
        # The zeros of the outer joints cannot be told from base and tool, and this solver wants all to be seen.
        ('offsets = "all"', 'offsets = ["joint_[2-5]"]'),
        ("[[measurements]]", '[solver]\nkind = "total_differential"\nstop = "1 mm"\n\n[[measurements]]'),
    )(job.parent)
    said = run("calibrate", job, "-o", tmp_path / "out")
    assert "Stopped after" in said.out
    trace = json.loads((tmp_path / "out" / "result.json").read_text())["trace"]
    largest = [at["largest"] for at in trace["iterations"]]
    assert largest[-1] < 0.1 * largest[0]
    # Offsets alone leave what the placements do, so this limit is out of reach and the result is not to be trusted.
    assert (trace["reason"] == "below the limit") == (said.code == 0)


@pytest.mark.parametrize(
    ("solver", "sentence"),
    [
        ('kind = "newton"', "solver.kind: 'newton' is not allowed"),
        ('kind = "total_differential"\nstop = "-1 mm"', "solver.stop: '-1 mm' is not above 0"),
        ('kind = "total_differential"\nmost = 0', "solver.most: 0 is not a whole number from 1 to 1000"),
    ],
)
def test_a_wrong_solver_is_refused(solver: str, sentence: str, tmp_path: Path) -> None:
    job = copy_case(tmp_path)
    edit("calibration.toml", ("[[measurements]]", f"[solver]\n{solver}\n\n[[measurements]]"))(job.parent)
    said = run("calibrate", job, "-o", tmp_path / "out")
    assert (said.code, said.out) == (1, "")
    assert sentence in said.err


def test_sensitivity_and_performance(tmp_path: Path) -> None:
    assert run("calibrate", CASE / "calibration_realistic.toml", "-o", tmp_path / "out", "-q").code == 0
    said = run(
        "performance",
        tmp_path / "out",
        CASE / "cone.csv",
        CASE / "lengths.csv",
        "--probe",
        CASE / "probe.csv",
        "--json",
    )
    figures = json.loads(said.out)
    assert all(
        abs(a["value"]) < abs(b["value"]) / 100 for b, a in zip(figures["before"], figures["after"], strict=True)
    )
    plot = tmp_path / "plot.svg"
    said = run("sensitivity", CASE / "calibration.toml", "--plot", plot, "--json")
    by_name = {record["name"]: record for record in json.loads(said.out)["parameters"]}
    assert by_name["base.x"]["rms"] == pytest.approx(1.0)
    assert plot.read_text().startswith("<?xml")
    again = tmp_path / "again.svg"
    assert run("sensitivity", CASE / "calibration.toml", "--plot", again, "-q").code == 0
    assert again.read_bytes() == plot.read_bytes()
    assert run("sensitivity", CASE / "calibration.toml", "--plot", tmp_path / "plot.txt").code == 1
    plot.write_text("mine")
    said = run("sensitivity", CASE / "calibration.toml", "--plot", plot)
    assert said == (1, "", f"Error: {plot}: already exists; choose another name.\n")
    assert plot.read_text() == "mine"


def test_commands_are_corrected(tmp_path: Path) -> None:
    assert run("calibrate", CASE / "calibration.toml", "-o", tmp_path / "out", "-q").code == 0
    targets = tmp_path / "targets.csv"
    rows = ["joint_1 [deg],joint_2 [deg],joint_3 [deg],joint_4 [deg],joint_5 [deg],joint_6 [deg]", "5,40,40,-60,60,50"]
    targets.write_text("\n".join([*rows, ""]))
    said = run("compensate", tmp_path / "out", targets, "-o", tmp_path / "corrected.csv")
    assert said.code == 0
    assert said.out.startswith("1 target, it can be reached.")
    robot = calib.load_robot(CASE / "arm_cmm.urdf")
    model = calib.load_machine(tmp_path / "out")
    row = (tmp_path / "corrected.csv").read_text().splitlines()[1].split(",")
    corrected = np.radians(np.array(row[:6], dtype=float))
    wanted = robot.tips(np.radians([[5.0, 40.0, 40.0, -60.0, 60.0, 50.0]])) @ model.tools["tool"]
    np.testing.assert_allclose(model.tips(corrected[None]) @ model.tools["tool"], wanted, atol=1e-6)
    again = run("compensate", tmp_path / "out", targets, "-o", tmp_path / "corrected.csv")
    assert (again.code, again.out) == (1, "")
    assert "already exists" in again.err
