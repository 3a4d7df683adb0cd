"""Where the tools of rows go when parameters change, whatever the rows measure."""

from dataclasses import replace

import numpy as np

from calib.foundations.arrays import Array
from calib.identification.fit import Fit
from calib.identification.machine import values_at
from calib.identification.system import Problem, jacobian
from calib.measurement.measurements import Measurements


def as_positions(data: Measurements) -> Measurements:
    """Return rows of one end alone, as if an instrument that sees all that is on the floor had seen the tool."""
    n = len(data)
    return replace(
        data,
        kind="position",
        position=np.zeros((n, 3)),
        value=np.zeros((n, 0)),
        sigma=np.ones((n, 3)),
        other=None,
        uses={},
        camera=None,
        board=None,
        target_links={},
        stream=None,
    )


def tool_motions(fit: Fit, data: Measurements, along: Array) -> Array:
    """Return how the tools of n rows move (n, 3, k) along directions (p, k) of a fit's parameters, in SI units.

    In the instrument's frame, per unit of each direction, to first order.
    """
    at = fit.machine
    problem = Problem(fit.model, fit.parameters, at.frames, (as_positions(data),), at.deviations)
    (J,) = jacobian(problem, values_at(fit.model.robot, fit.parameters, at.frames, at.deviations))
    # Of residuals, measured minus predicted.
    return np.asarray(-J @ along)
