"""What must not matter to the calibration of any serial arm, and what must matter in one way only."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

import calib
from tests.properties.strategies import arms, poses
from tests.support import machines
from tests.support.machines import Array, Machine, pose, predicted

ROWS, SIGMA = 80, 5e-5
KNOWN = {"position": [0.0], "pose": [0.0, 0.0]}


@dataclass(frozen=True, eq=False)
class Case:
    """A badly made arm that stands at ``base``, measured in one of two ways."""

    text: str
    base: Array
    observes: str
    seed: int

    @cached_property
    def arm(self) -> machines.Arm:
        return machines.arm(self.text, "tip")

    @cached_property
    def robot(self) -> calib.Robot:
        return machines.load(self.text, "tip")

    @cached_property
    def true(self) -> Machine:
        rng = np.random.default_rng(self.seed)
        return Machine(self.arm.moved(rng), self.base, {"tool": pose((0.05, 0.02, 0.15), (0.3, -0.4, 0.5))})

    @cached_property
    def readings(self) -> Array:
        return self.arm.draw(np.random.default_rng(self.seed + 1), ROWS)

    @cached_property
    def unseen(self) -> Array:
        return self.arm.draw(np.random.default_rng(self.seed + 2), 50)

    @cached_property
    def model(self) -> calib.ErrorModel:
        return self.model_of()

    @cached_property
    def data(self) -> calib.Measurements:
        return self.measured(SIGMA)

    @cached_property
    def fit(self) -> calib.Fit:
        return self.identified(self.data)

    def model_of(self, **options: object) -> calib.ErrorModel:
        tool = "pose" if self.observes == "pose" else "position"
        return machines.model(self.robot, **({"offsets": "all", "placements": "all", "tool": tool} | options))

    def measured(self, sigma: float, stated: float | None = None) -> calib.Measurements:
        rng = np.random.default_rng(self.seed + 3)
        said = None if stated is None else (stated, 2 * stated)
        return self.true.measure(
            self.robot, self.readings, self.observes, rng=rng, sigma=sigma, sigma_angle=2 * sigma, stated=said
        )

    def identified(
        self, data: calib.Measurements, model: calib.ErrorModel | None = None, **options: object
    ) -> calib.Fit:
        """The fit with the noise as it is stated."""
        return calib.identify(model or self.model, data, model_sigmas=KNOWN[self.observes], **options)

    def tools(self, fit: calib.Fit) -> Array:
        """What was measured, at unseen readings: tool poses (N, 4, 4), or their points (N, 4)."""
        T = predicted(fit, self.unseen)
        return T if self.observes == "pose" else T[:, :, 3]


def cases(observes: tuple[str, ...] = ("position", "pose")) -> st.SearchStrategy[Case]:
    return st.builds(Case, arms().filter(has_use), poses(), st.sampled_from(observes), st.integers(0, 1000))


def has_use(text: str) -> bool:
    """Whether every joint does something else than the one before it: nobody builds a hinge on the axis of a hinge."""
    T, before = np.eye(4), None
    for joint in machines.arm(text, "tip").joints:
        T = T @ joint.origin
        if joint.type == "fixed":
            continue
        axis, point = T[:3, :3] @ joint.axis, T[:3, 3]
        if before is not None and before[0] == joint.type and np.linalg.norm(np.cross(axis, before[1])) < 0.1:
            apart = np.linalg.norm(np.cross(point - before[2], axis))
            if joint.type == "prismatic" or apart < 0.05:
                return False
        before = joint.type, axis, point
    return True


def same(case: Case, fit: calib.Fit, other: calib.Fit, at: Array | None = None) -> None:
    """Both fits predict the same and know their parameters equally well; ``at`` moved the world of the other one."""
    moved = np.eye(4) if at is None else at
    tools = case.tools(fit)
    expected = moved @ tools if tools.ndim == 3 else tools @ moved.T
    np.testing.assert_allclose(case.tools(other), expected, rtol=0, atol=1e-8)
    assert (other.rank, other.numerical_rank) == (fit.rank, fit.numerical_rank)
    of_robot = np.array([p.of_robot for p in fit.parameters])
    np.testing.assert_array_equal(other.unidentifiable[of_robot], fit.unidentifiable[of_robot])
    np.testing.assert_allclose(other.sigmas[of_robot], fit.sigmas[of_robot], rtol=1e-3)
    # A parameter that is hardly seen answers rounding with as much more.
    sigmas = np.nan_to_num(fit.sigmas[of_robot], nan=1e-3)
    assert np.all(np.abs(other.values - fit.values)[of_robot] < 1e-3 * sigmas + 1e-8)


# ---- the truth is found


@given(cases())
def test_without_noise_what_is_seen_is_exact(case: Case) -> None:
    fit = calib.identify(case.model, case.measured(0.0))
    assert fit.converged
    truth = case.true.see(case.unseen)
    np.testing.assert_allclose(case.tools(fit), truth if case.observes == "pose" else truth[:, :, 3], rtol=0, atol=1e-9)


# ---- what must not matter


@given(cases(), poses(20.0))
def test_where_the_instrument_or_the_robot_stands_does_not_matter(case: Case, moved: Array) -> None:
    same(case, case.fit, case.identified(in_world(case.data, moved)), moved)


def in_world(data: calib.Measurements, moved: Array) -> calib.Measurements:
    turned = replace(data, position=data.position @ moved[:3, :3].T + moved[:3, 3])
    return turned if data.orientation is None else replace(turned, orientation=moved[:3, :3] @ data.orientation)


@given(cases(), st.permutations(range(ROWS)))
def test_the_order_of_the_rows_does_not_matter(case: Case, order: list[int]) -> None:
    same(case, case.fit, case.identified(case.data.subset(np.array(order))))


@given(cases())
def test_the_units_of_the_table_do_not_matter(case: Case) -> None:
    columns = machines.table(case.arm, case.readings, case.true.see(case.readings), case.observes)
    other = {
        name.replace("[m]", "[mm]").replace("[rad]", "[deg]"): values * 1e3
        if "[m]" in name
        else np.degrees(values)
        if "[rad]" in name
        else values
        for name, values in columns.items()
    }
    assert other.keys() != columns.keys()
    angle = 2 * SIGMA if case.observes == "pose" else None
    fits = [
        case.identified(calib.read_measurements(c, case.robot, case.observes, sigma=(SIGMA, angle)))
        for c in (columns, other)
    ]
    same(case, *fits)


@given(cases())
def test_a_parameter_that_cannot_be_seen_changes_no_prediction_and_is_said_so(case: Case) -> None:
    """The first joint's place along and about its own axis are the base's, or its own zero's."""
    first = next(joint for joint in case.robot.chain if joint.type != "fixed")
    own = "tz" if first.type == "prismatic" else "rz"
    less = case.model_of(placements="none")
    more = case.model_of(placements=[f"{first.name}.{'t' if own == 'rz' else 'r'}z"])
    fits = [case.identified(case.data, model) for model in (less, more)]
    np.testing.assert_allclose(case.tools(fits[1]), case.tools(fits[0]), rtol=0, atol=1e-8)
    assert fits[1].rank == fits[0].rank
    records = {record["name"]: record for record in fits[1].records()}
    (added,) = records.keys() - {record["name"] for record in fits[0].records()}
    assert records[added]["identifiable"] is False
    assert records[added]["sigma"] is None
    assert any(added in direction.shares for direction in fits[1].null_space)


# ---- what must matter in one way


@given(cases(), st.sampled_from((0.2, 3.0, 40.0)))
def test_intervals_scale_with_the_stated_noise(case: Case, times: float) -> None:
    names = seen_well(case)
    fits = [case.identified(replace(case.data, sigma=k * case.data.sigma), free=names) for k in (1.0, times)]
    # Weak priors weigh a little more or less beside them.
    np.testing.assert_allclose(case.tools(fits[1]), case.tools(fits[0]), rtol=0, atol=0.02 * SIGMA)
    np.testing.assert_allclose(fits[1].sigmas, times * fits[0].sigmas, rtol=1e-4)
    np.testing.assert_allclose(times * fits[1].singular_values, fits[0].singular_values, rtol=1e-6)


@given(cases())
def test_the_same_rows_twice_halve_the_covariance(case: Case) -> None:
    names = seen_well(case)
    once, twice = (case.identified(data, free=names) for data in (case.data, doubled(case.data)))
    np.testing.assert_allclose((twice.values - once.values) / once.sigmas, 0.0, rtol=0, atol=2e-3)
    np.testing.assert_allclose(twice.covariance, once.covariance / 2, rtol=1e-4, atol=1e-6 * once.covariance.max())


@given(cases(("position",)))
def test_with_estimated_noise_they_do_so_up_to_the_degrees_of_freedom(case: Case) -> None:
    """Rows less parameters judge the noise: n - p once, and 2 n - p for twice the squares."""
    names = seen_well(case)
    data = case.measured(SIGMA, stated=0.0)
    once, twice = (calib.identify(case.model, rows, free=names) for rows in (data, doubled(data)))
    n, p = 3 * ROWS, len(names)
    # Weak priors know a little, too.
    assert once.noise[0].degrees_of_freedom == pytest.approx(n - p, abs=0.01)
    assert twice.noise[0].degrees_of_freedom == pytest.approx(2 * n - p, abs=0.01)
    ratio = (n - p) / (2 * n - p)
    np.testing.assert_allclose(
        twice.covariance, ratio * once.covariance, rtol=1e-4, atol=1e-6 * np.abs(once.covariance).max()
    )


def doubled(data: calib.Measurements) -> calib.Measurements:
    return data.subset(np.repeat(np.arange(len(data)), 2))


def seen_well(case: Case) -> list[str]:
    """Names of offsets, base and tool of which every single one is known well, even if the noise were 50 times that."""
    model, rough = case.model_of(placements="none"), replace(case.data, sigma=50.0 * case.data.sigma)
    names = [p.name for p in case.identified(rough, model=model, null_space="minimal").parameters]
    fit = case.identified(rough, free=names)
    assume(fit.numerical_rank == len(names))
    return names
