"""Many rows: memory that does not grow with rows times parameters, and starts that need not see all of them."""

import tracemalloc

import numpy as np
import pytest

import calib
from calib.identification import system
from calib.identification.initialisation.frames import initial_frames
from calib.identification.initialisation.problem import initial_problem
from tests.support import machines

URDF, TIP = "example:ur_description/urdf/ur10_robot.urdf", "tool0"
ROWS = 40_000


def seen(
    robot: calib.Robot, readings: machines.Array, position: machines.Array, points: list[str] | None = None
) -> calib.Measurements:
    columns: dict[str, object] = {f"{r.name} [rad]": readings[:, k] for k, r in enumerate(robot.readings)}
    columns |= {f"{axis} [m]": position[:, k] for k, axis in enumerate("xyz")}
    if points is not None:
        columns["tool"] = points
    return calib.read_measurements(columns, robot, "position", sigma=1e-4)


@pytest.fixture(scope="module")
def robot() -> calib.Robot:
    return machines.load(URDF, TIP)


def test_residuals_and_jacobians_never_stand_in_memory_as_a_whole(robot: calib.Robot) -> None:
    rng = np.random.default_rng(0)
    true = machines.arm(URDF, TIP)
    readings = true.draw(rng, ROWS)
    data = seen(robot, readings, true.tips(readings)[:, :3, 3])
    problem = initial_problem(calib.error_model(robot, offsets="all", placements="all"), (data,))
    x = rng.normal(scale=1e-3, size=len(problem.parameters))
    tracemalloc.start()
    found = system.evaluate(problem, [data.sigma], x)
    (residuals,) = system.residuals(robot, (data,), problem.machine(x))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 0.25 * data.sigma.size * len(x) * 8
    assert np.array_equal(residuals, found.residuals[0])


def test_a_row_is_what_it_is_in_whatever_block_it_stands(robot: calib.Robot) -> None:
    rng = np.random.default_rng(1)
    true = machines.arm(URDF, TIP).moved(rng)
    readings = true.draw(rng, 1000)
    data = seen(robot, readings, true.tips(readings)[:, :3, 3])
    problem = initial_problem(calib.error_model(robot, offsets="all"), (data,))
    machine = problem.machine(np.zeros(len(problem.parameters)))
    (together,) = system.residuals(robot, (data,), machine)
    (alone,) = system.residuals(robot, (data.subset([777]),), machine)
    assert np.allclose(together[777], alone[0], rtol=0.0, atol=1e-15)


def test_a_start_from_some_of_the_rows_knows_every_tool(robot: calib.Robot) -> None:
    """The few rows of a tool that was used last are among them."""
    rng = np.random.default_rng(2)
    true = machines.arm(URDF, TIP)
    readings = true.draw(rng, 30_000)
    base, tools = machines.anywhere(rng), np.array([[0.1, 0.0, 0.2], [0.0, -0.1, 0.3]])
    number = (np.arange(30_000) >= 29_980).astype(int)
    placed = base @ true.tips(readings) @ machines.pose(tools)[number]
    data = seen(robot, readings, placed[:, :3, 3], ["first" if k == 0 else "last" for k in number])
    frames = initial_frames(calib.error_model(robot, offsets="all", tool="position"), (data,))
    assert np.allclose(frames.base, base, atol=1e-9)
    assert np.allclose(frames.tools[:, :3, 3], tools, atol=1e-9)
    backwards = initial_frames(
        calib.error_model(robot, offsets="all", tool="position"), (data.subset(np.arange(30_000)[::-1]),)
    )
    assert np.allclose(backwards.tools[:, :3, 3], tools, atol=1e-9)
