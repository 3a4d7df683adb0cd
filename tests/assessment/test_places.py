"""Rows in a few places: who has no priors is told that geometry is not shown elsewhere."""

from dataclasses import replace

import numpy as np

import calib
from calib.assessment.places import unshown
from calib.assessment.validation import neighbourhoods, row_groups
from scripts.studies.places import in_cubes
from tests.support import machines
from tests.support.gears import UR10

Array = np.ndarray
ROBOT = machines.load(*UR10)
MODEL = calib.error_model(ROBOT, offsets="all", placements="all")


def few_cubes(seed: int) -> tuple[calib.Measurements, machines.Machine, Array]:
    """Rows of an arm in cubes of space in each of which the tool keeps its orientation, and readings elsewhere."""
    rng = np.random.default_rng([seed, 9])
    machine = machines.Machine(
        machines.arm(*UR10).moved(rng), machines.anywhere(rng), {"tool": machines.pose((0.05, 0.02, 0.15))}
    )
    data = machine.measure(ROBOT, in_cubes(rng, "cubes"), "position", rng=rng, sigma=5e-4)
    return data, machine, machine.arm.draw(rng, 300)


def test_a_fit_without_priors_to_places_apart_is_not_shown_elsewhere() -> None:
    data, machine, elsewhere = few_cubes(4)
    fit = calib.identify(MODEL, data)
    (said,) = unshown(fit)
    assert said in calib.assess(fit).shown
    number = int(neighbourhoods([data], row_groups([data])).number.max()) + 1
    assert said.startswith(f"The rows lie in {number} places of joint space")
    assert 'error_model.prior = { length = "learned", angle = "learned" }' in said
    anywhere = machine.measure(ROBOT, elsewhere[:60], "position", rng=np.random.default_rng(0), sigma=5e-5)
    assert unshown(calib.identify(MODEL, anywhere)) == ()
    base_alone = calib.error_model(ROBOT)
    assert unshown(calib.identify(base_alone, data)) == ()


def test_a_stated_prior_is_an_answer() -> None:
    data, _, _ = few_cubes(4)
    assert unshown(calib.identify(replace(MODEL, priors=calib.Priors(angle=1e-3)), data)) == ()
