"""May a calibration be trusted? Reasons why not, in sentences."""

from collections.abc import Mapping

from calib.assessment.metrics import Metrics
from calib.identification.fit import Fit
from calib.measurement.checks import Finding


def doubts(fit: Fit, before: Mapping[str, Metrics], after: Mapping[str, Metrics], *, held_out: bool) -> tuple[str, ...]:
    """Return why the calibration should not be used; nothing where there is no reason.

    ``before`` and ``after``: metrics by quantity, of data the fit never saw where ``held_out``, else of its own.
    """
    found = []
    if not fit.converged:
        found.append(f"The solver did not converge: its last step was {fit.step:.2g} parameter scales.")
    data = "data that the fit never saw" if held_out else "the data it was fitted to"
    robot_is_free = any(parameter.of_robot for parameter in fit.parameters)
    for quantity, now in after.items():
        if robot_is_free and now.rms >= before[quantity].rms:
            found.append(f"On {data} the {quantity} error is no smaller than before calibration.")
    return tuple(found)


def remarks(fit: Fit) -> tuple[Finding, ...]:
    """Return what a user should know of the search for a solution that may be trusted."""
    if not fit.converged or fit.narrowed == 1.0:
        return ()
    return (
        Finding(
            "warning",
            "priors-narrowed",
            f"The solver did not converge with the usual weak priors, so they were made {fit.narrowed:g} times "
            "narrower. Parameters that the data hardly determine stay that much nearer to the nominal robot, and base "
            "and tool to their start values. Predictions near the measured poses hardly change. More poses, other "
            "orientations of the tool, or priors for known values make this unnecessary.",
        ),
    )
