"""What measurements would reveal, before anything is solved."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from calib.foundations.arrays import Array
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
    ``condition``: of the seen directions, for ordinary deviations; ``indices``: O1 to O5 (:func:`indices`) of the same.
    """

    parameters: tuple[Parameter, ...]
    numbers: int
    rank: int
    condition: float
    blind_directions: tuple[BlindDirection, ...]
    indices: Mapping[str, float]


def indices(singular_values: Array, poses: int) -> dict[str, float]:
    """Return the observability indices of ``poses`` poses from the singular values s_1 >= ... >= s_r of what is seen.

    O1 = (s_1 ... s_r)^(1/r) / sqrt(poses), O2 = s_r / s_1, O3 = s_r, O4 = s_r^2 / s_1, O5 = 1 / (1/s_1 + ... + 1/s_r):
    larger is better (Y. Sun, J. M. Hollerbach, *Observability index selection for robot calibration*, ICRA 2008).
    Empty where nothing is seen.
    """
    s = singular_values
    if not len(s):
        return {}
    return {
        "O1": float(np.exp(np.mean(np.log(s))) / np.sqrt(poses)),
        "O2": float(s[-1] / s[0]),
        "O3": float(s[-1]),
        "O4": float(s[-1] ** 2 / s[0]),
        "O5": float(1.0 / np.sum(1.0 / s)),
    }


def observability(model: ErrorModel, measurements: Sequence[Measurements]) -> Observability:
    """Return what the measurements can see; raises MeasurementError when they are not of this robot."""
    problem = posed(model, measurements)
    parameters, sets = problem.parameters, problem.measurements
    # One millimetre and one milliradian of noise: only the shape of what is seen matters here.
    ones = [np.full(data.sigma.shape, 1e-3) for data in sets]
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
        indices(seen, sum(map(len, sets))),
    )
