"""What a job says of itself: date, serial number, operator and note, as the report repeats them."""

import json
from pathlib import Path

import pytest

from calib.job.schema import AboutSection
from tests.support.cases import JOB, copy_case, run


def about(folder: Path, text: str) -> str:
    job = Path(copy_case(folder))
    job.write_text(job.read_text(encoding="utf-8").replace("schema = 1\n", f"schema = 1\n[about]\n{text}\n", 1))
    return str(job)


def test_the_report_repeats_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    job = about(tmp_path, 'date = 2025-03-31\nserial = "24-10-7"\nnote = "after <the> change"')
    assert run("calibrate", job, "-o", "out", "-q").code == 0
    page = (tmp_path / "out/report.html").read_text(encoding="utf-8")
    for name, said in (("date", "2025-03-31"), ("serial", "24-10-7"), ("note", "after &lt;the&gt; change")):
        assert f"<dt>{name}</dt><dd>{said}</dd>" in page
    assert "operator" not in page
    assert '<a href="scene.html">' in page
    told = json.loads((tmp_path / "out/job.json").read_text(encoding="utf-8"))["about"]
    assert told == {"date": "2025-03-31", "serial": "24-10-7", "operator": None, "note": "after <the> change"}


@pytest.mark.parametrize("name", ["佐藤\u3000太郎", "می\u200cرود", "M.\u00a0Dupont", "\U0001f469\u200d\U0001f527"])
def test_names_may_have_wide_spaces_and_joiners_as_japanese_and_persian_ones_do(name: str) -> None:
    assert AboutSection.model_validate({"operator": name}).operator == name


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("date = 2025-03-31T10:00:00", "about.date: '2025-03-31 10:00:00' is not a date like 2025-03-31."),
        ('date = "31.3.2025"', "about.date: '31.3.2025' is not a date like 2025-03-31."),
        ("serial = 7", "about.serial: 7 is not one line of text of at most 500 characters."),
        (f'note = "{501 * "a"}"', "is not one line of text of at most 500 characters."),
        (r'note = "a\nb"', "is not one line of text of at most 500 characters."),
        (r'note = "a\u2028b"', "is not one line of text of at most 500 characters."),
        (r'note = "a\u001b[2Jb"', "is not one line of text of at most 500 characters."),
        (r'note = "a\u202eb"', "is not one line of text of at most 500 characters."),
        ('operator = " "', "about.operator: ' ' is not one line of text of at most 500 characters."),
    ],
)
def test_what_cannot_be_said_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str, sentence: str
) -> None:
    monkeypatch.chdir(tmp_path)
    said = run("calibrate", about(tmp_path, text), "-o", "out")
    assert (said.code, said.out, said.err.count("\n")) == (1, "", 1)
    assert said.err.startswith(f"Error: {tmp_path / JOB}: about.")
    assert said.err.endswith(f"{sentence}\n")
    assert not (tmp_path / "out").exists()
