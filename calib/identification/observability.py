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
from calib.identification.system import evaluate
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
    # One millimetre, milliradian or pixel of noise: only the shape of what is seen matters here.
    ones = [np.full(data.sigma.shape, 1e-3 if data.camera is None else 1.0) for data in sets]
    x = values_at(model.robot, parameters, problem.reference)
    rows = evaluate(problem, ones, x).rows[:, :-1]
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
