"""From photographs to a calibrated arm by commands: board, import, calibrate; and photographs that are of no use."""

import csv
import json
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

cv2 = pytest.importorskip("cv2")

from calib.job.photographs import Imported, Photograph  # noqa: E402
from calib.job.read import read_board  # noqa: E402
from calib.robot.load import load_robot  # noqa: E402
from scripts.simulate import photographs as simulation  # noqa: E402
from tests.support.cases import run  # noqa: E402
from tests.support.photographs import small_session  # noqa: E402

UR5 = simulation.UR5
SEED, IMAGES = 3, 10
JOINTS = [f"{name}_joint" for name in ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")]


@pytest.fixture(scope="module")
def session() -> simulation.Session:
    return small_session(SEED, IMAGES)


@pytest.fixture(scope="module")
def rendered(session: simulation.Session, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("photographs")
    simulation.write(folder, session, SEED)
    return folder


@pytest.fixture
def folder(rendered: Path, tmp_path: Path) -> Path:
    shutil.copytree(rendered, tmp_path, dirs_exist_ok=True)
    return tmp_path


def imported(folder: Path, readings: str = "readings.csv", *more: str):
    return run(
        *("import", "images", folder / "photographs", "--board", folder / "board.toml"),
        *("--readings", folder / readings, "-o", folder / "marks.csv", *more),
    )


def test_two_commands_lead_from_photographs_to_a_calibrated_arm(folder: Path, session: simulation.Session) -> None:
    said = imported(folder, "readings.csv", "--robot", UR5)
    assert (said.code, said.err) == (0, "")
    assert f"corners of {IMAGES} of {IMAGES} photographs" in said.out.replace("\n", " ")
    page = (folder / "marks_photographs.html").read_text()
    assert page.count("<figure") == IMAGES and "<script" not in page
    with (folder / "marks.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert {float(row["sigma [px]"]) < 0.1 for row in rows} == {True}
    assert run("calibrate", folder / "marks.toml", "-o", folder / "out").code in (0, 3)
    result = json.loads((folder / "out" / "result.json").read_text())
    found = {one["name"]: (one["value"], one["sigma"]) for one in result["parameters"]}
    for name, true in (("fx", 452.0), ("cy", 177.0)):
        value, sigma = found[f"lens.{name}"]
        assert abs(value - true) < 4.0 * sigma
    value, sigma = found["board.scale"]
    assert abs(value - session.sheet.scale) < 3.0 * sigma
    assert result["metrics"]["validation"]["after"]["pixels"]["rms"] < 0.1
    assert [choice["chosen"] for choice in result["optics"]] == [1]
    said = run("verify", folder / "out", folder / "marks.csv")
    assert said.code == 1
    assert (
        "pixels of photographs are not verified; name this table in a [[measurements]] of the job, with use" in said.err
    )


def test_a_job_names_its_files_whatever_they_are_called(folder: Path) -> None:
    """Behind a link, and with a letter that JSON writes otherwise than TOML."""
    (folder / "far" / "away").mkdir(parents=True)
    (folder / "link").symlink_to(folder / "far" / "away")
    out = folder / "link" / "\U0001f916.csv"
    by = ("--board", folder / "board.toml", "--readings", folder / "readings.csv", "--robot", UR5)
    assert run("import", "images", folder / "photographs", *by, "-o", out, "-q") == (0, "", "")
    assert run("check", out.with_suffix(".toml"), "-q") == (0, "", "")


def test_poses_of_the_flange_alone_give_hand_eye(folder: Path, session: simulation.Session) -> None:
    assert imported(folder, "flange.csv").code == 0
    assert 'placements = "none"' in (folder / "marks.toml").read_text()
    assert run("calibrate", folder / "marks.toml", "-o", folder / "out").code in (0, 3)
    result = json.loads((folder / "out" / "result.json").read_text())
    np.testing.assert_allclose(result["tools"]["tool"]["position"], session.camera[:3, 3], atol=3e-4)
    found = {one["name"]: one for one in result["parameters"]}
    # The flange's motion is the ruler: the scale of the print shows.
    assert found["board.scale"]["value"] == pytest.approx(session.sheet.scale, abs=5e-4)


def test_a_place_of_the_flange_that_was_mistyped_is_named(tmp_path: Path) -> None:
    """What strays is measured by how far the flange goes, not by how far the axes go that stand for it."""
    simulation.write(tmp_path, small_session(SEED, 18), SEED)
    rows = list(csv.reader((tmp_path / "flange.csv").open()))
    rows[2][1] = f"{float(rows[2][1]) + 200.0:.9f}"
    with (tmp_path / "flange.csv").open("w", newline="") as file:
        csv.writer(file).writerows(rows)
    assert imported(tmp_path, "flange.csv").code == 0
    said = run("check", tmp_path / "marks.toml").out.replace("\n", " ")
    found = re.search(r"photographs are off from where all others put them: 'image_001.png' by (\d+) mm", said)
    assert found is not None, said
    assert 190 < int(found[1]) < 210


def test_poses_of_the_flange_and_a_urdf_give_readings(folder: Path, session: simulation.Session) -> None:
    """A nominal arm whose controller states the pose has these readings, or those of another configuration."""
    nominal = [session.arm.tip(q, nominal=True) for q in session.readings]
    rows = list(csv.reader((folder / "flange.csv").open()))
    for row, T in zip(rows[1:], nominal, strict=True):
        x, y, z, w = simulation.Rotation.from_matrix(T[:3, :3]).as_quat()
        row[1:] = [f"{v:.9f}" for v in (*(1e3 * T[:3, 3]), w, x, y, z)]
    with (folder / "flange.csv").open("w", newline="") as file:
        csv.writer(file).writerows(rows)
    said = imported(folder, "flange.csv", "--robot", UR5, "--tip", "tool0", "--json")
    assert said.code == 0
    assert "readings are those with which the robot of the URDF is there" in json.loads(said.out)["remarks"][0]
    with (folder / "marks.csv").open() as file:
        by_image = {row["group"]: [float(row[f"{n} [rad]"]) for n in session.arm.names] for row in csv.DictReader(file)}
    for name, T in zip((row[0] for row in rows[1:]), nominal, strict=True):
        np.testing.assert_allclose(session.arm.tip(np.array(by_image[name]), nominal=True), T, atol=1e-6)


def test_photographs_of_no_use_are_named_and_left_out(folder: Path) -> None:
    photographs = folder / "photographs"
    image = cv2.imread(str(photographs / "image_001.png"), 0)
    cv2.imwrite(str(photographs / "image_001.png"), cv2.GaussianBlur(image, (0, 0), 5.0))
    cv2.imwrite(str(photographs / "image_002.png"), np.full_like(image, 128))
    cv2.imwrite(str(photographs / "image_003.png"), cv2.resize(image, (1280, 720)))
    (photographs / "image_004.png").write_bytes(b"no image")
    shutil.copyfile(photographs / "image_000.png", photographs / "other.png")
    (photographs / "image_005.png").unlink()
    two = cv2.imread(str(photographs / "image_006.png"), 0)
    cv2.imwrite(str(photographs / "image_006.png"), np.hstack([two, two]))
    said = imported(folder, "readings.csv", "--json")
    assert said.code == 0
    told = json.loads(said.out)
    why = {one["image"]: one["why"] for one in told["left_out"]}
    assert re.fullmatch(r"is blurred over .* px, and 4 are allowed|no board is found|only .*", why["image_001.png"])
    assert why["image_002.png"] == "no board is found"
    assert why["image_003.png"] == "has 1280 x 720 pixels, and most have 640 x 360"
    assert why["image_004.png"] == "is not an image that is read: PNG, JPEG, BMP, TIFF, PGM or WebP"
    assert why["other.png"] == "has no row in the readings"
    assert why["image_006.png"].startswith(
        "markers of the board are seen twice; of boards in one photograph each needs"
    )
    assert any("there is no photograph 'image_005.png'" in remark for remark in told["remarks"])


def test_odd_names_and_both_joints_and_poses(folder: Path, session: simulation.Session) -> None:
    """Names with blanks, dots and capitals; joints in degrees beside poses of the flange, of which joints are taken."""
    odd = ["a b.PNG", "ü.1.png", "IMAGE-3.Png", "04.png"]
    for k, name in enumerate(odd):
        (folder / "photographs" / f"image_{k:03d}.png").rename(folder / "photographs" / name)
    shutil.copyfile(folder / "photographs" / "04.png", folder / "photographs" / "04.bmp")
    joints, flange = (list(csv.reader((folder / f"{name}.csv").open())) for name in ("readings", "flange"))
    written = [f"photographs\\{odd[0]}", f"./photographs/{odd[1]}", odd[2], "04"]
    rows = [["image", *(f"{name} [deg]" for name in session.arm.names), *flange[0][1:]]]
    for k, (row, pose) in enumerate(zip(joints[1:], flange[1:], strict=True)):
        name = written[k] if k < 4 else row[0]
        rows.append([name, *(f"{np.rad2deg(float(v)):.7f}" for v in row[1:]), *pose[1:]])
    with (folder / "both.csv").open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows(rows)
    said = imported(folder, "both.csv", "--robot", UR5, "--tip", "tool0", "--json")
    assert (said.code, said.err) == (0, "")
    told = json.loads(said.out)
    assert told["used"] == IMAGES
    assert told["left_out"] == [{"image": "04.png", "why": "has the readings of 04.bmp"}]
    assert "its poses of the flange are not needed" in told["remarks"][0]
    with (folder / "marks.csv").open(encoding="utf-8") as file:
        table = list(csv.DictReader(file))
    assert [name for name in table[0] if name.startswith("q") or name in ("x [mm]", "y [mm]")] == []
    first = next(row for row in table if row["group"] == odd[0])
    read = [float(first[f"{name} [deg]"]) for name in session.arm.names]
    np.testing.assert_allclose(np.deg2rad(read), session.readings[0], atol=1e-8)


@pytest.mark.parametrize("orientation", ["rotation_vector", "rpy", "ZYX", "matrix"])
def test_the_flange_in_other_conventions_is_the_same_pose(folder: Path, orientation: str) -> None:
    rows = list(csv.reader((folder / "flange.csv").open()))
    titles = [f"r{i}{j}" for i in "123" for j in "123"] if orientation == "matrix" else ["rx", "ry", "rz"]
    unit = "" if orientation == "matrix" else " [deg]"
    out = [["image", "x [m]", "y [m]", "z [m]", *(title + unit for title in titles)]]
    for name, x, y, z, qw, qx, qy, qz in rows[1:]:
        turn = simulation.Rotation.from_quat([float(v) for v in (qx, qy, qz, qw)])
        if orientation == "matrix":
            numbers = turn.as_matrix().ravel()
        elif orientation == "rotation_vector":
            numbers = np.rad2deg(turn.as_rotvec())
        else:
            numbers = turn.as_euler("xyz" if orientation == "rpy" else orientation, degrees=True)
        out.append([name, *(f"{1e-3 * float(v):.12f}" for v in (x, y, z)), *(f"{v:.12f}" for v in numbers)])
    with (folder / "other.csv").open("w", newline="") as file:
        csv.writer(file).writerows(out)
    assert imported(folder, "flange.csv").code == 0
    first = list(csv.DictReader((folder / "marks.csv").open()))
    for file in folder.glob("marks*"):
        file.unlink()
    said = imported(folder, "other.csv", "--orientation", orientation)
    assert (said.code, said.err) == (0, "")
    again = list(csv.DictReader((folder / "marks.csv").open()))
    for a, b in zip(first[::24], again[::24], strict=True):
        for name in a:
            if name.startswith("flange"):
                assert float(a[name]) == pytest.approx(float(b[name]), abs=2e-8)


@pytest.mark.parametrize("called", ["r{}{}", "T_{}_{}"])
def test_matrices_of_the_flange_need_no_word(folder: Path, called: str) -> None:
    """As other programs call their cells; the last row says nothing."""
    titles, rows = "", []
    first, size = (1, 3) if called.startswith("r") else (0, 4)
    for image, p, R in turned(folder):
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = R.as_matrix(), p
        rows.append([image, *T[:size, :size].ravel(), *(p if size == 3 else ())])
    for i, j in np.ndindex(size, size):
        titles += called.format(i + first, j + first) + ("[mm] " if size == 4 and j == 3 and i < 3 else " ")
    table = written(folder, titles + ("x[mm] y[mm] z[mm]" if size == 3 else ""), rows)
    seen = []
    for readings in ("flange.csv", table):
        assert imported(folder, readings).code == 0
        seen.append([float(row["flange_rx [rad]"]) for row in csv.DictReader((folder / "marks.csv").open())])
        for file in folder.glob("marks*"):
            file.unlink()
    np.testing.assert_allclose(*seen, atol=1e-8)


def test_where_no_robot_is_named_no_job_is_written_and_this_is_said(folder: Path) -> None:
    said = imported(folder)
    assert said.code == 0
    assert not (folder / "marks.toml").exists()
    assert "No job is written, as no arm is named (--robot)." in said.out


def turned(folder: Path) -> list[tuple[str, np.ndarray, simulation.Rotation]]:
    """Return images, places in mm and rotations of the flange as they are."""
    rows = list(csv.reader((folder / "flange.csv").open()))[1:]
    numbers = [np.array(list(map(float, row[1:]))) for row in rows]
    return [
        (row[0], n[:3], simulation.Rotation.from_quat(n[[4, 5, 6, 3]])) for row, n in zip(rows, numbers, strict=True)
    ]


def written(folder: Path, titles: str, rows: list[list[object]]) -> str:
    with (folder / "other.csv").open("w", newline="") as file:
        csv.writer(file).writerows([["image", *titles.split()], *rows])
    return "other.csv"


def degrees(folder: Path, convention: str) -> str:
    rows = [
        [image, *p, *(R.as_rotvec(degrees=True) if convention == "" else R.as_euler(convention, degrees=True))]
        for image, p, R in turned(folder)
    ]
    return written(folder, "x[mm] y[mm] z[mm] rx[deg] ry[deg] rz[deg]", rows)


@pytest.mark.parametrize("convention", ["", "xyz", "ZYZ"])
def test_photographs_tell_what_three_angles_are(folder: Path, convention: str) -> None:
    assert imported(folder, "flange.csv").code == 0
    first = list(csv.DictReader((folder / "marks.csv").open()))
    for file in folder.glob("marks*"):
        file.unlink()
    said = imported(folder, degrees(folder, convention), "--json")
    assert (said.code, said.err) == (0, "")
    assert f"rx, ry, rz are {convention or 'rotation_vector'!r}" in json.loads(said.out)["remarks"][1]
    again = list(csv.DictReader((folder / "marks.csv").open()))
    for a, b in zip(first[::24], again[::24], strict=True):
        for name in a:
            if name.startswith("flange"):
                assert float(a[name]) == pytest.approx(float(b[name]), abs=1e-6)


def test_photographs_of_no_turn_do_not_tell_what_three_angles_are(folder: Path) -> None:
    """Nor do they where there are too few."""
    for file in sorted((folder / "photographs").iterdir())[4:]:
        file.unlink()
    said = imported(folder, degrees(folder, "xyz"))
    assert said.code == 1
    assert "rx, ry, rz do not say in which order and about which axes they turn" in said.err


def quaternion(folder: Path, order: list[int], *, unit: str = "mm", inverse: bool = False, by: int = 0) -> str:
    rows: list[list[object]] = []
    for image, p, R in turned(folder):
        q, place = (R.inv() if inverse else R).as_quat(), -R.inv().apply(p) if inverse else p
        rows.append([image, *place, *q[order]])
    rows = [[rows[(k + by) % len(rows)][0], *row[1:]] for k, row in enumerate(rows)]
    return written(folder, f"x[{unit}] y[{unit}] z[{unit}] qw qx qy qz", rows)


def by_letters(folder: Path) -> str:
    """Photographs 1 to 10, and a row for each in the order of letters, with the poses in that of numbers."""
    for k, file in enumerate(sorted((folder / "photographs").iterdir())):
        file.rename(file.with_name(f"{k + 1}.png"))
    names = sorted(f"{k + 1}.png" for k in range(IMAGES))
    rows = [[name, *p, *R.as_quat()[[3, 0, 1, 2]]] for name, (_, p, R) in zip(names, turned(folder), strict=True)]
    return written(folder, "x[mm] y[mm] z[mm] qw qx qy qz", rows)


WXYZ = [3, 0, 1, 2]


@pytest.mark.parametrize(
    ("wrong", "more", "says"),
    [
        (lambda folder: degrees(folder, "xyz"), ("--orientation", "XYZ"), "rx, ry, rz were 'xyz'"),
        (lambda folder: degrees(folder, ""), ("--orientation", "rpy"), "rx, ry, rz were 'rotation_vector'"),
        (lambda folder: quaternion(folder, [0, 1, 2, 3]), (), "qw, qx, qy, qz hold x, y, z, w"),
        (lambda folder: quaternion(folder, WXYZ, unit="m"), (), "millimetres stand under [m] in x, y, z"),
        (lambda folder: quaternion(folder, WXYZ, inverse=True), (), "the poses are those of the base in the flange"),
        (lambda folder: quaternion(folder, WXYZ, by=1), (), "each row is of the photograph before its own"),
        (lambda folder: "flange.csv", ("--camera-on", "floor"), "the camera is on the flange"),
        (by_letters, (), "images stand in the order of letters (1, 10, 2), and poses in that of numbers (1, 2, 10)"),
    ],
)
def test_photographs_tell_what_is_wrong_with_poses_of_the_flange(folder: Path, wrong, more, says: str) -> None:
    code, out, err = imported(folder, wrong(folder), *more)
    assert (code, out, err.count("\n")) == (1, "", 1)
    assert f"it looks as if {says}" in err or says in err
    assert "half of the photographs are off by" in err
    assert not list(folder.glob("marks*"))


def test_a_board_as_opencv_drew_it_before_is_found(tmp_path: Path) -> None:
    """Of an even number of rows, with a white square first: its corners are at the same places as they would be."""
    drawn = cv2.aruco.CharucoBoard((7, 6), 0.03, 0.022, cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50))
    drawn.setLegacyPattern(True)
    image = cv2.copyMakeBorder(drawn.generateImage((420, 360)), 90, 90, 90, 90, cv2.BORDER_CONSTANT, value=255)
    (tmp_path / "photographs").mkdir()
    views = [np.array([[1.0, 0.1 * k, 5.0], [-0.1 * k, 0.9, 60.0], [1e-4 * k, 2e-4, 1.0]]) for k in range(3)]
    for k, H in enumerate(views):
        seen = cv2.GaussianBlur(cv2.warpPerspective(image, H, (640, 600), borderValue=255), (0, 0), 0.7)
        cv2.imwrite(str(tmp_path / "photographs" / f"{k}.png"), seen)
    (tmp_path / "readings.csv").write_text("image,a [rad]\n0.png,0\n1.png,1\n2.png,2\n")
    board = 'kind = "charuco"\nsquares = [7, 6]\nsquare = "30 mm"\nmarker = "22 mm"\ndictionary = "DICT_4X4_50"\n'
    (tmp_path / "board.toml").write_text(board)
    said = imported(tmp_path, "readings.csv", "--json")
    assert said.code == 0, said.err
    assert any("as OpenCV before 4.6 drew" in remark for remark in json.loads(said.out)["remarks"])
    with (tmp_path / "marks.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) > 80
    for row in rows:
        place = np.array([float(row["board_x [mm]"]), float(row["board_y [mm]"])])
        x, y, w = views[int(row["group"][0])] @ np.append(90.0 + 2.0 * place - 0.5, 1.0)
        assert np.hypot(float(row["u [px]"]) - x / w, float(row["v [px]"]) - y / w) < 0.5


def spoil(name: str, *change: tuple[str, str]):
    def apply(folder: Path) -> None:
        text = (folder / name).read_text()
        for old, new in change:
            assert old in text
            text = text.replace(old, new)
        (folder / name).write_text(text)

    return apply


def emptied(folder: Path) -> None:
    for file in (folder / "photographs").iterdir():
        file.unlink()


def two_left(folder: Path) -> None:
    for file in sorted((folder / "photographs").iterdir())[2:]:
        file.unlink()


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        (spoil("readings.csv", ("image,", "picture,")), "there is no column 'image'; the columns are 'picture'"),
        (spoil("readings.csv", ("image_001", "image_000")), "the image 'image_000.png' has two rows"),
        (spoil("board.toml", ("charuco", "circles")), "kind: 'circles' is not allowed"),
        (spoil("board.toml", ("DICT_4X4_50", "DICT_4")), "board.toml: dictionary: 'DICT_4' is none of OpenCV's"),
        (spoil("board.toml", ("[7, 5]", "[7, 5.5]")), "squares: [7, 5.5] is not a list of two whole numbers"),
        (spoil("board.toml", ("30 mm", "30 m")), "square: '30 m' is out of range; allowed is 0.0001 to 10 m"),
        (spoil("board.toml", ("22 mm", "30 mm")), "has no white around it in a square of 0.03 m"),
        (spoil("board.toml", ("squares", "square_count")), "square_count: is not a known key"),
        (emptied, "holds no photographs; they end with .png"),
        (two_left, "2 of 2 photographs can be used, and 3 are the fewest that tell anything"),
        (lambda folder: shutil.rmtree(folder / "photographs"), "cannot be read (No such file or directory)"),
    ],
)
def test_one_sentence_and_nothing_written(folder: Path, wrong, says: str) -> None:
    wrong(folder)
    before = sorted(folder.iterdir())
    code, out, err = imported(folder)
    assert (code, out, err.count("\n")) == (1, "", 1)
    assert says in err
    assert sorted(folder.iterdir()) == before


def test_a_table_that_is_called_as_its_job_is_refused(folder: Path) -> None:
    """The job took its place, and named itself as the table."""
    out = folder / "marks.toml"
    said = run(
        *("import", "images", folder / "photographs", "--board", folder / "board.toml"),
        *("--readings", folder / "readings.csv", "--robot", UR5, "-o", out),
    )
    assert said.code == 1
    assert "is the name of the job that is written beside the table; call the table marks.csv." in said.err
    assert not out.exists()


def test_readings_without_a_unit_are_told_before_the_photographs_are_searched(folder: Path) -> None:
    """Else the table of pixels has them, and the job that is written beside it does not read it."""
    spoil("readings.csv", (" [rad]", ""))(folder)
    code, out, err = imported(folder, "readings.csv", "--robot", UR5)
    assert (code, out) == (1, "")
    assert "readings.csv: columns 'shoulder_pan_joint', " in err and "have no unit; write one in brackets" in err
    assert not (folder / "marks.csv").exists()


def widened(file: Path, titles: str, cells: str) -> None:
    """Write further columns into a table, the same cells in each row."""
    head, *rows = file.read_text().splitlines()
    file.write_text("\n".join([f"{head},{titles}", *(f"{row},{cells}" for row in rows), ""]))


def test_columns_that_no_job_reads_are_left_out_of_the_table_of_pixels(folder: Path) -> None:
    widened(folder / "readings.csv", "note,width [mm]", "warm,12")
    said = imported(folder, "readings.csv", "--robot", UR5)
    assert "has readings of the joints; 'note', 'width [mm]' are not read." in said.out.replace("\n", " ")
    with (folder / "marks.csv").open() as file:
        assert not {"note", "width [mm]"} & set(next(csv.reader(file)))
    assert run("check", folder / "marks.toml").code == 0


def test_columns_that_the_table_of_pixels_has_itself_are_left_out(folder: Path) -> None:
    """Else the job beside it found two columns of a name."""
    widened(folder / "readings.csv", "group,sigma [mm],u [px]", "a,0.1,7")
    said = imported(folder, "readings.csv", "--robot", UR5)
    assert "'group', 'sigma [mm]', 'u [px]' are not read." in said.out.replace("\n", " ")
    assert run("check", folder / "marks.toml").code == 0


def of_numbers(folder: Path) -> None:
    text = (folder / "readings.csv").read_text()
    for k, joint in enumerate(JOINTS):
        text = text.replace(f"{joint} [rad]", f"q{k + 1} [rad]")
    (folder / "readings.csv").write_text(text)


def emptied_cell(folder: Path) -> None:
    lines = (folder / "readings.csv").read_text().splitlines()
    lines[3] = ",".join(["image_002.png", "", *lines[3].split(",")[2:]])
    (folder / "readings.csv").write_text("\n".join(lines) + "\n")


def said_twice(folder: Path) -> None:
    lines = (folder / "readings.csv").read_text().splitlines()
    (folder / "readings.csv").write_text("\n".join(f"{line},{line.split(',')[1]}" for line in lines) + "\n")


def of_two_matrices(folder: Path) -> None:
    titles = " ".join(f"{called}_{i}_{j}" for called in ("flange", "board") for i, j in np.ndindex(3, 4))
    rows = [[image, *np.eye(3, 4).ravel(), *np.eye(3, 4).ravel()] for image, _, _ in turned(folder)]
    written(folder, titles, rows)
    (folder / "other.csv").replace(folder / "readings.csv")


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        (of_numbers, "there is no column 'shoulder_pan_joint', 'shoulder_lift_joint', "),
        (of_two_matrices, "and no pose of the flange is found in each row; the columns are 'image', 'flange_0_0', "),
        (emptied_cell, "readings.csv: the row of 'image_002.png': column 'shoulder_pan_joint': '' is not a number."),
        (said_twice, "readings.csv: column 'shoulder_pan_joint' appears more than once."),
    ],
)
def test_readings_that_no_job_could_read_are_told_before_photographs_are_searched(folder: Path, wrong, says) -> None:
    """Readings of no joint of the robot were taken for such, and the job beside the table of pixels was of no use."""
    wrong(folder)
    code, out, err = imported(folder, "readings.csv", "--robot", UR5)
    assert (code, out) == (1, "")
    assert says in err.replace("\n", " ")
    assert not (folder / "marks.csv").exists()


def test_what_stands_beside_poses_of_the_flange_is_not_read_and_named(folder: Path) -> None:
    widened(folder / "flange.csv", "note,speed", "warm,12")
    said = imported(folder, "flange.csv", "--robot", UR5)
    assert (said.code, said.err) == (0, "")
    assert "flange.csv:'note','speed'arenotread." in "".join(said.out.split())


@pytest.mark.parametrize(
    ("of_place", "of_rotation", "says"),
    [
        ("", "", "'T_0_3', 'T_1_3', 'T_2_3' have no unit; write one in brackets, like 'T_0_3 [mm]'."),
        ("[mm]", "[mm]", "column 'T_0_0[mm]' is of a rotation, and has no unit."),
    ],
)
def test_units_of_a_matrix_are_told_by_the_names_of_its_cells(folder: Path, of_place, of_rotation, says) -> None:
    titles = " ".join(f"T_{i}_{j}{of_place if j == 3 else of_rotation}" for i, j in np.ndindex(3, 4))
    table = written(folder, titles, [[image, *np.eye(3, 4).ravel()] for image, _, _ in turned(folder)])
    said = imported(folder, table)
    assert said.code == 1
    assert says in said.err.replace("\n", " ")


def test_a_pose_that_the_arm_does_not_reach_is_named(folder: Path) -> None:
    text = (folder / "flange.csv").read_text().splitlines()
    cells = text[2].split(",")
    text[2] = ",".join([cells[0], "5000", *cells[2:]])
    (folder / "flange.csv").write_text("\n".join(text) + "\n")
    said = imported(folder, "flange.csv", "--robot", UR5, "--tip", "tool0")
    assert said.code == 1
    assert "the robot does not reach the pose of 'image_001.png'" in said.err


def test_a_board_is_written_as_it_is_read(tmp_path: Path) -> None:
    out = tmp_path / "board"
    assert run("board", "-o", out, "--squares", "9x6", "--square", "1 inch", "--marker", "18 mm").code == 0
    assert sorted(file.name for file in out.iterdir()) == ["board.pdf", "board.svg", "board.toml"]
    print_ = read_board(out / "board.toml")
    assert (print_.squares, print_.square, print_.marker) == ((9, 6), pytest.approx(0.0254), pytest.approx(0.018))
    assert (print_.square_sigma, print_.shape) == (0.005, "auto")
    pdf = (out / "board.pdf").read_bytes()
    width = float(re.search(rb"MediaBox \[0 0 ([\d.]+) ", pdf)[1])
    # 9 x 6 inches and white: 72 points an inch.
    assert width == pytest.approx(9 * 72 + 20 / 25.4 * 72, abs=0.01)
    assert pdf.startswith(b"%PDF-1.4") and pdf.endswith(b"%%EOF\n")
    start = int(re.search(rb"startxref\n(\d+)", pdf)[1])
    assert pdf[start : start + 4] == b"xref"


def test_what_is_drawn_is_what_opencv_draws(tmp_path: Path) -> None:
    out = tmp_path / "board"
    assert run("board", "-o", out).code == 0
    svg = (out / "board.svg").read_text()
    drawn = np.full((5 * 60 + 40, 7 * 60 + 40), 255, dtype=np.uint8)
    boxes = re.findall(r"M([\d.]+) ([\d.]+)h([\d.]+)v([\d.]+)h", svg)
    y, x = (np.indices(drawn.shape) + 0.5) / 2.0
    for left, top, width, height in (map(float, box) for box in boxes):
        if top + height < 161.0:  # above the ruler
            drawn[(x > left) & (x < left + width) & (y > top) & (y < top + height)] = 0
    of = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    theirs = cv2.aruco.CharucoBoard((7, 5), 0.03, 0.022, of).generateImage((420, 300))
    assert np.mean(drawn[20:320, 20:440] != theirs) < 0.02


def test_a_chessboard_needs_no_opencv(tmp_path: Path) -> None:
    out = tmp_path / "board"
    assert run("board", "-o", out, "--kind", "chessboard").code == 0
    assert (out / "board.svg").read_text().count("h30v30h") == 20


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("--squares", ""), "--squares: '' is not two whole numbers below 1000, like 7x5"),
        (("--squares", "7"), "--squares: '7' is not two whole numbers below 1000, like 7x5"),
        (("--square", "30"), "--square: '30' has no unit"),
        (("--kind", "circles"), "--kind: 'circles' is not charuco or chessboard"),
        (("--kind", "chessboard", "--squares", "7x5"), "of 7 x 5 squares looks the same upside down"),
        (("--squares", "12x12"), "need 72 markers, and DICT_4X4_50 has 50"),
    ],
)
def test_boards_that_cannot_be_are_refused(tmp_path: Path, arguments: tuple[str, ...], says: str) -> None:
    said = run("board", "-o", tmp_path / "board", *arguments)
    assert (said.code, says in said.err) == (1, True), said.err
    assert not (tmp_path / "board").exists()


def test_a_board_below_a_file_is_refused_as_other_results_are(tmp_path: Path) -> None:
    file = tmp_path / "notes.txt"
    file.write_text("mine")
    said = run("board", "-o", file / "board", "--kind", "chessboard", "--squares", "8x5")
    assert (said.code, " ".join(said.err.split())) == (
        1,
        f"Error: {file / 'board'}: cannot be made, as {file} is a file.",
    )
    assert file.read_text() == "mine"


@pytest.mark.parametrize(("count", "prior"), [(10, '"1 mm", angle = "1 mrad"'), (11, '"learned", angle = "learned"')])
def test_photographs_teach_how_well_an_arm_is_made_where_they_are_enough(count: int, prior: str) -> None:
    """One that is left out teaches nothing."""
    size: tuple[int, int] = (640, 360)
    nothing: Any = None
    photographs = [Photograph(f"{k}.png", size, nothing, "", b"") for k in range(count)]
    photographs.append(Photograph("dark.png", size, nothing, "no board is seen", b""))
    arm = load_robot(UR5, "tool0")
    job = Imported(tuple(photographs), size, (), {}, nothing, (), arm).job(UR5, "marks.csv", "b.toml", camera_on="tip")
    assert f"prior = {{ length = {prior} }}" in job


def test_a_board_of_two_tables_and_learned_priors_is_assessed(folder: Path, session: simulation.Session) -> None:
    """Its place is an unknown of both, and no block: what rows are in m, and no pixel is, was a traceback."""
    columns = simulation.corners_seen(session, 0.05, np.random.default_rng(1))
    rows = list(zip(*columns.values(), strict=True))
    for name, own in (("a.csv", rows[: len(rows) // 2]), ("b.csv", rows[len(rows) // 2 :])):
        with (folder / name).open("w", newline="") as file:
            csv.writer(file).writerows([list(columns), *own])
    lens = session.lens
    tables = "".join(
        f'[[measurements]]\nfile = "{name}"\nobserves = "pixels"\ninstrument = "eye"\n' for name in ("a.csv", "b.csv")
    )
    (folder / "two.toml").write_text(
        f'schema = 1\n[robot]\nurdf = "{UR5}"\ntip = "tool0"\n'
        '[error_model]\noffsets = "all"\nplacements = "all"\nbase = "fixed"\ntool = "pose"\n'
        'prior = { length = "learned", angle = "learned" }\n'
        '[instruments.eye]\nkind = "camera"\ncamera_on = "tip"\nlens = "given"\n'
        f'fx = "{lens.fx} px"\nfy = "{lens.fy} px"\ncx = "{lens.cx} px"\ncy = "{lens.cy} px"\n'
        f"size = [{lens.size[0]}, {lens.size[1]}]\n"
        + "".join(f"{name} = {value}\n" for name, value in zip(("k1", "k2", "p1", "p2", "k3"), lens.k, strict=True))
        + tables
    )
    assert run("calibrate", folder / "two.toml", "-o", folder / "out").code in (0, 3)
    assert (folder / "out" / "result.json").exists()
