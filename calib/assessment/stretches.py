"""The rows of a fit in their order, whitened, with what they would do if base, tool or a joint were elsewhere."""

from dataclasses import dataclass, replace

import numpy as np

from calib.assessment.influence import ROUNDING, Residue
from calib.foundations.arrays import Array, BoolArray, IntArray, evenly_in_runs
from calib.foundations.sealing import sealed
from calib.identification.parameters import scales
from calib.identification.repeats import Repeats, by_pose
from calib.identification.system import Problem
from calib.identification.together import Together
from calib.measurement.kinds import WITH_TARGET
from calib.measurement.measurements import Measurements
from calib.measurement.poses import poses_of

# Of larger data so many rows are taken, in runs of neighbours.
_MOST_ROWS, _RUN = 6000, 100
# Rows with times that are no farther apart, in s, are a motion.
_STREAM = 1.0


@dataclass(frozen=True, slots=True, eq=False)
@sealed
class Stretch:
    """Rows of one set in their order, whitened: ``r`` (n, d), ``J`` (n, d, k); how they follow what is no parameter.

    Of photographs that err together all is less what rows have in common: an arm that does not come back is no other.
    ``columns`` (k,): the fit's parameters by which J is, by number.
    ``by_joint`` (n, d, k): a turn (shift) of each of ``joints``; ``by_base`` (n, d, 6) and ``by_tool`` (n, d, 6): a
    motion of the base and of the tool, in m and rad; ``by_growth`` (n, d): all lengths longer by their whole, of
    positions alone. ``values`` (n, k): the joints' readings at which J is, ``rates`` (n, k): their
    change from row to row, or in a second where ``step``, the time in s between rows, is known; else that is nan.
    ``followers`` (f): joints that follow a reading of another by a coupling or as mimic joints, and that reading;
    ``by_follower`` (n, d, f): a turn (shift) of each, ``followed`` (n, f): by how much it follows.
    ``row`` (n,): number in the set; ``pose`` (n,): that of its pose. ``used``: how many of the numbers the parameters
    take up. ``instrument``: rms of the instrument's noise, as a share of what rows are weighed by; 0 where it is not
    known. ``least``: variance of r that is rounding. ``together``: how its photographs err, where their rows err
    together; ``repeats``: how rows of one pose err, of every quantity where these do.
    """

    r: Array
    J: Array
    columns: IntArray
    joints: tuple[str, ...]
    by_joint: Array
    by_base: Array
    by_tool: Array
    by_growth: Array
    values: Array
    rates: Array
    followers: tuple[tuple[str, str], ...]
    by_follower: Array
    followed: Array
    row: Array
    step: float
    pose: IntArray
    data: Measurements
    used: float
    instrument: float
    least: float
    together: Together | None = None
    repeats: tuple[Repeats, ...] = ()


def stretches(residue: Residue) -> tuple[Stretch, ...]:
    """Return the rows of every set of a fit, with what they would do if base, tool or a joint were elsewhere."""
    fit = residue.fit
    robot = fit.model.robot
    read = tuple(robot.chain[i].name for j, i in enumerate(robot.moving) if j not in robot.passive)
    wide = replace(fit.model, offsets=read, placements=(), terms=(), base="pose", tool="pose", setups={})
    names_of = fit.measurements[0]
    parameters = wide.parameters(names_of.tools, names_of.setups)
    kinds = [np.array([parameter.kind == kind for parameter in parameters]) for kind in ("base", "tool", "offset")]
    names = [parameter.name.removesuffix(".offset") for parameter in parameters if parameter.kind == "offset"]
    readings = [reading.name for reading in robot.readings]
    # A joint that another drives has no reading of its own.
    own = [k for k, name in enumerate(names) if name in readings]
    column = [readings.index(names[k]) for k in own]
    # Others follow readings of theirs, each by a multiple.
    moving = [robot.chain[i].name for i in robot.moving]
    multiple = robot.coupling[[moving.index(name) for name in names]]
    ties = [(k, i) for k, i in np.argwhere(multiple != 0.0).tolist() if k not in own]
    of_follower, followed = [k for k, _ in ties], [i for _, i in ties]
    units = np.ones(len(parameters))
    judged = tuple(fit.parameters[k] for k in residue.judged)
    found = []
    for i, data in enumerate(fit.measurements):
        rows = _chosen(data, residue)
        if not len(rows):
            continue
        part = data.subset(rows)
        sigma, w = residue.sigma[i][rows][:, :, None], np.sqrt(residue.w[i][rows])[:, None, None]
        together = fit.together[i] if fit.together else None
        together = together and together.drawn(rows, np.zeros_like(rows))
        less = _as_it_is if together is None else together.less
        at = Problem(wide, parameters, fit.machine.frames, (part,))
        blocks = list(at.rates(fit.machine, units).blocks(part))
        moved, there = [_moved(b.J, *kinds) for b in blocks], np.concatenate([b.readings for b in blocks])
        by_base, tool, by_offset = (less(np.concatenate(one) / sigma * w) for one in zip(*moved, strict=True))
        mine = replace(residue.problem, measurements=(part,), parameters=judged)
        J, left = np.empty((*part.sigma.shape, len(judged))), np.empty(part.sigma.shape)
        for b in mine.rates(fit.machine, scales(judged)).blocks(part):
            J[b.rows], left[b.rows] = b.J / sigma[b.rows] * w[b.rows], b.observed.residual
        J = less(J)
        r = less(left[:, :, None] / sigma * w)[:, :, 0]
        rates, step = _rates(data, fit.machine.frames.scalars)
        found.append(
            Stretch(
                r,
                J,
                residue.judged,
                tuple(names[k] for k in own),
                by_offset[:, :, own],
                by_base,
                tool,
                _by_growth(part, left, by_base, fit.machine.frames.bases),
                there[:, column],
                rates[rows][:, column],
                tuple((names[k], readings[i]) for k, i in ties),
                by_offset[:, :, of_follower],
                there[:, followed] * multiple[of_follower, followed],
                rows.astype(np.float64),
                step,
                poses_of(part, pieces=True),
                data,
                _taken_up(J, residue.C),
                float(np.sqrt(np.mean((part.sigma / sigma[:, :, 0]) ** 2))),
                (ROUNDING / float(residue.sigma[i].min())) ** 2,
                together,
                tuple(told for told in fit.repeats if told.measurements == i),
            )
        )
    return tuple(found)


def _moved(J: Array, base: BoolArray, tool: BoolArray, offset: BoolArray) -> tuple[Array, Array, Array]:
    """Return what moving the base, and the tool, of a row's own does to it (n, d, 6), and what offsets do (n, d, k).

    ``base``, ``tool`` and ``offset`` (p,): which parameters are these, of how many set-ups and tools there are.
    """
    by_base, by_tool = (J[:, :, own].reshape(*J.shape[:2], -1, 6).sum(axis=2) for own in (base, tool))
    return by_base, by_tool, J[:, :, offset]


def _taken_up(J: Array, C: Array) -> float:
    """Return how many of the numbers J (n, d, k) is of the parameters take up: the trace of J C J^T."""
    rows = J.reshape(-1, len(C))
    return float(np.sum((rows.T @ rows) * C))


def by_photograph(part: Stretch) -> Stretch:
    """Return six numbers of every photograph in place of its rows, where these err together: what they have in common.

    Whatever differs from photograph to photograph is in these; the rest of the rows would only dilute it. In the order
    of the rows.
    """
    together = part.together
    if together is None:
        return part
    number, last = together.number, len(together.number) - 1
    _, first = np.unique(number, return_index=True)
    order = np.argsort(first)
    first, ends = first[order], last - np.unique(number[::-1], return_index=True)[1][order]

    def common(whitened: Array) -> Array:
        return np.asarray(together.by_photograph(whitened)[order])

    return replace(
        part,
        r=common(part.r[:, :, None])[:, :, 0],
        J=common(part.J),
        by_joint=common(part.by_joint),
        by_follower=common(part.by_follower),
        by_base=common(part.by_base),
        by_tool=common(part.by_tool),
        by_growth=common(part.by_growth[:, :, None])[:, :, 0],
        values=part.values[first],
        followed=part.followed[first],
        rates=part.rates[first],
        row=part.row[ends],
        pose=np.arange(len(first)),
        together=None,
    )


def pose_by_pose(part: Stretch, C: Array) -> Stretch:
    """Return rows that measure one pose again and again, one after the other, as one: with the same J, but less noise.

    What a model leaves is the same in all of them: as rows of their own they would make chance of it impossible. ``C``:
    the covariance of the parameters.
    """
    first = np.flatnonzero(np.diff(part.pose, prepend=-1))
    if len(first) == len(part.pose):
        return part
    run = np.repeat(np.arange(len(first)), np.diff(np.append(first, len(part.pose))))
    found = as_means(part, run)
    return replace(found, used=_taken_up(found.J, C))


def as_means(part: Stretch, number: IntArray) -> Stretch:
    """Return the rows of each ``number`` (n,), from 0, as one: their mean, times the root of how many they are."""
    many = np.bincount(number)

    def mean(x: Array) -> Array:
        return np.asarray(by_pose(x, number)[0] / many.reshape(-1, *[1] * (x.ndim - 1)))

    def as_one(x: Array) -> Array:
        return np.asarray(mean(x) * np.sqrt(many).reshape(-1, *[1] * (x.ndim - 1)))

    last = len(number) - 1 - np.unique(number[::-1], return_index=True)[1]
    return replace(
        part,
        r=as_one(part.r),
        J=as_one(part.J),
        by_joint=as_one(part.by_joint),
        by_follower=as_one(part.by_follower),
        by_base=as_one(part.by_base),
        by_tool=as_one(part.by_tool),
        by_growth=as_one(part.by_growth),
        values=mean(part.values),
        followed=mean(part.followed),
        rates=mean(part.rates),
        row=part.row[last],
        pose=part.pose[last],
    )


def _rates(data: Measurements, scalars: Array) -> tuple[Array, float]:
    """Return how fast the readings (N, k) change, in a second, and the seconds between rows; or from row to row."""
    if data.stream is not None and data.times is not None:
        return data.stream.rates(data.shifts(scalars)), float(np.median(np.diff(data.times)))
    if len(data) < 2:
        return np.zeros_like(data.readings), float("nan")
    if data.times is not None:
        steps = np.diff(data.times)
        if np.all(steps > 0.0) and np.median(steps) <= _STREAM:
            # Angles may be told within a turn; no joint slides so far, in m, from one row of a motion to the next.
            moved = np.unwrap(data.readings, axis=0)
            return np.asarray(np.gradient(moved, data.times, axis=0)), float(np.median(steps))
    return np.asarray(np.gradient(data.readings, axis=0)), float("nan")


def _by_growth(data: Measurements, residual: Array, by_base: Array, bases: Array) -> Array:
    """Return what it does to positions if the tool is farther from the base by all of their distance (n, d).

    Where the fit has it: with what was measured, every residual would be a part of it.
    """
    if data.position is None:
        return np.zeros(by_base.shape[:2])
    arm = data.position - residual[:, :3] - bases[data.setup, :3, 3]
    return np.asarray(np.einsum("ndk,nk->nd", by_base[:, :, :3], arm))


def _as_it_is(rows: Array) -> Array:
    return rows


def _chosen(data: Measurements, residue: Residue) -> IntArray:
    """Return the rows to look at: all, or of very many runs of neighbours, spread evenly.

    Of very many targets all rows of those that are judged.
    """
    rows, left_out = np.arange(len(data)), len(residue.fit.parameters) - len(residue.judged)
    if left_out and data.kind in WITH_TARGET:
        names = {residue.fit.parameters[k].name.rpartition(".")[0] for k in residue.judged}
        unknown = {parameter.name.rpartition(".")[0] for parameter in residue.fit.parameters}
        whole = np.array([f"target.{name}" in names or f"target.{name}" not in unknown for name in data.targets])
        rows = rows[whole[data.target]]
    return rows[evenly_in_runs(len(rows), _MOST_ROWS, _RUN)]
