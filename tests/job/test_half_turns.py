"""Chessboards that look the same upside down: readings tell which way up each photograph has them, or it is said."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.job.flange_poses import Seen, _off, way_up
from calib.job.half_turns import half_turns
from calib.measurement.prints import Print
from scripts.simulate import photographs as simulation
from tests.support.cases import run
from tests.support.photographs import small_session

Array = simulation.Array
PRINT = Print("chessboard", (8, 6), 0.026)
ACROSS, DOWN = 7, 5
SIZE, FOCAL = (640, 480), 600.0
HALF = np.diag([-1.0, -1.0, 1.0, 1.0])
pose = simulation.pose


def before_camera(rng: np.random.Generator, n: int, tilt: float = 30.0, turns: Array | None = None) -> Array:
    """Poses (n, 4, 4) of the middle of a board before a camera."""
    found = []
    for k in range(n):
        way, turn = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(-180.0, 180.0) if turns is None else turns[k]
        tilted = Rotation.from_rotvec(
            np.radians(rng.uniform(0.3, 1.0) * tilt) * np.array([np.cos(way), np.sin(way), 0])
        )
        place = np.array([*rng.uniform(-0.02, 0.02, 2), rng.uniform(0.35, 0.5)])
        found.append(pose(place, (tilted * Rotation.from_euler("z", turn, degrees=True)).as_rotvec()))
    return np.array(found)


def flanges(rng: np.random.Generator, boards: Array, camera_on: str) -> Array:
    """Where the flange is (n, 4, 4), of a camera or a board anywhere on it."""
    on, beside = pose(rng.normal(scale=0.1, size=3), rng.normal(size=3)), pose(rng.normal(size=3), rng.normal(size=3))
    return np.array([beside @ (np.linalg.inv(T) if camera_on == "tip" else T) @ on for T in boards])


def off(rng: np.random.Generator, poses: Array) -> Array:
    """Poses that are off by 0.5 deg about each axis."""
    return np.array([T @ pose(np.zeros(3), np.radians(0.5) * rng.normal(size=3)) for T in poses])


@pytest.mark.parametrize("camera_on", ["tip", "floor"])
@pytest.mark.parametrize("count", [8, 150])
def test_pairs_tell_which_way_up_a_board_is(camera_on: str, count: int) -> None:
    rng = np.random.default_rng(1)
    boards = before_camera(rng, count)
    tips = flanges(rng, boards, camera_on)
    halves = rng.random(count) < 0.5
    seen = off(rng, np.where(halves[:, None, None], boards @ HALF, boards))
    tips[5] = tips[5] @ pose(np.zeros(3), np.array([0.3, 1.1, -0.4]))
    found = half_turns(seen, tips)
    others = np.arange(count) != 5
    assert found.told[others].all() and not found.told[5] and found.contradict[5]
    apart = (found.turned ^ halves)[others]
    assert apart.all() or not apart.any()


def test_quarter_turns_about_the_normal_tell_nothing() -> None:
    """Five photographs are turned by nothing and three by a quarter: how these are to those, nobody knows."""
    rng = np.random.default_rng(2)
    boards = before_camera(rng, 8, 0.0, np.array([0.0, 90.0, 0.0, 0.0, 90.0, 0.0, 0.0, 90.0]))
    tips = flanges(rng, boards, "tip")
    boards[2] = boards[2] @ HALF
    found = half_turns(boards, tips)
    assert found.told.tolist() == [True, False, True, True, False, True, True, False]
    assert found.turned[found.told].tolist() in ([False, True, False, False, False], [True, False, True, True, True])
    assert not found.contradict.any()


def test_readings_of_other_photographs_tell_nothing() -> None:
    half_turn = PRINT.half_turn
    assert half_turn is not None
    for seed in range(20):
        rng = np.random.default_rng([seed, 3])
        boards = before_camera(rng, 8)
        seen = Seen(boards @ pose(-0.5 * half_turn[:3, 3], np.zeros(3)), np.arange(8), half_turn)
        assert way_up(seen, np.roll(flanges(rng, boards, "tip"), 1, axis=0)) is None


def photograph(T: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """The photograph of a board whose middle is at T in the camera, and where its corners truly are (n, 2)."""
    import cv2

    fine, (across, down) = 24, PRINT.squares
    cells = np.pad(170.0 * (np.indices((down, across)).sum(axis=0) % 2) + 35.0, 1, constant_values=205.0)
    K = np.array([[FOCAL, 0.0, 319.5], [0.0, FOCAL, 239.5], [0.0, 0.0, 1.0]])
    # From drawn pixels, the middle of the first one at 0, 0, to places about the middle of the board.
    a, x, y = PRINT.square / fine, 0.5 * (across + 2) * fine - 0.5, 0.5 * (down + 2) * fine - 0.5
    drawn = np.array([[a, 0.0, -a * x], [0.0, a, -a * y], [0.0, 0.0, 1.0]])
    seen = cv2.warpPerspective(
        np.kron(cells, np.ones((fine, fine))),
        K @ T[:3, [0, 1, 3]] @ drawn,
        SIZE,
        flags=cv2.INTER_AREA,
        borderValue=120.0,
    )
    noisy = cv2.GaussianBlur(seen, (0, 0), 0.8) + rng.normal(scale=2.0, size=seen.shape)
    places = PRINT.marks - 0.5 * PRINT.square * np.array([*PRINT.squares, 0.0])
    at = (places @ T[:3, :3].T + T[:3, 3]) @ K.T
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8), at[:, :2] / at[:, 2:]


def write(folder: Path, boards: Array, tips: Array, squares: tuple[int, int] = PRINT.squares) -> list[Array]:
    """Write photographs, board.toml and flange.csv; return where corners are in each."""
    import cv2

    rng, true = np.random.default_rng(4), []
    (folder / "photographs").mkdir()
    (folder / "board.toml").write_text(
        f'kind = "chessboard"\nsquares = [{squares[0]}, {squares[1]}]\nsquare = "26 mm"\n'
    )
    rows: list[list[object]] = [["image", "x [mm]", "y [mm]", "z [mm]", "qw", "qx", "qy", "qz"]]
    for k, (T, F) in enumerate(zip(boards, tips, strict=True)):
        image, corners = photograph(T, rng)
        true.append(corners)
        cv2.imwrite(str(folder / "photographs" / f"{k}.png"), image)
        q = Rotation.from_matrix(F[:3, :3]).as_quat()[[3, 0, 1, 2]]
        rows.append([f"{k}.png", *(1e3 * F[:3, 3]), *q])
    write_rows(folder / "flange.csv", rows)
    return true


def write_rows(file: Path, rows: list[list[object]]) -> None:
    with file.open("w", newline="") as text:
        csv.writer(text).writerows(rows)


def imported(folder: Path, readings: str, *more: str):
    return run(
        *("import", "images", folder / "photographs", "--board", folder / "board.toml", "--json"),
        *("--readings", folder / readings, "-o", folder / "marks.csv", *more),
    )


def ways(folder: Path, true: list[Array]) -> list[bool]:
    """Whether the marks of each photograph in the table are numbered as they truly are, or from the other end."""
    found: dict[str, list[bool]] = {}
    for row in csv.DictReader((folder / "marks.csv").open()):
        i, j = (round(float(row[f"board_{axis} [mm]"]) / 26.0) - 1 for axis in "xy")
        seen, corners = np.array([float(row["u [px]"]), float(row["v [px]"])]), true[int(row["group"][:-4])]
        ahead, back = (np.linalg.norm(of[j * ACROSS + i] - seen) < 1.0 for of in (corners, corners[::-1]))
        assert ahead or back
        if (i, j) != (3, 2):
            found.setdefault(row["group"], []).append(bool(ahead))
    assert all(len(set(one)) == 1 for one in found.values())
    return [one[0] for one in found.values()]


@pytest.mark.parametrize("camera_on", ["tip", "floor"])
def test_marks_are_numbered_alike_and_wrong_readings_are_named(tmp_path: Path, camera_on: str) -> None:
    pytest.importorskip("cv2")
    rng = np.random.default_rng(6)
    boards = before_camera(rng, 9)
    tips = flanges(rng, boards, camera_on)
    tips[4] = tips[4] @ pose(np.zeros(3), np.array([0.3, 1.1, -0.4]))
    true = write(tmp_path, boards, tips)
    said = imported(tmp_path, "flange.csv", "--camera-on", "floor" if camera_on == "tip" else "tip")
    assert (said.code, "it looks as if the camera" in said.err) == (1, True), said.err
    said = imported(tmp_path, "flange.csv", "--camera-on", camera_on)
    assert said.code == 0, said.err
    told = json.loads(said.out)
    assert [one["image"] for one in told["left_out"]] == ["4.png"]
    assert "contradict those of other photographs" in told["left_out"][0]["why"]
    (remark,) = [remark for remark in told["remarks"] if "looks the same upside down" in remark]
    turned = int(remark.split("and ")[1].split(" of 8 photographs")[0])
    found = ways(tmp_path, true)
    assert len(found) == 8 and len(set(found)) == 1
    # Else all of this would be nothing.
    assert 0 < turned < 8
    assert run("check", tmp_path / "marks.toml").code in (0, 3)


def test_the_joints_of_a_robot_tell_it_too_and_without_a_robot_nothing_does(tmp_path: Path) -> None:
    pytest.importorskip("cv2")
    session = small_session(3, 14)
    boards = np.array(simulation.before_camera(session))
    true = write(tmp_path, boards, flanges(np.random.default_rng(6), boards, "tip"))
    titles: list[object] = ["image", *(f"{name} [rad]" for name in session.arm.names)]
    write_rows(tmp_path / "joints.csv", [titles, *([f"{k}.png", *q] for k, q in enumerate(session.readings))])
    said = imported(tmp_path, "joints.csv")
    assert (said.code, said.err.count("\n")) == (1, 1)
    assert "where the robot is tells which way up it is in each photograph; name the robot" in said.err
    said = imported(tmp_path, "joints.csv", "--robot", simulation.UR5, "--tip", "tool0")
    assert said.code == 0, said.err
    # The others show no whole board.
    found = ways(tmp_path, true)
    assert len(found) >= 8 and len(set(found)) == 1


def test_what_cannot_be_told_is_refused_in_a_sentence(tmp_path: Path) -> None:
    """So are readings of other photographs, five photographs, and a board that looks the same from all four sides."""
    pytest.importorskip("cv2")
    rng = np.random.default_rng(7)
    boards = before_camera(rng, 8)
    write(tmp_path, boards, flanges(rng, before_camera(rng, 8), "tip"))
    said = imported(tmp_path, "flange.csv")
    assert (said.code, said.err.count("\n")) == (1, 1)
    assert "the readings do not tell which way up it is in most photographs" in said.err
    for k in range(5, 8):
        (tmp_path / "photographs" / f"{k}.png").unlink()
    said = imported(tmp_path, "flange.csv")
    assert (said.code, said.err.count("\n")) == (1, 1)
    assert "to tell which way up it is, 6 photographs with readings that show how it lies are needed" in said.err
    (tmp_path / "board.toml").write_text('kind = "chessboard"\nsquares = [7, 7]\nsquare = "26 mm"\n')
    said = imported(tmp_path, "flange.csv")
    assert "a chessboard of 7 x 7 squares looks the same from all four sides" in said.err
    assert not list(tmp_path.glob("marks*"))


@pytest.mark.parametrize("seed", [2, 3, 5, 7, 8, 9])
def test_one_photograph_that_is_far_off_does_not_hide_that_others_fit(seed: int) -> None:
    """Of a camera beside the robot, read as one on the flange of which the poses are inverse: the same."""
    rng = np.random.default_rng(seed)
    boards = before_camera(rng, 9)
    tips = flanges(rng, boards, "floor")
    tips[4] = tips[4] @ pose(np.zeros(3), np.array([0.3, 1.1, -0.4]))
    corner = pose(np.array([-0.104, -0.078, 0.0]), np.zeros(3))
    found = _off(np.linalg.inv(tips), Seen(boards @ corner, np.arange(9)), "tip")
    assert found.share < 1e-6
