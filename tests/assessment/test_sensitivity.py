"""The error model's coefficients against finite differences, and what is made of them."""

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import calib
from calib.assessment.sensitivity import (
    error_coefficients,
    exact_error,
    group_of,
    group_study,
    predicted_error,
    sensitivity,
)
from calib.foundations.errors import JobError, MeasurementError
from calib.job.assumed_errors import read_errors
from calib.presentation import plots
from calib.presentation.command_tables import group_sheet, sensitivity_sentence, sensitivity_sheet
from calib.presentation.plots import sensitivity_figure
from calib.presentation.tables import plain, sheet_table
from tests.support import machines
from tests.support.cases import TABLE, URDF, copy_case, edit

Array = machines.Array

POINT = (0.05, 0.02, 0.15)
ARMS = {"ur10": ("example:ur_description/urdf/ur10_robot.urdf", "tool0")} | {
    name: (text, "tip") for name, text in machines.INLINE.items()
}


def case(name: str = "ur10", rows: int = 10, **options: object) -> tuple[calib.ErrorModel, Array, machines.Arm]:
    """A model with known base and tool, poses, and the same arm by independent code."""
    arm, rng = machines.arm(*ARMS[name]), np.random.default_rng(3)
    given = {"offsets": "all", "placements": "all", "base": "fixed", "tool": "fixed", "tool_poses": {"tool": POINT}}
    return machines.model(machines.load(*ARMS[name]), **given | options), arm.draw(rng, rows), arm


@pytest.mark.parametrize("name", ARMS)
def test_coefficients_are_the_derivatives_of_the_exact_error(name: str) -> None:
    model, q, _ = case(name, placements=["*"], base="pose", tool="position")
    names, matrix = error_coefficients(model, q)
    assert matrix.shape == (len(q), 3, len(names))
    h = 1e-5
    for k, parameter in enumerate(names):
        numeric = (exact_error(model, q, {parameter: h}) - exact_error(model, q, {parameter: -h})) / (2 * h)
        assert np.max(np.abs(matrix[:, :, k] - numeric)) < 1e-8, parameter


def test_exact_error_is_that_of_an_arm_walked_by_other_code() -> None:
    model, q, arm = case("negative", offsets="all", placements="none")
    zeros = dict(zip(arm.ranges, (0.1, -0.2, 0.3, 0.2, -0.1, 0.4), strict=True))
    wrong = arm.with_errors(np.zeros((len(arm.joints), 6)), zeros)
    expected = ((wrong.tips(q) - arm.tips(q)) @ machines.pose(POINT))[:, :3, 3]
    errors = {f"{joint}.offset": zero for joint, zero in zeros.items()}
    assert np.max(np.abs(exact_error(model, q, errors) - expected)) < 1e-13


def test_linear_error_misses_the_exact_one_by_the_square_of_the_errors() -> None:
    model, q, _ = case()
    rng = np.random.default_rng(0)
    errors = {name: float(value) for name in error_coefficients(model, q).names for value in [rng.normal(scale=1e-3)]}

    def miss(scale: float) -> float:
        scaled = {name: scale * value for name, value in errors.items()}
        return float(np.max(np.abs(predicted_error(model, q, scaled) - exact_error(model, q, scaled))))

    assert miss(1.0) / miss(0.1) == pytest.approx(100.0, rel=0.05)


def test_predicted_error_is_the_matrix_times_the_errors_and_unnamed_ones_are_zero() -> None:
    model, q, _ = case()
    names, matrix = error_coefficients(model, q)
    errors = {names[3]: 2e-3, names[7]: -1e-3}
    expected = 2e-3 * matrix[:, :, 3] - 1e-3 * matrix[:, :, 7]
    assert np.max(np.abs(predicted_error(model, q, errors) - expected)) < 1e-16
    assert not predicted_error(model, q, {}).any()
    assert not exact_error(model, q, {}).any()


def test_the_base_turns_errors_and_does_not_change_their_length() -> None:
    base = machines.anywhere(np.random.default_rng(8))
    model, q, _ = case()
    moved, _, _ = case(base_pose=base)
    errors = {"shoulder_lift_joint.offset": 0.2, "elbow_joint.tx": 1e-3}
    for of in (predicted_error, exact_error):
        assert np.max(np.abs(of(moved, q, errors) - of(model, q, errors) @ base[:3, :3].T)) < 1e-14


def test_sensitivity_is_the_length_of_the_columns() -> None:
    model, q, _ = case()
    found = sensitivity(model, q)
    lengths = np.linalg.norm(error_coefficients(model, q).matrix, axis=1)
    assert np.allclose(found.rms, np.sqrt(np.mean(lengths**2, axis=0)), rtol=1e-14)
    assert np.allclose(found.largest, lengths.max(axis=0), rtol=1e-14)
    translations = [p.name.endswith((".tx", ".ty", ".tz")) for p in found.parameters]
    assert np.allclose(found.rms[translations], 1.0, rtol=1e-13)
    assert found.poses == len(q)
    assert [record["name"] for record in found.records()] == [p.name for p in found.parameters]
    assert np.all(np.diff(found.rms[found.order]) <= 1e-9)


def test_sensitivity_says_what_positions_cannot_tell_apart() -> None:
    # On the last axis an offset moves nothing; the point's place and the last placement are one.
    model, q, _ = case(placements=["wrist_3_joint.tx"], tool="position", tool_poses={"tool": (0.0, 0.0, 0.1)})
    found = sensitivity(model, q)
    assert found.rank == len(found.parameters) - len(found.undetermined)
    assert "wrist_3_joint.offset" in {direction.parameter for direction in found.undetermined}
    seen, q, _ = case(placements="none")
    assert sensitivity(seen, q).rank == 6
    assert sensitivity(seen, q).undetermined == ()


def test_group_is_the_last_part_of_a_name() -> None:
    assert [group_of(name) for name in ("joint_3.alpha", "a.b.offset", "tool.probe.x")] == ["alpha", "offset", "x"]


def test_group_study_scales_one_group_at_a_time() -> None:
    model, q, _ = case()
    errors = {"shoulder_lift_joint.offset": 1e-3, "elbow_joint.offset": 2e-3, "elbow_joint.tx": 1e-4}
    study = group_study(model, q, errors, factors=(10.0, 0.0, 1.0))
    assert study.groups == ("offset", "tx")
    assert study.scaled.shape == (2, 3, len(q))
    assert np.allclose(study.errors, np.linalg.norm(exact_error(model, q, errors), axis=1), rtol=1e-14)
    ten = errors | {"elbow_joint.tx": 1e-3}
    assert np.allclose(study.scaled[1, 0], np.linalg.norm(exact_error(model, q, ten), axis=1), rtol=1e-14)
    none = {"elbow_joint.tx": 1e-4}
    assert np.allclose(study.scaled[0, 1], np.linalg.norm(exact_error(model, q, none), axis=1), rtol=1e-12)
    assert not study.changes[:, 2].any()
    assert study.records()[0] == {
        "group": "offset",
        "factor": 10.0,
        "smallest": float(study.changes[0, 0].min()),
        "mean": float(study.changes[0, 0].mean()),
        "largest": float(study.changes[0, 0].max()),
    }


def test_refuses_names_values_factors_and_readings() -> None:
    model, q, _ = case()
    with pytest.raises(JobError, match=r"'elbow_joint.ofset' is not a free parameter .* 'elbow_joint.offset'"):
        predicted_error(model, q, {"elbow_joint.ofset": 1e-3})
    with pytest.raises(JobError, match=r"elbow_joint\.tx: nan is not a finite error"):
        exact_error(model, q, {"elbow_joint.tx": float("nan")})
    for factors in ((), (float("nan"),), (10.0, float("inf"))):
        with pytest.raises(JobError, match=r"factors: .* are not finite numbers"):
            group_study(model, q, {"elbow_joint.tx": 1e-3}, factors=factors)
    # A whole number that no integer of NumPy holds.
    assert group_study(model, q, {"elbow_joint.tx": 1e-39}, factors=(10**30,)).factors == (1e30,)
    for wrong in (q[:, :5], q[0], q[:0], np.full_like(q, np.nan)):
        with pytest.raises(MeasurementError, match=r"needed are finite numbers \(N, 6\)"):
            sensitivity(model, wrong)
    nothing, _, _ = case(offsets="none", placements="none")
    with pytest.raises(JobError, match="no parameter is free"):
        error_coefficients(nothing, q)


def test_results_are_read_only() -> None:
    model, q, _ = case()
    errors = {"elbow_joint.tx": 1e-3}
    found, study = sensitivity(model, q), group_study(model, q, errors)
    arrays = (found.rms, found.largest, study.errors, study.scaled, error_coefficients(model, q).matrix)
    assert not any(
        a.flags.writeable for a in (*arrays, predicted_error(model, q, errors), exact_error(model, q, errors))
    )


# ---- shown to people


def test_tables_are_narrow_and_in_order() -> None:
    model, q, _ = case()
    found = sensitivity(model, q)
    text = plain(sheet_table(sensitivity_sheet(found)))
    assert max(map(len, text.splitlines())) <= 80
    rows = [line.split()[0] for line in text.splitlines() if "mm/m" in line]
    assert rows == [found.parameters[k].name for k in found.order]
    said = f"tell {found.rank} combinations of the {len(found.parameters)} parameters apart"
    assert said in sensitivity_sentence(found)
    study = group_study(model, q, {"elbow_joint.tx": 1e-3, "elbow_joint.offset": 1e-3})
    shown = plain(sheet_table(group_sheet(study)))
    assert max(map(len, shown.splitlines())) <= 80
    assert [line.split()[:2] for line in shown.splitlines() if line.endswith("mm")] == [
        ["tx", "10"],
        ["tx", "0.1"],
        ["offset", "10"],
        ["offset", "0.1"],
    ]


def test_figure_has_a_bar_for_every_parameter_the_strongest_on_top(tmp_path: object) -> None:
    model, q, _ = case()
    found = sensitivity(model, q)
    figure = sensitivity_figure(found)
    (axes,) = figure.axes
    assert [bar.get_width() for bar in axes.patches] == found.rms[found.order[::-1]].tolist()
    assert [label.get_text() for label in axes.get_yticklabels()][-1] == found.parameters[found.order[0]].name
    figure.savefig(f"{tmp_path}/sensitivity.svg")
    figure.savefig(f"{tmp_path}/sensitivity.png")


def test_names_are_no_formulas_and_strangers_settings_are_not_taken(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A process of its own: matplotlib reads its settings where it is loaded."""
    job = copy_case(tmp_path)
    for name in (URDF, TABLE, "validation.csv"):
        edit(name, ("joint_1", "a$_{$"), everywhere=True)(tmp_path)
    (tmp_path / "matplotlibrc").write_text("text.usetex: True\nsvg.fonttype: none\n")
    monkeypatch.chdir(tmp_path)
    run = "from calib.cli import main; main()"
    done = subprocess.run([sys.executable, "-c", run, "sensitivity", job.name, "--plot", "s.svg", "-q"], check=False)
    assert done.returncode == 0
    text = (tmp_path / "s.svg").read_text()
    assert "a$_{$.offset" in text
    assert "<text" not in text


def test_what_matplotlib_makes_can_be_removed_whatever_the_umask(monkeypatch: pytest.MonkeyPatch) -> None:
    """It left a folder that nobody could enter among the temporary ones, and a traceback."""
    met = []

    def loaded(_: str) -> None:
        os.umask(mask := os.umask(0))
        met.append(mask)

    monkeypatch.setattr(plots, "import_module", loaded)
    before = os.umask(0o777)
    try:
        plots.load_matplotlib()
        after = os.umask(0o777)
    finally:
        os.umask(before)
    assert (met, after) == ([0o077], 0o777)


def test_library_loads_no_matplotlib_for_tables() -> None:
    code = "import sys, calib.presentation.plots; sys.exit(any(m.startswith('matplotlib') for m in sys.modules))"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


# ---- assumed errors


def written(folder: Path, *rows: str, head: str = "parameter,error") -> Path:
    path = folder / "errors.csv"
    path.write_text("\n".join(["# assumed", head, *rows]) + "\n", encoding="utf-8")
    return path


def test_assumed_errors_are_read_with_their_units(tmp_path: Path) -> None:
    model, q, _ = case()
    path = written(tmp_path, "elbow_joint.offset, 0.06 deg", "elbow_joint.tx,-0.12 mm")
    errors = read_errors(path, model)
    assert errors == {"elbow_joint.offset": pytest.approx(np.radians(0.06)), "elbow_joint.tx": pytest.approx(-0.12e-3)}
    study = group_study(model, q, errors)
    assert set(study.groups) == {"offset", "tx"}


@pytest.mark.parametrize(
    ("rows", "head", "said"),
    [
        (["elbow_joint.offset,0.06 mm"], "parameter,error", "unit 'mm' is not a unit of"),
        (["elbow_joint.offset,0.06"], "parameter,error", "has no unit"),
        (["elbow.offset,0.06 deg"], "parameter,error", ":3: 'elbow.offset' is not a free parameter of the model"),
        (["elbow_joint.offset,0.06 deg"] * 2, "parameter,error", ":4: 'elbow_joint.offset' appears twice"),
        (["elbow_joint.offset"], "parameter,error", ":3: has 1 cells"),
        ([], "name,value", "begins with the columns 'parameter,error'"),
        ([], "parameter,error", "has a header and no rows"),
        (
            ['"elbow_joint.offset,0.06 deg', "x"],
            "parameter,error",
            ":3: a quote is not closed, or something follows it",
        ),
        (["x" * 200_000 + ",1 mm"], "parameter,error", ":3: is longer than the 2000 characters that are allowed"),
    ],
)
def test_wrong_errors_are_refused(tmp_path: Path, rows: list[str], head: str, said: str) -> None:
    model, _, _ = case()
    with pytest.raises(JobError, match=re.escape(said)):
        read_errors(written(tmp_path, *rows, head=head), model)
