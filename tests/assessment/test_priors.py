"""A stated prior that the data contradict is a doubt; one that is right is none."""

from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

import calib
from calib.assessment.influence import Residue
from calib.assessment.priors import contradicted
from calib.assessment.stretches import stretches
from calib.identification.parameters import Parameter
from calib.identification.set_ups import SetUp
from calib.measurement.checks import Finding
from tests.support import machines

UR5 = ("example:ur_description/urdf/ur5_robot.urdf", "tool0")
LENGTH, ANGLE = 0.5e-3, 1e-3


def said_of(fit: calib.Fit) -> list[Finding]:
    return contradicted(fit, stretches(Residue.of(fit, {})))


def session(
    seed: int, wider: float = 1.0, base_off: float | None = None, sigma: float = 1e-4, within: float = 2.0
) -> calib.Fit:
    """A fit under a prior that is right, or ``wider`` times narrower than the truth, which independent code draws.

    ``base_off``: the base stood so many of its own stated deviations from where it is said to have stood.
    """
    rng = np.random.default_rng(seed)
    robot = calib.load_robot(*UR5)
    true = machines.arm(*UR5).moved(rng, length=LENGTH * wider, angle=ANGLE * wider, zero=ANGLE * wider)
    base = machines.anywhere(rng)
    machine = machines.Machine(true, base, {"tool": machines.pose((0.05, 0.02, 0.15))})
    data = machine.measure(robot, rng.uniform(-within, within, (60, 6)), rng=rng, sigma=sigma)
    model = calib.error_model(robot, offsets="all", placements="all", priors=calib.Priors(LENGTH, ANGLE))
    if base_off is not None:
        stated = base @ machines.pose((base_off * LENGTH, 0.0, 0.0))
        model = replace(model, setups={data.setups[0]: SetUp(stated, LENGTH, ANGLE)})
    return calib.identify(model, data)


@pytest.mark.parametrize("seed", range(8))
def test_a_prior_that_is_right_is_not_contradicted(seed: int) -> None:
    assert said_of(session(seed, base_off=1.0, sigma=(1e-5, 1e-4, 3e-4)[seed % 3])) == []


@pytest.mark.parametrize("seed", range(3))
def test_arms_that_are_worse_than_stated_are_doubted_where_few_rows_tell(seed: int) -> None:
    fit = session(seed, wider=4.0, sigma=3e-4, within=0.3)
    (said,) = said_of(fit)
    assert "s of the arm (" in said.sentence and ") is not what the data say: they show them " in said.sentence
    assert any(said.sentence in doubt for doubt in calib.assess(fit).doubts)


def test_where_data_tell_all_that_matters_it_is_said_and_no_doubt() -> None:
    fit = session(0, wider=4.0, sigma=1e-5)
    (said,) = said_of(fit)
    assert said.code == "prior-too-narrow" and "; predictions hardly depend on it, but " in said.sentence
    found = calib.assess(fit)
    assert not any("The prior" in doubt for doubt in found.doubts)
    assert said.sentence in found.shown


def test_what_is_most_off_is_named() -> None:
    rng = np.random.default_rng(1)
    robot = calib.load_robot(*UR5)
    true = machines.arm(*UR5)
    origins = np.zeros((len(true.joints), 6))
    names = [joint.driver for joint in true.joints]
    origins[names.index("wrist_1_joint"), 0] = 8e-3
    machine = machines.Machine(true.with_errors(origins, {}), machines.anywhere(rng), {"tool": np.eye(4)})
    data = machine.measure(robot, rng.uniform(-2.0, 2.0, (60, 6)), rng=rng, sigma=1e-4)
    fit = calib.identify(
        calib.error_model(robot, offsets="all", placements="all", priors=calib.Priors(LENGTH, ANGLE)), data
    )
    (found,) = said_of(fit)
    assert "wrist_1_joint.ty most, by +8.0" in found.sentence


def test_a_base_that_stood_elsewhere_than_stated_is_named() -> None:
    """Base and first joint are one to the data: both are named."""
    (found,) = said_of(session(2, base_off=15.0))
    assert found.sentence.startswith("The prior of lengths of the arm (0.5 mm) is not what the data say: ")
    assert found.sentence.endswith(" The same seems true of lengths of the base, perhaps by that alone.")


def test_learned_priors_are_as_wide_as_the_data_say() -> None:
    fit = session(0, wider=5.0)
    model = replace(fit.model, priors=calib.Priors("learned", "learned"))
    assert said_of(calib.identify(model, fit.measurements)) == []


def test_a_prior_that_is_made_as_wide_as_it_says_is_right() -> None:
    fit = session(1, wider=5.0)
    wide = replace(fit.model, priors=calib.Priors(5.0 * LENGTH, 5.0 * ANGLE))
    assert said_of(calib.identify(wide, fit.measurements)) == []


def test_priors_that_keep_the_search_from_the_arm_are_the_cause_of_what_is_left() -> None:
    """Twenty times as far off as stated, the fit ends where 24 mm are left, and nothing but the priors explains it."""
    fit = session(2, wider=20.0, sigma=2.3e-4)
    assert fit.noise[0].model > 10e-3
    found = calib.assess(fit)
    (cause,) = (check for check in found.checks if check.name == "cause")
    assert not cause.passed and "where " in cause.sentence
    assert cause.sentence.startswith(
        "What is left is explained if the arm is farther from its URDF than error_model.prior"
    )
    free = replace(fit.model, priors=calib.Priors())
    assert calib.identify(free, fit.measurements).noise[0].model < 1e-4


@pytest.mark.parametrize("held_out", [False, True])
def test_a_prior_that_leaves_more_than_the_instrument_has_is_no_noise(held_out: bool) -> None:
    """Angles were stated a hundred times too well: six sigmas were left, taken for noise, and the fit was trusted."""
    fit = session(0, wider=1.0)
    (data,) = fit.measurements
    rows = np.arange(len(data))
    rest = [data.subset(rows[40:])] if held_out else []
    model = replace(fit.model, priors=calib.Priors(angle=ANGLE / 100.0))
    found = calib.assess(calib.identify(model, data.subset(rows[:40])), rest)
    assert [check.name for check in found.checks if not check.passed] == ["cause"]
    assert "if the arm is farther from its URDF than error_model.prior lets it be" in found.doubts[0]


@pytest.mark.parametrize("rows", [25, 60])
def test_priors_that_are_right_are_no_cause_where_sigma_is_too_small(rows: int) -> None:
    """Residuals of ten stated sigmas, of which the priors leave none."""
    fit = session(1, sigma=1e-3)
    (data,) = fit.measurements
    data = replace(data.subset(np.arange(rows)), sigma=np.full((rows, 3), 1e-4))
    found = calib.assess(calib.identify(fit.model, data))
    assert not any(check.name == "cause" and not check.passed for check in found.checks)


def test_priors_that_are_right_are_no_cause_of_a_jump() -> None:
    fit = session(0, sigma=1e-4)
    (data,) = fit.measurements
    assert data.position is not None
    moved = np.where(np.arange(len(data))[:, None] > 30, [4e-3, 0.0, 0.0], 0.0)
    found = calib.assess(calib.identify(fit.model, replace(data, position=data.position + moved)))
    assert any("seems to have changed" in doubt for doubt in found.doubts)
    assert not any("error_model.prior" in doubt for doubt in found.doubts)


def test_of_a_base_among_many_set_ups_it_is_said() -> None:
    """What hardly is noise is known well, however few numbers tell the noise."""
    rng = np.random.default_rng(0)
    robot = calib.load_robot(*UR5)
    true = machines.arm(*UR5).moved(rng)
    sets, setups = [], {}
    for k in range(6):
        base = machines.anywhere(rng)
        machine = machines.Machine(true, base, {"tool": machines.pose((0.05, 0.02, 0.15))})
        data = machine.measure(robot, rng.uniform(-2.0, 2.0, (6, 6)), rng=rng, sigma=2e-5)
        sets.append(replace(data, setups=(f"s{k}",), where=f"{k}.csv"))
        setups[f"s{k}"] = SetUp(base @ machines.pose((0.03 * (k == 4), 0.0, 0.0)), 2e-3, 2e-3)
    model = calib.error_model(robot, offsets="all", placements="all", known=calib.Known(setups=setups))
    (found,) = said_of(calib.identify(model, sets))
    assert found.sentence.startswith("The prior of lengths of base.s4 (2 mm) is not what the data say: ")


@pytest.mark.parametrize(
    ("sigma", "so"), [(1e-3, "lens.k1 is found -0.49 +- 0.001 from "), (np.nan, "lens.k1 is found -0.49 from what is ")]
)
def test_a_number_of_a_lens_that_is_not_identifiable_is_told_without_a_sigma(sigma: float, so: str) -> None:
    """One of a lens that is stated wrongly, such as an fy of 100000 px, beside which nothing shows k1."""
    k1 = Parameter("lens.k1", "number", "instrument", (), prior=0.05, centre=-0.09)
    fit = SimpleNamespace(parameters=(k1,), values=np.array([-0.58]), sigmas=np.array([sigma]))
    (finding,) = contradicted(cast("calib.Fit", fit), ())
    assert finding.sentence.startswith(so)
