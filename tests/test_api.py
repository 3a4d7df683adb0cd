"""``import calib``: what it offers, what it does not load, and the five lines that it promises."""

import ast
import subprocess
import sys
import textwrap
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import calib
from tests.job.cases import CASE, TABLE

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


def test_public_names_are_there_and_explained() -> None:
    assert sorted(calib.__all__) == calib.__all__
    for name in calib.__all__:
        assert getattr(calib, name).__doc__, name
    assert set(calib.__all__) <= set(dir(calib))
    with pytest.raises(AttributeError, match="module 'calib' has no attribute 'calibrat'"):
        calib.calibrat  # type: ignore[attr-defined] # noqa: B018


def test_names_are_known_to_type_checkers_and_found_where_these_look() -> None:
    """What a type checker reads, where a running program looks, and ``__all__`` are one list."""
    tree = ast.parse(Path(calib.__file__).read_text(encoding="utf-8"))
    (block,) = [node for node in tree.body if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"]
    read = {alias.name: node.module for node in block.body if isinstance(node, ast.ImportFrom) for alias in node.names}
    assert read == calib._MODULES
    assert sorted(read) == calib.__all__


@pytest.mark.parametrize(
    "name", ["calib.robot.gravity.Payload", "calib.assessment.drift.compare", "calib.positioner", "calib.dh.read_dh"]
)
def test_modules_need_no_import_of_their_own(name: str) -> None:
    code = f"import calib; calib.Payload; {name}"
    subprocess.run([sys.executable, "-W", "error", "-c", code], check=True)


def test_errors_are_one_family() -> None:
    for name in calib.__all__:
        if name.endswith("Error"):
            assert issubclass(getattr(calib, name), calib.CalibError)
            assert getattr(calib, name).__module__ == "calib.foundations.errors"


def test_lines_of_the_docstring_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    lines = [line for line in (calib.__doc__ or "").splitlines() if line.startswith("    ")]
    assert len(lines) == 6  # the import, and five lines
    (tmp_path / "arm.urdf").write_bytes((CASE / "arm_cmm.urdf").read_bytes())
    (tmp_path / TABLE).write_bytes((CASE / TABLE).read_bytes())
    monkeypatch.chdir(tmp_path)
    exec(textwrap.dedent("\n".join(lines)), {})
    printed = capsys.readouterr().out
    assert "Tip errors" in printed
    assert "joint_6.offset" in printed
    nominal, calibrated = (calib.load_robot(tmp_path / name, "probe") for name in ("arm.urdf", "calibrated.urdf"))
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
    assert repr(by_file) == "<Fit of 45 parameters to 60 rows: rank 27, 18 directions are blind>"
    assert [record["name"] for record in by_file.records()] == [parameter.name for parameter in by_file.parameters]


def test_frame_is_not_changed() -> None:
    frame = pd.read_csv(CASE / TABLE, comment="#", skipinitialspace=True)
    before = frame.copy(deep=True)
    fit_of(frame)
    pd.testing.assert_frame_equal(frame, before)
