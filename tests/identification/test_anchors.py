"""Anchors in unknown places, of which lengths alone tell: on the right side of the arm, and the tool with them."""

from typing import Literal

import numpy as np
import pytest

import calib
from calib.identification.identify import residuals_of
from calib.identification.initialisation.anchors import anchors_anew
from calib.identification.initialisation.problem import initial_problem
from calib.identification.initialisation.target_poses import centre
from calib.identification.machine import values_at
from calib.identification.sanity import signatures
from calib.identification.targets import Target
from tests.support import machines
from tests.support.machines import Array
from tests.support.touching import lab

UR10 = ("example:ur_description/urdf/ur10_robot.urdf", "tool0")
PANDA = ("example:panda_description/urdf/panda.urdf", "panda_hand")
SIGMA = 2e-5
TOOL = (0.08, 0.05, 0.25)


def lengths(
    robot: calib.Robot,
    readings: Array,
    points: Array,
    places: Array,
    target: Array,
    rng: np.random.Generator,
    offset: float | None = None,
    kind: Literal["distance", "sphere"] = "distance",
) -> calib.Measurements:
    measured = np.linalg.norm(points - places[target], axis=1) + rng.normal(scale=SIGMA, size=len(points))
    measured += offset or 0.0
    columns: dict[str, object] = {f"{r.name} [rad]": readings[:, k] for k, r in enumerate(robot.readings)}
    values = {"length [m]": measured} if kind == "distance" else {"diameter [m]": 2.0 * measured}
    columns |= {**values, "target": [f"anchor {t}" for t in target]}
    named = None if offset is None else "bar"
    return calib.read_measurements(columns, robot, kind, sigma=SIGMA, offset=named)


def session(
    anchors: int, each: int, kind: Literal["distance", "sphere"] = "distance"
) -> tuple[calib.Robot, calib.Measurements, calib.Measurements]:
    """A UR10 of which every placement and zero is off, lengths to anchors all around it, and others to judge by."""
    rng = np.random.default_rng(4)
    robot, true = machines.load(*UR10), machines.arm(*UR10).moved(rng)
    places = rng.uniform(-2.0, 2.0, (anchors, 3))
    sets = []
    for n in (each, 2):
        target = np.repeat(np.arange(anchors), n)
        readings = true.draw(rng, len(target))
        points = (true.tips(readings) @ machines.pose(TOOL))[:, :3, 3]
        sets.append(lengths(robot, readings, points, places, target, rng, kind=kind))
    return robot, sets[0], sets[1]


def test_of_an_anchor_on_a_circle_nothing_is_told() -> None:
    """Two lengths leave it anywhere on one: where its tangent lies in a plane of the axes, no coordinate is known."""
    rng = np.random.default_rng(7)
    robot, true = machines.load(*UR10), machines.arm(*UR10).moved(rng)
    places, base, tool = rng.uniform(-2.0, 2.0, (40, 3)), machines.anywhere(rng), machines.pose(TOOL)
    seen = machines.Machine(true, base, {"tool": tool}).measure(
        robot, true.draw(rng, 60), "position", points=["tool"] * 60, rng=rng, sigma=SIGMA, sigma_angle=SIGMA
    )
    target = np.repeat(np.arange(40), 2)
    readings = true.draw(rng, len(target))
    points = (base @ true.tips(readings) @ tool)[:, :3, 3]
    fit = calib.identify(calib.error_model(robot), [seen, lengths(robot, readings, points, places, target, rng)])
    of_targets = np.array([parameter.kind == "target" for parameter in fit.parameters])
    assert fit.unidentifiable[of_targets].all()
    assert not fit.unidentifiable[~of_targets].any()


def test_two_tables_of_balls_of_unknown_radius() -> None:
    """With nothing of a known size, which the search for what no row sees has to know of every table."""
    of = lab(3, noise=1e-5)
    sets = [of.sphere(60, offset="ball"), of.sphere(40, offset="ball")]
    fit = calib.identify(calib.error_model(of.robot, offsets="all", placements="all"), sets)
    assert fit.converged
    assert np.sqrt(np.mean(np.concatenate(fit.residuals) ** 2)) < 2e-5


def test_lengths_find_tool_and_anchors() -> None:
    robot, data, rest = session(60, 8)
    model = calib.error_model(robot, offsets="all", placements="all")
    fit = calib.identify(model, data)
    assert fit.converged
    # Some anchors begin in a wrong place, where residuals of theirs would be centimetres.
    assert np.sqrt(np.mean(fit.residuals[0] ** 2)) < 1.1 * SIGMA
    (missed,) = residuals_of(fit, [rest], fit.machine)
    assert np.sqrt(np.mean(missed**2)) < 3 * SIGMA


@pytest.mark.parametrize("kind", ["distance", "sphere"])
def test_an_anchor_on_the_wrong_side_is_put_where_its_rows_put_it(kind: Literal["distance", "sphere"]) -> None:
    """Balls as well: from touches on a half of one that are off by its radius, its centre begins on the other side."""
    robot, data, _ = session(30, 8, kind)
    model = calib.error_model(robot, offsets="all", placements="all")
    fit = calib.identify(model, data)
    problem = initial_problem(model, (data,))
    x = values_at(model.robot, problem.parameters, fit.machine.frames, fit.machine.deviations)
    assert anchors_anew(problem, x) is None
    own = [k for k, p in enumerate(problem.parameters) if p.name.startswith("target.anchor 7.")]
    wrong = x.copy()
    wrong[own] += (0.5, -0.7, 0.4)
    found = anchors_anew(problem, wrong)
    assert found is not None
    np.testing.assert_allclose(found, x, atol=2e-3)
    others = np.setdiff1d(np.arange(len(x)), own)
    assert np.array_equal(found[others], x[others])


@pytest.mark.parametrize("thickness", [0.02, 0.1, 0.6])
def test_points_that_are_nearly_in_a_plane_tell_the_side(thickness: float) -> None:
    """Points are off by what a nominal robot is, of which the linear equations make half a metre, and a wrong side."""
    rng = np.random.default_rng(2)
    robot, places = machines.load(*UR10), np.array([[0.3, -0.2, 1.5]])
    none = np.zeros((10, 6))
    for _ in range(20):
        turn = machines.anywhere(rng)[:3, :3]
        points = rng.uniform(-0.5, 0.5, (10, 3)) * (1.0, 1.0, thickness) @ turn.T
        place = turn @ places[0]
        data = lengths(robot, none, points, place[None], np.zeros(10, dtype=int), rng)
        off = points + rng.normal(scale=1e-3, size=points.shape)
        assert np.linalg.norm(centre([(data, off, data.value)]) - place) < 0.05


@pytest.mark.parametrize("offset", [None, 0.03])
def test_known_anchors_show_where_the_base_is(offset: float | None) -> None:
    """From a base at rest at the origin, lengths lead to other minima, and to mistakes that nobody made."""
    rng = np.random.default_rng(5)
    robot, arm = machines.load(*UR10), machines.arm(*UR10)
    for _ in range(3):
        true, base = arm.moved(rng), machines.anywhere(rng)
        places = (base @ np.append(rng.normal(size=(4, 3)), np.ones((4, 1)), axis=1).T).T[:, :3]
        target = np.repeat(np.arange(4), 15)
        readings = arm.draw(rng, len(target))
        points = (base @ true.tips(readings) @ machines.pose(TOOL))[:, :3, 3]
        data = lengths(robot, readings, points, places, target, rng, offset)
        known = {f"anchor {t}": Target(machines.pose(place)) for t, place in enumerate(places)}
        model = calib.error_model(robot, offsets="all", placements="all", known=calib.Known(targets=known))
        frames = initial_problem(model, (data,)).reference
        away = np.linalg.inv(frames.bases[0]) @ base
        # As near as a tool of 0.27 m lets it be that is taken for none.
        assert np.linalg.norm(away[:3, 3]) < 0.6
        assert np.arccos((np.trace(away[:3, :3]) - 1.0) / 2.0) < 0.6
        assert signatures(model, [data]) == ()


@pytest.mark.parametrize("seed", [0, 2, 10])
def test_lengths_from_unknown_anchors_are_no_mistake(seed: int) -> None:
    """They begin far away, as nothing shows the tool."""
    rng = np.random.default_rng(seed)
    robot, true = machines.load(*PANDA), machines.arm(*PANDA).moved(rng)
    places, target = rng.normal(size=(3, 3)), np.repeat(np.arange(3), 40)
    readings = true.draw(rng, len(target))
    points = (true.tips(readings) @ machines.pose(TOOL))[:, :3, 3]
    data = lengths(robot, readings, points, places, target, rng, 0.02)
    assert signatures(calib.error_model(robot, offsets="all", placements="all"), [data]) == ()
