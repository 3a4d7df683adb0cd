"""The Gaussian process of residuals: right where errors were measured, nothing elsewhere, and absent from noise."""

import io
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import calib
from calib.assessment import gaussian_choice
from calib.assessment.gaussian_choice import bought, held_out_errors
from calib.compensation import commands
from calib.foundations import rigid
from calib.foundations.errors import JobError, MeasurementError, OutputError
from calib.machine import gaussian
from calib.machine.gaussian import GaussianResiduals, gaussian_from_residuals, load_gaussian
from calib.robot.robot import Reading
from tests.support import machines

Array = NDArray[np.float64]

READINGS = (
    Reading("j1", "angle", -3.0, 3.0),
    Reading("slide", "length", 0.0, 2.0),
    Reading("j3", "angle", None, None),
)
NOISE = 1e-5


def draw(n: int, seed: int, readings: tuple[Reading, ...] = READINGS) -> Array:
    return np.random.default_rng(seed).uniform(0.0, 1.5, (n, len(readings)))


def wavy(q: Array) -> Array:
    """Errors in m of the first and the last joint, and none of those between."""
    a, c = q[:, 0], q[:, -1]
    return 1e-4 * np.stack([np.sin(4 * a + c), np.cos(3 * a), np.sin(2 * a) * c], axis=1)


ROWS = draw(120, 1)
ERRORS = wavy(ROWS) + np.random.default_rng(2).normal(scale=NOISE, size=(120, 3))


@pytest.fixture(scope="module")
def known() -> GaussianResiduals:
    return gaussian_from_residuals(ROWS, ERRORS, READINGS, frame="tip")


def test_a_known_function_is_recovered(known: GaussianResiduals) -> None:
    points = draw(300, 3)
    off = known.at(points) - wavy(points)
    assert np.sqrt(np.mean(off**2)) < NOISE
    # The predicted deviation is neither vain nor timid, and the noise and the idle joint are found.
    z = off / known.sigma(points)[:, None]
    assert 0.5 < np.sqrt(np.mean(z**2)) < 1.3
    assert known.kernel.noise == pytest.approx(NOISE, rel=0.2)
    assert known.kernel.scales[1] > 5 * max(known.kernel.scales[0], known.kernel.scales[2])
    assert known.outside(points) == ("",) * 300


def test_prediction_is_that_of_scikit_learn(known: GaussianResiduals) -> None:
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import ConstantKernel, Matern, WhiteKernel

    a, scales, noise = known.kernel
    kernel = ConstantKernel(a**2 * 1e8) * Matern(scales, nu=1.5) + WhiteKernel(noise**2 * 1e8)
    theirs = GaussianProcessRegressor(kernel, optimizer=None, alpha=1e-14).fit(ROWS, ERRORS * 1e4)
    points = draw(50, 4)
    mean, deviation = theirs.predict(points, return_std=True)
    assert np.abs(known.at(points) * 1e4 - mean).max() < 1e-7
    # Theirs has the noise in it.
    assert np.abs(np.hypot(known.sigma(points), noise)[:, None] * 1e4 - deviation).max() < 1e-7


def test_the_likelihood_is_that_of_scikit_learn_and_its_derivative_that_of_differences() -> None:
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import ConstantKernel, Matern, WhiteKernel

    points, errors = ROWS[:60], ERRORS[:60] / np.sqrt(np.mean(ERRORS[:60] ** 2))
    for logarithms in np.log([[0.7, 0.3, 0.3, 0.3, 0.3], [2.0, 0.5, 100.0, 1.0, 1e-3]]):
        variance, *scales, noise = np.exp(logarithms)
        kernel = ConstantKernel(variance) * Matern(scales, nu=1.5) + WhiteKernel(noise)
        theirs = GaussianProcessRegressor(kernel, optimizer=None, alpha=0.0).fit(points, errors)
        value, by_logarithms = gaussian._unlikely(logarithms, points, errors)
        assert value == pytest.approx(-theirs.log_marginal_likelihood_value_, rel=1e-9)
        steps = 1e-5 * np.eye(len(logarithms))
        differences = [
            (
                gaussian._unlikely(logarithms + h, points, errors)[0]
                - gaussian._unlikely(logarithms - h, points, errors)[0]
            )
            / 2e-5
            for h in steps
        ]
        np.testing.assert_allclose(by_logarithms, differences, rtol=1e-5, atol=1e-5)


def test_errors_that_follow_no_joint_are_searched_no_longer_than_others(monkeypatch: pytest.MonkeyPatch) -> None:
    """Their likelihood is flat: without a bound the search took hundreds of looks at it."""
    looks: list[float] = []
    likely = gaussian._unlikely

    def looked(*given: Any) -> tuple[float, Array]:
        value, by_logarithms = likely(*given)
        looks.append(value)
        return value, by_logarithms

    monkeypatch.setattr(gaussian, "_unlikely", looked)
    rng = np.random.default_rng(0)
    gaussian.likeliest_kernel(rng.uniform(-1.0, 1.0, (200, 6)), rng.normal(scale=1e-4, size=(200, 3)))
    assert len(looks) < 400


@pytest.mark.parametrize("share", [0.0, 0.5])
def test_of_many_rows_a_hopeless_search_ends_and_no_other(share: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """``share`` of the errors' deviation follows the joints."""
    rng, looks = np.random.default_rng(0), [0]
    likely = gaussian._unlikely

    def looked(*given: Any) -> tuple[float, Array]:
        looks[0] += 1
        return likely(*given)

    monkeypatch.setattr(gaussian, "_unlikely", looked)
    points = rng.uniform(-1.0, 1.0, (gaussian._MANY_ROWS, 2))
    errors = 1e-4 * (share * np.sin(6.0 * points[:, :1]) + rng.normal(scale=1.0 - share, size=(len(points), 3)))
    found = []
    for hopeful in (gaussian._STEPS_TO_HOPE, 10_000):
        monkeypatch.setattr(gaussian, "_STEPS_TO_HOPE", hopeful)
        looks[0] = 0
        found.append((gaussian.likeliest_kernel(points, errors), looks[0]))
    (kernel, few), (closely, every) = found
    if share:
        assert (kernel.amplitude, kernel.noise, few) == (closely.amplitude, closely.noise, every)
    else:
        assert few < 0.75 * every


def test_far_from_all_rows_it_fades_to_zero_and_says_so(known: GaussianResiduals) -> None:
    far = np.array([[60.0, 0.5, 60.0]])
    assert np.abs(known.at(far)).max() < 1e-3 * np.abs(known.at(ROWS)).max()
    assert np.array_equal(known.at(far), known.at(far, clamp=True))
    assert known.sigma(far)[0] == pytest.approx(known.kernel.amplitude, rel=1e-3)
    (said,) = known.outside(far)
    prior = f"{known.kernel.amplitude * 1e3:.3g} mm"
    assert said == f"no error was measured near: the standard deviation there is {prior}, of {prior}"
    # On the way out it says so before it has faded.
    way = np.linspace(1.5, 60.0, 200)[:, None] * np.array([1.0, 0.0, 1.0]) + np.array([0.0, 0.5, 0.0])
    words = known.outside(way)
    assert words[0] == ""
    first = next(n for n, word in enumerate(words) if word)
    assert all(words[first:])
    assert known.at(np.zeros((0, 3))).shape == (0, 3)


def test_whole_turns_are_not_far_where_they_bring_back_all_that_follows(known: GaussianResiduals) -> None:
    turning = replace(known, turning=(True, False, False))
    points = draw(5, 4)
    away = points + 2.0 * np.pi * np.outer([1, -1, 2, -2, 1], [1, 0, 0])
    assert np.abs(turning.at(away) - known.at(points)).max() < 1e-12
    assert np.abs(turning.sigma(away) - known.sigma(points)).max() < 1e-12
    assert np.abs(turning.own_errors(away, NOISE) - known.own_errors(points, NOISE)).max() < 1e-9
    assert all(known.outside(away))


def test_the_order_of_rows_does_not_matter(known: GaussianResiduals) -> None:
    order = np.random.default_rng(5).permutation(len(ROWS))
    shuffled = gaussian_from_residuals(ROWS[order], ERRORS[order], READINGS, frame="tip")
    assert gaussian.gaussian_bytes(shuffled) == gaussian.gaussian_bytes(known)


def test_moving_the_world_moves_the_shifts(known: GaussianResiduals) -> None:
    rng = np.random.default_rng(6)
    world, base, tips = machines.anywhere(rng), machines.anywhere(rng), machines.anywhere(rng)[None].repeat(5, axis=0)
    shifts = known.shifts(base, tips, ROWS[:5])
    assert np.abs(known.shifts(world @ base, tips, ROWS[:5]) - shifts @ world[:3, :3].T).max() < 1e-18
    # In the axes of the tip.
    assert np.abs(shifts - known.at(ROWS[:5]) @ (base @ tips[0])[:3, :3].T).max() < 1e-18
    # Nor does it matter how large the errors are: numbers of metres and micrometres are one.
    larger = gaussian_from_residuals(ROWS, 64.0 * ERRORS, READINGS, frame="tip")
    assert np.abs(larger.at(ROWS) / 64.0 - known.at(ROWS)).max() < 1e-9


def test_named_joints_alone(known: GaussianResiduals) -> None:
    two = gaussian_from_residuals(ROWS, ERRORS, READINGS, ("j3", "j1"))
    assert two.joints == (0, 2)
    assert np.abs(two.at(ROWS) - known.at(ROWS)).max() < 5e-6


# ---- the guard


def test_held_out_rows_are_those_of_a_process_without_them(known: GaussianResiduals) -> None:
    fold = np.arange(len(ROWS)) % 4
    left = held_out_errors(known.kernel, ROWS, ERRORS, fold, np.ones(len(ROWS), dtype=np.bool_))
    some = np.isin(fold, (1, 3))
    np.testing.assert_allclose(held_out_errors(known.kernel, ROWS, ERRORS, fold, some), left[some], atol=1e-12)
    for k in range(4):
        own = fold == k
        K = known.kernel.of_rows(ROWS[~own])
        predicted = known.kernel.between(ROWS[own], ROWS[~own]) @ np.linalg.solve(K, ERRORS[~own])
        assert np.abs(left[own] - (ERRORS[own] - predicted)).max() < 1e-12


def test_it_enters_where_it_helps(known: GaussianResiduals) -> None:
    gain = bought(known, ROWS, ERRORS, np.arange(len(ROWS)))
    assert gain.enters
    assert gain.held_out.rms < 0.25 * gain.without.rms


@pytest.mark.parametrize("seed", range(4))
def test_white_noise_is_not_learnt(seed: int) -> None:
    rng = np.random.default_rng([7, seed])
    rows, errors = draw(60, seed + 10), rng.normal(scale=1e-4, size=(60, 3))
    made = gaussian_from_residuals(rows, errors, READINGS)
    assert not bought(made, rows, errors, np.arange(60)).enters


def test_of_very_many_rows_some_are_judged(known: GaussianResiduals, monkeypatch: pytest.MonkeyPatch) -> None:
    """In whatever order they come."""
    monkeypatch.setattr(gaussian_choice, "MOST_JUDGED", len(ROWS) // 2)
    group, order = np.arange(len(ROWS)) // 2, np.random.default_rng(1).permutation(len(ROWS))
    gain = bought(known, ROWS, ERRORS, group)
    again = bought(known, ROWS[order], ERRORS[order], group[order])
    assert gain.enters
    assert again.without.rms == pytest.approx(gain.without.rms, rel=1e-12)
    assert gain.without.rms != np.sqrt(np.mean(np.sum(ERRORS**2, axis=1)))


def test_visits_of_one_pose_do_not_praise_it() -> None:
    """Errors of their own at poses visited twice: one visit foretells the other, and no other pose."""
    rng = np.random.default_rng(8)
    rows, errors = draw(40, 9).repeat(2, axis=0), rng.normal(scale=1e-4, size=(40, 3)).repeat(2, axis=0)
    errors += rng.normal(scale=1e-6, size=errors.shape)
    made = gaussian_from_residuals(rows, errors, READINGS)
    assert bought(made, rows, errors, np.arange(80)).enters
    assert not bought(made, rows, errors, np.arange(80) // 2).enters


# ---- commands


def test_commands_through_it_converge() -> None:
    robot = machines.load("example:ur_description/urdf/ur10_robot.urdf", "tool0")
    rng = np.random.default_rng(9)
    rows = np.array([0.0, -1.2, 1.0, 0.3, 0.9, 0.2]) + rng.uniform(-0.6, 0.6, (80, 6))
    field = 5e-4 * np.stack([np.sin(8 * rows[:, 1]), np.cos(8 * rows[:, 2]), np.sin(5 * rows[:, 1])], axis=1)
    known = gaussian_from_residuals(rows, field, robot.readings, [r.name for r in robot.readings[1:3]])
    deviations = calib.Deviations(rng.normal(scale=3e-4, size=(len(robot.chain), 6)), rng.normal(scale=1e-3, size=6))
    tool = rigid.placement(np.eye(3), np.array([0.03, 0.0, 0.1]))
    model = calib.CalibratedMachine(robot, deviations, machines.anywhere(rng), {"tool": tool}, known)
    wanted = np.array([0.0, -1.2, 1.0, 0.3, 0.9, 0.2]) + rng.uniform(-0.5, 0.5, (20, 6))
    found = commands.for_joint_targets(model, wanted)
    assert found.reached.all(), found.reasons
    goal = model.base @ robot.tips(wanted) @ tool
    assert np.abs((model.predict(found.readings) - goal)[:, :3, 3]).max() < 1e-6
    assert np.abs(known.at(found.readings)).max() > 1e-4
    far = np.array([[0.0, 3.0, -2.5, 0.3, 0.9, 0.2]])
    refused = commands.for_joint_targets(model, far)
    assert refused.reasons[0].startswith("no error was measured near")
    clamped = commands.for_joint_targets(model, far, clamp=True)
    assert clamped.reached.all()
    assert clamped.reasons[0].endswith("; the predicted error fades to zero")


# ---- what cannot be used


@pytest.mark.parametrize(
    ("call", "error", "sentence"),
    [
        (lambda: gaussian_from_residuals(ROWS, ERRORS, READINGS, ["j9"]), JobError, "cannot follow 'j9'"),
        (lambda: gaussian_from_residuals(ROWS, ERRORS, READINGS, ["j1", "j1"]), JobError, "each named once"),
        (lambda: gaussian_from_residuals(ROWS, ERRORS, READINGS, []), JobError, "at least one"),
        (lambda: gaussian_from_residuals(ROWS, ERRORS, READINGS, None, "world"), JobError, "allowed are base, tip"),  # type: ignore[arg-type]
        (lambda: gaussian_from_residuals(ROWS, ERRORS[:, :2], READINGS), MeasurementError, r"\(N, 3\) and"),
        (lambda: gaussian_from_residuals(ROWS * np.nan, ERRORS, READINGS), MeasurementError, "finite"),
        (lambda: gaussian_from_residuals(ROWS[:9], ERRORS[:9], READINGS), MeasurementError, "10 to 5000 rows"),
        (lambda: gaussian_from_residuals(ROWS, 0 * ERRORS, READINGS), MeasurementError, "all errors are zero"),
    ],
)
def test_wrong_arguments(call: Callable[[], Any], error: type[Exception], sentence: str) -> None:
    with pytest.raises(error, match=sentence.replace(r"\(N, 3\) and", r"\(N, 3\)")):
        call()


# ---- files


def test_round_trip(known: GaussianResiduals, tmp_path: Path) -> None:
    (tmp_path / "gaussian.npz").write_bytes(gaussian.gaussian_bytes(known))
    again = load_gaussian(tmp_path / "gaussian.npz", READINGS)
    points = draw(40, 11)
    assert (again.readings, again.joints, again.frame) == (known.readings, known.joints, "tip")
    assert np.array_equal(again.at(points), known.at(points))
    assert np.array_equal(again.sigma(points), known.sigma(points))
    assert not again.errors.flags.writeable
    assert gaussian.gaussian_bytes(again) == (tmp_path / "gaussian.npz").read_bytes()
    with pytest.raises(OutputError, match=r"is of a robot with the joints j1, slide, j3, and this one has j1, slide\."):
        load_gaussian(tmp_path / "gaussian.npz", READINGS[:2])


HOSTILE: dict[str, tuple[dict[str, Any], str]] = {
    "another schema": ({"schema": np.array(2)}, "its schema is not 1"),
    "another frame": ({"frame": np.array("world")}, "its frame is not one of base, tip"),
    "a key more": ({"code": np.zeros(3)}, "and nothing else"),
    "a key less": ({"noise": None}, "and nothing else"),
    "objects": ({"errors": np.array([{}, print], dtype=object)}, "an array is not what its header says"),
    "integers": ({"points": np.zeros((120, 3), dtype=int)}, "points has a wrong type"),
    "NaN": ({"errors": np.full((120, 3), np.nan)}, "errors has a value that is not a finite number"),
    "a row less": ({"errors": np.zeros((119, 3))}, "its errors are not those of its points"),
    "no rows": ({"errors": np.zeros((0, 3)), "points": np.zeros((0, 3))}, "its errors are not those of its points"),
    "a scale less": ({"scales": np.ones(2)}, "are not positive numbers"),
    "no noise": ({"noise": np.array(0.0)}, "are not positive numbers"),
    "too little noise": ({"noise": np.array(1e-300), "points": np.ones((120, 3))}, "its rows cannot be told apart"),
    "a joint too far": ({"joints": np.array([0, 1, 3])}, "its joints are not different ones"),
    "dimension": ({"dimensions": np.array([["j1", "mass"]] * 3)}, "no names and dimensions"),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_contents(name: str, known: GaussianResiduals, tmp_path: Path) -> None:
    change, why = HOSTILE[name]
    with np.load(io.BytesIO(gaussian.gaussian_bytes(known)), allow_pickle=False) as file:
        contents = {key: value for key, value in (dict(file) | change).items() if value is not None}
    np.savez(tmp_path / "gaussian.npz", **contents)
    with pytest.raises(OutputError) as caught:
        load_gaussian(tmp_path / "gaussian.npz")
    said = str(caught.value)
    assert said.startswith(f"{tmp_path / 'gaussian.npz'}: is not a Gaussian process of this toolkit: ")
    assert why in said


def test_files_that_are_none(known: GaussianResiduals, tmp_path: Path) -> None:
    path, whole = tmp_path / "gaussian.npz", gaussian.gaussian_bytes(known)
    bent = bytearray(whole)
    bent[whole.index(known.errors.tobytes()) + 100] ^= 0xFF
    for data in (b"", b"x,y\n1,2\n", whole[:-30], bytes(bent)):
        path.write_bytes(data)
        with pytest.raises(OutputError, match="is not a Gaussian process of this toolkit"):
            load_gaussian(path)
