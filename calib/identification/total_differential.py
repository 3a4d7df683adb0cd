"""Gauss-Newton by total differential: the zero-offset algorithm of articulated arm CMMs, one iteration at a time.

With P = F(x) the touched point, dP = G dx. From m points of known position

    dx = (G^T G)^-1 G^T dQ,        x <- x + dx,        dQ = measured - F(x),

until the largest position error is below a set value (Ye Dong et al., joint zero offsets of a 6-joint articulated CMM,
where x are the six offsets and 3m > 6). Nothing damps the step and nothing weighs the rows: the noise does not enter,
and there are no sigmas. What this method has and :func:`calib.identify` has not is a trace that can be followed by
hand; for a calibration take ``identify``.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from calib.foundations.arguments import checked
from calib.foundations.arrays import Array, read_only
from calib.foundations.brief import brief
from calib.foundations.errors import IdentificationError, JobError, MeasurementError
from calib.foundations.sealing import sealed
from calib.foundations.units import UNITS
from calib.identification import system
from calib.identification.error_model import ErrorModel
from calib.identification.identifiability import RANK_TOLERANCE
from calib.identification.initialisation.problem import initial_problem
from calib.identification.machine import Machine, values_at
from calib.identification.parameters import Parameter, refuse_none_free, scales
from calib.identification.system import Problem
from calib.measurement.measurements import Measurements, as_sets

StopReason = Literal["below the limit", "the estimate repeats", "too many iterations"]

# Steps below 1e-9 parameter scales (1e-12 m, 1e-12 rad) are rounding: the estimate has come to rest.
_AT_REST = 1e-9
# What takes all of this, as Python and as a job say it.
_INSTEAD = 'identify (in a job, solver.kind = "least_squares")'


@dataclass(frozen=True, slots=True, eq=False)
@sealed
class Iteration:
    """One estimate: ``values`` (p,) in SI units, and the position error (N,) in m of every row under it."""

    values: Array
    errors: Array

    @property
    def largest(self) -> float:
        """The largest position error in m."""
        return float(np.max(self.errors))


@dataclass(frozen=True, slots=True, eq=False)
class Trace:
    """All that happened. Made by :func:`total_differential`.

    ``iterations``: the start, then every estimate; the last one is the answer, and ``machine`` is ``model.robot`` with
    it. ``reason``: why it stopped.
    """

    __repr__ = brief

    model: ErrorModel
    parameters: tuple[Parameter, ...]
    iterations: tuple[Iteration, ...]
    reason: StopReason
    machine: Machine

    @property
    def values(self) -> Array:
        """The last estimate (p,) in SI units."""
        return self.iterations[-1].values

    def records(self) -> list[dict[str, object]]:
        """Return one plain record for every iteration, in SI units."""
        return [
            {
                "iteration": k,
                "values": {p.name: float(v) for p, v in zip(self.parameters, at.values, strict=True)},
                "errors": at.errors.tolist(),
                "largest": at.largest,
            }
            for k, at in enumerate(self.iterations)
        ]

    def __str__(self) -> str:
        """Tell every iteration in a column of its own, in mm and degrees, and why it stopped."""
        mm, deg = UNITS["mm"], UNITS["deg"]
        rows = [
            (f"{p.name} [{unit.symbol}]", [float(at.values[k]) / unit.factor for at in self.iterations])
            for k, p in enumerate(self.parameters)
            for unit in [mm if p.unit == "m" else deg]
        ]
        rows.append(("largest error [mm]", [at.largest / mm.factor for at in self.iterations]))
        width = max(len(name) for name, _ in rows)
        head = f"{'iteration':<{width}}" + "".join(f"{k:>11}" for k in range(len(self.iterations)))
        lines = [f"{name:<{width}}" + "".join(f"{value:>11.4f}" for value in values) for name, values in rows]
        return "\n".join([head, *lines, f"Stopped after {len(self.iterations) - 1} iterations: {self.reason}."])


@checked
def total_differential(
    model: ErrorModel,
    measurements: Measurements | Sequence[Measurements],
    *,
    stop: float,
    rounding: float | None = None,
    most: int = 20,
) -> Trace:
    """Follow Gauss-Newton from the nominal robot until the largest position error is below ``stop`` (m).

    ``rounding`` (rad): after every iteration each angle is rounded to a multiple of it, as the paper's authors did with
    1 mrad; lengths are never rounded. A rounded estimate may stay above ``stop`` for good, so the search also ends when
    an estimate repeats, and after ``most`` iterations. Base and tools that are free start where the nominal robot
    explains the measurements best.

    Raises JobError for an option that cannot be used or a model with priors or joint terms, MeasurementError when the
    measurements are not positions of this robot, IdentificationError when they cannot determine the parameters.
    """
    if not (np.isfinite(stop) and stop >= 0.0):
        raise JobError(f"stop: {stop!r} is not a length in m from 0.")
    if rounding is not None and not (np.isfinite(rounding) and rounding > 0.0):
        raise JobError(f"rounding: {rounding!r} is not a positive angle in rad; leave it out for none.")
    if most < 1:
        raise JobError(f"most: {most!r} is not a number of iterations from 1.")
    problem = _problem(model, measurements)
    x = values_at(model.robot, problem.parameters, problem.reference)
    seen = [Iteration(read_only(x), read_only(np.linalg.norm(_misses(problem, x), axis=1)))]
    reason: StopReason = "too many iterations"
    for _ in range(most):
        if seen[-1].largest < stop:
            break
        x = _rounded(problem.parameters, x + _step(problem, x), rounding)
        seen.append(Iteration(read_only(x), read_only(np.linalg.norm(_misses(problem, x), axis=1))))
        if any(_same(problem.parameters, x, before.values) for before in seen[:-1]):
            reason = "the estimate repeats"
            break
    if seen[-1].largest < stop:
        reason = "below the limit"
    return Trace(model, problem.parameters, tuple(seen), reason, problem.machine(x))


def _problem(model: ErrorModel, measurements: Measurements | Sequence[Measurements]) -> Problem:
    sets = as_sets(measurements)
    for data in sets:
        if data.kind != "position":
            raise MeasurementError(
                f"{data.where}: observes {data.kind}, and the total differential takes positions only; use {_INSTEAD}."
            )
    problem = initial_problem(model, sets)
    parameters = problem.parameters
    refuse_none_free(parameters)
    if any(parameter.prior is not None or parameter.group is not None for parameter in parameters):
        raise JobError(f"the total differential takes no priors; leave them out or use {_INSTEAD}.")
    if model.terms:
        raise JobError(f"the total differential takes no joint terms; leave them out or use {_INSTEAD}.")
    points = sum(len(data) for data in sets)
    if 3 * points <= len(parameters):
        raise IdentificationError(
            f"{points} points give {3 * points} equations for {len(parameters)} parameters; "
            f"at least {len(parameters) // 3 + 1} points are needed."
        )
    return problem


def _misses(problem: Problem, x: Array) -> Array:
    """Return dQ (N, 3) in m, measured minus predicted, of all sets together."""
    return np.concatenate(system.residuals(problem.model.robot, problem.measurements, problem.machine(x)))


def _step(problem: Problem, x: Array) -> Array:
    """Return dx (p,), the least-squares solution of G dx = dQ, by SVD: G^T G would square the condition number."""
    s = scales(problem.parameters)
    # The system's residuals are measured minus predicted, so G is minus their Jacobian.
    G = -np.concatenate(system.jacobian(problem, x)).reshape(-1, len(s)) * s
    z, _, rank, _ = np.linalg.lstsq(G, _misses(problem, x).ravel(), rcond=RANK_TOLERANCE)
    if rank < len(s):
        raise IdentificationError(
            f"the points determine {rank} of {len(s)} parameters; free fewer, measure other poses, "
            f"or use {_INSTEAD}, which says what cannot be told apart."
        )
    return np.asarray(z * s)


def _rounded(parameters: Sequence[Parameter], x: Array, rounding: float | None) -> Array:
    if rounding is None:
        return x
    angle = np.array([parameter.unit == "rad" for parameter in parameters])
    return np.where(angle, np.round(x / rounding) * rounding, x)


def _same(parameters: Sequence[Parameter], x: Array, y: Array) -> bool:
    return bool(np.max(np.abs(x - y) / scales(parameters)) < _AT_REST)
