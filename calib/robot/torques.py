"""Measured torques that scatter: what drives are likely to hold, so that compliances are not taken for smaller.

Noise in what a coefficient is multiplied by makes it smaller, by the share that the noise has in the variance of the
torque (W. A. Fuller, *Measurement error models*, 1987). So torques with a stated sigma are replaced by what is to be
expected of them, given what was read and all else that is known (regression calibration: R. J. Carroll, D. Ruppert,
L. A. Stefanski, C. M. Crainiceanu, *Measurement error in nonlinear models*, 2006, chapter 4). That is what gravity does
to masses which are found here beside those that are stated, with a constant and friction where sides are told, and of
the rest as much as is not noise. Nothing that was measured of the tip is looked at.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calib.foundations.arrays import Array, read_only
from calib.foundations.errors import RobotError
from calib.robot.conditions import Conditions
from calib.robot.gravity import Holding
from calib.robot.joint_terms import moments, weights_of, with_joint_terms
from calib.robot.robot import Robot

# Of fewer rows for each coefficient no scatter can be told.
_ROWS_EACH = 3


def expected_torques(robot: Robot, rows: Sequence[tuple[Array, Conditions]]) -> tuple[Conditions, ...]:
    """Return the conditions of several sets of rows, (N, nr) readings each, with torques to be expected in all of them.

    Those of readings whose torque has no sigma stay, and so does what rows are too few to tell. ``robot`` is in the
    frames of its URDF.
    """
    wanted = [k for k, (_, told) in enumerate(rows) if told.torque is not None and told.torque_sigma is not None]
    if not wanted:
        return tuple(told for _, told in rows)
    torques = [np.array(rows[k][1].torque) for k in wanted]
    ends = np.cumsum([len(torque) for torque in torques])[:-1]
    sigma = np.concatenate([np.asarray(rows[k][1].torque_sigma) for k in wanted])
    terms = moments(robot)
    units: dict[str, int] = {}
    each = np.zeros((0, len(sigma), len(robot.readings)))
    if terms:
        heavy = with_joint_terms(robot, terms)
        holding = None if heavy.weights is None else Holding(heavy.weights)
        if holding is not None:
            units = {name: k for k, name in enumerate(holding.units)}
            each = np.concatenate([holding.of_units(*rows[k])[:, :, : len(robot.readings)] for k in wanted], axis=1)
    stated = _stated(robot, [rows[k] for k in wanted])
    every = np.concatenate(torques)
    for j, reading in enumerate(robot.readings):
        here = np.isfinite(every[:, j])
        columns = [each[units[term.body], :, j] for term in terms if term.reading == reading.name]
        columns += [] if stated is None else [stated[:, j]]
        sides = [rows[k][1].approach for k in wanted]
        if all(side is not None for side in sides):
            columns.append(np.nan_to_num(np.concatenate([np.asarray(side)[:, j] for side in sides])))
        X = np.column_stack([np.ones(len(sigma)), *columns])[here]
        if len(X) < _ROWS_EACH * X.shape[1]:
            continue
        smooth = X @ np.linalg.lstsq(X, every[here, j], rcond=None)[0]
        left = every[here, j] - smooth
        scatter = float(left @ left) / (len(X) - X.shape[1])
        noise = float(np.mean(sigma[here] ** 2))
        every[here, j] = smooth + (max(0.0, 1.0 - noise / scatter) if scatter > 0.0 else 0.0) * left
    found = dict(zip(wanted, np.split(every, ends), strict=True))
    return tuple(
        replace(told, torque=read_only(found[k]), torque_sigma=None) if k in found else told
        for k, (_, told) in enumerate(rows)
    )


def _stated(robot: Robot, rows: Sequence[tuple[Array, Conditions]]) -> Array | None:
    """Return what stated masses, payloads of the rows among them, have readings hold (N, nr); None without masses."""
    try:
        holding = Holding(weights_of(robot))
    except RobotError:
        return None
    return np.concatenate([holding(readings, told)[:, : len(robot.readings)] for readings, told in rows])
