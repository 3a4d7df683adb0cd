"""A column that is there and unused is tried, and named where held-out rows get better by it."""

from dataclasses import replace

import numpy as np

import calib
from calib.assessment.suggestions import suggestions
from calib.results.report import report_of
from calib.robot.conditions import Conditions
from tests.support import machines

UR5 = ("example:ur_description/urdf/ur5_robot.urdf", "tool0")


def session(per_kelvin: float, scale: float = 0.0, rows: int = 60) -> tuple[calib.Fit, calib.Measurements]:
    """A fit and rows held out of it; the zero of the elbow wanders with a temperature that the rows tell.

    ``scale``: by so much more than it reads does the elbow turn.
    """
    rng = np.random.default_rng(3)
    robot = calib.load_robot(*UR5)
    true = machines.arm(*UR5).moved(rng)
    machine = machines.Machine(true, machines.anywhere(rng), {"tool": machines.pose((0.05, 0.02, 0.15))})
    sets = []
    for n in (rows, 40):
        q, temperature = rng.uniform(-2.0, 2.0, (n, 6)), rng.uniform(15.0, 40.0, n)
        warm = q + (per_kelvin * (temperature - 20.0)[:, None] + scale * q) * np.eye(6)[2]
        data = machine.measure(robot, warm, rng=rng, sigma=2e-5)
        sets.append(replace(data, readings=q, conditions=Conditions(temperature=temperature)))
    return calib.identify(calib.error_model(robot, offsets="all", placements="all"), sets[0]), sets[1]


def test_a_temperature_that_nobody_used_is_named() -> None:
    fit, held_out = session(2e-5)
    (said,) = suggestions(fit, [held_out])
    assert said.startswith('The temperature: error_model.thermal = "all" makes the held-out position error ')
    assert said.endswith(' % smaller; terms = "auto" chooses among all kinds.')
    assert suggestions(fit, []) == ()
    # What took long to fit would take as long once more for every kind that is tried.
    assert suggestions(replace(fit, evaluations=61), [held_out]) == ()


def test_of_very_many_rows_some_are_looked_at() -> None:
    fit, held_out = session(2e-5, rows=1100)
    (said,) = suggestions(fit, [held_out])
    assert said.startswith("The temperature: ")


def test_where_the_fit_is_doubted_it_is_told_after_the_doubts() -> None:
    found = calib.assess(*session(2e-5))
    found = replace(found, suggested=("The temperature: ...",))
    trusted, doubted = (report_of(replace(found, doubts=doubts)).verdict for doubts in ((), ("it jumped.",)))
    assert trusted.trusted and trusted.reasons[-1].endswith(" The temperature: ...")
    assert doubted.reasons == ("Not to be trusted: it jumped.", "The temperature: ...")


def test_a_joint_that_moves_more_than_it_reads_is_named() -> None:
    """As the axes of a gantry do, whose scales are never of one length."""
    fit, held_out = session(0.0, 1e-3)
    (said,) = suggestions(fit, [held_out])
    assert said.startswith(
        'Joints that move by more or less than they read: error_model.gain = "all" makes the held-out '
    )


def test_what_does_not_help_is_not_named() -> None:
    assert suggestions(session(0.0)[0], [session(0.0)[1]]) == ()
