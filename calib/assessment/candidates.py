"""Poses that could be measured, and what each would bring."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import get_args

import numpy as np

from calib.assessment.design import DesignRows
from calib.foundations import rigid
from calib.foundations.arguments import checked, own_fields
from calib.foundations.arrays import Array, BoolArray, read_only
from calib.foundations.brief import brief
from calib.foundations.chance import drawing
from calib.foundations.choices import MOST_CANDIDATES, Observed
from calib.foundations.errors import JobError
from calib.foundations.ranges import finite, refuse_beyond, refuse_shape
from calib.foundations.sealing import sealed
from calib.foundations.units import DEG
from calib.foundations.words import refuse_other
from calib.identification.error_model import ErrorModel
from calib.identification.machine import Frames, machine, values_at
from calib.identification.parameters import directions, scales
from calib.machine.tool_motion import tool_jacobian
from calib.robot.collision import Effort, SelfCollision
from calib.robot.conditions import ordinary
from calib.robot.robot import Robot, TipModel
from calib.robot.sampling import closing, joint_limits

# What kinematic models leave out comes from eccentric encoders and gears and from gravity, mostly once a turn. On a
# real UR10 (docs/pose_choice.md) second harmonics beside the first made the choice no better.
_ORDERS = (1,)
# After so many tries, with so many times fewer found than would do, chance no longer brings enough.
_ENOUGH_TRIES = 2000
_BY_CHANCE = 4


@checked
def roughly(tool: Sequence[float] = (0.05, 0.0, 0.05), tracker: Sequence[float] = (0.0, 0.0, 0.0)) -> Frames:
    """Return frames for a plan: ``tool`` (3,), a reflector in the tip link, and ``tracker`` (3,) in the base, in m.

    Raises JobError for anything else than three numbers.
    """
    t, u = (
        finite(list(given), (3,), f"{name}: needs three lengths x, y, z in m.", JobError)
        for name, given in (("tracker", tracker), ("tool", tool))
    )
    return Frames(rigid.translation(-t)[None], rigid.translation(u)[None])


@dataclass(frozen=True, slots=True)
@sealed
class PlannedMeasurement:
    """How poses are measured. ``frames``: where base and tool are, roughly; ``observes`` "position" or "pose".

    ``sigma`` and ``sigma_angle``: of one coordinate, in m and rad. ``misfit``: rms in m of the position error that the
    model will not explain, all coordinates together; 0 for none. ``working`` (M, nr): poses where the tool must be
    accurate; when None, the candidates.
    """

    __repr__ = brief

    frames: Frames = field(default_factory=roughly)
    observes: Observed = "position"
    sigma: float = 0.05e-3
    sigma_angle: float = 0.1e-3
    misfit: float = 0.0
    working: Array | None = None

    def __post_init__(self) -> None:
        own_fields(self)
        refuse_other(self.observes, get_args(Observed), "observes")
        if self.working is not None:
            refuse_shape(self.working, (None, None), "working")
        refuse_beyond(self.sigma, "sigma", "sigma")
        refuse_beyond(self.sigma_angle, "sigma_angle", "sigma_angle")
        refuse_beyond(self.misfit, "model_sigma", "misfit")


def rows(model: ErrorModel, measurement: PlannedMeasurement, readings: Array) -> DesignRows:
    """Return what measuring each of N poses would bring, as rows of 3 numbers for positions and 6 for poses."""
    sigma = np.repeat([measurement.sigma, measurement.sigma_angle], 3)[: 6 if measurement.observes == "pose" else 3]
    J, H = _motions(model, measurement, readings, measurement.observes)
    return DesignRows(J / sigma[:, None], H / sigma[:, None])


def working_rows(model: ErrorModel, measurement: PlannedMeasurement, readings: Array) -> DesignRows:
    """Return the motions of the tool's position at N working poses, in m: what an I-optimal design keeps small."""
    J, H = _motions(model, measurement, readings, "position")
    return DesignRows(J, H)


def _motions(
    model: ErrorModel, measurement: PlannedMeasurement, readings: Array, observes: Observed
) -> tuple[Array, Array]:
    """Return the tool's motions (N, d, p) for the scale of each parameter, and (N, d, h) for effects left out."""
    robot, frames, parameters = model.robot, measurement.frames, model.parameters()
    at = machine(robot, parameters, frames, values_at(robot, parameters, frames))
    by_state = tool_jacobian(robot, at, readings, ordinary(readings))[:, : 6 if observes == "pose" else 3]
    J = by_state @ (directions(parameters, by_state.shape[2]) * scales(parameters))
    H = np.zeros((*J.shape[:2], 0))
    if measurement.misfit > 0.0:
        tips, by_reading = TipModel(robot).driven(readings)
        local = rigid.adjoint(rigid.inverse(frames.tools[0])) @ by_reading
        turned = (frames.base @ tips @ frames.tools[0])[:, :3, :3]
        moved = np.concatenate([turned @ local[:, :3], local[:, 3:]], axis=1)[:, : J.shape[1]]
        waves = [wave(k * readings)[:, None] for k in _ORDERS for wave in (np.cos, np.sin)]
        H = np.concatenate([moved * wave for wave in waves], axis=2)
        size = float(np.sqrt(np.mean(np.sum(H[:, :3] ** 2, axis=(1, 2)))))
        H = H * (measurement.misfit / size)
    return J, H


# ---- which poses can be measured


@dataclass(frozen=True, slots=True)
class Sight:
    """From where a reflector can be seen. All in m and rad.

    ``station``: the tracker in the frame of its measurements. ``facing``: the direction in which the reflector looks,
    in the tip link, None where it looks everywhere. ``acceptance``: how far from it the tracker may stand, as an angle.
    ``nearest`` and ``farthest``: distances between tracker and reflector.
    """

    station: tuple[float, float, float] = (0.0, 0.0, 0.0)
    facing: tuple[float, float, float] | None = None
    acceptance: float = 30.0 * DEG
    nearest: float = 0.0
    farthest: float = float("inf")

    def __post_init__(self) -> None:
        own_fields(self)
        refuse_beyond(self.station, "position, station, point", "station")
        if self.facing is not None:
            refuse_beyond(self.facing, "normal", "facing")
        if self.facing is not None and not np.linalg.norm(self.facing) > 0.0:
            raise JobError(f"facing: {self.facing} has no direction.")
        if not 0.0 < self.acceptance <= np.pi:
            raise JobError(f"acceptance: {self.acceptance / DEG:g} deg is not between 0 and 180 deg.")
        if not 0.0 <= self.nearest < self.farthest:
            raise JobError(f"range: from {self.nearest:g} m to {self.farthest:g} m holds no distance.")

    @checked
    def sees(self, tips: Array, points: Array) -> tuple[BoolArray, BoolArray]:
        """Return which reflectors face the tracker, and which are in range.

        ``tips`` (N, 4, 4): the tip link, and ``points`` (N, 3): the reflector, in the instrument's frame.
        Raises JobError for other shapes.
        """
        refuse_shape(tips, (None, 4, 4), "tips")
        refuse_shape(points, (len(tips), 3), "points")
        to_tracker = np.asarray(self.station) - points
        distance = np.linalg.norm(to_tracker, axis=1)
        within = (distance >= self.nearest) & (distance <= self.farthest)
        if self.facing is None:
            return np.ones(len(points), dtype=bool), within
        looks = tips[:, :3, :3] @ (np.asarray(self.facing) / np.linalg.norm(self.facing))
        cosine = np.sum(looks * to_tracker, axis=1) / np.maximum(distance, 1e-12)
        return cosine >= np.cos(self.acceptance) - 1e-12, within


@dataclass(frozen=True, slots=True, eq=False)
@sealed
class Candidates:
    """Poses that can be measured: ``readings`` (N, nr). ``rejected``: of ``tried`` poses how many for which reason."""

    __repr__ = brief

    readings: Array
    tried: int
    rejected: Mapping[str, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        own_fields(self)
        refuse_shape(self.readings, (None, None), "candidates: readings")


@checked
def possible(
    robot: Robot,
    frames: Frames,
    readings: Array,
    sight: Sight | None = None,
    collision: SelfCollision | None = None,
    effort: Effort | None = None,
) -> Candidates:
    """Return those of the readings (N, nr) that are within the joints' limits, seen, and free of self-collision.

    Raises RobotError for what is no readings of this robot, and when collisions take more than ``effort``, one of as
    many poses when None.
    """
    readings = robot.own(readings)
    limits = joint_limits(robot)
    unlimited = np.array([reading.lower is None or reading.upper is None for reading in robot.readings])
    inside = np.all(unlimited | ((readings >= limits[:, 0] - 1e-9) & (readings <= limits[:, 1] + 1e-9)), axis=1)
    rejected = {"outside the joints' limits": int(np.count_nonzero(~inside))}
    kept = readings[inside]
    closes = closing(robot, kept)
    rejected["with a loop that does not close"] = int(np.count_nonzero(~closes))
    kept = kept[closes]
    if sight is not None and len(kept):
        tips = frames.base @ robot.tips(kept)
        facing, within = sight.sees(tips, (tips @ frames.tools[0])[:, :3, 3])
        rejected |= {
            "reflector turned away": int(np.count_nonzero(~facing)),
            "out of the tracker's range": int(np.count_nonzero(facing & ~within)),
        }
        kept = kept[facing & within]
    if collision is not None and len(kept):
        touching = collision.colliding(kept, effort)
        rejected["touching itself"] = int(np.count_nonzero(touching))
        kept = kept[~touching]
    return Candidates(read_only(kept), len(readings), {reason: n for reason, n in rejected.items() if n})


@checked
def random_candidates(
    robot: Robot,
    frames: Frames,
    count: int,
    sight: Sight | None = None,
    collision: SelfCollision | None = None,
    *,
    seed: int = 0,
    most_tries: int = 200,
    progress: Callable[[int, int], None] = lambda _done, _of: None,
) -> Candidates:
    """Return ``count`` random poses, uniform over the joints' limits, that can be measured.

    Batches of ``count`` are drawn until there are enough, at most ``most_tries`` of them. Raises JobError with what
    was in the way when these do not suffice, or by the first of them clearly will not; RobotError as :func:`possible`.
    """
    if count < 1:
        raise JobError(f"{count} random poses are asked for; it takes one at least.")
    if count > MOST_CANDIDATES:
        raise JobError(f"{count} random poses are asked for; allowed are {MOST_CANDIDATES}.")
    limits = joint_limits(robot)
    if np.all(limits[:, 0] == limits[:, 1]):
        raise JobError(
            f"{robot.urdf.where}: the limits of its joints leave no room to move, so that there is one pose; a <limit> "
            "without lower and upper is from 0 to 0."
        )
    rng = drawing(seed)
    parts: list[Array] = []
    tried, rejected = 0, Counter[str]()
    effort = Effort(robot, count)
    while (found := sum(map(len, parts))) < count and tried < most_tries * count:
        if tried >= _ENOUGH_TRIES and found * most_tries * _BY_CHANCE < tried:
            break
        progress(found, count)
        drawn = rng.uniform(limits[:, 0], limits[:, 1], (count, len(limits)))
        some = possible(robot, frames, drawn, sight, collision, effort)
        parts.append(some.readings)
        tried += some.tried
        rejected.update(some.rejected)
    if found < count:
        reasons = ", ".join(f"{n} {reason}" for reason, n in rejected.most_common())
        raise JobError(f"only {found} of {tried} random poses can be measured, and {count} are asked for: {reasons}.")
    return Candidates(read_only(np.concatenate(parts)[:count]), tried, rejected)
