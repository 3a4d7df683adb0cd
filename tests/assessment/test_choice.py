"""The choice of joint terms: what is there is found, what is not there is not, and the short cut is the long way."""

import sys
import time
from dataclasses import replace

import numpy as np
import pytest

import calib
from calib.assessment import choice as choice_module
from calib.assessment import linearised
from calib.assessment.choice import _spent, candidates, choose_terms
from calib.assessment.linearised import Candidate, LinearisedSystem
from calib.assessment.validation import cross_validate
from calib.foundations.chance import bound
from calib.foundations.errors import IdentificationError
from calib.identification.arrow import Split
from calib.identification.error_model import with_terms
from calib.identification.system import Problem
from calib.presentation.sheets import choice_sheet
from calib.robot.terms.harmonic import OFFERED, harmonic
from calib.robot.urdf import parse_urdf
from tests.support import machines, touching
from tests.support.gears import UR10, geared
from tests.support.loops import four_bar_urdf

Array = np.ndarray
SIGMA = 5e-5
PANDA = ("example:panda_description/urdf/panda.urdf", "panda_link8")


def measured(
    seed: int, n: int, waves: dict[tuple[int, int], float], observes: str = "position"
) -> tuple[calib.ErrorModel, calib.Measurements, machines.Machine]:
    """A UR10; ``waves``: amplitude in rad by joint and order, the phase anywhere."""
    rng = np.random.default_rng([seed, 77])
    robot, plain = machines.load(*UR10), machines.arm(*UR10)
    phases = rng.uniform(0.0, 2.0 * np.pi, len(waves))

    def extra(u: Array) -> Array:
        found = np.zeros_like(u)
        for phase, ((joint, order), amplitude) in zip(phases, waves.items(), strict=True):
            found[:, joint] += amplitude * np.cos(order * u[:, joint] - phase)
        return found

    arm = geared(plain.moved(rng), extra)
    true = machines.Machine(arm, machines.anywhere(rng), {"tool": machines.pose((0.05, 0.02, 0.15))})
    data = true.measure(robot, plain.draw(rng, n), observes, rng=rng, sigma=SIGMA, sigma_angle=SIGMA)
    tool = "pose" if observes == "pose" else "position"
    return calib.error_model(robot, offsets="all", placements="all", tool=tool), data, true


@pytest.mark.parametrize(("n", "observes"), [(60, "position"), (150, "position"), (60, "pose")])
def test_a_machine_without_terms_is_given_none(n: int, observes: str) -> None:
    """At least 95 of 100 are asked for; scripts/studies/ur10_terms.py counts."""
    for seed in range(4):
        model, data, _ = measured(seed, n, {}, observes)
        choice = choose_terms(model, data)
        assert choice.taken == 0
        assert choice.terms == ()
        assert choice.model.parameters() == model.parameters()


def many_small_waves(seed: int) -> dict[tuple[int, int], float]:
    rng = np.random.default_rng([seed, 5])
    return {(joint, order): float(10 ** rng.uniform(-4.6, -3.7)) for joint in range(6) for order in range(1, 9)}


def inside(fit: calib.Fit, true: machines.Machine) -> float:
    """The share of 300 true positions that are in their 95 % regions."""
    readings = true.arm.draw(np.random.default_rng(1), 300)
    told = calib.judging.tool_uncertainty(calib.machine_of(fit), readings)
    off = (machines.predicted(fit, readings) - true.see(readings))[:, :3, 3]
    squares = np.einsum("ni,ni->n", off, np.linalg.solve(told.covariance[:, :3, :3], off[:, :, None])[..., 0])
    return float(np.mean(squares <= bound(0.95, 3, told.degrees_of_freedom)))


def test_what_a_choice_has_spent_is_in_the_noise_and_regions_hold() -> None:
    """scripts/studies/chosen_regions.py has more of them."""
    held, before = [], []
    for seed in range(6):
        model, data, true = measured(seed, 100, many_small_waves(seed))
        choice = choose_terms(model, data)
        assert len(choice.terms) > 10
        plain = calib.identify(choice.model, data)
        again = calib.identify(choice.model, data, spent=choice.spent or None)
        np.testing.assert_allclose(again.noise[0].total, choice.fit.noise[0].total, rtol=1e-3)
        held.append(inside(choice.fit, true))
        before.append(inside(plain, true))
    assert np.mean(held) > 0.93
    assert np.mean(before) < 0.91


def test_terms_that_nobody_had_to_search_for_spend_little() -> None:
    waves = {(0, 5): 3e-4, (1, 3): 3e-4, (2, 7): 3e-4, (3, 4): 3e-4}
    model, data, _ = measured(1, 250, waves)
    choice = choose_terms(model, data)
    assert choice.terms
    assert sum(choice.spent) < 0.05 * len(data) * 3


def test_a_choice_spends_none_of_what_is_measured_again_at_a_pose() -> None:
    """Of few poses, each measured again, half of what tells of the noise alone was counted as spent."""
    model, once, true = measured(4, 22, {(0, 2): 4e-4, (2, 1): 5e-4})
    again = np.repeat(once.readings, 4, axis=0)
    seen = true.see(again)[:, :3, 3] + np.random.default_rng(4).normal(scale=SIGMA, size=(88, 3))
    names = [f"{reading.name}_rad" for reading in model.robot.readings]
    columns = dict(zip([*names, "x_m", "y_m", "z_m"], np.column_stack([again, seen]).T, strict=True))
    choice = choose_terms(model, calib.read_measurements(columns, model.robot, sigma=SIGMA))
    foretold = tuple(3.0 * one for one in choice.steps[choice.taken].optimism)
    steps = [replace(step, optimism=foretold) if k == choice.taken else step for k, step in enumerate(choice.steps)]
    (spent,) = _spent(replace(choice, steps=tuple(steps)), choice.fit, 10)
    assert 0.0 < spent < choice.fit.noise[0].degrees_of_freedom - 66 * 3


@pytest.mark.parametrize("observes", ["position", "pose"])
def test_rows_without_noise_are_chosen_from_as_well(observes: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys.modules[__name__], "SIGMA", 0.0)
    model, data, true = measured(3, 80, {(0, 5): 2e-4, (1, 3): 2e-4, (2, 7): 2e-4, (3, 4): 3e-4}, observes)
    choice = choose_terms(model, data)
    assert machines.miss(choice.fit, true, true.arm.draw(np.random.default_rng(0), 100)) < 1e-6
    assert not any(choice.spent)


def test_what_is_there_is_found_and_little_else() -> None:
    waves = {(0, 5): 2e-4, (1, 3): 2e-4, (2, 7): 2e-4, (3, 4): 3e-4}
    model, data, true = measured(1, 250, waves)
    choice = choose_terms(model, data)
    joints = [reading.name for reading in model.robot.readings]
    there = {term for joint, order in waves for term in harmonic(joints[joint], order)}
    assert there <= set(choice.terms)
    assert len(choice.terms) <= len(there) + 4
    unseen = true.arm.draw(np.random.default_rng(0), 400)
    chosen, plain = calib.identify(choice.model, data), choice.geometric
    assert machines.miss(chosen, true, unseen) < 0.3 * machines.miss(plain, true, unseen)


def test_a_pose_that_was_visited_twice_does_not_help_itself() -> None:
    """Every row three times, noise and all: taken for new poses they would praise whatever fits their noise."""
    model, data, _ = measured(3, 40, {})
    thrice = data.subset(np.tile(np.arange(len(data)), 3))
    assert choose_terms(model, thrice).taken == 0
    named = choose_terms(model, thrice).steps[0].held_out
    assert named.standard_error > 1.3 * choose_terms(model, measured(3, 120, {})[1]).steps[0].held_out.standard_error


@pytest.mark.parametrize("observes", ["position", "pose"])
def test_the_linear_figures_are_those_of_fits(observes: str) -> None:
    """One candidate enters, so that both know what was fitted in every fold."""
    model, data, _ = measured(4, 120, {(1, 3): 3e-4}, observes)
    joint = model.robot.readings[1].name
    choice = choose_terms(model, data, offered=[Candidate(harmonic(joint, 3))])
    for step, terms in zip(choice.steps, ((), harmonic(joint, 3)), strict=True):
        full = cross_validate(with_terms(model, terms), data)
        assert step.rms["position"] == pytest.approx(full.figure().rms, rel=2e-3)
        if observes == "pose":
            assert step.rms["orientation"] == pytest.approx(full.figure("orientation").rms, rel=2e-3)
    assert list(choice.steps[0].rms) == (["position", "orientation"] if observes == "pose" else ["position"])
    assert choice.taken == 1


def test_widths_are_learned_by_geometry_before_and_by_the_chosen_terms_after() -> None:
    model, data, _ = measured(5, 60, {(1, 3): 3e-4, (1, 6): 3e-4})
    learning = replace(model, priors=calib.Priors("learned", "learned", "learned"))
    offered = [Candidate(harmonic(model.robot.readings[1].name, k)) for k in (3, 6)]
    choice = choose_terms(learning, data, offered=offered)
    assert {prior.group for prior in choice.geometric.learned} >= {"link translations", "link rotations"}
    assert choice.taken == 2
    (waves,) = [prior for prior in calib.identify(choice.model, data).learned if prior.group.startswith("harmonics")]
    assert (waves.parameters, waves.outcome) == (4, "learned")
    assert 1e-4 < waves.width < 6e-4


def test_neither_the_order_of_rows_nor_the_frame_moves_the_choice() -> None:
    model, data, _ = measured(5, 120, {(1, 3): 2e-4, (2, 6): 2e-4})
    choice = choose_terms(model, data)
    again = choose_terms(model, data.subset(np.random.default_rng(0).permutation(len(data))))
    assert again.terms == choice.terms
    figures = [[step.held_out.rms for step in one.steps] for one in (choice, again)]
    np.testing.assert_allclose(*figures, rtol=1e-6)


def test_of_very_many_rows_some_are_looked_at_whatever_their_order(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(choice_module, "_ENOUGH_ROWS", 180)
    model, data, _ = measured(5, 200, {(1, 3): 3e-4, (2, 6): 3e-4})
    twice = data.subset(np.tile(np.arange(len(data)), 2))
    choice = choose_terms(model, twice)
    # Rather another pose than another visit.
    assert choice.rows == 180
    assert len(choice.geometric.measurements[0]) == 400
    joints = [reading.name for reading in model.robot.readings]
    assert {*harmonic(joints[1], 3), *harmonic(joints[2], 6)} <= set(choice.terms)
    assert "; by 180 of 400 rows, taken at random" in choice_sheet(choice).caption
    again = choose_terms(model, twice.subset(np.random.default_rng(0).permutation(len(twice))))
    assert again.terms == choice.terms
    figures = [[step.held_out.rms for step in one.steps] for one in (choice, again)]
    np.testing.assert_allclose(*figures, rtol=1e-6)


def test_of_few_large_groups_all_are_looked_at(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(choice_module, "_ENOUGH_ROWS", 40)
    model, data, _ = measured(7, 60, {})
    assert choose_terms(model, replace(data, group=tuple(f"g{k % 4}" for k in range(60)))).rows == 40


def cubes(
    seed: int, places: int, rows: int, waves: dict[tuple[int, int], float]
) -> tuple[calib.Measurements, Array, machines.Machine]:
    """Rows of a UR10 in a few small cubes of joint space, and readings in others."""
    _, _, true = measured(seed, 5, waves)
    rng = np.random.default_rng([seed, 78])

    def somewhere(number: int) -> Array:
        return np.concatenate([c + rng.uniform(-0.2, 0.2, (rows, 6)) for c in rng.uniform(-2.5, 2.5, (number, 6))])

    robot = machines.load(*UR10)
    return true.measure(robot, somewhere(places), "position", rng=rng, sigma=SIGMA), somewhere(12), true


@pytest.mark.parametrize(("seed", "places"), [(17, 4), (18, 5), (19, 7)])
def test_in_cubes_that_were_not_measured_terms_do_not_harm(seed: int, places: int) -> None:
    """scripts/studies/clusters.py counts over a hundred."""
    data, elsewhere, true = cubes(seed, places, 40, {(1, 2): 2e-4, (2, 5): 2e-4, (3, 11): 2e-4})
    choice = choose_terms(calib.error_model(machines.load(*UR10), offsets="all", placements="all"), data)

    def p95(fit: calib.Fit) -> float:
        missed = machines.predicted(fit, elsewhere)[:, :3, 3] - true.see(elsewhere)[:, :3, 3]
        return float(np.quantile(np.linalg.norm(missed, axis=1), 0.95))

    assert p95(choice.fit) <= p95(choice.geometric)
    assert choice.taken == 0 or choice.model.priors.harmonics == "learned"
    away = [step.away for step in choice.steps[: choice.taken + 1]]
    assert all(figure is not None for figure in away) or choice.taken == 0


def test_a_prior_that_is_stated_stays_in_places_apart() -> None:
    data, _, _ = cubes(17, 5, 40, {(1, 2): 2e-4, (2, 5): 2e-4})
    model = calib.error_model(machines.load(*UR10), offsets="all", placements="all")
    choice = choose_terms(replace(model, priors=calib.Priors(harmonics=1e-4)), data)
    assert choice.taken
    assert choice.model.priors.harmonics == 1e-4
    assert {p.prior for p in choice.fit.parameters if p.name.endswith(("cos_2", "sin_2"))} == {1e-4}


def judged_between(monkeypatch: pytest.MonkeyPatch) -> list[tuple[Array, Array]]:
    """Poses at which choices from now on compare scatters, and what they find there."""
    found: list[tuple[Array, Array]] = []
    scatter = LinearisedSystem.scatter

    def told(system: LinearisedSystem, poses: Array, whole: Array, without: Array) -> Array:
        found.append((poses, scatter(system, poses, whole, without)))
        return found[-1][1]

    monkeypatch.setattr(LinearisedSystem, "scatter", told)
    return found


def test_scatter_between_places_is_that_of_fits_without_each_of_them(monkeypatch: pytest.MonkeyPatch) -> None:
    told = judged_between(monkeypatch)
    data, _, _ = cubes(17, 5, 40, {(1, 2): 2e-4, (2, 5): 2e-4})
    monkeypatch.setattr(choice_module, "_SHOWS", 0.0)
    model, place = calib.error_model(machines.load(*UR10), offsets="all", placements="all"), np.repeat(range(5), 40)
    choose_terms(model, data)
    ((poses, found),) = told

    def tips(rows: calib.Measurements) -> Array:
        return machines.predicted(calib.identify(model, rows), poses)[:, :3, 3]

    change = np.array([tips(data.subset(place != k)) for k in range(5)]) - tips(data)
    expected = np.sqrt(4.0 / 5.0 * np.mean(np.sum(change**2, axis=(0, 2))))
    assert found[0] == pytest.approx(expected, rel=0.05)
    assert len(found) > 1


def test_what_hardly_shows_is_taken_only_where_it_steadies_predictions(monkeypatch: pytest.MonkeyPatch) -> None:
    """In cubes: a wave that is larger than the noise says enough by itself, a smaller one does not."""
    told = judged_between(monkeypatch)
    model = calib.error_model(machines.load(*UR10), offsets="all", placements="all")
    loud, quiet, faint = (cubes(17, 5, 40, {(1, 5): size})[0] for size in (4e-4, 7e-5, 5e-5))
    assert choose_terms(model, loud).taken == 1
    assert not told
    for data, taken in ((quiet, 1), (faint, 0)):
        choice = choose_terms(model, data)
        _, scatter = told.pop()
        assert choice.steps[1].held_out.rms > 0.87 * choice.steps[0].held_out.rms
        assert (scatter[1] < 0.8 * scatter[0]) == taken == choice.taken


def test_a_fit_that_does_not_converge_is_taken_back(monkeypatch: pytest.MonkeyPatch) -> None:
    model, data, _ = measured(1, 150, {(0, 5): 2e-4, (1, 3): 2e-4, (2, 7): 2e-4, (3, 4): 3e-4})
    whole = choose_terms(model, data)
    assert whole.taken >= 4
    assert whole.taken_back == 0
    identify, most = choice_module.identify_near, 2 * (whole.taken // 2)

    def stubborn(near: calib.Fit, model: calib.ErrorModel, *given: object, **options: object) -> calib.Fit:
        fit = identify(near, model, *given, **options)  # type: ignore[arg-type]
        return replace(fit, converged=len(model.terms) <= most)

    monkeypatch.setattr(choice_module, "identify_near", stubborn)
    less = choose_terms(model, data)
    assert (less.taken, less.taken_back) == (whole.taken // 2, whole.taken - whole.taken // 2)
    assert less.fit.model.terms == less.model.terms
    assert len(less.terms) < len(whole.terms)


def test_the_records_tell_every_step() -> None:
    model, data, _ = measured(6, 80, {(1, 3): 3e-4})
    choice = choose_terms(replace(model, priors=calib.Priors(harmonics=1e-4)), data)
    records = choice.records()
    assert choice.offered == len(candidates(model.robot)) == 6 * (3 + len(OFFERED))
    assert len(records) == len(choice.steps) <= 1 + choice.offered
    assert [record["taken"] for record in records] == [k <= choice.taken for k in range(len(records))]
    assert records[0]["added"] == []
    assert {name for record in records for name in record["added"]} <= {
        term.name for candidate in candidates(model.robot) for term in candidate.terms
    }
    priors = {p.prior for p in choice.model.parameters() if p.kind == "term" and not p.name.endswith("gain")}
    assert priors == {1e-4}


@pytest.mark.parametrize("rows", [40, 60])
def test_few_poses_are_given_few_coefficients(rows: int) -> None:
    """One at most for two poses, however uneven the gears are."""
    waves = {(joint, order): 5e-4 for joint in range(6) for order in (2, 5, 9, 14)}
    choice = choose_terms(*measured(11, rows, waves)[:2])
    entered = [len(step.added.terms) for step in choice.steps[1:] if step.added is not None]
    assert sum(entered) <= rows // 2
    assert len(choice.terms) <= rows // 2


@pytest.mark.parametrize(("size", "least"), [(0.0, 0), (5e-4, 0), (3e-3, 2)])
def test_forty_rows_of_a_panda_are_given_few_coefficients(size: float, least: int) -> None:
    """All orders of all its joints would be more than five hundred."""
    urdf, tip = PANDA
    rng, plain, robot = np.random.default_rng([40, 7]), machines.arm(urdf, tip), machines.load(urdf, tip)

    def extra(u: Array) -> Array:
        return np.asarray(size * np.column_stack([np.cos(k * u[:, j]) for j, k in enumerate((1, 2, 3, 1, 2, 5, 1))]))

    arm = geared(plain.moved(rng), extra)
    true = machines.Machine(arm, machines.anywhere(rng), {"tool": machines.pose((0.05, 0.02, 0.15))})
    data = true.measure(robot, plain.draw(rng, 40), "position", rng=rng, sigma=SIGMA)
    choice = choose_terms(calib.error_model(robot, offsets="all", placements="all"), data)
    assert choice.offered > 7 * len(OFFERED)
    assert least <= len(choice.terms) <= 20
    unseen = plain.draw(rng, 400)
    assert machines.miss(choice.fit, true, unseen) <= machines.miss(choice.geometric, true, unseen)


def test_a_choice_ends_where_chance_begins() -> None:
    """Of machines without terms few candidates are looked at: each costs as much as a fold's elimination."""
    choice = choose_terms(*measured(12, 400, {})[:2])
    assert len(choice.steps) < 0.3 * choice.offered


@pytest.mark.parametrize("waves", [{}, {(1, 3): 3e-4, (2, 6): 3e-4}])
def test_a_choice_costs_few_geometric_fits(waves: dict[tuple[int, int], float]) -> None:
    model, data, _ = measured(13, 600, waves)
    start = time.process_time()
    calib.identify(model, data)
    one = time.process_time() - start
    start = time.process_time()
    choose_terms(model, data)
    assert time.process_time() - start < 100.0 * one


def test_progress_is_told() -> None:
    model, data, _ = measured(7, 40, {})
    said: list[str] = []
    choose_terms(model, data, count=4, progress=said.append)
    assert len(said) == 7
    assert said[2] == "choosing joint terms: fold 1 of 4"


def test_rows_that_lie_off_do_not_decide_where_a_loss_says_so() -> None:
    """A hundredth of the rows off by decimetres drowns what the others say; with a loss it is found all the same."""
    model, data, _ = measured(8, 200, {(1, 3): 3e-4, (2, 6): 3e-4})
    position = np.array(data.position)
    position[::100] += 0.1
    spoilt = replace(data, position=position)
    joints = [reading.name for reading in model.robot.readings]
    there = {*harmonic(joints[1], 3), *harmonic(joints[2], 6)}
    assert not there <= set(choose_terms(model, spoilt).terms)
    assert there <= set(choose_terms(model, spoilt, losses=["cauchy"]).terms)


def test_other_kinds_of_observation_are_judged_as_well() -> None:
    """Distances from a place that is known to the tool point."""
    model, data, true = measured(9, 200, {(1, 3): 3e-4})
    robot, rng = model.robot, np.random.default_rng(3)
    points = true.see(data.readings)[:, :3, 3]
    anchor = np.array([0.4, -1.5, 0.7])
    columns: dict[str, object] = {f"{name} [rad]": data.readings[:, k] for k, name in enumerate(data.reading_names)}
    columns["length [m]"] = np.linalg.norm(points - anchor, axis=1) + rng.normal(scale=SIGMA, size=len(points))
    lengths = calib.read_measurements(columns, robot, "distance")
    choice = choose_terms(model, [data.subset(range(100)), lengths])
    assert set(harmonic(robot.readings[1].name, 3)) <= set(choice.terms)
    assert list(choice.steps[0].rms) == ["position", "distance"]
    assert choice.steps[choice.taken].rms["distance"] < 0.8 * choice.steps[0].rms["distance"]


def test_terms_are_not_chosen_beside_very_many_unknowns(monkeypatch: pytest.MonkeyPatch) -> None:
    """A table of 545 kB with 2200 planes took more than a minute and 3.6 GB."""
    robot, arm = machines.load(*UR10), machines.arm(*UR10)
    true = machines.Machine(arm, np.eye(4), {"tool": machines.pose((0.05, 0.0, 0.1))})
    rng = np.random.default_rng(2)
    data = true.measure(robot, arm.draw(rng, 30), rng=rng, sigma=1e-5)
    fit = calib.identify(calib.error_model(robot, offsets="all"), data)
    monkeypatch.setattr(linearised, "_MOST_UNKNOWNS", 14)
    with pytest.raises(IdentificationError, match=r"unknowns of arm, .* at most, and here are 15; choose"):
        LinearisedSystem(fit, (), None, np.ones(30, dtype=bool), np.zeros(0))
    monkeypatch.setattr(linearised, "_MOST_UNKNOWNS", 15)
    LinearisedSystem(fit, (), None, np.ones(30, dtype=bool), np.zeros(0))


def test_between_places_the_loops_of_the_identified_machine_close_too() -> None:
    """A lever that is too short: near the flat parallelogram only the nominal machine closes."""
    loop = calib.ClosedLoop("parallelogram", ("rod_end", "pin"), ("x", "z"), ("elbow", "rod"))

    def robot(e: float) -> calib.Robot:
        return calib.load_robot(parse_urdf(four_bar_urdf(e=e).encode(), "arm.urdf"), "tip", loops=[loop])

    rng = np.random.default_rng(1)
    q = rng.uniform(-0.5, 0.5, (40, len(robot(0.18).readings)))
    x = robot(0.175).tips(q)[:, :3, 3] + rng.normal(scale=1e-5, size=(40, 3))
    columns: dict[str, object] = {f"{r.name} [rad]": q[:, k] for k, r in enumerate(robot(0.18).readings)}
    data = calib.read_measurements(
        columns | {f"{a} [m]": x[:, k] for k, a in enumerate("xyz")}, robot(0.18), sigma=1e-5
    )
    model = calib.error_model(robot(0.18), placements=["pin.tx"], tool="fixed")
    fit = calib.identify(model, data)
    system = LinearisedSystem(fit, (), None, np.ones(40, dtype=bool), np.zeros(0))
    names = [r.name for r in robot(0.18).readings]
    flat = np.zeros((2, len(names)))
    flat[:, names.index("crank")] = np.pi / 2 - 0.02
    flat[1, names.index("crank")] = 0.1
    p = len(fit.parameters)
    whole = np.zeros((1, p))
    without = rng.normal(size=(3, 1, p))
    found = system.scatter(flat, whole, without)
    assert np.isfinite(found).all()
    np.testing.assert_allclose(found, system.scatter(flat[1:], whole, without))
    assert np.isinf(system.scatter(flat[:1], whole, without)).all()


def test_sigmas_that_cannot_be_weighed_together_are_said() -> None:
    lab = touching.lab(3, noise=1e-5)
    far = replace(touching.between("distance", "a", "b"), value=1e4, sigma=1e-9)
    model = machines.model(lab.robot, offsets="all", placements="all", relations=[far])
    with pytest.raises(IdentificationError, match="differ by too much to be weighed together"):
        choose_terms(model, [lab.positions(40), lab.sockets(12)])


@pytest.mark.parametrize(("size", "placed"), [(2e-4, True), (2e-5, True), (2e-4, False)])
def test_targets_that_are_eliminated_leave_the_choice_as_it_was(
    size: float, placed: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of touches in sockets and planes, with a wave of one reading.

    Without positions, a turn and the size of all are unknown: they are held at the fit, with the targets or without.
    """
    lab = touching.lab(3, noise=2e-5)
    waving = [lab.sockets(30), lab.planes(14, tuple(touching.NORMALS)), *([lab.positions(20)] if placed else [])]
    for data in waving:
        wave = np.zeros_like(data.readings)
        wave[:, 2] = size * np.cos(2.0 * data.readings[:, 2])
        object.__setattr__(data, "readings", data.readings + wave)
    model = machines.model(lab.robot, offsets="all", placements="all", base="fixed")
    found = choose_terms(model, waving)
    monkeypatch.setattr(Problem, "of_known_widths", property(lambda problem: Split.none(len(problem.parameters))))
    whole = choose_terms(model, waving)
    assert found.taken == whole.taken
    assert bool(found.taken) == (size > 1e-4)
    for own, other in zip(found.records(), whole.records(), strict=True):
        assert own["added"] == other["added"]
        np.testing.assert_allclose(own["held_out"], other["held_out"], rtol=1e-6 if placed else 2e-2)
    harmonics = found.all_harmonics, whole.all_harmonics
    if harmonics[0] is not None and harmonics[1] is not None:
        np.testing.assert_allclose(harmonics[0].held_out.rms, harmonics[1].held_out.rms, rtol=1e-4 if placed else 2e-2)
        np.testing.assert_allclose(harmonics[0].widths, harmonics[1].widths, rtol=1e-3 if placed else 0.1)
