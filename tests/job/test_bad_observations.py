"""Bad input about sockets, gauges, planes, balls and indicators: one clear sentence each, and nothing written."""

import shutil
from pathlib import Path

import pytest

from tests.support.cases import CASE, Edit, edit, run, tree

JOB = "calibration_gauges.toml"
TABLES = ("cone.csv", "lengths.csv", "sphere.csv", "probe.csv", "articulations.csv")
FIRST = "[[measurements]]     # three cones"


def job(old: str, new: str) -> Edit:
    return edit(JOB, (old, new))


def section(text: str) -> Edit:
    """Put a section before the measurements."""
    return edit(JOB, (FIRST, f"{text}\n{FIRST}"))


def relation(what: str, sigma: str = "0.01 mm", targets: str = '"near", "far"') -> Edit:
    return section(f'[[relations]]\ntargets = [{targets}]\n{what}\nsigma = "{sigma}"\n')


def cones(more: str) -> Edit:
    """Add keys to the table of cones."""
    return job('observes = "socket"\n', f'observes = "socket"\n{more}\n')


def two_tables(kind: str) -> Edit:
    return edit(
        JOB, ('observes = "sphere"\ntargets = { near = "sphere near", far = "sphere far" }', f'observes = "{kind}"')
    )


FIRST_PAIR = ", A, 1, 299.987"
CASES: dict[str, Edit] = {
    "kind unknown": job('"socket"', '"sockets"'),
    "pair of one row": edit("lengths.csv", (FIRST_PAIR, ", A, 0, 299.987")),
    "pair of two lengths": edit("lengths.csv", (FIRST_PAIR, ", A, 1, 299.986")),
    "pairs without a column": edit("lengths.csv", ("pair,", "time [s],")),
    "lengths without a column": edit("lengths.csv", ("length [mm]", "time [s]")),
    "diameter without a column": edit("sphere.csv", ("diameter [mm]", "time [s]")),
    "diameter in degrees": edit("sphere.csv", ("diameter [mm]", "diameter [deg]")),
    "dial without a column": job('"socket"', '"indicator"'),
    "noise of coordinates of lengths": edit("lengths.csv", ("length [mm]", "sigma_x [mm]")),
    "point and plane": two_tables("plane"),
    "socket and ball": two_tables("sphere"),
    "direction of a dial": job('"pair_distance"', '"indicator"\ncolumns = { indicated = "length" }'),
    "offset of sockets": cones('length_offset = "bar"'),
    "offset empty": job('"pair_distance"', '"pair_distance"\nlength_offset = ""'),
    "radius known and unknown": job('observes = "sphere"', 'observes = "sphere"\nlength_offset = "ball"'),
    "tracker of sockets": (
        edit(
            JOB,
            ('"socket"', '"socket"\ninstrument = "leica"'),
            (FIRST, f'[instruments.leica]\nkind = "laser_tracker"\nsigma = "1 mm"\n{FIRST}'),
        )
    ),
    "nodes of sockets": cones('use = "nodes"'),
    "angles of sockets": cones('sigma_angle = "1 deg"'),
    "loss unknown": cones('loss = "hubert"'),
    "loss of held-out data": job('use = "validate"', 'use = "validate"\nloss = "huber"'),
    "target called otherwise is not there": cones('targets = { fern = "far" }'),
    "targets called the same": cones('targets = { near = "far" }'),
    "known target not measured": section('[targets.fern]\nposition = ["0 m", "0 m", "1 m"]\n'),
    "known target of nothing": section("[targets.far]\n"),
    "known target of two things": section(
        '[targets.far]\nposition = ["0 m", "0 m", "1 m"]\nnormal = [0.0, 0.0, 1.0]\n'
    ),
    "known height of a point": section('[targets.far]\nposition = ["0 m", "0 m", "1 m"]\nheight = "1 m"\n'),
    "known normal of nothing": section("[targets.far]\nnormal = [0.0, 0.0, 0.0]\n"),
    "known socket with a normal": section("[targets.far]\nnormal = [0.0, 0.0, 1.0]\n"),
    "relation of nothing": relation(""),
    "relation of two things": relation('distance = "1 m"\nangle = "1 deg"'),
    "relation of three": relation('distance = "1 m"', targets='"near", "far", "middle"'),
    "relation with itself": relation('distance = "1 m"', targets='"near", "near"'),
    "relation with nobody": relation('distance = "1 m"', targets='"near", "fern"'),
    "relation of wrong shapes": relation('angle = "1 deg"', "1 deg"),
    "relation with a negative distance": relation('distance = "-1 m"'),
    "relation in another unit": relation('distance = "1 deg"'),
    "relation's sigma in another unit": relation('distance = "1 m"', "1 deg"),
    "relation's sigma zero": relation('distance = "1 m"', "0 mm"),
}

# What is said to each case, one line each: read them as a user would.
SENTENCES = dict(
    line.split(" | ")
    for line in Path(__file__).with_name("observation_sentences.txt").read_text(encoding="utf-8").splitlines()
)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    for name in (JOB, "arm_cmm.urdf", *TABLES):
        shutil.copyfile(CASE / name, tmp_path / name)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("name", CASES)
def test_sentence(folder: Path, name: str) -> None:
    CASES[name](folder)
    before = tree(folder)
    assert run("calibrate", JOB, "-o", "out") == (1, "", f"Error: {SENTENCES[name]}\n")
    assert tree(folder) == before


def test_every_sentence_is_said() -> None:
    assert list(SENTENCES) == list(CASES)
