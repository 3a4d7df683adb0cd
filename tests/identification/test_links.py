"""Links that bend and expand, drives wound up by masses that nobody knows: found again on arms simulated by numpy."""

import json
import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

import calib
from calib.assessment.choice import candidates, choose_terms
from calib.assessment.linearised import Candidate
from calib.compensation.commands import for_joint_targets
from calib.compensation.controllers.ros import export_ros
from calib.foundations.errors import JobError, MeasurementError, RobotError
from calib.identification.machine import Frames
from calib.identification.system import Problem
from calib.machine.model_file import model_json
from calib.machine.of_fit import machine_of
from calib.machine.tool_uncertainty import tool_uncertainty
from calib.robot.conditions import Conditions
from calib.robot.gravity import Payload
from calib.robot.sources import resolve
from calib.robot.terms import JointTerm, kind_of
from calib.robot.urdf import parse_urdf
from tests.support import beams, jacobians, machines
from tests.support.gears import UR10

Array = np.ndarray
SIGMA = 3e-5
PAYLOAD = Payload(10.0, (0.0, 0.08, 0.12))
G = np.array([0.0, 0.0, -9.80665])
DRIVES = {"shoulder_lift_joint": 8e-6, "elbow_joint": 1.2e-5, "wrist_1_joint": 4e-5}
LINKS = {"elbow_joint": 5e-6, "wrist_1_joint": 8e-6}
STRAIN = 1.7e-5
FREE = {"offsets": "all", "placements": "all"}


@dataclass(frozen=True)
class Soft(machines.Arm):
    """A UR10 whose drives and links give way to gravity, as they hold it at ``nominal`` geometry, and grow."""

    nominal: machines.Arm
    drives: dict[str, float]
    links: dict[str, float]
    strain: float

    def at(self, readings: Array, degrees: Array) -> Array:
        """Tips (N, 4, 4) at readings (N, 6) and temperatures (N,) in degC."""
        return np.stack([self._tip(u, t) for u, t in zip(readings, degrees, strict=True)])

    def _tip(self, u: Array, degrees: float) -> Array:
        loads = self._loads(u)
        T, k = np.eye(4), 0
        for joint, (P, e, L, F, M, sunk, bent) in zip(self.joints, loads, strict=True):
            origin = joint.origin.copy()
            origin[:3, 3] *= 1.0 + self.strain * (degrees - 20.0)
            T = T @ origin
            if (compliance := self.links.get(joint.name, 0.0)) > 0.0:
                across = P[:3, :3].T @ (np.eye(3) - np.outer(e, e))
                sideways = across @ (F * L**2 / 3.0 + np.cross(M, e) * L / 2.0 + sunk / L) * compliance
                turn = across @ (M + np.cross(e, F) * L / 2.0 + bent / L) * compliance
                T = T @ machines.pose(sideways, turn)
            if joint.type != "fixed":
                lifted = float(np.dot(P[:3, :3] @ joint.axis, M))
                wound = u[k] + self.drives.get(joint.name, 0.0) * lifted
                T = T @ machines.pose(rotvec=joint.axis * (wound * joint.multiplier + joint.shift))
                k += 1
        return T

    def _loads(self, u: Array) -> list[tuple[Array, Array, float, Array, Array, Array, Array]]:
        """Every joint's placement, its link's direction and length, and force and moment there, in the base.

        Last how far the link's own weight shifts and turns its end where EI = 1.
        """
        document = machines.read(UR10[0])
        T, k, found = np.eye(4), 0, []
        masses: list[tuple[int, float, Array]] = []
        body = None
        for i, joint in enumerate(self.nominal.joints):
            R, sunk, bent = T[:3, :3], np.zeros(3), np.zeros(3)
            link = R @ joint.origin[:3, 3]
            if body is not None and body.mass and link.any():
                shift, turn, _ = beams.own_weight(joint.origin[:3, 3], body.origin[:3, 3])
                sunk, bent = (R @ moved @ R.T @ G * body.mass for moved in (shift, turn))
            T = T @ joint.origin
            found.append((T, link, sunk, bent))
            if joint.type != "fixed":
                T = T @ machines.pose(rotvec=joint.axis * u[k])
                k += 1
            body = document.link_map[document.joint_map[joint.name].child].inertial
            if body is not None and body.mass:
                masses.append((i, body.mass, (T @ body.origin)[:3, 3]))
        masses.append((i, PAYLOAD.mass, (T @ [*PAYLOAD.position, 1.0])[:3]))
        loads = []
        for i, (P, link, sunk, bent) in enumerate(found):
            L = float(np.linalg.norm(link))
            F = sum(m for at, m, _ in masses if at >= i) * G
            M = np.cross(sum((m * (c - P[:3, 3]) for at, m, c in masses if at >= i), np.zeros(3)), G)
            loads.append((P, link / max(L, 1e-12), L, F, M, sunk, bent))
        return loads


class Lab:
    """A badly made UR10 with a payload, anywhere in the room, in a hall that warms up."""

    def __init__(self, seed: int, n: int = 150, *, drives: bool = True, links: bool = True, warm: bool = True) -> None:
        self.rng = rng = np.random.default_rng([seed, 9])
        self.robot = calib.load_robot(*UR10, payload=PAYLOAD)
        self.plain = machines.arm(*UR10)
        moved = self.plain.moved(rng)
        parts = (self.plain, DRIVES if drives else {}, LINKS if links else {}, STRAIN if warm else 0.0)
        self.arm = Soft(moved.joints, moved.ranges, *parts)
        self.base = machines.anywhere(rng)
        self.truth = {f"{joint}.elastic": coefficient for joint, coefficient in DRIVES.items() if drives}
        self.truth |= {f"{joint}.bending": coefficient for joint, coefficient in LINKS.items() if links}
        self.truth |= {"arm.expansion": STRAIN} if warm else {}
        self.readings, self.degrees = self.plain.draw(rng, n), rng.uniform(15.0, 40.0, n)

    def points(self, readings: Array, degrees: Array) -> Array:
        return (self.base @ self.arm.at(readings, degrees) @ machines.pose((0.05, 0.02, 0.15)))[:, :3, 3]

    def measure(self, sigma: float = SIGMA, robot: calib.Robot | None = None) -> calib.Measurements:
        x = self.points(self.readings, self.degrees)
        x = x + sigma * self.rng.standard_normal(x.shape)
        columns: dict[str, object] = {
            f"{reading.name} [rad]": self.readings[:, k] for k, reading in enumerate(self.robot.readings)
        }
        columns |= {f"{axis} [m]": x[:, k] for k, axis in enumerate("xyz")} | {"temperature [degC]": self.degrees}
        return calib.read_measurements(columns, robot or self.robot, sigma=SIGMA)

    def model(self, **options: object) -> calib.ErrorModel:
        kinds = {"elastic": "elastic", "bending": "bending"}
        chosen = {
            kind: [name.split(".")[0] for name in self.truth if name.endswith(ending)] or "none"
            for kind, ending in kinds.items()
        }
        chosen["expansion"] = "arm" if "arm.expansion" in self.truth else "none"
        return machines.model(self.robot, **(FREE | chosen | options))

    def miss(self, fit: calib.Fit, n: int = 100) -> float:
        """3D rms in m of tool points in poses, and at temperatures, that were not measured."""
        u, degrees = self.plain.draw(self.rng, n), self.rng.uniform(15.0, 40.0, n)
        tips = fit.robot.tips(u, fit.deviations, Conditions(temperature=degrees))
        found = (fit.machine.frames.base @ tips @ fit.machine.frames.tools[0])[:, :3, 3]
        return float(np.sqrt(np.mean(np.sum((found - self.points(u, degrees)) ** 2, axis=1))))


def weightless() -> calib.Robot:
    """The same UR10 from a URDF that states no inertias."""
    text = re.sub(rb"<inertial>.*?</inertial>", b"", resolve(UR10[0]).read_bytes(), flags=re.DOTALL)
    assert b"inertial" not in text
    return calib.load_robot(parse_urdf(text, "weightless.urdf"), "tool0")


ALONE = [
    {"links": False, "warm": False},
    {"drives": False, "warm": False},
    {"drives": False, "links": False},
    {},
]


@pytest.mark.parametrize("parts", ALONE, ids=["wind-up", "bending", "expansion", "together"])
def test_what_is_found_lies_within_its_interval(parts: dict[str, bool]) -> None:
    inside, total = 0, 0
    for seed in range(4):
        lab = Lab(seed, 120, **parts)
        fit = calib.identify(lab.model(), lab.measure())
        names = [p.name for p in fit.parameters]
        for name, truth in lab.truth.items():
            sigma = fit.sigmas[names.index(name)]
            inside += abs(fit.value(name) - truth) < 1.96 * sigma
            total += 1
    assert inside >= 0.85 * total


def test_without_masses_moments_predict_as_well() -> None:
    """Compliances times first moments of mass, nobody told which: unseen tips as good as with the masses known."""
    missed = []
    for seed in range(2):
        lab = Lab(seed, 200, links=False, warm=False)
        bare, data = weightless(), lab.measure()
        guessed = machines.model(bare, **FREE, moments=list(DRIVES))
        fits = [calib.identify(model, data) for model in (lab.model(), guessed, machines.model(bare, **FREE))]
        missed.append([lab.miss(fit) for fit in fits])
        assert {p.unit for p in fits[1].parameters if ".moment_" in p.name} == {"kg m rad/Nm"}
    known, without_masses, neither = np.mean(missed, axis=0)
    # Rows that are held out have their noise as well; 18 coefficients in the place of 3 cost a few per cent of it.
    held_out = np.hypot([known, without_masses], np.sqrt(3.0) * SIGMA)
    assert held_out[1] < 1.05 * held_out[0]
    assert without_masses < 0.03 * neither


def test_without_masses_another_payload_is_refused() -> None:
    """It was passed over without a word, and the arm predicted as if it carried what it did before."""
    lab = Lab(0, 100, links=False, warm=False)
    fit = calib.identify(machines.model(weightless(), **FREE, moments=list(DRIVES)), lab.measure())
    machine, q = machine_of(fit), lab.readings[:5]
    heavy = np.tile([0.0, 0.0, 0.6, 12.0], (5, 1, 1))
    why = r"^shoulder_lift_joint\.moment_.* takes all masses as they were when it was identified, and cannot follow "
    for ask in (
        lambda told: machine.predict(q, conditions=told),
        lambda told: tool_uncertainty(machine, q, conditions=told),
        lambda told: for_joint_targets(machine, q, conditions=told),
    ):
        with pytest.raises(RobotError, match=why):
            ask(Conditions(payload=heavy))
        ask(Conditions(payload=0.0 * heavy))
        ask(Conditions(payload=np.nan * heavy))


def test_products_that_cannot_be_told_apart_have_no_interval() -> None:
    """The last joints never move: masses on them are one mass, and the fit says that it cannot tell them apart."""
    lab = Lab(3, 120, links=False, warm=False)
    lab.readings[:, 3:] = lab.readings[0, 3:]
    fit = calib.identify(machines.model(weightless(), offsets="all", moments="all"), lab.measure())
    names = [p.name for p in fit.parameters]
    behind = [k for k, name in enumerate(names) if name.startswith("elbow_joint.moment")]
    assert len(behind) == 8
    assert not np.isfinite(fit.sigmas[behind]).any()
    assert fit.rank < len(names)


def test_columns_match_central_differences() -> None:
    """At a point far from zero: what links do shifts with every other parameter."""
    lab = Lab(12, 6)
    model = lab.model(bending="all", moments=["elbow_joint"], expansion="all", gain="all", tool="pose")
    parameters = model.parameters()
    scale = np.array([parameter.typical_size for parameter in parameters])
    x = lab.rng.uniform(-20.0, 20.0, len(parameters)) * scale
    problem = Problem(model, parameters, Frames(np.eye(4)[None], np.eye(4)[None]), (lab.measure(),))

    jacobians.check(problem, x, 1e-2 * scale, within=2e-6, least=1e-2)


def test_neither_the_order_of_rows_nor_the_place_of_the_room_matters() -> None:
    lab = Lab(5, 80)
    data = lab.measure()
    found = calib.identify(lab.model(), data)
    again = calib.identify(lab.model(), data.subset(np.random.default_rng(0).permutation(len(data))))
    room = machines.pose((3.0, -2.0, 1.0), (0.4, 1.0, -0.3))
    assert data.position is not None
    elsewhere = replace(data, position=data.position @ room[:3, :3].T + room[:3, 3])
    moved = calib.identify(lab.model(), elsewhere)
    for other in (again, moved):
        for name in lab.truth:
            assert other.value(name) == pytest.approx(found.value(name), rel=1e-5)
    np.testing.assert_allclose(moved.machine.frames.base, room @ found.machine.frames.base, rtol=0, atol=1e-7)


def test_the_model_read_back_gives_way_alike_and_is_commanded(tmp_path: Path) -> None:
    lab = Lab(6, 80)
    robot = replace(weightless(), payload=PAYLOAD)
    for name, options in (
        ("weighed", {"bending": "all"}),
        (
            "weightless",
            {"elastic": "none", "bending": "none", "moments": "all", "expansion": ["elbow*", "*fixed_joint"]},
        ),
    ):
        model = lab.model(**options) if name == "weighed" else machines.model(robot, **FREE, **options)
        fit = calib.identify(model, lab.measure())
        folder = tmp_path / name
        folder.mkdir()
        (folder / "model.json").write_text(model_json(machine_of(fit)), encoding="utf-8")
        (folder / "nominal.urdf").write_bytes(fit.robot.urdf.source)
        again = calib.load_machine(folder)
        assert again.robot.terms == fit.robot.terms
        u = lab.rng.uniform(-0.5, 0.5, (30, 6)) + np.array([0.0, 0.0, 1.2, 0.0, 1.5, 0.0])
        told = Conditions(temperature=lab.rng.uniform(10.0, 40.0, 30))
        np.testing.assert_allclose(again.tips(u, told), fit.robot.tips(u, fit.deviations, told), rtol=0, atol=1e-13)
        assert np.linalg.norm(again.tips(u, told)[:, :3, 3] - again.robot.tips(u)[:, :3, 3], axis=1).min() > 1e-4
        found = for_joint_targets(again, u, conditions=told)
        assert found.reached.all(), found.reasons
        np.testing.assert_allclose(again.tips(found.readings, told), again.robot.tips(u), rtol=0, atol=2e-6)
        assert np.isfinite(tool_uncertainty(machine_of(fit), u).position).all()
        exported = export_ros(again).text
        terms = json.loads((folder / "model.json").read_text())["terms"]
        assert all(term["kind"] in exported for term in terms)
        assert {bool(term.get("body")) for term in terms if term["kind"] == "moment"} <= {True}


def test_what_nobody_can_mean_is_refused() -> None:
    robot = calib.load_robot(*UR10)
    for options, sentence in (
        ({"bending": ["elbow"]}, "bending: 'elbow' matches no joint of the arm; did you mean 'elbow_joint'"),
        ({"bending": ["world_joint"]}, "bending: there is no link before 'world_joint': it is at the same place"),
        ({"bending": "arm"}, 'bending: \'arm\' is not "all", "none" or a list of names'),
        ({"expansion": "some"}, 'expansion: \'some\' is not "arm", "all", "none" or a list of names'),
        ({"moments": ["shoulder_pan_joint"]}, "moments: 'shoulder_pan_joint' is never loaded by gravity"),
        ({"bending": "all", "dh": "all"}, "bending: links bend and expand between joints of the URDF; free placements"),
        (
            {"expansion": "arm", "dh": "all"},
            "expansion: links bend and expand between joints of the URDF; free placements",
        ),
    ):
        with pytest.raises(JobError, match=re.escape(sentence)):
            machines.model(robot, **options)
    lab = Lab(7, 20)
    cold = replace(lab.measure(), conditions=Conditions())
    with pytest.raises(MeasurementError, match=r"no column 'temperature', which arm\.expansion needs"):
        calib.identify(lab.model(), cold)


def test_they_are_offered_where_they_can_be_seen_and_chosen_where_they_are() -> None:
    lab = Lab(8, 200)
    data = lab.measure()

    def kinds(robot: calib.Robot, rows: calib.Measurements) -> set[str]:
        return {term.kind for one in candidates(robot, [rows], {"harmonic_orders": ()}) for term in one.terms}

    still = replace(data, conditions=Conditions(temperature=np.full(len(data), 25.0)))
    assert kinds(lab.robot, data) == {"gain", "thermal", "elastic", "bending", "expansion"}
    assert kinds(lab.robot, still) == {"gain", "elastic", "bending"}
    assert kinds(weightless(), data) == {"gain", "thermal", "moment", "expansion"}
    offered = [
        Candidate((JointTerm(joint, "bending"),)) for joint in ("shoulder_pan_joint", "elbow_joint", "wrist_1_joint")
    ]
    offered += [Candidate((JointTerm("", "expansion"),))]
    offered += [Candidate((JointTerm(joint, "elastic"),)) for joint in DRIVES]
    choice = choose_terms(machines.model(lab.robot, **FREE), data, offered=offered)
    assert {term.name for term in choice.terms} >= {"elbow_joint.bending", "shoulder_lift_joint.elastic"}
    named = [step.added.name for step in choice.steps[1:] if step.added is not None]
    assert {"arm: expansion", "elbow_joint: bending", "elbow_joint: elastic"} <= set(named)
    assert Candidate((JointTerm("a", "moment", body="b_1_x"),)).name == "a: moment b_1_x"
    table = machines.model(lab.robot, dh="all")
    assert not [term for term in choose_terms(table, still, count=3).terms if kind_of(term).of_link]
