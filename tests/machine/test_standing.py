"""How sure it is where a machine stands: against differences, and against true machines before one tracker."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

import calib
from calib.machine.place import Place, undetermined_in_words
from calib.machine.standing import Moved, Pivoted, place_of, place_of_touched, rigid_parts, with_tool_point
from calib.robot.conditions import NO_CONDITIONS, ordinary
from calib.robot.sampling import random_readings
from tests.support import machines, standing
from tests.support.machines import Array, Rng

UR10 = ("example:ur_description/urdf/ur10_robot.urdf", "tool0")
FLANGE = ("flange", "fixed", "0 0 0.02", "0 0 0", "0 0 0")
SCARA = (
    machines.urdf(
        ("shoulder", "revolute", "0 0 0.4", "0 0 0", "0 0 1"),
        ("elbow", "revolute", "0.35 0 0.05", "0 0 0", "0 0 1"),
        ("quill", "prismatic", "0.3 0 0", "0 0 0", "0 0 -1"),
        ("spin", "continuous", "0 0 -0.1", "0 0 0", "0 0 -1"),
        FLANGE,
    ),
    "tip",
)
# Not along the axes of a SCARA, where its place is not seen: far off there, second-order effects would be seen.
TOOL = machines.pose((0.05, 0.02, 0.0))
SESSIONS = 12


def calibrated(name: tuple[str, str], rng: Rng) -> tuple[calib.CalibratedMachine, machines.Machine]:
    robot, arm = machines.load(*name), machines.arm(*name)
    true = machines.Machine(arm.moved(rng), machines.anywhere(rng), {"tool": TOOL})
    data = true.measure(robot, arm.draw(rng, int(rng.integers(25, 60))), rng=rng, sigma=5e-5)
    model = calib.error_model(robot, offsets="all", placements="all", tool="position")
    return calib.machine_of(calib.identify(model, data)), true


@pytest.fixture(scope="module")
def scara() -> tuple[calib.CalibratedMachine, machines.Machine]:
    return calibrated(SCARA, np.random.default_rng(0))


def error(machine: calib.CalibratedMachine, true: machines.Machine, rng: Rng) -> Array:
    """How far the machine truly is from where it was found to stand, at its base, in the tracker's axes."""
    low, high = machine.known_uncertainty.identified.T
    q = rng.uniform(low, high, (200, len(low)))
    truly = true.base @ true.arm.tips(q) @ machine.tools["tool"]
    return standing.shift_of_all(machine.predict(q), truly, machine.base[:3, 3])


def moved(machine: calib.CalibratedMachine, change: Array) -> calib.CalibratedMachine:
    """The machine whose state has changed, as the rows of a factor say."""
    layout, count = machine.layout, len(machine.robot.chain)
    offsets = change[6 * count : 6 * count + len(machine.deviations.offsets)]
    deviations = calib.Deviations(
        machine.deviations.placements + change[: 6 * count].reshape(-1, 6),
        machine.deviations.offsets + offsets,
        machine.deviations.terms,
    )
    base = np.array(machine.base)
    base[:3, 3] += change[layout.base : layout.base + 3]
    base[:3, :3] = base[:3, :3] @ Rotation.from_rotvec(change[layout.base + 3 : layout.base + 6]).as_matrix()
    tools = {name: np.array(T) for name, T in machine.tools.items()}
    for k, T in enumerate(tools.values()):
        T[:3, 3] += change[layout.tools + 6 * k : layout.tools + 6 * k + 3]
    return replace(machine, deviations=deviations, base=base, tools=tools, uncertainty=None)


def with_errors(machine: calib.CalibratedMachine, factor: Array, null_basis: Array) -> calib.CalibratedMachine:
    """The machine with columns of a factor as its only errors."""
    known, causes = machine.known_uncertainty, (factor.shape[1], 0, 0)
    known = replace(known, factor=factor, null_basis=null_basis, left_out=None, causes=causes)
    return replace(machine, uncertainty=known)


@pytest.mark.parametrize("name", [UR10, SCARA], ids=["ur10", "scara"])
def test_factor_is_what_differences_say(name: tuple[str, str]) -> None:
    """Every column moves links; of that, the rigid part beside a motion in their own axes, by least squares."""
    machine, _ = calibrated(name, np.random.default_rng(3))
    known = machine.known_uncertainty
    machine = with_errors(machine, known.factor, known.null_basis)
    q = random_readings(machine.robot, 200, known.identified)
    found = machine.predict(q)
    points = found[:, :3, 3]
    apart = np.sqrt(np.mean(np.sum((points - points.mean(axis=0)) ** 2, axis=1)))
    weights = np.repeat([1.0, apart], 3)

    def motion(change: Array) -> Array:
        h = 1e-7 / max(np.abs(change).max(), 1e-12)
        ahead, behind = (replace(moved(machine, sign * h * change), tools=machine.tools).predict(q) for sign in (1, -1))
        return np.asarray((weights * standing.field(behind, ahead)).ravel() / (2.0 * h))

    A = np.zeros((200, 6, 6))
    A[:, :3, :3] = A[:, 3:, 3:] = np.eye(3)
    A[:, :3, 3:] = -standing.cross(points - machine.base[:3, 3])
    A = (weights[:, None] * A).reshape(-1, 6)
    local = np.zeros((200, 6, 6))
    local[:, :3, :3] = local[:, 3:, 3:] = found[:, :3, :3]
    place = place_of(machine)
    rows = np.hstack([A, (weights[:, None] * local).reshape(-1, 6)])
    columns = np.random.default_rng(0).choice(known.factor.shape[1], 12, replace=False)
    across = np.eye(6) - place.undetermined_basis @ place.undetermined_basis.T
    for k in columns:
        expected = np.linalg.lstsq(rows, motion(known.factor[:, k]), rcond=1e-3)[0][:6]
        size = np.abs(place.factor).max()
        np.testing.assert_allclose(across @ place.factor[:, k], across @ expected, atol=2e-3 * size)


def test_tools_of_one_link_are_one_body() -> None:
    """A motion of each in its own axes is fitted: for every one of 40 tools, that took 800 MB."""
    machine, _ = calibrated(UR10, np.random.default_rng(3))
    known, more = machine.known_uncertainty, 39
    tools = dict(machine.tools) | {f"mark {k}": machines.pose((0.05, 0.002 * k, 0.0)) for k in range(more)}
    parts = (known.factor, known.null_basis)
    factor, null_basis = (np.vstack([part, np.zeros((6 * more, part.shape[1]))]) for part in parts)
    many = replace(machine, tools=tools, uncertainty=replace(known, factor=factor, null_basis=null_basis))
    tracemalloc.start()
    place = place_of(many)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 200e6
    np.testing.assert_allclose(place.sigmas, place_of(machine).sigmas, rtol=0.05)


def test_true_places_are_inside() -> None:
    """An arm and a SCARA before one tracker, each badly made in its own way, its base and first joint as well."""
    inside = []
    for seed in range(SESSIONS):
        rng = np.random.default_rng(seed)
        (first, its), (second, others) = calibrated(UR10, rng), calibrated(SCARA, rng)
        between = second.base[:3, 3] - first.base[:3, 3]
        place = place_of(second).beside(place_of(first).at(between))
        off = error(second, others, rng) - standing.at(error(first, its, rng), between)
        inside.append(place.inside(off))
        assert place.sigmas[0] < 0.3e-3
    # Of 12, three or more are outside once in fifty times where 95 % are inside.
    assert np.mean(inside) > 0.8


def test_what_cancels_is_not_counted_and_the_height_is_named(
    scara: tuple[calib.CalibratedMachine, machines.Machine],
) -> None:
    """Base and first joint, spin and tool: no places. The tool's height along all axes of a SCARA is one."""
    machine, true = scara
    assert machine.known_uncertainty.null_basis.shape[1] > 10
    place = place_of(machine).turned(machine.base[:3, :3].T)
    ((said, twist),) = undetermined_in_words(place)
    assert said == "along z"
    np.testing.assert_array_equal(twist, [0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
    assert place.sigmas[0] < 0.1e-3
    # And rightly so: along z the tool's height is off, and nothing else is.
    off = standing.turned(error(machine, true, np.random.default_rng(5)), machine.base[:3, :3].T)
    assert place.inside(off)


def test_a_turn_is_named_by_its_line() -> None:
    T = np.array([0.2, 0.1, 0.0])
    about_z = np.array([[0.0, 0.0, 0.0, 0.0, 0.0, 1.0]]).T
    here = Place(np.zeros((6, 1)), about_z, np.inf)
    assert [said for said, _ in undetermined_in_words(here)] == ["turning about z"]
    ((there, _),) = undetermined_in_words(here.at(T))
    assert there == "turning about z through (-200, -100, 0) mm from its base"
    everything = Place(np.zeros((6, 1)), np.eye(6), np.inf)
    named = ["along x", "along y", "along z", "turning about x", "turning about y", "turning about z"]
    assert [said for said, _ in undetermined_in_words(everything)] == named
    leaning = Place(np.zeros((6, 1)), np.array([[0.6, 0.0, 0.8, 0.0, 0.0, 0.0]]).T, np.inf)
    assert [said for said, _ in undetermined_in_words(leaning)] == ["along (0.600, 0.000, 0.800)"]
    assert undetermined_in_words(Place(np.eye(6), np.zeros((6, 0)), np.inf)) == ()


def test_a_point_has_an_uncertainty_of_its_own(scara: tuple[calib.CalibratedMachine, machines.Machine]) -> None:
    machine, _ = scara
    C = np.diag([1e-8, 4e-8, 9e-8])
    found = with_tool_point(machine, np.array([0.0, 0.1, 0.2]), C)
    known, start = found.known_uncertainty, found.layout.tools
    assert sum(known.causes) == known.factor.shape[1]
    assert len(known.factor) == found.layout.size == start + 6
    np.testing.assert_allclose((known.factor @ known.factor.T)[start:, start:][:3, :3], C, atol=1e-20)
    assert not known.null_basis[start:].any()


def kabsch(found: Array, moved_to: Array, origin: Array) -> Array:
    """The twist (6,), at ``origin``, of the rigid motion that takes points (N, 3) nearest to others."""
    middle, there = found.mean(axis=0), moved_to.mean(axis=0)
    turn, _ = Rotation.align_vectors(moved_to - there, found - middle)
    return np.concatenate([there + turn.apply(origin - middle) - origin, turn.as_rotvec()])


def test_errors_of_the_base_and_of_the_tool_move_what_was_touched(
    scara: tuple[calib.CalibratedMachine, machines.Machine],
) -> None:
    """The base's do not, in the base; the tool's in one orientation move it as they are, and turned into the base."""
    machine = replace(scara[0], deviations=scara[0].robot.no_deviations())
    layout, rng = machine.layout, np.random.default_rng(1)
    of_base, of_tool = np.zeros((layout.size, 6)), np.zeros((layout.size, 3))
    of_base[layout.base : layout.base + 6] = 1e-3 * np.eye(6)
    of_tool[layout.tools : layout.tools + 3] = 1e-3 * np.eye(3)
    q = machines.arm(*SCARA).draw(rng, 20)
    touches = [(q, ordinary(q))]
    alone = with_errors(machine, of_base, np.zeros((layout.size, 0)))
    np.testing.assert_allclose(place_of_touched(alone, "tool", touches).factor, 0.0, atol=1e-12)

    alone = with_errors(machine, of_tool, np.zeros((layout.size, 0)))
    q[:, 3] = q[:, 0] + q[:, 1] + 0.7  # the spin turns back, about -z
    R = machine.tips(q)[:, :3, :3]
    assert np.abs(R - R[0]).max() < 1e-12
    expected = 1e-3 * np.vstack([R[0], np.zeros((3, 3))])
    np.testing.assert_allclose(place_of_touched(alone, "tool", [(q, ordinary(q))]).factor, expected, atol=1e-12)
    # Turned over once around, most of a shift across is gone.
    q[:, 3] += np.arange(20) * 2.0 * np.pi / 20
    touched = place_of_touched(alone, "tool", [(q[:10], ordinary(q[:10])), (q[10:], ordinary(q[10:]))])
    points, T = (machine.tips(q) @ machine.tools["tool"])[:, :3, 3], machine.tips(q)
    for k in range(3):
        shifted = kabsch(points, points + 1e-6 * T[:, :3, k], np.zeros(3)) / 1e-6
        np.testing.assert_allclose(touched.factor[:, k], 1e-3 * shifted, atol=1e-8)


def test_place_of_what_was_touched_is_what_differences_say() -> None:
    """Every column moves the tips that touched, and the arm: the rigid motion of the ones less that of the other."""
    machine, _ = calibrated(UR10, np.random.default_rng(3))
    known, rng = machine.known_uncertainty, np.random.default_rng(7)
    machine = with_errors(machine, known.factor, known.null_basis)
    low, high = known.identified.T
    touching, q = rng.uniform(low, high, (30, len(low))), random_readings(machine.robot, 200, known.identified)
    origin = machine.base[:3, 3]

    def apart(change: Array) -> Array:
        other = moved(machine, change)
        tips = (one.predict(touching)[:, :3, 3] for one in (machine, other))
        links = (one.predict(q) for one in (machine, replace(other, tools=machine.tools)))
        return kabsch(*tips, origin) - standing.shift_of_all(*links, origin)

    place = place_of_touched(machine, "tool", [(touching, ordinary(touching))])
    size = np.abs(place.factor).max()
    for k in rng.choice(known.factor.shape[1], 12, replace=False):
        change = known.factor[:, k]
        h = 1e-6 / max(np.abs(change).max(), 1e-12)
        twist = standing.turned((apart(h * change) - apart(-h * change)) / (2.0 * h), machine.base[:3, :3].T)
        np.testing.assert_allclose(place.factor[:, k], twist, atol=1e-3 * size)


def test_what_the_arm_cannot_see_moves_what_it_touched() -> None:
    """Nobody takes it out of the touched points: by as much as it may be, they are off, and the body with them."""
    rng = np.random.default_rng(2)
    points = rng.normal(size=(12, 3))
    leaning = Rotation.from_rotvec(rng.uniform(-1.0, 1.0, (12, 3))).apply([0.0, 0.0, 1.0])[:, :, None]
    (place,) = rigid_parts([Moved(points, 0.03 * leaning, leaning, np.zeros((12, 3, 0)))], np.zeros(3))
    twist = kabsch(points, points + 1e-6 * leaning[:, :, 0], np.zeros(3)) / 1e-6
    assert place.undetermined.shape[1] == 0
    np.testing.assert_allclose(place.factor[:, 0], 0.03 * twist, atol=1e-7)


def test_two_unseen_heights_that_lean_leave_the_place_unsure_across(
    scara: tuple[calib.CalibratedMachine, machines.Machine],
) -> None:
    """They are told as one direction; along the other's the machine may be as far off as its tool's height."""
    machine, _ = scara
    known, height = machine.known_uncertainty, machine.layout.tools + 2
    width, lean = float(np.linalg.norm(known.factor[height])), 5e-3
    upright = place_of(machine).turned(machine.base[:3, :3].T)
    assert np.linalg.norm(upright.undetermined_basis.T @ upright.factor) == pytest.approx(width, rel=1e-2)
    both = upright.beside(upright.turned(Rotation.from_rotvec([lean, 0.0, 0.0]).as_matrix()))
    assert both.undetermined_basis.shape[1] == 1
    assert both.sigmas[0] == pytest.approx(width * lean / np.sqrt(2.0), rel=0.1)


def test_a_pivoted_point_follows_the_arm_that_pivoted() -> None:
    """Of two targets, each touched in its orientations, as solved anew with an arm that is a little off."""
    machine, _ = calibrated(UR10, np.random.default_rng(3))
    known, rng = machine.known_uncertainty, np.random.default_rng(4)
    machine = with_errors(machine, known.factor, known.null_basis)
    point, targets = np.array([0.01, 0.02, 0.15]), ("a",) * 8 + ("b",) * 8
    fixed = {"a": np.array([0.5, 0.3, 0.4]), "b": np.array([-0.4, 0.5, 0.3])}

    def tip(one: calib.CalibratedMachine, q: Array, p: Array = point) -> Array:
        T = one.tips(q)
        return np.asarray(T[:, :3, :3] @ p + T[:, :3, 3])

    def pivoting(target: str) -> Array:
        while True:
            start = rng.uniform(-2.0, 2.0, 6)
            found = least_squares(lambda q: tip(machine, q[None])[0] - fixed[target], start, xtol=1e-14, gtol=1e-14)
            if found.cost < 1e-20:
                return np.asarray(found.x)

    q = np.stack([pivoting(target) for target in targets])
    of = with_tool_point(machine, point, np.zeros((3, 3)), Pivoted(q, NO_CONDITIONS, targets))
    start = of.layout.tools
    factor = of.known_uncertainty.factor[start : start + 3, 3:]
    for k in rng.choice(known.factor.shape[1], 8, replace=False):
        change = known.factor[:, k]
        h = 1e-6 / max(np.abs(change).max(), 1e-12)
        ahead, behind = (
            calib.positioner.pivot(moved(machine, sign * h * change).tips(q), targets).tool_point for sign in (1, -1)
        )
        expected = (ahead - behind) / (2.0 * h)
        np.testing.assert_allclose(factor[:, k], expected, atol=1e-4 * np.abs(factor).max())
