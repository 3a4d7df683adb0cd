"""A job that leaves the widths of its priors to the data: what was learned is used, kept and told."""

import json
import shutil
from pathlib import Path

import pytest

from calib.job.inputs import load
from calib.job.run import run
from calib.presentation.fit_tables import table
from calib.presentation.report.document import Prose
from calib.presentation.sheets import prior_sentences
from calib.results.calibration import Calibration
from calib.results.folder import write_results
from calib.results.report import report_of
from tests.job.test_terms import CASE, JOB

STATED = 'prior = { length = "0.3 mm", angle = "0.5 mrad", harmonics = "0.1 mrad" }'
LEARNED = 'prior = { length = "learned", angle = "learned", harmonics = "learned" }'


@pytest.fixture(scope="module")
def learned(tmp_path_factory: pytest.TempPathFactory) -> tuple[Calibration, Path]:
    folder = tmp_path_factory.mktemp("learned")
    for name in ("irb2400.urdf", "harmonics.csv", "test.csv"):
        shutil.copy(CASE / name, folder)
    text = (CASE / JOB).read_text(encoding="utf-8")
    assert STATED in text
    (folder / JOB).write_text(text.replace(STATED, LEARNED), encoding="utf-8")
    outcome = run(load(folder / JOB))
    write_results(outcome, folder / "out")
    return outcome, folder / "out"


def test_errors_are_as_small_as_with_priors_of_one_who_knows(learned: tuple[Calibration, Path]) -> None:
    """Scatter and tracker alone make 0.038 mm; the stated priors are those that the machine was drawn with."""
    assert learned[0].metrics["validation"]["after"]["position"].mean < 1.1 * 0.0382e-3


def test_the_result_and_the_report_tell_what_was_learned(learned: tuple[Calibration, Path]) -> None:
    outcome, out = learned
    result = json.loads((out / "result.json").read_text())
    told = {prior["group"]: prior for prior in result["learned_priors"]}
    assert {"link translations", "link rotations", "offsets of joints that turn", "harmonics of joint_1"} <= set(told)
    for prior in told.values():
        assert prior["outcome"] in ("learned", "too few", "nothing shows")
        assert 0.0 <= prior["taught"] <= prior["parameters"] + 1e-9
    by_name = {parameter["name"]: parameter["prior"] for parameter in result["parameters"]}
    assert by_name["joint_1.sin_5"] == told["harmonics of joint_1"]["width"]
    assert by_name["base.x"] is None
    said = prior_sentences(outcome.fit)
    assert len(said) == len(told)
    section = next(s for s in report_of(outcome).sections if s.key == "priors")
    assert section.blocks == (Prose(said, brief=True),)
    assert "Prior of link translations: 0." in (out / "report.md").read_text(encoding="utf-8")
    assert all(sentence.split(":")[0] in " ".join(table(outcome.fit).split()) for sentence in said)
    assert "deg" in next(sentence for sentence in said if "link rotations" in sentence)
