"""Closed loops: against plain trigonometry, along both chains, and every derivative against finite differences."""

import tracemalloc
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import calib
from calib.foundations.errors import OutputError, PoseError, RobotError
from calib.identification.machine import Frames
from calib.identification.system import Problem
from calib.machine import urdf
from calib.machine.model_file import model_json
from calib.machine.of_fit import machine_of
from calib.machine.urdf import calibrated_urdf
from calib.robot.load import load_robot, with_document
from calib.robot.loops import LoopsTogether, at_dead_centre
from calib.robot.robot import ClosedLoop, Coupling, Deviations, Robot, TipModel
from calib.robot.sampling import closing, least_determinant, random_readings
from calib.robot.urdf import parse_urdf
from tests.support import jacobians, machines
from tests.support.loops import four_bar_urdf, mimic, tree

Array = np.ndarray

CASE = Path(__file__).resolve().parents[2] / "robots" / "irb2400"


def load(text: str, tip: str, *loops: ClosedLoop, couplings: Sequence[Coupling] = ()) -> Robot:
    return load_robot(parse_urdf(text.encode(), "loop.urdf"), tip, couplings=couplings, loops=loops)


PARALLELOGRAM = ClosedLoop("parallelogram", ("rod_end", "pin"), ("x", "z"), ("elbow", "rod"))

FIVE_BAR = tree(
    ("base", "left", "revolute", "0 0 0.1", "0 0 1"),
    ("left", "left_distal", "revolute", "0.2 0 0", "0 0 1"),
    ("left_distal", "tip", "fixed", "0.3 0 0", "0 0 0"),
    ("base", "right", "revolute", "0.25 0 0.1", "0 0 1"),
    ("right", "right_distal", "revolute", "0.21 0 0.01", "0 0 1"),
    ("right_distal", "right_end", "fixed", "0.29 0 0", "0 0 0"),
)
# No encoder turns the distal links; where the search starts, the drivers say.
PANTOGRAPH = ClosedLoop("pantograph", ("tip", "right_end"), ("x", "y"), ("left_distal", "right_distal"))
ELBOWS = (Coupling("left_distal", {"left": -1.0}, 0.9), Coupling("right_distal", {"right": -1.0}, 2.3))

SLIDER_CRANK = tree(
    ("base", "crank", "revolute", "0.02 0 0.05", "0 0 1"),
    ("crank", "rod", "revolute", "0.1 0 0", "0 0 1", mimic("crank", -1.0)),
    ("rod", "rod_end", "fixed", "0.35 0 0", "0 0 0"),
    ("base", "slider", "prismatic", "0.4 0.03 0.05", "1 0 0"),
    ("slider", "tip", "fixed", "0.05 0.01 0.02", "0 0 0"),
)
CROSSHEAD = ClosedLoop("crosshead", ("slider", "rod_end"), ("x", "y"), ("rod", "slider"))

# A parallelogram whose forearm's crank drives a slider-crank on top: one loop carries the other.
TWO_LOOPS = four_bar_urdf(out=0.08).replace(
    "</robot>",
    tree(
        ("elbow", "arm_2", "revolute", "0.1 0.05 0", "0 1 0", mimic("roll", 0.5)),
        ("arm_2", "rod_2", "revolute", "0.06 0.01 0", "0 1 0", mimic("roll", -0.5)),
        ("rod_2", "end_2", "fixed", "0.25 0 0", "0 0 0"),
        ("elbow", "slide_2", "prismatic", "0.42 0 0.02", "1 0 0"),
    ).removeprefix('<robot name="loops"><link name="elbow"/>'),
)
SECOND = ClosedLoop("second", ("slide_2", "end_2"), ("x", "z"), ("rod_2", "slide_2"))

# A strut from the lower arm to what the parallelogram turns: these two move each other.
THREE_LOOPS = TWO_LOOPS.replace(
    "</robot>",
    tree(
        ("lower", "strut_pin", "revolute", "0.1 0 0.3", "0 1 0"),
        ("strut_pin", "strut", "prismatic", "0 0 0.4", "0 0 1"),
        ("elbow", "hook", "fixed", "0.2 0 0", "0 0 0"),
    )
    .removeprefix('<robot name="loops"><link name="lower"/>')
    .replace('<link name="elbow"/>', ""),
)
STRUT = ClosedLoop("strut", ("hook", "strut"), ("x", "z"), ("strut_pin", "strut"))


def machine(name: str) -> tuple[Robot, Array]:
    """A machine with loops, and ten rows of its readings, well off the dead centres."""
    rng = np.random.default_rng(11)
    if name in ("parallelogram", "out of plane", "two loops", "three loops"):
        if name == "two loops":
            robot = load(TWO_LOOPS, "slide_2", PARALLELOGRAM, SECOND)
        elif name == "three loops":
            robot = load(THREE_LOOPS, "slide_2", STRUT, SECOND, PARALLELOGRAM)
        else:
            robot = load(four_bar_urdf(out=0.08 if name == "out of plane" else 0.0), "tip", PARALLELOGRAM)
        readings = rng.uniform(-1.0, 1.0, (10, len(robot.readings)))
        names = [reading.name for reading in robot.readings]
        readings[:, names.index("crank")] = readings[:, names.index("lower")] + rng.uniform(-0.7, 0.7, 10)
        return robot, readings
    if name == "five-bar":
        drivers = rng.uniform([1.6, 0.7], [2.4, 1.5], (10, 2))
        return load(FIVE_BAR, "tip", PANTOGRAPH, couplings=ELBOWS), drivers
    assert name == "slider-crank"
    return load(SLIDER_CRANK, "tip", CROSSHEAD), rng.uniform(-3.0, 3.0, (10, 1))


MACHINES = ("parallelogram", "out of plane", "five-bar", "slider-crank", "two loops", "three loops")


def deviations(robot: Robot, length: float, angle: float, seed: int = 5) -> Deviations:
    """Random deviations of every joint, also passive and fixed ones, and offsets of those that are read or coupled."""
    rng = np.random.default_rng(seed)
    placements = rng.uniform(-1.0, 1.0, (len(robot.chain), 6)) * np.repeat((length, angle), 3)
    offsets = rng.uniform(-angle, angle, len(robot.moving))
    offsets[list(robot.passive)] = 0.0
    return Deviations(placements, offsets)


def link(robot: Robot, name: str, readings: Array, d: Deviations | None = None) -> Array:
    """A link's placements (N, 4, 4), walked joint by joint at the closed positions, without calib's kinematics."""
    q = robot.joint_positions(readings, d)
    d = d or robot.no_deviations()
    path, at = [], name
    while (joint := robot.urdf.parent_joint(at)) is not None:
        path.append(joint)
        at = joint.parent
    T = np.broadcast_to(np.eye(4), (len(q), 4, 4))
    for joint in reversed(path):
        i = next(i for i, own in enumerate(robot.chain) if own.name == joint.name)
        own, e = robot.chain[i], d.placements[i]
        E = machines.pose(e[:3], Rotation.from_euler("XYZ", e[3:]).as_rotvec())
        T = T @ joint.origin @ own.frame @ E @ np.linalg.inv(own.frame)
        if own.type != "fixed":
            travel = q[:, robot.moving.index(i), None] * joint.axis
            T = T @ (machines.pose(travel) if own.type == "prismatic" else machines.pose(rotvec=travel))
    return T


def positions(robot: Robot, readings: Array) -> dict[str, Array]:
    q = robot.joint_positions(readings)
    return {robot.chain[i].name: q[:, j] for j, i in enumerate(robot.moving)}


# ---- against trigonometry


def joint_range() -> Array:
    """Readings turret, lower, crank, roll, tip over the joint range, alpha 30..150 deg."""
    lower = np.radians(np.linspace(-100, 110, 22))[:, None]
    crank = lower + np.radians(np.linspace(-60, 60, 25))
    zero = np.zeros(crank.size)
    return np.stack([zero + 0.4, np.broadcast_to(lower, crank.shape).ravel(), crank.ravel(), zero, zero], axis=1)


WRONG = [
    {},
    {"L2": 0.7021, "b": 0.1789, "c": 0.6987, "e": 0.1813},
    {"L2": 0.69, "b": 0.185, "c": 0.7, "e": 0.178},
    {"L2": 0.72, "b": 0.17, "c": 0.7, "e": 0.19},
]


@pytest.mark.parametrize("lengths", WRONG)
def test_a_four_bar_of_any_lengths_is_that_of_the_closed_formula(lengths: dict[str, float]) -> None:
    robot, readings = load(four_bar_urdf(**lengths), "tip", PARALLELOGRAM), joint_range()
    L2, b, c, e = ({"L2": 0.7, "b": 0.18, "c": 0.7, "e": 0.18} | lengths).values()
    assert [reading.name for reading in robot.readings] == ["turret", "lower", "crank", "roll", "tip"]
    # Angles from x to z, so that a turn about y counts down.
    phi2, psi = 0.5 * np.pi - readings[:, 1], np.pi - readings[:, 2]
    D = b * np.stack([np.cos(psi), np.sin(psi)]) - L2 * np.stack([np.cos(phi2), np.sin(phi2)])
    s = np.hypot(*D)
    phi = np.arctan2(D[1], D[0]) - np.sign(np.sin(psi - phi2)) * np.arccos((s**2 + e**2 - c**2) / (2 * e * s))
    q = positions(robot, readings)
    found = np.pi - (q["lower"] + q["cancel"] + q["elbow"])
    assert np.abs(np.exp(1j * found) - np.exp(1j * phi)).max() < 1e-12
    gamma = np.arctan2(e * np.sin(phi) - D[1], e * np.cos(phi) - D[0])
    found = 0.5 * np.pi - (q["crank"] + q["rod_cancel"] + q["rod"])
    assert np.abs(np.exp(1j * found) - np.exp(1j * gamma)).max() < 1e-12


@pytest.mark.parametrize("lengths", WRONG)
def test_both_chains_of_the_four_bar_lead_to_the_same_pin(lengths: dict[str, float]) -> None:
    """The document's 1-2'-3'-4'-3, through crank and rod, and 1-2-3, through the lower arm."""
    robot, readings = load(four_bar_urdf(**lengths), "tip", PARALLELOGRAM), joint_range()
    through_rod, through_arm = (link(robot, name, readings)[:, :3, 3] for name in ("rod_end", "pin"))
    assert np.abs(through_rod - through_arm).max() < 1e-13


def test_an_ideal_parallelogram_is_the_same_with_and_without_its_loop() -> None:
    readings = joint_range()
    for text, tip in ((four_bar_urdf(), "tip"), (four_bar_urdf(out=0.08), "tip")):
        loop, serial = load(text, tip, PARALLELOGRAM), load(text, tip)
        assert loop.readings == serial.readings
        np.testing.assert_allclose(loop.tips(readings), serial.tips(readings), atol=1e-13)


def test_a_five_bar_is_where_two_circles_meet() -> None:
    robot, readings = machine("five-bar")
    assert [reading.name for reading in robot.readings] == ["left", "right"]
    left, right = readings.T
    A = np.stack([0.2 * np.cos(left), 0.2 * np.sin(left)], axis=1)
    B = np.stack([0.25 + 0.21 * np.cos(right), 0.21 * np.sin(right)], axis=1)
    s = np.linalg.norm(B - A, axis=1)
    along = (0.3**2 - 0.29**2 + s**2) / (2 * s)
    e = (B - A) / s[:, None]
    meet = A + along[:, None] * e + np.sqrt(0.3**2 - along**2)[:, None] * np.stack([-e[:, 1], e[:, 0]], axis=1)
    tips = robot.tips(readings)
    np.testing.assert_allclose(tips[:, :2, 3], meet, atol=1e-13)
    np.testing.assert_allclose(tips[:, 2, 3], 0.1, atol=1e-15)


def test_a_slider_crank_slides_as_far_as_its_rod_pushes() -> None:
    robot, readings = machine("slider-crank")
    assert [reading.name for reading in robot.readings] == ["crank"]
    turn = readings[:, 0]
    x = 0.02 + 0.1 * np.cos(turn) + np.sqrt(0.35**2 - (0.1 * np.sin(turn) - 0.03) ** 2)
    expected = np.stack([x + 0.05, np.full(10, 0.04), np.full(10, 0.07)], axis=1)
    np.testing.assert_allclose(robot.tips(readings)[:, :3, 3], expected, atol=1e-13)


# ---- any loop, badly made


@pytest.mark.parametrize("size", [1e-3, 20e-3])
@pytest.mark.parametrize("name", MACHINES)
def test_loops_close_in_their_directions_whatever_the_deviations(name: str, size: float) -> None:
    robot, readings = machine(name)
    d = deviations(robot, size, size)
    left_open = 0.0
    for loop in robot.closed_loops:
        a, b = (link(robot, frame, readings, d) for frame in loop.frames)
        gap = np.einsum("nij,ni->nj", a[:, :3, :3], b[:, :3, 3] - a[:, :3, 3])
        assert np.abs(gap[:, ["xyz".index(axis) for axis in loop.closes]]).max() < 1e-13
        left_open = max(left_open, np.abs(gap).max())
    if name in ("out of plane", "two loops"):
        assert left_open > 0.05
    np.testing.assert_allclose(robot.tips(readings, d), link(robot, robot.tip, readings, d), atol=1e-13)


@pytest.mark.parametrize("size", [1e-3, 20e-3])
@pytest.mark.parametrize("name", MACHINES)
def test_every_column_of_the_motion_is_that_of_central_differences(name: str, size: float) -> None:
    robot, readings = machine(name)
    d = deviations(robot, size, size)
    motion = robot.motion(readings, d)
    np.testing.assert_allclose(motion.placement, robot.tips(readings, d), atol=1e-14)
    columns = motion.by_deviations
    state = np.concatenate([d.placements.ravel(), d.offsets])
    inverse, h = np.linalg.inv(motion.placement), 1e-5
    passive = [6 * len(robot.chain) + j for j in robot.passive]
    for k in range(len(state)):

        def tips(by: float, k: int = k) -> Array:
            x = state.copy()
            x[k] += by
            return robot.tips(readings, Deviations(x[: d.placements.size].reshape(-1, 6), x[d.placements.size :]))

        twist = inverse @ (tips(h) - tips(-h)) / (2 * h)
        numeric = np.stack([*twist[:, :3, 3].T, twist[:, 2, 1], twist[:, 0, 2], twist[:, 1, 0]], axis=1)
        if k in passive:
            numeric[:] = 0.0  # an offset of a passive joint moves where the search starts, and nothing else
        np.testing.assert_allclose(columns[:, :, k], numeric, atol=1e-7 * max(1.0, np.abs(numeric).max()))


@pytest.mark.parametrize("observes", ["position", "pose"])
@pytest.mark.parametrize("name", MACHINES)
def test_the_jacobian_of_a_machine_with_loops_is_that_of_central_differences(name: str, observes: str) -> None:
    robot, readings = machine(name)
    rng = np.random.default_rng(3)
    model = calib.error_model(robot, offsets="all", placements=["*"], tool="pose")
    parameters = model.parameters()
    x = rng.uniform(-5e-3, 5e-3, len(parameters))
    reference = Frames(machines.anywhere(rng)[None], machines.anywhere(rng, 0.3)[None])
    prismatic = {r.name for r in robot.readings if r.dimension == "length"}
    columns: dict[str, object] = {
        f"{r.name} [{'m' if r.name in prismatic else 'rad'}]": readings[:, k] for k, r in enumerate(robot.readings)
    }
    columns |= {f"{axis} [m]": rng.uniform(-1, 1, len(readings)) for axis in "xyz"}
    if observes == "pose":
        # Near the tool, where the logarithm is smooth.
        at = Problem(model, parameters, reference, ()).machine(x)
        R = (at.frames.base @ robot.tips(readings, at.deviations) @ at.frames.tools[0])[:, :3, :3]
        turned = Rotation.from_matrix(R) * Rotation.from_rotvec(rng.uniform(-0.5, 0.5, (len(readings), 3)))
        qx, qy, qz, qw = turned.as_quat().T
        columns |= {"qw": qw, "qx": qx, "qy": qy, "qz": qz}
    data = calib.read_measurements(columns, robot, observes, sigma=(1e-3, 1e-3 if observes == "pose" else None))
    found = Problem(model, parameters, reference, (data,))
    jacobians.check(found, x, least=1e-2)


@pytest.mark.parametrize("name", MACHINES)
def test_a_passive_joint_has_no_offset_but_its_driver_has(name: str) -> None:
    robot, _ = machine(name)
    names = {parameter.name for parameter in calib.error_model(robot, offsets="all").parameters()}
    passive = {robot.chain[robot.moving[j]].name for j in robot.passive}
    assert passive == {joint for loop in robot.closed_loops for joint in loop.passive}
    moving = {robot.chain[i].name for i in robot.moving}
    assert {n for n in names if n.endswith(".offset")} == {f"{joint}.offset" for joint in moving - passive}
    with pytest.raises(calib.JobError, match="matches no joint of the arm"):
        calib.error_model(robot, offsets=[next(iter(passive))])


def test_the_offset_of_a_passive_joint_moves_nothing() -> None:
    robot, readings = machine("out of plane")
    d = deviations(robot, 5e-3, 5e-3)
    offsets = d.offsets.copy()
    offsets[list(robot.passive)] = 0.02
    np.testing.assert_allclose(
        robot.tips(readings, Deviations(d.placements, offsets)), robot.tips(readings, d), atol=1e-13
    )


def test_no_rows_are_no_trouble() -> None:
    robot, _ = machine("two loops")
    none = np.empty((0, len(robot.readings)))
    assert robot.tips(none).shape == (0, 4, 4)
    assert robot.motion(none).rates.shape == (0, 4, 6 * len(robot.chain) + len(robot.moving))


# ---- couplings


def test_a_coupling_with_two_drivers_is_the_counter_rotating_link() -> None:
    direct = tree(
        ("base", "lower", "revolute", "0.1 0 0.2", "0 1 0"),
        ("lower", "elbow", "revolute", "0 0 0.7", "0 1 0"),
        ("elbow", "tip", "revolute", "0.5 0 0.1", "1 0 0"),
        ("base", "crank", "revolute", "0.1 0 0.2", "0 1 0"),
    )
    linked = tree(
        ("base", "lower", "revolute", "0.1 0 0.2", "0 1 0"),
        ("lower", "cancel", "revolute", "0 0 0.7", "0 1 0", mimic("lower", -1.0)),
        ("cancel", "elbow", "revolute", "0 0 0", "0 1 0", mimic("crank", 1.0)),
        ("elbow", "tip", "revolute", "0.5 0 0.1", "1 0 0"),
        ("base", "crank", "revolute", "0.1 0 0.2", "0 1 0"),
    )
    a = load(direct, "tip", couplings=[Coupling("elbow", {"lower": -1.0, "crank": 1.0}, 0.2)])
    b = load(linked, "tip")
    assert [reading.name for reading in a.readings] == [reading.name for reading in b.readings]
    readings = np.random.default_rng(0).uniform(-2, 2, (20, 3))
    shifted = readings + np.array([0.0, 0.2, 0.0])
    np.testing.assert_allclose(a.tips(readings), b.tips(shifted), atol=1e-14)
    # The offset of the lower arm, which is on the arm, moves the elbow too.
    offsets = [0.03, 0.0, 0.01]
    np.testing.assert_allclose(
        a.tips(readings, Deviations(np.zeros((3, 6)), np.array(offsets))),
        b.tips(shifted, Deviations(np.zeros((4, 6)), np.array([0.03, 0.0, 0.0, 0.01]))),
        atol=1e-14,
    )


@pytest.mark.parametrize(
    ("couplings", "sentence"),
    [
        (
            [Coupling("nowhere", {"lower": 1.0})],
            "loop.urdf: coupling of 'nowhere', which is not a moving joint of the arm.",
        ),
        (
            [Coupling("roll", {"cancel": 1.0}), Coupling("cancel", {"roll": 1.0})],
            "loop.urdf: the couplings of joint 'cancel' run in a circle.",
        ),
        (
            [Coupling("roll", {"roll": 1.0, "cancel": 1.0})],
            "loop.urdf:1: the coupling of joint 'roll' has 'roll' itself among its drivers; put one more joint where "
            "it is into the URDF, which follows the others, and leave it its own reading.",
        ),
        (
            [Coupling("roll", {"lower": 1.0}), Coupling("roll", {"crank": 1.0})],
            "loop.urdf: joint 'roll' has two couplings; write one with the drivers of both, or leave one out.",
        ),
    ],
)
def test_wrong_couplings_are_refused(couplings: list[Coupling], sentence: str) -> None:
    with pytest.raises(RobotError) as caught:
        load(four_bar_urdf(), "tip", PARALLELOGRAM, couplings=couplings)
    assert str(caught.value) == sentence


# ---- what is refused


def test_a_joint_is_passive_in_one_loop_alone() -> None:
    again = ClosedLoop("again", ("rod_end", "pin"), ("x", "z"), ("elbow", "rod"))
    with pytest.raises(RobotError) as caught:
        load(four_bar_urdf(), "tip", PARALLELOGRAM, again)
    assert str(caught.value) == (
        "loop.urdf: loops 'parallelogram' and 'again' have one passive joint, 'elbow', which only one of them can "
        "determine."
    )


@pytest.mark.parametrize(
    ("loop", "sentence"),
    [
        (
            ClosedLoop("p", ("rod_end", "nut"), ("x", "z"), ("elbow", "rod")),
            "loop.urdf: loop 'p': 'nut' is not a link of the URDF; its links are base, turret, lower, cancel, elbow, "
            "pin, crank, rod_cancel, rod, rod_end, roll, tip.",
        ),
        (
            ClosedLoop("p", ("rod_end", "pin"), ("x", "z"), ("elbow", "pin")),
            "loop.urdf: loop 'p': passive joint 'pin' is not one of the moving joints turret, lower, cancel, elbow, "
            "roll, tip, crank, rod_cancel, rod.",
        ),
        (
            ClosedLoop("p", ("rod_end", "pin"), ("x", "y", "z"), ("elbow", "rod")),
            "loop.urdf: loop 'p': closes has 3 directions and passive has 2 joints; both need the same number.",
        ),
    ],
)
def test_wrong_declarations_are_refused_in_a_sentence(loop: ClosedLoop, sentence: str) -> None:
    with pytest.raises(RobotError) as caught:
        load(four_bar_urdf(), "tip", loop)
    assert str(caught.value) == sentence


def refused(robot: Robot, readings: Array) -> PoseError:
    with pytest.raises(PoseError) as caught:
        robot.tips(readings)
    return caught.value


def test_a_dead_centre_names_its_row() -> None:
    robot = load(four_bar_urdf(), "tip", PARALLELOGRAM)
    readings = np.zeros((4, 5))
    readings[2, 2] = readings[3, 2] = 0.5 * np.pi  # crank and lower arm in line
    error = refused(robot, readings)
    assert str(error) == "row 2: loop 'parallelogram' is at a dead centre: its joints may go two ways."
    assert (error.row, error.reason) == (
        2,
        "loop 'parallelogram' is at a dead centre: its joints may go two ways",
    )


@pytest.mark.parametrize("k", [1, 2, 3, 5])
def test_a_dead_centre_is_where_a_singular_value_is_small(k: int) -> None:
    # The smallest one on both sides of the limit, the others of any size.
    chance = np.random.default_rng(k)
    values = 10.0 ** chance.uniform(-3.0, 2.0, (2000, k))
    values[:, -1] = 1e-6 * 10.0 ** chance.uniform(-2.0, 2.0, len(values))
    values[::50, -1] = 0.0
    left, right = (np.linalg.qr(chance.normal(size=(len(values), k, k)))[0] for _ in range(2))
    slope = (left * values[:, None]) @ right
    smallest = np.linalg.svd(slope, compute_uv=False)[:, -1]
    assert 500 < np.count_nonzero(smallest < 1e-6) < 1500
    assert np.array_equal(at_dead_centre(slope), smallest < 1e-6)
    assert not at_dead_centre(slope[smallest > 1e-6]).any()


def test_links_that_do_not_reach_name_their_row() -> None:
    robot = load(four_bar_urdf(c=0.72), "tip", PARALLELOGRAM)
    readings = np.zeros((3, 5))
    readings[1:, 2] = 1.5  # 0.525 m from the elbow to the crank's end; the rod needs 0.54
    error = refused(robot, readings)
    assert str(error) == "row 1: loop 'parallelogram' cannot close: its links do not reach."
    assert error.row == 1


def test_a_slider_that_its_rod_cannot_reach_names_its_row() -> None:
    text = SLIDER_CRANK.replace('xyz="0.4 0.03 0.05"', 'xyz="0.4 -0.3 0.05"')
    robot = load(text, "tip", CROSSHEAD)
    assert str(refused(robot, np.array([[0.0], [-0.3], [1.4]]))) == (
        "row 2: loop 'crosshead' cannot close: its links do not reach, or its passive joints are far from where their "
        "<mimic>, or zero, is."
    )


@pytest.mark.parametrize(
    ("name", "together", "named"),
    [("two loops", [1, 1], "'parallelogram'"), ("three loops", [2, 1], "'strut', 'parallelogram'")],
)
def test_loops_that_move_each_other_are_named_together(name: str, together: list[int], named: str) -> None:
    robot, readings = machine(name)
    assert robot.loops_together == together
    names = [reading.name for reading in robot.readings]
    readings[4, names.index("crank")] = readings[4, names.index("lower")] + 0.5 * np.pi
    assert str(refused(robot, readings)).startswith(f"row 4: loop {named} is at a dead centre")


def test_what_loops_take_grows_with_their_number() -> None:
    """Fifty struts on an arm, solved at once, took 20 GB at 500 rows."""
    n = 12
    joints = [("base", "lower", "revolute", "0 0 0.3", "0 1 0"), ("lower", "upper", "revolute", "0 0 0.7", "0 1 0")]
    for k in range(n):
        joints += [
            ("lower", f"pin{k}", "revolute", f"0.2 {k / 100} 0.3", "0 1 0"),
            (f"pin{k}", f"strut{k}", "prismatic", "0 0 0.4", "0 0 1"),
            ("upper", f"hook{k}", "fixed", f"0.2 {k / 100} 0.05", "0 0 1"),
        ]
    loops = [ClosedLoop(f"s{k}", (f"hook{k}", f"strut{k}"), ("x", "z"), (f"pin{k}", f"strut{k}")) for k in range(n)]
    readings = np.random.default_rng(2).uniform(-0.5, 0.5, (300, 2))

    def most(count: int) -> int:
        model = TipModel(load(tree(*joints), "upper", *loops[:count]))
        tracemalloc.start()
        model.motion(readings)
        found = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return found

    # Twice as many loops have twice as many passive joints, each of which follows twice as many deviations.
    assert most(12) < 5.0 * most(6)


@pytest.mark.parametrize("name", ["parallelogram", "five-bar", "slider-crank"])
def test_where_all_machines_close_is_what_single_rows_say(name: str) -> None:
    robot, _ = machine(name)
    if name == "slider-crank":
        robot = load(SLIDER_CRANK.replace('xyz="0.4 0.03 0.05"', 'xyz="0.4 -0.3 0.05"'), "tip", CROSSHEAD)
    readings = np.random.default_rng(3).uniform(-3.0, 3.0, (60, len(robot.readings)))
    readings[:5] = 0.0
    both = (None, deviations(robot, 2e-2, 2e-2))

    def closes(row: Array) -> bool:
        try:
            for d in both:
                robot.tips(row[None], d)
        except PoseError:
            return False
        return True

    expected = [closes(row) for row in readings]
    assert closing(robot, readings, both).tolist() == expected
    assert 0 < sum(expected) < 60
    assert closing(robot, readings[:0], both).shape == (0,)


class Counted:
    """Counts the steps of Newton's method, and how many rows they move."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.steps = self.rows = 0
        solve = np.linalg.solve

        def counting(*arguments: Array) -> Array:
            self.steps += 1
            self.rows += len(arguments[0])
            return np.asarray(solve(*arguments))

        monkeypatch.setattr("calib.robot.loops.np.linalg.solve", counting)


def test_poses_in_which_no_loop_closes_are_not_tried_one_by_one(monkeypatch: pytest.MonkeyPatch) -> None:
    apart = SLIDER_CRANK.replace('xyz="0.4 0.03 0.05"', 'xyz="0.4 3 0.05"')
    robot, counted = load(apart, "tip", CROSSHEAD), Counted(monkeypatch)
    readings = np.random.default_rng(3).uniform(-3.0, 3.0, (2000, 1))
    assert not closing(robot, readings).any()
    assert counted.steps < 1000
    counted.steps = 0
    with pytest.raises(RobotError, match="its loops close in hardly any pose within the limits of its joints"):
        random_readings(robot, 2000)
    assert counted.steps < 1000


def test_rows_that_are_closed_do_not_wait_for_one_that_cannot(monkeypatch: pytest.MonkeyPatch) -> None:
    short = load(SLIDER_CRANK.replace('xyz="0.4 0.03 0.05"', 'xyz="0.4 -0.3 0.05"'), "tip", CROSSHEAD)
    readings = np.random.default_rng(7).uniform(-3.0, 3.0, (200, 1))
    readings = readings[closing(short, readings)]
    alone = short.tips(readings[:1])
    counted = Counted(monkeypatch)
    assert np.abs(short.tips(readings)[:1] - alone).max() < 1e-15
    all_close, counted.rows = counted.rows, 0
    assert refused(short, np.vstack([readings, [[1.4]]])).rows == (len(readings),)
    assert counted.rows <= all_close + 30


def test_random_poses_are_looked_at_only_while_some_are_lacking(monkeypatch: pytest.MonkeyPatch) -> None:
    short = load(SLIDER_CRANK.replace('xyz="0.4 0.03 0.05"', 'xyz="0.4 -0.3 0.05"'), "tip", CROSSHEAD)
    counted, limits = Counted(monkeypatch), np.array([[-3.0, 3.0]])
    drawn = np.random.default_rng(7).uniform(-3.0, 3.0, (2000, 1))
    there = closing(short, drawn)
    first, closes = counted.rows, drawn[there]
    assert 1000 < len(closes) < 2000
    np.testing.assert_array_equal(random_readings(short, 2000, limits, seed=7)[: len(closes)], closes)
    # As many as the first draw lacks, and of these again as many as do not close: not all of the second draw.
    assert counted.rows - first < 1.7 * first
    # Rows that are closed, or at a dead centre, are not moved any more.
    assert first < 30 * len(drawn) * np.mean(~there) + 8 * len(drawn)


def test_how_near_a_parallelogram_is_to_folding_flat_is_the_sine_between_its_links() -> None:
    plain = load_robot(CASE / "irb2400.urdf", tip="tool0")
    loop = ClosedLoop("parallelogram", ("rod_end", "rear_lever_pin"), ("x", "z"), ("elbow", "rod"))
    robot = load_robot(CASE / "irb2400.urdf", tip="tool0", loops=[loop])
    nominal, readings = robot.no_deviations(), np.zeros((3, 6))
    # Lower arm and crank are at right angles where axes 2 and 3 are alike.
    readings[:, 1:3] = np.radians([[0.0, 0.0], [20.0, -40.0], [-70.0, 30.0]])
    open_, near, beyond = (least_determinant(robot, nominal, row[None]) for row in readings)
    assert open_ is not None
    assert near == pytest.approx(open_ * np.cos(np.radians(60.0)))
    assert beyond == pytest.approx(open_ * np.cos(np.radians(100.0)))
    assert least_determinant(robot, nominal, readings[:2]) == near
    assert least_determinant(robot, nominal, readings) is None
    assert least_determinant(plain, plain.no_deviations(), readings) is None
    drawn = random_readings(robot, 500, determinant=near)
    apart = np.degrees(np.abs(drawn[:, 2] - drawn[:, 1]))
    assert 50.0 < apart.max() < 64.0
    assert np.degrees(np.ptp(random_readings(robot, 500)[:, 1:3], axis=1)).max() > 120.0


def test_how_the_tip_follows_readings_is_known_with_its_motion() -> None:
    robot, readings = machine("five-bar")
    model = TipModel(robot, deviations(robot, 1e-3, 1e-3))
    placed, driven = model.driven(readings)
    motion = model.motion(readings)
    np.testing.assert_allclose(motion.placement, placed, atol=1e-13)
    np.testing.assert_allclose(motion.by_readings(readings), driven, atol=1e-12)


def test_a_map_closes_the_loops_of_a_pose_once_as_identified_and_once_as_nominal(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    robot, readings = machine("parallelogram")
    data = calib.poses(robot, readings, robot.tips(readings), sigma=1e-4, sigma_angle=1e-4)
    u = machine_of(calib.identify(calib.error_model(robot, offsets="all"), data))
    counted = Counted(monkeypatch)
    asked = readings[:20]
    u.robot.tips(asked, u.deviations)
    once = counted.rows
    calib.judging.tool_uncertainty(u, asked)
    # What gravity makes joints hold is that of the nominal arm.
    assert counted.rows == once + 2 * once > 0


# ---- out of the toolkit and back


@pytest.mark.parametrize("name", MACHINES)
def test_the_calibrated_urdf_reads_back_as_the_calibrated_machine(name: str) -> None:
    robot, readings = machine(name)
    d = deviations(robot, 1e-3, 1e-3)
    again = with_document(robot, parse_urdf(calibrated_urdf(robot, d), "calibrated.urdf"))
    np.testing.assert_allclose(again.tips(readings), robot.tips(readings, d), atol=1e-12)


def test_the_calibrated_urdf_is_compared_where_the_loops_close(monkeypatch: pytest.MonkeyPatch) -> None:
    """At readings of a radian, which it never took, the rod of a sound machine did not reach, and it had no URDF."""
    robot = load(four_bar_urdf(c=0.72), "tip", PARALLELOGRAM)
    d = deviations(robot, 1e-3, 1e-3)
    document = calibrated_urdf(robot, d)
    readings = np.random.default_rng(0).uniform(-0.4, 0.4, (10, 5))
    again = with_document(robot, parse_urdf(document, "calibrated.urdf"))
    np.testing.assert_allclose(again.tips(readings), robot.tips(readings, d), atol=1e-12)
    short = four_bar_urdf(c=0.5).encode()
    monkeypatch.setattr(urdf, "splice_origins", lambda *_: short)
    with pytest.raises(OutputError, match="has loops that do not close where the machine's do"):
        calibrated_urdf(robot, d)


@pytest.mark.parametrize("name", MACHINES)
def test_a_model_file_with_loops_and_couplings_predicts_the_same(name: str, tmp_path: Path) -> None:
    robot, readings = machine(name)
    d = deviations(robot, 1e-3, 1e-3)
    columns: dict[str, object] = {f"{r.name} [rad]": readings[:, k] for k, r in enumerate(robot.readings)}
    columns |= {f"{a} [m]": p for a, p in zip("xyz", robot.tips(readings, d)[:, :3, 3].T, strict=True)}
    data = calib.read_measurements(columns, robot, sigma=1e-6)
    model = calib.error_model(robot, offsets="all", base="fixed", tool="fixed")
    fit = calib.identify(model, data)

    (tmp_path / "model.json").write_text(model_json(machine_of(fit)), encoding="utf-8")
    (tmp_path / "nominal.urdf").write_bytes(robot.urdf.source)
    again = calib.load_machine(tmp_path)
    assert again.robot.closed_loops == robot.closed_loops
    assert again.robot.couplings == robot.couplings
    np.testing.assert_allclose(again.predict(readings), machines.predicted(fit, readings), atol=1e-13)


def test_a_joint_that_follows_a_passive_one_is_refused() -> None:
    with pytest.raises(
        RobotError, match="joint 'roll' follows 'elbow', which is passive: a loop determines it, and it has no"
    ):
        load_robot(
            parse_urdf(four_bar_urdf().encode(), "loop.urdf"),
            "tip",
            couplings=[Coupling("roll", {"elbow": 1.0})],
            loops=[PARALLELOGRAM],
        )


@pytest.mark.parametrize(
    ("closes", "passive"), [((), ()), (("x", "x"), ("elbow", "rod")), (("x", "z"), ("rod", "rod"))]
)
def test_a_loop_names_each_thing_once(closes: tuple[Literal["x", "z"], ...], passive: tuple[str, ...]) -> None:
    with pytest.raises(RobotError, match="must name at least one, and each once"):
        load_robot(
            parse_urdf(four_bar_urdf().encode(), "loop.urdf"),
            "tip",
            loops=[ClosedLoop("p", ("rod_end", "pin"), closes, passive)],
        )


def test_a_five_bar_stays_as_it_was_assembled_far_from_where_it_is_drawn() -> None:
    """Its distal links turn by more than a radian; nothing but the URDF says where they are, at readings of zero."""
    tilt = float(np.arctan2(0.1, np.sqrt(0.4**2 - 0.1**2)))
    text = tree(
        ("base", "left", "revolute", "-0.1 0 0", "0 1 0"),
        ("left", "left_distal", "revolute", "0 0 0.3", "0 1 0", "", f"0 {tilt} 0"),
        ("left_distal", "tip", "fixed", "0 0 0.4", "0 0 0"),
        ("base", "right", "revolute", "0.1 0 0", "0 1 0"),
        ("right", "right_distal", "revolute", "0 0 0.3", "0 1 0", "", f"0 {-tilt} 0"),
        ("right_distal", "right_end", "fixed", "0 0 0.4", "0 0 0"),
    )
    robot = load(text, "tip", ClosedLoop("five", ("tip", "right_end"), ("x", "z"), ("left_distal", "right_distal")))
    assert [reading.name for reading in robot.readings] == ["left", "right"]
    left, right = np.meshgrid(np.linspace(-1.25, 0.0, 26), np.linspace(0.0, 1.25, 26))
    readings = np.stack([left.ravel(), right.ravel()], axis=1)
    A = np.stack([-0.1 + 0.3 * np.sin(readings[:, 0]), 0.3 * np.cos(readings[:, 0])], axis=1)
    B = np.stack([0.1 + 0.3 * np.sin(readings[:, 1]), 0.3 * np.cos(readings[:, 1])], axis=1)
    half = 0.5 * (B - A)
    across = np.stack([-half[:, 1], half[:, 0]], axis=1) / np.linalg.norm(half, axis=1)[:, None]
    up = A + half + np.sqrt(0.4**2 - np.sum(half**2, axis=1))[:, None] * across
    np.testing.assert_allclose(robot.tips(readings)[:, [0, 2], 3], up, atol=1e-12)


def test_readings_that_cannot_be_closed_are_given_up_soon(monkeypatch: pytest.MonkeyPatch) -> None:
    """Those that a search for commands tries far beyond all limits: the way there is not walked in small steps."""
    robot, _ = machine("five-bar")
    model, looks = TipModel(robot), [0]
    gaps = LoopsTogether._gaps

    def counted(self: LoopsTogether, q: Array, starts: object) -> tuple[Array, Array]:
        looks[0] += len(q)
        return gaps(self, q, starts)

    monkeypatch.setattr(LoopsTogether, "_gaps", counted)
    readings = np.stack([np.linspace(2.9, 3.3, 9), np.linspace(0.2, -0.2, 9)], axis=1)
    assert not model.closes(readings).any()
    assert looks[0] <= 100 * len(readings)


# A four-bar whose coupler and rocker come into line at both ends of the crank's range: ground, crank, coupler, rocker.
GROUND, CRANK, COUPLER, ROCKER = 0.45, 0.35, 0.3, 0.25


def far_four_bar(drawn: bool) -> Robot:
    """It is ``drawn`` where the crank is upright, and elsewhere its links turn by radians."""
    text = tree(
        ("base", "crank", "revolute", "0 0 0", "0 1 0"),
        ("crank", "coupler", "revolute", f"0 0 {CRANK}", "0 1 0"),
        ("coupler", "pin", "fixed", f"{COUPLER} 0 0", "0 0 0"),
        ("base", "rocker", "revolute", f"{GROUND} 0 0", "0 1 0"),
        ("rocker", "tip", "fixed", f"0 0 {ROCKER}", "0 0 0"),
    )
    text = text.replace(machines.LIMIT["revolute"], '<limit lower="0.07" upper="3.07" effort="1" velocity="1"/>', 1)
    near = (Coupling("coupler", {"crank": 1.0}, -4.033), Coupling("rocker", {"crank": -0.1}, 0.517)) if drawn else ()
    loop = ClosedLoop("four", ("pin", "tip"), ("x", "z"), ("coupler", "rocker"))
    return load(text, "tip", loop, couplings=near)


def test_a_four_bar_closes_up_to_its_dead_centres_as_it_was_assembled() -> None:
    """From where it is drawn, nothing closes some of these readings at once, and long stretches lead past them."""
    crank = np.linspace(0.08, 3.06, 200)
    pin = CRANK * np.stack([np.sin(crank), np.cos(crank)], axis=1)
    way = np.array([GROUND, 0.0]) - pin
    far = np.linalg.norm(way, axis=1)
    along = (far**2 + COUPLER**2 - ROCKER**2) / (2.0 * far)
    across = np.stack([-way[:, 1], way[:, 0]], axis=1) / far[:, None]
    end = pin + (along / far)[:, None] * way + np.sqrt(COUPLER**2 - along**2)[:, None] * across
    np.testing.assert_allclose(far_four_bar(drawn=True).tips(crank[:, None])[:, [0, 2], 3], end, atol=1e-9)


def test_links_that_are_drawn_nowhere_near_their_loop_are_told() -> None:
    with pytest.raises(PoseError, match="or its passive joints are far from where their <mimic>, or zero, is"):
        far_four_bar(drawn=False).tips(np.array([[1.6]]))


def test_a_five_bar_is_not_closed_the_other_way_near_a_dead_centre() -> None:
    """Both ways are near each other where the distal links are nearly in line."""
    text = tree(
        ("base", "left", "revolute", "0.2 0 0", "0 0 1"),
        ("left", "left_distal", "revolute", "0.25 0 0", "0 0 1"),
        ("left_distal", "tip", "fixed", "0.4 0 0", "0 0 0"),
        ("base", "right", "revolute", "-0.1 0 0", "0 0 1"),
        ("right", "right_distal", "revolute", "0.25 0 0", "0 0 1"),
        ("right_distal", "right_end", "fixed", "0.4 0 0", "0 0 0"),
    )
    drawn = (Coupling("left_distal", {"left": -1.0}, 2.452), Coupling("right_distal", {"right": -1.0}, 0.689))
    loop = ClosedLoop("five", ("tip", "right_end"), ("x", "y"), ("left_distal", "right_distal"))
    robot = load(text, "tip", loop, couplings=drawn)
    readings = np.array([(0.21, 3.33), (-0.19, 3.19), (0.0, 3.39), (0.28, 3.52), (0.14, 3.42), (-0.28, 3.1)])
    left, right = readings.T
    A = np.stack([0.2 + 0.25 * np.cos(left), 0.25 * np.sin(left)], axis=1)
    B = np.stack([-0.1 + 0.25 * np.cos(right), 0.25 * np.sin(right)], axis=1)
    half = 0.5 * (B - A)
    across = np.stack([half[:, 1], -half[:, 0]], axis=1) / np.linalg.norm(half, axis=1)[:, None]
    up = A + half + np.sqrt(0.4**2 - np.sum(half**2, axis=1))[:, None] * across
    np.testing.assert_allclose(robot.tips(readings)[:, :2, 3], up, atol=1e-9)
