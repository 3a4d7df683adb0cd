"""The report of an outcome: which sections it has, in which order.

A section more is a function more in ``SECTIONS``: it takes the outcome, and returns None where it has nothing to say.
"""

from collections.abc import Callable

from calib.job.run import Outcome
from calib.job.versions import versions
from calib.presentation.report import sections
from calib.presentation.report.document import Report, Section
from calib.presentation.report.outlying import outliers

SECTIONS: tuple[Callable[[Outcome], Section | None], ...] = (
    lambda o: sections.errors(o.metrics, o.lost_in_urdf),
    lambda o: None if o.trace is None else sections.trace(o.trace),
    lambda o: sections.levels([(e.name, e.free, e.rank, e.metrics) for e in o.levels]) if o.levels else None,
    lambda o: None if o.choice is None else sections.chosen(o.choice),
    lambda o: sections.distribution(o.sets),
    lambda o: sections.poses(o.sets),
    lambda o: sections.joints(o.fit, o.sets),
    lambda o: sections.workspace(o.fit, o.sets),
    lambda o: outliers(o.outliers),
    lambda o: sections.parameters(o.fit),
    lambda o: sections.correlations(o.fit),
    lambda o: sections.seen(o.fit),
    lambda o: sections.priors(o.fit),
    lambda o: sections.noise(o.fit),
    lambda o: sections.provenance(f"calib calibrate {o.inputs.path.name} -o out", versions(), o.inputs.hashes),
)


def report_of(outcome: Outcome) -> Report:
    """Return the report of a finished calibration."""
    robot = outcome.fit.robot
    return Report(
        f"Calibration of {robot.urdf.name or robot.urdf.where}",
        sections.verdict(outcome.metrics, outcome.doubts, [finding.sentence for finding in outcome.inputs.findings]),
        tuple(section for make in SECTIONS if (section := make(outcome)) is not None),
    )
