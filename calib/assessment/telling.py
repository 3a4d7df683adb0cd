"""Which of very many rows tell most: a selection by information, for streams of millions of rows."""

import numpy as np

from calib.assessment.design import DesignRows, sequence, space
from calib.foundations.arguments import checked
from calib.foundations.errors import JobError
from calib.foundations.linear import one_thread
from calib.identification.error_model import ErrorModel
from calib.identification.initialisation.problem import initial_problem
from calib.identification.machine import values_at
from calib.identification.parameters import scales
from calib.measurement.measurements import Measurements

# Rows that are looked at, evenly spread: neighbours of a stream say the same, and err alike.
_CANDIDATES = 3000
# A row of which nobody states the noise weighs as one of this, in m or rad; only ratios matter.
_NOISE = 1e-4


@checked
def most_telling(model: ErrorModel, data: Measurements, count: int) -> Measurements:
    """Return the rows of measurements that together determine the parameters of a model best, in their order.

        few = calib.planning.most_telling(model, stream, 500)

    D-optimal, one row after another (``calib.assessment.design``), of 3000 evenly spread ones: rows that follow each
    other are alike. Clocks are parameters too: fast rows tell them. Raises JobError when more rows are asked for than
    there are, MeasurementError as :func:`calib.identify` does.
    """
    if not 0 < count <= min(len(data), _CANDIDATES):
        most = min(len(data), _CANDIDATES)
        raise JobError(f"count: {count} rows cannot be chosen; allowed are 1 to {most}.")
    rows = np.unique(np.linspace(0, len(data) - 1, _CANDIDATES).round().astype(np.intp))
    with one_thread():
        problem = initial_problem(model, (data.subset(rows),))
        machine = problem.machine(values_at(model.robot, problem.parameters, problem.reference))
        (part,) = problem.measurements
        J = np.concatenate([b.J for b in problem.rates(machine, scales(problem.parameters)).blocks(part)])
        sigma = np.where(part.sigma > 0.0, part.sigma, _NOISE)
        prior = np.array([1.0 / parameter.hold if parameter.hold > 0.0 else np.inf for parameter in problem.parameters])
        chosen = sequence(space(DesignRows.without_misfit(J / sigma[:, :, None]), "D", prior=prior), count)
    return data.subset(rows[np.sort(np.array(chosen, dtype=np.intp))])
