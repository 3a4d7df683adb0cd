"""The case robots/hand_eye: run as a user runs it, made as the script makes it, and refused where it is spoilt."""

import csv
import json
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.support.cases import ROOT, Edit, append, edit, keep_rows, run

CASE = ROOT / "robots" / "hand_eye"
FILES = ("calibration.toml", "identification.csv", "validation.csv")


def test_script_reproduces_the_committed_files(tmp_path: Path) -> None:
    script = ROOT / "scripts/simulate/hand_eye.py"
    subprocess.run([sys.executable, str(script), str(tmp_path)], check=True, capture_output=True)
    for name in ("identification.csv", "validation.csv", "truth.toml"):
        assert (tmp_path / name).read_bytes() == (CASE / name).read_bytes(), name


@pytest.fixture(scope="module")
def calibrated(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    out = tmp_path_factory.mktemp("hand_eye") / "out"
    said = run("calibrate", CASE / "calibration.toml", "-o", out)
    assert (said.code, said.err) == (0, "")
    return out, said.out


def test_the_terminal_says_pixels(calibrated: tuple[Path, str]) -> None:
    _, said = calibrated
    rows = [line.split() for line in said.splitlines() if line.split()[1:2] in (["before"], ["after"])]
    assert [(row[0], row[1], row[-1]) for row in rows] == [
        (of, when, "px")
        for use in ("identification", "validation")
        for of, when in ((use, "before"), ("pixels", "after"))
    ]
    assert "Noise of one pixels coordinate: 0.2000 px instrument" in said
    assert "The data determine 39 combinations of 58 parameters." in said


def test_the_figures_are_those_of_the_residuals(calibrated: tuple[Path, str]) -> None:
    out, _ = calibrated
    result = json.loads((out / "result.json").read_text(encoding="utf-8"))
    with (out / "residuals.csv").open(encoding="utf-8", newline="") as file:
        rows = [row for row in csv.DictReader(file) if row["use"] == "validation"]
    for when in ("before", "after"):
        norms = np.hypot(*(np.array([float(row[f"{when}_{axis} [px]"]) for row in rows]) for axis in "uv"))
        told = result["metrics"]["validation"][when]["pixels"]
        assert told["unit"] == "px"
        assert told["n"] == len(norms)
        assert told["rms"] == pytest.approx(np.sqrt(np.mean(norms**2)), abs=1e-4)
    # Two coordinates with 0.2 px each; what is left of the model is small beside them.
    assert told["rms"] < 1.1 * 0.2 * np.sqrt(2.0)
    assert result["noise"][0]["instrument"] == pytest.approx(0.2)
    # The simulated arm comes back to where it was.
    assert result["together"] == []


def test_camera_and_board_are_found(calibrated: tuple[Path, str]) -> None:
    """To what a choice among equal fits leaves: errors of the first and last joint are camera's and board's as well."""
    out, _ = calibrated
    result = json.loads((out / "result.json").read_text(encoding="utf-8"))
    truth = tomllib.loads((CASE / "truth.toml").read_text(encoding="utf-8"))
    for found, true in ((result["tools"]["tool"], truth["camera"]), (result["targets"]["board"], truth["board"])):
        assert np.linalg.norm(1e3 * np.array(found["position"]) - true["position_mm"]) < 3.0
        turns = [Rotation.from_quat(q, scalar_first=True) for q in (found["quaternion"], true["quaternion_wxyz"])]
        assert (turns[0].inv() * turns[1]).magnitude() < 5e-3


def test_check_counts_what_is_seen() -> None:
    said = run("check", CASE / "calibration.toml", "--json")
    told = json.loads(said.out)
    # Nine numbers of the lens are seen; of the board's scale a robot that is all free tells nothing.
    assert (told["rank"], len(told["parameters"])) == (39, 58)


JOB = "calibration.toml"
LENS = {"fx": 1395.2, "fy": 1393.8, "cx": 648.3, "cy": 505.9}
BENT = {"k1": "-0.1124", "k2": "0.1387", "p1": "0.00031", "p2": "-0.00047", "k3": "-0.0312"}
BROKEN: dict[str, tuple[Edit, str]] = {
    "camera without its place": (edit(JOB, ('camera_on = "tip"\n', "")), "instruments.camera.camera_on: is missing"),
    "camera without focal length": (edit(JOB, ('fx = "1395.2 px"\n', "")), "instruments.camera.fx: is missing"),
    "camera elsewhere": (edit(JOB, ('"tip"\nlens', '"wall"\nlens')), '\'wall\' is not "floor", "tip" or a link'),
    "focal length zero": (edit(JOB, ("1395.2 px", "0 px")), "instruments.camera.fx: '0 px' is not above 0"),
    "focal length without unit": (edit(JOB, ('"1395.2 px"', "1395.2")), "instruments.camera.fx: 1395.2 is not a text"),
    "sigma in mm": (edit(JOB, ('"0.2 px"', '"0.2 mm"')), "'0.2 mm' is not of a camera; allowed are pixels"),
    "camera with a station": (
        edit(JOB, ('kind = "camera"', 'kind = "camera"\nstation = ["0 m", "0 m", "0 m"]')),
        'instruments.camera.station: has no effect with kind = "camera"',
    ),
    "pixels without a camera": (
        edit(JOB, ('instrument = "camera"\n', "")),
        "measurements[0].instrument: is missing; pixels need the camera",
    ),
    "pixels with a noise of their own": (
        edit(JOB, ('observes = "pixels"', 'observes = "pixels"\nsigma = "0.1 mm"')),
        "measurements[0].sigma: the noise of pixels is the camera's; leave it out, and give [instruments.camera]",
    ),
    "pixels with a noise of their own in px": (
        edit(JOB, ('observes = "pixels"', 'observes = "pixels"\nsigma = "0.2 px"')),
        "measurements[0].sigma: the noise of pixels is the camera's; leave it out, and give [instruments.camera]",
    ),
    "camera's sigma without a number": (
        edit(JOB, ('"0.2 px"', '"nan px"')),
        "instruments.camera.sigma: 'nan px' is not a number with a unit, like '0.2 px'.",
    ),
    "camera's sigma beyond all numbers": (
        edit(JOB, ('"0.2 px"', '"1e400 px"')),
        "instruments.camera.sigma: '1e400 px' is not a finite number.",
    ),
    "camera of positions": (edit(JOB, ('observes = "pixels"\n', "")), "a camera measures no position"),
    "model part in mm": (
        edit(JOB, ('observes = "pixels"', 'observes = "pixels"\nmodel_sigma = "0.1 mm"')),
        "measurements[0].model_sigma: '0.1 mm' does not fit what is observed; allowed are pixels",
    ),
    "tracker of pixels": (
        append(
            '[instruments.leica]\nkind = "laser_tracker"\nsigma = "1 um"\n',
            ('instrument = "camera"', 'instrument = "leica"'),
        ),
        "measurements[0].instrument: a laser tracker measures no pixels",
    ),
    "tracker with a lens": (
        append('[instruments.leica]\nkind = "laser_tracker"\nsigma = "1 um"\nk1 = 0.1\n'),
        'instruments.leica.k1: has no effect with kind = "laser_tracker"',
    ),
    "tool without orientation": (edit(JOB, ('tool = "pose"', 'tool = "position"')), 'is not known; write "pose"'),
    "prior of what is given": (
        edit(JOB, ('lens = "free"', 'lens = "given"\nlens_sigma = { fx = "2 px" }')),
        'instruments.camera.lens_sigma.fx: fx is not free; write lens = "free" or name it there',
    ),
    "prior of nothing": (
        edit(JOB, ('lens = "free"', 'lens = "free"\nlens_sigma = { k1 = 0 }')),
        "instruments.camera.lens_sigma.k1: 0 is out of range; allowed is 1e-09 to 1000.",
    ),
    "prior about nothing": (
        edit(
            JOB,
            ('lens = "free"', 'lens = "free"\nlens_sigma = { cx = "5 px" }'),
            *((f'{key} = "{value} px"\n', "") for key, value in LENS.items()),
            *((f"{key} = {value}\n", "") for key, value in BENT.items()),
        ),
        "instruments.camera.lens_sigma.cx: is about what is given, and fx, fy, cx, cy are not; leave it out.",
    ),
    "folded lens": (
        edit(JOB, ('lens = "free"', 'lens = "given"'), ("k1 = -0.1124", "k1 = -9.0")),
        "identification.csv:",
    ),
    "lens without size": (
        edit(
            JOB,
            ("size = [1280, 1024]\n", ""),
            *((f'{key} = "{value} px"\n', "") for key, value in LENS.items()),
            *((f"{key} = {value}\n", "") for key, value in BENT.items()),
        ),
        "instruments.camera.size: is missing, and no more is known of the lens; write that of its images",
    ),
    "lens bent and without focal lengths": (
        edit(JOB, *((f'{key} = "{value} px"\n', "") for key, value in LENS.items())),
        "instruments.camera.k1: has no effect without fx, fy, cx, cy",
    ),
    "lens twice": (
        edit(JOB, ("size = [1280, 1024]", 'lens_file = "lens.yaml"')),
        "instruments.camera.fx: is given by lens_file as well; keep one of them",
    ),
    "lens of a word": (edit(JOB, ('"free"', '"wide"')), '\'wide\' is not "given", "free" or a list of fx, fy, cx'),
    "lens of a number twice": (edit(JOB, ('"free"', '["fx", "fx"]')), "names a number twice"),
    "size of one number": (edit(JOB, ("[1280, 1024]", "[1280]")), "is not a list of two whole numbers, like [7, 5]"),
    "board that is not there": (
        edit(JOB, ('instrument = "camera"', 'instrument = "camera"\nboard = "board.toml"')),
        "board.toml: there is no such file",
    ),
    "column in mm": (edit("identification.csv", ("u [px]", "u [mm]")), "unit 'mm' is not a unit of pixel"),
    "normal of a board": (
        append("[targets.board]\nnormal = [0, 0, 1]\n"),
        "is given as a plane, and was measured as a frame",
    ),
}


@pytest.mark.parametrize("name", BROKEN)
def test_a_spoilt_case_is_refused_in_one_sentence(tmp_path: Path, name: str) -> None:
    for file in FILES:
        shutil.copyfile(CASE / file, tmp_path / file)
    for table in FILES[1:]:
        keep_rows(table, 90)(tmp_path)
    spoil, sentence = BROKEN[name]
    spoil(tmp_path)
    said = run("calibrate", tmp_path / JOB, "-o", tmp_path / "out")
    assert (said.code, said.out) == (1, "")
    assert sentence in said.err
    assert said.err.startswith("Error: ")
    assert said.err.count("\n") == 1
    assert not (tmp_path / "out").exists()


LENS_FILE = """{size}camera_matrix: [[1395.2, 0, 648.3], [0, 1393.8, 505.9], [0, 0, 1]]
distortion_coefficients: [-0.1124, 0.1387, 0.00031, -0.00047, -0.0312]
"""


def test_a_lens_file_may_leave_the_size_of_images_to_the_job(tmp_path: Path) -> None:
    for file in FILES:
        shutil.copyfile(CASE / file, tmp_path / file)
    numbers = [(f'{key} = "{value} px"\n', "") for key, value in LENS.items()]
    numbers += [(f"{key} = {value}\n", "") for key, value in BENT.items()]
    edit(JOB, ('kind = "camera"', 'kind = "camera"\nlens_file = "lens.yaml"'), *numbers)(tmp_path)
    for size in ("", "image_width: 1280\nimage_height: 1024\n"):
        (tmp_path / "lens.yaml").write_text(LENS_FILE.format(size=size))
        assert run("check", tmp_path / JOB).code == 0
    (tmp_path / "lens.yaml").write_text(LENS_FILE.format(size="image_width: 640\nimage_height: 512\n"))
    said = run("check", tmp_path / JOB)
    assert (said.code, said.out) == (1, "")
    assert "instruments.camera.size: is 1280 x 1024, and lens.yaml says 640 x 512; keep one of them." in said.err


def test_levels_work_without_a_base(tmp_path: Path) -> None:
    """Cameras alone know no base to fit anew after each level."""
    for file in FILES:
        shutil.copyfile(CASE / file, tmp_path / file)
    for table in FILES[1:]:
        keep_rows(table, 400)(tmp_path)
    append('[[levels]]\nname = "eye"\nfree = ["tool.*"]\n[[levels]]\nname = "all"\nfree = ["*"]\n')(tmp_path)
    said = run("calibrate", tmp_path / JOB, "-o", tmp_path / "out")
    assert (said.code, said.err) == (0, "")
    levels = json.loads((tmp_path / "out" / "result.json").read_text(encoding="utf-8"))["levels"]
    assert [(level["name"], level["free"], level["rank"]) for level in levels] == [("eye", 22, 22), ("all", 58, 39)]
    assert levels[1]["metrics"]["pixels"]["rms"] < 0.1 * levels[0]["metrics"]["pixels"]["rms"]


def test_photographs_are_planned_beside_those_of_the_case(tmp_path: Path) -> None:
    job, out = CASE / "calibration.toml", tmp_path / "next.csv"
    asked = ("plan", job, "--observes", "pixels", "-n", "4", "--candidates", "30", "-o", out)
    said = run(*asked, "--json")
    assert (said.code, said.err) == (0, "")
    told = json.loads(said.out)
    assert set(told["rejected"]) <= {
        "board not in the image",
        "board tilted too far",
        "board too near or too far",
        "outside the joints' limits",
        "touching itself",
    }
    with out.open(encoding="utf-8", newline="") as file:
        rows = list(csv.reader(file))
    assert (len(rows), len(rows[0])) == (5, 6)
    assert run(*asked[:-1], tmp_path / "again.csv").code == 0
    assert (tmp_path / "again.csv").read_bytes() == out.read_bytes()
    assert run("plan", job, "--observes", "pixels", "--tip", "tool0", "-o", tmp_path / "none.csv").code == 2
    arm = run("plan", "example:ur_description/urdf/ur5_robot.urdf", "--observes", "pixels", "-o", tmp_path / "none.csv")
    assert (arm.code, "photographs are planned beside those of a job" in arm.err) == (1, True)
    assert not (tmp_path / "none.csv").exists()
