"""Payloads and gravity that differ from row to row, and what hangs on other arms: simulated by numpy, and found."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import calib
from calib.assessment.trust import remarks
from calib.foundations.errors import JobError, MeasurementError, RobotError
from calib.identification import system
from calib.identification.identify import residuals_of
from calib.identification.machine import Frames
from calib.identification.system import Problem
from calib.machine.identified import outside_identified
from calib.machine.model_file import machine_files
from calib.robot.conditions import NO_CONDITIONS, Conditions
from calib.robot.gravity import Holding, Load, Payload
from calib.robot.joint_terms import in_setup, weights_of
from calib.robot.load import load_robot
from calib.robot.urdf import parse_urdf
from tests.support import machines
from tests.support.gears import UR10
from tests.support.machines import Array
from tests.support.sagging import BALL, CENTRE, DOWN, SOFT, WALL, Sagging, arm, two_arms

IRB = Path(__file__).resolve().parents[2] / "robots" / "irb2400" / "irb2400.urdf"
LOOP = calib.ClosedLoop("parallelogram", ("rod_end", "rear_lever_pin"), ("x", "z"), ("elbow", "rod"))
SIGMA = 3e-5


def rows(
    machine: Sagging,
    robot: calib.Robot,
    rng: np.random.Generator,
    n: int,
    base: Array,
    gravity: tuple[float, float, float] = DOWN,
    mass: float = 0.0,
    sigma: float = SIGMA,
) -> calib.Measurements:
    u = machines.arm(*UR10).draw(rng, n)
    names = [reading.name for reading in robot.readings]
    carried = {"tool0": (mass, CENTRE)}
    x = np.array(
        [(base @ machine.tip("tool0", dict(zip(names, q, strict=True)), gravity, carried) @ BALL)[:3, 3] for q in u]
    )
    x += sigma * rng.standard_normal(x.shape)
    columns: dict[str, object] = {f"{name} [rad]": u[:, k] for k, name in enumerate(names)}
    return calib.read_measurements(columns | {f"{a} [m]": x[:, k] for k, a in enumerate("xyz")}, robot, sigma=SIGMA)


def rms(residuals: Array) -> float:
    return float(np.sqrt(np.mean(residuals**2)))


def test_drives_that_rise_under_weight_are_told() -> None:
    """Of gravity upside down every compliance has the wrong sign, and positions are as well explained."""
    rng = np.random.default_rng(12)
    robot, machine, base = calib.load_robot(*UR10), arm(rng), machines.anywhere(rng)
    data = rows(machine, robot, rng, 60, base)
    for gravity, told in ((DOWN, False), ((0.0, 0.0, 9.81), True)):
        hung = calib.load_robot(*UR10, gravity=gravity)
        fit = calib.identify(machines.model(hung, offsets="all", placements="all", elastic=list(SOFT)), data)
        found = [one for one in remarks(fit) if one.code == "compliance-below-zero"]
        assert len(found) == told
    assert "'shoulder_lift_joint'" in found[0].sentence
    assert "Check the direction of gravity" in found[0].sentence


def test_three_tables_with_three_payloads_calibrate_in_one_job() -> None:
    """Compliances to 4 sigma, held out to the noise; told of no payloads, far from it."""
    rng = np.random.default_rng(11)
    robot, machine, base = calib.load_robot(*UR10), arm(rng), machines.anywhere(rng)
    masses = (0.0, 1.25, 2.5)
    tables = [rows(machine, robot, rng, 50, base, mass=mass) for mass in masses]
    judges = [rows(machine, robot, rng, 20, base, mass=mass) for mass in masses]
    model = machines.model(robot, offsets="all", placements="all", elastic=list(SOFT))

    def told(data: calib.Measurements, mass: float) -> calib.Measurements:
        return data.carrying(robot, Payload(mass, CENTRE))

    fit = calib.identify(model, [told(data, mass) for data, mass in zip(tables, masses, strict=True)])
    assert fit.converged
    sigmas = dict(zip([p.name for p in fit.parameters], fit.sigmas, strict=True))
    for joint, truth in SOFT.items():
        assert abs(fit.value(f"{joint}.elastic") - truth) < 4.0 * sigmas[f"{joint}.elastic"]
        assert sigmas[f"{joint}.elastic"] < 0.2 * truth
    calibrated = calib.machine_of(fit)
    for data, mass in zip(judges, masses, strict=True):
        assert rms(calibrated.residuals(told(data, mass))) < 1.2 * SIGMA
    untold = calib.machine_of(calib.identify(model, tables))
    assert rms(untold.residuals(judges[2])) > 1.5 * SIGMA


def test_a_robot_on_a_wall_and_on_the_floor_is_one_machine(tmp_path: Path) -> None:
    """Set-ups bear their own gravity and payload: in the fit, from the file, and for whoever asks the machine."""
    rng = np.random.default_rng(12)
    loads = {"wall": Load(WALL, Payload(2.5, CENTRE))}
    robot, machine = calib.load_robot(*UR10).with_loads(loads), arm(rng)
    bases = {"floor": machines.anywhere(rng), "wall": machines.anywhere(rng)}
    told = {"floor": (DOWN, 0.0), "wall": (WALL, 2.5)}
    tables = [rows(machine, robot, rng, 60, bases[name], *told[name]).named(setup=name) for name in told]
    model = machines.model(robot, offsets="all", placements="all", elastic=list(SOFT))
    fit = calib.identify(model, tables)
    assert max(map(rms, fit.residuals)) < 1.1 * SIGMA
    blind = calib.identify(
        machines.model(calib.load_robot(*UR10), offsets="all", placements="all", elastic=list(SOFT)), tables
    )
    assert rms(blind.residuals[1]) > 2.0 * rms(fit.residuals[1])
    found = calib.machine_of(fit)
    for name, content in machine_files(found).items():
        (tmp_path / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    for one in (found, calib.load_machine(tmp_path)):
        for first in ("wall", "floor"):  # there and back again
            for name, load in told.items():
                data = rows(machine, robot, rng, 12, bases[name], *load).named(setup=name)
                there = one.at(first).at(name)
                assert rms(there.residuals(data)) < 1.5 * SIGMA
                missed = there.predict(data.readings)[:, :3, 3] - data.position
                assert rms(missed) < 1.5 * SIGMA
                assert calib.verify(one, data, limit=0.5e-3).passed
        assert one.at("wall").robot.load == loads["wall"]
        assert one.at("floor").robot.load == Load()


def test_what_the_other_arm_holds_weighs_on_the_torso() -> None:
    """The other arm, at its own readings and with a payload in its hand, bends the torso of the one that is seen."""
    rng, text = np.random.default_rng(13), two_arms()
    truth = Sagging(text, {"lean": 4e-5, "left_lift": 3e-5, "right_lift": 2e-5})
    robot = load_robot(parse_urdf(text.encode(), "two.urdf"), "left_hand", links=["right_hand"])
    names = [reading.name for reading in robot.readings]
    assert set(names) == {"lean", "left_lift", "left_bend", "right_lift", "right_bend"}
    base, marks = machines.anywhere(rng), {"left": (0.1, 0.03, 0.02), "right": (0.08, -0.02, 0.05)}
    carried = {"right_hand": (4.0, (0.1, 0.0, 0.05))}

    def measured(side: str, n: int) -> calib.Measurements:
        u = rng.uniform(-1.2, 1.2, (n, len(names)))
        x = [
            (base @ truth.tip(f"{side}_hand", dict(zip(names, q, strict=True)), payloads=carried) @ [*marks[side], 1])[
                :3
            ]
            for q in u
        ]
        columns: dict[str, object] = {f"{name} [rad]": u[:, k] for k, name in enumerate(names)}
        columns |= {f"{a} [m]": np.array(x)[:, k] + SIGMA * rng.standard_normal(n) for k, a in enumerate("xyz")}
        data = calib.read_measurements(columns, robot.with_tip(f"{side}_hand"), sigma=SIGMA).named(tool=side)
        return data.carrying(robot, Payload(*carried["right_hand"], link="right_hand"))

    terms = list(truth.compliances)
    fit = calib.identify(machines.model(robot, elastic=terms), [measured("left", 50), measured("right", 50)])
    for joint, compliance in truth.compliances.items():
        assert fit.value(f"{joint}.elastic") == pytest.approx(compliance, rel=0.02)
    held_out = [measured("left", 20), measured("right", 20)]
    assert max(map(rms, residuals_of(fit, held_out, fit.machine))) < 1.2 * SIGMA
    # So its joints have a range for the tool of either arm.
    q = np.zeros((1, len(names)))
    q[0, names.index("right_lift")] = 2.0
    assert len(outside_identified(calib.machine_of(fit), q, tool="left")) == 1
    # An arm alone, whose torso knows nothing of the other one, does not come near.
    alone = load_robot(parse_urdf(text.encode(), "two.urdf"), "left_hand")
    left = fit.measurements[0]
    columns = {f"{name} [rad]": left.readings[:, names.index(name)] for name in (r.name for r in alone.readings)}
    columns |= {f"{a} [m]": left.position[:, k] for k, a in enumerate("xyz")}
    lonely = calib.identify(
        machines.model(alone, elastic=["lean", "left_lift"]), calib.read_measurements(columns, alone, sigma=SIGMA)
    )
    assert rms(lonely.residuals[0]) > 3.0 * SIGMA


@pytest.mark.parametrize("torso", ["soft", "stiff"])
def test_only_what_hangs_on_the_same_joints_has_to_be_told(torso: str) -> None:
    """Tables of two soft arms that tell the joints of their own arm alone: sound where no soft joint carries both."""
    rng, text = np.random.default_rng(14), two_arms()
    truth = Sagging(text, {"left_lift": 3e-5, "right_lift": 2e-5})
    robot = load_robot(parse_urdf(text.encode(), "two.urdf"), "left_hand", links=["right_hand"])
    base = machines.anywhere(rng)

    def measured(side: str) -> calib.Measurements:
        names = [reading.name for reading in robot.readings if reading.name.startswith(("lean", side))]
        u = rng.uniform(-1.2, 1.2, (40, len(names)))
        at = [dict.fromkeys([r.name for r in robot.readings], 0.0) | dict(zip(names, q, strict=True)) for q in u]
        x = np.array([(base @ truth.tip(f"{side}_hand", q) @ [0.1, 0.03, 0.02, 1])[:3] for q in at])
        columns: dict[str, object] = {f"{name} [rad]": u[:, k] for k, name in enumerate(names)}
        columns |= {f"{a} [m]": x[:, k] + SIGMA * rng.standard_normal(40) for k, a in enumerate("xyz")}
        return calib.read_measurements(columns, robot.with_tip(f"{side}_hand"), sigma=SIGMA).named(tool=side)

    elastic = [*truth.compliances, *(["lean"] if torso == "soft" else [])]
    model, tables = machines.model(robot, elastic=elastic), [measured("left"), measured("right")]
    if torso == "stiff":
        assert model.robot.bearing_on(("right_hand",)) == ("lean", "right_lift", "right_bend")
        fit = calib.identify(model, tables)
        for joint, compliance in truth.compliances.items():
            assert fit.value(f"{joint}.elastic") == pytest.approx(compliance, rel=0.03)
        assert calib.verify(calib.machine_of(fit), measured("right")).passed
        return
    assert set(model.robot.bearing_on(("right_hand",))) == {reading.name for reading in robot.readings}
    with pytest.raises(MeasurementError, match=r"no column 'right_lift', 'right_bend' of a joint, .* loads on joints"):
        calib.identify(model, tables)
    tools, tips = {"left": BALL, "right": BALL}, {"right": "right_hand"}
    machine = calib.CalibratedMachine(model.robot, model.robot.no_deviations(), base, tools, tool_tips=tips)
    with pytest.raises(MeasurementError, match=r"no column 'left_lift', 'left_bend' of a joint, .* loads on joints"):
        machine.residuals(tables[1])
    # Of a tool of the other arm, the columns are not what is wrong.
    with pytest.raises(MeasurementError, match="the tool 'left' is on 'left_hand', and the rows are of 'right_hand'"):
        machine.residuals(replace(tables[1], tools=("left",)))


def arms() -> list[calib.Robot]:
    return [load_robot(*UR10, links=["wrist_3_link"]), load_robot(IRB, "tool0", loops=[LOOP])]


@pytest.mark.parametrize("robot", arms(), ids=["chain", "closed loop"])
def test_a_load_that_is_told_holds_as_one_of_the_robot(robot: calib.Robot) -> None:
    rng = np.random.default_rng(3)
    u = rng.uniform(-0.5, 0.5, (5, len(robot.readings)))
    payload, gravity = Payload(4.0, (0.1, -0.05, 0.2)), (3.0, -2.0, -8.0)
    own = replace(robot, payload=Payload(1.5, (0.0, 0.1, 0.0)))
    known = Holding(weights_of(replace(robot, payload=payload, gravity=gravity)))(u)
    moments = np.tile(robot.moments(payload), (5, 1, 1))
    told = Conditions(payload=moments, gravity=np.tile(gravity, (5, 1)))
    np.testing.assert_allclose(Holding(weights_of(own))(u, told), known, rtol=0, atol=1e-9)
    # Rows of which nothing is told hold what the robot itself carries.
    some = (np.arange(5) < 2)[:, None]
    told = Conditions(payload=np.where(some[:, None], moments, np.nan), gravity=np.where(some, gravity, np.nan))
    found = Holding(weights_of(own))(u, told)
    np.testing.assert_allclose(found[:2], known[:2], rtol=0, atol=1e-9)
    np.testing.assert_allclose(found[2:], Holding(weights_of(own))(u)[2:], rtol=0, atol=1e-12)
    assert np.abs(known[2:] - found[2:]).max() > 1.0


@pytest.mark.parametrize("looped", [False, True], ids=["chain", "closed loop"])
def test_columns_match_central_differences_under_loads(looped: bool) -> None:
    """All parameters, rows under three loads, coefficients three times as large as ordinary ones."""
    rng = np.random.default_rng(4)
    loads = {"wall": Load(WALL, Payload(2.0, (0.0, 0.1, 0.0)))}
    robot = load_robot(IRB, "tool0", loops=[LOOP]).with_loads(loads) if looped else load_robot(*UR10).with_loads(loads)
    terms = {"moments": ["joint_2", "joint_3"]} if looped else {"elastic": "all", "lateral": "all", "bending": "all"}
    model = machines.model(robot, offsets="all", placements="all", **terms)
    n = 6
    u = rng.uniform(-0.4, 0.4, (n, len(robot.readings)))
    columns: dict[str, object] = {f"{reading.name} [rad]": u[:, k] for k, reading in enumerate(robot.readings)}
    columns |= {f"{a} [m]": rng.uniform(-1, 1, n) for a in "xyz"}
    columns["setup"] = ["wall", "floor"] * 3
    data = calib.read_measurements(columns, robot)
    if not looped:
        data = replace(data.carrying(robot, Payload(5.0, (0.0, 0.0, 0.2))))
    data = data.loaded(robot)
    assert data.conditions.gravity is not None
    assert len(np.unique(data.conditions.gravity, axis=0)) == 2
    parameters = model.parameters(data.tools, data.setups)
    reference = Frames(np.stack([machines.anywhere(rng) for _ in data.setups]), machines.anywhere(rng, 0.3)[None])
    problem = Problem(model, parameters, reference, (data,))
    x = rng.uniform(-3, 3, len(parameters)) * [p.scale for p in parameters]
    (J,) = system.jacobian(problem, x)
    for k, parameter in enumerate(parameters):
        h = 1e-5 / max(float(np.abs(J[:, :, k]).max()), 1e-2)
        step = h * (np.arange(len(x)) == k)
        ends = [problem.residuals(x + s)[0] for s in (step, -step)]
        numeric = (ends[0] - ends[1]) / (2.0 * h)
        limit = (1e-5 if looped else 1e-6) * max(float(np.abs(numeric).max()), 1e-3)
        np.testing.assert_allclose(J[:, :, k], numeric, rtol=0, atol=limit, err_msg=parameter.name)


def test_permuted_rows_and_a_turned_world_find_the_same() -> None:
    rng = np.random.default_rng(14)
    robot, machine, base = calib.load_robot(*UR10), arm(rng), machines.anywhere(rng)
    data = rows(machine, robot, rng, 60, base, mass=2.5).carrying(robot, Payload(2.5, CENTRE))
    model = machines.model(robot, offsets="all", placements="all", elastic=list(SOFT))
    fit = calib.identify(model, data)
    shuffled = calib.identify(model, data.subset(rng.permutation(60)))
    turn = machines.anywhere(rng)
    assert data.position is not None
    moved = replace(data, position=data.position @ turn[:3, :3].T + turn[:3, 3])
    carried = calib.identify(model, moved)
    for joint in SOFT:
        name = f"{joint}.elastic"
        assert shuffled.value(name) == pytest.approx(fit.value(name), rel=1e-6)
        assert carried.value(name) == pytest.approx(fit.value(name), rel=1e-5)


def test_masses_that_nobody_states_do_not_follow_a_payload() -> None:
    rng = np.random.default_rng(15)
    robot, machine, base = calib.load_robot(*UR10), arm(rng), machines.anywhere(rng)
    tables = [rows(machine, robot, rng, 15, base), rows(machine, robot, rng, 15, base, mass=2.5)]
    tables[1] = tables[1].carrying(robot, Payload(2.5, CENTRE))
    with pytest.raises(JobError, match="moments: the payload is not the same in all rows"):
        calib.identify(machines.model(robot, moments=["elbow_joint"]), tables)


def test_a_payload_on_a_link_that_is_not_there_is_refused() -> None:
    with pytest.raises(RobotError, match="payload's link 'hand' is not one of the links"):
        load_robot(*UR10, payload=Payload(1.0, link="hand"))
    robot = load_robot(*UR10)
    data = rows(arm(np.random.default_rng(0)), robot, np.random.default_rng(0), 5, np.eye(4))
    with pytest.raises(MeasurementError, match="payload's link 'hand'"):
        data.carrying(robot, Payload(1.0, link="hand"))
    with pytest.raises(RobotError, match="the payload's link 'hand' is not one of the links"):
        load_robot(*UR10).with_loads({"wall": Load(payload=Payload(1.0, link="hand"))})


def test_in_a_set_up_of_which_nothing_is_said_all_is_as_usual() -> None:
    robot = load_robot(*UR10, gravity=WALL).with_loads({"floor": Load()})
    assert in_setup(in_setup(robot, "floor"), "anywhere").load.gravity == WALL


@pytest.mark.parametrize("seed", [12, 13, 14])
def test_regions_hold_under_a_load_that_nobody_told(seed: int) -> None:
    """Rows of that set-up scatter more, and regions there count it; with one noise for all rows more of them miss."""
    rng = np.random.default_rng(seed)
    robot, machine = calib.load_robot(*UR10), arm(rng)
    bases = {"floor": machines.anywhere(rng), "loaded": machines.anywhere(rng)}
    masses = {"floor": 0.0, "loaded": 12.0}
    tables = [rows(machine, robot, rng, 60, bases[name], mass=kg).named(setup=name) for name, kg in masses.items()]
    model = machines.model(robot, offsets="all", placements="all", elastic=list(SOFT))
    found = calib.machine_of(calib.identify(model, tables))
    common = replace(found, uncertainty=replace(found.known_uncertainty, own_noise=()))

    def inside(machine_: calib.CalibratedMachine, name: str) -> float:
        there = machine_.at(name)
        errors = new.position - there.predict(new.readings)[:, :3, 3]
        return float(np.mean(calib.judging.tool_uncertainty(there, new.readings).inside(errors)))

    for name, kg in masses.items():
        new = rows(machine, robot, rng, 200, bases[name], mass=kg, sigma=0.0)
        assert inside(found, name) > 0.88
    assert 1.0 - inside(common, "loaded") > 1.2 * (1.0 - inside(found, "loaded"))


def test_a_payload_beyond_those_that_were_measured_is_outside() -> None:
    rng = np.random.default_rng(5)
    robot, machine, base = calib.load_robot(*UR10), arm(rng), machines.anywhere(rng)
    tables = [
        rows(machine, robot, rng, 40, base, mass=mass).carrying(robot, Payload(mass, CENTRE)) for mass in (0.0, 2.0)
    ]
    found = calib.machine_of(calib.identify(machines.model(robot, offsets="all", elastic=list(SOFT)), tables))
    known, q = found.known_uncertainty, tables[0].readings[:10]
    assert dict(known.conditions) == {"payload": (0.0, 2.0)}
    assert outside_identified(found, q) == outside_identified(found, q, tables[1].conditions.subset(slice(10))) == ()
    heavy = replace(tables[0].subset(np.arange(10)), conditions=NO_CONDITIONS).carrying(robot, Payload(5.0, CENTRE))
    assert outside_identified(found, q, heavy.conditions) == (
        "The payload is outside the range it was identified in, 0 to 2 kg, in 10 of 10 rows; the farthest is 5 kg.",
    )
    # So is one that the set-up bears in which the machine stands.
    again = replace(found, robot=found.robot.with_loads({found.setup: Load(payload=Payload(9.0))}))
    (said,) = outside_identified(again, q)
    assert said.endswith("in 10 of 10 rows; the farthest is 9 kg.")
