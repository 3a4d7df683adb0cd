"""What controllers take: other readers and other code find the calibrated machine in it, and losses are told."""

import math
from dataclasses import replace

import numpy as np
import pytest
import yaml

import calib
from calib import dh
from calib.compensation.controllers import LeftOut, export_dh, export_offsets, export_ros, export_ur
from calib.compensation.controllers.export import judged_readings
from calib.compensation.controllers.offsets import read_offsets
from calib.compensation.controllers.yaml_text import read_yaml, yaml_text
from calib.foundations.errors import OutputError, RobotError
from calib.machine.calibrated import CalibratedMachine
from calib.machine.grid import SectorGrid
from calib.robot.conditions import Conditions
from calib.robot.gravity import Load, Payload
from calib.robot.terms import JointTerm
from tests.support import machines
from tests.support.machines import Array

UR10 = "example:ur_description/urdf/ur10_robot.urdf"
LINKS = ("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")
JOINTS = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
# x, y, z and turns about x in quarters, as the maker states them for these arms.
MADE = {
    "ur3_robot": (0.1519, -0.24365, -0.21325, 0.11235, -0.08535, 0.0819),
    "ur5_robot": (0.089159, -0.425, -0.39225, 0.10915, -0.09465, 0.0823),
    "ur10_robot": (0.1273, -0.612, -0.5723, 0.163941, -0.1157, 0.0922),
}


def model(robot: calib.Robot, *, seed: int | None = 0, fixed: bool = False) -> CalibratedMachine:
    """A calibrated machine with errors of all moving joints, of fixed ones as well, or with none."""
    d = robot.no_deviations()
    if seed is not None:
        rng = np.random.default_rng(seed)
        placements = rng.normal(scale=2e-3, size=(len(robot.chain), 6))
        placements[[joint.type == "fixed" and not fixed for joint in robot.chain]] = 0.0
        d = calib.Deviations(placements, rng.normal(scale=0.01, size=len(robot.moving)))
    frames = machines.pose((1.0, 2.0, 3.0), (0.1, -0.2, 0.3)), machines.pose((0.1, 0.0, 0.2), (1.0, 0.0, 0.0))
    return CalibratedMachine(robot, d, frames[0], {'tool "ä"': frames[1]})


def with_terms(bare: CalibratedMachine, coefficients: dict[JointTerm, float]) -> CalibratedMachine:
    d = replace(bare.deviations, terms=np.array(list(coefficients.values())))
    return replace(bare, robot=replace(bare.robot, terms=tuple(coefficients)), deviations=d)


def driver_urdf(text: str) -> str:
    """The arm as the driver's description builds it of its kinematics file."""
    kinematics = yaml.safe_load(text)["kinematics"]
    joints = [("base", "fixed", "0 0 0", f"0 0 {math.pi}", "0 0 1")]
    for link, name in zip(LINKS, JOINTS, strict=True):
        xyz, rpy = (
            " ".join(repr(kinematics[link][n]) for n in of) for of in (("x", "y", "z"), ("roll", "pitch", "yaw"))
        )
        joints.append((f"{name}_joint", "revolute", xyz, rpy, "0 0 1"))
    joints += [
        ("flange", "fixed", "0 0 0", f"0 {-math.pi / 2} {-math.pi / 2}", "0 0 1"),
        ("tool0", "fixed", "0 0 0", f"{math.pi / 2} 0 {math.pi / 2}", "0 0 1"),
    ]
    return machines.urdf(*joints).replace('"base"', '"base_link"').replace('"tip"', '"tool0"')


@pytest.mark.parametrize("name", MADE)
def test_nominal_arms_are_as_their_maker_states_them(name: str) -> None:
    robot = calib.load_robot(f"example:ur_description/urdf/{name}.urdf", "tool0")
    found = export_ur(model(robot, seed=None))
    kinematics = yaml.safe_load(found.text)["kinematics"]
    assert list(kinematics) == [*LINKS, "hash"]
    assert kinematics["hash"].startswith("calib_")
    d1, a2, a3, d4, d5, d6 = MADE[name]
    rows = [(0, 0, d1, 0), (0, 0, 0, 1), (a2, 0, 0, 0), (a3, 0, d4, 0), (0, d5, 0, 1), (0, d6, 0, -1)]
    for link, (x, y, z, quarters) in zip(LINKS, rows, strict=True):
        numbers = [kinematics[link][n] for n in ("x", "y", "z", "roll", "pitch", "yaw")]
        assert numbers == pytest.approx([x, y, z, quarters * math.pi / 2, 0, 0], abs=1e-10), link


@pytest.mark.parametrize("tip", ["tool0", "ee_link", "wrist_3_link"])
def test_the_driver_builds_the_calibrated_arm(tip: str) -> None:
    machine = model(calib.load_robot(UR10, tip, "base_link"))
    found = export_ur(machine)
    assert (found.left_out, found.before > 5e-3) == ((), True)
    assert found.lost < 1e-9
    readings = np.random.default_rng(1).uniform(-3.0, 3.0, (50, 6))
    seen = machines.arm(driver_urdf(found.text), "tool0").tips(readings)
    behind = np.linalg.inv(machines.arm(UR10, "tool0", "wrist_3_link").tips(np.zeros((1, 0)))) @ (
        np.eye(4) if tip == "wrist_3_link" else machines.arm(UR10, tip, "wrist_3_link").tips(np.zeros((1, 0)))
    )
    assert np.abs(seen @ behind - machine.tips(readings)).max() < 1e-9


def test_urdfs_in_the_frames_of_the_driver_keep_them() -> None:
    """Such a URDF may be calibrated by its maker already, with frames far from where axes would cross."""
    first = export_ur(model(calib.load_robot(UR10, "tool0", "base_link"))).text
    robot = machines.load(driver_urdf(first), "tool0")
    origins = {
        link: list(numbers.values()) for link, numbers in yaml.safe_load(first)["kinematics"].items() if link != "hash"
    }
    again = yaml.safe_load(export_ur(model(robot, seed=None)).text)["kinematics"]
    for link in LINKS:
        assert list(again[link].values()) == pytest.approx(origins[link], abs=1e-12)


def test_what_fixed_joints_deviate_is_no_part_of_the_ur_file() -> None:
    machine = model(calib.load_robot(UR10, "tool0"), fixed=True)
    found = export_ur(machine)
    (left,) = found.left_out
    assert (left.part, left.cost) == ("placements of fixed joints", pytest.approx(found.lost, rel=1e-6))
    assert left.cost > 1e-3


@pytest.mark.parametrize(
    ("text", "what"),
    [
        (machines.INLINE["scara"], "moves shoulder, elbow, quill, spin; the kinematics file of Universal Robots"),
        (
            driver_urdf(export_ur(model(calib.load_robot(UR10, "tool0"), seed=None)).text).replace('"tool0"', '"tip"'),
            "has no link 'tool0'",
        ),
    ],
)
def test_other_arms_have_no_ur_file(text: str, what: str) -> None:
    tip = machines.read(text).robot.links[-1].name
    with pytest.raises(OutputError, match=what):
        export_ur(model(machines.load(text, tip)))


def test_axes_elsewhere_are_told() -> None:
    text = driver_urdf(export_ur(model(calib.load_robot(UR10, "tool0"), seed=None)).text)
    elbow = text.index('name="elbow_joint"')
    turned = text[:elbow] + text[elbow:].replace('axis xyz="0 0 1"', 'axis xyz="0 0 -1"', 1)
    with pytest.raises(OutputError, match="has the axis of 'elbow_joint' along"):
        export_ur(model(machines.load(turned, "tool0")))
    beside, along = (
        text.replace(f'xyz="0 0 0" rpy="{math.pi / 2} 0', f'xyz="{xyz}" rpy="{math.pi / 2} 0')
        for xyz in ("0 0.01 0", "0.01 0 0")
    )
    assert text not in (beside, along)
    with pytest.raises(OutputError, match="has 'tool0' elsewhere than on the axis of its last joint"):
        export_ur(model(machines.load(beside, "tool0")))
    # On the axis, the last frame of the driver is where the tool is.
    machine = model(machines.load(along, "tool0"))
    readings = np.random.default_rng(1).uniform(-3.0, 3.0, (20, 6))
    seen = machines.arm(driver_urdf(export_ur(machine).text), "tool0").tips(readings)
    assert np.abs(seen - machine.tips(readings)).max() < 1e-9


@pytest.mark.parametrize("name", ["scara", "gantry", "skew", "mimic"])
def test_offsets_are_added_to_readings(name: str) -> None:
    text = machines.INLINE[name]
    machine = model(machines.load(text, "tip"))
    d = machine.deviations
    read = [reading.name for reading in machine.robot.readings]
    moving = [machine.robot.chain[i].name for i in machine.robot.moving]
    found = export_offsets(machine)
    table = read_offsets(found.text)
    assert list(table) == read
    assert [table[joint] for joint in read] == pytest.approx(
        [d.offsets[moving.index(joint)] for joint in read], rel=1e-14
    )
    followers = ["offsets of joints that follow others"] if name == "mimic" else []
    assert [part.part for part in found.left_out] == [*followers, "placements"]
    assert all(part.cost > 1e-4 for part in found.left_out)
    # The controller's machine: the nominal one at readings moved by the table.
    readings = judged_readings(machine)
    arm = machines.arm(text, "tip")
    order = [read.index(joint) for joint in arm.ranges]
    controlled = arm.tips((readings + np.array([table[joint] for joint in read]))[:, order])[:, :3, 3]
    whole = machine.tips(readings)[:, :3, 3]
    assert found.lost == pytest.approx(np.sqrt(np.mean(np.sum((controlled - whole) ** 2, axis=1))), rel=1e-9)
    assert f"with these offsets alone {found.lost * 1e3:.4f} mm" in found.text
    assert f"without any correction {found.before * 1e3:.4f} mm" in found.text


@pytest.mark.parametrize("odd", ["\u2028", "&#10;", "# ", "&quot;"])
def test_offsets_of_joints_with_odd_names(odd: str) -> None:
    """Characters that end lines in Python, and not in files, cut the name in two, and the file was refused."""
    text = machines.INLINE["scara"].replace('"shoulder"', f'"{odd}shoulder"')
    machine = model(machines.load(text, "tip"))
    assert list(read_offsets(export_offsets(machine).text)) == [reading.name for reading in machine.robot.readings]


@pytest.mark.parametrize("source", [UR10, machines.INLINE["scara"], machines.INLINE["gantry"]])
def test_the_dh_table_is_the_calibrated_arm(source: str) -> None:
    machine = model(machines.load(source, "tool0" if source == UR10 else "tip"))
    found = export_dh(machine)
    table = dh.parse_dh(found.text.encode(), "table")
    text = dh.dh_to_urdf(table).decode()
    arm = machines.arm(text[text.index("<robot") :], "tip")
    names = [reading.name for reading in machine.robot.readings]
    readings = np.random.default_rng(2).uniform(-2.0, 2.0, (40, len(names)))
    order = [names.index(joint) for joint in arm.ranges]
    assert np.abs(arm.tips(readings[:, order]) - machine.tips(readings)).max() < 1e-9
    assert (found.left_out, found.lost < 1e-9) == ((), True)


def test_a_dh_table_of_another_machine_is_refused() -> None:
    machine = model(calib.load_robot(UR10, "tool0"))
    with pytest.raises(OutputError, match="the file read back differs from the calibrated machine by"):
        export_dh(machine, dh.dh_of(machine.robot))
    with pytest.raises(RobotError, match="in a DH table every joint moves by itself"):
        export_dh(model(machines.load(machines.INLINE["mimic"], "tip")))


def test_yaml_for_ros_has_what_the_calibrated_urdf_lacks() -> None:
    bare = model(machines.load(machines.INLINE["skew"], "tip"))
    names = [reading.name for reading in bare.robot.readings]
    coefficients = {
        JointTerm(names[1], "gain"): 2e-3,
        JointTerm(names[1], "cos", 3): -1e-5,
        JointTerm(names[2], "backlash"): 1e-4,
    }
    machine = with_terms(bare, coefficients)
    found = export_ros(machine)
    read = yaml.safe_load(found.text)["calibration"]
    assert (read["base_link"], read["tip_link"]) == (machine.robot.base, "tip")
    assert [joint["offset"] for joint in read["joints"]] == machine.deviations.offsets.tolist()
    for T, frame in ((machine.base, read["base"]), (machine.tools['tool "ä"'], read["tools"][0])):
        x, y, z, w = frame["quaternion"]
        assert np.abs(machines.Rotation.from_quat([x, y, z, w]).as_matrix() - T[:3, :3]).max() < 1e-14
        assert frame["xyz"] == T[:3, 3].tolist()
    assert read["tools"][0]["name"] == 'tool "ä"'
    assert [(t["joint"], t["kind"], t["order"], t["coefficient"]) for t in read["terms"]] == [
        (t.reading, t.kind, t.order, coefficient) for t, coefficient in coefficients.items()
    ]
    assert [t["unit"] for t in read["terms"]] == ["1", "rad", "rad"]
    # Readings moved by the terms, given to the machine of the calibrated URDF, are the whole machine.
    readings = judged_readings(machine)
    moved = readings.copy()
    u = readings[:, 1]
    moved[:, 1] += read["terms"][0]["coefficient"] * u + read["terms"][1]["coefficient"] * np.cos(3.0 * u)
    moved[:, 2] += read["terms"][2]["coefficient"]
    conditions = Conditions(approach=np.ones_like(readings))
    assert np.abs(bare.tips(moved) - machine.tips(readings, conditions)).max() < 1e-12
    assert [part.part for part in found.left_out] == ["placements"]
    assert found.left_out[0].cost == pytest.approx(found.lost, rel=1e-9)


def test_yaml_for_ros_has_the_base_and_the_load_of_every_set_up() -> None:
    one = model(machines.load(machines.INLINE["skew"], "tip"))
    assert "setups" not in yaml.safe_load(export_ros(one).text)["calibration"]
    hung = Load(gravity=(0.0, 0.0, 9.81), payload=Payload(2.5, (0.0, 0.1, 0.2)))
    base = machines.pose((1.0, -2.0, 0.5), (0.1, 0.2, 3.0))
    robot = replace(one.robot, loads={"ceiling": hung})
    read = yaml.safe_load(export_ros(replace(one, robot=robot, others={"ceiling": base})).text)["calibration"]
    first, other = read["setups"]
    assert first == {"name": one.setup, **read["base"], "gravity": read["gravity"]}
    assert (other["name"], other["xyz"], other["gravity"]) == ("ceiling", [1.0, -2.0, 0.5], [0.0, 0.0, 9.81])
    assert np.abs(machines.Rotation.from_quat(other["quaternion"]).as_matrix() - base[:3, :3]).max() < 1e-14
    assert other["payload"] == {"mass": 2.5, "position": [0.0, 0.1, 0.2], "link": "tip"}
    assert "payload" not in first


def test_what_is_left_out_is_told_with_its_cost() -> None:
    """A turntable with a rim at 0.5 m: a harmonic of 1 mrad makes 0.5 mm / sqrt 2, a constant grid what it holds."""
    turntable = ("table", "continuous", "0 0 0", "0 0 0", "0 0 1"), ("rim", "fixed", "0.5 0 0", "0 0 0", "0 0 0")
    bare = model(machines.load(machines.urdf(*turntable), "tip"), seed=None)
    machine = replace(
        with_terms(bare, {JointTerm("table", "cos", 3): 1e-3}), residual_model=constant_grid(np.array([0.0, 0.0, 2e-4]))
    )
    for found in (export_offsets(machine), export_dh(machine)):
        assert [part.part for part in found.left_out] == ["joint terms", "residual model"]
        terms, grid = (part.cost for part in found.left_out)
        assert terms == pytest.approx(0.5e-3 / math.sqrt(2.0), rel=0.05)
        assert grid == pytest.approx(2e-4, rel=1e-9)
        assert found.lost == pytest.approx(math.hypot(terms, grid), rel=1e-9)  # one is level, the other upright
    assert export_ros(machine).left_out == (LeftOut("residual model", pytest.approx(2e-4)),)


@pytest.mark.parametrize("kind", ["thermal", "warming"])
def test_terms_of_temperature_are_judged_where_they_were_measured(kind: str) -> None:
    """At 20 degC they do nothing; what a file without them loses is what they do at the temperatures of the rows."""
    rng = np.random.default_rng(5)
    robot, true = calib.load_robot(UR10, "tool0"), machines.arm(UR10, "tool0")
    readings, celsius, per_kelvin = true.draw(rng, 80), rng.uniform(30.0, 40.0, 80), 5e-5
    moved = readings.copy()
    lift = [reading.name for reading in robot.readings].index("shoulder_lift_joint")
    moved[:, lift] += per_kelvin * (celsius - 20.0)
    points = true.tips(moved)[:, :3, 3] + rng.normal(scale=1e-6, size=(80, 3))
    columns: dict[str, object] = {f"{r.name} [rad]": readings[:, k] for k, r in enumerate(robot.readings)}
    columns |= {f"{axis} [m]": points[:, k] for k, axis in enumerate("xyz")}
    # Rows that are far apart in time: what follows late has followed.
    columns |= {"temperature [degC]": celsius, "time [s]": 1e9 * np.arange(80.0)}
    data = calib.read_measurements(columns, robot, sigma=1e-6)
    terms = {kind: ["shoulder_lift_joint"]}
    fit = calib.identify(calib.error_model(robot, terms=terms, base="fixed", tool="fixed"), data)
    machine = calib.machine_of(fit)
    (left,) = (part for part in export_offsets(machine).left_out if part.part == "joint terms")
    at = judged_readings(machine)
    warm = at.copy()
    warm[:, lift] += per_kelvin * (celsius.min() / 2.0 + celsius.max() / 2.0 - 20.0)
    apart = true.tips(warm)[:, :3, 3] - true.tips(at)[:, :3, 3]
    assert left.cost == pytest.approx(np.sqrt(np.mean(np.sum(apart**2, axis=1))), rel=1e-2)
    assert export_ros(machine).lost < 1e-6
    found = calib.judging.uncertainty_map(machine, 50)
    warm = found.readings.copy()
    warm[:, lift] += per_kelvin * (celsius.min() / 2.0 + celsius.max() / 2.0 - 20.0)
    np.testing.assert_allclose(found.positions, true.tips(warm)[:, :3, 3], atol=1e-5)


def constant_grid(error: Array) -> SectorGrid:
    axis = np.array([-4.0, 4.0])
    errors = np.broadcast_to(error, (2, 3))
    return SectorGrid((("table", "angle"),), (0,), (axis,), np.array([np.nan]), errors, np.ones(2, dtype=bool), "base")


NODES = {
    "words": ["yes", "1e3", "", "a: b", 'q"\\', "ä\n\x7f\U0001f916", "~", "no_", "1_000", "null"],
    "numbers": [1e-5, 1e16, 5e-324, -0.1, 1.7976931348623157e308, 3.0, -2.5e-7],
    "whole": 3,
    "nothing": [],
    "rows": [{"a_b": "n", "c": [1.0, 2.0], "d": {"e": 1e-7, "f": [{"g": 1.0}, {"g": 2.0}]}}, {"a_b": "off"}],
}


@pytest.mark.parametrize("reader", [yaml.safe_load, read_yaml])
def test_yaml_reads_back_equal(reader: object) -> None:
    assert callable(reader)
    read = reader(yaml_text(NODES))
    assert read == NODES
    assert all(type(value) is float for value in read["numbers"])


def test_random_doubles_read_back_equal_in_yaml() -> None:
    bits = np.random.default_rng(3).integers(0, 2**63, 300, dtype=np.uint64)
    values = [float(v) for v in bits.view(np.float64) if np.isfinite(v)]
    assert yaml.safe_load(yaml_text({"values": values}))["values"] == values
