"""Random readings of a robot: within its limits, and where its loops close."""

from collections.abc import Sequence

import numpy as np

from calib.foundations.arrays import Array, BoolArray
from calib.foundations.choices import MOST_POSES
from calib.foundations.errors import RobotError
from calib.foundations.ranges import are_numbers
from calib.robot.conditions import ordinary
from calib.robot.robot import Deviations, Reading, Robot, TipModel
from calib.robot.urdf import UrdfJoint

# Hardly any pose: fewer than one in so many, when so many were tried.
_RARELY = 200
_ENOUGH = 1000
# Machines that differ by their errors differ in the determinant of closure as well; where joints stood still, all rows
# have the least one.
_SLACK = 0.9
# Limits are written in degrees with few digits; this is what rounding takes.
_LIMIT_SLACK = 1e-9


def joint_limits(robot: Robot) -> Array:
    """Return the limits (nr, 2) of the readings; a joint without turns once, or slides a metre to either side."""
    turn = {"angle": np.pi, "length": 1.0}
    return np.array(
        [
            (
                -turn[reading.dimension] if reading.lower is None else reading.lower,
                turn[reading.dimension] if reading.upper is None else reading.upper,
            )
            for reading in robot.readings
        ]
    )


def limits(of: Sequence[Reading | UrdfJoint]) -> tuple[Array, Array]:
    """Return the least and the greatest value (n,) of readings or joints, infinite where one has no limit."""
    low = [-np.inf if one.lower is None else one.lower for one in of]
    high = [np.inf if one.upper is None else one.upper for one in of]
    return np.array(low), np.array(high)


def outside(q: Array, low: Array, high: Array) -> BoolArray:
    """Return which positions (..., n) are beyond their limits (n,)."""
    return np.asarray((q < low - _LIMIT_SLACK) | (q > high + _LIMIT_SLACK))


def limited_followers(robot: Robot) -> list[tuple[int, UrdfJoint]]:
    """Return the joints without a reading that have a range in the URDF, with their columns of joint positions.

    Such limits are often written without care, so that what is beyond them is worth a remark and no more.
    """
    known = {reading.name for reading in robot.readings}
    joints = enumerate(robot.urdf.joint(robot.chain[i].name) for i in robot.moving)
    # A <limit> of efforts alone is 0 to 0.
    return [(k, joint) for k, joint in joints if joint.name not in known and joint.lower != joint.upper]


def closing(robot: Robot, readings: Array, machines: Sequence[Deviations | None] = (None,)) -> BoolArray:
    """Return at which of the readings (N, nr) the loops of all machines close; None stands for the nominal one."""
    return _closing([TipModel(robot, deviations) for deviations in machines] if robot.loops else [], readings)


def _closing(models: Sequence[TipModel], readings: Array, determinant: float | None = None) -> BoolArray:
    found = np.ones(len(readings), dtype=bool)
    for model in models:
        rows = np.flatnonzero(found)
        asked = readings[rows], ordinary(readings[rows])
        if determinant is None or (own := model.determinants(*asked)) is None:
            found[rows] = model.closes(*asked)
        else:  # nothing compares with nan
            found[rows] = own * np.sign(determinant) >= _SLACK * abs(determinant)
    return found


def least_determinant(robot: Robot, deviations: Deviations, readings: Array) -> float | None:
    """Return the determinant of closure nearest to 0, a dead centre, at readings (N, nr): its sign tells the side.

    None without loops, where no row closes, or where rows are on both sides.
    """
    if not robot.loops:
        return None
    determinants = TipModel(robot, deviations).determinants(readings, ordinary(readings))
    if determinants is None:
        return None
    determinants = determinants[~np.isnan(determinants)]
    if not (len(determinants) and (np.all(determinants > 0.0) or np.all(determinants < 0.0))):
        return None
    return float(determinants[np.argmin(np.abs(determinants))])


def random_readings(
    robot: Robot,
    count: int,
    limits: Array | None = None,
    machines: Sequence[Deviations | None] = (None,),
    *,
    determinant: float | None = None,
    seed: int = 0,
) -> Array:
    """Return random readings (count, nr), uniform over ``limits`` (nr, 2), those of the joints when None.

    Readings where a loop of one of the machines does not close are drawn again, and with a ``determinant`` those
    where it is nearer to a dead centre than that, or beyond (:func:`least_determinant`); raises RobotError when hardly
    any are left.
    """
    bounds = (joint_limits(robot) if limits is None else limits) + 0.0  # -0.0 is below 0.0 to who draws
    width = len(robot.readings)
    if bounds.shape != (width, 2) or not (are_numbers(bounds) and np.all(bounds[:, 0] <= bounds[:, 1])):
        raise RobotError(f"limits: needs finite numbers ({width}, 2), for every reading its lower and its upper one.")
    if not 1 <= count <= MOST_POSES or seed < 0:
        raise RobotError(f"{count} random poses, seed {seed}: allowed are 1 to {MOST_POSES} and no negative seed.")
    models = [TipModel(robot, deviations) for deviations in machines] if robot.loops else []
    rng = np.random.default_rng(seed)
    found = np.zeros((0, len(bounds)))
    tried = 0
    while tried < _ENOUGH or len(found) * _RARELY >= tried:
        drawn = rng.uniform(bounds[:, 0], bounds[:, 1], (count, len(bounds)))
        tried += count
        # No more are looked at than are lacking.
        while len(drawn):
            part, drawn = np.split(drawn, [count - len(found)])
            found = np.concatenate([found, part[_closing(models, part, determinant)]])
            if len(found) == count:
                return found
    raise RobotError(f"{robot.urdf.where}: its loops close in hardly any pose within the limits of its joints.")
