"""A serial arm in DH frames: its table, and the deviations that changes of the table are.

A DH frame has z along a joint's axis, x along the common normal to the next axis, its origin at the normal's foot. The
frame of a joint may turn about and slide along the joint's own axis, since its motion commutes with both; that freedom
makes a DH frame of any frame whose z is the axis. Between two such frames lies Rz(theta) Tz(d) Tx(a) Rx(alpha), and
changing these numbers is a deviation of the second one,

    Tz(d)^-1 ... Tz(d + dd) Tx(a + da) Rx(alpha + dalpha) Ry(dbeta)
        = Trans(da, sin(alpha) dd, cos(alpha) dd) Rx(dalpha) Ry(dbeta),

exactly, for changes of any size: da is tx, dalpha is rx, dbeta is ry, dd goes along the previous z in shares of ty and
tz, and dtheta is the joint's own offset. Where beta is not zero already, the step is cut in two before Ry(beta): a
fixed joint that the URDF does not know takes da, dd and dalpha, and the joint itself dbeta.
"""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from calib.foundations import rigid
from calib.foundations.arguments import checked
from calib.foundations.arrays import Array, read_only
from calib.foundations.brief import brief
from calib.foundations.choices import Convention
from calib.foundations.errors import RobotError, naming
from calib.foundations.sealing import sealed
from calib.robot import deviation
from calib.robot.dh.table import NUMBERS, DhRow, DhTable, check_convention, step_across, step_along
from calib.robot.robot import ChainJoint, Deviations, Robot

# Neighbouring axes nearer to parallel than this, in rad, have no common normal that one would build by: its foot would
# stand a hundred link lengths away. They get d as it is (0 where nothing says otherwise) and beta.
PARALLEL = 0.01
MOST_PARALLEL = 0.5

# A frame of the URDF is a DH frame when it misses by less; the numbers themselves are computed to rounding either way.
_IS_DH = 1e-9
# Rounding of sums and arctangents, in m and rad.
_ROUNDING = 1e-14
_QUARTER = float(np.pi) / 2.0

Direction = tuple[tuple[int, float], ...]


@dataclass(frozen=True, slots=True, eq=False)
@sealed
class DhFrames:
    """An arm in DH frames. Made by :func:`dh_frames`.

    ``source`` is the arm as it was, ``robot`` the same arm with DH frames; ``owner[i]`` is the number in the source's
    chain of the robot's chain joint i. ``rows``: all rows of the nominal table. ``directions[joint, number]``: the
    entries of the deviations (6 for every joint of ``robot.chain``) that a change of that number is, with shares that
    are orthonormal over all numbers; a joint's own motion (theta of a revolute row, d of a prismatic one) is its offset
    and not here. ``dropped``: (joint, "d") where the next axis is parallel, so that only the sum of the two d counts.
    ``first`` and ``last``: numbers in ``robot.chain`` of the first and the last joint that the rows lie between.
    ``to_first`` (4, 4): from the frame that carries the first joint to frame 0 of a modified table, along z.
    """

    __repr__ = brief

    source: Robot
    robot: Robot
    owner: tuple[int, ...]
    convention: Convention
    rows: tuple[DhRow, ...]
    directions: Mapping[tuple[str, str], Direction]
    dropped: frozenset[tuple[str, str]]
    first: int
    last: int
    to_first: Array

    @checked
    def table(self, deviations: Deviations | None = None) -> DhTable:
        """Return the table of the nominal arm, or of one with ``deviations`` of ``robot``: its tips, to rounding.

        Raises RobotError when a joint mimics another, or a deviation between the rows is not one of ``directions``.
        """
        _refuse_mimics(self.source)
        d = deviations or self.robot.no_deviations()
        changes, rest = self._split(d.placements)
        moving = [self.source.chain[i].name for i in self.source.moving]
        # A joint that follows others takes over its multiples of their offsets.
        offsets = dict(zip(moving, map(float, self.robot.offset_coupling @ d.offsets), strict=True))
        changes |= {(row.joint, own): offsets[row.joint] for row in self.rows if (own := own_motion(row)) is not None}
        rows = [
            DhRow(
                row.joint,
                row.type,
                *(_tidy(name, getattr(row, name) + changes.get((row.joint, name), 0.0)) for name in NUMBERS),
            )
            for row in self.rows
        ]
        # A deviation of the joint in which frame 0 of a standard table stands is one of the base.
        inner, outer = self.first + (self.convention == "standard"), self.last + 1
        for joint, left in zip(self.robot.chain[inner:outer], rest[inner:outer], strict=True):
            if np.abs(left).max() > _ROUNDING:
                raise RobotError(
                    f"joint {joint.name!r} has a deviation that is no parameter of a {self.convention} DH table; "
                    "take the table of the calibrated URDF instead."
                )
        placements = np.stack([joint.placement for joint in self.robot.chain]) @ deviation.motion(rest)
        base = _product(placements[:inner]) @ self.to_first
        tool = _product(placements[outer:]) @ rigid.inverse(self.robot.chain[-1].frame)
        if self.robot.chain[self.last].type != "fixed":
            # Nothing lies behind the last joint: its row ends in the frame that the URDF gives the joint.
            tool = rigid.inverse(self.rows[-1].along) @ tool
        while rows[-1] == DhRow(rows[-1].joint, "fixed", 0.0, 0.0, 0.0, 0.0):
            rows.pop()
        return DhTable(self.convention, tuple(rows), _cleaned(base), _cleaned(tool))

    @checked
    def in_source(self, deviations: Deviations) -> Deviations:
        """Return the deviations of ``source`` that make the same arm as ``deviations`` make of ``robot``."""
        found = np.zeros((len(self.source.chain), 6))
        for k, joint in enumerate(self.source.chain):
            mine = [i for i, owner in enumerate(self.owner) if owner == k]
            if np.any(deviations.placements[mine]):  # without a deviation a turned frame would leave rounding
                frames = np.stack([self.robot.chain[i].frame for i in mine])
                E = _product(frames @ deviation.motion(deviations.placements[mine]) @ rigid.inverse(frames))
                E = rigid.inverse(joint.frame) @ E @ joint.frame
                # Rx Ry Rz of some angles is the inverse of roll, pitch, yaw of the opposite ones.
                found[k] = np.concatenate([E[:3, 3], -rigid.rpy_of(E[:3, :3].T)])
        return Deviations(read_only(found), deviations.offsets, deviations.terms)

    @checked
    def source_rates(self, deviations: Deviations) -> Array:
        """Return how the placements' deviations of ``source`` follow those of ``robot``: (6 n_source, 6 n_robot)."""
        there = self.in_source(deviations).placements
        rates = np.zeros((there.size, deviations.placements.size))
        motions = deviation.motion(deviations.placements)
        twists = deviation.twists(deviations.placements)
        for k, joint in enumerate(self.source.chain):
            to_parameters = np.linalg.inv(deviation.twists(there[k])) @ rigid.adjoint(rigid.inverse(joint.frame))
            # From the last to the first: a change passes through what stands behind it.
            behind = np.eye(4)
            for i in reversed([i for i, owner in enumerate(self.owner) if owner == k]):
                frame = self.robot.chain[i].frame
                carried = rigid.adjoint(rigid.inverse(behind) @ frame) @ twists[i]
                rates[6 * k : 6 * k + 6, 6 * i : 6 * i + 6] = to_parameters @ carried
                behind = frame @ motions[i] @ rigid.inverse(frame) @ behind
        return rates

    def _split(self, placements: Array) -> tuple[dict[tuple[str, str], float], Array]:
        """Return the changes of the table that deviations (n, 6) are, and what these hold besides."""
        state = placements.ravel()
        changes = {
            number: sum(share * float(state[entry]) for entry, share in direction)
            for number, direction in self.directions.items()
        }
        rest = state.copy()
        for number, direction in self.directions.items():
            for entry, share in direction:
                rest[entry] -= share * changes[number]
        return changes, rest.reshape(placements.shape)


def own_motion(row: DhRow) -> str | None:
    """Return the number of a row that its joint moves, and of which the joint's offset is the change."""
    return {"revolute": "theta", "prismatic": "d", "fixed": None}[row.type]


@checked
def dh_of(robot: Robot, convention: Convention = "standard", parallel: float = PARALLEL) -> DhTable:
    """Return the DH table of a serial arm: the same tips at the same joint positions, to rounding.

    Rows are named after the arm's joints. Where the frames of the URDF are DH frames already, the table is read off
    them; else the frames are computed: d = 0 where the next axis is parallel to within ``parallel`` rad (such a row has
    Hayati's beta), theta within +-90 deg where that can be chosen. Frame 0 is the frame that carries the first joint
    wherever the convention allows; fixed joints between moving ones are merged into a row; every fixed joint
    behind the last moving one but the last gets a row from its own z to the next one's. Base and tool are the rest.

    Raises RobotError when a joint of the arm mimics another one, or the convention is none.
    """
    _refuse_mimics(robot)
    return dh_frames(robot, convention, parallel).table()


@checked
def dh_frames(robot: Robot, convention: Convention = "standard", parallel: float = PARALLEL) -> DhFrames:
    """Return the arm in DH frames; see :func:`dh_of` for how they are chosen. Raises RobotError."""
    check_convention(convention)
    if not 0.0 <= parallel <= MOST_PARALLEL:
        raise RobotError(f"parallel: {parallel!r} is not an angle between 0 and {MOST_PARALLEL} rad.")
    if robot.loops:
        raise RobotError(f"{robot.urdf.where}: an arm with closed loops has no DH table; free placements instead.")
    if robot.tip_joint != len(robot.chain) - 1 or any(joint.parent != i - 1 for i, joint in enumerate(robot.chain)):
        raise RobotError(f"{robot.urdf.where}: a DH table is of one arm, not of {len(robot.links)} links.")
    modified = convention == "modified"
    elements, steps, slides = _walk(robot, parallel, modified=modified)
    chain, owner, at = _chain(robot, dict(zip(elements, slides, strict=True)), dict(zip(elements, steps, strict=True)))
    joints = [robot.chain[i] for i in elements]

    # The row of a last moving joint ends in the joint's own frame; what lies behind a last fixed one is the tool.
    end = _NO_STEP
    if joints[-1].type != "fixed":
        back = rigid.inverse(slides[-1])
        end = end._replace(theta=_tidy("theta", _yaw(back)), d=float(back[2, 3]))
    ahead = [*steps[1:], end]
    beside = steps if modified else ahead
    with naming(robot.urdf.where, RobotError):
        rows = [
            DhRow(joint.name, joint.type, to.a, on.d, to.alpha, on.theta, to.beta)
            for joint, on, to in zip(joints, ahead, beside, strict=True)
        ]
    if joints[-1].type == "fixed" and not modified:
        rows.pop()

    directions, dropped = _directions(joints, steps, [at[i] for i in elements], modified=modified)
    numbers = [(row.joint, name) for row in rows for name in NUMBERS]
    return DhFrames(
        robot,
        replace(robot, chain=chain, tip_joint=len(chain) - 1),
        owner,
        convention,
        tuple(rows),
        {number: directions[number] for number in numbers if number in directions},
        dropped,
        at[elements[0]][0],
        at[elements[-1]][1],
        read_only(step_along(steps[0].theta, steps[0].d)),
    )


# ---- from axis to axis


class _Step(NamedTuple):
    """Rz(theta) Tz(d) Tx(a) Rx(alpha) Ry(beta); ``hinged``: it leads between parallel axes of two moving joints."""

    theta: float
    d: float
    a: float
    alpha: float
    beta: float
    hinged: bool


_NO_STEP = _Step(0.0, 0.0, 0.0, 0.0, 0.0, False)


def _walk(robot: Robot, parallel: float, *, modified: bool) -> tuple[list[int], list[_Step], list[Array]]:
    """Return the joints that the rows lie between, the step to each, and the motion (4, 4) along its axis to its frame.

    Step 0 leads from the frame that carries the first joint; only a modified table has it.
    """
    chain, last_moving = robot.chain, robot.moving[-1]
    elements = [*robot.moving, *range(last_moving + 1, len(chain))]
    placements = np.stack([joint.placement for joint in chain])
    between = [_product(placements[i + 1 : j + 1]) for i, j in itertools.pairwise(elements)]
    read_off = all(
        _own_normal(T, parallel) is not None for T, i in zip(between, elements[1:], strict=True) if i <= last_moving
    )
    start = chain[elements[0]].placement
    first = _step(start, parallel, 0.0, None)._replace(hinged=False)
    # Frame 0 of a standard table is on axis 1: the frame before it where that is on the axis too, else the joint's own.
    on_axis = first.a == first.alpha == first.beta == 0.0
    steps = [first if modified else _NO_STEP]
    slides = [_slide(start, first) if modified or on_axis else np.eye(4)]
    for i, T in zip(elements[1:], between, strict=True):
        G = rigid.inverse(slides[-1]) @ T
        fixed = i > last_moving
        step = _step(
            G,
            parallel,
            float(G[2, 3]) if read_off or fixed else 0.0,
            _own_normal(G, parallel) if read_off or fixed else None,
        )
        slide = _slide(G, step)
        if last_moving + 1 < i == len(chain) - 1 and np.abs(slide - np.eye(4)).max() > _IS_DH:
            # The last fixed frame of several is no DH frame: what leads to it is better left whole, as the tool.
            return elements[:-1], steps, slides
        steps.append(step._replace(hinged=step.hinged and not fixed))
        slides.append(slide)
    return elements, steps, slides


def _step(G: Array, parallel: float, height: float, normal: Array | None) -> _Step:
    """Return the step from a frame to the axis that is z of ``G`` (4, 4).

    ``height`` in m: where a parallel axis is met. ``normal`` (2,): the direction that x should have, None where any has
    the same right.
    """
    p, z = G[:3, 3], G[:3, 2]
    sine = float(np.hypot(z[0], z[1]))
    is_parallel = sine <= np.sin(parallel)
    if is_parallel:
        foot = p + z * (height - p[2]) / z[2]
        distance = float(np.hypot(foot[0], foot[1]))
        if normal is not None and abs(_cross(normal, foot)) < _ROUNDING:
            u = normal
        else:
            u = foot[:2] / distance if distance > _ROUNDING else np.array([1.0, 0.0])
            u = _turned(u, foot, normal)
        d = height
    else:
        u = _turned(np.array([-z[1], z[0]]) / sine, p, normal)
        # Feet of the common normal: the horizontal way from p to it is made good by sliding along z.
        foot = p - z * float(p[:2] @ z[:2]) / sine**2
        d = float(foot[2])
    v = np.array([-u[1], u[0]])
    across, along = float(-v @ z[:2]), float(u @ z[:2])
    return _Step(
        _tidy("theta", float(np.arctan2(u[1], u[0]))),
        _tidy("d", d),
        _tidy("a", float(u @ foot[:2])),
        _tidy("alpha", float(np.arctan2(across, z[2]))),
        _tidy("beta", float(np.arctan2(along, np.hypot(across, z[2])))) if is_parallel else 0.0,
        bool(is_parallel),
    )


def _turned(u: Array, foot: Array, normal: Array | None) -> Array:
    """Return u or -u (2,): nearer to ``normal``; else to x, as one draws an arm stretched out; else with a > 0."""
    if normal is not None:
        keep = float(u @ normal) > 0.0
    elif abs(u[0]) > _IS_DH:
        keep = u[0] > 0.0
    elif abs(u @ foot[:2]) > _IS_DH:
        keep = float(u @ foot[:2]) > 0.0
    else:
        keep = u[1] > 0.0
    return u if keep else -u


def _own_normal(G: Array, parallel: float) -> Array | None:
    """Return the direction (2,) of x if ``G`` (4, 4) is a DH step as it stands, else None."""
    R, p = G[:3, :3], G[:3, 3]
    if np.hypot(R[0, 2], R[1, 2]) <= np.sin(parallel):
        # R = Rz(theta) Rx(alpha) Ry(beta) has the second column Rz (0, cos alpha, sin alpha), alpha near 0 or pi.
        u = np.array([R[1, 1], -R[0, 1]]) * np.sign(R[2, 2])
    elif abs(R[2, 0]) < _IS_DH:
        u = R[:2, 0]
    else:
        return None
    u = u / np.hypot(u[0], u[1])
    return u if abs(_cross(u, p)) < _IS_DH else None


def _slide(G: Array, step: _Step) -> Array:
    """Return the motion (4, 4) about and along z from ``G`` to the frame in which the step ends."""
    K = rigid.inverse(G) @ step_along(step.theta, step.d) @ step_across(step.a, step.alpha, step.beta)
    return step_along(_tidy("theta", _yaw(K)), _tidy("d", float(K[2, 3])))


def _chain(
    robot: Robot, slides: Mapping[int, Array], steps: Mapping[int, _Step]
) -> tuple[tuple[ChainJoint, ...], tuple[int, ...], dict[int, tuple[int, int]]]:
    """Return the chain in DH frames, its joints' numbers in the old one, and (cut, own) new numbers of those slid."""
    new: list[ChainJoint] = []
    owner: list[int] = []
    at: dict[int, tuple[int, int]] = {}
    before = np.eye(4)
    for i, joint in enumerate(robot.chain):
        slide = slides.get(i, np.eye(4))
        placement, frame = rigid.inverse(before) @ joint.placement @ slide, joint.frame @ slide
        beta = steps[i].beta if i in steps else 0.0
        at[i] = len(new), len(new) + (beta != 0.0)
        if beta != 0.0:
            turn = step_across(0.0, 0.0, beta)
            back = rigid.inverse(turn)
            name, end = f"{joint.name} (cut)", len(new) - 1
            new.append(ChainJoint(name, "fixed", end, read_only(placement @ back), read_only(frame @ back)))
            placement = turn
        new.append(replace(joint, parent=len(new) - 1, placement=read_only(placement), frame=read_only(frame)))
        owner += [i] * (len(new) - len(owner))
        before = slide
    return tuple(new), tuple(owner), at


def _directions(
    joints: Sequence[ChainJoint], steps: Sequence[_Step], at: Sequence[tuple[int, int]], *, modified: bool
) -> tuple[dict[tuple[str, str], Direction], frozenset[tuple[str, str]]]:
    """Return what changes of the numbers are among the deviations, and the d that parallel axes leave without use.

    ``at``: for every joint the chain numbers of the deviation that ends the step before Ry(beta), and of its own.
    """
    directions: dict[tuple[str, str], Direction] = {}
    dropped: set[tuple[str, str]] = set()
    for k, step in enumerate(steps):
        cut, own = at[k]
        if k > 0:
            name, kind = joints[k - 1].name, joints[k - 1].type
            if kind != "revolute":
                # Rz is the last factor of a deviation, and commutes with sliding along z.
                directions[name, "theta"] = ((6 * at[k - 1][1] + 5, 1.0),)
            if kind != "prismatic" and step.hinged:
                dropped.add((name, "d"))
            elif kind != "prismatic":
                sine, cosine = float(np.sin(step.alpha)), float(np.cos(step.alpha))
                directions[name, "d"] = ((6 * cut + 1, sine), (6 * cut + 2, cosine))
        if k > 0 or modified:
            name = joints[k if modified else k - 1].name
            directions[name, "a"] = ((6 * cut, 1.0),)
            directions[name, "alpha"] = ((6 * cut + 3, 1.0),)
            if step.hinged:
                directions[name, "beta"] = ((6 * own + 4, 1.0),)
    return directions, frozenset(dropped)


# ---- numbers


def _refuse_mimics(robot: Robot) -> None:
    for joint in robot.chain:
        mimic = robot.urdf.joint(joint.name).mimic
        if mimic is not None:
            raise RobotError(
                f"{robot.urdf.where}: joint {joint.name!r} mimics {mimic.joint!r}, and in a DH table every joint moves "
                "by itself; take a base or a tip that leaves it out."
            )


def _product(placements: Array | Sequence[Array]) -> Array:
    T = np.eye(4)
    for placement in placements:
        T = T @ placement
    return T


def _cross(u: Array, p: Array) -> float:
    return float(u[0] * p[1] - u[1] * p[0])


def _yaw(T: Array) -> float:
    return float(np.arctan2(T[1, 0], T[0, 0]))


def _tidy(name: str, value: float) -> float:
    """Return a number of a table without rounding noise: a zero, a quarter turn, half a turn with its plus sign."""
    if name in ("a", "d"):
        return value if abs(value) > _ROUNDING else 0.0
    quarters = round(value / _QUARTER)
    value = quarters * _QUARTER if abs(value - quarters * _QUARTER) < _ROUNDING else value
    return float(value + 4.0 * _QUARTER) if value == -2.0 * _QUARTER else float(value)


def _cleaned(T: Array) -> Array:
    """Return a placement (4, 4) with rounding noise taken from the zeros and ones of its entries."""
    whole = np.round(T)
    return read_only(np.where(np.abs(T - whole) < _ROUNDING, whole, T) + 0.0)
