"""The folder of results: whole, consistent, readable by others, and never in the place of anything else."""

import csv
import io
import json
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yourdfpy

import calib
from calib.foundations.errors import OutputError
from calib.job.calibrate import calibrated
from calib.job.inputs import load
from calib.job.run import run as identify
from calib.results import calibration
from calib.results import folder as results
from calib.results.calibration import Calibration
from calib.results.folder import write_results
from tests.support import machines
from tests.support.cases import JOB, TABLE, URDF, copy_case, edit, keep_rows, run, tree, write
from tests.support.machines import Array
from tests.support.swaps import left

FILES = [
    *("calibrated.urdf", "job.json", "model.json", "nominal.urdf"),
    *("report.html", "report.md", "residuals.csv", "result.json", "scene.html", "uncertainty.json"),
]


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("case")
    copy_case(folder)
    return folder


@pytest.fixture(scope="module")
def outcome(case: Path) -> Calibration:
    return identify(load(case / JOB))


@pytest.fixture(scope="module")
def out(case: Path, outcome: Calibration) -> Path:
    write_results(outcome, case / "out")
    return case / "out"


def strict(text: str) -> dict[str, object]:
    def refuse(constant: str) -> float:
        raise AssertionError(f"{constant} is not JSON")

    contents = json.loads(text, parse_constant=refuse)
    assert isinstance(contents, dict)
    return contents


def without_origins(document: bytes) -> bytes:
    return re.sub(rb"<origin[^>]*/>", b"<origin/>", document)


# The files. -------------------------------------------------------------------------------------------------------


def test_folder_holds_every_file_and_nothing_else(out: Path) -> None:
    assert sorted(path.name for path in out.iterdir()) == FILES
    assert [path.name for path in out.parent.iterdir() if "out" in path.name] == ["out"]


def test_json_files_are_strict(out: Path) -> None:
    for name in ("result.json", "model.json", "job.json"):
        assert strict((out / name).read_text(encoding="utf-8"))["schema"] == 1


def test_result_is_what_the_table_prints(case: Path, tmp_path: Path) -> None:
    said = run("calibrate", case / JOB, "-o", tmp_path / "out")
    metrics = json.loads((tmp_path / "out/result.json").read_text(encoding="utf-8"))["metrics"]
    rows = [line.split() for line in said.out.splitlines() if " mm" in line and line.split()[1] in ("before", "after")]
    assert [row[:2] for row in rows] == [
        [use, when] for use in ("identification", "validation") for when in ("before", "after")
    ]
    for use, when, n, *figures, unit in rows:
        m = metrics[use][when]["position"]
        assert (int(n), unit, m["unit"]) == (m["n"], "mm", "m")
        assert figures == [f"{m[key] * 1e3:.4f}" for key in ("mean", "rms", "p95", "max")]


def test_result_is_the_fit(out: Path, outcome: Calibration) -> None:
    result = json.loads((out / "result.json").read_text(encoding="utf-8"))
    fit = outcome.fit
    assert (result["trusted"], result["doubts"], result["rank"]) == (True, [], 27)
    assert [p["name"] for p in result["parameters"]] == [p.name for p in fit.parameters]
    assert [p["value"] for p in result["parameters"]] == fit.values.tolist()
    covariance = np.array(result["covariance"])
    assert covariance.shape == (45, 45)
    for p, variance in zip(result["parameters"], np.diag(covariance), strict=True):
        assert (p["sigma"] is None) == (not p["identifiable"])
        assert p["sigma"] is None or p["sigma"] == pytest.approx(np.sqrt(variance), abs=1e-15)
    assert len(result["null_space"]["directions"]) == len(result["parameters"]) - result["numerical_rank"]
    assert result["noise"][0]["measurements"] == TABLE
    assert set(result["inputs"]) == {JOB, URDF, TABLE, "validation.csv"}


def test_result_does_not_depend_on_where_it_was_made(case: Path, out: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(case)
    outcome = identify(load(Path(JOB)))
    assert results.result_json(outcome) == (out / "result.json").read_text(encoding="utf-8")
    assert results.residual_table(outcome) == (out / "residuals.csv").read_text(encoding="utf-8")


def test_doubts_call_a_table_what_the_job_does(case: Path) -> None:
    """And not what it is called on this computer: reports are sent to others."""
    inputs = load(case / JOB)
    (data,) = inputs.identify
    moved = np.where(np.arange(len(data))[:, None] > len(data) // 2, [5e-3, 0.0, 0.0], 0.0)
    doubted = identify(replace(inputs, identify=(replace(data, position=data.position + moved),)))
    (said,) = (check.sentence for check in doubted.checks if check.name == "jump")
    assert said.startswith(f"{TABLE}:") and " seems to have changed, by " in said


def test_residuals_give_the_metrics(out: Path, outcome: Calibration) -> None:
    rows = list(csv.DictReader(io.StringIO((out / "residuals.csv").read_text(encoding="utf-8"))))
    assert list(rows[0]) == [
        *("use", "file", "line", "tool"),
        *(f"{when}_{axis} [mm]" for when in ("before", "after") for axis in "xyz"),
        *(f"{when}_r{axis} [deg]" for when in ("before", "after") for axis in "xyz"),
    ]
    assert [(row["use"], row["file"]) for row in rows] == [("identification", TABLE)] * 60 + [
        ("validation", "validation.csv")
    ] * 30
    table = (out.parent / TABLE).read_text(encoding="utf-8").splitlines()
    assert all(table[int(row["line"]) - 1][0] in "-0123456789" for row in rows[:60])
    for use in ("identification", "validation"):
        for when in ("before", "after"):
            error = [[float(row[f"{when}_{axis} [mm]"]) for axis in "xyz"] for row in rows if row["use"] == use]
            rms = float(np.sqrt(np.mean(np.sum(np.square(error), axis=1))))
            assert rms == pytest.approx(outcome.metrics[use][when]["position"].rms * 1e3, abs=1e-6)
    assert {row["after_rx [deg]"] for row in rows} == {""}


def test_job_has_every_default(out: Path) -> None:
    job = json.loads((out / "job.json").read_text(encoding="utf-8"))
    assert job["error_model"]["null_space"] == "nearest"
    assert job["measurements"][0]["use"] == "identify"


def test_inputs_are_untouched(case: Path, tmp_path: Path) -> None:
    before = tree(case)
    assert run("calibrate", case / JOB, "-o", tmp_path / "out").code == 0
    assert tree(case) == before


# The calibrated robot in the eyes of others. ------------------------------------------------------------------------


def tip_by_yourdfpy(robot: yourdfpy.URDF, tip: str, names: list[str], readings: Array) -> Iterator[Array]:
    for row in readings:
        robot.update_cfg(dict(zip(names, row, strict=True)))
        yield robot.get_transform(tip, robot.base_link)


def compare_at_the_tip(out: Path) -> None:
    model = calib.load_machine(out)
    names = [reading.name for reading in model.robot.readings]
    readings = np.random.default_rng(3).uniform(-2.5, 2.5, (100, len(names)))
    robot = yourdfpy.URDF.load(str(out / "calibrated.urdf"), load_meshes=False)
    seen = np.stack(list(tip_by_yourdfpy(robot, model.robot.tip, names, readings)))
    assert np.abs(seen - model.tips(readings)).max() < 1e-9
    nominal = yourdfpy.URDF.load(str(out / "nominal.urdf"), load_meshes=False)
    before = np.stack(list(tip_by_yourdfpy(nominal, model.robot.tip, names, readings)))
    assert np.abs(seen - before)[:, :3, 3].max() > 1e-3


def test_calibrated_urdf_differs_in_origins_only(case: Path, out: Path) -> None:
    nominal, calibrated = (out / "nominal.urdf").read_bytes(), (out / "calibrated.urdf").read_bytes()
    assert nominal == (case / URDF).read_bytes()
    assert nominal != calibrated
    assert without_origins(nominal) == without_origins(calibrated)


def test_another_reader_sees_the_calibrated_tip(out: Path) -> None:
    compare_at_the_tip(out)


@pytest.mark.parametrize("arm", ["mimic", "gantry", "negative"])
def test_another_reader_sees_the_tip_of_stranger_arms(arm: str, tmp_path: Path) -> None:
    """The mimic joint takes over the offset of the joint it follows, without a reading of its own."""
    text = machines.INLINE[arm]
    rng = np.random.default_rng(5)
    true = machines.arm(text, "tip").moved(rng)
    machine = machines.Machine(true, machines.anywhere(rng), {"tool": machines.pose((0.05, 0.02, 0.15))})
    readings = true.draw(rng, 80)
    columns = machines.table(true, readings, machine.see(readings), "position")
    rows = np.column_stack([np.asarray(values) for values in columns.values()])
    lines = [", ".join(columns), *(", ".join(map(repr, map(float, row))) for row in rows)]
    write("table.csv", "\n".join(lines) + "\n")(tmp_path)
    write("arm.urdf", text)(tmp_path)
    write(
        JOB,
        'schema = 1\n[robot]\nurdf = "arm.urdf"\ntip = "tip"\n[error_model]\noffsets = "all"\nplacements = "all"\n'
        '[[measurements]]\nfile = "table.csv"\nsigma = "1 um"\n',
    )(tmp_path)
    said = run("calibrate", tmp_path / JOB, "-o", tmp_path / "out")
    assert said.code == 0, said
    compare_at_the_tip(tmp_path / "out")
    nominal, calibrated = ((tmp_path / "out" / name).read_bytes() for name in ("nominal.urdf", "calibrated.urdf"))
    assert without_origins(nominal) == without_origins(calibrated)


# Instead of older results. ------------------------------------------------------------------------------------------


def test_older_results_are_replaced_whole(case: Path, outcome: Calibration, out: Path, tmp_path: Path) -> None:
    target = tmp_path / "out"
    target.mkdir()
    for name, text in (("result.json", "old"), ("model.json", '{"urdf": "nominal.urdf"}'), ("scene.html", "old")):
        write(name, text)(target)
    write_results(outcome, target)
    assert tree(target) == tree(out)
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_results_of_a_killed_run_come_back_and_are_replaced(outcome: Calibration, out: Path, tmp_path: Path) -> None:
    left(tmp_path / ".out.0123abcd.calib")
    write_results(outcome, tmp_path / "out")
    assert tree(tmp_path / "out") == tree(out)
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_link_to_results_stays_a_link(outcome: Calibration, tmp_path: Path) -> None:
    (tmp_path / "real").mkdir()
    (tmp_path / "out").symlink_to("real")
    write_results(outcome, tmp_path / "out")
    assert (tmp_path / "out").is_symlink()
    assert sorted(path.name for path in (tmp_path / "real").iterdir()) == FILES


@pytest.mark.parametrize("loading", [True, False])
def test_a_folder_that_leads_elsewhere_after_the_work_is_left_alone(
    case: Path, outcome: Calibration, tmp_path: Path, loading: bool
) -> None:
    """Whoever puts a link in its place while a calibration loads or runs does not choose what is replaced."""

    def put_link(now: bool) -> None:
        if now and not (tmp_path / "out").is_symlink():
            (tmp_path / "out").symlink_to("precious")

    write_results(outcome, tmp_path / "precious")
    (tmp_path / "precious/report.md").write_text("old")
    before = tree(tmp_path / "precious")
    with pytest.raises(OutputError, match=r"out: leads to .*precious now, and led to .*out when the work began; "):
        calibrated(case / JOB, tmp_path / "out", lambda _: put_link(loading), lambda _: put_link(not loading))
    assert tree(tmp_path / "precious") == before


def test_a_folder_above_that_becomes_a_link_at_last_leads_nowhere(outcome: Calibration, tmp_path: Path) -> None:
    """Whatever was looked at before: what the link leads to was not."""
    write_results(outcome, tmp_path / "precious/out")
    (tmp_path / "precious/out/report.md").write_text("old")
    before = tree(tmp_path / "precious")
    (tmp_path / "place").mkdir()

    def put_link(said: str) -> None:
        if said == "writing the results":
            (tmp_path / "place").rename(tmp_path / "moved")
            (tmp_path / "place").symlink_to("precious")

    with pytest.raises(OutputError, match=r"place/out: a folder above it is a link now, or has been moved; run it"):
        write_results(outcome, tmp_path / "place/out", put_link)
    assert tree(tmp_path / "precious") == before


def test_folders_on_the_way_are_made(outcome: Calibration, tmp_path: Path) -> None:
    write_results(outcome, tmp_path / "a/b/out")
    assert sorted(path.name for path in (tmp_path / "a/b/out").iterdir()) == FILES


def test_old_results_survive_a_wrong_job(case: Path, out: Path, tmp_path: Path) -> None:
    copy_case(tmp_path)
    assert run("calibrate", tmp_path / JOB, "-o", tmp_path / "out").code == 0
    before = tree(tmp_path / "out")
    keep_rows(TABLE, 9)(tmp_path)
    assert run("calibrate", tmp_path / JOB, "-o", tmp_path / "out").code == 1
    assert tree(tmp_path / "out") == before


@pytest.mark.parametrize("broken", ["render_scene", "machine_files", "residual_table", "result"])
def test_old_results_survive_an_error_at_the_last_moment(
    outcome: Calibration, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, broken: str
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise OutputError("the disk is full.")

    write_results(outcome, tmp_path / "out")
    before = tree(tmp_path)
    monkeypatch.setattr(results, broken, fail)
    with pytest.raises(OutputError, match="the disk is full"):
        write_results(outcome, tmp_path / "out")
    assert tree(tmp_path) == before


def test_libraries_known_by_another_name_do_not_cost_the_results(
    outcome: Calibration, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(calibration, "_LIBRARIES", ("no-such-distribution",))
    assert results.result(outcome)["versions"]["no-such-distribution"] is None


def test_what_is_not_finite_is_null(outcome: Calibration, tmp_path: Path) -> None:
    copy_case(tmp_path)
    edit(JOB, ('sigma = "0.02 mm"\n', "\n"), everywhere=True)(tmp_path)
    result = results.result(identify(load(tmp_path / JOB)))
    assert result["noise"][0]["chi_square"] is None
    strict(json.dumps(result, allow_nan=False))
