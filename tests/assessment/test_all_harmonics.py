"""All harmonics with learned widths: taken where they predict better, and the short cut is the long way."""

from dataclasses import replace

import numpy as np
import pytest

import calib
from calib.assessment import choice as choice_module
from calib.assessment.all_harmonics import Known, Offer, better
from calib.assessment.choice import Choice, choose_terms
from calib.assessment.entering import Products
from calib.assessment.validation import cross_validate, surely_less
from calib.identification.error_model import with_terms
from calib.presentation.sheets import choice_sheet
from tests.support import machines
from tests.support.gears import UR10, geared

Array = np.ndarray
SIGMA = 5e-5
ORDERS = np.arange(1, 21)


def uneven(rows: int, size: float) -> tuple[calib.ErrorModel, calib.Measurements, machines.Machine]:
    """A UR10 of which three joints err by so many rad in every one of twenty orders."""
    rng, plain = np.random.default_rng([rows, 20]), machines.arm(*UR10)
    sizes = size * rng.normal(size=(6, len(ORDERS))) * (np.arange(6) < 3)[:, None]
    phases = rng.uniform(0.0, 2.0 * np.pi, sizes.shape)

    def extra(u: Array) -> Array:
        return np.asarray(np.sum(sizes * np.cos(ORDERS * u[:, :, None] - phases), axis=2))

    true = machines.Machine(
        geared(plain.moved(rng), extra), machines.anywhere(rng), {"tool": machines.pose((0.05, 0.02, 0.15))}
    )
    robot = machines.load(*UR10)
    data = true.measure(robot, plain.draw(rng, rows), "position", rng=rng, sigma=SIGMA)
    return calib.error_model(robot, offsets="all", placements="all"), data, true


@pytest.fixture(scope="module")
def many() -> tuple[calib.ErrorModel, calib.Measurements, machines.Machine, Choice]:
    model, data, true = uneven(300, 5e-5)
    return model, data, true, choose_terms(model, data)


def test_where_gears_err_in_all_orders_they_are_taken_and_predict_better(
    many: tuple[calib.ErrorModel, calib.Measurements, machines.Machine, Choice],
) -> None:
    model, data, true, choice = many
    assert choice.all_harmonics is not None
    assert choice.all_harmonics.taken
    assert choice.terms == choice.fit.robot.terms == choice.all_harmonics.terms
    assert len(choice.terms) <= len(data) // 2
    assert choice.model.priors.harmonics == "learned"
    assert {term.order for term in choice.terms if term.reading == choice.all_harmonics.readings[0]} >= set(
        range(1, choice.all_harmonics.order + 1)
    )
    chosen = [term for step in choice.steps[1 : choice.taken + 1] if step.added for term in step.added.terms]
    alone = calib.identify(with_terms(model, chosen), data)
    unseen = true.arm.draw(np.random.default_rng(0), 400)
    assert machines.miss(choice.fit, true, unseen) < 0.95 * machines.miss(alone, true, unseen)
    sheet = choice_sheet(choice)
    assert sheet.rows[-1].cells[-1] == "yes"
    assert sheet.rows[-1].cells[1] == f"all harmonics up to {choice.all_harmonics.order}"


def test_their_linear_figures_are_those_of_fits(
    many: tuple[calib.ErrorModel, calib.Measurements, machines.Machine, Choice],
) -> None:
    """The linear folds choose for themselves, the fits take what all rows have chosen."""
    _, data, _, choice = many
    assert choice.all_harmonics is not None
    full = cross_validate(choice.model, data)
    assert choice.all_harmonics.rms == pytest.approx(full.figure().rms, rel=0.1)


def test_they_are_not_offered_where_a_prior_is_stated_or_candidates_are(
    many: tuple[calib.ErrorModel, calib.Measurements, machines.Machine, Choice],
) -> None:
    model, data, _, _ = many
    offered = choice_module.candidates(model.robot)[:20]
    assert choose_terms(model, data, offered=offered).all_harmonics is None
    assert choose_terms(replace(model, priors=calib.Priors(harmonics=1e-4)), data).all_harmonics is None


def test_where_a_fit_with_them_does_not_converge_steps_are_taken(
    many: tuple[calib.ErrorModel, calib.Measurements, machines.Machine, Choice], monkeypatch: pytest.MonkeyPatch
) -> None:
    model, data, _, choice = many
    identify_near = choice_module.identify_near

    def stubborn(begun: calib.Fit, model: calib.ErrorModel, *given: object, **options: object) -> calib.Fit:
        fit = identify_near(begun, model, *given, **options)  # type: ignore[arg-type]
        return replace(fit, converged=model.priors.harmonics != "learned")

    monkeypatch.setattr(choice_module, "identify_near", stubborn)
    less = choose_terms(model, data, geometric=choice.geometric)
    assert less.all_harmonics is not None
    assert not less.all_harmonics.taken
    assert (less.taken, less.taken_back) == (choice.taken, 0)
    assert less.terms == less.fit.robot.terms
    assert sum(less.steps_taken) == less.taken + 1
    assert choice_sheet(less).rows[-1].cells[-1] == "no"


def test_of_few_rows_nothing_is_offered_that_they_could_not_teach() -> None:
    model, data, _ = uneven(40, 5e-5)
    choice = choose_terms(model, data)
    assert choice.all_harmonics is None or not choice.all_harmonics.taken
    assert len(choice.terms) <= 20


def linear(rng: np.random.Generator) -> tuple[Known, Products, Array, Array, Array]:
    """Rows of three columns of geometry, and of two readings with harmonics of four orders; one shows nothing."""
    rows, fold = rng.normal(size=(120, 2, 20)), rng.integers(0, 5, 120)
    rows[:, :, 11:19] *= 1e-3
    rows[:, :, 19] = rows[:, :, 3:11] @ rng.normal(size=8) + rng.normal(size=(120, 2))
    products = np.diag(np.append(np.full(19, 1e-4), 0.0))
    harmonics = np.arange(3, 19).reshape(2, 4, 2)
    known = Known(products, np.where(np.arange(19) < 3, 0.0, 1e-4), np.arange(3), 0.1, fixed=False)
    return known, Products([(fold, rows, None)], 5, 0, 20, harmonics.reshape(-1, 2)), rows, fold, harmonics


def test_widths_that_begin_elsewhere_end_at_the_same_place() -> None:
    known, products, _, _, harmonics = linear(np.random.default_rng(1))
    none = np.zeros(0, dtype=np.intp)
    found = [Offer.of(known, harmonics, products, none, 8, begin) for begin in ((), (0.02, 1.0))]
    assert found[0] is not None
    assert found[1] is not None
    np.testing.assert_allclose(found[1].start.widths, found[0].start.widths, rtol=1e-3)


def test_without_a_fold_they_are_what_its_rows_left_out_would_find() -> None:
    known, products, rows, fold, harmonics = linear(np.random.default_rng(1))
    offer = Offer.of(known, harmonics, products, np.zeros(0, dtype=np.intp), 8)
    assert offer is not None
    assert offer.kept.tolist() == [0]
    assert offer.order == 4
    none = [np.zeros(0, dtype=np.intp)] * 5
    found = offer.values(products, none)
    for k in range(5):
        left = rows[fold != k]
        alone = Products([(np.zeros(len(left), dtype=np.intp), left, None)], 1, 0, 20, harmonics.reshape(-1, 2))
        own = Offer.of(known, harmonics, alone, none[0], 8)
        assert own is not None
        J, r = left.reshape(-1, 20)[:, :11], left.reshape(-1, 20)[:, 19]
        hold = np.append(np.full(3, 1e-4), np.full(8, own.start.widths[0] ** -2.0))
        left_noise = own.start.factors[0] ** 2
        expected = -np.linalg.solve(J.T @ J / left_noise + np.diag(hold), J.T @ r / left_noise)
        np.testing.assert_allclose(found[k, :11], expected, rtol=2e-3, atol=2e-3)
        assert not found[k, 11:].any()


def test_no_more_are_offered_than_are_allowed_beside_what_is_chosen() -> None:
    known, products, _, _, harmonics = linear(np.random.default_rng(2))
    chosen = np.array([9, 10])
    offer = Offer.of(known, harmonics, products, chosen, 6)
    assert offer is not None
    assert offer.order == 2
    assert offer.columns(chosen).tolist() == [3, 4, 5, 6, 9, 10]
    assert Offer.of(known, harmonics, products, chosen, 1) is None


def test_they_must_be_better_by_two_standard_errors_and_harm_no_quantile() -> None:
    rng = np.random.default_rng(0)
    group, before = np.repeat(np.arange(50), 4), rng.chisquare(3, 200)
    assert surely_less(0.9 * before, before, group)
    assert not surely_less(before, before, group)
    assert not surely_less(before + rng.normal(scale=0.5, size=200), before, group)
    assert better(0.9 * before, before, group)
    harmed = 0.5 * before
    harmed[0] = 4.0 * before.max()
    assert surely_less(harmed, before, group)
    assert not better(harmed, before, group)
