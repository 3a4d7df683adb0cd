"""How sure it is where a machine stands: against differences, and against true machines before one tracker."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import calib
from calib.machine.place import Place, undetermined_in_words
from calib.machine.standing import place_of, with_tool_point
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
    return replace(machine, deviations=deviations, base=base, uncertainty=None)


@pytest.mark.parametrize("name", [UR10, SCARA], ids=["ur10", "scara"])
def test_factor_is_what_differences_say(name: tuple[str, str]) -> None:
    """Every column moves links; of that, the rigid part beside what the null space does, by least squares."""
    machine, _ = calibrated(name, np.random.default_rng(3))
    known = machine.known_uncertainty
    known = replace(known, left_out=None, causes=(known.factor.shape[1], 0, 0))
    machine = replace(machine, uncertainty=known)
    q = random_readings(machine.robot, 200, known.identified)
    found = machine.predict(q)
    points = found[:, :3, 3]
    apart = np.sqrt(np.mean(np.sum((points - points.mean(axis=0)) ** 2, axis=1)))
    weights = np.repeat([1.0, apart], 3)

    def motion(change: Array) -> Array:
        h = 1e-7 / max(np.abs(change).max(), 1e-12)
        ahead, behind = (moved(machine, sign * h * change).predict(q) for sign in (1.0, -1.0))
        return np.asarray((weights * standing.field(behind, ahead)).ravel() / (2.0 * h))

    A = np.zeros((200, 6, 6))
    A[:, :3, :3] = A[:, 3:, 3:] = np.eye(3)
    A[:, :3, 3:] = -standing.cross(points - machine.base[:3, 3])
    A = (weights[:, None] * A).reshape(-1, 6)
    null = 1e3 * np.column_stack([motion(column) for column in known.null_basis.T])
    local = np.zeros((200, 6, 6))
    local[:, :3, :3] = local[:, 3:, 3:] = found[:, :3, :3]
    place = place_of(machine)
    rows = np.hstack([A, null, (weights[:, None] * local).reshape(-1, 6)])
    columns = np.random.default_rng(0).choice(known.factor.shape[1], 12, replace=False)
    across = np.eye(6) - place.undetermined_basis @ place.undetermined_basis.T
    for k in columns:
        expected = np.linalg.lstsq(rows, motion(known.factor[:, k]), rcond=1e-3)[0][:6]
        size = np.abs(place.factor).max()
        np.testing.assert_allclose(across @ place.factor[:, k], across @ expected, atol=2e-3 * size)


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
