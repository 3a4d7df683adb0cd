"""Cameras: Jacobian, start values, recovered truth, ranks, intervals, outliers, mixed sets and refusals."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats
from scipy.spatial.transform import Rotation

import calib
from calib.foundations.errors import JobError, MeasurementError
from calib.identification import system, targets
from calib.identification.arrow import Arrow
from calib.identification.identify import residuals_of
from calib.identification.initialisation.problem import initial_problem
from calib.identification.machine import Layout, values_at
from calib.identification.observability import observability
from calib.identification.parameters import scales
from calib.identification.rows import photograph_numbers
from calib.identification.system import Problem, with_twists
from calib.identification.targets import Target
from calib.identification.together import Together
from calib.measurement.boards import Board
from tests.support import cameras, jacobians, machines
from tests.support.cameras import BLOCK, BOARD, MARK, TIP, UR5, Array, Scene, scene

ROBOT, NOMINAL = machines.load(UR5, TIP), machines.arm(UR5, TIP)
SEEN = {"board": BOARD, "block": BLOCK, "mark": MARK}
INNER = ("shoulder_lift_joint", "elbow_joint", "wrist_1_joint", "wrist_2_joint")


def freedom(camera_on: str, what: str) -> str:
    return "position" if (camera_on, what) == ("floor", "mark") else "pose"


def everything(camera_on: str, what: str) -> calib.ErrorModel:
    return calib.error_model(ROBOT, offsets="all", placements="all", tool=freedom(camera_on, what))


def relative(found: Array, true: Array) -> tuple[float, float]:
    """How far poses are apart, in m and rad."""
    T = np.linalg.inv(found) @ true
    return float(np.linalg.norm(T[:3, 3])), float(Rotation.from_matrix(T[:3, :3]).magnitude())


@pytest.mark.parametrize("what", SEEN)
@pytest.mark.parametrize("camera_on", ["floor", "tip"])
def test_columns_match_central_differences(camera_on: str, what: str) -> None:
    """Everything free, the base and fixed joints too, far from where it starts."""
    rng = np.random.default_rng(7)
    true = scene(rng, NOMINAL, camera_on, SEEN[what])
    data = true.measure(ROBOT, true.draw(rng, 8 if what == "mark" else 3))
    model = calib.error_model(ROBOT, offsets="all", placements=["*"], tool="pose")
    start = Problem(model, (), initial_problem(everything(camera_on, what), [data]).reference, (data,))
    layout = Layout.of(ROBOT, start.reference)
    parameters = (*model.parameters(), *targets.unknowns([data], {}, layout))
    problem = replace(start, parameters=parameters)
    x = values_at(ROBOT, parameters, start.reference) + rng.uniform(-0.04, 0.04, len(parameters))
    jacobians.check(problem, x, 1e-6, least=10.0)


@pytest.mark.parametrize(("what", "rank"), [("board", 30), ("block", 30), ("mark", 26)])
@pytest.mark.parametrize("camera_on", ["floor", "tip"])
def test_truth_is_recovered(camera_on: str, what: str, rank: int) -> None:
    """A badly made arm, camera and board anywhere: held-out pixels are foretold, and the rank is as counted.

    Single marks tell directions and no length: one less than 27 of positions. All else is robot and hand-eye.
    """
    rng = np.random.default_rng(11)
    true = scene(rng, NOMINAL.moved(rng), camera_on, SEEN[what])
    readings = true.draw(rng, 80 if what == "mark" else 30)
    fit = calib.identify(everything(camera_on, what), true.measure(ROBOT, readings))
    assert (fit.rank, fit.numerical_rank, fit.converged) == (rank, rank, True)
    assert np.abs(fit.nominal_residuals[0]).max() > 1.0
    (held_out,) = residuals_of(fit, [true.measure(ROBOT, true.draw(rng, 20))], fit.machine)
    assert np.abs(held_out).max() < 1e-9


@pytest.mark.parametrize("camera_on", ["floor", "tip"])
def test_noise_does_not_make_a_size_of_a_single_mark(camera_on: str) -> None:
    """A machine shrunk to a point in the camera explains nothing and costs nothing: its size stays nominal."""
    rng = np.random.default_rng(13)
    true = scene(rng, NOMINAL.moved(rng), camera_on, MARK, sigma=0.3)
    fit = calib.identify(everything(camera_on, "mark"), true.measure(ROBOT, true.draw(rng, 80), rng, 0.3))
    assert (fit.rank, fit.numerical_rank, fit.converged) == (26, 26, True)
    frames = fit.machine.frames
    found, at = (frames.tools[0], true.tool) if camera_on == "tip" else (frames.targets[0], true.target)
    place, turn = relative(found, at)
    assert place < 0.01
    assert turn < 0.01


@pytest.mark.parametrize("together", [False, True])
@pytest.mark.parametrize(
    ("camera_on", "link"), [("floor", None), ("tip", None), ("tip", "upper_arm_link"), ("floor", "shoulder_link")]
)
def test_photographs_say_what_their_marks_say(
    camera_on: str, link: str | None, together: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rows in any order, of many marks and of one, with lens and shape free, at a place that explains nothing.

    ``link``: where the target is said to be, if not on the floor.
    """
    rng = np.random.default_rng(3)
    true = scene(rng, NOMINAL, camera_on)
    camera = replace(true.camera, free=("fx", "fy", "k1"))
    data = cameras.photographed(ROBOT, true, 12, camera, Board(marks=BOARD, shape="quadratic"), rng, 0.3)
    data = data.subset(rng.permutation(len(data))[:150])
    robot = ROBOT if link is None else calib.load_robot(UR5, tip=TIP, links=[link])
    model = calib.error_model(robot, offsets="all", placements="all", tool="pose")
    problem = initial_problem(model, [data])
    (own,) = problem.measurements
    links = {} if link is None else dict.fromkeys(own.targets, link)
    problem = replace(problem, measurements=(replace(own, target_links=links),))
    x = values_at(robot, problem.parameters, problem.reference) + rng.uniform(-0.02, 0.02, len(problem.parameters))
    sigmas = [rng.uniform(0.2, 0.5, data.sigma.shape)]
    number = photograph_numbers(problem.measurements[0])
    if together:
        rows = with_twists(problem, problem.machine(x), problem.measurements[0], scales(problem.parameters))
        problem = replace(problem, together=(Together.of(1e-4, 3e-4, 0.1, number, rows.by_twist, sigmas[0]),))
    photographs = problem.evaluate(sigmas, x)
    assert problem.photographs[0] is not None
    monkeypatch.setattr(system, "photographs_of", lambda _: None)
    marks = replace(problem).evaluate(sigmas, x)
    np.testing.assert_allclose(photographs.residuals[0], marks.residuals[0], atol=1e-9)
    few, many = (_squares(one.rows.whole) for one in (photographs, marks))
    np.testing.assert_allclose(few, many, rtol=1e-8, atol=1e-10 * np.abs(many).max())


def _squares(rows: Arrow) -> Array:
    """``[J r]^T [J r]``."""
    r = np.concatenate([rows.heads[:, :, -1].ravel(), rows.rest[:, -1]])
    both = np.column_stack([rows.moved(np.eye(rows.split.size)), r])
    return both.T @ both


@pytest.mark.parametrize("camera_on", ["floor", "tip"])
def test_hand_eye_is_recovered(camera_on: str) -> None:
    """With what can be told apart free, camera and board are where they are, and so are the zeros."""
    rng = np.random.default_rng(12)
    zeros = dict(zip(INNER, rng.normal(scale=0.01, size=4), strict=True))
    true = scene(rng, NOMINAL.with_errors(np.zeros((len(NOMINAL.joints), 6)), zeros), camera_on)
    fit = calib.identify(calib.error_model(ROBOT, offsets=INNER, tool="pose"), true.measure(ROBOT, true.draw(rng, 12)))
    assert not fit.null_space
    for name, zero in zeros.items():
        assert abs(fit.value(f"{name}.offset") - zero) < 1e-9
    assert max(relative(fit.machine.frames.tools[0], true.tool)) < 1e-9
    assert max(relative(fit.machine.frames.targets[0], true.target)) < 1e-9


@pytest.mark.parametrize("camera_on", ["floor", "tip"])
def test_errors_are_within_their_intervals(camera_on: str) -> None:
    """Zeros and the tool's place, over many noisy data sets: errors in their covariance are chi-square."""
    squares = []
    for seed in range(10):
        rng = np.random.default_rng(seed)
        zeros = dict(zip(INNER, rng.normal(scale=0.01, size=4), strict=True))
        arm = NOMINAL.with_errors(np.zeros((len(NOMINAL.joints), 6)), zeros)
        true = scene(rng, arm, camera_on, sigma=0.3 if seed % 2 else 0.0)
        data = true.measure(ROBOT, true.draw(rng, 10), rng, 0.3)
        fit = calib.identify(calib.error_model(ROBOT, offsets=INNER, tool="pose"), data)
        names = [parameter.name for parameter in fit.parameters]
        own = [names.index(name) for name in (*(f"{j}.offset" for j in INNER), "tool.x", "tool.y", "tool.z")]
        error = fit.values[own] - np.array([*zeros.values(), *true.tool[:3, 3]])
        squares.append(error @ np.linalg.solve(fit.covariance[np.ix_(own, own)], error))
        (noise,) = fit.noise
        assert (noise.quantity, noise.instrument) == ("pixels", pytest.approx(0.3 if seed % 2 else 0.0))
        assert noise.total == pytest.approx(0.3, rel=0.15)
    low, high = stats.chi2.ppf([0.001, 0.999], 7 * len(squares))
    assert low < sum(squares) < high


@pytest.mark.parametrize("what", SEEN)
@pytest.mark.parametrize("camera_on", ["floor", "tip"])
def test_starts_from_anywhere(camera_on: str, what: str) -> None:
    """Camera, board and tool anywhere, turned any way, few noisy images: the nominal robot already explains them."""
    for seed in range(20, 22):
        rng = np.random.default_rng(seed)
        true = scene(rng, NOMINAL.moved(rng, zero=0.02), camera_on, SEEN[what], sigma=0.3)
        data = true.measure(ROBOT, true.draw(rng, 40 if what == "mark" else 8), rng, 0.3)
        fit = calib.identify(calib.error_model(ROBOT, offsets="all", tool=freedom(camera_on, what)), data)
        assert fit.converged
        assert np.median(np.abs(fit.residuals[0])) < 5.0
        assert np.median(np.abs(fit.nominal_residuals[0])) < 60.0


@pytest.mark.parametrize("camera_on", ["floor", "tip"])
def test_outliers_hardly_matter_to_a_robust_loss(camera_on: str) -> None:
    rng = np.random.default_rng(31)
    true = scene(rng, NOMINAL.moved(rng), camera_on, sigma=0.2)
    columns = true.columns(true.draw(rng, 15), rng, 0.2)
    u = np.array(columns["u [px]"])
    wrong = rng.choice(len(u), len(u) // 20, replace=False)
    u[wrong] += rng.choice([-1, 1], len(wrong)) * rng.uniform(20, 80, len(wrong))
    data = calib.read_measurements(columns | {"u [px]": u}, ROBOT, "pixels", instrument=true.camera)
    held_out = true.measure(ROBOT, true.draw(rng, 20))

    def miss(loss: str) -> float:
        fit = calib.identify(everything(camera_on, "board"), data, losses=[loss])
        return float(np.sqrt(np.mean(residuals_of(fit, [held_out], fit.machine)[0] ** 2)))

    assert miss("cauchy") < 0.25 * miss("linear")


@pytest.mark.parametrize("camera_on", ["floor", "tip"])
def test_the_order_of_rows_changes_nothing(camera_on: str) -> None:
    rng = np.random.default_rng(41)
    true = scene(rng, NOMINAL.moved(rng), camera_on, sigma=0.2)
    data = true.measure(ROBOT, true.draw(rng, 12), rng, 0.2)
    one = calib.identify(everything(camera_on, "board"), data)
    other = calib.identify(everything(camera_on, "board"), data.subset(rng.permutation(len(data))))
    np.testing.assert_allclose(one.values, other.values, rtol=0, atol=1e-9)
    assert np.nanmax(np.abs(one.sigmas / other.sigmas - 1.0)) < 1e-6


def mixed(rng: np.random.Generator, camera_on: str) -> tuple[Scene, machines.Machine, list[calib.Measurements]]:
    """One arm before a tracker, with a reflector and a camera or board on its tip."""
    arm, base = NOMINAL.moved(rng), machines.anywhere(rng)
    true = scene(rng, arm, camera_on, base=base, sigma=0.2)
    tracked = machines.Machine(arm, base, {"ball": machines.pose((0.03, -0.02, 0.09))})
    readings = true.draw(rng, 12)
    columns = true.columns(readings, rng, 0.2) | {"tool": ["eye"] * 12 * len(BOARD)}
    return (
        true,
        tracked,
        [
            tracked.measure(ROBOT, arm.draw(rng, 14), points=["ball"] * 14, rng=rng, sigma=0.05e-3),
            calib.read_measurements(columns, ROBOT, "pixels", instrument=true.camera),
        ],
    )


@pytest.mark.parametrize("camera_on", ["floor", "tip"])
def test_a_tracker_and_a_camera_in_one_fit(camera_on: str) -> None:
    """The tracker's frame is the world, where the camera is found too; together they are better than the tracker."""
    rng = np.random.default_rng(51)
    true, tracked, sets = mixed(rng, camera_on)
    model = everything(camera_on, "board")
    fit = calib.identify(model, sets)
    names = {parameter.name for parameter in fit.parameters}
    assert {"base.x", "tool.eye.rx", "target.target.rx", "tool.ball.x"} <= names
    # A reflector has no orientation to determine.
    assert "tool.ball.rx" not in names
    assert fit.rank == 36 + 3 + 1  # and the scale of the board, which the tracker tells
    assert fit.converged
    alone = calib.identify(replace(model, tool="position"), sets[0])
    held_out = tracked.arm.draw(rng, 200)
    assert machines.miss(fit, tracked, held_out) < 0.9 * machines.miss(alone, tracked, held_out)
    assert [noise.quantity for noise in fit.noise] == ["position", "pixels"]
    place, turn = relative(fit.machine.frames.targets[0], true.target)
    assert place < 2e-3
    assert turn < 4e-3


def test_a_camera_finds_its_place_by_marks_that_a_tracker_placed() -> None:
    """Of each mark it needed six poses, though where they are on the tip was known."""
    rng = np.random.default_rng(52)
    arm, base = NOMINAL.moved(rng), machines.anywhere(rng)
    true = scene(rng, arm, "floor", MARK, base=base)
    tools = {name: machines.pose(place) for name, place in (("A", (0.03, -0.02, 0.09)), ("B", (-0.04, 0.01, 0.06)))}
    tracked = machines.Machine(arm, base, tools)
    names = ["A", "B"] * 5
    data = tracked.measure(ROBOT, arm.draw(rng, 10), points=names, rng=rng, sigma=0.02e-3)
    parts = [replace(true, tool=tools[name]).columns(true.draw(rng, n), rng, 0.1) for name, n in (("A", 5), ("B", 2))]
    columns = {title: np.concatenate([np.asarray(part[title]) for part in parts]) for title in parts[0]}
    seen = calib.read_measurements(columns | {"tool": list("AAAAABB")}, ROBOT, "pixels", instrument=true.camera)
    fit = calib.identify(calib.error_model(ROBOT, offsets=INNER, tool="position"), [data, seen])
    place, turn = relative(fit.machine.frames.targets[0], true.target)
    assert place < 0.02
    assert turn < 0.02


def test_a_camera_on_a_link_is_found_from_all_places_where_the_robot_stood() -> None:
    """It was sought from one of them alone, where too few marks may have been seen."""
    rng = np.random.default_rng(53)
    true = scene(rng, NOMINAL, "floor", MARK)
    columns = true.columns(true.draw(rng, 10)) | {"setup": ["left"] * 5 + ["right"] * 5}
    robot = calib.load_robot(UR5, tip=TIP, links=["base_link"])
    data = calib.read_measurements(columns, robot, "pixels", instrument=true.camera).named(on={"target": "base_link"})
    fit = calib.identify(calib.error_model(robot, offsets=INNER[:1], tool="position"), [data])
    assert relative(fit.machine.frames.targets[0], true.target)[1] < 1e-6


@pytest.mark.parametrize("camera_on", ["floor", "tip"])
def test_a_known_target_tells_where_the_base_is(camera_on: str) -> None:
    rng = np.random.default_rng(61)
    true = scene(rng, NOMINAL, camera_on, base=machines.anywhere(rng))
    data = true.measure(ROBOT, true.draw(rng, 10))
    fit = calib.identify(
        machines.model(ROBOT, offsets=INNER, tool="pose", targets={"target": Target(true.target)}), data
    )
    assert max(relative(fit.machine.frames.base, true.base)) < 1e-9
    assert max(relative(fit.machine.frames.tools[0], true.tool)) < 1e-9


@pytest.mark.parametrize("camera_on", ["floor", "tip"])
def test_a_known_tool_needs_no_start(camera_on: str) -> None:
    rng = np.random.default_rng(62)
    true = scene(rng, NOMINAL, camera_on)
    model = machines.model(ROBOT, offsets=INNER, tool="fixed", tool_poses={"tool": true.tool})
    fit = calib.identify(model, true.measure(ROBOT, true.draw(rng, 10)))
    assert max(relative(fit.machine.frames.targets[0], true.target)) < 1e-9


@pytest.mark.parametrize(("seed", "images"), [(7, 20), (9, 8)])
def test_small_boards_tilted_to_the_wrong_side_in_a_third_of_the_images(seed: int, images: int) -> None:
    """Perspective tells no side of boards 50 pixels wide; the start was 170 degrees off, and behind the camera."""
    rng = np.random.default_rng(seed)
    robot, arm = machines.load(UR5, TIP), machines.arm(UR5, TIP)
    true = scene(rng, arm, "tip", places=0.25 * BOARD, sigma=0.3)
    data = true.measure(robot, true.draw(rng, images), rng, 0.3)
    fit = calib.identify(calib.error_model(robot, tool="pose", base="fixed"), data)
    assert fit.noise[0].chi_square < 1.5
    turn = fit.machine.frames.tools[0, :3, :3].T @ true.tool[:3, :3]
    assert np.arccos(np.clip((np.trace(turn) - 1.0) / 2.0, -1.0, 1.0)) < 0.05


def test_held_out_images_of_another_board_find_it() -> None:
    rng = np.random.default_rng(63)
    true = scene(rng, NOMINAL.moved(rng), "tip")
    fit = calib.identify(everything("tip", "board"), true.measure(ROBOT, true.draw(rng, 30)))
    other = replace(true, target=true.target @ machines.pose((0.1, 0.05, -0.02), (0.1, 0.2, 0.3)), places=BLOCK)
    readings = other.draw(rng, 10)
    columns = other.columns(readings) | {"target": ["another"] * len(BLOCK) * 10}
    data = calib.read_measurements(columns, ROBOT, "pixels", instrument=true.camera)
    assert np.abs(residuals_of(fit, [data], fit.machine)[0]).max() < 1e-8


def test_what_cannot_be_seen_is_told() -> None:
    rng = np.random.default_rng(64)
    true = scene(rng, NOMINAL, "tip")
    seen = observability(everything("tip", "board"), [true.measure(ROBOT, true.draw(rng, 30))])
    assert (seen.rank, len(seen.parameters)) == (30, 49)
    # The base is the world: its place is no unknown beside that of the board.
    assert not any(parameter.kind == "base" for parameter in seen.parameters)


def seen_table() -> tuple[Scene, dict[str, object]]:
    rng = np.random.default_rng(71)
    true = scene(rng, NOMINAL, "tip")
    return true, true.columns(true.draw(rng, 8))


def bent_columns(columns: Mapping[str, object], name: str, row: int, value: float) -> dict[str, object]:
    values = np.array(columns[name], dtype=float)
    values[row] = value
    return {**columns, name: values}


def test_a_pixel_beyond_the_lens_is_refused() -> None:
    true, columns = seen_table()
    lens = replace(true.camera, k1=-2.0, k2=0.0, k3=0.0)
    middle = columns | {"u [px]": np.full(160, lens.cx), "v [px]": np.full(160, lens.cy)}
    with pytest.raises(
        MeasurementError, match=r"^arrays:7: the camera cannot see anything at the pixel u = 9000, v = 508"
    ):
        calib.read_measurements(bent_columns(middle, "u [px]", 7, 9000.0), ROBOT, "pixels", instrument=lens)


def test_a_mark_behind_the_camera_is_refused() -> None:
    """One place on the board is written wrongly: it would be two metres behind the camera."""
    true, columns = seen_table()
    readings = np.stack([np.array(columns[f"{name} [rad]"]) for name in NOMINAL.ranges], axis=1)
    camera = np.linalg.inv(true.target) @ true.arm.tips(readings[33:34])[0] @ true.tool
    place = camera @ (0.0, 0.0, -2.0, 1.0)
    for axis, value in zip("xyz", place, strict=False):
        columns = bent_columns(columns, f"board_{axis} [mm]", 33, 1e3 * value)
    data = calib.read_measurements(columns, ROBOT, "pixels", instrument=true.camera)
    with pytest.raises(MeasurementError, match=r'^arrays:33: the camera saw this mark, .* behind the camera; .*"tip"'):
        calib.identify(calib.error_model(ROBOT, offsets="all", tool="pose"), data)


def test_too_few_marks_are_refused() -> None:
    true, columns = seen_table()
    some = {name: np.array(values)[np.arange(160) % 20 < 3] for name, values in columns.items()}
    data = calib.read_measurements(some, ROBOT, "pixels", instrument=true.camera)
    with pytest.raises(MeasurementError, match=r"too little to tell where the target 'target' is; .* four marks"):
        calib.identify(calib.error_model(ROBOT, tool="pose"), data)


@pytest.mark.parametrize(("camera_on", "what"), [("floor", "board"), ("tip", "camera")])
def test_an_unknown_orientation_that_is_not_free_is_refused(camera_on: str, what: str) -> None:
    rng = np.random.default_rng(72)
    true = scene(rng, NOMINAL, camera_on)
    data = true.measure(ROBOT, true.draw(rng, 8))
    with pytest.raises(JobError, match=f'orientation of the {what} on the tip in arrays is not known; write "pose"'):
        calib.identify(calib.error_model(ROBOT), data)


def test_options_that_do_not_fit_are_refused() -> None:
    true, columns = seen_table()
    with pytest.raises(JobError, match="no camera is given"):
        calib.read_measurements(columns, ROBOT, "pixels")
    with pytest.raises(JobError, match="the noise of pixels is the camera's"):
        calib.read_measurements(columns, ROBOT, "pixels", instrument=true.camera, sigma=0.1)
    with pytest.raises(JobError, match="a camera is given, which measures pixels and not a socket"):
        calib.read_measurements(columns, ROBOT, "socket", instrument=true.camera)
    with pytest.raises(MeasurementError, match="there is no column 'v' of the pixel"):
        calib.read_measurements(
            {k: v for k, v in columns.items() if k != "v [px]"}, ROBOT, "pixels", instrument=true.camera
        )
    with pytest.raises(MeasurementError, match="unit 'mm' is not a unit of pixel"):
        calib.read_measurements(
            {k.replace("v [px]", "v [mm]"): v for k, v in columns.items()}, ROBOT, "pixels", instrument=true.camera
        )
    with pytest.raises(JobError, match="'target' is a board or camera: give its position and quaternion"):
        calib.identify(
            machines.model(ROBOT, tool="pose", targets={"target": Target(np.eye(4), height_is_known=False)}),
            calib.read_measurements(columns, ROBOT, "pixels", instrument=true.camera),
        )


def test_a_column_of_sigmas_in_pixels() -> None:
    true, columns = seen_table()
    sigma = np.linspace(0.1, 0.5, 160)
    data = calib.read_measurements(columns | {"sigma [px]": sigma}, ROBOT, "pixels", instrument=true.camera)
    np.testing.assert_array_equal(data.sigma, np.column_stack([sigma, sigma]))
    assert cameras.eye("tip", 0.2) == replace(true.camera, sigma=0.2)
