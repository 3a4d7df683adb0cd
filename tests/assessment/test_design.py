"""Optimal designs: criteria against plain formulas, exchanges against exhaustive search, and what must not change."""

import itertools

import numpy as np
import pytest

import calib
from calib.assessment import design
from calib.assessment.candidates import PlannedMeasurement, rows, working_rows
from calib.assessment.design import (
    DesignRows,
    Space,
    choose,
    parts_of,
    random_values,
    sequence,
    space,
    unseen,
    value_of,
)
from calib.foundations import rigid
from calib.foundations.choices import Criterion
from calib.foundations.errors import JobError
from calib.identification.machine import Frames
from tests.support import machines

CRITERIA: tuple[Criterion, ...] = ("D", "A", "I")
Array = np.ndarray


def small(seed: int = 0, n: int = 9, misfit: int = 2) -> tuple[DesignRows, DesignRows]:
    rng = np.random.default_rng(seed)
    candidates = DesignRows(100.0 * rng.standard_normal((n, 2, 4)), 10.0 * rng.standard_normal((n, 2, misfit)))
    return candidates, DesignRows(rng.standard_normal((6, 3, 4)), rng.standard_normal((6, 3, misfit)))


def by_formula(criterion: Criterion, candidates: DesignRows, working: DesignRows, chosen: tuple[int, ...]) -> float:
    """The value by its definition: the covariance of least squares, and the fit of every effect by lstsq."""
    A = candidates.of_parameters[list(chosen)].reshape(-1, 4)
    M = A.T @ A
    if criterion == "D":
        return float(np.log(np.linalg.det(M)))
    if criterion == "A":
        return float(np.trace(np.linalg.inv(M)))
    X = np.linalg.lstsq(A, candidates.of_misfit[list(chosen)].reshape(len(A), -1), rcond=None)[0]
    total = 0.0
    for B, H in zip(working.of_parameters, working.of_misfit, strict=True):
        total += np.trace(B @ np.linalg.inv(M) @ B.T) + np.sum((B @ X - H) ** 2)
    return float(total / len(working.of_parameters))


@pytest.mark.parametrize("criterion", CRITERIA)
def test_values_are_those_of_the_definitions(criterion: Criterion) -> None:
    candidates, working = small()
    s = space(candidates, criterion, working)
    for chosen in ((0, 1, 2), (3, 5, 7, 8)):
        assert value_of(s, chosen) == pytest.approx(by_formula(criterion, candidates, working, chosen), rel=1e-6)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("criterion", CRITERIA)
def test_exchanges_find_the_best_of_all_subsets(criterion: Criterion, seed: int) -> None:
    candidates, working = small(seed)
    s = space(candidates, criterion, working)
    every = [value_of(s, c) for c in itertools.combinations(range(9), 4)]
    found = choose(s, 4, starts=6)
    assert found.converged
    assert found.value == pytest.approx(max(every) if criterion == "D" else min(every), rel=1e-9)
    assert found.value == pytest.approx(value_of(s, found.chosen), rel=1e-12)


@pytest.mark.parametrize("count", [2, 3, 15])
@pytest.mark.parametrize("criterion", CRITERIA)
def test_no_exchange_improves_what_converged(criterion: Criterion, count: int) -> None:
    """Two poses barely determine everything, so that each one that leaves takes nearly all that was known."""
    candidates, working = small(5, n=40)
    s = space(candidates, criterion, working)
    found = choose(s, count, starts=3)
    assert found.converged
    sign = 1.0 if criterion == "D" else -1.0
    for place, new in itertools.product(range(count), set(range(40)) - set(found.chosen)):
        other = sign * value_of(s, (*found.chosen[:place], new, *found.chosen[place + 1 :]))
        assert other <= sign * found.value + 1e-8 * abs(found.value)


@pytest.mark.parametrize("criterion", CRITERIA)
def test_a_sequence_takes_what_brings_most(criterion: Criterion) -> None:
    candidates, working = small(1)
    s = space(candidates, criterion, working)
    order = sequence(s, 6)
    assert len(set(order)) == 6
    sign = 1.0 if criterion == "D" else -1.0
    for k in range(3, 6):
        others = [sign * value_of(s, (*order[:k], c)) for c in range(9) if c not in order[:k]]
        assert sign * value_of(s, order[: k + 1]) == pytest.approx(max(others), rel=1e-9)


@pytest.mark.parametrize("criterion", CRITERIA)
def test_what_is_measured_already_counts(criterion: Criterion) -> None:
    candidates, working = small(2)
    given = DesignRows(candidates.of_parameters[:3], candidates.of_misfit[:3])
    s, alone = space(candidates, criterion, working, given), space(candidates, criterion, working)
    assert value_of(s, (5, 6)) == pytest.approx(value_of(alone, (0, 1, 2, 5, 6)), rel=1e-6)


def test_priors_stand_in_for_poses() -> None:
    candidates, working = small(3, misfit=0)
    prior = np.array([0.01, 0.02, np.inf, 0.05])
    s = space(candidates, "A", working, prior=prior)
    A = candidates.of_parameters[0]
    assert value_of(s, (0,)) == pytest.approx(np.trace(np.linalg.inv(A.T @ A + np.diag(prior**-2.0))), rel=1e-4)
    # What priors alone know is judged too, but nothing that poses see.
    flat = DesignRows.without_misfit(candidates.of_parameters * [1.0, 1.0, 1.0, 0.0])
    known = space(flat, "A", working, prior=prior)
    assert (known.seen, known.V.shape[1]) == (3, 4)


def test_what_no_candidate_sees_remains_when_all_are_measured_without_noise() -> None:
    candidates, working = small(misfit=0)
    # A direction that they cannot see: the first parameter grows as the second shrinks.
    blind = candidates.of_parameters.copy()
    blind[:, :, 1] = blind[:, :, 0]
    prior = np.array([0.5, 0.2, np.inf, np.inf])
    s = space(DesignRows.without_misfit(blind), "I", working, prior=prior)
    flat, B = blind.reshape(-1, 4), working.of_parameters.reshape(-1, 4)
    remains = np.trace(np.linalg.inv(1e4 * flat.T @ flat + np.diag(prior**-2.0)) @ B.T @ B) / 6
    assert unseen(s) == pytest.approx(remains, rel=1e-3)
    assert 0.0 < unseen(s) < value_of(s, range(9))
    # Without such a direction nothing remains.
    assert unseen(space(candidates, "I", working, prior=prior)) == 0.0


def test_the_order_of_candidates_and_unseen_parameters_change_nothing() -> None:
    candidates, working = small(4)
    s = space(candidates, "I", working)
    order = np.random.default_rng(0).permutation(9)
    shuffled = space(DesignRows(candidates.of_parameters[order], candidates.of_misfit[order]), "I", working)
    assert {int(order[c]) for c in choose(shuffled, 4, starts=5).chosen} == set(choose(s, 4, starts=5).chosen)
    # A parameter that is the sum of two others adds nothing that can be seen.
    wider = (
        DesignRows(np.concatenate([r.of_parameters, r.of_parameters[:, :, :1]], axis=2), r.of_misfit)
        for r in (candidates, working)
    )
    doubled = space(next(wider), "I", next(wider))
    assert doubled.seen == s.seen == 4
    assert value_of(doubled, (0, 1, 2, 3)) == pytest.approx(value_of(s, (0, 1, 2, 3)), rel=1e-6)


def test_too_few_candidates_and_unknown_criteria_are_refused() -> None:
    candidates, working = small()
    with pytest.raises(JobError, match="10 poses cannot be chosen from 9 candidates"):
        choose(space(candidates, "D"), 10)
    with pytest.raises(JobError, match="criterion: 'E' is not one of D, A, I"):
        space(candidates, "E", working)  # type: ignore[arg-type]
    with pytest.raises(JobError, match="determine no parameter"):
        space(DesignRows.without_misfit(np.zeros((3, 2, 4))), "D")


# ---- a UR10


def ur10(n: int, misfit: float = 0.0, observes: str = "position") -> tuple[calib.ErrorModel, PlannedMeasurement, Array]:
    name = ("example:ur_description/urdf/ur10_robot.urdf", "tool0")
    robot, rng = machines.load(*name), np.random.default_rng(0)
    frames = Frames(machines.anywhere(rng)[None], rigid.translation(np.array([0.05, 0.02, 0.1]))[None])
    model = calib.error_model(robot, offsets="all", placements="all", tool="pose" if observes == "pose" else "position")
    how = PlannedMeasurement(frames, observes, 0.05e-3, 0.1e-3, misfit)  # type: ignore[arg-type]
    return model, how, machines.arm(*name).draw(rng, n)


def spaced(criterion: Criterion, n: int, misfit: float = 0.0) -> Space:
    model, how, q = ur10(n, misfit)
    return space(rows(model, how, q), criterion, working_rows(model, how, q))


@pytest.mark.parametrize("misfit", [0.0, 0.3e-3])
@pytest.mark.parametrize("criterion", CRITERIA)
def test_thirty_of_three_hundred_beat_random_designs(criterion: Criterion, misfit: float) -> None:
    """Against 500 here; scripts/studies/pose_choice.py takes 10 000."""
    s = spaced(criterion, 300, misfit)
    assert s.seen == 27
    found, random = choose(s, 30), random_values(s, 30, 500)
    assert found.value > random.max() if criterion == "D" else found.value < random.min()


def test_the_forecast_of_an_i_design_is_the_variance_a_fit_then_states() -> None:
    """The mean variance at the working poses, by the covariance of a fit to the chosen poses."""
    model, how, q = ur10(60)
    s = space(rows(model, how, q), "I", working_rows(model, how, q))
    chosen = choose(s, 40).chosen
    tip = how.frames.base @ model.robot.tips(q[list(chosen)]) @ how.frames.tools[0]
    columns = {f"{r.name} [rad]": q[list(chosen), k] for k, r in enumerate(model.robot.readings)}
    columns |= {f"{axis} [m]": tip[:, k, 3] for k, axis in enumerate("xyz")}
    data = calib.read_measurements(columns, model.robot, sigma=how.sigma)
    fit = calib.identify(model, data, model_sigmas=[0.0])
    stated = machines.scatter_of_positions(fit, q)
    assert np.sqrt(np.mean(stated**2)) == pytest.approx(np.sqrt(value_of(s, chosen)), rel=1e-6)
    assert parts_of(s, chosen)[1] == 0.0


def test_effects_left_out_are_harmonics_of_the_readings_of_the_stated_size() -> None:
    model, how, q = ur10(50, misfit=0.3e-3)
    H = working_rows(model, how, q).of_misfit
    assert H.shape == (50, 3, 12)
    assert np.sqrt(np.mean(np.sum(H**2, axis=(1, 2)))) == pytest.approx(0.3e-3)
    # The first column: the tool's motion when the first reading moves by a cosine of itself.
    h = np.zeros(6)
    h[0] = 1e-6
    ends = [(how.frames.base @ model.robot.tips(q + k * h) @ how.frames.tools[0])[:, :3, 3] for k in (1, -1)]
    moved = (ends[0] - ends[1]) / 2e-6 * np.cos(q[:, :1])
    np.testing.assert_allclose(H[:, :, 0] / np.linalg.norm(H[:, :, 0]), moved / np.linalg.norm(moved), atol=1e-8)


def test_poses_bring_six_numbers() -> None:
    model, how, q = ur10(40, 0.3e-3, "pose")
    found = rows(model, how, q)
    assert found.of_parameters.shape == (40, 6, 48)
    assert found.of_misfit.shape == (40, 6, 12)
    assert space(found, "D").seen == 30


@pytest.mark.parametrize("field", ["sigma", "misfit"])
def test_numbers_of_a_setup_are_checked(field: str) -> None:
    frames = Frames(np.eye(4)[None], np.eye(4)[None])
    with pytest.raises(JobError, match=f"{field} is -1"):
        PlannedMeasurement(frames, **{field: -1.0})


@pytest.mark.parametrize("criterion", CRITERIA)
def test_of_very_many_candidates_those_that_bring_little_are_not_looked_at_again(
    criterion: Criterion, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Designs of 22 000 candidates took eight times as long as to calibrate from 11 000 rows."""
    candidates, working = small(1, n=200)
    s = space(candidates, criterion, working)
    every, count = choose(s, 12), 12
    monkeypatch.setattr(design, "_MOST_NUMBERS", 50 * 2**2)
    looked_at: list[int] = []
    of_each = design._Gains.of_each
    monkeypatch.setattr(design._Gains, "of_each", lambda own: looked_at.append(len(own.kept)) or of_each(own))
    some = choose(s, count)
    assert len(set(some.chosen)) == count
    assert some.converged
    # Before all directions are known, and once to find those that bring most.
    assert looked_at.count(200) <= 7
    assert set(looked_at) == {50, 200}
    chance = float(np.median(random_values(s, count, 50)))
    # Both end where no exchange improves them, which is not in one place; a quarter has less to be found in it.
    assert abs(some.value - every.value) < 0.3 * abs(chance - every.value)


def test_large_designs_of_very_many_candidates_are_better_than_chance(monkeypatch: pytest.MonkeyPatch) -> None:
    """What brings most by itself bends a model that leaves something out: of it alone they were worse than chance.

    Of 20 000 poses of an IRB2400, 2000 chosen ones left three times the error of random ones.
    """
    rng = np.random.default_rng(0)
    x = rng.uniform(-1.0, 1.0, (1000, 3))
    # A plane is fitted to what bends: the farther out, the more is told of its slope, and the wrong.
    plane = np.column_stack([np.ones(1000), x])[:, None]
    candidates = DesignRows(100.0 * plane, 100.0 * (x**2)[:, None])
    s = space(candidates, "I", DesignRows(plane, (x**2)[:, None]))
    chance = float(np.median(random_values(s, 80, 50)))
    monkeypatch.setattr(design, "_MOST_NUMBERS", 100)
    for value in (choose(s, 80).value, value_of(s, sequence(s, 80))):
        assert value < chance


def test_large_designs_end_before_all_exchanges_are_tried(monkeypatch: pytest.MonkeyPatch) -> None:
    """Designs of 2000 of 20 000 candidates were exchanged for minutes."""
    candidates, working = small(1, n=200)
    s = space(candidates, "I", working)
    whole = choose(s, 12)
    assert whole.converged
    looked_at: list[int] = []
    of_each = design._Gains.of_each
    monkeypatch.setattr(design._Gains, "of_each", lambda own: looked_at.append(len(own.kept)) or of_each(own))
    monkeypatch.setattr(design, "_MOST_LOOKED_AT", 5 * 200 * 2**2)
    some = choose(s, 12, order=sequence(s, 12))
    assert len(looked_at) == 12 + 5
    assert not some.converged
    assert whole.value <= some.value <= value_of(s, sequence(s, 12))
