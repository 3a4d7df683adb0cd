"""Bearings that tilt and links that twist under gravity: found on an arm simulated by numpy, with exact slopes."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import calib
from calib.foundations.errors import JobError
from calib.identification.machine import Frames
from calib.identification.system import Problem
from calib.machine.model_file import machine_files
from calib.machine.of_fit import machine_of
from calib.robot.gravity import Body, Holding, Payload, Weights
from calib.robot.joint_terms import with_joint_terms
from calib.robot.robot import Deviations, Robot
from calib.robot.sources import resolve
from calib.robot.terms import JointTerm
from calib.robot.urdf import parse_urdf
from tests.support import beams, jacobians, machines
from tests.support.gears import UR10

Array = np.ndarray
IRB = Path(__file__).resolve().parents[2] / "robots" / "irb2400" / "irb2400.urdf"
LOOP = calib.ClosedLoop("parallelogram", ("rod_end", "rear_lever_pin"), ("x", "z"), ("elbow", "rod"))
SIGMA = 3e-5
PAYLOAD = Payload(10.0, (0.0, 0.08, 0.12))
G = np.array([0.0, 0.0, -9.80665])
# About x, y and z of the joint's frame: bearings, and the drive where it is soft.
SOFT = {
    "shoulder_pan_joint": (9e-6, 1.4e-5, 0.0),
    "shoulder_lift_joint": (1.1e-5, 0.0, 8e-6),
    "elbow_joint": (1.6e-5, 7e-6, 1.2e-5),
    "wrist_1_joint": (3e-5, 0.0, 0.0),
}
TWISTS = {"wrist_1_joint": 2e-5}
FREE = {"offsets": "all", "placements": "all"}


class Bearings:
    """A UR10 whose joints turn about all three axes under the torque about each, and whose links may twist.

    Walked by numpy: torques are moments of weight about the nominal joint's place, from yourdfpy's masses.
    """

    def __init__(self, moved: machines.Arm, twists: dict[str, float]) -> None:
        self.moved, self.twists, self.nominal = moved, twists, machines.arm(*UR10)
        self.document = machines.read(UR10[0])

    def tips(self, readings: Array) -> Array:
        return np.stack([self._tip(u) for u in readings])

    def _tip(self, u: Array) -> Array:
        T, k = np.eye(4), 0
        for i, (joint, (place, link, own, torque)) in enumerate(zip(self.moved.joints, self._loads(u), strict=True)):
            T = T @ joint.origin
            if (compliance := self.twists.get(joint.name, 0.0)) > 0.0:
                along = link / np.linalg.norm(link)
                T = T @ machines.pose(rotvec=compliance * place.T @ along * float(along @ (torque + own)))
            if joint.type == "fixed":
                continue
            axes = axes_of(self.nominal.joints[i].axis)
            c = np.array(SOFT.get(joint.name, (0.0, 0.0, 0.0)))
            held = axes.T @ place.T @ torque
            for axis in (0, 1):
                T = T @ machines.pose(rotvec=axes[:, axis] * c[axis] * held[axis])
            wound = u[k] * joint.multiplier + joint.shift + c[2] * held[2]
            T = T @ machines.pose(rotvec=joint.axis * wound)
            k += 1
        return T

    def _loads(self, u: Array) -> list[tuple[Array, Array, Array, Array]]:
        """Every joint's nominal axes, the link before it, the torque of its own weight, the moment of all behind it."""
        T, k, found, masses = np.eye(4), 0, [], list[tuple[int, float, Array]]()
        body = None
        for i, joint in enumerate(self.nominal.joints):
            R, own = T[:3, :3], np.zeros(3)
            link = R @ joint.origin[:3, 3]
            if body is not None and body.mass and link.any():
                _, _, twist = beams.own_weight(joint.origin[:3, 3], body.origin[:3, 3])
                own = R @ twist @ R.T @ G * body.mass / np.linalg.norm(link)
            T = T @ joint.origin
            found.append((T, link, own))
            if joint.type != "fixed":
                T = T @ machines.pose(rotvec=joint.axis * u[k])
                k += 1
            body = self.document.link_map[self.document.joint_map[joint.name].child].inertial
            if body is not None and body.mass:
                masses.append((i, body.mass, (T @ body.origin)[:3, 3]))
        masses.append((i, PAYLOAD.mass, (T @ [*PAYLOAD.position, 1.0])[:3]))
        return [
            (
                P[:3, :3],
                link,
                own,
                np.cross(sum((m * (c - P[:3, 3]) for at, m, c in masses if at >= i), np.zeros(3)), G),
            )
            for i, (P, link, own) in enumerate(found)
        ]


def axes_of(axis: Array) -> Array:
    """x, y and z of a joint: of its frame where z is the axis, else as the toolkit's frames have them."""
    from calib.robot.deviation import axis_frame

    return axis_frame(axis)[:3, :3]


class Lab:
    def __init__(self, seed: int, n: int = 150, *, twists: bool = False) -> None:
        self.rng = rng = np.random.default_rng([seed, 20])
        self.robot = calib.load_robot(*UR10, payload=PAYLOAD)
        self.plain = machines.arm(*UR10)
        self.arm = Bearings(self.plain.moved(rng), TWISTS if twists else {})
        self.base = machines.anywhere(rng)
        self.readings = self.plain.draw(rng, n)

    def points(self, readings: Array) -> Array:
        return (self.base @ self.arm.tips(readings) @ machines.pose((0.05, 0.02, 0.15)))[:, :3, 3]

    def measure(self, robot: calib.Robot | None = None, sigma: float = SIGMA) -> calib.Measurements:
        x = self.points(self.readings)
        x = x + sigma * self.rng.standard_normal(x.shape)
        columns: dict[str, object] = {
            f"{reading.name} [rad]": self.readings[:, k] for k, reading in enumerate(self.robot.readings)
        }
        columns |= {f"{axis} [m]": x[:, k] for k, axis in enumerate("xyz")}
        return calib.read_measurements(columns, robot or self.robot, sigma=SIGMA)

    def miss(self, fit: calib.Fit, n: int = 60) -> float:
        """3D rms in m of tool points in poses that were not measured."""
        u = self.plain.draw(np.random.default_rng(99), n)
        found = machines.predicted(fit, u)[:, :3, 3]
        return float(np.sqrt(np.mean(np.sum((found - self.points(u)) ** 2, axis=1))))


def weightless() -> calib.Robot:
    text = re.sub(rb"<inertial>.*?</inertial>", b"", resolve(UR10[0]).read_bytes(), flags=re.DOTALL)
    return calib.load_robot(parse_urdf(text, "weightless.urdf"), "tool0")


def test_a_known_truth_is_found_to_the_floor() -> None:
    """Held out, noise included, within 1.1 of the noise alone, where wind-up alone is far from it."""
    held_out = []
    for seed in range(2):
        lab = Lab(seed, 120)
        data = lab.measure()
        drives = ["shoulder_lift_joint", "elbow_joint"]
        fits = [
            calib.identify(machines.model(lab.robot, **FREE, **terms), data)
            for terms in ({"elastic": drives, "lateral": list(SOFT)}, {"elastic": "all"})
        ]
        assert all(fit.converged for fit in fits)
        held_out.append([np.hypot(lab.miss(fit), np.sqrt(3.0) * SIGMA) for fit in fits])
        told = {p.name: sigma for p, sigma in zip(fits[0].parameters, fits[0].sigmas, strict=True)}
        for joint, (x, y, _) in SOFT.items():
            for name, truth in ((f"{joint}.lateral_x", x), (f"{joint}.lateral_y", y)):
                if np.isfinite(told[name]):
                    assert abs(fits[0].value(name) - truth) < 4.0 * told[name]
    with_bearings, without = np.mean(held_out, axis=0)
    assert with_bearings < 1.1 * np.sqrt(3.0) * SIGMA
    assert without > 3.0 * with_bearings


def test_twisting_links_are_found_beside_them() -> None:
    lab = Lab(5, twists=True)
    drives = ["shoulder_lift_joint", "elbow_joint"]
    model = machines.model(lab.robot, **FREE, elastic=drives, lateral=list(SOFT), torsion=list(TWISTS))
    fit = calib.identify(model, lab.measure())
    assert np.hypot(lab.miss(fit), np.sqrt(3.0) * SIGMA) < 1.1 * np.sqrt(3.0) * SIGMA


def test_without_masses_moments_do_it() -> None:
    lab, bare = Lab(7, 400), weightless()
    data = lab.measure(bare)
    moments = {"moments": ["shoulder_lift_joint", "elbow_joint"], "lateral_moments": list(SOFT)}
    fits = [calib.identify(machines.model(bare, **FREE, **terms), data) for terms in (moments, {})]
    assert {p.unit for p in fits[0].parameters if ".lateral_moment_" in p.name} == {"kg m rad/Nm"}
    assert np.hypot(lab.miss(fits[0]), np.sqrt(3.0) * SIGMA) < 1.1 * np.sqrt(3.0) * SIGMA
    assert lab.miss(fits[1]) > 10.0 * lab.miss(fits[0])


def test_what_cannot_be_told_apart_is_said() -> None:
    """A wrist that hangs on one spot: its bearings hold nothing that changes, and so look like placements."""
    lab = Lab(8)
    lab.readings[:, 2:] = lab.readings[0, 2:]
    fit = calib.identify(machines.model(lab.robot, offsets="all", placements="all", lateral="all"), lab.measure())
    names = [p.name for p in fit.parameters]
    wrist = [k for k, name in enumerate(names) if name.startswith("wrist_3_joint.lateral")]
    assert len(wrist) == 2
    assert fit.rank < len(names)
    assert not np.isfinite(fit.sigmas[wrist]).any()
    assert any("lateral" in direction.parameter or "lateral" in str(direction) for direction in fit.null_space)


def twist(at: Array, forward: Array, back: Array) -> Array:
    """Small motions (N, 6), in the frames ``at`` (N, 4, 4), from one placement (N, 4, 4) to another."""
    R = at[:, :3, :3].swapaxes(1, 2)
    turns = Rotation.from_matrix(R @ forward[:, :3, :3] @ back[:, :3, :3].swapaxes(1, 2) @ at[:, :3, :3]).as_rotvec()
    return np.hstack([np.einsum("nij,nj->ni", R, forward[:, :3, 3] - back[:, :3, 3]), turns])


def arm_with_loop() -> Robot:
    return calib.load_robot(IRB, "tool0", loops=[LOOP])


@pytest.mark.parametrize("robot", [calib.load_robot(*UR10), arm_with_loop()], ids=["chain", "closed loop"])
def test_what_bearings_hold_is_the_slope_of_the_energy(robot: Robot) -> None:
    """dV/du of a weight at the tip, against tips whose joints' placements are turned: loops follow in both."""
    names = [joint.name for joint in robot.chain if joint.type == "revolute"]
    mass, centre = 7.0, np.array([0.1, -0.2, 0.3])
    equipped = with_joint_terms(robot, [JointTerm(name, f"lateral_{a}") for name in names for a in "xy"])
    weights = Weights(
        equipped.mechanism, (Body(robot.tip_joint, mass, centre, np.zeros((3, 3))),), np.array(robot.gravity)
    )
    rng = np.random.default_rng(2)
    u = rng.uniform(-0.5, 0.5, (6, len(robot.readings)))
    held = Holding(weights)(u)[:, len(robot.readings) :]

    def energy(d: Deviations) -> Array:
        return -mass * (robot.tips(u, d) @ [*centre, 1.0])[:, :3] @ np.array(robot.gravity)

    h, number = 1e-5, {joint.name: i for i, joint in enumerate(robot.chain)}
    for t, term in enumerate(equipped.terms):
        slopes = []
        for sign in (1.0, -1.0):
            placements = np.zeros((len(robot.chain), 6))
            placements[number[term.reading], 3 + "xy".index(term.kind[-1])] = sign * h
            slopes.append(energy(Deviations(placements, np.zeros(len(robot.moving)))))
        np.testing.assert_allclose(
            held[:, t], (slopes[0] - slopes[1]) / (2.0 * h), rtol=0, atol=1e-5, err_msg=term.name
        )
    assert np.abs(held).max() > 10.0


@pytest.mark.parametrize("name", ["chain", "closed loop", "slides"])
def test_derivatives_match_central_differences(name: str) -> None:
    """By every coefficient, at coefficients up to three times as large as ordinary ones."""
    rng = np.random.default_rng(4)
    if name == "slides":
        robot = machines.load(machines.INLINE["gantry"], "tip")
        terms: dict[str, object] = {"lateral_moments": "all"}
    else:
        robot = calib.load_robot(*UR10) if name == "chain" else arm_with_loop()
        terms = {"lateral_moments": ["joint_2" if robot.loops else "elbow_joint"]}
        terms |= dict.fromkeys(("lateral", "torsion", "elastic"), "all")
    robot = calib.error_model(robot, terms=terms).robot
    if name == "slides":
        # About the vertical, which y is here, gravity has no torque.
        assert {term.kind[-1] for term in robot.terms if term.reading == "carriage"} == {"y", "z"}
    model = calib.error_model(robot, terms=list(robot.terms))
    sizes = np.array([p.typical_size for p in model.parameters() if p.kind == "term"])
    placements = rng.normal(scale=1e-3, size=(len(robot.chain), 6))
    d = Deviations(placements, np.zeros(len(robot.moving)), 3.0 * sizes * rng.uniform(-1, 1, len(sizes)))
    u = rng.uniform(-0.4, 0.4, (4, len(robot.readings)))
    motion = robot.motion(u, d)
    for t, term in enumerate(robot.terms):
        h = 1e-5 / max(float(np.abs(motion.by_terms[:, :, t]).max()), 1e-2)
        step = h * (np.arange(len(robot.terms)) == t)
        ends = [robot.tips(u, replace(d, terms=d.terms + s)) for s in (step, -step)]
        numeric = twist(motion.placement, *ends) / (2.0 * h)
        largest = max(float(np.abs(numeric).max()), 1e-2)
        # Loops are closed by a search that ends at rounding of its own.
        limit = (1e-6 if name == "closed loop" else 1e-7) * largest
        np.testing.assert_allclose(motion.by_terms[:, :, t], numeric, rtol=0, atol=limit, err_msg=term.name)


def test_columns_of_all_parameters_match_central_differences() -> None:
    lab = Lab(12, 6)
    model = machines.model(lab.robot, **FREE, lateral="all", torsion="all", bending="all", tool="pose", elastic="all")
    parameters = model.parameters()
    scale = np.array([parameter.typical_size for parameter in parameters])
    x = lab.rng.uniform(-20.0, 20.0, len(parameters)) * scale
    problem = Problem(model, parameters, Frames(np.eye(4)[None], np.eye(4)[None]), (lab.measure(),))

    jacobians.check(problem, x, 1e-2 * scale, within=2e-6, least=1e-2)


def test_neither_the_order_of_rows_nor_the_place_of_the_room_matters() -> None:
    lab = Lab(6, 100)
    data, model = lab.measure(), machines.model(lab.robot, **FREE, lateral=["elbow_joint"])
    found = calib.identify(model, data)
    room = machines.pose((3.0, -2.0, 1.0), (0.4, 1.0, -0.3))
    assert data.position is not None
    elsewhere = replace(data, position=data.position @ room[:3, :3].T + room[:3, 3])
    for rows in (data.subset(np.random.default_rng(0).permutation(len(data))), elsewhere):
        again = calib.identify(model, rows)
        for name in ("elbow_joint.lateral_x", "elbow_joint.lateral_y"):
            assert again.value(name) == pytest.approx(found.value(name), rel=1e-5)


def test_the_model_read_back_gives_way_alike(tmp_path: Path) -> None:
    lab = Lab(9, 80)
    for robot, terms in (
        (lab.robot, {"lateral": "all", "torsion": "all"}),
        (weightless(), {"lateral_moments": ["elbow_joint"]}),
    ):
        fit = calib.identify(machines.model(robot, **FREE, **terms), lab.measure(robot))
        folder = tmp_path / next(iter(terms))
        folder.mkdir()
        for name, text in machine_files(machine_of(fit)).items():
            (folder / name).write_bytes(text.encode() if isinstance(text, str) else text)
        again = calib.load_machine(folder)
        assert again.robot.terms == fit.robot.terms
        np.testing.assert_allclose(
            again.tips(lab.readings), fit.robot.tips(lab.readings, fit.deviations), rtol=0, atol=1e-13
        )


def test_what_nobody_can_mean_is_refused() -> None:
    robot = calib.load_robot(*UR10)
    for options, sentence in (
        ({"lateral": ["ee_fixed_joint"]}, "lateral: 'ee_fixed_joint' matches no joint of the arm"),
        ({"lateral": "arm"}, 'lateral: \'arm\' is not "all", "none" or a list of names'),
        ({"lateral": "all", "dh": "all"}, "lateral: links bend and expand between joints of the URDF"),
        ({"torsion": ["world_joint"]}, "torsion: there is no link before 'world_joint'"),
    ):
        with pytest.raises(JobError, match=re.escape(sentence)):
            machines.model(robot, **options)


def test_a_bearing_is_one_joint_whatever_masses_tilt_it() -> None:
    """Pinocchio's memory grows with the cube of how many joints there are: of six bearings, each with its masses."""
    robot = calib.error_model(weightless(), terms={"lateral_moments": "all"}).robot
    assert len(robot.terms) > 50
    tilts = {(term.reading, term.kind) for term in robot.terms}
    assert len(robot.flexures.every) == len(tilts) <= 12
