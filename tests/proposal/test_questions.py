"""What ``calib init`` asks a person at a terminal, and what it makes of the answers."""

import itertools
import os
import pty
import select
import signal
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import NamedTuple
from unicodedata import normalize

import numpy as np
import pytest

import calib
from tests.proposal.twins import TWINS
from tests.support.cases import TABLE, copy_case, edit, run
from tests.support.machines import urdf
from tests.support.people import UR10

# What is started in the background hears no Ctrl-C unless it asks for it.
MAIN = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler); from calib_start import main; main()"
OF = {twin.name: twin for twin in TWINS}


class Talk(NamedTuple):
    code: int
    said: str
    job: dict[str, object] | None


def talk(folder: Path, twin: str, answers: str, titles: tuple[str, str] = ("", "")) -> Talk:
    """Run ``calib init`` at a terminal where a person types ``answers``."""
    contents = OF[twin].contents()
    assert isinstance(contents, str)
    (folder / "measured.csv").write_text(contents.replace(*titles) if titles[0] else contents, encoding="utf-8")
    ours, theirs = pty.openpty()
    os.write(ours, answers.encode())
    command = [sys.executable, "-c", "from calib.cli import main; main()", "init", UR10, "measured.csv"]
    done = subprocess.run(command, cwd=folder, stdin=theirs, capture_output=True, timeout=120, check=False)
    os.close(ours)
    os.close(theirs)
    job = folder / "calibration.toml"
    read = tomllib.loads(job.read_text(encoding="utf-8")) if job.exists() else None
    return Talk(done.returncode, done.stderr.decode() + done.stdout.decode(), read)


UNITS = "four rows without units, of which two would do"


def columns(talk: Talk) -> dict[str, str]:
    assert talk.job is not None, talk.said
    return talk.job["measurements"][0]["columns"]  # type: ignore[index, no-any-return]


def test_a_unit_is_asked_until_the_answer_is_one_of_the_choices(tmp_path: Path) -> None:
    found = talk(tmp_path, UNITS, "degrees\n7\n2\n")
    assert found.code == 0
    assert "J1 to J6 have no unit, and rad and deg are both within the limits" in found.said
    assert "  1  rad\n  2  deg\n" in found.said
    assert found.said.count("Which") == 3
    assert columns(found)["shoulder_pan_joint [deg]"] == "J1"


def test_columns_are_asked_by_their_titles(tmp_path: Path) -> None:
    found = talk(tmp_path, "stations under a word of their own", "1\n")
    assert found.code == 0
    assert "  1  'setup=Station'\n  2  'tool=Station'\n" in found.said
    assert columns(found)["setup"] == "Station"


def test_a_title_cannot_command_the_terminal(tmp_path: Path) -> None:
    found = talk(tmp_path, "stations under a word of their own", "1\n", ("Station", "\x1bcStation"))
    assert "\\x1bcStation" in found.said
    assert "\x1b" not in found.said
    assert columns(found)["setup"] == "\x1bcStation"


def test_an_end_of_answers_ends_it_and_writes_nothing(tmp_path: Path) -> None:
    found = talk(tmp_path, UNITS, "\x04")
    assert found.code == 1
    assert found.job is None
    assert "Traceback" not in found.said


def test_ctrl_c_at_a_question_has_its_exit_code(tmp_path: Path) -> None:
    (tmp_path / "measured.csv").write_text(str(OF[UNITS].contents()), encoding="utf-8")
    ours, theirs = pty.openpty()
    command = [sys.executable, "-c", MAIN, "init", UR10, "measured.csv"]
    asking = subprocess.Popen(command, cwd=tmp_path, stdin=theirs, stdout=theirs, stderr=subprocess.PIPE, text=True)
    assert asking.stderr is not None
    said = ""
    while not said.endswith("Which: "):
        said += asking.stderr.read(1)
    # Python hears one that comes just before it waits only when another one comes.
    for _ in range(60):
        asking.send_signal(signal.SIGINT)
        if select.select([asking.stderr], [], [], 0.5)[0]:
            break
    assert asking.communicate(timeout=60)[1].strip() == "Error: interrupted."
    assert asking.returncode == 130
    os.close(ours)
    os.close(theirs)


def test_what_has_no_choices_is_an_error_at_a_terminal_too(tmp_path: Path) -> None:
    found = talk(tmp_path, "a tracker that was moved, and nothing says so", "1\n")
    assert found.code == 1
    assert "answer by a column setup, or tool" in found.said
    assert found.job is None


@pytest.mark.parametrize("option", ["--quiet", "--json"])
def test_nobody_is_asked(tmp_path: Path, option: str) -> None:
    (tmp_path / "measured.csv").write_text(str(OF[UNITS].contents()), encoding="utf-8")
    ours, theirs = pty.openpty()
    command = [sys.executable, "-c", "from calib.cli import main; main()", "init", UR10, "measured.csv", option]
    done = subprocess.run(command, cwd=tmp_path, stdin=theirs, capture_output=True, timeout=120, check=False)
    os.close(ours)
    os.close(theirs)
    assert (done.returncode, b"Which" in done.stderr) == (1, False)


@pytest.mark.parametrize("titles", ["jx [mm],jy [mm],jz [mm],x,y,z", "x,y,z,mx,my,mz", "q1 [mm],q2 [mm],q3 [mm],x,y,z"])
def test_nothing_is_asked_of_an_arm_whose_joints_are_called_as_columns(titles: str, tmp_path: Path) -> None:
    """No answer would make a job of it, as of a gantry with the joints x, y and z."""
    axes = {"x": "1 0 0", "y": "0 1 0", "z": "0 0 1"}
    text = urdf(*((name, "prismatic", "0 0 0.1", "0 0 0", axis) for name, axis in axes.items()))
    (tmp_path / "gantry.urdf").write_text(text, encoding="utf-8")
    rows = "".join(f"{a},{b},{c},{a},{b},{c + 300}\n" for a, b, c in itertools.product((10, 220, 430), repeat=3))
    (tmp_path / "table.csv").write_text(f"{titles}\n{rows}", encoding="utf-8")
    with pytest.raises(calib.MeasurementError, match="joint 'x' has the name of a measured column; rename the joint"):
        calib.measuring.propose(tmp_path / "gantry.urdf", [tmp_path / "table.csv"])


@pytest.mark.parametrize(
    "titles", ["X [mm],Y [mm],Z [mm],x [mm],y [mm],z [mm]", "x [mm],X [mm],y [mm],Y [mm],z [mm],Z [mm]"]
)
def test_joints_in_capitals_stand_beside_a_point_in_small_letters(titles: str, tmp_path: Path) -> None:
    """A gantry's own columns are no measured point, and the point beside them is seen."""
    axes = {"X": "1 0 0", "Y": "0 1 0", "Z": "0 0 1"}
    text = urdf(*((name, "prismatic", "0 0 0.1", "0 0 0", axis) for name, axis in axes.items()))
    (tmp_path / "gantry.urdf").write_text(text, encoding="utf-8")
    rows = []
    for q in itertools.product((10, 220, 430), repeat=3):
        of = {**dict(zip("XYZ", q, strict=True)), "x": -q[1] + 55, "y": q[0] - 80, "z": q[2] + 300}
        rows.append(",".join(str(of[title[0]]) for title in titles.split(",")))
    (tmp_path / "table.csv").write_text("\n".join([titles, *rows]) + "\n", encoding="utf-8")
    found = calib.measuring.propose(tmp_path / "gantry.urdf", [tmp_path / "table.csv"])
    assert found.questions == ()
    assert found.tables[0].columns.names == {f"{name} [mm]": f"{name} [mm]" for name in "XYZxyz"}
    assert found.tables[0].columns.ignore == ()


@pytest.mark.parametrize("names", [("A", "a", "B", "b", "C", "c"), ("\u0131", "i", "I", "\u0130", "\u017f", "s")])
def test_columns_that_are_called_just_as_joints_are_these_whatever_is_alike(
    names: tuple[str, ...], tmp_path: Path
) -> None:
    """Of joints that capitals alone tell apart, only the first one was found, in an arm that ended there."""
    axes = ("0 0 1", "0 1 0", "0 1 0", "1 0 0", "0 1 0", "1 0 0")
    joints = [(name, "revolute", "0.1 0 0.3", "0 0 0", axis) for name, axis in zip(names, axes, strict=True)]
    (tmp_path / "arm.urdf").write_text(urdf(*joints), encoding="utf-8")
    q = np.random.default_rng(3).uniform(-1.5, 1.5, (40, 6))
    at = 1e3 * calib.load_robot(tmp_path / "arm.urdf", "tip").tips(q)[:, :3, 3]
    titles = ",".join([*(f"{name} [deg]" for name in names), "x [mm],y [mm],z [mm]"])
    np.savetxt(
        tmp_path / "t.csv", np.hstack([np.degrees(q), at]), delimiter=",", header=titles, comments="", encoding="utf-8"
    )
    found = calib.measuring.propose(tmp_path / "arm.urdf", [tmp_path / "t.csv"])
    assert (found.robot.tip, found.tables[0].columns.ignore) == ("tip", ())
    assert f"{names[0]} [deg] to {names[-1]} [deg] are" in found.reasons[0]


def test_accents_of_columns_may_be_characters_of_their_own(tmp_path: Path) -> None:
    """No column was a joint of the arm, and the sentence about it named both alike."""
    names = [normalize("NFC", name) for name in ("größe", "coude_é", "poignet_è")]
    axes = ("0 0 1", "0 1 0", "1 0 0")
    joints = [(name, "revolute", "0.1 0 0.3", "0 0 0", axis) for name, axis in zip(names, axes, strict=True)]
    (tmp_path / "arm.urdf").write_text(urdf(*joints), encoding="utf-8")
    q = np.random.default_rng(3).uniform(-1.5, 1.5, (40, 3))
    at = 1e3 * calib.load_robot(tmp_path / "arm.urdf", "tip").tips(q)[:, :3, 3]
    titles = [f"{normalize('NFD', name)} [deg]" for name in names]
    header = ",".join([*titles, "x [mm],y [mm],z [mm]"])
    np.savetxt(
        tmp_path / "t.csv", np.hstack([np.degrees(q), at]), delimiter=",", header=header, comments="", encoding="utf-8"
    )
    found = calib.measuring.propose(tmp_path / "arm.urdf", [tmp_path / "t.csv"])
    told = {f"{name} [deg]": title for name, title in zip(names, titles, strict=True)}
    assert found.tables[0].columns.names.items() >= told.items()
    (tmp_path / "job.toml").write_text(
        'schema = 1\n[robot]\nurdf = "arm.urdf"\n[error_model]\noffsets = "all"\n[[measurements]]\nfile = "t.csv"\n',
        encoding="utf-8",
    )
    said = run("check", tmp_path / "job.toml")
    assert said.code == 1
    assert r"'gro\u0308ße'" in said.err
    assert r'write in the job: columns = { "größe [deg]" = "gro\u0308ße [deg]"' in said.err


@pytest.mark.parametrize("first", ["axis one", "joint_1 [deg]"])
def test_columns_of_an_arm_whose_joints_a_job_couples_are_looked_for_in_all_of_it(first: str, tmp_path: Path) -> None:
    """From its second joint on it was looked at without the coupling, and had a joint more: a traceback."""
    job = copy_case(tmp_path)
    edit(
        job.name, ('tip = "probe"', 'tip = "probe"\n[[robot.coupling]]\njoint = "joint_3"\ndrivers = {joint_2 = -1.0}')
    )(tmp_path)
    for name in (TABLE, "validation.csv"):
        lines = [line for line in (tmp_path / name).read_text(encoding="utf-8").splitlines() if line[0] != "#"]
        rows = [[*line.split(",")[:2], *line.split(",")[3:]] for line in lines]
        rows[0][0] = first
        (tmp_path / name).write_text("\n".join(",".join(row) for row in rows) + "\n", encoding="utf-8")
    said = run("check", job)
    missing = (
        "" if "[" in first else "column 'axis one' has no unit; write one in brackets, like 'axis one [mm]' or '[deg]'."
    )
    assert said.code == (1 if missing else 0)
    assert missing in said.err
