"""Links that give way: statics and potential energy by code that shares nothing with the toolkit."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib.foundations import rigid
from calib.foundations.errors import RobotError
from calib.robot.conditions import Conditions
from calib.robot.gravity import Body, Holding, Payload, Weights
from calib.robot.joint_terms import foreign, moments, weights_of, with_joint_terms
from calib.robot.load import load_robot
from calib.robot.robot import Deviations, Robot, TipModel, segments
from calib.robot.terms import JointTerm, kind_of
from calib.robot.urdf import parse_urdf
from tests.robot.test_gravity import DOWN, LOOP, PANDA, UR10, potential
from tests.support import beams, machines, trees

Array = np.ndarray
ROOT = Path(__file__).resolve().parents[2]
IRB = ROOT / "robots" / "irb2400" / "irb2400.urdf"


def links_of(robot: Robot) -> list[str]:
    return [joint.name for joint in robot.chain if np.linalg.norm(joint.placement[:3, 3]) > 0.0]


def soft(robot: Robot, unknown: bool = True) -> Robot:
    """Everything at once: links bend, twist and expand, drives wind up under masses and, if ``unknown``, moments."""
    names = links_of(robot)
    terms = [JointTerm(joint, "bending") for joint in names[1::2]]
    terms += [JointTerm(joint, "expansion") for joint in names[::3]]
    terms += [JointTerm(joint, "torsion") for joint in names[::2]]
    terms += [JointTerm("", "expansion"), *(moments(robot) if unknown else ())]
    terms += [JointTerm(reading.name, kind) for reading in robot.readings for kind in ("gain", "elastic")]
    return with_joint_terms(robot, terms)


def robot_of(name: str) -> Robot:
    if name == "irb2400":
        return load_robot(IRB, "tool0", loops=[LOOP], gravity=DOWN)
    if name == "tree":
        return tree()
    if name == "gantry":
        return load_robot(machines.load(machines.INLINE[name].replace(*WEIGHED), "tip").urdf, "tip", gravity=DOWN)
    return load_robot(*{"ur10": (UR10, "tool0"), "panda": (PANDA, "panda_hand_tcp")}[name], gravity=DOWN)


def tree(links: tuple[str, ...] = ("chest_link", "right_elbow_link", "left_forearm_link")) -> Robot:
    """A torso with two arms, of which these links have masses beside their line."""
    text = trees.urdf()
    for link in links:
        body = '<inertial><origin xyz=".03 .05 .13"/><mass value="20"/></inertial>'
        text = text.replace(f'<link name="{link}"/>', f'<link name="{link}">{body}</link>')
    return load_robot(parse_urdf(text.encode(), "tree.urdf"), "right_hand", links=["left_hand"], gravity=DOWN)


WEIGHED = (
    '<link name="tip"/>',
    '<link name="tip"><inertial><origin xyz="0 .1 .2"/><mass value="3"/></inertial></link>',
)


def amounts_of(robot: Robot, rng: np.random.Generator, size: float) -> Array:
    """Coefficients that move tips by some ``size`` rad; far from zero they are tenths."""
    scale = {"elastic": 1e-2, "moment": 1e-2, "bending": 1e-2, "torsion": 1e-2, "expansion": 1e-1, "gain": 1.0}
    return np.array([scale[term.kind] for term in robot.terms]) * rng.uniform(-size, size, len(robot.terms))


def rows(robot: Robot, rng: np.random.Generator, n: int = 3) -> tuple[Array, Conditions]:
    return rng.uniform(-0.5, 0.5, (n, len(robot.readings))), Conditions(temperature=rng.uniform(15.0, 30.0, n))


@pytest.mark.parametrize(
    ("name", "size"),
    [
        ("ur10", 1e-3),
        ("ur10", 0.1),
        ("panda", 0.1),
        ("gantry", 0.1),
        ("tree", 0.1),
        ("irb2400", 1e-3),
        ("irb2400", 0.1),
    ],
)
def test_derivatives_match_central_differences(name: str, size: float) -> None:
    """By coefficients, by placements and by offsets, which all act through links that have given way."""
    rng = np.random.default_rng(2)
    robot = soft(robot_of(name), unknown=name != "tree")
    u, told = rows(robot, rng)
    d = Deviations(
        rng.normal(scale=1e-3, size=(len(robot.chain), 6)),
        rng.normal(scale=1e-3, size=len(robot.moving)),
        amounts_of(robot, rng, size),
    )
    motion = robot.motion(u, d, told)
    assert motion.by_terms.shape == (len(u), 6, len(robot.terms))
    assert robot.joint_positions(u, d, told).shape == (len(u), len(robot.moving))
    J = motion.by_deviations

    def twist(forward: Deviations, back: Deviations, h: float) -> Array:
        ends = robot.tips(u, forward, told) - robot.tips(u, back, told)
        change = rigid.inverse(motion.placement) @ ends / (2.0 * h)
        w = change[:, :3, :3]
        return np.column_stack([change[:, :3, 3], w[:, 2, 1], w[:, 0, 2], w[:, 1, 0]])

    def compare(found: Array, expected: Array, least: float = 0.1) -> None:
        assert np.abs(found - expected).max() <= 1e-6 * max(least, np.abs(expected).max())

    unit = 1e-6 / np.maximum(np.abs(motion.by_terms).max(axis=(0, 1)), 1e-3)
    # Of hardly bent arms some coefficients, as some numbers of the placements.
    few = rng.choice(len(robot.terms), 10, replace=False) if size < 0.1 else range(len(robot.terms))
    for t in few:
        step = unit[t] * (np.arange(len(robot.terms)) == t)
        compare(
            motion.by_terms[:, :, t],
            twist(replace(d, terms=d.terms + step), replace(d, terms=d.terms - step), unit[t]),
            1e-3,
        )
    for k in rng.choice(d.placements.size, 10, replace=False):
        step = 1e-5 * (np.arange(d.placements.size) == k).reshape(-1, 6)
        ends = (replace(d, placements=d.placements + s) for s in (step, -step))
        compare(J[:, :, k], twist(*ends, 1e-5))
    for j in range(len(d.offsets)):
        step = 1e-5 * (np.arange(len(d.offsets)) == j)
        ends = (replace(d, offsets=d.offsets + s) for s in (step, -step))
        compare(J[:, :, d.placements.size + j], twist(*ends, 1e-5))


def carried(
    source: str, robot: Robot, u: Array, after: str
) -> tuple[Array, Array, list[tuple[float, Array]], list[tuple[float, Array]], Array]:
    """The joint's placement before its own motion, its link vector, and the masses that it carries, in the root.

    Then the masses of the link itself, those welded to it too, in its own frame, and where that is turned.
    """
    document = machines.read(source)
    by_child = {joint.child: joint for joint in document.robot.joints}
    readings = dict(zip([reading.name for reading in robot.readings], u, strict=True))

    def placed(link: str) -> tuple[Array, bool]:
        T, through = np.eye(4), False
        while link in by_child:
            joint = by_child[link]
            origin = np.eye(4) if joint.origin is None else joint.origin
            if joint.type in ("revolute", "continuous"):
                axis = joint.axis / np.linalg.norm(joint.axis)
                origin = origin @ machines.pose(rotvec=axis * readings.get(joint.name, 0.0))
            T, link, through = origin @ T, joint.parent, through or joint.name == after
        return T, through

    joint = document.joint_map[after]
    masses = []
    for link in document.robot.links:
        T, through = placed(link.name)
        if through and link.inertial is not None and link.inertial.mass:
            c = np.zeros(3) if link.inertial.origin is None else link.inertial.origin[:3, 3]
            masses.append((link.inertial.mass, T[:3, :3] @ c + T[:3, 3]))
        if link.name == robot.tip and robot.payload is not None:
            masses.append((robot.payload.mass, (T @ [*robot.payload.position, 1.0])[:3]))
    parent, _ = placed(joint.parent)
    own = []
    for link in document.robot.links:
        at = link.name
        while at != joint.parent and at in by_child and by_child[at].type == "fixed":
            at = by_child[at].parent
        if at == joint.parent and link.inertial is not None and link.inertial.mass:
            c = np.zeros(3) if link.inertial.origin is None else link.inertial.origin[:3, 3]
            own.append((link.inertial.mass, (np.linalg.inv(parent) @ placed(link.name)[0] @ [*c, 1.0])[:3]))
    return parent @ joint.origin, parent[:3, :3] @ joint.origin[:3, 3], masses, own, parent[:3, :3]


@pytest.mark.parametrize(
    ("source", "tip", "joint"),
    [(UR10, "tool0", "elbow_joint"), (UR10, "tool0", "shoulder_lift_joint"), (PANDA, "panda_hand_tcp", "panda_joint4")],
)
def test_a_link_bends_as_a_beam_under_what_it_carries(source: str, tip: str, joint: str) -> None:
    """Forces and moments by plain statics, the beam's end by the textbook: (F L^3/3 + M L^2/2) / EI sideways.

    What its own weight adds comes from an integral of the beam's equation.
    """
    rng = np.random.default_rng(4)
    plain = load_robot(source, tip, gravity=DOWN, payload=Payload(4.0, (0.05, 0.1, 0.2)))
    robot = with_joint_terms(plain, [JointTerm(joint, "bending")])
    compliance = 1e-7
    d = replace(robot.no_deviations(), terms=np.array([compliance]))
    u = rng.uniform(-1.5, 1.5, (6, len(robot.readings)))
    straight, bent = plain.tips(u), robot.tips(u, d)
    for n in range(len(u)):
        T, link, masses, own, R = carried(source, robot, u[n], joint)
        L = float(np.linalg.norm(link))
        e = link / L
        F = sum(m * np.array(DOWN) for m, _ in masses)
        M = sum(m * np.cross(c - T[:3, 3], DOWN) for m, c in masses)
        EI = L / compliance
        across = np.eye(3) - np.outer(e, e)
        sideways = across @ (F * L**3 / 3.0 + np.cross(M, e) * L**2 / 2.0) / EI
        turn = across @ (M * L + np.cross(e, F) * L**2 / 2.0) / EI
        assert own
        for m, c in own:
            sunk, turned, _ = beams.own_weight(R.T @ link, c)
            sideways = sideways + R @ sunk @ R.T @ DOWN * m / EI
            turn = turn + R @ turned @ R.T @ DOWN * m / EI
        about = T[:3, 3]
        moved = Rotation.from_rotvec(turn).apply(straight[n, :3, 3] - about) + about + sideways
        shift = np.linalg.norm(moved - straight[n, :3, 3])
        assert shift > 1e-8
        # Torques do not feel how far the link is bent, so that what is left is of second order.
        assert np.linalg.norm(bent[n, :3, 3] - moved) < 1e-4 * shift
        expected = Rotation.from_rotvec(turn).as_matrix() @ straight[n, :3, :3]
        np.testing.assert_allclose(bent[n, :3, :3], expected, rtol=0, atol=1e-4 * np.linalg.norm(turn))


CANTILEVER = """<robot name="cantilever"><link name="base"/>
<joint name="root" type="revolute"><parent link="base"/><child link="beam"/><axis xyz="0 0 1"/>
<limit lower="-3" upper="3" effort="1" velocity="1"/></joint>
<link name="beam"><inertial><origin xyz="{0} 0 0"/><mass value="{1}"/></inertial></link>
<joint name="end" type="revolute"><parent link="beam"/><child link="tip"/><origin xyz="1.6 0 0"/><axis xyz="0 0 1"/>
<limit lower="-3" upper="3" effort="1" velocity="1"/></joint><link name="tip"/></robot>"""


@pytest.mark.parametrize("place", [0.5, 1.0, 1.2, 0.0, -0.2])
def test_a_cantilever_sags_under_its_own_weight_as_in_the_textbook(place: float) -> None:
    """W L^3/8EI and W L^2/6EI of an even beam; W L^3/3EI and W L^2/2EI at its end, with a moment where it is beyond."""
    L, mass, k = 1.6, 12.0, 1e-6
    urdf = parse_urdf(CANTILEVER.format(place * L, mass).encode(), "cantilever.urdf")
    robot = with_joint_terms(load_robot(urdf, "tip", gravity=(0, 0, -10.0)), [JointTerm("end", "bending")])
    (T,) = robot.tips(np.zeros((1, 2)), replace(robot.no_deviations(), terms=np.array([k])))
    W, EI = 10.0 * mass, L / k
    beyond = max(place - 1.0, 0.0) * W * L
    sinks, turns = {0.5: (W * L**3 / 8.0, W * L**2 / 6.0), 0.0: (0.0, 0.0), -0.2: (0.0, 0.0)}.get(
        place, (W * L**3 / 3.0 + beyond * L**2 / 2.0, W * L**2 / 2.0 + beyond * L)
    )
    np.testing.assert_allclose(T[:3, 3], [L, 0.0, -sinks / EI], rtol=0, atol=1e-15)
    np.testing.assert_allclose(Rotation.from_matrix(T[:3, :3]).as_rotvec(), [0.0, turns / EI, 0.0], rtol=0, atol=1e-12)


def test_of_a_tree_a_trunk_that_weighs_bends_to_each_branch() -> None:
    """The chest alone has a mass, beside the way to the shoulder: shift, turn and twist by integrals of the beam."""
    rng = np.random.default_rng(11)
    plain = tree(("chest_link",))
    terms = [JointTerm("right_shoulder_pan", kind) for kind in ("bending", "torsion")]
    robot = with_joint_terms(plain, terms)
    chest = load_robot(plain.urdf, "chest_link")
    u = rng.uniform(-0.5, 0.5, (5, len(robot.readings)))
    names = [reading.name for reading in robot.readings]
    trunk = chest.tips(u[:, [names.index(reading.name) for reading in chest.readings]])
    vector, k = np.array([-0.2, 0.05, 0.3]), np.array([1e-8, 3e-8])
    L = float(np.linalg.norm(vector))
    found = robot.tips(u, replace(robot.no_deviations(), terms=k))
    for n, straight in enumerate(plain.tips(u)):
        R, about = trunk[n, :3, :3], (trunk[n] @ [*vector, 1.0])[:3]
        shift, turn, twist = (
            R @ moved @ R.T @ DOWN * 20.0 * c / L
            for moved, c in zip(beams.own_weight(vector, np.array([0.03, 0.05, 0.13])), k[[0, 0, 1]], strict=True)
        )
        moved = shift + np.cross(turn + twist, straight[:3, 3] - about)
        assert np.linalg.norm(twist) > 0.01 * np.linalg.norm(turn)
        np.testing.assert_allclose(
            found[n, :3, 3] - straight[:3, 3], moved, rtol=0, atol=1e-3 * float(np.linalg.norm(moved))
        )


def test_what_flexures_hold_is_the_slope_of_the_energy_on_the_parallelogram() -> None:
    """Rod and crank follow the bent link: the loop is closed anew; heights are those of all masses, the link's too."""
    robot = with_joint_terms(
        robot_of("irb2400"), [JointTerm(j, "bending") for j in ("elbow_cancel", "joint_3", "joint_5")]
    )
    every = robot.flexures.every
    u = np.random.default_rng(5).uniform(-0.4, 0.4, (2, 6))
    found = Holding(weights_of(robot))(u)
    assert found.shape == (2, 6 + 12)
    document = machines.read(str(IRB))
    by_child = {joint.child: joint for joint in document.robot.joints}
    chain = {joint.name: (i, joint) for i, joint in enumerate(robot.chain)}

    def placed(link: str, q: dict[str, float], flexed: Array) -> Array:
        T = np.eye(4)
        while link in by_child:
            joint = by_child[link]
            origin = np.eye(4) if joint.origin is None else joint.origin
            if joint.name in chain:
                i, own = chain[joint.name]
                give = own.frame
                for k, flexure in enumerate(every):
                    if flexure.joint == i:
                        travel = flexure.axis * flexed[k]
                        give = give @ (
                            machines.pose(travel) if flexure.type == "prismatic" else machines.pose(rotvec=travel)
                        )
                origin = origin @ give @ np.linalg.inv(own.frame)
            if joint.type != "fixed":
                driver, value = joint, 1.0
                while driver.name not in q:
                    value *= driver.mimic.multiplier
                    driver = document.joint_map[driver.mimic.joint]
                origin = origin @ machines.pose(rotvec=joint.axis * value * q[driver.name])
            T, link = origin @ T, joint.parent
        return T

    def energy(u: Array, flexed: Array) -> float:
        q = {f"joint_{k + 1}": u[k] for k in range(6)}
        start = robot.joint_positions(u[None])[0]
        of_moving = {robot.chain[i].name: start[j] for j, i in enumerate(robot.moving)}

        def gap(passive: Array) -> Array:
            at = q | dict(zip(LOOP.passive, passive, strict=True))
            first, other = (placed(frame, at, flexed) for frame in LOOP.frames)
            return (first[:3, :3].T @ (other[:3, 3] - first[:3, 3]))[[0, 2]]

        passive = np.array([of_moving[name] for name in LOOP.passive])
        for _ in range(6):
            slope = [(gap(passive + s) - gap(passive - s)) / 2e-4 for s in 1e-4 * np.eye(2)]
            passive -= np.linalg.solve(np.transpose(slope), gap(passive))
        assert np.abs(gap(passive)).max() < 1e-14
        q |= dict(zip(LOOP.passive, passive, strict=True))
        total = 0.0
        for link in document.robot.links:
            if link.inertial is not None and link.inertial.mass:
                c = np.zeros(3) if link.inertial.origin is None else link.inertial.origin[:3, 3]
                T = placed(link.name, q, flexed)
                at = (T @ [*c, 1.0])[:3]
                for i in {flexure.joint for flexure in every}:
                    origin = document.joint_map[robot.chain[i].name].origin
                    if document.joint_map[robot.chain[i].name].parent == link.name:
                        turned = origin[:3, :3] @ robot.chain[i].frame[:3, :3]
                        ends = [
                            sum(
                                f.axis * x for f, x in zip(every, flexed, strict=True) if (f.joint, f.type) == (i, kind)
                            )
                            for kind in ("prismatic", "revolute")
                        ]
                        at += T[:3, :3] @ beams.followed(origin[:3, 3], c, *(turned @ end for end in ends))
                total -= link.inertial.mass * float(np.dot(DOWN, at))
        return total

    h = 1e-4
    for n in range(len(u)):
        for k in range(len(every)):
            step = h * (np.arange(len(every)) == k)
            slope = (energy(u[n], step) - energy(u[n], -step)) / (2.0 * h)
            assert found[n, 6 + k] == pytest.approx(slope, abs=1e-4), every[k]
    assert np.abs(found[:, 6:]).max() > 100.0


@pytest.mark.parametrize(
    ("name", "joint"), [("ur10", "shoulder_lift_joint"), ("panda", "panda_joint5"), ("irb2400", "rod_length")]
)
def test_lengths_grow_with_the_temperature(name: str, joint: str) -> None:
    """The whole arm at once is the arm scaled; one link alone moves what it carries along itself."""
    rng = np.random.default_rng(6)
    plain = robot_of(name)
    u, told = rows(plain, rng)
    strain = 1e-3 * (told.temperature - 20.0)
    robot = with_joint_terms(plain, [JointTerm("", "expansion")])
    grown = robot.tips(u, replace(robot.no_deviations(), terms=np.array([1e-3])), told)
    expected = plain.tips(u)
    expected[:, :3, 3] *= 1.0 + strain[:, None]
    np.testing.assert_allclose(grown, expected, rtol=0, atol=1e-13)
    one = with_joint_terms(plain, [JointTerm(joint, "expansion")])
    for n in range(len(u)):
        i = [j.name for j in plain.chain].index(joint)
        longer = plain.chain[i].placement.copy()
        longer[:3, 3] *= 1.0 + strain[n]
        chain = tuple(replace(j, placement=longer) if k == i else j for k, j in enumerate(plain.chain))
        expected = replace(plain, chain=chain).tips(u[n : n + 1])
        d = replace(one.no_deviations(), terms=np.array([1e-3]))
        np.testing.assert_allclose(one.tips(u[n : n + 1], d, told.subset([n])), expected, rtol=0, atol=1e-13)


@pytest.mark.parametrize(("source", "tip"), [(UR10, "tool0"), (PANDA, "panda_hand_tcp")])
def test_moments_are_the_slopes_of_the_energy_of_a_mass(source: str, tip: str) -> None:
    """What nine kilograms beside the tip hold, by an independent walk, and by their first moment and mass."""
    empty, loaded = (load_robot(source, tip, gravity=DOWN, payload=p) for p in (None, Payload(9.0, (0.1, 0.2, -0.3))))
    assert loaded.payload is not None
    names = [reading.name for reading in empty.readings]
    i = empty.moving[-1] if source == UR10 else [joint.name for joint in empty.chain].index("panda_joint7")
    last = empty.chain[i]
    bodies = [f"{last.name}_{what}" for what in ("x", "y", "z", "mass")]
    robot = with_joint_terms(empty, [JointTerm(names[1], "moment", body=body) for body in bodies])
    assert robot.weights is not None
    # The payload in the frame of the last joint: what lies between never moves.
    T = np.linalg.inv(last.frame)
    for joint in empty.chain[i + 1 : empty.tip_joint + 1]:
        T = T @ _origin(source, joint.name)
    place = (T @ [*loaded.payload.position, 1.0])[:3]
    u = np.random.default_rng(7).uniform(-1.5, 1.5, (3, len(names)))
    torques = np.einsum("knc,k->nc", Holding(robot.weights).of_units(u), 9.0 * np.array([*place, 1.0]))
    h = 1e-4
    for n in range(len(u)):
        for k in range(len(names)):
            at = [dict(zip(names, u[n] + s * h * (np.arange(len(names)) == k), strict=True)) for s in (1.0, -1.0)]
            with_mass, without = (
                [potential(source, dict(q), payload, tip) for q in at] for payload in (loaded.payload, None)
            )
            slope = (np.subtract(*with_mass) - np.subtract(*without)) / (2.0 * h)
            assert torques[n, k] == pytest.approx(slope, abs=1e-5)
    assert np.abs(torques).max() > 10.0


def _origin(source: str, joint: str) -> Array:
    origin = machines.read(source).joint_map[joint].origin
    return np.eye(4) if origin is None else np.asarray(origin)


@pytest.mark.parametrize("name", ["ur10", "skew", "irb2400"])
def test_moments_make_up_whatever_masses_there_are(name: str) -> None:
    """Masses anywhere on every link: what any reading holds is a sum of its moments, no one of which is spare."""
    rng = np.random.default_rng(9)
    robot = load_robot(machines.load(machines.INLINE[name], "tip").urdf, "tip") if name == "skew" else robot_of(name)
    robot = replace(robot, gravity=(0.0, 0.0, -9.81))
    bodies = tuple(
        Body(i, rng.uniform(1.0, 5.0), rng.normal(scale=0.3, size=3), np.zeros((3, 3))) for i in robot.moving
    )
    u = rng.uniform(-0.4, 0.4, (200, len(robot.readings)))
    torques = Holding(Weights(robot.mechanism, bodies, np.array(robot.gravity)))(u)
    terms = moments(robot)
    equipped = with_joint_terms(robot, terms)
    assert equipped.weights is not None
    holding = Holding(equipped.weights)
    each = holding.of_units(u)
    for k, reading in enumerate(robot.readings):
        own = [holding.units[term.body] for term in terms if term.reading == reading.name]
        A = each[own, :, k].T
        left = torques[:, k] - A @ np.linalg.lstsq(A, torques[:, k], rcond=None)[0] if own else torques[:, k]
        assert np.abs(left).max() < 1e-9
        assert np.linalg.matrix_rank(A, 1e-6) == len(own)


def test_as_few_moments_as_tell_masses_apart() -> None:
    found = [term.name for term in moments(load_robot(UR10, "tool0"))]
    lift = [name.removeprefix("shoulder_lift_joint.moment_") for name in found if name.startswith("shoulder_lift")]
    joints = ("shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
    # What stands along an axis is carried as by the link before, and so is the mass itself.
    assert lift == [f"{joint}_joint_{axis}" for joint in joints for axis in "xy"]
    assert not [name for name in found if name.startswith("shoulder_pan")]
    irb = [term.name for term in moments(load_robot(IRB, "tool0", loops=[LOOP]))]
    # On a parallelogram the lower arm holds all that its end carries, wherever the upper arm stands.
    assert [name for name in irb if name.startswith("joint_2")] == [f"joint_2.moment_joint_2_{axis}" for axis in "xy"]
    # Gravity along the first axis is why the pan lifts nothing: on a wall it does.
    assert "shoulder_pan_joint" in {term.reading for term in moments(load_robot(UR10, "tool0", gravity=(9.81, 0, 0)))}


def test_a_robot_without_such_terms_is_what_it_was() -> None:
    robot = robot_of("irb2400")
    assert robot.mechanism.rigid
    assert [s.placement.tobytes() for s in robot.mechanism.segments] == [s.placement.tobytes() for s in segments(robot)]
    limp = soft(robot)
    u, told = rows(robot, np.random.default_rng(8))
    np.testing.assert_allclose(limp.tips(u, None, told), robot.tips(u), rtol=0, atol=1e-13)
    np.testing.assert_allclose(limp.joint_positions(u, None, told), robot.joint_positions(u), rtol=0, atol=1e-13)
    J, plain = TipModel(limp).driven(u, told)[1], TipModel(robot).driven(u)[1]
    np.testing.assert_allclose(J, plain, rtol=0, atol=1e-12)


def test_what_the_robot_does_not_have_is_refused() -> None:
    robot = load_robot(UR10, "tool0")
    for term, sentence in (
        (JointTerm("world_joint", "bending"), "there is no link before 'world_joint'"),
        (
            JointTerm("shoulder_lift_joint", "moment", body="elbow_x"),
            "the robot has no moment of mass 'elbow_x'",
        ),
    ):
        assert foreign(robot, [term])
        with pytest.raises(RobotError, match=sentence):
            with_joint_terms(robot, [term])
    hot = with_joint_terms(robot, [JointTerm("", "expansion")])
    with pytest.raises(RobotError, match=r"arm\.expansion needs 'temperature' for every row"):
        hot.tips(np.zeros((1, 6)), replace(hot.no_deviations(), terms=np.ones(1)))


def test_names_and_units() -> None:
    terms = [
        JointTerm("a", "moment", body="b_x"),
        JointTerm("a", "moment", body="b_mass"),
        JointTerm("a", "bending"),
        JointTerm("a", "expansion"),
        JointTerm("", "expansion"),
    ]
    assert [term.name for term in terms] == [
        "a.moment_b_x",
        "a.moment_b_mass",
        "a.bending",
        "a.expansion",
        "arm.expansion",
    ]
    assert [kind_of(term).coefficient(term, "angle").unit for term in terms] == [
        "kg m rad/Nm",
        "kg rad/Nm",
        "rad/Nm",
        "1/K",
        "1/K",
    ]
    assert [kind_of(term).coefficient(term, "length").unit for term in terms[:3]] == ["kg m2/N", "kg m/N", "rad/Nm"]
