"""A maker's calibration of a UR10 as the nominal robot, against kinematics by DH numbers that are written out here."""

import time
from pathlib import Path

import numpy as np
import pytest

import calib
from calib.compensation.controllers.ur import JOINTS
from calib.compensation.controllers.ur_own import with_ur_kinematics
from calib.foundations.errors import RobotError
from calib.robot.urdf import parse_urdf, read_urdf
from tests.support.cases import run

UR10 = "example:ur_description/urdf/ur10_robot.urdf"
D = np.array([0.1273, 0.0, 0.0, 0.163941, 0.1157, 0.0922])
A = np.array([0.0, -0.612, -0.5723, 0.0, 0.0, 0.0])
ALPHA = np.array([np.pi / 2, 0.0, 0.0, np.pi / 2, -np.pi / 2, 0.0])


def tips(q: np.ndarray, theta: np.ndarray, a: np.ndarray, d: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """The tool in base_link, by DH: half a turn before it, as ROS has its bases."""
    found = []
    for row in q:
        T = np.diag([-1.0, -1.0, 1.0, 1.0])
        for k in range(6):
            c, s, ca, sa = np.cos(row[k] + theta[k]), np.sin(row[k] + theta[k]), np.cos(alpha[k]), np.sin(alpha[k])
            T = T @ [[c, -s * ca, s * sa, a[k] * c], [s, c * ca, -c * sa, a[k] * s], [0, sa, ca, d[k]], [0, 0, 0, 1]]
        found.append(T)
    return np.array(found)


def conf(deltas: dict[str, np.ndarray]) -> str:
    lines = [f"delta_{name} = [ {', '.join(map(repr, map(float, values)))}]" for name, values in deltas.items()]
    return "[mounting]\n" + "\n".join(lines) + "\njoint_checksum = [ 0xb3241580, 0xb10112f1]\n"


def some(seed: int) -> dict[str, np.ndarray]:
    """Deltas as controllers have them: nearly parallel axes put frames metres away, and back."""
    chance = np.random.default_rng(seed)
    found = {name: 1e-3 * chance.standard_normal(6) for name in ("theta", "a", "d", "alpha")}
    found["theta"][1], found["theta"][2], found["theta"][3] = 0.02, -0.015, -0.005
    found["d"][1], found["d"][2], found["d"][3] = 8.0, -5.0, -3.0
    found["alpha"][1], found["alpha"][2] = 1e-5, -2e-5
    return found


@pytest.mark.parametrize("seed", [None, 1])
def test_calibration_conf(seed: int | None) -> None:
    zero = {name: np.zeros(6) for name in ("theta", "a", "d", "alpha")}
    deltas = zero | ({} if seed is None else some(seed))
    if seed is not None:
        deltas["theta"][1:4] = [1e-3, -2e-3, 1e-3]
    urdf = with_ur_kinematics(read_urdf(UR10), conf(deltas), "calibration.conf")
    robot = calib.load_robot(parse_urdf(urdf, "own"), "tool0", "base_link")
    q = np.random.default_rng(2).uniform(-3.0, 3.0, (20, 6))
    should = tips(q, deltas["theta"], A + deltas["a"], D + deltas["d"], ALPHA + deltas["alpha"])
    np.testing.assert_allclose(robot.tips(q)[:, :3, 3], should[:, :3, 3], rtol=0.0, atol=2e-6)
    np.testing.assert_allclose(robot.tips(q)[:, :3, :3], should[:, :3, :3], rtol=0.0, atol=2e-6)
    assert max(float(np.abs(joint.origin[:3, 3]).max()) for joint in parse_urdf(urdf, "own").joints) < 1.0


def test_a_urdf_of_a_dh_table_has_frames_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its joints turn about z as the driver's do, but stand elsewhere on their axes: it was taken for the driver's."""
    monkeypatch.chdir(tmp_path)
    rows = zip(JOINTS, A, D, ALPHA, strict=True)
    table = "convention, standard\nbase, 0 m, 0 m, 0 m, 0 deg, 0 deg, 180 deg\n"
    table += "joint, a [m], d [m], alpha [rad], theta [rad]\n"
    Path("dh.csv").write_text(table + "".join(f"{joint}, {a}, {d}, {alpha}, 0\n" for joint, a, d, alpha in rows))
    assert run("dh", "dh.csv", "-o", "dh.urdf", "-q") == (0, "", "")
    nominal = parse_urdf(Path("dh.urdf").read_bytes().replace(b'"tip"', b'"tool0"'), "dh.urdf")
    deltas = some(1)
    robot = calib.load_robot(parse_urdf(with_ur_kinematics(nominal, conf(deltas)), "own"), "tool0", "base_link")
    q = np.random.default_rng(2).uniform(-3.0, 3.0, (20, 6))
    should = tips(q, deltas["theta"], A + deltas["a"], D + deltas["d"], ALPHA + deltas["alpha"])
    np.testing.assert_allclose(robot.tips(q), should, rtol=0.0, atol=2e-6)


def test_what_is_exported_for_the_driver_comes_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    yaml = "kinematics:\n" + "".join(
        f"  {link}:\n    x: {x}\n    y: {y}\n    z: {z}\n    roll: {r}\n    pitch: {p}\n    yaw: {w}\n"
        for link, x, y, z, r, p, w in (
            ("shoulder", 0, 0, 0.1283, 0, 0, 0.001),
            ("upper_arm", 0.0002, 0, 0, 1.570796327, 0, 0),
            ("forearm", -0.6125, 0, 0, 0, 0.0004, 0),
            ("wrist_1", -0.5719, 0, 0.163941, 0, 0, 0),
            ("wrist_2", 0, -0.1157, 0, 1.570796327, 0, 0),
            ("wrist_3", 0, 0.0922, 0, 1.570796326589793, 3.141592653589793, 3.141592653589793),
        )
    )
    Path("own.yaml").write_text(yaml + "  hash: calib_12788084448423163542\n")
    assert run("import", "own.yaml", "--robot", UR10, "-o", "own.urdf", "-q") == (0, "", "")
    robot = calib.load_robot("own.urdf", "tool0", "base_link")
    nominal = calib.load_robot(UR10, "tool0", "base_link")
    q = np.random.default_rng(3).uniform(-3.0, 3.0, (50, 6))
    off = np.linalg.norm(robot.tips(q)[:, :3, 3] - nominal.tips(q)[:, :3, 3], axis=1)
    assert 5e-4 < off.max() < 5e-3


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("kinematics: 1", "k: 'shoulder' has not x, y, z, roll, pitch and yaw; is it kinematics_params?"),
        ("delta_theta = [1]", "k: has not six numbers each in delta_theta, delta_a, delta_d and delta_alpha."),
        ("delta_theta = [x]", "k: 'x' is not a number of a calibration."),
    ],
)
def test_files_that_are_none(text: str, sentence: str) -> None:
    with pytest.raises(RobotError) as caught:
        with_ur_kinematics(read_urdf(UR10), text, "k")
    assert str(caught.value) == sentence


def test_of_another_model() -> None:
    deltas = {name: np.zeros(6) for name in ("theta", "a", "d", "alpha")} | {"d": np.full(6, 0.2)}
    with pytest.raises(RobotError, match="is it of this model"):
        with_ur_kinematics(read_urdf(UR10), conf(deltas), "k")
    with pytest.raises(RobotError, match="is no arm of Universal Robots"):
        with_ur_kinematics(read_urdf("example:panda_description/urdf/panda.urdf"), conf(deltas), "k")


def test_of_the_next_series() -> None:
    """Of a UR3e, whose axes stand as those of a UR3 do, but for 19 mm at the wrist."""
    nominal = read_urdf("example:ur_description/urdf/ur3_robot.urdf")
    yaml = "".join(
        f"{link}:\n  x: {x}\n  y: {y}\n  z: {z}\n  roll: {r}\n  pitch: {p}\n  yaw: {p}\n"
        for link, x, y, z, r, p in (
            ("shoulder", 0, 0, 0.15185, 0, 0),
            ("upper_arm", 0, 0, 0, 1.570796327, 0),
            ("forearm", -0.24355, 0, 0, 0, 0),
            ("wrist_1", -0.2132, 0, 0.13105, 0, 0),
            ("wrist_2", 0, -0.08535, 0, 1.570796327, 0),
            ("wrist_3", 0, 0.0921, 0, 1.570796326589793, 3.141592653589793),
        )
    )
    with pytest.raises(RobotError, match="the axis of wrist_2_joint is not near that of "):
        with_ur_kinematics(nominal, yaml, "k")
    own = yaml.replace("0.13105", "0.1129").replace("0.0921", "0.0824")
    assert with_ur_kinematics(nominal, own, "k") != nominal.source


@pytest.mark.parametrize("text", ["\n" * 100_000, " " * 100_000, "delta_a = [\n" * 10_000, "shoulder:\n" * 10_000])
def test_files_of_nothing_are_refused_at_once(text: str) -> None:
    begun = time.process_time()
    with pytest.raises(RobotError, match="is it kinematics_params"):
        with_ur_kinematics(read_urdf(UR10), text)
    assert time.process_time() - begun < 5.0


def test_what_is_said_twice_is_refused() -> None:
    deltas = conf(some(1))
    with pytest.raises(RobotError, match="has delta_theta twice"):
        with_ur_kinematics(read_urdf(UR10), deltas + deltas)
    with pytest.raises(RobotError, match="'shoulder' has x twice"):
        with_ur_kinematics(read_urdf(UR10), "shoulder:\n  x: 1\n  x: 2\n")
