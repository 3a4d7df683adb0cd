"""What measurements would reveal, before anything is solved."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib.identification import identifiability
from calib.identification.error_model import ErrorModel
from calib.identification.identifiability import BlindDirection
from calib.identification.machine import values_at
from calib.identification.parameters import Parameter
from calib.identification.start import posed
from calib.identification.system import Evaluation, Problem, evaluate
from calib.measurement.checks import Finding
from calib.measurement.measurements import Measurements


@dataclass(frozen=True, slots=True, eq=False)
class Observability:
    """What a set of poses can see of an error model, at the nominal robot.

    ``numbers``: measured numbers. ``rank`` of ``parameters``; ``blind_directions``: what is not seen.
    ``condition``: of the seen directions, for ordinary deviations.
    """

    parameters: tuple[Parameter, ...]
    numbers: int
    rank: int
    condition: float
    blind_directions: tuple[BlindDirection, ...]


def observability(model: ErrorModel, measurements: Sequence[Measurements]) -> Observability:
    """Return what the measurements can see; raises MeasurementError when they are not of this robot."""
    problem = posed(model, measurements)
    parameters, sets = problem.parameters, problem.measurements
    rows = _at_start(problem).rows[:, :-1]
    directions = identifiability.directions(rows)
    rank = directions.rank
    _, blind = identifiability.told(rows, rank, parameters)
    seen = directions.singular_values[:rank]
    return Observability(
        parameters,
        sum(data.sigma.size for data in sets),
        rank,
        float(seen[0] / seen[-1]) if rank else float("nan"),
        blind,
    )


def unseen(model: ErrorModel, measurements: Sequence[Measurements]) -> tuple[Finding, ...]:
    """Return what no number of such measurements would see, and which others would.

    Raises MeasurementError and JobError as :func:`calib.identification.start.posed` does.
    """
    problem = posed(model, measurements)
    found = []
    moving = problem.motions
    if moving is not None and moving.grows and _at_start(problem).unseen[:, -1].any():
        found.append(
            Finding(
                "warning",
                "size-unseen",
                "The measurements do not tell how large the arm is: one that is larger throughout touches the same "
                "things in other places. The nominal size is kept as far as it is free. One known length tells it: "
                "the distance between two sockets or planes ([[relations]]), a gauge, a ball bar, a ball of known "
                "diameter, or positions from an instrument.",
            )
        )
    if problem.model.base != model.base:
        found.append(
            Finding(
                "warning",
                "base-unseen",
                "Nothing was measured in an instrument's frame, so that where the base stands is not seen: base.x to "
                "base.rz are held as given. Positions from an instrument, or known places of three sockets "
                '([targets.NAME]), would tell; with base = "fixed" nothing is said.',
            )
        )
    return tuple(found)


def _at_start(problem: Problem) -> Evaluation:
    # One millimetre and one milliradian of noise: only the shape of what is seen matters here.
    ones = [np.full(data.sigma.shape, 1e-3) for data in problem.measurements]
    return evaluate(problem, ones, values_at(problem.model.robot, problem.parameters, problem.reference))
