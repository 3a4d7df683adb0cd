"""The report of a calibration: which sections it has, in which order.

A section more is a function more in ``SECTIONS``: it takes the calibration, and returns None where it has nothing to
say.
"""

from collections.abc import Callable

from calib.assessment.hand_eye import hand_eyes
from calib.presentation.hand_eye import blame_section, hand_eye_section, optics_section
from calib.presentation.report import sections
from calib.presentation.report.document import Report, Section
from calib.presentation.report.in_time import in_time
from calib.presentation.report.outlying import outlier_section
from calib.results.calibration import Calibration, versions

SECTIONS: tuple[Callable[[Calibration], Section | None], ...] = (
    lambda c: sections.errors(c.metrics, None if c.in_urdf is None else (c.in_urdf.metrics, c.in_urdf.fit.converged)),
    lambda c: sections.checks(c.checks),
    lambda c: None if c.trace is None else sections.trace(c.trace),
    lambda c: sections.levels([(e.name, e.free, e.rank, e.metrics) for e in c.levels]) if c.levels else None,
    lambda c: None if c.choice is None else sections.chosen(c.choice),
    lambda c: hand_eye_section(hand_eyes(c.fit, c.sets)),
    lambda c: optics_section(c.optics),
    lambda c: None if c.blame is None else blame_section(c.blame),
    lambda c: sections.distribution(c.sets),
    lambda c: sections.pose_section(c.sets),
    lambda c: sections.joints(c.fit, c.sets),
    lambda c: sections.workspace(c.fit, c.sets),
    lambda c: in_time(c.fit, c.sets),
    lambda c: outlier_section(c.outliers),
    lambda c: sections.budget(c.machine, c.sets),
    lambda c: sections.parameters(c.fit),
    lambda c: sections.correlations(c.fit),
    lambda c: sections.seen(c.fit),
    lambda c: sections.priors(c.fit),
    lambda c: sections.noise(c.fit),
    lambda c: sections.provenance(c.origin.command, versions(), c.origin.hashes),
)


def report_of(found: Calibration, beside: tuple[tuple[str, str], ...] = ()) -> Report:
    """Return the report of a judged calibration, as plain data. ``beside``: words and URLs of pages in its folder."""
    robot = found.fit.robot
    return Report(
        f"Calibration of {robot.urdf.name or robot.urdf.where}",
        sections.verdict(
            found.metrics, found.doubts, [finding.sentence for finding in found.findings], found.shown, found.suggested
        ),
        tuple(section for make in SECTIONS if (section := make(found)) is not None),
        tuple(found.origin.about.items()),
        beside,
    )
