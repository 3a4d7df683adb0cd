"""Rows in a few places of joint space with nothing between them: what geometry is worth elsewhere.

Such rows hardly tell placements and offsets from each other. Without priors they may grow far beyond what any arm has,
with hardly a trace where rows are, and make predictions elsewhere wrong by millimetres. Priors whose widths are learned
keep them small. But where the data determine too few parameters of a kind, such a prior has a usual width, which is an
assumption, and places that are held out do not tell whether it holds. So the user is told, and decides.
"""

from calib.assessment.validation import neighbourhoods, row_groups
from calib.identification.fit import Fit

# Of more rows places are not looked for.
_MOST_ROWS = 10_000


def unshown(fit: Fit) -> tuple[str, ...]:
    """Return what a user should know of a fit without priors to rows in a few places apart; nothing of others."""
    model, sets = fit.model, fit.measurements
    free = bool(model.offsets or model.placements) and model.priors.length is None and model.priors.angle is None
    if not free or sum(map(len, sets)) > _MOST_ROWS or any(data.stream for data in sets):
        return ()
    near = neighbourhoods(sets, row_groups(sets), turning=[reading.turns for reading in model.robot.readings])
    if not near.apart:
        return ()
    return (
        f"The rows lie in {int(near.number.max()) + 1} places of joint space with nothing between them, so the "
        "geometry is not shown elsewhere. Measure poses between these places; or, if the arm is near its URDF, keep it "
        'there: error_model.prior = { length = "learned", angle = "learned" }.',
    )
