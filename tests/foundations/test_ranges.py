"""The ranges of quantities: one table, which jobs, Python, tables and the documentation have in common."""

import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import calib
from calib.foundations.errors import CalibError
from calib.foundations.ranges import COUNTS, MOST_NAMES, OF_DIMENSION, RANGES, refuse_beyond
from calib.job.fields import number, quantity
from calib.job.schema import CouplingSection
from calib.robot.gravity import Payload
from tests.support import machines
from tests.support.cases import CASE, Edit, append, copy_case, job, run, tree

FORMATS = Path(__file__).resolve().parents[2] / "docs" / "formats.md"
TRACKER = '[instruments.leica]\nkind = "laser_tracker"\nsigma = "15 um"\nstation = ["{}", "0 m", "0 m"]\n'
GRAVITY = 'tip = "probe"\ngravity = ["0 m/s2", "0 m/s2", "{}"]'
PAYLOAD = 'tip = "probe"\npayload = {{ mass = "{}", position = ["0 m", "0 m", "{}"] }}'
BASE = '[base]\nposition = ["{}", "0 m", "0 m"]\n'
PRIOR = 'offsets = "all"\nprior = {{ length = "{}" }}'
FIXED = ('"pose" ', '"fixed"')


def test_the_documentation_has_them() -> None:
    text = FORMATS.read_text(encoding="utf-8")
    for key, allowed in RANGES.items():
        assert f"| {key} | {allowed} |" in text
    for dimension, allowed in OF_DIMENSION.items():
        assert f"| {dimension} | {allowed} |" in text
    for key, most in (*COUNTS.items(), ("names and globs in a list", MOST_NAMES)):
        assert f"| {key} | {most} |" in text


@pytest.mark.parametrize("key", RANGES)
def test_ends_are_within_and_what_is_beyond_is_not(key: str) -> None:
    allowed = RANGES[key]
    beyond = [
        1.01 * allowed.high,
        1e300,
        *([1.01 * allowed.low] if allowed.low < 0.0 else [0.99 * allowed.low or -1.0]),
    ]
    if allowed.unit == "1":
        for end in (allowed.low, allowed.high):
            assert number(key)(end) == end
        for value in beyond:
            with pytest.raises(ValueError, match="is out of range; allowed is"):
                number(key)(value)
        return
    for end in (allowed.low, allowed.high):
        assert quantity(key)(f"{end!r} {allowed.unit}")
    for value in beyond:
        with pytest.raises(ValueError, match="is out of range; allowed is"):
            quantity(key)(f"{value!r} {allowed.unit}")
    assert allowed.holds(0.0) == (allowed.zero or allowed.low <= 0.0)


def test_the_unit_of_an_offset_decides_its_range() -> None:
    for offset in ("-900 rad", "9000 m", None):
        assert CouplingSection(joint="a", drivers={"b": 1.0}, offset=offset).offset == offset
    for offset, key in (("9000 rad", "coupling.offset"), ("11000 m", "coupling.offset of what slides")):
        with pytest.raises(ValueError, match=re.escape(f"allowed is {RANGES[key]}.")):
            CouplingSection(joint="a", drivers={"b": 1.0}, offset=offset)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e300])
def test_what_is_no_number_is_in_no_range(value: float) -> None:
    for key in RANGES:
        with pytest.raises(CalibError):
            refuse_beyond(value, key, "here")


MAGNITUDES: dict[str, tuple[Edit, str, str]] = {
    "sigma": (job(('"0.02 mm"', '"1e100 mm"')), "measurements[0].sigma: '1e100 mm'", "sigma"),
    "large sigma": (job(('"0.02 mm"', '"1e30 mm"')), "measurements[0].sigma: '1e30 mm'", "sigma"),
    "small sigma": (job(('"0.02 mm"', '"1e-300 mm"')), "measurements[0].sigma: '1e-300 mm'", "sigma"),
    "prior": (
        job(('offsets = "all"', PRIOR.format("1e300 m"))),
        "error_model.prior.length: '1e300 m'",
        "prior.length",
    ),
    "gravity": (job(('tip = "probe"', GRAVITY.format("1e7 m/s2"))), "robot.gravity[2]: '1e7 m/s2'", "gravity"),
    "payload": (
        job(('tip = "probe"', PAYLOAD.format("1e300 kg", "0 m"))),
        "robot.payload.mass: '1e300 kg'",
        "mass",
    ),
    "payload far away": (
        job(('tip = "probe"', PAYLOAD.format("1 kg", "1e300 m"))),
        "robot.payload.position[2]: '1e300 m'",
        "position, station, point",
    ),
    "base": (append(BASE.format("1e9 m"), FIXED), "base.position[0]: '1e9 m'", "position, station, point"),
    "base far away": (append(BASE.format("1e300 m"), FIXED), "base.position[0]: '1e300 m'", "position, station, point"),
    "station": (
        append(TRACKER.format("1e300 m")),
        "instruments.leica.station[0]: '1e300 m'",
        "position, station, point",
    ),
}


@pytest.mark.parametrize("name", MAGNITUDES)
def test_a_job_with_a_slip_of_the_pen(tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(copy_case(tmp_path).parent)
    change, value, key = MAGNITUDES[name]
    change(tmp_path)
    before = tree(tmp_path)
    sentence = f"Error: calibration.toml: {value} is out of range; allowed is {RANGES[key]}.\n"
    assert run("calibrate", "calibration.toml", "-o", "out") == (1, "", sentence)
    assert tree(tmp_path) == before


SIGMA_COLUMN = job(
    ('file = "identification.csv"\nobserves = "position"\nsigma = "0.02 mm"', 'file = "identification.csv"')
)


def in_column(title: str, value: str) -> Edit:
    """All cells of a column of the table to identify from; the column is added where there is none."""

    def change(folder: Path) -> None:
        path = folder / "identification.csv"
        header, *rows = [line for line in path.read_text(encoding="utf-8").splitlines() if not line.startswith("#")]
        titles = header.split(", ")
        cells = [row.split(", ") for row in rows]
        if title not in titles:
            titles.append(title)
            cells = [[*row, ""] for row in cells]
        for row in cells:
            row[titles.index(title)] = value
        path.write_text("\n".join(", ".join(row) for row in (titles, *cells)) + "\n", encoding="utf-8")

    return change


CELLS: dict[str, tuple[tuple[Edit, ...], str]] = {
    "positions of nothing": (
        tuple(in_column(f"{axis} [mm]", "1e-300") for axis in "xyz"),
        "column 'x': 1e-300 is out of range; what is not 0 has a size of 1e-100 or more in SI units",
    ),
    "a place far away": (
        (in_column("y [mm]", "1e30"),),
        "column 'y': 1e30 is out of range; allowed is -10000 to 10000 m",
    ),
    "a large sigma": (
        (SIGMA_COLUMN, in_column("sigma [mm]", "1e6")),
        "column 'sigma' is out of range; allowed is 0, or 1e-06 to 1000 mm",
    ),
    "a sigma beyond all": (
        (SIGMA_COLUMN, in_column("sigma [mm]", "1e100")),
        "column 'sigma': 1e100 is out of range; allowed is -10000 to 10000 m",
    ),
    "a reading of nothing": (
        (in_column("joint_1 [deg]", "-6.9e-310"),),
        "column 'joint_1': -6.9e-310 is out of range; what is not 0 has a size of 1e-100 or more in SI units",
    ),
}


@pytest.mark.parametrize("name", CELLS)
def test_cells_out_of_range(tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(copy_case(tmp_path).parent)
    changes, sentence = CELLS[name]
    for change in changes:
        change(tmp_path)
    for command in (("check", "calibration.toml"), ("calibrate", "calibration.toml", "-o", "out")):
        assert run(*command) == (1, "", f"Error: identification.csv:2: {sentence}.\n")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    "change",
    [
        job(('"0.02 mm"', '"1e-6 mm"')),
        job(('"0.02 mm"', '"1000 mm"')),
        job(('offsets = "all"', PRIOR.format("1e-6 mm"))),
        job(('tip = "probe"', PAYLOAD.format("100000 kg", "10000 m"))),
        append(BASE.format("10000 m"), FIXED),
    ],
    ids=["smallest sigma", "largest sigma", "smallest prior", "largest payload", "farthest base"],
)
def test_a_job_at_the_ends_is_served_or_refused(tmp_path: Path, change: Edit) -> None:
    path = copy_case(tmp_path)
    change(tmp_path)
    said = run("calibrate", path, "-o", tmp_path / "out", "--quiet")
    assert said.code in (0, 1, 3)
    assert (tmp_path / "out").is_dir() == (said.code != 1)
    assert len(said.err.splitlines()) <= 4


def test_python_is_given_the_same_ranges() -> None:
    robot = calib.load_robot(CASE / "arm_cmm.urdf", "probe")
    data = calib.read_measurements(CASE / "identification.csv", robot, sigma=2e-5)
    model = calib.error_model(robot, offsets="all")
    far = np.array([1e9, 0.0, 0.0])
    calls: list[Any] = [
        lambda: machines.model(robot, offsets="all", prior_length=1e300),
        lambda: machines.model(robot, offsets="all", prior_angle=1e-300),
        lambda: machines.model(robot, offsets="all", base="fixed", base_pose=far),
        lambda: machines.model(robot, offsets="all", tool="fixed", tool_poses={"tool": far}),
        lambda: calib.measuring.LaserTracker(1e100, 0.0),
        lambda: calib.measuring.LaserTracker(1e-5, 0.0, (1e300, 0.0, 0.0)),
        lambda: calib.load_robot(robot.urdf, robot.tip, gravity=(0.0, 0.0, 1e7)),
        lambda: calib.load_robot(robot.urdf, robot.tip, payload=Payload(1e300)),
        lambda: calib.load_robot(robot.urdf, robot.tip, payload=Payload(1.0, (1e300, 0.0, 0.0))),
        lambda: calib.identify(model, data, model_sigmas=[1e100]),
    ]
    for call in calls:
        with pytest.raises(CalibError, match="allowed is"):
            call()
