"""What readings hold against gravity: the slope of a potential energy that shares no code with the toolkit."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import calib
from calib.foundations import rigid
from calib.foundations.errors import RobotError
from calib.robot import gravity
from calib.robot.conditions import Conditions
from calib.robot.gravity import Holding, Payload
from calib.robot.joint_terms import weights_of, with_joint_terms
from calib.robot.load import load_robot
from calib.robot.robot import Deviations, Robot
from calib.robot.terms import JointTerm
from calib.robot.urdf import inertials, parse_urdf
from scripts.simulate import irb2400 as simulation
from tests.support import machines

Array = np.ndarray
ROOT = Path(__file__).resolve().parents[2]
IRB = ROOT / "robots" / "irb2400" / "irb2400.urdf"
LOOP = calib.ClosedLoop("parallelogram", ("rod_end", "rear_lever_pin"), ("x", "z"), ("elbow", "rod"))
PANDA = "example:panda_description/urdf/panda.urdf"
UR10 = "example:ur_description/urdf/ur10_robot.urdf"
DOWN = (0.3, -0.5, -9.7)


def potential(source: str, readings: dict[str, float], payload: Payload | None, tip: str) -> float:
    """Potential energy in J by yourdfpy: every link's mass at its height along gravity."""
    document = machines.read(source)
    for name in document.joint_map:
        if document.joint_map[name].type != "fixed" and document.joint_map[name].mimic is None:
            readings.setdefault(name, 0.0)
    energy = 0.0
    for link in document.robot.links:
        mass, centre = 0.0, np.zeros(3)
        if link.inertial is not None and link.inertial.mass:
            mass = link.inertial.mass
            centre = np.zeros(3) if link.inertial.origin is None else link.inertial.origin[:3, 3]
        carried = [(mass, centre)]
        if payload is not None and link.name == tip:
            carried.append((payload.mass, np.array(payload.position)))
        T = placed(source, link.name, readings)
        energy -= sum(m * float(np.dot(DOWN, T[:3, :3] @ c + T[:3, 3])) for m, c in carried if m)
    return energy


def placed(source: str, link: str, readings: dict[str, float]) -> Array:
    """A link in the root, walked by numpy."""
    by_child = {joint.child: joint for joint in machines.read(source).robot.joints}
    T = np.eye(4)
    while link in by_child:
        joint = by_child[link]
        origin = np.eye(4) if joint.origin is None else joint.origin
        if joint.type != "fixed":
            driver, q = joint, 1.0
            while driver.mimic is not None:
                q *= driver.mimic.multiplier
                driver = machines.read(source).joint_map[driver.mimic.joint]
            travel = joint.axis / np.linalg.norm(joint.axis) * q * readings[driver.name]
            origin = origin @ (machines.pose(travel) if joint.type == "prismatic" else machines.pose(rotvec=travel))
        T = origin @ T
        link = joint.parent
    return T


def test_torques_of_the_same_rows_are_made_once_and_those_of_another_load_anew(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    holding = Holding(weights_of(load_robot(UR10, "tool0", gravity=DOWN)))
    u = np.random.default_rng(0).uniform(-1.5, 1.5, (4, 6))
    upwards = Conditions(gravity=np.tile(-np.array(DOWN), (4, 1)))
    first = holding(u)
    np.testing.assert_allclose(holding(u, upwards), -first, atol=1e-9)
    assert holding(u.copy()) is first
    assert holding(u[::-1]) is not first
    monkeypatch.setattr(gravity, "_MOST_KEPT", 0)
    assert holding(u + 1.0) is not first
    assert holding(u) is not first


@pytest.mark.parametrize(
    ("source", "tip", "payload"),
    [(UR10, "tool0", None), (UR10, "tool0", Payload(5.0, (0.1, 0.02, 0.2))), (PANDA, "panda_hand_tcp", None)],
)
def test_torques_are_the_slopes_of_the_potential_energy(source: str, tip: str, payload: Payload | None) -> None:
    robot = load_robot(source, tip, gravity=DOWN, payload=payload)
    names = [reading.name for reading in robot.readings]
    u = np.random.default_rng(0).uniform(-1.5, 1.5, (4, len(names)))
    torques = Holding(weights_of(robot))(u)
    h = 1e-4
    for n in range(len(u)):
        for k in range(len(names)):
            ends = [
                potential(
                    source, dict(zip(names, u[n] + s * h * (np.arange(len(names)) == k), strict=True)), payload, tip
                )
                for s in (1.0, -1.0)
            ]
            assert torques[n, k] == pytest.approx((ends[0] - ends[1]) / (2 * h), abs=2e-6)
    assert np.abs(torques).max() > 5.0


def test_what_slides_holds_a_force() -> None:
    text = machines.INLINE["gantry"].replace(
        '<link name="tip"/>', '<link name="tip"><inertial><mass value="3"/></inertial></link>'
    )
    robot = load_robot(parse_urdf(text.encode(), "gantry.urdf"), "tip", gravity=(0.0, 0.0, -10.0))
    torques = Holding(weights_of(robot))(np.zeros((1, 6)))
    # Only the ram moves up and down; the probe's turns move its centre not at all, or level.
    assert torques[0, 2] == pytest.approx(30.0)
    np.testing.assert_allclose(torques[0, :2], 0.0, atol=1e-12)


def test_a_joint_that_follows_with_an_offset_holds_its_share() -> None:
    centre, mass = (0.1, -0.2, 0.3), 2.0
    inertial = f'<inertial><origin xyz="0.1 -0.2 0.3"/><mass value="{mass}"/></inertial>'
    text = machines.INLINE["mimic"].replace('<link name="tip"/>', f'<link name="tip">{inertial}</link>')
    robot = load_robot(parse_urdf(text.encode(), "mimic.urdf"), "tip", gravity=DOWN)
    arm, h = machines.arm(text, "tip"), 1e-5
    u = np.random.default_rng(3).uniform(-1.5, 1.5, (4, len(robot.readings)))

    def energy(q: Array) -> Array:
        return -mass * (arm.tips(q) @ [*centre, 1.0])[:, :3] @ np.array(DOWN)

    slopes = [(energy(u + step) - energy(u - step)) / (2 * h) for step in h * np.eye(u.shape[1])]
    np.testing.assert_allclose(Holding(weights_of(robot))(u), np.stack(slopes, axis=1), rtol=0, atol=1e-7)


def test_unless_told_otherwise_gravity_is_standard_and_a_payload_sits_in_the_tip() -> None:
    assert load_robot(UR10, "tool0").gravity == (0.0, 0.0, -9.80665)
    assert Payload(2.0).position == (0.0, 0.0, 0.0)


def irb2400(**options: object) -> Robot:
    return calib.load_robot(IRB, "tool0", loops=[LOOP], **options)


def test_on_the_parallelogram_the_loop_carries_its_share() -> None:
    """The script's own energy; the tree's torques alone would be wrong, which is shown."""
    u = np.random.default_rng(1).uniform(-0.4, 0.4, (30, 6)) * [5, 1, 1, 5, 3, 5]
    expected = simulation.gravity_torques(u)
    torques = Holding(weights_of(irb2400(gravity=(0.0, 0.0, -9.81))))(u)
    np.testing.assert_allclose(torques, expected, rtol=0, atol=1e-6 * np.abs(expected).max())
    assert np.abs(expected[:, 1:3]).min(axis=0).max() > 1.0


def test_freezing_the_torques_at_nominal_geometry_costs_nothing() -> None:
    """Real arms deviate by millimetres and milliradians: their torques do by a fraction of 1e-2 of the largest."""
    robot = irb2400()
    rng = np.random.default_rng(2)
    u = rng.uniform(-0.4, 0.4, (10, 6))
    nominal = weights_of(robot)
    moved = robot.chain
    bent = tuple(
        replace(joint, placement=joint.placement @ rigid.translation(rng.normal(scale=1e-3, size=3))) for joint in moved
    )
    torques, other = Holding(nominal)(u), Holding(weights_of(replace(robot, chain=bent)))(u)
    assert 0.0 < np.abs(other - torques).max() < 1e-2 * np.abs(torques).max()


def test_an_elastic_joint_gives_way_to_what_it_holds() -> None:
    terms = [JointTerm("joint_2", "elastic"), JointTerm("joint_3", "elastic")]
    robot = with_joint_terms(irb2400(), terms)
    u = np.random.default_rng(3).uniform(-0.4, 0.4, (6, 6))
    coefficients = np.array([4e-6, 7e-6])
    d = Deviations(np.zeros((len(robot.chain), 6)), np.zeros(len(robot.moving)), coefficients)
    torques = Holding(weights_of(robot))(u)
    moved = u.copy()
    moved[:, 1:3] -= coefficients * torques[:, 1:3]
    np.testing.assert_allclose(robot.tips(u, d), irb2400().tips(moved), rtol=0, atol=1e-13)
    by_terms = robot.motion(u, d).by_terms
    for t in range(2):
        step = 1e-4 * (np.arange(2) == t)
        ends = [robot.tips(u, replace(d, terms=coefficients + s * step)) for s in (1.0, -1.0)]
        tip = robot.tips(u, d)
        v = (np.swapaxes(tip[:, :3, :3], 1, 2) @ (ends[0] - ends[1])[:, :3, 3, None])[:, :, 0] / 2e-4
        assert np.abs(by_terms[:, :3, t] - v).max() < 2e-4 * np.abs(v).max()


WEIGHED = '<link name="tip"><inertial><origin xyz="0 0 0.1"/><mass value="2"/></inertial></link>'


@pytest.mark.parametrize(
    ("link", "sentence"),
    [
        ('<link name="tip"/>', "no link that 'base' carries states its mass"),
        (WEIGHED.replace('<mass value="2"/>', ""), "arm.urdf:1: link 'tip': <inertial> has no <mass>."),
        (WEIGHED.replace('"2"', '"-2"'), "arm.urdf:1: link 'tip': the mass -2 kg is negative."),
        (WEIGHED.replace('"2"', '"two"'), "arm.urdf:1: link 'tip': <mass> value='two' is not a plain decimal number."),
        (WEIGHED.replace('"0 0 0.1"', '"0 0"'), "arm.urdf:1: link 'tip': <origin> xyz='0 0' is not 3 plain decimal"),
        (WEIGHED.replace("</link>", "<inertial/></link>"), "arm.urdf:1: link 'tip' has a second <inertial>"),
    ],
)
def test_masses_that_cannot_be_used_are_refused_where_they_are_needed(link: str, sentence: str) -> None:
    text = machines.INLINE["skew"].replace('<link name="tip"/>', link)
    robot = load_robot(parse_urdf(text.encode(), "arm.urdf"), "tip")
    with pytest.raises(RobotError) as caught:
        machines.model(robot, elastic="all")
    assert sentence in str(caught.value)
    assert machines.model(robot, gain="all").terms


def test_masses_are_read() -> None:
    text = machines.INLINE["skew"].replace('<link name="tip"/>', WEIGHED)
    (found,) = inertials(parse_urdf(text.encode(), "arm.urdf")).values()
    assert found.mass == 2.0
    assert found.centre.tolist() == [0.0, 0.0, 0.1]


@pytest.mark.parametrize("diagonal", [(-5e-20, -5e-20, 0.0), (-1e-3, 2e-3, 0.0)])
def test_inertias_that_no_body_has_bear_on_nothing_at_rest(diagonal: tuple[float, float, float]) -> None:
    inertia = '<inertia ixx="{}" ixy="1e-9" ixz="0" iyy="{}" iyz="0" izz="{}"/>'.format(*diagonal)
    u = np.random.default_rng(5).uniform(-1.0, 1.0, (3, 6))
    held = []
    for link in (WEIGHED, WEIGHED.replace("</inertial>", f"{inertia}</inertial>")):
        text = machines.INLINE["skew"].replace('<link name="tip"/>', link)
        held.append(Holding(weights_of(load_robot(parse_urdf(text.encode(), "arm.urdf"), "tip")))(u))
    np.testing.assert_array_equal(held[0], held[1])


def test_a_branch_that_moves_without_the_chain_is_refused() -> None:
    with pytest.raises(RobotError, match=r"link 'crank' moves with the reading 'joint_3' but .* close its loop"):
        weights_of(calib.load_robot(IRB, "tool0"))


@pytest.mark.parametrize("options", [{"gravity": (0.0, 0.0)}, {"gravity": (0, 0, np.nan)}])
def test_wrong_gravity_and_payload_are_refused(options: dict[str, object]) -> None:
    with pytest.raises(RobotError):
        load_robot(UR10, "tool0", **options)
