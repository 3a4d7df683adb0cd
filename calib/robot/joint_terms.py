"""A robot with joint terms, and with the masses that some of them need."""

import functools
from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from calib.foundations.arrays import Array, read_only
from calib.foundations.errors import RobotError
from calib.robot.conditions import Conditions
from calib.robot.flexures import followed, link_length
from calib.robot.gravity import Body, Holding, Weights
from calib.robot.robot import Robot, segments
from calib.robot.sampling import random_readings
from calib.robot.terms import KINDS, NAMED, JointTerm, kind_of
from calib.robot.terms.kind import Dimension, Parts
from calib.robot.urdf import UrdfJoint, inertials

# Poses at which torques of masses are compared, and the share of the largest below which one says nothing new.
_POSES = 60
_TOLD_APART = 1e-3


def with_joint_terms(robot: Robot, terms: Sequence[JointTerm]) -> Robot:
    """Return the robot with these terms in the place of its own. ``robot`` is in the frames of its URDF.

    Raises RobotError when a term needs masses that the URDF does not state, or says in a way that cannot be used; or is
    of a link, or of a moment of mass, that the robot does not have.
    """
    equipped = replace(robot, terms=tuple(terms), weights=None)
    bodies = _bodies(robot) if any(kind_of(term).masses == "stated" for term in terms) else ()
    units = dict.fromkeys(term.body for term in terms if kind_of(term).masses == "unknown")
    if bodies or units:
        equipped = replace(equipped, weights=_weights(equipped, bodies, tuple(units)))
    return equipped


def in_setup(robot: Robot, setup: str) -> Robot:
    """Return the robot, in the frames of its URDF, as it stands in a set-up: with the load that it has there."""
    if robot.load_in(setup) == robot.load:
        return replace(robot, setup=setup)
    return with_joint_terms(replace(robot, setup=setup), robot.terms)


def weights_of(robot: Robot) -> Weights:
    """Return the masses of all links that the base link carries, and of the payload, at the joints of the chain.

    What hangs on joints that belong to no reading, as the fingers of a gripper do, is taken where these are at zero.
    Raises RobotError when no link states a mass, or one moves with a reading but not with the chain.
    """
    return _weights(robot, _bodies(robot), ())


def parts(robot: Robot) -> Parts:
    """Return what of a robot its terms may be of."""

    @functools.cache
    def weighed() -> bool:
        try:
            weights_of(robot)
        except RobotError:
            return False
        return True

    ends = zip(segments(robot), robot.chain, strict=True)
    return Parts(
        readings={reading.name: reading.dimension for reading in robot.readings},
        links={joint.name: joint.type != "fixed" for segment, joint in ends if link_length(segment)},
        joints=tuple(joint.name for joint in robot.chain),
        masses=tuple(_units(robot)),
        weighed=weighed,
        moments=functools.cache(lambda: moments(robot)),
        moving=_moving(robot),
        lateral_moments=functools.cache(lambda: lateral_moments(robot)),
    )


def _moving(robot: Robot) -> dict[str, Dimension]:
    return {j.name: "length" if j.type == "prismatic" else "angle" for j in robot.chain if j.type != "fixed"}


def foreign(robot: Robot, terms: Iterable[JointTerm]) -> JointTerm | None:
    """Return the first term that is of no kind, or of what the robot does not have; else None."""
    of = parts(robot)
    return next((term for term in terms if term.kind not in NAMED or not kind_of(term).there(of, term)), None)


def ordered(robot: Robot, terms: Iterable[JointTerm]) -> tuple[JointTerm, ...]:
    """Return terms in the order of the robot's readings, and of the kinds; those of links come last."""
    names = [*(reading.name for reading in robot.readings), *(joint.name for joint in robot.chain), ""]
    masses = ["", *_units(robot)]

    def place(term: JointTerm) -> tuple[bool, int, int, int, int, int]:
        kind = kind_of(term)
        own = kind.names.index(term.kind)
        return kind.of_link, names.index(term.reading), KINDS.index(kind), term.order, own, masses.index(term.body)

    return tuple(sorted(terms, key=place))


def moments(robot: Robot) -> tuple[JointTerm, ...]:
    """Return wind-up by masses that nobody knows: of every reading, the first moments that make its torques differ.

    What gravity makes a reading hold is linear in mass and first moment of every link that it moves (W. Khalil, E.
    Dombre, *Modeling, identification and control of robots*, 2002, chapter 9). Outwards from the base, one is left out
    where those before it do the same to the reading in all poses: what is left is as few as tell all masses apart.
    """
    bare = replace(robot, terms=(), weights=None)
    return _fewest(bare, [JointTerm(reading.name, "moment") for reading in robot.readings])


def lateral_moments(robot: Robot) -> tuple[JointTerm, ...]:
    """Return the same of the bearings of all joints that move: lateral compliance by masses that nobody knows."""
    bare = replace(robot, terms=(), weights=None)
    axes = [
        JointTerm(name, f"lateral_{axis}")
        for name, dimension in _moving(robot).items()
        for axis in ("xyz" if dimension == "length" else "xy")
    ]
    tilting = replace(bare, terms=ordered(bare, axes))
    named = [JointTerm(term.reading, term.kind.replace("lateral", "lateral_moment")) for term in tilting.terms]
    return _fewest(tilting, named, len(robot.readings))


def _fewest(robot: Robot, terms: Sequence[JointTerm], first: int = 0) -> tuple[JointTerm, ...]:
    """Return terms with the masses that make what their coordinates hold differ; ``first``: of these coordinates."""
    readings, units = random_readings(robot, _POSES), _units(robot)
    # On the floor a turntable holds nothing, and on a wall it does.
    pulls = list(dict.fromkeys([robot.load.gravity, *(load.gravity for load in robot.loads.values())]))
    told = Conditions(gravity=np.repeat(np.array(pulls), _POSES, axis=0))
    each = Holding(_weights(robot, (), tuple(units))).of_units(np.tile(readings, (len(pulls), 1)), told)
    least = _TOLD_APART * float(np.linalg.norm(robot.load.gravity)) * np.sqrt(_POSES)
    found: list[JointTerm] = []
    for k, term in enumerate(terms):
        kept = np.zeros((each.shape[1], 0))
        for name, torques in zip(units, each[:, :, first + k], strict=True):
            left = torques - kept @ (kept.T @ torques)
            if np.linalg.norm(left) > least:
                kept = np.linalg.qr(np.column_stack([kept, left]))[0]
                found.append(replace(term, body=name))
    return tuple(found)


def _weights(robot: Robot, bodies: Sequence[Body], names: Sequence[str]) -> Weights:
    known = _units(robot)
    if unknown := next((name for name in names if name not in known), None):
        raise RobotError(f"{robot.urdf.where}: the robot has no moment of mass {unknown!r}.")
    units = tuple((name, *known[name]) for name in names)
    load = robot.load
    return Weights(
        robot.mechanism,
        (*bodies, *_payload(robot)) if bodies else (),
        read_only(load.gravity),
        units,
        tuple(robot.carrier(link) for link in robot.links) if bodies else (),
        read_only(robot.moments(load.payload)),
        _own(robot, bodies),
    )


def _own(robot: Robot, bodies: Sequence[Body]) -> tuple[tuple[int, int, Array], ...]:
    """Return what links that give way weigh themselves, as :class:`Weights` has it: payloads are at their ends."""
    of_chain, found = segments(robot), []
    for k, flexure in enumerate(robot.flexures.every):
        segment = of_chain[flexure.joint]
        masses = np.zeros(3)
        for body in bodies:
            if body.joint == segment.parent:
                centre = of_chain[body.joint].frame[:3, :3].T @ body.centre
                masses += body.mass * followed(flexure, segment, centre)
        if masses.any():
            found.append((len(robot.readings) + k, segment.parent, read_only(masses)))
    return tuple(found)


def _units(robot: Robot) -> dict[str, tuple[int, Array]]:
    """Return moments of mass by name, outwards, as :class:`Weights` has them: of every joint that moves x, y, z, mass.

    What fixed joints carry belongs to the joint that moves it.
    """
    what = dict(zip(("x", "y", "z", "mass"), np.eye(4), strict=True))
    return {f"{robot.chain[i].name}_{name}": (i, read_only(unit)) for i in robot.moving for name, unit in what.items()}


def _bodies(robot: Robot) -> tuple[Body, ...]:
    """Return the masses of all links that the chain carries."""
    placed: dict[str, tuple[int, Array] | None] = {
        robot.urdf.joint(joint.name).child: (i, np.eye(4)) for i, joint in enumerate(robot.chain)
    }
    bodies: list[Body] = []
    for link, (mass, centre, inertia) in inertials(robot.urdf).items():
        if mass > 0.0 and (place := _place(robot, link, placed)) is not None:
            joint, T = place
            R = T[:3, :3]
            bodies.append(Body(joint, mass, read_only(R @ centre + T[:3, 3]), read_only(R @ inertia @ R.T)))
    if not bodies:
        raise RobotError(
            f"{robot.urdf.where}: no link that {robot.base!r} carries states its mass, which wind-up and bending under "
            "gravity need; give every <link> an <inertial>, or free moments instead of elastic."
        )
    return tuple(bodies)


def _payload(robot: Robot) -> tuple[Body, ...]:
    """Return the payload as a mass, if there is one that the base does not carry."""
    payload = robot.load.payload
    if payload is None:
        return ()
    at = robot.carrier(payload.link or robot.links[0])
    inertia = read_only(np.zeros((3, 3)))
    return (Body(at, payload.mass, read_only(payload.position), inertia),) if at >= 0 else ()


def _place(robot: Robot, link: str, placed: dict[str, tuple[int, Array] | None]) -> tuple[int, Array] | None:
    """Return the joint of the chain that carries a link, and the link (4, 4) in its; None where the base carries it.

    ``placed``: those that are known, to which all on the way are added.
    """
    way: list[UrdfJoint] = []
    at = link
    while at not in placed:
        joint = robot.urdf.parent_joint(at)
        if joint is None or at == robot.base:
            placed[at] = None
            break
        if joint.type != "fixed" and _reading(robot, joint) is not None:
            raise RobotError(
                f"{robot.urdf.where}:{joint.line}: link {link!r} moves with the reading {_reading(robot, joint)!r} but "
                "not on the way to the tip, and what it weighs there is not known; close its loop."
            )
        way.append(joint)
        at = joint.parent
    found = placed[at]
    for joint in reversed(way):
        found = None if found is None else (found[0], found[1] @ joint.origin)
        placed[joint.child] = found
    return found


def weighed_at_zero(robot: Robot) -> frozenset[str]:
    """Return the names of joints that carry masses on the chain, and are no part of it: they are taken at zero."""
    carried = {robot.urdf.joint(joint.name).child: True for joint in robot.chain}
    found: set[str] = set()
    for link, (mass, _, _) in inertials(robot.urdf).items():
        if not mass > 0.0:
            continue
        way: list[UrdfJoint] = []
        at = link
        while at not in carried and (joint := robot.urdf.parent_joint(at)) is not None:
            way.append(joint)
            at = joint.parent
        on_chain = carried.get(at, False)
        carried |= {joint.child: on_chain for joint in way}
        if on_chain:
            found.update(joint.name for joint in way if joint.type != "fixed")
    return frozenset(found)


def _reading(robot: Robot, joint: UrdfJoint) -> str | None:
    """Return the reading that moves a joint, or None."""
    while joint.mimic is not None:
        joint = robot.urdf.joint(joint.mimic.joint)
    return joint.name if any(reading.name == joint.name for reading in robot.readings) else None
