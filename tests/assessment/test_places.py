"""Rows in a few places: learned widths of geometry are judged by places held out, and who has no priors is told."""

from dataclasses import replace

import numpy as np
import pytest

import calib
from calib.assessment.choice import choose_terms
from calib.assessment.places import LearnedWidths, learned_widths, unshown, with_learned_geometry
from calib.assessment.validation import HeldOut, neighbourhoods, row_groups
from calib.presentation.sheets import choice_sheet
from scripts.studies.places import in_cubes
from tests.support import machines
from tests.support.gears import UR10

Array = np.ndarray
ROBOT = machines.load(*UR10)
MODEL = calib.error_model(ROBOT, offsets="all", placements="all")
# An arm of which they win.
TAKEN = 4


def figure(rms: float, p95: float) -> HeldOut:
    return HeldOut(rms, 0.0, p95, 2.0 * p95)


@pytest.mark.parametrize(
    ("rms", "p95", "scatter", "taken"),
    [(0.9, 0.9, 0.7, True), (1.1, 0.9, 0.7, False), (0.9, 1.1, 0.7, False), (0.9, 0.9, 0.9, False)],
)
def test_learned_widths_must_win_in_all_three(rms: float, p95: float, scatter: float, taken: bool) -> None:
    found = LearnedWidths(4, figure(1.0, 2.0), figure(rms, 2.0 * p95), 1e-3, scatter * 1e-3)
    assert found.taken is taken
    assert ("no priors of geometry; with learned" in found.sentence) is not taken
    assert f"{rms:.3f}" in found.sentence
    assert found.record()["taken"] is taken


def test_no_pose_between_places_is_no_win() -> None:
    found = LearnedWidths(4, figure(1.0, 2.0), figure(0.5, 1.0), np.nan, np.nan)
    assert not found.taken
    assert found.record()["scatter_learned"] is None
    assert "scatter" not in found.sentence


def few_cubes(seed: int) -> tuple[calib.Measurements, machines.Machine, Array]:
    """Rows of an arm in cubes of space in each of which the tool keeps its orientation, and readings elsewhere."""
    rng = np.random.default_rng([seed, 9])
    machine = machines.Machine(
        machines.arm(*UR10).moved(rng), machines.anywhere(rng), {"tool": machines.pose((0.05, 0.02, 0.15))}
    )
    data = machine.measure(ROBOT, in_cubes(rng, "cubes"), "position", rng=rng, sigma=5e-4)
    return data, machine, machine.arm.draw(rng, 300)


def judged(data: calib.Measurements, model: calib.ErrorModel = MODEL) -> LearnedWidths | None:
    near = neighbourhoods([data], row_groups([data]))
    assert near.apart
    return learned_widths(model, [data], np.ones(len(data), dtype=bool), near.number)


def test_errors_held_out_are_those_of_fits_without_each_place() -> None:
    data, _, _ = few_cubes(TAKEN)
    found = judged(data)
    assert found is not None
    place = neighbourhoods([data], row_groups([data])).number
    for model, said in ((MODEL, found.without), (with_learned_geometry(MODEL), found.learned)):
        squares = np.empty(len(data))
        for k in range(found.places):
            fit = calib.identify(model, data.subset(place != k))
            rows = data.subset(place == k)
            assert rows.position is not None
            missed = machines.predicted(fit, rows.readings)[:, :3, 3] - rows.position
            squares[place == k] = np.sum(missed**2, axis=1)
        assert said.rms == pytest.approx(np.sqrt(squares.mean()), rel=1e-3)
        assert said.p95 == pytest.approx(np.sqrt(np.quantile(squares, 0.95)), rel=1e-3)


def test_where_they_win_the_choice_takes_them_and_says_so() -> None:
    data, machine, elsewhere = few_cubes(TAKEN)
    choice = choose_terms(MODEL, data, offered=[])
    assert choice.widths is not None
    assert choice.widths.taken
    assert choice.model.priors == calib.Priors("learned", "learned")
    assert choice.geometric.learned
    assert choice.widths.sentence in choice_sheet(choice).caption
    assert machines.miss(choice.fit, machine, elsewhere) < machines.miss(
        calib.identify(MODEL, data), machine, elsewhere
    )


def test_a_stated_prior_is_kept_and_nothing_is_said() -> None:
    data, _, _ = few_cubes(TAKEN)
    stated = replace(MODEL, priors=calib.Priors(angle=1e-3))
    assert judged(data, stated) is None
    assert choose_terms(stated, data, offered=[]).model.priors == stated.priors
    assert unshown(calib.identify(stated, data)) == ()


def test_a_fit_without_priors_to_places_apart_is_not_shown_elsewhere() -> None:
    data, machine, elsewhere = few_cubes(TAKEN)
    (said,) = unshown(calib.identify(MODEL, data))
    number = int(neighbourhoods([data], row_groups([data])).number.max()) + 1
    assert said.startswith(f"The rows lie in {number} places of joint space")
    assert 'error_model.prior = { length = "learned", angle = "learned" }' in said
    anywhere = machine.measure(ROBOT, elsewhere[:60], "position", rng=np.random.default_rng(0), sigma=5e-5)
    assert unshown(calib.identify(MODEL, anywhere)) == ()
    base_alone = calib.error_model(ROBOT)
    assert unshown(calib.identify(base_alone, data)) == ()
