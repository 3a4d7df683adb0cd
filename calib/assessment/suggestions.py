"""What else the data would show: joint terms that nobody asked for, tried on rows that were held out.

A column that is there and unused - temperature, the side of approach, measured torques - costs nothing to try, and
gears that wobble or give way, and scales that are too long, need no column. Each kind of joint terms is fitted to the
rows of the fit, and is named only where it makes errors of the rows held out smaller: significantly, and by a tenth.
"""

from collections.abc import Sequence
from dataclasses import replace

from calib.assessment.gain import gain
from calib.assessment.judged import JudgedSet
from calib.assessment.validation import ChosenRows, row_groups, some_rows
from calib.foundations.arrays import Array
from calib.foundations.errors import CalibError
from calib.identification.error_model import with_terms
from calib.identification.fit import Fit
from calib.identification.identify import residuals_of
from calib.measurement.kinds import QUANTITIES
from calib.measurement.measurements import Measurements
from calib.robot.conditions import joined
from calib.robot.joint_terms import parts
from calib.robot.terms import KINDS
from calib.robot.terms.kind import Kind

# Keys of a job that are tried, and what shows them.
_TRIED = {
    "backlash": "the side from which joints were reached",
    "thermal": "the temperature",
    "torque": "the measured torques",
    "harmonics": "gears that wobble",
    "elastic": "joints that give way",
    "gain": "joints that move by more or less than they read",
}
# Of more rows so many are looked at: a trial should cost little to those who did not ask. What it finds is not more.
_ROWS = 1000
# Nor of a fit that was long in coming: each trial is as long.
_MOST_EVALUATIONS = 60
_OPTIONS = {"harmonic_orders": (1, 2)}
_SURELY = 0.999
_BY = 0.9


def suggestions(fit: Fit, held_out: Sequence[Measurements]) -> tuple[str, ...]:
    """Return a sentence for the kind of joint terms that would make held-out errors smallest; nothing where none does.

    Nothing is tried where the instrument explains what remains, where no rows were held out, or where the fit itself
    was long in coming.
    """
    explained = all(noise.model == 0.0 for noise in fit.noise)
    if not held_out or explained or not fit.converged or fit.evaluations > _MOST_EVALUATIONS:
        return ()
    # Of several quantities the first is judged.
    quantity = QUANTITIES[held_out[0].kind][0].name
    held_out = [data for data in held_out if quantity in {q.name for q in QUANTITIES[data.kind]}]
    now = residuals_of(fit, held_out, fit.machine)
    sets = fit.measurements
    rows = ChosenRows(sets, None, fit.losses).some_of_all(some_rows(sets, row_groups(sets), _ROWS))
    best, least = "", 1.0
    for kind in KINDS:
        if kind.key not in _TRIED or any(term.kind in kind.names for term in fit.model.robot.terms):
            continue
        then = _with(fit, rows, kind, held_out)
        if then is None:
            continue
        judged = [
            JudgedSet("validation", data.where, data, before, after)
            for data, before, after in zip(held_out, now, then, strict=True)
        ]
        found = gain(judged, quantity)
        if found.after < _BY * least * found.before and found.t > found.needed(_SURELY):
            least = found.after / found.before
            best = (
                f'{_TRIED[kind.key].capitalize()}: error_model.{kind.key} = "all" makes the held-out {quantity} error '
                f'{100.0 * (1.0 - least):.0f} % smaller; terms = "auto" chooses among all kinds.'
            )
    return (best,) if best else ()


def _with(fit: Fit, rows: ChosenRows, kind: Kind, held_out: Sequence[Measurements]) -> tuple[Array, ...] | None:
    """Return the held-out residuals of a fit with terms of a kind; None where it cannot be tried."""
    robot = fit.model.urdf_robot
    told = joined([(len(data), end.conditions) for data in (*fit.measurements, *held_out) for end in data.ends])
    try:
        offered = [term for terms in kind.offered(parts(robot), told, _OPTIONS) for term in terms]
        if not offered:
            return None
        model = with_terms(fit.model, (*robot.terms, *offered))
        found = replace(rows.fit(model, near=fit), model=model)
        return residuals_of(found, held_out, found.machine) if found.converged else None
    except CalibError:  # as where the URDF states no masses
        return None
