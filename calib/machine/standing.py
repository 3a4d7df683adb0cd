"""How sure is it where a machine stands: what its uncertainty does to its links, as one rigid motion of all of it.

The base of a calibrated machine is a number among others: where a base and the placement of the first joint are both
free, only what follows from both is determined. So a place is told of the links that carry tools: by the rigid motion
that takes them nearest to where they are, over the readings that were identified, together with a motion of each in
its own axes, as in robot-world calibration: what is beyond the last joint is no matter of the place. Changes in the
null space that move a tool against its link, or links against each other, count for nothing; those that move the links
as one body are directions in which the place is not determined. All is to first order: where such a direction is far
off, as by a tool 100 mm longer than stated, what is told of the others is too small.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from calib.foundations import rigid
from calib.foundations.arrays import Array, read_only
from calib.foundations.linear import spread, svd
from calib.foundations.sealing import sealed
from calib.machine.calibrated import CalibratedMachine
from calib.machine.place import SAME, Place
from calib.machine.tool_uncertainty import link_errors
from calib.machine.uncertainty import Uncertainty
from calib.measurement.measurements import ONLY_TOOL
from calib.robot.conditions import Conditions, ordinary
from calib.robot.sampling import random_readings

# Tools of a link; poses of a tool, and of all: what motions of each in its own axes take grows with the cube of how
# many they are.
_ENOUGH_TOOLS, _POSES, _MOST_POSES = 10, 200, 2000
# What a null direction does to links, by rms and in one parameter scale, is more than rounding from here on, in m.
_MOVES = 1e-7
# Rigid motions that points do not show, as a turn about the line on which they lie: by share of the best seen one.
_SEEN = 1e-6
# A turn is set against a shift by how far points are apart; in m, where they are all in one place.
_LEAST_ARM = 0.1


@dataclass(frozen=True, slots=True, eq=False)
@sealed
class Moved:
    """What errors do to a body at N of its points: ``points`` (N, 3), ``errors`` (N, d, r), ``unseen`` (N, d, k).

    d is 3, shifts of the points, or 6, with turns of the body. ``errors``: a factor of their covariance; ``unseen``:
    what directions of the null space do; ``beside`` (N, d, l): other motions that are no matter of where the body is.
    All in the axes of one frame, in m and rad.
    """

    points: Array
    errors: Array
    unseen: Array
    beside: Array


class Pivoted(NamedTuple):
    """Touches of fixed points that told a tool point: ``readings`` (M, nr), and of each its conditions and target."""

    readings: Array
    conditions: Conditions
    targets: tuple[str, ...]


def place_of(machine: CalibratedMachine) -> Place:
    """Return how sure it is where a machine stands in the instrument's frame, at its base, in the instrument's axes.

    Without its residual model. Raises MeasurementError where the uncertainty is not known.
    """
    (found,) = rigid_parts([_links(machine)], machine.base[:3, 3])
    return replace(found, freedom=machine.known_uncertainty.degrees_of_freedom)


def place_of_touched(machine: CalibratedMachine, tool: str, touches: Sequence[tuple[Array, Conditions]]) -> Place:
    """Return how sure it is where a body stands, against the links of the arm that touched it.

    ``touches``: readings (M, nr) of the arm ``machine`` where its ``tool`` touched, and conditions. Of the arm's errors
    alone, which are common to all touches; in its base, at its origin. What moves the arm and all touches alike is no
    error. Raises MeasurementError where the uncertainty is not known.
    """
    touched = [_at(machine, tool, readings, told, tool_pose=True) for readings, told in touches]
    points = Moved(
        np.concatenate([part.points for part in touched]),
        np.concatenate([part.errors[:, :3] for part in touched]),
        np.concatenate([part.unseen[:, :3] for part in touched]),
        np.zeros((sum(len(part.points) for part in touched), 3, 0)),
    )
    arm, body = rigid_parts([_links(machine), points], machine.base[:3, 3])
    apart = Place(
        body.factor - arm.factor, body.undetermined - arm.undetermined, machine.known_uncertainty.degrees_of_freedom
    )
    return apart.turned(machine.base[:3, :3].T)


def with_tool_point(
    machine: CalibratedMachine, point: Array, covariance: Array, pivoted: Pivoted | None = None
) -> CalibratedMachine:
    """Return the machine with a point (3,) on its tip link as its only tool, of a covariance (3, 3) of its own.

    ``pivoted``: the touches that told the point, where some did. Then errors of the machine move the point as well, so
    that it stays where it touched, as far as it can. Raises MeasurementError where the uncertainty is not known.
    """
    known, start = machine.known_uncertainty, machine.layout.tools
    values, vectors = np.linalg.eigh(covariance)
    own = np.zeros((start + 6, 3))
    own[start : start + 3] = vectors * np.sqrt(np.maximum(values, 0.0))
    tools = {ONLY_TOOL: read_only(rigid.translation(point))}
    bare = _of_point(known, start, np.zeros((3, known.factor.shape[1])), np.zeros((3, known.null_basis.shape[1])))
    alone = replace(machine, tools=tools, tool_tips={}, residual_model=None, uncertainty=bare, in_urdf=None)
    told = bare if pivoted is None else _of_point(known, start, *_followed(alone, pivoted))
    instrument, parameters, left_out = known.causes
    factor, causes = read_only(np.hstack([own, told.factor])), (instrument + 3, parameters, left_out)
    return replace(alone, uncertainty=replace(told, factor=factor, causes=causes))


def _of_point(known: Uncertainty, start: int, errors: Array, unseen: Array) -> Uncertainty:
    """Return what is known of a machine with one tool, a point with ``errors`` (3, r) and ``unseen`` (3, k)."""
    factor, null_basis = (
        read_only(np.vstack([part[:start], rows, np.zeros_like(rows)]))
        for part, rows in ((known.factor, errors), (known.null_basis, unseen))
    )
    return replace(known, factor=factor, null_basis=null_basis)


def _followed(machine: CalibratedMachine, of: Pivoted) -> tuple[Array, Array]:
    """Return how a pivoted tool point (3, r), (3, k) on its link follows errors and null directions of the arm."""
    moved = link_errors(machine, of.readings, ONLY_TOOL, tool_pose=False, conditions=of.conditions)
    R = machine.base[:3, :3] @ machine.tips(of.readings, of.conditions)[:, :3, :3]
    targets = np.unique(of.targets, return_inverse=True)[1]
    # What moves the point where it touched, less what moves the fixed point, is nothing.
    fixed = -np.kron(np.eye(int(targets.max()) + 1)[targets], np.eye(3))
    of_point = -np.linalg.pinv(np.hstack([R.reshape(-1, 3), fixed]))[:3]
    errors, unseen = (of_point @ part[:, :3].reshape(3 * len(R), -1) for part in moved)
    return errors, unseen


def _links(machine: CalibratedMachine) -> Moved:
    """Return what the uncertainty does to all links that carry tools, over the identified readings."""
    known = machine.known_uncertainty
    links = [machine.tool_tips.get(tool) for tool in machine.tools]
    # Those of one link move as one body: more of them tell nothing new.
    tools = [tool for k, tool in enumerate(machine.tools) if links[:k].count(links[k]) < _ENOUGH_TOOLS]
    poses = min(_POSES, _MOST_POSES // len(tools))
    readings = random_readings(
        machine.robot, poses, known.identified, (machine.deviations,), determinant=known.closure_determinant
    )
    told = ordinary(readings)
    parts = [_at(machine, tool, readings, told, tool_pose=False) for tool in tools]
    beside = np.zeros((len(parts), poses, 6, len(parts), 6))
    for k, part in enumerate(parts):
        beside[k, :, :, k] = part.beside
    return Moved(
        np.concatenate([part.points for part in parts]),
        np.concatenate([part.errors for part in parts]),
        np.concatenate([part.unseen for part in parts]),
        beside.reshape(-1, 6, 6 * len(parts)),
    )


def _at(machine: CalibratedMachine, tool: str, readings: Array, told: Conditions, *, tool_pose: bool) -> Moved:
    machine = replace(machine, residual_model=None)
    errors, unseen = link_errors(machine, readings, tool, tool_pose=tool_pose, conditions=told)
    T = machine.predict(readings, tool=tool, conditions=told)
    own = np.zeros((len(T), 6, 6))
    own[:, :3, :3] = own[:, 3:, 3:] = T[:, :3, :3]
    return Moved(T[:, :3, 3], _turned(errors, T), _turned(unseen, T), own)


def _turned(motions: Array, T: Array) -> Array:
    """Return motions (N, 6, k) whose turns are about axes of T (N, 4, 4), about those of the frame."""
    found = np.array(motions)
    found[:, 3:] = T[:, :3, :3] @ motions[:, 3:]
    return found


def rigid_parts(bodies: Sequence[Moved], origin: Array) -> list[Place]:
    """Return how far each of several bodies moves as one, at ``origin`` (3,), by errors that they have in common.

    ``factor`` (6, r) and ``undetermined`` (6, k) have the same columns for all bodies. Motions beside are fitted
    together with the rigid ones, so that they are no part of them, but what a rigid motion does as well. Errors in the
    null space are errors like others, as wide as its priors: nobody takes them out of what was touched.
    """
    rigid_motions, errors, unseen, beside, start = [], [], [], [], 0
    size = sum(body.errors.shape[0] * body.errors.shape[1] for body in bodies)
    for body in bodies:
        count, d = body.errors.shape[:2]
        arm = max(spread(body.points), _LEAST_ARM)
        # Every body counts the same, however many points it has.
        weights = np.repeat([1.0, arm], 3)[:d] / np.sqrt(count)
        A = np.zeros((count, d, 6))
        A[:, :3, :3] = np.eye(3)
        A[:, :3, 3:] = -rigid.skew(body.points - origin)
        A[:, 3:, 3:] = np.eye(3)[: d - 3] if d > 3 else np.zeros((0, 3))
        of_all = np.zeros((size, 6 + body.beside.shape[2]))
        of_all[start : start + count * d] = (weights[:, None] * np.dstack([A, body.beside])).reshape(count * d, -1)
        start += count * d
        rigid_motions.append(of_all[:, :6])
        beside.append(of_all[:, 6:])
        errors.append((weights[:, None] * body.errors).reshape(count * d, -1))
        unseen.append((weights[:, None] * body.unseen).reshape(count * d, -1))
    A, E, N, B = np.hstack(rigid_motions), np.concatenate(errors), np.concatenate(unseen), np.hstack(beside)
    # Rigid motions that the points show, as an orthonormal basis of what they do.
    Q, seen, Vt = svd(A, full_matrices=False)
    kept = seen > _SEEN * seen[0]
    Q, to_twists = Q[:, kept], Vt[kept].T / seen[kept]
    B = _basis(B, _SEEN)
    _, alike, Zt = svd(Q.T @ B)
    same = np.zeros(B.shape[1], dtype=np.bool_)
    same[: len(alike)] = alike > np.sqrt(1.0 - SAME**2)
    B = B @ Zt[~same].T
    factor = to_twists @ np.linalg.lstsq(Q - B @ (B.T @ Q), E, rcond=None)[0]
    W = _basis(np.hstack([_basis(N, _MOVES), B]), _SEEN)
    _, apart, Zt = svd(Q - W @ (W.T @ Q), full_matrices=False)
    open_ = np.hstack([to_twists @ Zt[apart <= SAME].T, Vt[~kept].T])
    return [
        Place(read_only(factor[rows]), read_only(open_[rows]), np.inf)
        for rows in (slice(6 * k, 6 * k + 6) for k in range(len(bodies)))
    ]


def _basis(M: Array, least: float) -> Array:
    """Return an orthonormal basis of what columns span, but for what is smaller than ``least``."""
    U, sizes, _ = svd(M, full_matrices=False)
    return np.asarray(U[:, sizes > least])
