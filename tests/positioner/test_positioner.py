"""Two-axis positioners: the patent's closed form, the same engine for any number of points, and what is expected."""

from dataclasses import replace

import numpy as np
import pytest

import calib
from calib import positioner
from calib.foundations import rigid
from calib.identification.system import Problem
from calib.positioner.five_point import _circle_frame, _off_angles
from tests.support import positioners
from tests.support.machines import load
from tests.support.positioners import MARK, TWENTY, TWO_AXES, Array, Machine, five, place, turn

SIGNS = np.array([1.0, -1.0, 1.0, -1.0])


def points(rotary: tuple[float, float] = (60, 60), tilt: tuple[float, float] = (60, 60), mark: Array = MARK) -> Array:
    """P1 to P5 for the turns given in deg."""
    q = np.radians([(0, 0), (0, rotary[0]), (0, -rotary[1]), (tilt[0], 0), (-tilt[1], 0)])
    return TWO_AXES.see(q, mark)


def angles(*turns: float) -> list[float]:
    return list(np.radians(turns) * SIGNS)


def test_readings_of_axes_that_are_none_are_sentences() -> None:
    t = np.linspace(0.0, 3.0, 8)
    turn = positioner.circle_axis(np.c_[np.cos(t), np.sin(t), 0.0 * t])
    slide = positioner.line_axis(np.c_[t, 0.0 * t, 0.0 * t])
    found = positioner.five_point([1, 0, 0], [0.9, 0.1, 0.3], [0.9, -0.1, -0.3], [0.5, 0.8, 0], [0.5, -0.8, 0])
    for slip in (
        lambda: turn.motion(np.inf),
        lambda: slide.motion([0.0, np.nan]),
        lambda: found.motion(0.1, np.inf),
        lambda: found.points(["x"], 0.1, 0.1),
        lambda: found.points([0.1, 0.2], 0.1, 0.1),
        lambda: found.frames(0.1, 0.1, [0.1, 0.2, 0.3]),
        lambda: found.frames(0.1, 0.1, np.diag([2.0, 2.0, 2.0, 1.0])),
        lambda: found.motion([0.1, 0.2, 0.3], [0.1, 0.2]),
        lambda: found.points(np.eye(3), [], 0.1),
        lambda: positioner.expected_circle_error(-1.0, t, 1e-4),
        lambda: found.robot(["a", None]),
        lambda: found.robot(("a", "\ud800")),
    ):
        with pytest.raises(calib.CalibError):
            slip()
    with pytest.raises(calib.MeasurementError, match="must be finite numbers, in rad"):
        found.motion(0.1, np.inf)
    with pytest.raises(calib.MeasurementError, match="shapes that do not go together"):
        found.motion([0.1, 0.2, 0.3], [0.1, 0.2])


# ---- five points


@pytest.mark.parametrize("turns", [(30, 30), (60, 60), (90, 90), (120, 90)])
def test_five_points_are_exact(turns: tuple[float, float]) -> None:
    rng = np.random.default_rng(0)
    a, b = turns
    found = positioner.five_point(*points((a, a), (b, b)), angles=angles(a, a, b, b))
    s, q = positioners.envelope(rng, 200)
    zero, there = TWO_AXES.see(np.zeros((200, 2)), s), TWO_AXES.see(q, s)
    assert np.abs(found.points(zero, q[:, 0], q[:, 1]) - there).max() < 1e-12
    carried = TWO_AXES.table(q) @ np.linalg.inv(TWO_AXES.table(np.zeros((1, 2))))
    assert np.abs(found.motion(q[:, 0], q[:, 1]) - carried).max() < 1e-12
    W = TWO_AXES.table(np.zeros((1, 2)))[0]
    assert np.abs(found.frames(q[:, 0], q[:, 1], W) - TWO_AXES.table(q)).max() < 1e-12


def test_frames_are_those_of_the_patent() -> None:
    """As document 4 states them; origins and x axes are conventions, the z axes are the joints'."""
    P = points((60, 80), (70, 90))
    found = positioner.five_point(*P)
    T = np.eye(4)
    for frame, B in zip(TWO_AXES.frames, (found.B_L, found.B_R), strict=True):
        T = T @ frame
        assert np.abs(B[:3, 2] - T[:3, 2]).max() < 1e-12
        assert np.linalg.norm(np.cross(B[:3, 3] - T[:3, 3], T[:3, 2])) < 1e-12
        toward = P[0] - B[:3, 3]
        assert np.abs(B[:3, 0] - toward / np.linalg.norm(toward)).max() < 1e-12
        assert np.abs(np.cross(B[:3, 2], B[:3, 0]) - B[:3, 1]).max() < 1e-12
    assert np.array_equal(found.B_P, found.B_L)
    assert np.abs(found.B_L @ found.L_R - found.B_R).max() < 1e-14
    assert np.abs(found.frames(0.0, 0.0) - found.B_R).max() < 1e-14
    assert not found.findings


def test_five_points_are_the_circles_of_three() -> None:
    P = points((60, 80), (70, 90)) + np.random.default_rng(1).normal(scale=1e-3, size=(5, 3))
    found = positioner.five_point(*P)
    for B, rows in ((found.B_R, [0, 1, 2]), (found.B_L, [0, 3, 4])):
        axis = positioner.circle_axis(P[rows])
        assert np.abs(axis.direction - B[:3, 2]).max() < 1e-9
        assert np.linalg.norm(np.cross(axis.point - B[:3, 3], axis.direction)) < 1e-9


def test_machine_of_five_points_moves_its_points() -> None:
    rng = np.random.default_rng(2)
    robot = positioner.five_point(*points()).robot(("trunnion", "disc"))
    assert [reading.name for reading in robot.readings] == ["trunnion", "disc"]
    q = rng.uniform(-1.5, 1.5, (50, 2))
    carried = robot.tips(q) @ rigid.inverse(robot.tips(np.zeros((1, 2))))
    assert np.abs(carried - TWO_AXES.table(q) @ np.linalg.inv(TWO_AXES.table(np.zeros((1, 2))))).max() < 1e-12


@pytest.mark.parametrize(
    ("order", "given", "sentence"),
    [
        ([0, 2, 1, 3, 4], angles(60, 80, 70, 90), r"P2 and P3 are swapped: seen from P1 they are turned by 80 and 60"),
        ([0, 1, 2, 4, 3], angles(60, 80, 70, 90), r"P4 and P5 are swapped: seen from P1"),
        ([0, 1, 2, 3, 4], list(-np.array(angles(60, 80, 70, 90))), r"P2 and P3 are swapped: P2 has to be the positive"),
        ([0, 1, 2, 3, 4], np.radians([60, -80, -90, 70]).tolist(), r"P4 and P5 are swapped: P4 has to be the positive"),
        ([0, 1, 2, 3, 4], np.radians([60, 80, 70, -90]).tolist(), r"the second a negative one"),
        ([0, 1, 2, 3, 4], np.radians([200, -170, 70, -90]).tolist(), r"less than 360 deg"),
        ([0, 1, 2, 3, 4], angles(60, 60, 70, 90), r"turned by 60 and 80 deg, .* angles say 60 and 60: points or"),
    ],
)
def test_order_is_checked_against_angles(order: list[int], given: list[float], sentence: str) -> None:
    P = points((60, 80), (70, 90))
    assert not positioner.five_point(*P, angles=angles(60, 80, 70, 90)).findings
    with pytest.raises(calib.MeasurementError, match=sentence):
        positioner.five_point(*P[order], angles=given)


def test_a_point_that_was_touched_wrongly_within_a_degree_is_told() -> None:
    """Nothing else would: a circle goes through any three points. Its axis is millimetres off."""
    P, given = points((60, 60), (60, 60)), angles(60, 60, 60, 60)
    slipped = P.copy()
    slipped[1, :2] += [2e-3, 1e-3]
    wrong = [one for one in positioner.five_point(*slipped, angles=given).findings if one.code == "turn-off"]
    assert wrong and all("about the rotary axis, where its angle says 60: " in one.sentence for one in wrong)
    rng = np.random.default_rng(0)
    noisy = [positioner.five_point(*(P + rng.normal(scale=1e-4, size=P.shape)), angles=given) for _ in range(300)]
    assert not any(one.code == "turn-off" for found in noisy for one in found.findings)


def test_noise_of_turns_is_that_of_points() -> None:
    """Six standard deviations of the turn that scatters most are where a finding begins."""
    rng, turns, noise = np.random.default_rng(1), np.radians([90.0, 40.0]), 3e-4
    at = np.array([0.0, turns[0], -turns[1]])
    P = np.stack([np.cos(at), np.sin(at), np.zeros(3)], axis=1)
    seen = [_circle_frame(P + rng.normal(scale=noise, size=P.shape), "rotary")[1] for _ in range(4000)]
    scatter = float(np.std([one[0] for one in seen]))
    for times, count in ((5.7, 0), (6.3, 1)):
        told = (turns[0] + times * scatter, turns[1])
        assert len(list(_off_angles("rotary", ("P2", "P3"), told, (turns[0], -turns[1]), noise))) == count


def test_swapped_points_without_angles_turn_the_axis_over() -> None:
    """What the docstring says of the sense of z."""
    P = points()
    right, swapped = positioner.five_point(*P), positioner.five_point(*P[[0, 2, 1, 3, 4]])
    assert swapped.B_R[:3, 2] @ right.B_R[:3, 2] < -0.999
    assert np.linalg.norm(swapped.points(P[0], 0.0, 1.0) - right.points(P[0], 0.0, 1.0)) > 0.4


def test_doubtful_circles_are_told_with_the_expected_error() -> None:
    P = points((30, 70), (60, 60))
    (small,) = positioner.five_point(*P).findings
    expected = np.degrees(positioner.expected_circle_error(0.3, np.radians([0, 30, -70]), 1e-4))
    assert (small.severity, small.code) == ("warning", "small-turn")
    assert small.sentence == (
        "P2 is turned by only 30 deg about the rotary axis, and 60 or more are advised; "
        f"with 0.1 mm per coordinate its direction is expected to be {expected:.2g} deg off."
    )
    # Ten times as near, ten times as wrong.
    near = positioner.five_point(*points(mark=np.array([0.03, 0.0, 0.08]))).findings
    assert [finding.code for finding in near] == ["small-radius"]
    assert "only 30 mm from the rotary axis" in near[0].sentence
    wide, narrow = (positioner.expected_circle_error(r, np.radians([0, 60, -60]), 1e-4) for r in (0.3, 0.03))
    assert narrow == pytest.approx(10.0 * wide)
    assert f"{np.degrees(narrow):.2g} deg off" in near[0].sentence
    codes = [finding.code for finding in positioner.five_point(*points((10, 10), (175, 175))).findings]
    assert codes == ["small-turn", "almost-collinear", "almost-collinear"]


@pytest.mark.parametrize("short", [0.0, 0.0005, 0.003])
def test_a_mark_as_far_from_an_axis_as_advised_is_not_told(short: float) -> None:
    """Noise and rounded digits put it nearer: "only 100 mm from the rotary axis, and 100 or more are advised"."""
    for radius, angle in ((0.1 * (1.0 - short), 60.0), (0.3, 60.0 * (1.0 - 0.1 * short))):
        P = points((angle, angle), (angle, angle), mark=np.array([radius, 0.0, 0.15]))
        assert positioner.five_point(*P).findings == ()


def test_what_has_no_circle_is_refused() -> None:
    P = points()
    with pytest.raises(calib.IdentificationError, match="rotary axis lie on a line"):
        positioner.five_point(P[0], P[0] + 0.1, P[0] + 0.2, P[3], P[4])
    with pytest.raises(calib.IdentificationError, match="tilt axis lie on a line, or two"):
        positioner.five_point(P[0], P[1], P[2], P[3], P[3])
    with pytest.raises(calib.MeasurementError, match=r"P3: .* is not a point"):
        positioner.five_point(P[0], P[1], [1.0, np.nan, 0.0], P[3], P[4])
    with pytest.raises(calib.JobError, match="angles: there must be four"):
        positioner.five_point(*P, angles=[1.0])
    with pytest.raises(calib.JobError, match="sigma is -1 m"):
        positioner.five_point(*P, sigma=-1.0)


# ---- any number of points: the engine


def carried(machine: Machine, fit: calib.Fit, rng: np.random.Generator, n: int = 40) -> float:
    """Largest error in m of table points that the fit carries from zero to anywhere."""
    q = rng.uniform(-1.0, 1.0, (n, len(machine.names))) * np.where(np.array(list(machine.kinds)) == "r", 3.0, 1.0)
    s = rng.uniform(-0.5, 0.5, (n, 3))
    there = positioner.table_points(fit, machine.see(np.zeros_like(q), s), q)
    return float(np.abs(there - machine.see(q, s)).max())


@pytest.mark.parametrize("readings", [five(60, 60), TWENTY], ids=["five", "twenty"])
@pytest.mark.parametrize("start", ["near", "far", "five points"])
def test_least_squares_recovers_two_axes(start: str, readings: Array) -> None:
    """From a URDF a few mm off, from one 0.1 m and 6 deg off, and from five points touched with noise."""
    rng = np.random.default_rng(3)
    if start == "five points":
        robot = positioner.five_point(*(points() + rng.normal(scale=1e-3, size=(5, 3)))).robot()
    else:
        length, angle = {"near": (3e-3, 3e-3), "far": (0.1, 0.1)}[start]
        robot = load(positioners.nominal(TWO_AXES, rng, length, angle), "table")
    fit = calib.identify(positioner.axes_model(robot), TWO_AXES.touch(robot, readings, [MARK]))
    assert (fit.rank, fit.numerical_rank, fit.converged) == (11, 11, True)
    assert carried(TWO_AXES, fit, rng) < 1e-12


@pytest.mark.parametrize(
    ("kinds", "rank"), [("r", 4), ("p", 2), ("rr", 8), ("rp", 6), ("pr", 6), ("prr", 10), ("rrr", 12)]
)
def test_external_axes_in_general(kinds: str, rank: int) -> None:
    """Turntable, track, track and turntable, track and positioner, three axes; three marks each."""
    rng = np.random.default_rng(4)
    frames = tuple(place(turn(rng.normal(size=3)), rng.uniform(-0.6, 0.6, 3).tolist()) for _ in kinds)
    machine = Machine(frames, kinds, tuple(f"axis_{k}" for k in range(len(kinds))))
    marks = [np.array([0.3, 0.0, 0.1]), np.array([-0.2, 0.25, 0.05]), np.array([0.1, -0.3, 0.2])]
    q = rng.uniform(-1.5, 1.5, (12, len(kinds)))
    robot = load(positioners.nominal(machine, rng, 5e-3, 5e-3), "table")
    fit = calib.identify(positioner.axes_model(robot), machine.touch(robot, q, marks))
    assert (fit.rank, fit.numerical_rank) == (rank + 9, rank + 9)
    assert carried(machine, fit, rng) < 1e-12
    # And with no URDF: the sweeps give the machine to begin from.
    places = np.linspace(-1.2, 1.0, 5)
    sweeps = np.concatenate([np.outer(places, row) for row in np.eye(len(kinds))])
    data = machine.touch(robot, sweeps, marks, rng, 1e-4)
    found = positioner.circle_point_analysis(data, ["revolute" if kind == "r" else "prismatic" for kind in kinds])
    built = positioner.axes_robot(found, machine.names)
    again = calib.identify(positioner.axes_model(built), machine.touch(built, q, marks))
    assert carried(machine, again, rng) < 1e-12


def test_minimal_set_is_eleven_and_predicts_the_same() -> None:
    rng = np.random.default_rng(5)
    robot = load(positioners.nominal(TWO_AXES, rng, 3e-3, 3e-3), "table")
    data = TWO_AXES.touch(robot, TWENTY, [MARK], rng, 1e-4)
    near, minimal = (
        calib.identify(positioner.axes_model(robot), data, null_space=policy) for policy in ("nearest", "minimal")
    )
    assert len(minimal.parameters) == 11
    assert np.isfinite(minimal.sigmas).all()
    s, q = positioners.envelope(rng, 50)
    zero = TWO_AXES.see(np.zeros_like(q), s)
    assert np.abs(positioner.table_points(near, zero, q) - positioner.table_points(minimal, zero, q)).max() < 1e-9
    assert np.abs(
        positioner.table_error(near, zero, q).covariances - positioner.table_error(minimal, zero, q).covariances
    ).max() < 1e-12  # fmt: skip


def test_world_and_order_change_nothing() -> None:
    rng = np.random.default_rng(6)
    robot = load(positioners.nominal(TWO_AXES, rng, 3e-3, 3e-3), "table")
    data = TWO_AXES.touch(robot, TWENTY, [MARK, -MARK], rng, 1e-4)
    order = rng.permutation(len(data))
    T = place(turn([0.4, -1.0, 2.0]), [3.0, -1.0, 0.5])
    moved = Machine((T @ TWO_AXES.frames[0], TWO_AXES.frames[1]), "rr", TWO_AXES.names)
    there = moved.touch(robot, TWENTY, [MARK, -MARK])
    columns = {"tilt [rad]": data.readings[order, 0], "rotary [rad]": data.readings[order, 1],
               **{f"{a} [m]": (data.position[order] @ T[:3, :3].T + T[:3, 3])[:, k] for k, a in enumerate("xyz")},
               "tool": [data.tools[k] for k in data.tool[order]]}  # fmt: skip
    other = calib.read_measurements(columns, robot, sigma=1e-4)
    assert np.abs(other.position - there.position[order]).max() < 1e-3
    a, b = (calib.identify(positioner.axes_model(robot), d) for d in (data, other))
    s, q = positioners.envelope(rng, 30)
    zero = TWO_AXES.see(np.zeros_like(q), s)
    there_a = positioner.table_points(a, zero, q) @ T[:3, :3].T + T[:3, 3]
    assert np.abs(there_a - positioner.table_points(b, zero @ T[:3, :3].T + T[:3, 3], q)).max() < 1e-10
    errors = [positioner.table_error(fit, x, q) for fit, x in ((a, zero), (b, zero @ T[:3, :3].T + T[:3, 3]))]
    assert errors[0].rms == pytest.approx(errors[1].rms, rel=1e-6)


def test_table_error_holds_in_simulation() -> None:
    """95 % intervals of predicted table coordinates, and their rms, pooled over 120 touched sets of 20 poses."""
    rng = np.random.default_rng(7)
    robot = load(positioners.nominal(TWO_AXES), "table")
    inside, squares, expected = [], [], []
    for _ in range(120):
        data = TWO_AXES.touch(robot, TWENTY, [MARK], rng, 1e-4)
        fit = calib.identify(positioner.axes_model(robot), data)
        s, q = positioners.envelope(rng, 20)
        zero = TWO_AXES.see(np.zeros_like(q), s)
        told = positioner.table_error(fit, zero, q)
        error = positioner.table_points(fit, zero, q) - TWO_AXES.see(q, s)
        sigmas = np.sqrt(np.diagonal(told.covariances, axis1=1, axis2=2))
        inside.append(np.abs(error) < 1.96 * sigmas)
        squares.append(np.mean(np.sum(error**2, axis=1)))
        expected.append(told.rms**2)
    assert 0.93 < np.mean(inside) < 0.97
    # Somewhat too much is told, as the estimated model part of the noise is never negative.
    assert np.sqrt(np.mean(squares)) == pytest.approx(np.sqrt(np.mean(expected)), rel=0.1)


def test_table_error_is_the_derivative() -> None:
    """Its covariance against finite differences of the predicted points, far from the nominal machine."""
    rng = np.random.default_rng(8)
    robot = load(positioners.nominal(TWO_AXES, rng, 0.05, 0.05), "table")
    fit = calib.identify(
        positioner.axes_model(robot), TWO_AXES.touch(robot, TWENTY, [MARK], rng, 1e-3), null_space="minimal"
    )
    s, q = positioners.envelope(rng, 5)
    zero = TWO_AXES.see(np.zeros_like(q), s)
    told = positioner.table_error(fit, zero, q)
    problem = Problem(fit.model, fit.parameters, fit.machine.frames, fit.measurements, fit.machine.deviations)
    # About a reference at the solution the angles are zero; positions and deviations stay.
    x = np.where([p.name in ("base.rx", "base.ry", "base.rz") for p in fit.parameters], 0.0, fit.values)
    again = replace(fit, machine=problem.machine(x))
    columns = []
    for k in range(len(x)):
        sides = []
        for h in (1e-6, -1e-6):
            moved = x.copy()
            moved[k] += h
            sides.append(positioner.table_points(replace(fit, machine=problem.machine(moved)), zero, q))
        columns.append((sides[0] - sides[1]) / 2e-6)
    J = np.stack(columns, axis=-1)
    expected = J @ fit.covariance @ np.swapaxes(J, -1, -2)
    np.testing.assert_allclose(positioner.table_error(again, zero, q).covariances, expected, rtol=1e-6, atol=1e-14)
    assert told.largest >= told.rms > 0.0


def test_what_the_points_hardly_see_is_told() -> None:
    """A mark 30 mm from the axis, +-30 deg: the axis' direction is not known to 10 mrad, and stays as designed."""
    rng = np.random.default_rng(9)
    robot = load(positioners.nominal(TWO_AXES), "table")
    near = np.array([0.03, 0.0, 0.08])
    held = []
    for mark in (MARK, near):
        fit = calib.identify(positioner.axes_model(robot), TWO_AXES.touch(robot, five(30, 30), [mark], rng, 1e-4))
        held.append(positioner.table_error(fit, MARK, TWENTY).held)
    assert held == [0, 1]


def test_bad_points_and_angles_are_refused() -> None:
    robot = load(positioners.nominal(TWO_AXES), "table")
    fit = calib.identify(positioner.axes_model(robot), TWO_AXES.touch(robot, TWENTY, [MARK]))
    with pytest.raises(calib.MeasurementError, match=r"angles: must be finite numbers \(N, 2\), of tilt, rotary"):
        positioner.table_error(fit, MARK, np.zeros((3, 3)))
    with pytest.raises(calib.MeasurementError, match=r"points: must be finite numbers \(3,\) or \(3, 3\)"):
        positioner.table_points(fit, np.zeros((2, 3)), np.zeros((3, 2)))
    with pytest.raises(calib.JobError, match="2 axes and 1 names"):
        positioner.axes_robot([positioner.line_axis([[0, 0, 0], [1, 0, 0]], sigma=1e-3)] * 2, ["one"])
