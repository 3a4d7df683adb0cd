"""Priors whose width the data teach: the truth of a drawn population comes back, and nothing is taken from thin air."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal

import calib
from calib.foundations.errors import JobError
from calib.foundations.linear import one_thread
from calib.identification.arrow import Split
from calib.identification.initialisation.problem import initial_problem
from calib.identification.system import Problem
from calib.identification.widths import NormalEquations, likeliest_widths, likelihood
from scripts.studies import sigmas
from tests.support import machines, touching
from tests.support.gears import UR10, geared, wavy

Array = np.ndarray
ORDERS = tuple(range(1, 9))
SIGMA = 5e-5
OFF_AXIS, ON_AXIS = (0.2, 0.1, 0.15), (0.0, 0.0, 0.15)


@pytest.fixture(autouse=True)
def _one_thread() -> Iterator[None]:
    with one_thread():
        yield


# ---- the likelihood, against a density that knows nothing of it


def drawn(rng: np.random.Generator, n: int, sizes: tuple[int, ...], widths: Array, sigma: float = 1.0) -> tuple:
    """Rows of ``r = J (z - x)`` with noise: J (n, p), r (n,), the group (p,) and the truth x (p,)."""
    group = np.repeat(np.arange(len(sizes)), sizes)
    J, x = rng.standard_normal((n, len(group))), rng.standard_normal(len(group)) * widths[group]
    return J, -J @ x + sigma * rng.standard_normal(n), group, x


def rows_of(J: Array, r: Array, group: Array, parts: int = 1) -> NormalEquations:
    whole = np.column_stack([J, r])
    grams = np.stack([part.T @ part for part in np.array_split(whole, parts)])
    counts = np.array([float(len(part)) for part in np.array_split(whole, parts)])
    none = np.zeros(parts)
    return NormalEquations(grams, counts, np.zeros_like(grams[0]), none, none.astype(bool), group)


def test_the_likelihood_is_the_density_of_what_was_measured() -> None:
    rng = np.random.default_rng(1)
    J, r, group, _ = drawn(rng, 30, (4, 3), np.array([2.0, 0.3]))
    rows = rows_of(J, r, group, parts=2)
    values, densities = [], []
    for _ in range(4):
        w, f = rng.uniform(0.2, 3.0, 2), rng.uniform(0.5, 2.0, 2)
        cov = (J * w[group] ** 2) @ J.T + np.diag(np.repeat(f, 15) ** 2)
        values.append(likelihood(rows, w, f).value)
        densities.append(-2.0 * multivariate_normal(np.zeros(30), cov).logpdf(r))
    np.testing.assert_allclose(np.diff(values), np.diff(densities), rtol=1e-9)


def test_its_slopes_are_those_of_finite_differences() -> None:
    rng = np.random.default_rng(2)
    J, r, group, _ = drawn(rng, 40, (4, 3, 2), np.array([2.0, 0.3, 1.0]))
    rows = rows_of(J, r, np.where(group == 2, -1, group), parts=3)
    for _ in range(3):
        theta = rng.normal(scale=1.0, size=5)
        found = likelihood(rows, np.exp(theta[:2]), np.exp(theta[2:]))
        slopes = np.concatenate([found.by_widths, found.by_factors])
        h = 1e-5
        for k in range(5):
            low, high = (theta + s * h * np.eye(5)[k] for s in (-1.0, 1.0))
            a, b = (likelihood(rows, np.exp(t[:2]), np.exp(t[2:])).value for t in (low, high))
            assert slopes[k] == pytest.approx((b - a) / (2 * h), rel=1e-5, abs=1e-5)


def test_a_search_that_tries_a_noise_of_hardly_anything_goes_on_without() -> None:
    """Some parameters are known weakly alone: beside data of a noise a thousand times smaller that is rounding."""
    J = 1e3 * np.random.default_rng(0).standard_normal((60, 6))
    J[:, 5] = J[:, 3] + J[:, 4]
    group = np.array([0, 0, 0, -1, -1, -1])
    for seed in range(8):
        rng = np.random.default_rng(seed)
        r = J @ rng.standard_normal(6) + 1e-3 * rng.standard_normal(60)
        rows = rows_of(J, r, group)._replace(known=np.diag([0.0, 0.0, 0.0, 1e-5, 1e-5, 1e-5, 0.0]))
        assert likeliest_widths(rows, np.ones(1)).gamma == pytest.approx([3.0], abs=1e-6)


def test_widths_and_noise_of_a_large_population_come_back() -> None:
    widths, sigma = np.array([3.0, 0.2, 1.0]), 0.5
    for seed in range(3):
        rows = rows_of(*drawn(np.random.default_rng([seed, 3]), 900, (80, 120, 100), widths, sigma)[:3])
        found, factors, gamma, shown = likeliest_widths(rows, np.ones(3))
        assert shown.all()
        # The logarithm of a width that gamma parameters teach scatters by 1 / sqrt(2 gamma).
        assert np.all(np.abs(np.log(found / widths)) < 3.5 / np.sqrt(2.0 * gamma))
        assert factors[0] == pytest.approx(sigma, rel=0.1)


def test_at_the_top_the_width_is_that_of_what_was_determined() -> None:
    J, r, group, _ = drawn(np.random.default_rng(4), 60, (20,), np.array([0.7]))
    found = likeliest_widths(rows_of(J, r, group), np.ones(1))
    C = np.linalg.inv(J.T @ J / found.factors[0] ** 2 + np.eye(20) / found.widths[0] ** 2)
    x = -C @ J.T @ r / found.factors[0] ** 2
    assert found.gamma[0] == pytest.approx(20 - np.trace(C) / found.widths[0] ** 2, rel=1e-6)
    assert found.widths[0] ** 2 == pytest.approx(np.sum(x**2) / (found.gamma[0] - 2.0), rel=1e-3)


def test_what_the_data_do_not_see_teaches_nothing() -> None:
    J, r, group, _ = drawn(np.random.default_rng(5), 60, (20,), np.array([0.7]))
    alone = likeliest_widths(rows_of(J, r, group), np.ones(1))
    unseen = np.hstack([J, np.zeros((60, 200))])
    more = likeliest_widths(rows_of(unseen, r, np.zeros(220, dtype=int)), np.ones(1))
    np.testing.assert_allclose(np.concatenate(more[:3]), np.concatenate(alone[:3]), rtol=1e-3)


@pytest.mark.parametrize("small", [0.02, 0.05, 0.1])
def test_intervals_with_learned_widths_hold_the_truth(small: float) -> None:
    """Rows alone tell each parameter to 0.07 at best, so that a small group hardly shows."""
    inside = []
    for seed in range(60):
        J, r, group, x = drawn(np.random.default_rng([seed, 6]), 100, (15, 25), np.array([0.3, small]), 0.7)
        widths, factors, *_ = likeliest_widths(rows_of(J, r, group), np.ones(2))
        C = np.linalg.inv(J.T @ J / factors[0] ** 2 + np.diag(widths[group] ** -2.0))
        inside.append(np.abs(-C @ J.T @ r / factors[0] ** 2 - x) < 1.96 * np.sqrt(np.diag(C)))
    assert np.mean(np.array(inside)[:, :15]) > 0.92
    assert np.mean(np.array(inside)[:, 15:]) > 0.92


@pytest.mark.parametrize("usual", [1.0, 5.0])
def test_a_usual_width_is_widened_by_few_that_are_far_off_and_never_narrowed(usual: float) -> None:
    rng = np.random.default_rng(8)
    J = np.column_stack([30.0 * rng.standard_normal((60, 2)), np.zeros((60, 4))])
    for size in (0.0, 0.3, 3.0, 12.0):
        x = np.array([size, -size, 0.0, 0.0, 0.0, 0.0])
        rows = rows_of(J, -J @ x + rng.standard_normal(60), np.zeros(6, dtype=int))
        found = likeliest_widths(rows, np.full(1, usual), usual=np.full(1, usual)).widths[0]
        assert found == pytest.approx(max(usual, np.sqrt((2.0 * size**2 + usual**2) / 3.0)), rel=2e-2)


# ---- machines


class Lab:
    """A UR10, badly made, with uneven gears: coefficients of harmonics drawn with standard deviation ``width``."""

    def __init__(self, seed: int, width: float, *, at: tuple[float, ...] = OFF_AXIS, **errors: float) -> None:
        self.rng = rng = np.random.default_rng([seed, 41])
        self.robot, plain = machines.load(*UR10), machines.arm(*UR10)
        cosines, sines = ({k: rng.normal(scale=width, size=6) for k in ORDERS} for _ in range(2))
        arm = geared(plain.moved(rng, **errors), wavy(np.zeros(6), cosines, sines))
        self.true = machines.Machine(arm, machines.anywhere(rng), {"tool": machines.pose(at)})
        self.draw = plain.draw

    def data(self, n: int, sigma: float = SIGMA, stated: float | None = None) -> calib.Measurements:
        readings = self.draw(self.rng, n)
        given = None if stated is None else (stated, stated)
        return self.true.measure(self.robot, readings, rng=self.rng, sigma=sigma, stated=given)

    def model(self, **options: object) -> calib.ErrorModel:
        free = {"offsets": "all", "placements": "all"} | options
        return machines.model(self.robot, **free)

    def wavy(self, **options: object) -> calib.ErrorModel:
        free = {"harmonics": "all", "harmonic_orders": ORDERS, "prior_harmonics": "learned"}
        return self.model(**(free | options))


def widths(fit: calib.Fit) -> Array:
    return np.array([prior.width for prior in fit.learned])


def test_the_width_of_harmonics_comes_back() -> None:
    lab = Lab(1, 4e-5)
    fit = calib.identify(lab.wavy(), lab.data(250))
    assert [prior.outcome for prior in fit.learned] == ["learned"] * 6
    assert [prior.parameters for prior in fit.learned] == [16] * 6
    logs, taught = np.log(widths(fit) / 4e-5), np.array([prior.taught for prior in fit.learned])
    assert np.all(np.abs(logs) < 3.5 / np.sqrt(2.0 * taught))
    assert np.mean(logs) == pytest.approx(0.0, abs=3.0 / np.sqrt(2.0 * taught.sum()))
    assert {p.prior for p in fit.parameters if p.kind == "term"} == set(widths(fit).tolist())


def test_without_noise_widths_are_those_of_the_amounts_themselves() -> None:
    lab = Lab(6, 4e-5)
    fit = calib.identify(lab.wavy(prior_length="learned", prior_angle="learned"), lab.data(120, sigma=0.0))
    assert machines.miss(fit, lab.true, lab.draw(lab.rng, 50)) < 1e-10
    for prior in fit.learned:
        own = [value for p, value in zip(fit.parameters, fit.values, strict=True) if p.group == prior.group]
        if prior.group.startswith("harmonics"):
            assert prior.taught == pytest.approx(len(own), rel=1e-3)
            assert prior.width**2 == pytest.approx(np.sum(np.square(own)) / (len(own) - 2.0), rel=1e-2)


def test_neither_rows_nor_the_world_nor_units_change_what_is_learned() -> None:
    lab = Lab(2, 4e-5)
    model = lab.wavy(harmonic_orders=(1, 2, 3), prior_length="learned", prior_angle="learned")
    data = lab.data(80)
    fit = calib.identify(model, data)
    order = np.random.default_rng(0).permutation(len(data))
    T = machines.anywhere(np.random.default_rng(1))
    columns = machines.table(lab.true.arm, data.readings, np.repeat(np.eye(4)[None], len(data), axis=0), "position")
    moved = data.position @ T[:3, :3].T + T[:3, 3]
    columns |= {f"{axis} [m]": moved[:, k] for k, axis in enumerate("xyz")}
    in_mm = {key.replace("[m]", "[mm]"): np.asarray(v) * (1e3 if "[m]" in key else 1.0) for key, v in columns.items()}
    unseen = lab.draw(np.random.default_rng(3), 50)
    for other, at in (
        (data.subset(order), np.eye(4)),
        (calib.read_measurements(columns, lab.robot, sigma=SIGMA), T),
        (calib.read_measurements(in_mm, lab.robot, sigma=SIGMA), T),
    ):
        again = calib.identify(model, other)
        assert [p.outcome for p in again.learned] == [p.outcome for p in fit.learned]
        np.testing.assert_allclose(widths(again), widths(fit), rtol=2e-3)
        there = (at @ machines.predicted(fit, unseen))[:, :3, 3]
        np.testing.assert_allclose(machines.predicted(again, unseen)[:, :3, 3], there, atol=2e-7)


def test_of_harmonics_that_are_not_there_nothing_is_told() -> None:
    """The noise is half of what is stated, so that not even by chance something shows."""
    lab = Lab(3, 0.0)
    data = lab.data(150, sigma=0.5 * SIGMA, stated=SIGMA)
    free = calib.identify(lab.wavy(prior_harmonics=None), data)
    fit, plain = calib.identify(lab.wavy(), data), calib.identify(lab.model(), data)
    assert {prior.outcome for prior in fit.learned} == {"nothing shows"}
    unseen = lab.draw(lab.rng, 200)

    def off(one: calib.Fit) -> Array:
        return (machines.predicted(one, unseen) - machines.predicted(plain, unseen))[:, :3, 3]

    sigma = calib.judging.tool_uncertainty(calib.machine_of(fit), unseen).covariance[:, range(3), range(3)] ** 0.5
    assert np.all(np.abs(off(fit)) < sigma)
    assert np.std(off(fit)) < 0.2 * np.std(off(free))


def test_too_few_parameters_keep_an_ordinary_width() -> None:
    """A point on the last axis sees nothing of the last joint, and two coefficients are no population."""
    lab = Lab(4, 1e-4, at=ON_AXIS)
    elbow, last = lab.robot.readings[2].name, lab.robot.readings[5].name
    fit = calib.identify(lab.wavy(harmonics=[last]), lab.data(150))
    (prior,) = fit.learned
    assert (prior.outcome, prior.width, prior.parameters) == ("too few", pytest.approx(1e-4, rel=1e-4), 16)
    assert prior.taught < 0.1
    (prior,) = calib.identify(lab.wavy(harmonics=[elbow], harmonic_orders=[3]), lab.data(150)).learned
    assert (prior.outcome, prior.parameters) == ("too few", 2)
    assert 1e-4 <= prior.width < 2e-4


def test_learned_widths_are_no_worse_than_ordinary_ones_and_better_where_these_are_wrong() -> None:
    """Geometry from twelve poses, of arms as bad as is ordinary, and five times better and worse made."""
    gains = []
    for size in (1.0, 0.2, 5.0):
        stated, learned = [], []
        for seed in range(4):
            lab = Lab(10 + seed, 0.0, length=size * 1e-3, angle=size * 1e-3, zero=size * 1e-3)
            data, unseen = lab.data(12), lab.draw(lab.rng, 200)
            for found, priors in ((stated, (1e-3, 1e-3)), (learned, ("learned", "learned"))):
                fit = calib.identify(lab.model(prior_length=priors[0], prior_angle=priors[1]), data)
                found.append(machines.miss(fit, lab.true, unseen))
        gains.append(np.mean(learned) / np.mean(stated))
    assert gains[0] < 1.02
    assert np.mean(gains) < 1.0
    assert min(gains) < 0.97


def test_predictions_are_as_sure_as_they_say() -> None:
    inside = []
    for seed in range(6):
        lab = Lab(30 + seed, 0.0, length=0.3e-3, angle=0.3e-3, zero=1e-3)
        fit = calib.identify(lab.model(prior_length="learned", prior_angle="learned"), lab.data(20))
        unseen = lab.draw(lab.rng, 200)
        sigma = calib.judging.tool_uncertainty(calib.machine_of(fit), unseen).covariance[:, range(3), range(3)] ** 0.5
        miss = machines.predicted(fit, unseen)[:, :3, 3] - lab.true.see(unseen)[:, :3, 3]
        inside.append(np.mean(np.abs(miss) < 1.96 * sigma))
    assert 0.88 < np.mean(inside) < 0.99


@pytest.mark.parametrize(
    ("which", "free", "seed"), [(3, "offsets and placements", 5000), (4, "offsets and tilts", 5007)]
)
def test_zeros_of_joints_that_few_poses_show_are_as_sure_as_they_say(which: str, free: str, seed: int) -> None:
    """They are off by 3 mrad, and the priors of placements leave hardly three directions to teach their width."""
    found = sigmas.session(list(sigmas.ARMS)[which], free, seed, learned=True)
    assert np.max(np.abs(found.off)) < 4.0


def test_a_width_is_a_number_or_to_be_learned() -> None:
    lab = Lab(5, 0.0)
    with pytest.raises(JobError, match=r"prior length: 'wide' is neither a positive number nor \"learned\"\."):
        lab.model(prior_length="wide")
    with pytest.raises(JobError, match="takes no priors"):
        calib.judging.total_differential(lab.model(prior_length="learned"), lab.data(60), stop=1e-4)


@pytest.mark.parametrize("placed", [False, True])
def test_targets_that_are_eliminated_teach_the_same_widths(placed: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of sockets and planes, each seen by a component of its own, whose noise is found with the widths."""
    lab = touching.lab(5, noise=2e-5)
    touched = [lab.sockets(12), lab.planes(12, tuple(touching.NORMALS)), *([lab.positions(15)] if placed else [])]
    data = [replace(one, sigma=0.2 * one.sigma) for one in touched]
    model = machines.model(
        lab.robot, offsets="all", placements="all", base="fixed", priors=calib.Priors("learned", "learned")
    )
    assert initial_problem(model, data).split.blocks.shape == (6, 3)
    found = calib.identify(model, data)
    monkeypatch.setattr(Problem, "split", property(lambda problem: Split.none(len(problem.parameters))))
    whole = calib.identify(model, data)
    assert {own.outcome for own in found.learned} >= {"learned"}
    for own, other in zip(found.learned, whole.learned, strict=True):
        assert own.outcome == other.outcome
        np.testing.assert_allclose((own.width, own.taught), (other.width, other.taught), rtol=1e-3)
    np.testing.assert_allclose(found.values, whole.values, atol=1e-6)
