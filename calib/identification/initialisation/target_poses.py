"""Where targets are: start values of sockets, anchors, balls, planes, boards and cameras, in closed form."""

from collections.abc import Sequence

import numpy as np

from calib.foundations import rigid
from calib.foundations.arrays import Array
from calib.foundations.linear import svd
from calib.identification import targets
from calib.identification.error_model import ErrorModel
from calib.identification.initialisation import cameras
from calib.identification.initialisation.carried import Carried
from calib.identification.machine import Frames
from calib.identification.relations import Relation
from calib.measurement.measurements import Measurements, numbered
from calib.robot.conditions import ordinary
from calib.robot.robot import TipModel

# Directions of a linear fit below this share of the best one are left at their start.
NEGLIGIBLE = 1e-8
# A part of the arm is clearly off a plane, in m.
_OFF = 0.01
# Points that are off a plane by less than that share of how they spread in it tell no side of it.
_FLAT = 0.02
# The cosine of an angle between planes, stated and found, from which its supplement is another one.
_SLANTED = 0.2
# Rows whose arm is looked at together.
_BLOCK = 5000


def with_targets(model: ErrorModel, rows: Sequence[Carried], frames: Frames) -> Frames:
    """Return the frames with the targets where the nominal robot puts them."""
    sets = [one.data for one in rows]
    names, found = sets[0].targets, targets.shapes(sets)
    poses, scalars = np.tile(np.eye(4), (len(names), 1, 1)), np.array([one.start for one in sets[0].scalars])
    carried = [one.seen(frames.bases) for one in rows]
    points = [(T @ data.placed_by(frames.tools))[:, :3, 3] for data, T in zip(sets, carried, strict=True)]
    of_target = [dict(numbered(data.target)) for data in sets]
    none = np.zeros(0, dtype=np.intp)
    planes = [t for t, name in enumerate(names) if found.get(name) == "plane" and name not in model.targets]
    arms = [arm_beside(model, data, T, x, planes) for data, T, x in zip(sets, carried, points, strict=True)]
    for t, name in enumerate(names):
        about = [
            (data, T, x, arm, rows.get(t, none))
            for data, T, x, arm, rows in zip(sets, carried, points, arms, of_target, strict=True)
        ]
        about = [(data, T, x, arm, rows) for data, T, x, arm, rows in about if len(rows)]
        touched = [(data, x, arm, rows) for data, _, x, arm, rows in about if data.kind in targets.SHAPES]
        own = [(data, x[rows], data.value[rows]) for data, x, _, rows in touched]
        sights = cameras.sights([data for data, *_ in about], [T for _, T, *_ in about], t)
        if name in model.targets:
            poses[t] = _known_pose(model.targets[name], own)
        elif found.get(name) == "plane":
            beside = [arm[rows] for _, _, arm, rows in touched]
            alike = [parts for parts in beside if parts.shape[1] == beside[0].shape[1]]
            poses[t] = plane_through(np.concatenate([x for _, x, _ in own]), np.concatenate(alike).mean(axis=0))
        elif own:
            sockets = [x for data, x, _ in own if data.kind == "socket"]
            if sights and not sockets:
                poses[t] = cameras.target_pose(name, sights, frames.tools)
            else:
                poses[t, :3, 3] = np.concatenate(sockets).mean(axis=0) if sockets else centre(own)
        cameras.refuse_behind(sights, frames.tools, poses[t])
    _turn_as_related(poses, [names[t] for t in planes], names, model.relations)
    for k in range(len(scalars)):
        missing = [
            sign * (data.value[:, 0] - np.linalg.norm(x - poses[data.target, :3, 3], axis=1))
            for role, sign in (("offset", 1.0), ("radius", -1.0))
            for data, x in zip(sets, points, strict=True)
            if data.uses.get(role) == k and data.kind != "pair_distance" and len(data)
        ]
        if missing:
            scalars[k] = np.concatenate(missing).mean()
    return Frames(frames.bases, frames.tools, poses, scalars)


def _turn_as_related(poses: Array, free: Sequence[str], names: Sequence[str], relations: Sequence[Relation]) -> None:
    """Turn planes of ``poses`` (M, 4, 4) over that stated angles say to be touched from the other side.

    The parts of an arm beside a plane may all be on its other side. So a stated angle that is the supplement of what
    was found says that one of two is turned over: of planes that hang together the fewer ones, or those not known.
    """
    number = {name: t for t, name in enumerate(names)}
    clear = {}
    for relation in relations:
        pair = [number[name] for name in relation.targets if name in number]
        if relation.kind == "angle" and len(pair) == 2 and set(relation.targets) & set(free):
            stated, seen = np.cos(relation.value), float(poses[pair[0], :3, 2] @ poses[pair[1], :3, 2])
            if min(abs(stated), abs(seen)) > _SLANTED:
                clear[pair[0], pair[1]] = clear[pair[1], pair[0]] = bool(stated * seen < 0.0)
    turnable = {number[name] for name in free}
    left = {t for pair in clear for t in pair}
    while left:
        turned = {min(left): False}
        while more := {b: turned[a] != other for (a, b), other in clear.items() if a in turned and b not in turned}:
            turned |= more
        left -= turned.keys()
        if any((turned[a] != turned[b]) != other for (a, b), other in clear.items() if a in turned):
            continue  # stated angles contradict each other, which the fit will show
        over = {t for t, is_over in turned.items() if is_over}
        for t in min((over, turned.keys() - over), key=lambda one: (len(one - turnable), len(one))):
            if t in turnable:
                poses[t, :3, 1:3] *= -1.0


def _known_pose(target: targets.Target, own: Sequence[tuple[Measurements, Array, Array]]) -> Array:
    """Return the pose of a target that is known, its height found where that is not."""
    if target.height_is_known or not own:
        return target.pose
    normal = target.pose[:3, 2]
    height = np.concatenate([x @ normal - value[:, 0] for _, x, value in own]).mean()
    return rigid.placement(target.pose[:3, :3], height * normal)


def arm_beside(model: ErrorModel, data: Measurements, tips: Array, x: Array, planes: Sequence[int]) -> Array:
    """Return where tip link and joints were, from the tip back to the base, beside the touched points (N, k, 3).

    ``tips`` (N, 4, 4) and points ``x`` (N, 3) are in the frame of the target. Rows about no plane stay at 0. A robot is
    made ready once for all rows: of thousands of planes, one for each took longer than the fit.
    """
    rows = np.flatnonzero(np.isin(data.target, planes))
    if data.kind not in targets.SHAPES or not len(rows):
        return np.zeros((len(x), 0, 3))
    robot = model.robot.with_tip(data.tip)
    arm = TipModel(robot)
    beside = np.zeros((len(x), 0, 3))
    for block in (rows[start : start + _BLOCK] for start in range(0, len(rows), _BLOCK)):
        readings = data.readings[block]
        motion = arm.motion(robot.own(readings), ordinary(readings)).tip
        # In the tip link; joints of other branches, and those behind the tip, do not move it.
        origins = (rigid.inverse(motion.placement) @ motion.before[::-1])[:, :, :3, 3].swapaxes(0, 1)
        origins = np.concatenate([np.zeros((len(block), 1, 3)), origins], axis=1)
        if not beside.size:
            beside = np.zeros((len(x), *origins.shape[1:]))
        beside[block] = origins @ np.swapaxes(tips[block, :3, :3], -1, -2) + (tips[block, :3, 3] - x[block])[:, None]
    return beside


def plane_through(x: Array, beside: Array) -> Array:
    """Return a frame whose x and y are in the plane nearest to points (n, 3), z on the side from which it is touched.

    That is the side of the first of the arm's parts ``beside`` it (k, 3) that is clearly off the plane. The base would
    not do: a cube's upper and far faces are touched from other sides than the base's.
    """
    middle = x.mean(axis=0)
    axes = svd(x - middle, full_matrices=True)[2]
    heights = beside @ axes[2]
    normal = axes[2] if heights[np.argmax(np.abs(heights) > _OFF)] >= 0.0 else -axes[2]
    return rigid.placement(np.column_stack([axes[0], np.cross(normal, axes[0]), normal]), middle)


def centre(own: Sequence[tuple[Measurements, Array, Array]]) -> Array:
    """Return the point at measured distances from points: |x|^2 - l^2 = 2 x c - 2 l o + o^2 - |c|^2, linear.

    Points that are nearly in a plane tell badly how far off it the point is, and hardly on which side. So both sides
    are tried, as far off as lengths say.
    """
    x = np.concatenate([points for _, points, _ in own])
    length = np.concatenate([value[:, 0] for _, _, value in own])
    middle = x.mean(axis=0)
    y = x - middle
    squares = (y * y).sum(axis=1) - length**2
    offset = [length] if any(data.uses for data, _, _ in own) and np.ptp(length) > 0.0 else []
    A = np.column_stack([2.0 * y, np.ones(len(y)), *offset])
    straight = np.linalg.lstsq(A, squares, rcond=NEGLIGIBLE)[0][:3]
    if offset:
        return np.asarray(middle + straight)
    axes = svd(y, full_matrices=True)[2]
    flat = y @ axes[:2].T
    within = np.linalg.lstsq(np.column_stack([2.0 * flat, np.ones(len(y))]), squares, rcond=NEGLIGIBLE)[0][:2]
    height = np.sqrt(max(float(np.mean(length**2 - ((flat - within) ** 2).sum(axis=1))), 0.0))
    tried = np.array([straight, *(within @ axes[:2] + side * height * axes[2] for side in (1.0, -1.0))])
    missed = np.linalg.norm(y - tried[:, None], axis=2) - length
    return np.asarray(middle + tried[np.argmin((missed**2).sum(axis=1))])


def other_side(own: Sequence[tuple[Measurements, Array, Array]], place: Array) -> Array:
    """Return where a ``place`` (3,) of :func:`centre` is behind the plane of its points; itself if they are in none."""
    x = np.concatenate([points for _, points, _ in own])
    middle = x.mean(axis=0)
    _, sizes, axes = svd(x - middle, full_matrices=True)
    if len(sizes) == 3 and sizes[2] > _FLAT * sizes[1]:
        return place
    return np.asarray(place - 2.0 * ((place - middle) @ axes[2]) * axes[2])
