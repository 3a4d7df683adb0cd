"""May a calibration be trusted? Reasons why not, in sentences."""

from collections.abc import Mapping

from calib.assessment.metrics import Metrics
from calib.identification.fit import Fit


def doubts(fit: Fit, before: Mapping[str, Metrics], after: Mapping[str, Metrics], *, held_out: bool) -> tuple[str, ...]:
    """Return why the calibration should not be used; nothing where there is no reason.

    ``before`` and ``after``: metrics by quantity, of data the fit never saw where ``held_out``, else of its own.
    """
    found = []
    if not fit.converged:
        found.append(f"The solver did not converge: its last step was {fit.step:.2g} ordinary deviations.")
    data = "data that the fit never saw" if held_out else "the data it was fitted to"
    robot_is_free = any(parameter.of_robot for parameter in fit.parameters)
    for quantity, now in after.items():
        if robot_is_free and now.rms >= before[quantity].rms:
            found.append(f"On {data} the {quantity} error is no smaller than before calibration.")
    return tuple(found)
