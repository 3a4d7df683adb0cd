"""A probe that balls alone tell: found also where it was pointed at their middles, as people touch."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import calib
from calib.identification.identify import identify
from calib.identification.initialisation.anchors import anchors_anew
from calib.identification.initialisation.problem import initial_problem
from calib.identification.machine import values_at
from calib.job.photographs import flange_urdf
from tests.support.machines import Array

PROBE = np.array([0.004, -0.003, 0.16])
BALL, RADIUS, SIGMA = np.array([0.4, 0.2, 0.1]), 0.015, 2e-5
_AXES = ("x", "y", "z")


def _touches(tmp_path: Path, seed: int, straight: float, half: bool) -> tuple[calib.Robot, calib.Measurements]:
    """A flange that goes anywhere and a ball it touches: its z turned from the ball's middle by ``straight`` rad."""
    rng = np.random.default_rng(seed)
    away = rng.normal(size=(30, 3))
    away[:, 2] = np.where(half, np.abs(away[:, 2]), away[:, 2])
    away /= np.linalg.norm(away, axis=1)[:, None]
    turns = (
        np.array([_towards(-d, rng) for d in away])
        @ Rotation.from_rotvec(rng.normal(scale=straight, size=(30, 3))).as_matrix()
    )
    flange = BALL + (RADIUS + rng.normal(scale=SIGMA, size=(30, 1))) * away - turns @ PROBE
    urdf = tmp_path / "flange.urdf"
    urdf.write_text(flange_urdf(flange), encoding="utf-8")
    robot = calib.load_robot(urdf, "flange")
    angles = Rotation.from_matrix(turns).as_euler("ZYX")
    values = np.column_stack([flange, angles])
    columns: dict[str, object] = {
        f"{reading.name} [{'m' if reading.dimension == 'length' else 'rad'}]": values[:, k]
        for k, reading in enumerate(robot.readings)
    }
    columns |= {"diameter [m]": np.full(30, 2.0 * RADIUS), "target": ["ball"] * 30}
    return robot, calib.read_measurements(columns, robot, "sphere", sigma=SIGMA)


def _towards(z: Array, rng: np.random.Generator) -> Array:
    x = np.cross(rng.normal(size=3), z)
    x /= np.linalg.norm(x)
    return np.column_stack([x, np.cross(z, x), z])


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("half", [False, True])
@pytest.mark.parametrize("straight", [0.2, 0.5])
def test_a_probe_that_points_at_the_ball_is_found(tmp_path: Path, seed: int, straight: float, half: bool) -> None:
    robot, data = _touches(tmp_path, seed, straight, half)
    fit = identify(calib.error_model(robot, base="fixed", tool="position"), data)
    assert fit.converged
    np.testing.assert_allclose(fit.machine.frames.tools[0, :3, 3], PROBE, atol=2e-4)
    assert np.sqrt(np.mean(fit.residuals[0] ** 2)) < 1.3 * SIGMA


def test_a_probe_is_found_by_the_ball_about_which_it_turned_among_many(tmp_path: Path) -> None:
    """Of many balls those tell the side about which the tip turned most, wherever they stand in the table."""
    robot, data = _touches(tmp_path, 2, 0.3, half=False)
    rng = np.random.default_rng(7)
    flanges, balls = [], []
    for k in range(12):
        away = rng.normal(size=(5, 3))
        away /= np.linalg.norm(away, axis=1)[:, None]
        turn = Rotation.from_euler("ZYX", rng.uniform(-0.5, 0.5, 3))
        angles = np.tile(turn.as_euler("ZYX"), (5, 1))
        flanges.append(np.column_stack([BALL + 0.05 * k + RADIUS * away - turn.apply(PROBE), angles]))
        balls += [f"other {k}"] * 5
    values = np.concatenate([*flanges, data.readings])
    columns: dict[str, object] = {
        f"{reading.name} [{'m' if reading.dimension == 'length' else 'rad'}]": values[:, k]
        for k, reading in enumerate(robot.readings)
    }
    columns |= {"diameter [m]": np.full(len(values), 2.0 * RADIUS), "target": [*balls, *["ball"] * len(data)]}
    every = calib.read_measurements(columns, robot, "sphere", sigma=SIGMA)
    problem = initial_problem(calib.error_model(robot, base="fixed", tool="position"), (every,))
    np.testing.assert_allclose(problem.reference.tools[0, :3, 3], PROBE, atol=2e-4)


def test_a_probe_on_the_wrong_side_is_put_where_its_touches_put_it(tmp_path: Path) -> None:
    """A search may have gone there by a robot that was off; one that is where it should be stays."""
    robot, data = _touches(tmp_path, 1, 0.3, half=False)
    model = calib.error_model(robot, base="fixed", tool="position")
    fit = identify(model, data)
    problem = initial_problem(model, (data,))
    x = values_at(robot, problem.parameters, fit.machine.frames, fit.machine.deviations)
    assert anchors_anew(problem, x) is None
    wrong = x + np.where([p.name == "tool.z" for p in problem.parameters], -RADIUS, 0.0)
    found = anchors_anew(problem, wrong)
    assert found is not None
    np.testing.assert_allclose(found, x, atol=2e-4)


TABLE = """<robot name="table"><link name="base"/><link name="plate"/><joint name="c" type="continuous">
<parent link="base"/><child link="plate"/><origin xyz="0 0 0.3"/><axis xyz="0 0 1"/></joint></robot>"""


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("anchors", [1, 3])
def test_a_ball_on_a_table_is_found_off_the_axis_by_a_ball_bar(tmp_path: Path, seed: int, anchors: int) -> None:
    """The frame of a table is on its axis: to which side the ball is, no derivative tells there."""
    rng = np.random.default_rng(seed)
    (tmp_path / "table.urdf").write_text(TABLE, encoding="utf-8")
    robot = calib.load_robot(tmp_path / "table.urdf")
    ball, places = np.array([0.25, 0.1, 0.05]), rng.uniform(-0.8, 0.8, (anchors, 3))
    turns, own = rng.uniform(-3.0, 3.0, 36), np.arange(36) % anchors
    points = Rotation.from_euler("z", turns[:, None]).apply(ball) + np.array([0.0, 0.0, 0.3])
    length = np.linalg.norm(points - places[own], axis=1) + rng.normal(scale=5e-6, size=36)
    columns: dict[str, object] = {"c [rad]": turns, "length [m]": length, "target": [f"A{k}" for k in own]}
    data = calib.read_measurements(columns, robot, "distance", sigma=5e-6)
    fit = identify(calib.error_model(robot, offsets=(), placements=(), base="fixed", tool="position"), data)
    assert fit.converged
    assert np.sqrt(np.mean(fit.residuals[0] ** 2)) < 1.2 * 5e-6
