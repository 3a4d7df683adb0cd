"""Jobs of streams: from two files to a folder of results, and what is wrong with them in one sentence."""

import functools
import json
from pathlib import Path

import numpy as np
import pytest

import calib
from calib.foundations.errors import JobError, MeasurementError
from scripts.simulate import streams as simulated
from tests.support import streams
from tests.support.cases import run


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("streams")
    simulated.write_case(folder, 2, 30.0)
    return folder


def test_a_job_of_streams_finds_clock_and_machine(case: Path) -> None:
    said = run("calibrate", case / "calibration.toml", "-o", case / "out")
    assert said.code == 0, said.err
    result = json.loads((case / "out" / "result.json").read_text())
    found = {one["name"]: one for one in result["parameters"]}
    assert found["clock.skew"]["value"] == pytest.approx(1e-3, abs=5.0 * found["clock.skew"]["sigma"])
    assert found["clock.offset"]["value"] == pytest.approx(7.3, abs=5e-4)
    assert found["clock.offset"]["unit"] == "s"
    assert set(result["inputs"]) >= {"tracker.csv", "joints.csv"}
    page = (case / "out" / "report.html").read_text()
    for title in ("Over time", "Speed of the tool, tracker.csv", "Error over time", "Autocorrelation of the residuals"):
        assert title in page
    assert "+7300." in page
    assert "us/s" in page

    # What is made of the results: the clock is of the set-up, and no machine by itself knows it.
    studied = run("sensitivity", case / "calibration.toml", "--errors", case / "out", "--json")
    assert (studied.code, studied.err) == (0, "")
    assert json.loads(studied.out)["groups"]
    machine = calib.load_machine(case / "out")
    data = calib.measuring.read_stream(case / "tracker.csv", machine.robot, case / "joints.csv", clock="free")
    for judge in (machine.residuals, functools.partial(calib.verify, machine)):
        with pytest.raises(MeasurementError, match="its clock is free, and a machine by itself does not know it"):
            judge(data)


def test_two_streams_of_one_clock_have_one_offset_and_the_second_its_latency(case: Path) -> None:
    head, *rows = (case / "tracker.csv").read_text().splitlines()
    (case / "own.csv").write_text("\n".join([head, *rows[::2]]) + "\n")
    late = [",".join([f"{float(t) - 0.004:.9f}", rest]) for t, rest in (row.split(",", 1) for row in rows[1::2])]
    (case / "late.csv").write_text("\n".join([head, *late]) + "\n")
    text = (case / "calibration.toml").read_text().replace("tracker.csv", "own.csv")
    more = 'file = "late.csv"\nreadings = "joints.csv"\nclock_of = "own.csv"\nlatency = "free"\nsigma = "0.1 mm"\n'
    (case / "two.toml").write_text(f"{text}\n[[measurements]]\n{more}")
    said = run("calibrate", case / "two.toml", "-o", case / "two")
    assert said.code in (0, 3), said.err
    found = {one["name"]: one for one in json.loads((case / "two" / "result.json").read_text())["parameters"]}
    assert {name for name in found if name.startswith("clock")} == {
        "clock.own.offset",
        "clock.own.skew",
        "clock.late.latency",
    }
    latency = found["clock.late.latency"]
    assert latency["value"] == pytest.approx(-0.004, abs=5.0 * latency["sigma"])


WRONG = {
    "clock without readings": (
        'readings = "joints.csv"       # time [s], joints\n',
        "",
        "tracker.csv: clock: is of a stream, and no readings are named.",
    ),
    "latency of a free clock": (
        'clock = "free" ',
        'clock = "free"\nlatency = "free" ',
        "latency: is free, and the clock is free too: the data cannot tell the latency from the clock's offset; "
        'write clock = "given", or clock_of if another stream has the same clock, or leave latency out.',
    ),
    "clock of what is no stream": (
        'clock = "free" ',
        'clock_of = "other.csv" ',
        "tracker.csv: clock_of: 'other.csv' is not a stream with a clock of its own above this one.",
    ),
    "another word": ('clock = "free" ', 'clock = "loose" ', "measurements[0].clock: 'loose' is not "),
    "gap": ('clock = "free" ', 'gap = "1 mm"\nclock = "free" ', "measurements[0].gap: unit 'mm' is not a unit of time"),
    "no such file": ('"joints.csv"', '"joint.csv"', "joint.csv: there is no such file."),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_is_wrong_is_one_sentence(case: Path, name: str) -> None:
    old, new, sentence = WRONG[name]
    text = (case / "calibration.toml").read_text()
    assert old in text
    path = case / f"{name.replace(' ', '_')}.toml"
    path.write_text(text.replace(old, new))
    said = run("check", path)
    assert said.code == 1
    assert sentence in said.err
    assert len(said.err.strip().splitlines()) == 1 or "\n" not in said.err.strip().replace("\n  ", " ")


def test_a_selection_of_rows_tells_more_than_as_many_evenly_spread() -> None:
    made = streams.streams(21, seconds=40.0)
    data = streams.read(made, sigma=1e-4)
    model = calib.error_model(made.robot, offsets="all", placements="all")
    few = calib.planning.most_telling(model, data, 60)
    assert len(few) == 60
    assert np.all(np.diff(few.lines) > 0)
    spread = data.subset(np.linspace(0, len(data) - 1, 60).astype(np.intp))
    fits = [calib.identify(model, some, model_sigmas=[0.0]) for some in (few, spread)]
    rank = min(fit.numerical_rank for fit in fits)
    few_told, spread_told = (np.log(fit.singular_values[:rank]) for fit in fits)
    assert np.mean(few_told - spread_told) > 0.08
    with pytest.raises(JobError, match="rows cannot be chosen; allowed are 1 to"):
        calib.planning.most_telling(model, data, len(data) + 1)
