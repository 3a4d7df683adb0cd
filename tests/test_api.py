"""``import calib``: what it offers, what it does not load, and the five lines that it promises."""

import ast
import copy
import inspect
import pickle
import subprocess
import sys
import textwrap
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import calib
from tests.support.cases import CASE, TABLE, copy_case

HEAVY = (
    "numpy",
    "scipy",
    "pinocchio",
    "pydantic",
    "rich",
    "sklearn",
    "trimesh",
    "meshcat",
    "matplotlib",
    "trimesh",
    "pandas",
    "IPython",
    "tornado",
    "typer",
    "jinja2",
    "PIL",
    "joblib",
    "distributed",
)


def test_import_is_light() -> None:
    code = f"import calib, sys; print([m for m in {HEAVY!r} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-W", "error", "-c", code], capture_output=True, text=True, check=True)
    assert (done.stdout, done.stderr) == ("[]\n", "")


@pytest.mark.parametrize("arguments", ["--help", "--version", "calibrate --help", "plan --help", "uncertainty -h"])
def test_help_is_as_light(arguments: str) -> None:
    code = (
        f"import sys, atexit; sys.argv = ['calib', *{arguments.split()!r}]; from calib_start import main; "
        f"atexit.register(lambda: print([m for m in {HEAVY!r} if m in sys.modules])); main()"
    )
    done = subprocess.run([sys.executable, "-W", "error", "-c", code], capture_output=True, text=True, check=True)
    # By pydantic typer reads the options of a command.
    assert done.stdout.splitlines()[-1] in ("['typer']", "['pydantic', 'typer']")


MODULES = ("commands", "dh", "judging", "measuring", "planning", "positioner")


def test_public_names_are_there_and_explained() -> None:
    assert sorted(calib.__all__) == calib.__all__
    assert len(calib.__all__) <= 46
    for name in calib.__all__:
        assert getattr(calib, name).__doc__, name
    assert set(calib.__all__) <= set(dir(calib))
    with pytest.raises(AttributeError, match="module 'calib' has no attribute 'calibrat'"):
        calib.calibrat  # type: ignore[attr-defined] # noqa: B018
    for module in MODULES:
        assert module in calib.__all__
        for name in getattr(calib, module).__all__:
            thing = getattr(getattr(calib, module), name)
            assert thing.__doc__ or not (inspect.isfunction(thing) or inspect.isclass(thing)), name


def test_no_function_takes_more_than_eight_things() -> None:
    for module in (calib, *(getattr(calib, name) for name in MODULES)):
        for name in module.__all__:
            thing = getattr(module, name)
            if inspect.isfunction(thing):
                assert len(inspect.signature(thing).parameters) <= 8, name


def test_names_are_known_to_type_checkers_and_found_where_these_look() -> None:
    """What a type checker reads, where a running program looks, and ``__all__`` are one list."""
    tree = ast.parse(Path(calib.__file__).read_text(encoding="utf-8"))
    (block,) = [node for node in tree.body if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"]
    read = {alias.name: node.module for node in block.body if isinstance(node, ast.ImportFrom) for alias in node.names}
    assert {name for name, module in read.items() if module == "calib"} == set(MODULES)
    assert {name: module for name, module in read.items() if module != "calib"} == calib._MODULES
    assert sorted(read) == calib.__all__


@pytest.mark.parametrize(
    "name", ["calib.robot.gravity.Payload", "calib.assessment.drift.compare", "calib.positioner", "calib.dh.read_dh"]
)
def test_modules_need_no_import_of_their_own(name: str) -> None:
    code = f"import calib; calib.measuring.Payload; {name}"
    subprocess.run([sys.executable, "-W", "error", "-c", code], check=True)


@pytest.mark.parametrize("name", MODULES)
def test_modules_of_names_are_imported_as_such(name: str) -> None:
    """``import calib.dh`` failed where ``from calib import dh`` did not."""
    subprocess.run([sys.executable, "-W", "error", "-c", f"import calib.{name}; calib.{name}.__all__"], check=True)


def test_errors_are_one_family() -> None:
    for name in calib.__all__:
        if name.endswith("Error"):
            assert issubclass(getattr(calib, name), calib.CalibError)
            assert getattr(calib, name).__module__ == "calib.foundations.errors"


def test_lines_of_the_docstring_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    lines = [line for line in (calib.__doc__ or "").splitlines() if line.startswith("    ")]
    assert len(lines) == 7  # the import, and six lines
    (tmp_path / "arm.urdf").write_bytes((CASE / "arm_cmm.urdf").read_bytes())
    (tmp_path / "measured.csv").write_bytes((CASE / TABLE).read_bytes())
    monkeypatch.chdir(tmp_path)
    exec(textwrap.dedent("\n".join(lines)), {})
    assert capsys.readouterr().out.startswith("<Calibration, to be trusted; position ")
    nominal, calibrated = (
        calib.load_robot(tmp_path / name, "probe") for name in ("arm.urdf", "results/calibrated.urdf")
    )
    readings = np.zeros((1, 6))
    assert np.abs(nominal.tips(readings) - calibrated.tips(readings)).max() > 1e-3


def fit_of(source: object) -> calib.Fit:
    robot = calib.load_robot(CASE / "arm_cmm.urdf", tip="probe")
    data = calib.read_measurements(source, robot, sigma=0.02e-3)  # type: ignore[arg-type]
    return calib.identify(calib.error_model(robot, offsets="all", placements="all"), data)


def test_frames_and_arrays_give_the_fit_of_the_file() -> None:
    frame = pd.read_csv(CASE / TABLE, comment="#", skipinitialspace=True)
    by_file, by_frame, by_arrays = map(
        fit_of, (CASE / TABLE, frame, {name: frame[name].to_numpy() for name in frame.columns})
    )
    assert by_file.values.tolist() == by_frame.values.tolist() == by_arrays.values.tolist()
    assert repr(by_file) == "<Fit of 45 parameters to 60 rows: formal rank 27, null space of 18 directions>"
    assert [record["name"] for record in by_file.records()] == [parameter.name for parameter in by_file.parameters]


def test_rows_of_a_fit_cannot_be_written_to() -> None:
    (data,) = fit_of(CASE / TABLE).measurements
    arrays = {name: value for name in data.__slots__ if isinstance(value := getattr(data, name), np.ndarray)}
    assert {"readings", "tool", "setup", "target"} <= set(arrays)
    assert not [name for name, array in arrays.items() if array.flags.writeable]


def test_frame_is_not_changed() -> None:
    frame = pd.read_csv(CASE / TABLE, comment="#", skipinitialspace=True)
    before = frame.copy(deep=True)
    fit_of(frame)
    pd.testing.assert_frame_equal(frame, before)


@pytest.fixture(scope="module")
def arm() -> calib.Robot:
    return calib.load_robot(CASE / "arm_cmm.urdf", tip="probe")


@pytest.fixture(scope="module")
def found(arm: calib.Robot) -> calib.Calibration:
    data, held_out = calib.hold_out(calib.read_measurements(CASE / TABLE, arm, sigma=0.02e-3))
    return calib.assess(calib.identify(calib.error_model(arm, offsets="all", placements="all"), data), held_out)


def test_all_that_is_found_shows_itself_on_a_screen(found: calib.Calibration) -> None:
    machine = found.machine
    readings = found.sets[0].data.readings
    things = [
        *(found, found.fit, found.fit.model, machine, machine.robot, machine.deviations, machine.uncertainty),
        *(found.sets[0].data, found.outliers, machine.robot.urdf, calib.verify(machine, found.sets[1].data)),
        *(calib.judging.compare(machine, machine), calib.judging.tool_uncertainty(machine, readings)),
        *(
            calib.judging.sensitivity(found.fit.model, readings),
            calib.judging.observability(found.fit.model, found.fit.measurements),
        ),
        *(calib.judging.uncertainty_map(machine, 5), calib.commands.for_joint_targets(machine, readings[:3])),
    ]
    for thing in things:
        assert len(repr(thing)) <= 1200, type(thing)
        assert type(thing).__name__ in repr(thing)


def test_python_writes_the_folder_of_the_command(found: calib.Calibration, tmp_path: Path) -> None:
    out = calib.save(found, tmp_path / "out")
    calib.calibrate(copy_case(tmp_path / "case"), tmp_path / "by_command")
    there, by_command = ({path.name for path in folder.iterdir()} for folder in (out, tmp_path / "by_command"))
    assert there == by_command - {"job.json"}
    # In a folder the page leads to the scene beside it.
    page = [line for line in (out / "report.html").read_text(encoding="utf-8").splitlines() if "scene.html" not in line]
    assert page == calib.report(found).splitlines()
    assert "Made from Python." in calib.report(found)
    assert (out / "scene.html").read_text(encoding="utf-8") == calib.scene(found)
    again = calib.load_machine(out)
    readings = found.sets[0].data.readings
    np.testing.assert_allclose(again.predict(readings), found.machine.predict(readings), rtol=0, atol=1e-12)
    assert again.uncertainty is not None
    # Older results are replaced, and nothing else is.
    calib.save(found.fit, out)
    (out / "mine.txt").write_text("mine", encoding="utf-8")
    with pytest.raises(calib.OutputError, match=r"holds 'mine.txt', which is no result"):
        calib.save(found, out)


def test_what_is_found_goes_to_other_processes(found: calib.Calibration) -> None:
    machine, held_out = found.machine, found.sets[1].data
    targets = calib.commands.read_targets(CASE / TABLE, machine)
    for made in (found, found.fit, machine, calib.verify(machine, held_out, limit=1e-3), targets, held_out):
        for again in (pickle.loads(pickle.dumps(made)), copy.deepcopy(made)):
            assert repr(again) == repr(made)


def test_rows_that_were_fitted_prove_nothing(found: calib.Calibration) -> None:
    identified, held_out = (judged.data for judged in found.sets)
    assert not found.findings
    (finding,) = calib.assess(found.fit, [held_out, identified]).findings
    assert finding.code == "not-held-out"
    assert "as a validation it proves nothing" in calib.report(calib.assess(found.fit, identified))


def test_plain_arrays_are_the_table(arm: calib.Robot) -> None:
    data = calib.read_measurements(CASE / TABLE, arm, sigma=0.02e-3)
    assert data.position is not None
    plain = calib.positions(arm, data.readings, data.position, sigma=0.02e-3)
    for name in ("readings", "position", "sigma"):
        np.testing.assert_array_equal(getattr(plain, name), getattr(data, name))
    poses = calib.poses(arm, data.readings, arm.tips(data.readings), sigma=1e-5, sigma_angle=1e-4)
    assert poses.kind == "pose"
    np.testing.assert_array_equal(poses.sigma[0], [1e-5] * 3 + [1e-4] * 3)
    lengths = np.linalg.norm(data.position, axis=1)
    assert calib.measuring.distances(arm, data.readings, lengths).targets == ("anchor",)
    names = ["a", "b"] * (len(data) // 2)
    assert calib.measuring.sockets(arm, data.readings, names).targets == ("a", "b")


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        (lambda r, q, x: calib.positions(r, q[:, :5], x), r"readings of shape \(60, 5\): needed is \(N, 6\)\."),
        (lambda r, q, x: calib.positions(r, q, x[:, :2]), r"xyz of shape \(60, 2\): needed is \(N, 3\)\."),
        (lambda r, q, x: calib.positions(r, q, x, tool=["a"]), r"tool: 1 names are given for 60 rows\."),
        (calib.poses, r"placements of shape \(60, 3\): needed is \(N, 4, 4\)\."),
        (lambda r, q, x: calib.poses(r, q, np.ones((60, 4, 4))), r"placements: row 1 is not a placement;"),
        (calib.measuring.distances, r"lengths of shape \(60, 3\): needed is \(N,\)\."),
        (
            lambda r, q, x: calib.hold_out(calib.positions(r, q, x), places=["nowhere"]),
            r"there is no target or group 'nowhere'; there are none\.",
        ),
    ],
)
def test_wrong_arrays_are_refused(arm: calib.Robot, wrong: Callable[..., object], said: str) -> None:
    data = calib.read_measurements(CASE / TABLE, arm)
    with pytest.raises(calib.MeasurementError, match=said):
        wrong(arm, data.readings, data.position)


def test_check_finds_what_is_wrong_and_nothing_else(arm: calib.Robot) -> None:
    model = calib.error_model(arm, offsets="all", placements="all")
    data = calib.read_measurements(CASE / TABLE, arm)
    assert calib.check(model, data) == ()
    assert data.position is not None
    wrong = calib.positions(arm, data.readings * [1, 1, -1, 1, 1, 1], data.position)
    assert any("joint_3" in finding.sentence for finding in calib.check(model, wrong))


def test_places_are_held_out_whole(arm: calib.Robot) -> None:
    q = calib.read_measurements(CASE / TABLE, arm).readings
    data = calib.measuring.sockets(arm, q, ["a", "b", "c"] * 20)
    some, rest = calib.hold_out(data, places=["b"])
    assert (some.targets, rest.targets, len(rest)) == (("a", "c"), ("b",), 20)
    with pytest.raises(calib.JobError, match=r"share: 1\.5 is not between 0 and 1"):
        calib.hold_out(data, 1.5)
