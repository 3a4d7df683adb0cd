"""Hand-eye in words of others, and which cause is blamed, for cameras and boards of a known truth."""

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

import calib
from calib.assessment import blame as blaming
from calib.assessment.blame import blame
from calib.assessment.hand_eye import HandEye, hand_eyes, marks_and_pixels
from calib.assessment.judged import JudgedSet
from calib.identification import identify as identification
from calib.identification.identify import identify_alike, residuals_of
from calib.measurement.boards import Board, shape_modes
from calib.measurement.lens import NAMES
from calib.measurement.optics import seen_by
from calib.presentation.hand_eye import (
    blame_section,
    camera_info,
    hand_eye_section,
    matrix,
    static_transform,
    urdf_joint,
)
from tests.support import cameras, machines
from tests.support.cameras import BENT, BOARD, TIP, UR5, Array, Scene, eye, scene

ROBOT, NOMINAL = machines.load(UR5, TIP), machines.arm(UR5, TIP)
SIGMA = 0.1


def judged(true: Scene, model: calib.ErrorModel, camera: calib.measuring.Camera, board: Board):
    data = cameras.photographed(ROBOT, true, 24, camera, board, np.random.default_rng(8), SIGMA)
    kept, held_out = calib.hold_out(data, 0.25)
    fit = calib.identify(model, kept)
    sets = [
        JudgedSet(use, use, some, *(residuals_of(fit, [some], at)[0] for at in (fit.nominal, fit.machine)))
        for use, some in (("identification", kept), ("validation", held_out))
    ]
    return fit, sets


@pytest.fixture(scope="module", params=["tip", "floor"])
def found(request: pytest.FixtureRequest) -> tuple[HandEye, Scene]:
    true = scene(np.random.default_rng(3), NOMINAL, request.param, sigma=SIGMA)
    camera = replace(eye(request.param, SIGMA), free=NAMES[:9], size=(1280, 1024))
    fit, sets = judged(true, calib.error_model(ROBOT, tool="pose"), camera, Board())
    (one,) = hand_eyes(fit, sets)
    assert hand_eye_section((one,)) is not None
    return one, true


@pytest.mark.parametrize("camera_on", ["tip", "floor"])
def test_a_pixel_is_a_way_across_the_line_of_sight_where_a_mark_is(camera_on: str) -> None:
    """Moved by its residual, a mark is seen by an independent projection where it was measured."""
    rng = np.random.default_rng(3)
    true = scene(rng, NOMINAL, camera_on, sigma=SIGMA)
    data = true.measure(ROBOT, true.draw(rng, 12), rng, SIGMA)
    data = seen_by(data, true.camera, Board(scale_sigma=0.0))
    fit = calib.identify(calib.error_model(ROBOT, tool="pose", base="fixed"), data)
    places, of_pixel = marks_and_pixels(fit, data)
    ways = np.einsum("nij,nj->ni", of_pixel, fit.residuals[0])
    frames = fit.machine.frames
    tools = NOMINAL.tips(data.readings) @ frames.tools[0]
    at = tools if camera_on == "tip" else np.broadcast_to(frames.targets[0], tools.shape)
    sight = np.einsum("nji,nj->ni", at[:, :3, :3], places - at[:, :3, 3])
    moved = sight + np.einsum("nji,nj->ni", at[:, :3, :3], ways)
    np.testing.assert_allclose(cameras.see(true.camera, moved), data.value[:, :2], atol=1e-3)
    along = np.sum(sight * (moved - sight), axis=1)
    assert np.all(np.abs(along) < 1e-6 * np.linalg.norm(sight, axis=1) * np.linalg.norm(ways, axis=1) + 1e-12)


def test_the_camera_is_where_it_is_and_its_errors_are_told_in_pixels_and_metres(found: tuple[HandEye, Scene]) -> None:
    one, true = found
    assert (one.parent, one.on_tip) == (("tool0", True) if true.camera.camera_on == "tip" else (ROBOT.base, False))
    pose = true.tool if one.on_tip else true.target
    np.testing.assert_allclose(one.pose, pose, atol=2e-3)
    assert one.pixels == pytest.approx(SIGMA * np.sqrt(2.0), rel=0.25)
    assert one.across == pytest.approx(one.pixels * one.distance / one.lens.fx, rel=0.4)
    for name in ("fx", "cy", "k1"):
        k = NAMES.index(name)
        assert abs(one.lens[k] - BENT[name]) < 4.0 * one.sigmas[k]
    assert not one.sigmas[9:].any()


def test_how_sure_the_pose_is_is_told_along_the_axes_that_it_is_told_in(found: tuple[HandEye, Scene]) -> None:
    one, true = found
    pose = true.tool if one.on_tip else true.target
    turn = Rotation.from_matrix(one.pose[:3, :3].T @ pose[:3, :3]).as_rotvec()
    off = np.concatenate([one.pose[:3, 3] - pose[:3, 3], turn])
    assert np.all((one.pose_sigmas > 0.0) & (one.pose_sigmas < 2e-3))
    assert np.all(np.abs(off) < 4.0 * one.pose_sigmas)
    said = [row.cells for row in hand_eye_section((one,)).blocks[0].rows if "one sigma" in row.cells[0]]
    assert [float(x) for x in said[0][1].removesuffix(" mm").split(", ")] == pytest.approx(
        1e3 * one.pose_sigmas[:3], abs=6e-4
    )
    assert said[1][1].endswith(" mrad")


def test_a_camera_beside_the_arm_is_as_sure_along_the_axes_of_the_base_as_along_its_own() -> None:
    true = scene(np.random.default_rng(3), NOMINAL, "floor", sigma=SIGMA)
    fit, sets = judged(true, calib.error_model(ROBOT, base="fixed", tool="pose"), eye("floor", SIGMA), Board())
    own = fit.covariance[np.ix_(*[[k for k, p in enumerate(fit.parameters) if p.kind == "target"]] * 2)]
    (one,) = hand_eyes(fit, sets)
    R = true.target[:3, :3]
    np.testing.assert_allclose(one.pose_sigmas[:3] ** 2, np.diag(R @ own[:3, :3] @ R.T), rtol=0.02)
    np.testing.assert_allclose(one.pose_sigmas[3:] ** 2, np.diag(own)[3:], rtol=1e-9)
    assert np.abs(one.pose_sigmas[:3] ** 2 / np.diag(own)[:3] - 1.0).max() > 0.1


def test_no_sigma_is_told_of_what_is_not_identifiable() -> None:
    """Of an arm whose placements are free, nothing tells where on its last axis a camera is."""
    true = scene(np.random.default_rng(3), NOMINAL, "tip", sigma=SIGMA)
    model = calib.error_model(ROBOT, offsets="all", placements="all", base="fixed", tool="pose")
    fit, sets = judged(true, model, eye("tip", SIGMA), Board())
    (one,) = hand_eyes(fit, sets)
    unknown = fit.unidentifiable[[p.kind == "tool" for p in fit.parameters]]
    assert unknown.any()
    np.testing.assert_array_equal(np.isnan(one.pose_sigmas), unknown)
    said = [row.cells[1] for row in hand_eye_section((one,)).blocks[0].rows if "one sigma" in row.cells[0]]
    assert sum(text.count("not identifiable") for text in said) == unknown.sum()


def test_a_camera_beside_an_arm_whose_base_is_free_has_no_sigma_in_it() -> None:
    rng = np.random.default_rng(3)
    true = scene(rng, NOMINAL, "floor", sigma=SIGMA)
    seen = cameras.photographed(ROBOT, true, 24, eye("floor", SIGMA), Board(), rng, SIGMA)
    tracked = machines.Machine(NOMINAL, machines.anywhere(rng), {"ball": machines.pose((0.05, 0.02, 0.15))})
    readings = NOMINAL.draw(rng, 20)
    positions = tracked.measure(ROBOT, readings, "position", points=["ball"] * 20, rng=rng, sigma=2e-5)
    fit = calib.identify(calib.error_model(ROBOT, tool="pose"), [seen, positions])
    (one,) = hand_eyes(fit, [JudgedSet("identification", "a.csv", seen, fit.residuals[0], fit.residuals[0])])
    assert {"base", "target"} <= {p.kind for p in fit.parameters}
    assert np.isnan(one.pose_sigmas).all()


def test_all_words_say_the_same_pose(found: tuple[HandEye, Scene]) -> None:
    one, _ = found
    np.testing.assert_allclose(np.array(matrix(one).split(), dtype=float).reshape(4, 4), one.pose, atol=1e-8)
    words = static_transform(one).split()
    told = {key: float(words[words.index(f"--{key}") + 1]) for key in ("x", "y", "z", "qx", "qy", "qz", "qw")}
    np.testing.assert_allclose([told[key] for key in "xyz"], one.pose[:3, 3], atol=1e-7)
    turn = Rotation.from_quat([told[f"q{key}"] for key in "xyzw"])
    np.testing.assert_allclose(turn.as_matrix(), one.pose[:3, :3], atol=1e-8)
    assert words[words.index("--frame-id") + 1] == one.parent
    joint = ET.fromstring(f"<robot>{urdf_joint(one)}</robot>").find("joint")  # noqa: S314 - our own
    origin = joint.find("origin")
    np.testing.assert_allclose(np.array(origin.get("xyz").split(), dtype=float), one.pose[:3, 3], atol=1e-9)
    rpy = np.array(origin.get("rpy").split(), dtype=float)
    np.testing.assert_allclose(Rotation.from_euler("xyz", rpy).as_matrix(), one.pose[:3, :3], atol=1e-8)
    info = yaml.safe_load(camera_info(one))
    assert (info["image_width"], info["distortion_model"]) == (1280, "plumb_bob")
    assert info["camera_matrix"]["data"][:3] == pytest.approx([one.lens.fx, 0.0, one.lens.cx])
    assert info["distortion_coefficients"]["data"] == pytest.approx(list(one.lens[4:9]))


def test_eight_numbers_are_those_of_the_rational_model(found: tuple[HandEye, Scene]) -> None:
    one = replace(found[0], lens=found[0].lens._replace(k5=0.1))
    info = yaml.safe_load(camera_info(one))
    assert info["distortion_model"] == "rational_polynomial"
    assert len(info["distortion_coefficients"]["data"]) == 8


def planted(cause: str) -> tuple[calib.Fit, list[JudgedSet]]:
    rng = np.random.default_rng(6)
    zeros = {"elbow_joint": 0.01} if cause == "arm" else {}
    true = scene(rng, NOMINAL.with_errors(np.zeros((len(NOMINAL.joints), 6)), zeros), "tip", sigma=SIGMA)
    given = replace(eye("tip", SIGMA), free=NAMES[:9])
    places: Array = BOARD
    if cause == "lens":
        given = replace(given, fx=BENT["fx"] * 1.02, fy=BENT["fy"] * 1.02, k1=0.0)
    elif cause == "scale":
        places = 1.015 * BOARD
    elif cause == "shape":
        places = BOARD + shape_modes(BOARD, "quadratic") @ np.array([1e-3, -8e-4, 1e-3, 0.0, 0.0])
    model = calib.error_model(ROBOT, offsets=["elbow_joint", "wrist_1_joint"], base="fixed", tool="pose")
    return judged(replace(true, places=places), model, given, Board(marks=BOARD, shape="quadratic"))


@pytest.mark.parametrize("cause", ["lens", "scale", "shape", "arm", "corners"])
def test_the_planted_cause_is_named(cause: str) -> None:
    fit, sets = planted(cause)
    found = blame(fit, sets)
    assert found is not None
    assert found.named == cause
    assert found.left == pytest.approx(SIGMA * np.sqrt(2.0), rel=0.2)
    section = blame_section(found)
    assert [row.strong for row in section.blocks[1].rows].count(True) == (cause != "corners")
    shares = {one.name: one.tool for one in found.causes}
    assert max(shares.values()) <= found.tool


def test_a_lens_that_is_about_known_is_held_where_another_cause_is_tried() -> None:
    """Numbers that are held have no prior; asking for one refused the whole calibration."""
    rng = np.random.default_rng(6)
    true = scene(rng, NOMINAL, "tip", sigma=SIGMA)
    given = replace(eye("tip", SIGMA), free=("fx", "fy"), lens_sigma={"fx": 2.0, "fy": 2.0})
    model = calib.error_model(ROBOT, offsets=["elbow_joint", "wrist_1_joint"], base="fixed", tool="pose")
    found = blame(*judged(true, model, given, Board(marks=BOARD, shape="quadratic")))
    assert found is not None


@pytest.mark.parametrize("cause", ["scale", "arm"])
def test_of_very_many_photographs_some_tell_the_cause(cause: str, monkeypatch: pytest.MonkeyPatch) -> None:
    fit, sets = planted(cause)
    rows: list[int] = []

    def seen(fit: calib.Fit, own: Sequence[calib.Measurements], *args: object, **options: object) -> calib.Fit:
        rows.append(sum(map(len, own)))
        return identify_alike(fit, own, *args, **options)

    monkeypatch.setattr(blaming, "identify_alike", seen)
    monkeypatch.setattr(blaming, "_ENOUGH", 10)
    found = blame(fit, sets)
    assert found is not None
    assert found.named == cause
    assert set(rows) == {9 * len(BOARD)}  # every second one of 18


@pytest.mark.parametrize("times", [1.02, 1.5])
def test_a_lens_of_other_images_is_told_from_the_photographs_by_themselves(times: float) -> None:
    true = scene(np.random.default_rng(6), NOMINAL, "tip", sigma=SIGMA)
    other = {name: BENT[name] / times for name in ("fx", "fy", "cx", "cy")}
    given = replace(eye("tip", SIGMA), **other)
    model = calib.error_model(ROBOT, offsets=["elbow_joint"], base="fixed", tool="pose")
    found = blame(*judged(true, model, given, Board(marks=BOARD)))
    assert found is not None
    assert found.lens_is_wrong
    assert found.left < 0.5 * found.whole
    assert found.corners == pytest.approx(SIGMA * np.sqrt(2.0), rel=0.2)


@pytest.mark.parametrize("cause", ["lens", "arm"])
def test_frames_that_a_fit_has_found_are_not_sought_anew(cause: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nor is a number taken with them: a lens and a print that are held stay as they were given."""
    fit, sets = planted(cause)
    bare = [
        seen_by(data, replace(data.camera, free=()), Board(marks=BOARD, scale_sigma=0.0)) for data in fit.measurements
    ]
    free = ["tool.*", "*.offset"]
    cold = identify_alike(fit, bare, free)
    monkeypatch.setattr(identification, "_placed", None)
    warm = identify_alike(fit, bare, free, placed="fitted")
    np.testing.assert_array_equal(warm.machine.frames.scalars, cold.machine.frames.scalars)
    np.testing.assert_array_equal(warm.nominal.frames.tools, fit.nominal.frames.tools)
    np.testing.assert_allclose(warm.machine.frames.tools, cold.machine.frames.tools, atol=1e-7)
    np.testing.assert_allclose(warm.machine.deviations.offsets, cold.machine.deviations.offsets, atol=1e-7)
    np.testing.assert_allclose(warm.residuals[0], cold.residuals[0], atol=1e-3)
    assert blame(fit, sets) is not None


def test_a_lens_that_nobody_gave_is_no_cause_and_yet_leaves_the_tool_in_doubt() -> None:
    true = scene(np.random.default_rng(6), NOMINAL, "tip", sigma=SIGMA)
    camera = calib.measuring.Camera("tip", free=NAMES[:9], size=(1280, 1024), sigma=SIGMA)
    board = Board(marks=BOARD, shape="quadratic")
    found = blame(*judged(true, calib.error_model(ROBOT, base="fixed", tool="pose"), camera, board))
    assert found is not None and not found.lens_held
    lens = next(one for one in found.causes if one.name == "lens")
    assert lens.alone is None and lens.tool is not None and 0.0 < lens.tool < found.tool
    cells = [row.cells for row in blame_section(found).blocks[1].rows]
    assert "held" not in next(row for row in cells if row[0] == "lens")
    assert next(row for row in cells if row[0] == "arm")[3] == "held"


def test_without_a_board_nobody_is_blamed() -> None:
    true = scene(np.random.default_rng(3), NOMINAL, "tip", np.zeros((1, 3)))
    data = true.measure(ROBOT, true.draw(np.random.default_rng(1), 40))
    fit = calib.identify(calib.error_model(ROBOT, tool="pose"), data)
    assert blame(fit, [JudgedSet("identification", "", data, fit.nominal_residuals[0], fit.residuals[0])]) is None


def test_a_given_lens_beside_free_placements_is_a_doubt_that_can_be_answered() -> None:
    true = scene(np.random.default_rng(3), NOMINAL, "tip", sigma=SIGMA)
    data = true.measure(ROBOT, true.draw(np.random.default_rng(1), 24), np.random.default_rng(2), SIGMA)
    model = calib.error_model(ROBOT, placements=["wrist_*"], base="fixed", tool="pose")
    given = calib.assess(calib.identify(model, data))
    assert any("The lens of 'camera' is taken as given and placements are free" in doubt for doubt in given.doubts)
    assert not any("lens" in doubt for doubt in given.accepting(["lens"]).doubts)
    free = seen_by(data, replace(data.camera, free=NAMES[:9]), data.board)
    assert not any("lens" in doubt for doubt in calib.assess(calib.identify(model, free)).doubts)
