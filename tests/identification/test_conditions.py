"""Backlash and temperature: terms of rows that say more than readings, found again and carried through."""

import json
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import calib
from calib.assessment.choice import candidates, choose_terms
from calib.assessment.trust import remarks
from calib.compensation import targets
from calib.compensation.commands import for_joint_targets
from calib.foundations.errors import JobError, MeasurementError, RobotError
from calib.identification.machine import Frames
from calib.identification.system import Problem
from calib.machine.identified import outside_identified
from calib.machine.model_file import machine_files, model_json
from calib.machine.of_fit import machine_of
from calib.machine.tool_uncertainty import tool_uncertainty
from calib.measurement.checks import unreached
from calib.measurement.table import table_from_arrays
from calib.robot.conditions import Conditions, in_order, joined, ordinary
from tests.support import jacobians, machines
from tests.support.gears import UR10, geared

Array = np.ndarray
SIGMA = 5e-5


class Lab:
    """A UR10 with gaps in its gears, of which the zeros wander as it warms up; anywhere in the room."""

    def __init__(self, seed: int, n: int = 300) -> None:
        self.rng = rng = np.random.default_rng([seed, 5])
        self.robot, self.plain = machines.load(*UR10), machines.arm(*UR10)
        self.badly_made = self.plain.moved(rng)
        self.base = machines.anywhere(rng)
        self.gaps = rng.uniform(0.5e-4, 3e-4, 6)
        self.drifts = rng.normal(scale=2e-5, size=6)
        self.readings = self.plain.draw(rng, n)
        self.sides = rng.choice([-1.0, 1.0], (n, 6))
        self.degrees = rng.uniform(15.0, 40.0, n)
        self.joints = [reading.name for reading in self.robot.readings]

    def points(self, readings: Array, sides: Array, degrees: Array) -> Array:
        """True tool points (N, 3)."""
        extra: Callable[[Array], Array] = lambda _: sides * self.gaps + (degrees - 20.0)[:, None] * self.drifts  # noqa: E731
        tools = {"tool": machines.pose((0.05, 0.02, 0.15))}
        return machines.Machine(geared(self.badly_made, extra), self.base, tools).see(readings)[:, :3, 3]

    def columns(self, sigma: float = SIGMA) -> dict[str, object]:
        x = self.points(self.readings, self.sides, self.degrees)
        x = x + sigma * self.rng.standard_normal(x.shape)
        found: dict[str, object] = {f"{joint} [rad]": self.readings[:, k] for k, joint in enumerate(self.joints)}
        found |= {f"{axis} [m]": x[:, k] for k, axis in enumerate("xyz")}
        found |= {f"direction_{joint}": words(self.sides[:, k]) for k, joint in enumerate(self.joints)}
        return found | {"temperature [degC]": self.degrees}

    def model(self, **options: object) -> calib.ErrorModel:
        return machines.model(
            self.robot, **({"offsets": "all", "placements": "all", "backlash": "all", "thermal": "all"} | options)
        )


def words(sides: Array) -> list[str]:
    return ["+" if side > 0.0 else "-" if side < 0.0 else "0" for side in sides]


def test_both_are_found_within_their_intervals() -> None:
    inside, total = 0, 0
    for seed in range(6):
        lab = Lab(seed)
        fit = calib.identify(lab.model(), calib.read_measurements(lab.columns(), lab.robot, sigma=SIGMA))
        sigmas = dict(zip([p.name for p in fit.parameters], fit.sigmas, strict=True))
        for k, joint in enumerate(lab.joints[1:5], start=1):
            for kind, truth in (("backlash", lab.gaps[k]), ("thermal", lab.drifts[k])):
                inside += abs(fit.value(f"{joint}.{kind}") - truth) < 1.96 * sigmas[f"{joint}.{kind}"]
                total += 1
        units = {p.name: p.unit for p in fit.parameters}
        assert (units[f"{lab.joints[0]}.backlash"], units[f"{lab.joints[0]}.thermal"]) == ("rad", "rad/K")
    assert total == 48
    assert 43 <= inside <= 48


@pytest.mark.parametrize(("sign", "said"), [(1.0, ["backlash-above-zero"]), (-1.0, [])])
def test_gaps_by_which_joints_are_ahead_of_their_readings_are_told(sign: float, said: list[str]) -> None:
    """Sides that are told the wrong way round explain the same rows."""
    lab = Lab(18)
    lab.gaps = sign * lab.gaps
    found = remarks(calib.identify(lab.model(), calib.read_measurements(lab.columns(), lab.robot, sigma=SIGMA)))
    assert [finding.code for finding in found] == said


def test_without_noise_unseen_tips_are_exact_whatever_the_conditions() -> None:
    lab = Lab(11)
    fit = calib.identify(lab.model(), calib.read_measurements(lab.columns(0.0), lab.robot))
    unseen, sides = lab.plain.draw(lab.rng, 100), lab.rng.choice([-1.0, 0.0, 1.0], (100, 6))
    degrees = lab.rng.uniform(0.0, 60.0, 100)
    frames = fit.machine.frames
    tips = fit.robot.tips(unseen, fit.deviations, Conditions(sides, degrees))
    found = (frames.base @ tips @ frames.tools[0])[:, :3, 3]
    assert np.abs(found - lab.points(unseen, sides, degrees)).max() < 1e-11


def test_columns_match_central_differences() -> None:
    lab = Lab(12, 6)
    model = lab.model(gain="all", harmonics="all")
    parameters = model.parameters()
    x = lab.rng.uniform(-0.05, 0.05, len(parameters))
    data = calib.read_measurements(lab.columns(), lab.robot)
    problem = Problem(model, parameters, Frames(np.eye(4)[None], np.eye(4)[None]), (data,))

    jacobians.check(problem, x)


def test_measured_torques_wind_drives_up() -> None:
    """Torques that no gravity explains, in the table; what slides has none."""
    inside = 0
    for seed in range(5):
        lab = Lab(30 + seed)
        compliances = lab.rng.uniform(0.5e-5, 3e-5, 6)
        torques = lab.rng.uniform(-30.0, 30.0, lab.readings.shape)
        lab.sides = -torques * compliances / lab.gaps
        columns = lab.columns() | {f"tau_{joint} [Nm]": torques[:, k] for k, joint in enumerate(lab.joints)}
        told = {name: values for name, values in columns.items() if not name.startswith("direction")}
        fit = calib.identify(
            lab.model(backlash="none", torque="all"), calib.read_measurements(told, lab.robot, sigma=SIGMA)
        )
        sigmas = dict(zip([p.name for p in fit.parameters], fit.sigmas, strict=True))
        for joint, truth in zip(lab.joints[1:5], compliances[1:5], strict=True):
            inside += abs(fit.value(f"{joint}.torque") - truth) < 1.96 * sigmas[f"{joint}.torque"] < truth
    assert inside >= 17
    with pytest.raises(JobError, match="torque: 'bridge' slides, and torques are of joints that turn"):
        machines.model(machines.load(machines.INLINE["gantry"], "tip"), torque=["bridge"])


def test_the_order_of_rows_tells_the_sides() -> None:
    readings = np.array([[0.0, 1.0], [0.5, 1.0], [0.5, 0.5], [0.2, 0.5], [0.3, 0.9]])
    expected = [[0, 0], [1, 0], [1, -1], [-1, -1], [1, 1]]
    np.testing.assert_array_equal(in_order(readings), expected)
    lab = Lab(13, 5)
    columns = {k: v for k, v in lab.columns().items() if not k.startswith("direction")}
    data = calib.read_measurements(columns, lab.robot, in_order=True)
    # From where the first one was reached nobody knows.
    expected = in_order(lab.readings)[1:]
    np.testing.assert_array_equal(data.readings, lab.readings[1:])
    np.testing.assert_array_equal(data.conditions.approach, expected)
    np.testing.assert_array_equal(data.subset([3, 1]).conditions.approach, expected[[3, 1]])


def test_rows_before_a_joint_has_moved_are_left_out_with_their_pairs() -> None:
    """The arm may rest at its first pose, and a pair is as well known as its worse end."""
    lab = Lab(13, 8)
    told = {k: v for k, v in lab.columns().items() if not k.startswith("direction")}
    rested = {name: np.concatenate([values[:1], values]) for name, values in told.items()}
    assert calib.read_measurements(rested, lab.robot, in_order=True).lines[0] == 2 + int(
        calib.read_measurements(told, lab.robot).lines[0]
    )
    assert calib.read_measurements(rested, lab.robot, in_order=True).unreached == 2
    still = {name: np.repeat(values[:1], 3) for name, values in told.items()}
    assert len(calib.read_measurements(still, lab.robot, in_order=True)) == 3
    pairs = {k: v for k, v in told.items() if k not in ("x [m]", "y [m]", "z [m]")}
    pairs |= {"length [m]": np.repeat(0.3, 8), "pair": ["a", "b", "a", "b", "c", "c", "d", "d"]}
    found = calib.read_measurements(pairs, lab.robot, "pair_distance", in_order=True, sigma=SIGMA)
    assert (len(found), unreached(found)) == (3, ())


def test_rows_are_left_out_until_every_joint_has_moved_that_moves_at_all() -> None:
    """In the middle, a joint that stands on one flank seems to jump when it first moves."""
    lab = Lab(13, 8)
    told = {k: v for k, v in lab.columns().items() if not k.startswith("direction")}
    wrist, still = lab.robot.readings[5].name, lab.robot.readings[4].name
    told |= {f"{wrist} [rad]": np.append(np.full(3, 0.2), told[f"{wrist} [rad]"][3:]), f"{still} [rad]": np.zeros(8)}
    found = calib.read_measurements(told, lab.robot, in_order=True)
    assert (len(found), found.unreached) == (5, 3)
    assert set(np.unique(found.conditions.approach[:, [0, 1, 2, 3, 5]])) == {-1.0, 1.0}
    assert not found.conditions.approach[:, 4].any()
    assert "3 rows, before every joint has moved" in unreached(found)[0].sentence
    # Where that leaves out most, as of axes that are turned one by one, so much is not asked.
    told[f"{wrist} [rad]"] = np.append(np.full(6, 0.2), told[f"{wrist} [rad]"][6:])
    found = calib.read_measurements(told, lab.robot, in_order=True)
    assert (len(found), found.unreached) == (7, 1)


@pytest.mark.parametrize(("column", "names"), [("tool", "tools"), ("setup", "setups")])
def test_what_only_the_row_had_that_is_left_out_is_not_calibrated(column: str, names: str) -> None:
    """It would be a tool or base that no row tells of."""
    lab = Lab(13, 8)
    told = {k: v for k, v in lab.columns().items() if not k.startswith("direction")}
    data = calib.read_measurements(told | {column: ["first", *["usual"] * 7]}, lab.robot, in_order=True)
    assert getattr(data, names) == ("usual",)


def test_a_sound_arm_with_backlash_is_trusted_by_the_order_of_its_rows() -> None:
    """With the first row as reached from neither side, the base seemed to jump, and all was doubted."""
    lab = Lab(13, 60)
    lab.sides = np.array(in_order(lab.readings))
    lab.sides[0] = 1.0
    columns = {k: v for k, v in lab.columns().items() if not k.startswith("direction")}
    found = calib.assess(
        calib.identify(lab.model(), calib.read_measurements(columns, lab.robot, sigma=SIGMA, in_order=True))
    )
    assert found.doubts == ()


def test_one_column_may_speak_for_all_joints() -> None:
    lab = Lab(14, 4)
    columns = {k: v for k, v in lab.columns().items() if not k.startswith("direction")}
    data = calib.read_measurements(columns | {"direction": ["+", "-", "0", "+"]}, lab.robot)
    np.testing.assert_array_equal(data.conditions.approach, np.outer([1, -1, 0, 1], np.ones(6)))
    np.testing.assert_array_equal(data.conditions.temperature, lab.degrees)


def test_conditions_of_several_sets_are_joined_where_all_have_them() -> None:
    whole = Conditions(np.ones((2, 3)), np.array([20.0, 21.0]))
    both = joined([(2, whole), (2, whole)])
    assert both.approach is not None
    assert both.approach.shape == (4, 3)
    assert joined([(2, whole), (1, Conditions(temperature=np.zeros(1)))]).approach is None
    assert joined([]).temperature is None


@pytest.mark.parametrize(
    ("change", "options", "sentence"),
    [
        ({"temperature [degC]": None}, {}, "there is no column 'temperature', which shoulder_pan_joint.thermal needs"),
        (
            {"tau_elbow_joint [Nm]": [1.0] * 20},
            {},
            "no column 'tau_shoulder_pan_joint', which shoulder_pan_joint.torque",
        ),
        (
            {"direction_elbow_joint": None},
            {},
            "there is no column 'direction_elbow_joint', which elbow_joint.backlash needs",
        ),
        (
            {"direction_elbow_joint": ["+", "up"] * 10},
            {},
            "arrays:1: column 'direction_elbow_joint': 'up' is not a side of approach; allowed are +, -, 0, 1, -1",
        ),
        ({"direction": ["+"] * 20}, {}, "given twice, by direction and by direction_shoulder_pan_joint; keep one"),
        ({}, {"in_order": True}, "given twice, by the order of the rows and by direction_shoulder_pan_joint; keep one"),
        ({"direction_elbow": ["+"] * 20}, {}, "column 'direction_elbow' is neither a joint nor a known column"),
    ],
)
def test_what_is_missing_or_wrong_is_told(change: dict[str, object], options: dict[str, bool], sentence: str) -> None:
    lab = Lab(15, 20)
    columns = {name: values for name, values in (lab.columns() | change).items() if values is not None}
    with pytest.raises(MeasurementError) as caught:
        torque = "all" if any(name.startswith("tau") for name in columns) else "none"
        calib.identify(lab.model(torque=torque), calib.read_measurements(columns, lab.robot, **options))
    assert sentence in str(caught.value)


def test_they_are_chosen_where_they_are_and_offered_where_they_can_be_seen() -> None:
    lab = Lab(16)
    data = calib.read_measurements(lab.columns(), lab.robot, sigma=SIGMA)
    chosen = choose_terms(calib.error_model(lab.robot, offsets="all", placements="all"), data).terms
    assert {term.kind for term in chosen} >= {"backlash", "thermal"}
    still = replace(data, conditions=Conditions(np.ones((len(data), 6)), np.full(len(data), 20.0)))
    offered = {term.kind for c in candidates(lab.robot, [still]) for term in c.terms}
    assert not offered & {"backlash", "thermal"}


@pytest.fixture
def folder(tmp_path: Path) -> tuple[Path, calib.Fit]:
    lab = Lab(17)
    fit = calib.identify(lab.model(), calib.read_measurements(lab.columns(), lab.robot, sigma=SIGMA))
    (tmp_path / "model.json").write_text(model_json(machine_of(fit)), encoding="utf-8")
    (tmp_path / "nominal.urdf").write_bytes(fit.robot.urdf.source)
    return tmp_path, fit


def test_the_model_read_back_and_its_commands_know_them(folder: tuple[Path, calib.Fit]) -> None:
    path, fit = folder
    model, rng = calib.load_machine(path), np.random.default_rng(0)
    u = rng.uniform(-0.5, 0.5, (30, 6)) + np.array([0.0, 0.0, 1.2, 0.0, 1.5, 0.0])
    told = Conditions(rng.choice([-1.0, 1.0], (30, 6)), rng.uniform(10.0, 40.0, 30))
    np.testing.assert_allclose(model.tips(u, told), fit.robot.tips(u, fit.deviations, told), rtol=0, atol=1e-13)
    assert {term["kind"] for term in json.loads((path / "model.json").read_text())["terms"]} == {"backlash", "thermal"}
    found = for_joint_targets(model, u, conditions=told)
    assert found.reached.all(), found.reasons
    np.testing.assert_allclose(model.tips(found.readings, told), model.robot.tips(u), rtol=0, atol=2e-6)
    with pytest.raises(RobotError, match=r"shoulder_pan_joint\.backlash needs '"):
        model.tips(u)
    with pytest.raises(JobError, match="for every target"):
        for_joint_targets(model, u)


def test_what_nobody_says_adds_nothing(folder: tuple[Path, calib.Fit]) -> None:
    """A scene or a map of the workspace has no rows: reached from neither side, at 20 degC."""
    _, fit = folder
    u = np.random.default_rng(2).uniform(-1.0, 1.0, (5, 6))
    plain = fit.robot.tips(u, replace(fit.deviations, terms=np.zeros_like(fit.deviations.terms)))
    np.testing.assert_allclose(fit.robot.tips(u, fit.deviations, ordinary(u)), plain, rtol=0, atol=1e-15)
    found = tool_uncertainty(machine_of(fit), u)
    assert np.isfinite(found.position).all()


def test_targets_of_a_table_say_them(folder: tuple[Path, calib.Fit]) -> None:
    path, fit = folder
    model = calib.load_machine(path)
    u = np.random.default_rng(1).uniform(-0.5, 0.5, (4, 6)) + np.array([0.0, 0.0, 1.0, 0.0, 1.5, 0.0])
    columns: dict[str, object] = {f"{r.name} [rad]": u[:, k] for k, r in enumerate(fit.robot.readings)}
    said = columns | {"direction": ["+", "-", "-", "+"], "temperature [degC]": [20.0, 25.0, 30.0, 35.0]}
    wanted = targets.targets(table_from_arrays(said), model)
    found = targets.corrections(model, wanted)
    assert found.reached.all(), found.reasons
    np.testing.assert_allclose(model.tips(found.readings, wanted.conditions), model.robot.tips(u), rtol=0, atol=2e-6)
    with pytest.raises(MeasurementError, match=r"which shoulder_pan_joint\.backlash of the machine needs"):
        targets.targets(table_from_arrays(columns), model)


def test_a_temperature_beyond_those_that_were_measured_is_outside(folder: tuple[Path, calib.Fit]) -> None:
    path, fit = folder
    found, degrees = machine_of(fit), fit.measurements[0].conditions.temperature
    assert degrees is not None
    for name, content in machine_files(found).items():
        (path / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    again, u = calib.load_machine(path), np.zeros((3, 6))
    assert again.known_uncertainty.conditions == {"temperature": (degrees.min(), degrees.max())}
    assert outside_identified(again, u) == ()
    told = Conditions(temperature=np.array([np.nan, 41.0, 60.0]))
    assert outside_identified(again, u, told) == (
        f"The temperature is outside the range it was identified in, {degrees.min():.4g} to {degrees.max():.4g} degC, "
        "in 1 of 3 rows; the farthest is 60 degC.",
    )


@pytest.mark.parametrize("rows", [0, 4, 6])
def test_conditions_of_other_rows_are_one_sentence(rows: int) -> None:
    robot = calib.error_model(machines.load(*UR10), terms={"thermal": ["elbow_joint"], "backlash": "all"}).robot
    drifting = replace(robot.no_deviations(), terms=np.full(len(robot.terms), 1e-5))
    machine = calib.CalibratedMachine(robot, drifting, np.eye(4), {"tool": np.eye(4)})
    readings = np.zeros((5, 6))
    of_others = Conditions(approach=np.ones((rows, 6)), temperature=np.full(rows, 25.0))
    said = rf"conditions: approach has the shape \({rows}, 6\); of these rows it is \(5, 6\)"
    for asked in (machine.predict, machine.tool_jacobian):
        with pytest.raises(RobotError, match=said):
            asked(readings, conditions=of_others)
    with pytest.raises(RobotError, match=said):
        for_joint_targets(machine, readings, conditions=of_others)


@pytest.mark.parametrize(("value", "shown"), [(np.inf, "inf"), (-1e300, "-1e+300"), (-301.0, "-301")])
def test_conditions_beyond_all_ranges_are_one_sentence(value: float, shown: str) -> None:
    robot = calib.error_model(machines.load(*UR10), terms={"thermal": ["elbow_joint"]}).robot
    drifting = replace(robot.no_deviations(), terms=np.full(len(robot.terms), 1e-5))
    machine = calib.CalibratedMachine(robot, drifting, np.eye(4), {"tool": np.eye(4)})
    told = Conditions(temperature=np.array([20.0, np.nan, value]))
    with pytest.raises(
        RobotError, match=rf"^conditions: temperature of row 2 is {re.escape(shown)}; allowed is -300 to 10000 degC"
    ):
        machine.predict(np.zeros((3, 6)), conditions=told)
