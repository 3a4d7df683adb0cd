"""A job that ends in a Gaussian process of the residuals: kept where held-out rows are in its favour, else said so."""

import csv
import json
import shutil
from pathlib import Path

import numpy as np
import pytest

import calib
from calib.foundations.errors import JobError
from calib.job.calibrate import steps_after_loading
from calib.job.inputs import load
from calib.job.run import run
from calib.machine.gaussian import GaussianResiduals
from calib.results.calibration import Calibration
from calib.results.folder import write_results
from tests.support import cases

IRB = Path(__file__).parents[2] / "robots" / "irb2400"
GRID = 'kind = "grid"'
LEVELS = """
[[levels]]
name = "all"
free = ["*"]

[[levels]]
name = "residual"
residual_model = { kind = "gaussian_process" }
"""


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> tuple[Calibration, Path]:
    folder = tmp_path_factory.mktemp("gaussian")
    for file in IRB.iterdir():
        if file.is_file():
            shutil.copy(file, folder)
    # A third of the nodes makes no grid, and is enough here.
    lines = (folder / "nodes.csv").read_text(encoding="utf-8").splitlines()
    head = next(n for n, line in enumerate(lines) if "joint_1" in line) + 1
    (folder / "nodes.csv").write_text("\n".join(lines[:head] + lines[head::3]) + "\n", encoding="utf-8")
    text = (IRB / "calibration.toml").read_text(encoding="utf-8")
    assert GRID in text
    (folder / "calibration.toml").write_text(text.replace(GRID, 'kind = "gaussian_process"'), encoding="utf-8")
    outcome = run(load(folder / "calibration.toml"))
    out = folder / "out"
    # Into the results of an earlier run: its file is one of the tool's own.
    write_results(outcome, out)
    write_results(outcome, out)
    return outcome, out


def test_it_is_learnt_from_the_nodes(kept: tuple[Calibration, Path]) -> None:
    outcome, out = kept
    assert isinstance(outcome.machine.residual_model, GaussianResiduals)
    nodes = load(out.parent / "calibration.toml").nodes
    assert len(outcome.machine.residual_model.points) == sum(map(len, nodes))
    kinematic, residual = (level.metrics["position"].mean for level in outcome.levels[-2:])
    assert residual < 0.9 * kinematic
    assert outcome.levels[-1].free == 3 + 2


def test_the_model_read_back_predicts_with_it(kept: tuple[Calibration, Path]) -> None:
    outcome, out = kept
    assert json.loads((out / "model.json").read_text())["residual_model"] == "gaussian.npz"
    model = calib.load_machine(out)
    (judged,) = [judged for judged in outcome.sets if judged.use == "validation"]
    predicted = model.predict(judged.data.readings)[:, :3, 3]
    np.testing.assert_allclose(judged.data.position - predicted, judged.after, atol=1e-12)


def test_commands_from_a_table(kept: tuple[Calibration, Path], tmp_path: Path) -> None:
    outcome, out = kept
    judged = outcome.sets[-1]
    rows = np.degrees(judged.data.readings[:5])
    names = [f"{reading.name} [deg]" for reading in outcome.fit.robot.readings]
    lines = [",".join(names), *(",".join(map(repr, map(float, row))) for row in rows)]
    (tmp_path / "targets.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    said = cases.run("compensate", out, tmp_path / "targets.csv", "-o", tmp_path / "corrected.csv")
    assert said.code == 0, said
    with (tmp_path / "corrected.csv").open(encoding="utf-8") as stream:
        corrected = list(csv.DictReader(stream))
    assert all(row["reached"] == "yes" for row in corrected), corrected
    assert all(float(row["remaining_error [mm]"]) < 1e-3 for row in corrected)


def test_an_arm_without_anything_unexplained_gets_none(tmp_path: Path) -> None:
    """From the rows to identify from, as there are no nodes; the simulated errors are noise."""
    path = cases.copy_case(tmp_path)
    with path.open("a", encoding="utf-8") as stream:
        stream.write(LEVELS)
    inputs = load(path)
    told: list[str] = []
    outcome = run(inputs, told.append)
    assert told.count("learning the Gaussian process") == 1
    assert len(told) + 4 == steps_after_loading(inputs)
    assert outcome.machine.residual_model is None
    assert [level.name for level in outcome.levels] == ["all"]
    (sentence,) = [f.sentence for f in outcome.findings if f.code == "gaussian-process-left-out"]
    assert sentence.startswith("The Gaussian process is left out: at rows held out it brings the position error from ")
    write_results(outcome, tmp_path / "out")
    assert not (tmp_path / "out" / "gaussian.npz").exists()
    assert sentence in json.loads((tmp_path / "out" / "result.json").read_text())["findings"]
    assert sentence.split(":")[0] in (tmp_path / "out" / "report.md").read_text(encoding="utf-8")
    assert calib.load_machine(tmp_path / "out").residual_model is None


def test_rows_that_a_robust_loss_lets_go_teach_it_nothing(tmp_path: Path) -> None:
    """Two wrong rows of sixty would make it seem useless: it is made of the others, as the fit is."""
    path = cases.copy_case(tmp_path)
    text = path.read_text(encoding="utf-8") + LEVELS
    text = text.replace('observes = "position"', 'observes = "position"\nloss = "cauchy"', 1)
    path.write_text(text.replace('placements = "all"', ""), encoding="utf-8")
    lines = (tmp_path / "identification.csv").read_text(encoding="utf-8").splitlines()
    head = next(n for n, line in enumerate(lines) if line.startswith("joint_1"))
    rows = [list(map(float, line.split(","))) for line in lines[head + 1 :]]
    x = lines[head].split(", ").index("x [mm]")
    for n, row in enumerate(rows):
        row[x] += 3.0 * np.sin(np.radians(3.0 * row[0])) + (40.0 if n in (7, 30) else 0.0)
    table = [lines[head], *(",".join(map(repr, map(float, row))) for row in rows)]
    (tmp_path / "identification.csv").write_text("\n".join(table) + "\n", encoding="utf-8")
    known = run(load(path)).machine.residual_model
    assert isinstance(known, GaussianResiduals)
    assert len(known.points) == len(rows) - 2


@pytest.mark.parametrize(
    ("kind", "sentence"),
    [
        ('kind = "grid"', "levels[1].residual_model.joints: is missing; a grid spans joints that are named."),
        (
            'kind = "grid", joints = ["joint_1"]',
            'levels: no measurements have use = "nodes", and a residual grid is made of these.',
        ),
        ('kind = "gaussian_process", joints = ["joint_99"]', "a residual model cannot follow 'joint_99'"),
        ('kind = "gaussian_process", joints = []', "levels[1].residual_model.joints"),
        (
            'kind = "gaussian_process" }\nmeasurements = ["identification.csv"]\n#',
            """has not use = "nodes"; with it: none; leave the key out, and those to identify from are taken.""",
        ),
    ],
)
def test_wrong_residual_models_are_refused(kind: str, sentence: str, tmp_path: Path) -> None:
    path = cases.copy_case(tmp_path)
    with path.open("a", encoding="utf-8") as stream:
        stream.write(LEVELS.replace('kind = "gaussian_process"', kind))
    with pytest.raises(JobError) as caught:
        load(path)
    assert sentence in str(caught.value)
    assert str(caught.value).startswith(str(path))


def test_a_payload_on_another_link_leaves_it_one_arm(tmp_path: Path) -> None:
    path = cases.copy_case(tmp_path)
    text = path.read_text(encoding="utf-8")
    heavy = '[robot]\npayload = { mass = "1 kg", link = "link_5" }'
    assert "[robot]" in text
    path.write_text(text.replace("[robot]", heavy) + LEVELS, encoding="utf-8")
    outcome = run(load(path))
    assert len(outcome.machine.robot.links) == 2
    assert "gaussian-process-left-out" in {finding.code for finding in outcome.findings}


def test_two_tips_are_refused(tmp_path: Path) -> None:
    path = cases.copy_case(tmp_path)
    text = path.read_text(encoding="utf-8").replace('use = "validate"', 'tip = "link_5"')
    path.write_text(text + LEVELS, encoding="utf-8")
    with pytest.raises(JobError, match=r"levels\[1\]\.residual_model: is of one tip, .* several: 'link_5', 'probe'"):
        load(path)
