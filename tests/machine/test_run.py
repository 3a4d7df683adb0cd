"""Files of results name their run: those of two runs of one robot are not used as one."""

import io
import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import calib
from calib.foundations.errors import OutputError
from calib.machine.calibrated import CalibratedMachine
from calib.machine.gaussian import gaussian_from_residuals
from calib.machine.grid import grid_from_residuals
from calib.machine.model_file import machine_files, run_of
from calib.machine.of_fit import machine_of
from calib.machine.residual_model import ResidualModel
from tests.support import machines

TEXT = machines.INLINE["mimic"]
TOOLS = {"tool": machines.pose((0.05, 0.02, 0.15))}


def identified(seed: int) -> CalibratedMachine:
    """A calibration of one robot; each time it is measured anew."""
    true = machines.arm(TEXT, "tip").moved(np.random.default_rng(7))
    rng = np.random.default_rng(seed)
    machine, readings = machines.Machine(true, machines.anywhere(rng), TOOLS), true.draw(rng, 60)
    robot = machines.load(TEXT, "tip")
    data = calib.read_measurements(machines.table(true, readings, machine.see(readings), "position"), robot, sigma=1e-6)
    return machine_of(calib.identify(calib.error_model(robot, offsets="all", placements="all"), data))


@pytest.fixture(scope="module")
def two() -> tuple[CalibratedMachine, CalibratedMachine]:
    return identified(1), identified(2)


def residuals(kind: str, machine: CalibratedMachine, size: float) -> ResidualModel:
    readings, width = machine.robot.readings, len(machine.robot.readings)
    rows = np.zeros((36, width))
    rows[:, :2] = [(a, b) for a in np.linspace(-1.0, 1.0, 6) for b in np.linspace(0.0, 0.5, 6)]
    errors = size * np.stack([np.sin(rows[:, 0]), rows[:, 1], rows[:, 0] * rows[:, 1]], axis=1)
    joints = [reading.name for reading in readings[:2]]
    if kind == "grid":
        return grid_from_residuals(rows, errors, readings, joints)
    return gaussian_from_residuals(rows, errors, readings, joints)


def written(machine: CalibratedMachine, folder: Path) -> Path:
    folder.mkdir()
    for name, contents in machine_files(machine).items():
        (folder / name).write_bytes(contents.encode() if isinstance(contents, str) else contents)
    return folder


def refused(folder: Path, name: str) -> str:
    with pytest.raises(OutputError) as caught:
        calib.load_machine(folder)
    said = str(caught.value)
    assert said.startswith(f"{folder / name}: ")
    return said.removeprefix(f"{folder / name}: ")


OTHER = re.compile(
    r"names the run [0-9a-f]{12}, and model\.json beside it names the run [0-9a-f]{12}; "
    r"a folder of results is used as one run wrote it\."
)


@pytest.mark.parametrize("kind", ["grid", "gaussian"])
@pytest.mark.parametrize("same_errors", [True, False])
def test_a_file_of_another_run_is_refused(
    two: tuple[CalibratedMachine, CalibratedMachine], tmp_path: Path, kind: str, same_errors: bool
) -> None:
    sizes = (1e-4, 1e-4 if same_errors else 2e-4)
    one, other = (
        written(replace(machine, residual_model=residuals(kind, machine, size)), tmp_path / name)
        for machine, size, name in zip(two, sizes, ("one", "other"), strict=True)
    )
    for name in ("uncertainty.json", f"{kind}.npz"):
        own = (one / name).read_bytes()
        (one / name).write_bytes((other / name).read_bytes())
        assert OTHER.fullmatch(refused(one, name))
        (one / name).write_bytes(own)
    assert calib.load_machine(one).residual_model is not None
    (one / "model.json").write_bytes((other / "model.json").read_bytes())
    assert OTHER.fullmatch(refused(one, "uncertainty.json"))


def test_the_urdf_of_another_robot_is_refused(two: tuple[CalibratedMachine, CalibratedMachine], tmp_path: Path) -> None:
    """With the same joints, but for where one is; lines that are ended otherwise are no other URDF."""
    folder = written(two[0], tmp_path / "out")
    urdf = folder / "nominal.urdf"
    source = urdf.read_bytes()
    urdf.write_bytes(source.replace(b"\n", b"\r\n"))
    assert calib.load_machine(folder).uncertainty is not None
    number = re.search(rb'<origin xyz="[^"]*?0\.\d', source)
    assert number is not None
    urdf.write_bytes(source[: number.end()] + b"5" + source[number.end() :])
    assert refused(folder, "nominal.urdf") == "is not the URDF of model.json beside it, as their SHA-256 differ."


def test_files_of_earlier_versions_name_no_run_and_are_read(
    two: tuple[CalibratedMachine, CalibratedMachine], tmp_path: Path
) -> None:
    """But one of them is none of a later run, nor the other way round."""
    machine = replace(two[0], residual_model=residuals("grid", two[0], 1e-4))
    folder, new = written(machine, tmp_path / "out"), written(machine, tmp_path / "new")
    for name in ("model.json", "uncertainty.json"):
        contents = json.loads((folder / name).read_text())
        (folder / name).write_text(json.dumps({k: v for k, v in contents.items() if k not in ("run", "urdf_sha256")}))
    with np.load(io.BytesIO((folder / "grid.npz").read_bytes()), allow_pickle=False) as file:
        np.savez(folder / "grid.npz", **{key: array for key, array in file.items() if key != "run"})
    again = calib.load_machine(folder)
    assert again.residual_model is not None
    assert again.uncertainty is not None
    old = (folder / "uncertainty.json").read_bytes()
    (folder / "uncertainty.json").write_bytes((new / "uncertainty.json").read_bytes())
    assert re.match(
        r"names the run [0-9a-f]{12}, and model.json .* names no run; ", refused(folder, "uncertainty.json")
    )
    (new / "uncertainty.json").write_bytes(old)
    assert re.match(r"names no run, and model.json .* names the run [0-9a-f]{12}; ", refused(new, "uncertainty.json"))


@pytest.mark.parametrize("value", [3, "", "12", None, ["a"]])
def test_names_that_are_none(two: tuple[CalibratedMachine, CalibratedMachine], tmp_path: Path, value: object) -> None:
    folder = written(replace(two[0], residual_model=residuals("grid", two[0], 1e-4)), tmp_path / "out")
    for name in ("uncertainty.json", "model.json"):
        own = (folder / name).read_bytes()
        (folder / name).write_text(json.dumps(json.loads(own) | {"run": value}))
        refused(folder, "uncertainty.json" if value is None else name)
        (folder / name).write_bytes(own)
    with np.load(io.BytesIO((folder / "grid.npz").read_bytes()), allow_pickle=False) as file:
        np.savez(folder / "grid.npz", **dict(file.items()) | {"run": np.array(["a"] if value is None else value)})
    refused(folder, "grid.npz")


def test_the_same_calibration_has_the_same_name_and_files(
    two: tuple[CalibratedMachine, CalibratedMachine], tmp_path: Path
) -> None:
    one, other = two
    assert machine_files(one) == machine_files(identified(1))
    assert run_of(replace(one, uncertainty=other.uncertainty)) != run_of(one) != run_of(other)
    grids = [replace(one, residual_model=residuals("grid", one, size)) for size in (1e-4, 2e-4)]
    assert len({run_of(one), *map(run_of, grids)}) == 3
    # What was read is written as a whole folder again, too.
    again = written(calib.load_machine(written(grids[0], tmp_path / "out")), tmp_path / "again")
    assert calib.load_machine(again).residual_model is not None
