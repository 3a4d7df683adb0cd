"""Lens and board in the solve: Jacobian, starts without a guess, recovered truth, intervals, and refusals."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

import calib
from calib.foundations.errors import JobError, MeasurementError
from calib.identification import targets
from calib.identification.identify import residuals_of
from calib.identification.initialisation.lenses import with_found_lenses
from calib.identification.initialisation.problem import initial_problem
from calib.identification.machine import Layout, values_at
from calib.identification.system import Problem
from calib.measurement.boards import Board, shape_modes
from calib.measurement.lens import NAMES
from calib.measurement.optics import seen_by
from tests.support import cameras, jacobians, machines
from tests.support.cameras import BENT, BOARD, MARK, TIP, UR5, Scene, eye, scene

ROBOT, NOMINAL = machines.load(UR5, TIP), machines.arm(UR5, TIP)
INNER = ("shoulder_lift_joint", "elbow_joint", "wrist_1_joint", "wrist_2_joint")
FIVE = NAMES[:9]
# Half a percent too large, bent by a millimetre, and not quite square.
SCALE = 0.004
SHAPE = np.array([3e-4, -2e-4, 2e-4, 8e-5, -5e-5])
PRINTED = (1.0 + SCALE) * (BOARD + shape_modes(BOARD, "quadratic") @ SHAPE)


def unknown(camera_on: str, free: tuple[str, ...] = FIVE, sigma: float = 0.0) -> calib.measuring.Camera:
    return calib.measuring.Camera(camera_on, free=free, size=(1280, 1024), sigma=sigma)


def photographed(
    true: Scene,
    n: int,
    camera: calib.measuring.Camera,
    board: Board,
    rng: np.random.Generator | None = None,
    sigma: float = 0.0,
) -> calib.Measurements:
    return cameras.photographed(ROBOT, replace(true, places=PRINTED), n, camera, board, rng, sigma)


def hand_eye(*offsets: str) -> calib.ErrorModel:
    return calib.error_model(ROBOT, offsets=offsets or "none", tool="pose")


@pytest.mark.parametrize("shape", ["flat", "quadratic", "free"])
@pytest.mark.parametrize("camera_on", ["floor", "tip"])
def test_columns_match_central_differences(camera_on: str, shape: str) -> None:
    rng = np.random.default_rng(7)
    true = scene(rng, NOMINAL, camera_on)
    camera = replace(eye(camera_on), k4=0.2, k5=-0.1, k6=0.05, free=NAMES)
    data = photographed(true, 3, camera, Board(marks=BOARD, shape=shape))
    model = hand_eye(*INNER)
    start = Problem(model, (), initial_problem(model, [data]).reference, (data,))
    parameters = (*model.parameters(), *targets.unknowns([data], {}, Layout.of(ROBOT, start.reference)))
    problem = replace(start, parameters=parameters)
    sizes = np.array([1e-3 if p.unit == "m" else p.scale if p.kind == "instrument" else 0.02 for p in parameters])
    x = values_at(ROBOT, parameters, start.reference) + sizes * rng.uniform(-1.0, 1.0, len(parameters))
    jacobians.check(problem, x, 1e-6, least=10.0)


@pytest.mark.parametrize("camera_on", ["floor", "tip"])
def test_lens_and_board_are_recovered_with_zeros_and_hand_eye(camera_on: str) -> None:
    rng = np.random.default_rng(12)
    zeros = dict(zip(INNER, rng.normal(scale=0.01, size=4), strict=True))
    true = scene(rng, NOMINAL.with_errors(np.zeros((len(NOMINAL.joints), 6)), zeros), camera_on)
    data = photographed(true, 24, unknown(camera_on), Board(marks=BOARD, shape="quadratic"))
    fit = calib.identify(hand_eye(*INNER), data)
    assert fit.converged and not fit.null_space
    for name, zero in zeros.items():
        assert fit.value(f"{name}.offset") == pytest.approx(zero, abs=1e-7)
    for name, value in BENT.items():
        assert fit.value(f"lens.{name}") == pytest.approx(value, rel=1e-5, abs=1e-6), name
    assert fit.value("board.scale") == pytest.approx(SCALE, abs=1e-7)
    modes = ("bend_x", "bend_y", "twist", "aspect", "shear")
    np.testing.assert_allclose([fit.value(f"board.{name}") for name in modes], SHAPE, atol=1e-8)
    (held_out,) = residuals_of(
        fit, [photographed(true, 6, unknown(camera_on), Board(marks=BOARD, shape="quadratic"))], fit.machine
    )
    assert np.abs(held_out).max() < 1e-5


def test_a_wrong_lens_that_is_held_is_paid_for_by_the_arm_and_one_that_is_free_is_not() -> None:
    rng = np.random.default_rng(3)
    true = scene(rng, NOMINAL, "tip", sigma=0.2)
    wrong = replace(eye("tip", 0.2), fx=BENT["fx"] * 1.01, fy=BENT["fy"] * 1.01, k1=0.0)
    board = Board(marks=BOARD, shape="quadratic")
    held = calib.identify(hand_eye(*INNER), photographed(true, 20, wrong, board, rng, 0.2))
    freed = calib.identify(hand_eye(*INNER), photographed(true, 20, replace(wrong, free=FIVE), board, rng, 0.2))
    off = [max(abs(fit.value(f"{name}.offset")) for name in INNER) for fit in (held, freed)]
    assert off[0] > 5.0 * off[1]
    assert freed.value("lens.fx") == pytest.approx(BENT["fx"], rel=3e-3)


def test_errors_of_lens_and_scale_are_within_their_intervals() -> None:
    squares, names = [], ("lens.fx", "lens.fy", "lens.cx", "lens.cy", "board.scale", "tool.x", "tool.y", "tool.z")
    for seed in range(4):
        rng = np.random.default_rng(seed)
        true = scene(rng, NOMINAL, "tip")
        board = Board(marks=BOARD, shape="quadratic")
        fit = calib.identify(hand_eye(), photographed(true, 15, unknown("tip"), board, rng, 0.3))
        own = [[p.name for p in fit.parameters].index(name) for name in names]
        truth = [*(BENT[name.removeprefix("lens.")] for name in names[:4]), SCALE, *true.tool[:3, 3]]
        error = fit.values[own] - np.array(truth)
        squares.append(error @ np.linalg.solve(fit.covariance[np.ix_(own, own)], error))
    low, high = stats.chi2.ppf([0.001, 0.999], len(names) * len(squares))
    assert low < sum(squares) < high


def test_moving_the_board_and_permuting_rows_change_nothing() -> None:
    rng = np.random.default_rng(9)
    true = scene(rng, NOMINAL, "tip")
    board = Board(marks=BOARD, shape="quadratic")
    data = photographed(true, 12, unknown("tip"), board, rng, 0.2)
    moved = data.value + np.array([0.0, 0.0, 0.1, -0.2, 0.0])
    other = seen_by(
        replace(data, value=moved), data.camera, Board(marks=BOARD + np.array([0.1, -0.2, 0.0]), shape="quadratic")
    )
    order = rng.permutation(len(data))
    first, *others = (calib.identify(hand_eye(), some) for some in (data, other, data.subset(order)))
    for fit in others:
        for name in ("lens.fx", "lens.k1", "board.scale", "board.twist", "tool.x"):
            assert fit.value(name) == pytest.approx(first.value(name), rel=1e-5, abs=1e-8), name


def test_the_scale_is_told_by_the_arm_and_its_prior_stays_where_it_was_stated() -> None:
    """With all lengths of the arm free, nothing but the prior tells the scale: it is that of the prior."""
    rng = np.random.default_rng(2)
    true = scene(rng, NOMINAL, "tip")
    data = photographed(true, 30, eye("tip"), Board(marks=BOARD, shape="quadratic"), rng, 0.1)
    told = calib.identify(hand_eye(), data)
    assert told.value("board.scale") == pytest.approx(SCALE, abs=5e-4)
    untold = calib.identify(calib.error_model(ROBOT, placements="all", offsets="all", tool="pose"), data)
    scale = [p.name for p in untold.parameters].index("board.scale")
    assert np.sqrt(untold.covariance[scale, scale]) > 0.9 * 0.005
    known = calib.identify(untold.model, seen_by(data, eye("tip"), replace(data.board, scale_sigma=0.0)))
    assert (untold.rank, len(untold.parameters)) == (known.rank, len(known.parameters) + 1)


def test_known_sizes_leave_no_scale() -> None:
    true = scene(np.random.default_rng(2), NOMINAL, "tip")
    data = photographed(true, 3, eye("tip"), Board(scale_sigma=0.0))
    assert data.scalars == ()


def two(change: dict[str, object], board: Board | None = None) -> list[calib.Measurements]:
    true = scene(np.random.default_rng(2), NOMINAL, "tip")
    data = photographed(true, 6, replace(eye("tip"), free=FIVE), Board())
    return [data, seen_by(data, replace(data.camera, **change), board or Board())]


@pytest.mark.parametrize(
    ("sets", "says"),
    [
        (lambda: two({"fx": 900.0}), "the camera 'camera' is not the one of that name in"),
        (lambda: two({}, Board(scale_sigma=0.01)), "the board 'board' is not the one of that name in"),
        (
            lambda: [photographed(scene(np.random.default_rng(2), NOMINAL, "tip"), 2, unknown("tip"), Board())],
            "2 photographs of a board are too few to find it; needed are 3 with 4 marks each",
        ),
        (
            lambda: [
                photographed(
                    scene(np.random.default_rng(2), NOMINAL, "tip"), 2, eye("tip"), Board(marks=2 * BOARD, shape="free")
                )
            ],
            "no mark of the board 'board' is at 0, 30, 0 mm; the nearest is at 0, 0, 0 mm",
        ),
        (
            lambda: [
                photographed(scene(np.random.default_rng(2), NOMINAL, "tip"), 2, eye("tip"), Board(marks=2 * BOARD))
            ],
            "no mark of the board 'board' is at 0, 30, 0 mm; the nearest is at 0, 0, 0 mm",
        ),
    ],
)
def test_refusals(sets, says: str) -> None:
    with pytest.raises(MeasurementError, match=says):
        calib.identify(hand_eye(), sets())


def test_a_single_mark_does_not_tell_a_lens() -> None:
    true: Scene = scene(np.random.default_rng(2), NOMINAL, "tip", MARK)
    with pytest.raises(JobError, match="can only be found from photographs of boards, and these are of single marks"):
        seen_by(true.measure(ROBOT, true.draw(np.random.default_rng(1), 8)), unknown("tip"), None)


def test_a_stated_prior_counts_and_stays_about_what_was_given() -> None:
    """Few photographs: the lens is surer with a prior, a sharp one holds it, and another start moves nothing."""
    rng = np.random.default_rng(5)
    true = scene(rng, NOMINAL, "tip")
    off = replace(eye("tip"), free=NAMES[:9], fx=BENT["fx"] + 2.0, k1=BENT["k1"] + 0.01)
    data = photographed(true, 5, off, Board(), rng, 0.3)

    def found(lens_sigma: dict[str, float], known: dict[str, float] | None = None) -> dict[str, tuple[float, float]]:
        sets = with_found_lenses([seen_by(data, replace(off, lens_sigma=lens_sigma), data.board)], known)
        fit = calib.identify(hand_eye(), sets[0])
        return {p.name: (float(v), float(s)) for p, v, s in zip(fit.parameters, fit.values, fit.sigmas, strict=True)}

    free, stated = found({}), found({"fx": 2.0, "k1": 0.01})
    for name, sigma in (("lens.fx", 2.0), ("lens.k1", 0.01)):
        assert stated[name][1] < min(free[name][1], 1.05 * sigma)  # the rest is of the null space
        assert abs(stated[name][0] - BENT[name.removeprefix("lens.")]) < 4.0 * stated[name][1]
    held = found({"fx": 1e-3})
    assert held["lens.fx"][0] == pytest.approx(off.fx, abs=5e-3)
    started = {f"lens.{name}": value * 1.01 for name, value in BENT.items()}
    again = found({"fx": 2.0, "k1": 0.01}, started)
    for name in ("lens.fx", "lens.cy", "lens.k1", "board.scale", "tool.x"):
        value, sigma = stated[name]
        assert again[name][0] == pytest.approx(value, abs=1e-2 * sigma), name


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"lens_sigma": {"k1": 0.1}}, "lens_sigma: 'k1' is not a free number of the lens"),
        ({"lens_sigma": {"fx": 0.0}}, "lens_sigma of fx is 0 px; allowed is 0.0001 to 100000 px"),
        (
            {"lens_sigma": {"fx": 1.0}, "fx": None, "fy": None, "cx": None, "cy": None, "size": (64, 64)},
            "lens_sigma: 'fx' is expected near a given value",
        ),
    ],
)
def test_priors_that_mean_nothing_are_refused(change: dict[str, object], says: str) -> None:
    with pytest.raises(JobError, match=says):
        replace(eye("tip"), **({"free": ("fx", "fy", "cx", "cy")} | change))
