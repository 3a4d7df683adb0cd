"""The calibrated URDF: what other programs read from it is the calibrated machine."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import calib
from calib.foundations.errors import OutputError
from calib.machine import urdf as compensation
from calib.machine.in_urdf import write_urdf
from calib.machine.urdf import calibrated_origins, calibrated_urdf, lost_in_urdf
from calib.robot.load import load_robot, with_document
from calib.robot.terms import JointTerm
from calib.robot.urdf import parse_urdf
from tests.support import machines

ARMS = {
    **{name: (text, "tip") for name, text in machines.INLINE.items()},
    "panda": ("example:panda_description/urdf/panda.urdf", "panda_hand_tcp"),
    "kinova": ("example:kinova_description/robots/kinova.urdf", "j2s6s200_end_effector"),
    "talos left": ("example:talos_data/robots/talos_reduced.urdf", "gripper_left_base_link"),
}


def deviations(robot: calib.Robot, seed: int = 0) -> calib.Deviations:
    rng = np.random.default_rng(seed)
    return calib.Deviations(
        rng.normal(scale=5e-3, size=(len(robot.chain), 6)), rng.normal(scale=0.02, size=len(robot.moving))
    )


@pytest.mark.parametrize("name", ARMS)
def test_another_reader_sees_the_machine(name: str) -> None:
    source, tip = ARMS[name]
    robot = machines.load(source, tip)
    d = deviations(robot)
    document = calibrated_urdf(robot, d)
    text = document.decode()
    arm = machines.arm(text[text.index("<robot") :], robot.tip, robot.base)
    readings = np.random.default_rng(1).uniform(-2.0, 2.0, (50, len(robot.readings)))
    order = [list(arm.ranges).index(reading.name) for reading in robot.readings]
    shuffled = np.empty_like(readings)
    shuffled[:, order] = readings
    assert np.abs(arm.tips(shuffled) - robot.tips(readings, d)).max() < 1e-9


def test_seen_from_another_tip_it_is_the_same_document() -> None:
    """Which of the links is the tip says nothing of the order of readings."""
    source, left = ARMS["talos left"]
    robot = load_robot(source, left, links=["gripper_right_base_link"], payload=calib.measuring.Payload(2.0))
    other = robot.with_tip("gripper_right_base_link")
    d = deviations(robot)
    assert calibrated_urdf(other, d) == calibrated_urdf(robot, d)
    again = with_document(other, robot.urdf)
    assert (again.tip, again.links, again.readings) == (other.tip, other.links, other.readings)
    q = np.random.default_rng(0).uniform(-1.0, 1.0, (5, len(robot.readings)))
    np.testing.assert_allclose(again.tips(q), other.tips(q), atol=1e-12)


@pytest.mark.parametrize(
    "couplings",
    [
        (calib.Coupling("level", {"lift": -1.0}),),
        (calib.Coupling("level", {"lift": -0.5, "swing": 0.25}, 0.3), calib.Coupling("bend", {"level": 2.0})),
    ],
    ids=["one driver", "several, and one after another"],
)
def test_coupled_joints_take_over_offsets_of_their_drivers(couplings: tuple[calib.Coupling, ...]) -> None:
    """The reader of the calibrated URDF is told the same couplings, and nothing of the offsets."""
    nominal = parse_urdf(machines.INLINE["mimic"].encode(), "arm.urdf")
    robot = load_robot(nominal, "tip", couplings=couplings)
    d = deviations(robot)
    again = load_robot(parse_urdf(calibrated_urdf(robot, d), "again"), "tip", couplings=couplings)
    readings = np.random.default_rng(1).uniform(-2.0, 2.0, (50, len(robot.readings)))
    assert np.abs(again.tips(readings) - robot.tips(readings, d)).max() < 1e-9
    # Each offset by itself, told by where the joint's positions go.
    for j, i in enumerate(robot.moving):
        offsets = np.eye(len(robot.moving))[j] * 0.01
        moved = robot.joint_positions(readings, calib.Deviations(0.0 * d.placements, offsets))
        own = {c.joint for c in couplings}
        reads = robot.chain[i].name not in own
        at = readings.copy()
        if reads:
            at[:, [r.name for r in robot.readings].index(robot.chain[i].name)] += 0.01
        expected = robot.joint_positions(at) + (0.0 if reads else offsets)
        np.testing.assert_allclose(moved, expected, atol=1e-12)


def test_fingers_beside_the_arm_follow_the_offsets_of_coupled_joints() -> None:
    """A finger that mimics a coupled joint stands where the drivers' readings, offsets included, put it."""
    text = machines.INLINE["mimic"].replace(
        "</robot>",
        '<link name="finger"/><joint name="grip" type="revolute"><parent link="tip"/><child link="finger"/>'
        '<axis xyz="0 1 0"/><mimic joint="level" multiplier="0.5"/>'
        f"{machines.LIMIT['revolute']}</joint></robot>",
    )
    couplings = (calib.Coupling("level", {"lift": -0.5, "swing": 0.25}, 0.3),)
    robot = load_robot(parse_urdf(text.encode(), "arm.urdf"), "tip", couplings=couplings)
    d = calib.Deviations(np.zeros((len(robot.chain), 6)), np.random.default_rng(0).normal(0.0, 0.02, len(robot.moving)))
    offsets = dict(zip((robot.chain[i].name for i in robot.moving), d.offsets, strict=True))
    turn = 0.5 * (-0.5 * offsets["lift"] + 0.25 * offsets["swing"])
    origin = calibrated_origins(robot, d)["grip"]
    np.testing.assert_allclose([origin[0, 2], origin[0, 0]], [np.sin(turn), np.cos(turn)], atol=1e-12)


def test_what_a_urdf_loses_of_joint_terms_is_told() -> None:
    """A turntable's harmonic of 1 mrad, seen at its rim: cos averages to 1/sqrt(2)."""
    turntable = ("table", "continuous", "0 0 0", "0 0 0", "0 0 1"), ("rim", "fixed", "0.5 0 0", "0 0 0", "0 0 0")
    bare = machines.load(machines.urdf(*turntable), "tip")
    robot = replace(bare, terms=(JointTerm("table", "cos", 3),))
    d = calib.Deviations(np.zeros((2, 6)), np.zeros(1), np.array([1e-3]))
    readings = np.linspace(0.0, 2.0 * np.pi, 100, endpoint=False)[:, None]
    assert calibrated_urdf(robot, d) == bare.urdf.source
    assert lost_in_urdf(bare, bare.no_deviations(), readings) == 0.0
    assert lost_in_urdf(robot, d, readings) == pytest.approx(0.5e-3 / np.sqrt(2.0), rel=1e-6)


def test_no_deviation_is_the_document_itself() -> None:
    robot = machines.load(machines.INLINE["skew"], "tip")
    assert calibrated_urdf(robot, robot.no_deviations()) == robot.urdf.source


def test_joints_beside_the_arm_that_mimic_it_take_over_its_offsets() -> None:
    finger = (
        '<link name="finger"/><joint name="finger" type="revolute"><parent link="base"/><child link="finger"/>'
        '<origin xyz="0 0 1"/><axis xyz="0 0 2"/><mimic joint="level" multiplier="3"/></joint></robot>'
    )
    text = machines.INLINE["mimic"].replace("</robot>", finger)
    robot = machines.load(text, "tip")
    zeros = np.zeros(len(robot.moving))
    zeros[1] = 0.01  # lift, which level follows by -1 and finger by 3 times level
    origins = calibrated_origins(robot, calib.Deviations(np.zeros((len(robot.chain), 6)), zeros))
    assert sorted(origins) == ["finger", "level", "lift"]
    assert np.arctan2(origins["finger"][1, 0], origins["finger"][0, 0]) == pytest.approx(-0.03, abs=1e-15)
    assert origins["finger"][:3, 3].tolist() == [0, 0, 1]


def test_of_a_long_chain_of_mimics_each_is_followed_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of 100 joints, each following the one before, the last comes first in the file and all take over its offset."""
    n = 100
    beside = "".join(
        f'<link name="f{k}"/><joint name="f{k}" type="revolute"><parent link="base"/><child link="f{k}"/>'
        f'<axis xyz="0 0 1"/><mimic joint="{f"f{k - 1}" if k else "lift"}" multiplier="-1"/></joint>'
        for k in reversed(range(n))
    )
    robot = machines.load(machines.INLINE["mimic"].replace("</robot>", beside + "</robot>"), "tip")
    zeros = np.zeros(len(robot.moving))
    zeros[1] = 0.01  # lift
    asked: list[str] = []
    monkeypatch.setattr(type(robot.urdf), "joint", lambda urdf, name: asked.append(name) or urdf._by_name[name])
    origins = calibrated_origins(robot, calib.Deviations(np.zeros((len(robot.chain), 6)), zeros))
    turns = [np.arctan2(origins[f"f{k}"][1, 0], origins[f"f{k}"][0, 0]) for k in range(n)]
    np.testing.assert_allclose(turns, np.where(np.arange(n) % 2, 0.01, -0.01), atol=1e-15)
    assert len(asked) <= 2 * n


def test_difference_from_the_machine_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    robot = machines.load(machines.INLINE["skew"], "tip")
    monkeypatch.setattr(compensation, "splice_origins", lambda source, *_: source)
    with pytest.raises(OutputError, match="read back differs from the calibrated machine by"):
        calibrated_urdf(robot, deviations(robot))


@pytest.fixture(scope="module")
def fit() -> calib.Fit:
    text = machines.INLINE["negative"]
    rng = np.random.default_rng(2)
    true = machines.arm(text, "tip").moved(rng)
    machine = machines.Machine(true, machines.anywhere(rng), {"tool": machines.pose((0.05, 0.02, 0.15))})
    robot = machines.load(text, "tip")
    data = machine.measure(robot, true.draw(rng, 40), rng=rng, sigma=1e-5)
    return calib.identify(calib.error_model(robot, offsets="all"), data)


def test_written_urdf_is_the_calibrated_one(fit: calib.Fit, tmp_path: Path) -> None:
    write_urdf(fit, tmp_path / "calibrated.urdf")
    robot = calib.load_robot(tmp_path / "calibrated.urdf", "tip")
    readings = np.random.default_rng(3).uniform(-2.0, 2.0, (50, 6))
    expected = fit.model.robot.tips(readings, fit.machine.deviations)
    assert np.abs(robot.tips(readings) - expected).max() < 1e-9
    write_urdf(fit, str(tmp_path / "calibrated.urdf"))


def test_nominal_urdf_is_never_overwritten(fit: calib.Fit, tmp_path: Path) -> None:
    path = tmp_path / "arm.urdf"
    path.write_bytes(fit.model.robot.urdf.source)
    with pytest.raises(OutputError, match=r"arm\.urdf: holds the nominal URDF, which is never overwritten"):
        write_urdf(fit, path)
    assert path.read_bytes() == fit.model.robot.urdf.source


def test_no_place_to_write(fit: calib.Fit, tmp_path: Path) -> None:
    for path in (tmp_path, tmp_path / "no" / "such.urdf", tmp_path / ("x" * 300)):
        with pytest.raises(OutputError, match=r"cannot be|is not a regular file"):
            write_urdf(fit, path)
    assert list(tmp_path.iterdir()) == []
