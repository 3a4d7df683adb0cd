"""What looks wrong with measurements, before they are fitted."""

from collections.abc import Callable, Sequence

from calib.foundations.arguments import checked
from calib.foundations.errors import IdentificationError
from calib.identification.error_model import ErrorModel
from calib.identification.observability import rank_findings
from calib.identification.sanity import signatures
from calib.measurement.checks import Finding, copied_tables
from calib.measurement.checks import table_findings as check_table
from calib.measurement.measurements import Measurements, as_sets


@checked
def check(model: ErrorModel, measurements: Measurements | Sequence[Measurements]) -> tuple[Finding, ...]:
    """Return what looks wrong with measurements and what they do not determine: an empty tuple where nothing does.

        for finding in calib.check(model, data):
            print(finding.severity, finding.sentence)

    Readings beyond their limits, wrong units, rows that are repeated; the typical mistake - a sign, an axis, a table in
    another frame - that explains why the nominal robot misses them; a tip link that never turns. An error says that a
    fit would be meaningless.
    """
    sets = as_sets(measurements)
    return _and(looks_wrong(model, sets), lambda: rank_findings(model, sets))


def looks_wrong(model: ErrorModel, sets: Sequence[Measurements]) -> tuple[Finding, ...]:
    """Return what looks wrong with measurements, and nothing of what they cannot show."""
    robot = model.urdf_robot
    of_tables = tuple(finding for data in sets for finding in check_table(data, robot.readings, data.reach(robot)))
    return _and((*of_tables, *copied_tables(sets)), lambda: signatures(model, sets))


def _and(found: tuple[Finding, ...], more: Callable[[], Sequence[Finding]]) -> tuple[Finding, ...]:
    """Return findings, and more of them where none is an error and there are enough numbers for a fit."""
    if any(finding.severity == "error" for finding in found):
        return found
    try:
        return (*found, *more())
    except IdentificationError:  # too few numbers, which the fit says
        return found
