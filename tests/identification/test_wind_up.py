"""Drives that give way, on the simulated IRB2400 whose script has its own mechanics: found alone and among others."""

import json
from pathlib import Path

import numpy as np
import pytest

import calib
from calib.assessment.choice import choose_terms
from calib.assessment.linearised import Candidate
from calib.compensation.commands import for_joint_targets
from calib.identification.machine import Frames
from calib.identification.system import Problem
from calib.machine.model_file import model_json
from calib.machine.of_fit import machine_of
from calib.robot.gravity import Payload
from calib.robot.terms import JointTerm
from scripts.simulate import irb2400 as simulation
from tests.support import jacobians, machines

Array = np.ndarray
ROOT = Path(__file__).resolve().parents[2]
URDF = ROOT / "robots" / "irb2400" / "irb2400.urdf"
LOOP = calib.ClosedLoop("parallelogram", ("rod_end", "rear_lever_pin"), ("x", "z"), ("elbow", "rod"))
GEOMETRY = {
    "offsets": ["joint_*"],
    "placements": ["joint_*", "elbow_cancel", "rod_length.tz", "rear_lever_length.tx"],
    "prior_length": 0.3e-3,
    "prior_angle": 0.5e-3,
}
ORDERS = (1, 2, 5, 11)


@pytest.fixture(scope="module")
def robot() -> calib.Robot:
    return calib.load_robot(URDF, "tool0", loops=[LOOP], gravity=(0.0, 0.0, -9.81))


def measurements(robot: calib.Robot, commands_deg: Array, positions_mm: Array) -> calib.Measurements:
    columns = {f"joint_{k + 1} [deg]": commands_deg[:, k] for k in range(6)}
    columns |= {f"{axis} [mm]": positions_mm[:, k] for k, axis in enumerate("xyz")}
    return calib.read_measurements(columns, robot)


@pytest.mark.parametrize("gears", [False, True])
def test_compliances_lie_within_their_intervals(robot: calib.Robot, gears: bool) -> None:
    """Axis 1 lifts nothing; harmonics of the first order imitate what the lower arm holds, and intervals know it."""
    harmonics = {"harmonics": "all", "harmonic_orders": ORDERS} if gears else {}
    model = machines.model(robot, **GEOMETRY, **harmonics, elastic=["joint_[2-6]"])
    inside, total, sigmas = 0, 0, []
    for seed in range(11, 16):
        machine = simulation.Machine(seed, harmonics=gears)
        commands = simulation.poses(seed)["harmonics"]
        measured = machine.measure(commands, simulation.noise(seed, "harmonics"))
        fit = calib.identify(model, measurements(robot, commands, measured))
        names = [parameter.name for parameter in fit.parameters]
        for k, truth in enumerate(machine.truth.compliances[1:], start=2):
            sigma = fit.sigmas[names.index(f"joint_{k}.elastic")]
            if np.isfinite(sigma):
                inside += abs(fit.value(f"joint_{k}.elastic") - truth) < 1.96 * sigma
                total += 1
        sigmas.append(fit.sigmas[names.index("joint_2.elastic")])
    assert total >= 20
    assert inside / total >= 0.85
    if not gears:
        assert max(sigmas) < 0.1e-6


def test_ignoring_it_costs_what_it_does_to_the_tip(robot: calib.Robot) -> None:
    machine, commands = simulation.Machine(3, harmonics=False), simulation.poses(3)
    data = measurements(robot, commands["harmonics"], machine.tcp(commands["harmonics"]))
    test = measurements(robot, commands["test"], machine.tcp(commands["test"]))
    missed = []
    for elastic in ("none", ["joint_[2-6]"]):
        fit = calib.identify(machines.model(robot, **GEOMETRY, elastic=elastic), data)
        tips = fit.machine.frames.base @ fit.robot.tips(test.readings, fit.deviations) @ fit.machine.frames.tools[0]
        missed.append(np.sqrt(np.mean(np.sum((tips[:, :3, 3] - test.position) ** 2, axis=1))))
    assert missed[0] > 10e-6
    assert missed[1] < 1e-6


def test_columns_match_central_differences(robot: calib.Robot) -> None:
    """All terms on the parallelogram, at a point far from zero."""
    rng = np.random.default_rng(5)
    model = machines.model(robot, **GEOMETRY, gain="all", harmonics="all", elastic="all", tool="pose")
    parameters = model.parameters()
    scale = np.array([parameter.typical_size for parameter in parameters])
    x = rng.uniform(-20.0, 20.0, len(parameters)) * scale
    u = rng.uniform(-0.5, 0.5, (6, 6))
    columns: dict[str, object] = {f"joint_{k + 1} [rad]": u[:, k] for k in range(6)}
    columns |= {f"{axis} [m]": rng.uniform(-1.0, 1.0, 6) for axis in "xyz"}
    data = calib.read_measurements(columns, robot)
    problem = Problem(model, parameters, Frames(np.eye(4)[None], np.eye(4)[None]), (data,))

    jacobians.check(problem, x, 1e-2 * scale, within=2e-6, least=1e-2)


def test_it_is_chosen_where_it_is(robot: calib.Robot) -> None:
    machine, commands = simulation.Machine(7, harmonics=False), simulation.poses(7)["harmonics"]
    data = measurements(robot, commands, machine.measure(commands, np.random.default_rng(0)))
    offered = [Candidate((JointTerm(f"joint_{k}", "elastic"),)) for k in range(1, 7)]
    choice = choose_terms(machines.model(robot, **GEOMETRY), data, offered=offered)
    assert {"joint_2", "joint_3"} & {term.reading for term in choice.terms}
    assert choice.model.robot.weights is not None


def test_the_model_read_back_gives_way_alike_and_is_commanded(robot: calib.Robot, tmp_path: Path) -> None:
    loaded = calib.load_robot(URDF, "tool0", loops=[LOOP], payload=Payload(8.0, (0.0, 0.1, 0.2)))
    rng = np.random.default_rng(6)
    u = rng.uniform(-0.5, 0.5, (60, 6)) + np.array([0.0, 0.0, 0.0, 0.0, 0.8, 0.0])
    positions = 1e3 * robot.tips(u)[:, :3, 3] + rng.normal(scale=0.2, size=(60, 3))
    fit = calib.identify(
        machines.model(loaded, offsets="all", elastic="all"), measurements(loaded, np.degrees(u), positions)
    )
    (tmp_path / "model.json").write_text(model_json(machine_of(fit)), encoding="utf-8")
    (tmp_path / "nominal.urdf").write_bytes(URDF.read_bytes())
    model = calib.load_machine(tmp_path)
    np.testing.assert_allclose(model.tips(u), fit.robot.tips(u, fit.deviations), rtol=0, atol=1e-13)
    assert json.loads((tmp_path / "model.json").read_text())["payload"] == {
        "mass": 8.0,
        "position": [0.0, 0.1, 0.2],
        "link": "",
    }
    found = for_joint_targets(model, u)
    assert found.reached.all(), found.reasons
    np.testing.assert_allclose(model.tips(found.readings), loaded.tips(u), rtol=0, atol=2e-6)


def test_gaps_lie_within_their_intervals(robot: calib.Robot) -> None:
    """The script's axes stand two half gaps back where they were reached from the other side."""
    model = machines.model(robot, **GEOMETRY, backlash="all")
    inside = 0
    for seed in range(21, 27):
        machine = simulation.Machine(seed, wind_up=False, harmonics=False)
        commands = simulation.poses(seed)["harmonics"]
        rng = np.random.default_rng(seed)
        sides = rng.choice([-1.0, 1.0], (len(commands), 6))
        columns: dict[str, object] = {f"joint_{k + 1} [deg]": commands[:, k] for k in range(6)}
        measured = machine.measure(commands, rng, sides)
        columns |= {f"{axis} [mm]": measured[:, k] for k, axis in enumerate("xyz")}
        columns |= {f"direction_joint_{k + 1}": ["+" if s > 0.0 else "-" for s in sides[:, k]] for k in range(6)}
        fit = calib.identify(model, calib.read_measurements(columns, robot))
        names = [parameter.name for parameter in fit.parameters]
        for k, truth in enumerate(machine.truth.half_gaps):
            sigma = fit.sigmas[names.index(f"joint_{k + 1}.backlash")]
            inside += abs(fit.value(f"joint_{k + 1}.backlash") - truth) < 1.96 * sigma
        assert fit.sigmas[names.index("joint_2.backlash")] < 4e-6
    assert inside >= 31
