"""Joint terms many times as large as those of industrial arms are found, and ordinary ones keep their weak priors."""

import numpy as np
import pytest

import calib
from calib.robot.terms import JointTerm
from tests.support import machines
from tests.support.sagging import Sagging

UR5 = ("example:ur_description/urdf/ur5_robot.urdf", "tool0")
UR10 = ("example:ur_description/urdf/ur10_robot.urdf", "tool0")
SIGMA = 1e-4
WAVING = "wrist_2_joint"
# rad/Nm: hundreds of times those of an industrial arm.
SOFT = {"shoulder_lift_joint": 2e-3, "elbow_joint": 4e-3}


def rows(seed: int, count: int, wave: float = 0.0, gain: float = 0.0) -> tuple[calib.Robot, calib.Measurements]:
    """Positions of an arm whose wrist turns by a wave (rad) and by a share too much."""
    rng = np.random.default_rng(seed)
    robot = calib.load_robot(*UR5)
    machine = machines.Machine(
        machines.arm(*UR5).moved(rng), machines.anywhere(rng), {"tool": machines.pose((0.1, 0, 0.1))}
    )
    readings = rng.uniform(-2.0, 2.0, (count, 6))
    stands = readings.copy()
    stands[:, 4] += wave * np.cos(2.0 * readings[:, 4]) + gain * readings[:, 4]
    points = machine.see(stands)[:, :3, 3] + rng.normal(0.0, SIGMA, (count, 3))
    return robot, calib.positions(robot, readings, points, sigma=SIGMA)


def fitted(robot: calib.Robot, data: calib.Measurements) -> calib.Fit:
    terms = {"harmonics": [WAVING], "harmonic_orders": (2,), "gain": [WAVING]}
    return calib.identify(calib.error_model(robot, offsets="all", placements="all", terms=terms), data)


def errors(fit: calib.Fit, **true: float) -> dict[str, float]:
    """By how many of their standard deviations terms are off the truth, which is zero where nothing else is said."""
    found = {p.name.rpartition(".")[2]: k for k, p in enumerate(fit.parameters) if p.kind == "term"}
    return {name: float((fit.values[k] - true.get(name, 0.0)) / fit.sigmas[k]) for name, k in found.items()}


@pytest.mark.parametrize(("wave", "count"), [(1e-2, 40), (3e-2, 25), (0.1, 16), (0.1, 25)])
def test_a_large_wave_is_found_from_few_rows(wave: float, count: int) -> None:
    """Held by its weak prior, it came out five sigmas small, or stayed at zero and was taken for noise."""
    fit = fitted(*rows(5, count, wave))
    assert fit.converged and not fit.unidentifiable[[p.kind == "term" for p in fit.parameters]].any()
    assert max(map(abs, errors(fit, cos_2=wave).values())) < 4.0
    assert fit.noise[0].model < SIGMA


def test_each_kind_is_widened_by_itself_and_both_where_both_ask() -> None:
    typical = {p.name: p.typical_size for p in fitted(*rows(1, 40)).parameters if p.kind == "term"}

    def times(fit: calib.Fit) -> dict[str, float]:
        return {
            p.name.rpartition(".")[2]: p.typical_size / typical[p.name] for p in fit.parameters if p.name in typical
        }

    assert times(fitted(*rows(1, 40, wave=5e-3))) == {"gain": 1.0, "cos_2": 100.0, "sin_2": 100.0}
    assert times(fitted(*rows(1, 40, gain=5e-2))) == {"gain": 100.0, "cos_2": 1.0, "sin_2": 1.0}
    both = fitted(*rows(1, 40, wave=0.1, gain=0.1))
    assert times(both) == {"gain": 100.0, "cos_2": 100.0, "sin_2": 100.0}
    assert max(map(abs, errors(both, cos_2=0.1, gain=0.1).values())) < 4.0


def test_ordinary_terms_keep_their_weak_priors() -> None:
    for seed in range(4):
        fit = fitted(*rows(seed, 20, wave=5e-4, gain=5e-4))
        assert all(p.wider is not None for p in fit.parameters if p.kind == "term")


def test_the_order_of_rows_and_where_the_world_is_change_nothing() -> None:
    robot, data = rows(3, 30, wave=0.05)
    once = fitted(robot, data)
    order = np.random.default_rng(0).permutation(len(data))
    moved = machines.pose((1.0, -2.0, 0.5), (0.3, 0.2, -0.9))
    assert data.position is not None
    points = data.position @ moved[:3, :3].T + moved[:3, 3]
    elsewhere = calib.positions(robot, data.readings, points, sigma=SIGMA)
    of_terms = [p.kind == "term" for p in once.parameters]
    for other in (data.subset(order), elsewhere):
        np.testing.assert_allclose(fitted(robot, other).values[of_terms], once.values[of_terms], atol=1e-7)


def sagging(seed: int, count: int) -> tuple[calib.Robot, calib.Measurements, calib.Measurements]:
    """Positions of an arm as soft as one of a hobbyist, and the same without noise at other poses."""
    rng = np.random.default_rng(seed)
    robot, soft = calib.load_robot(*UR10), Sagging(UR10[0], SOFT)
    names = [joint.name for joint in robot.readings]
    readings = rng.uniform(-2.0, 2.0, (2 * count, 6))
    base, tool = machines.pose((0.5, -1.0, 0.2), (0.0, 0.0, 0.7)), machines.pose((0.05, 0.02, 0.15))
    tips = np.stack([soft.tip("tool0", dict(zip(names, at, strict=True))) for at in readings.tolist()])
    points = (base @ tips @ tool)[:, :3, 3]
    noisy = points[:count] + rng.normal(0.0, SIGMA, (count, 3))
    return (
        robot,
        calib.positions(robot, readings[:count], noisy, sigma=SIGMA),
        calib.positions(robot, readings[count:], points[count:], sigma=SIGMA),
    )


def test_a_soft_arm_is_trusted_and_predicted_without_a_stated_prior() -> None:
    robot, data, true = sagging(2, 40)
    fit = calib.identify(calib.error_model(robot, offsets="all", placements="all", terms={"elastic": list(SOFT)}), data)
    found = {p.name: (v, s) for p, v, s in zip(fit.parameters, fit.values, fit.sigmas, strict=True) if p.kind == "term"}
    for name, compliance in SOFT.items():
        value, sigma = found[f"{name}.elastic"]
        assert abs(value - compliance) < 4.0 * sigma < 0.1 * compliance
    assert true.position is not None
    away = machines.predicted(fit, true.readings)[:, :3, 3] - true.position
    assert np.sqrt(np.mean(away**2)) < SIGMA
    assert calib.assess(fit).trusted


def test_learned_widths_are_those_of_a_soft_arm() -> None:
    """Beside what they leave, rows seemed to say too little to learn from: a usual width held them near zero."""
    robot, data, true = sagging(2, 40)
    terms, priors = {"elastic": list(SOFT)}, calib.Priors(elastic="learned")
    fit = calib.identify(calib.error_model(robot, offsets="all", placements="all", terms=terms, priors=priors), data)
    found = {p.name: (v, s) for p, v, s in zip(fit.parameters, fit.values, fit.sigmas, strict=True) if p.kind == "term"}
    for name, compliance in SOFT.items():
        value, sigma = found[f"{name}.elastic"]
        assert abs(value - compliance) < 4.0 * sigma < 0.1 * compliance
    (learned,) = fit.learned
    assert learned.width > min(SOFT.values())
    assert true.position is not None
    away = machines.predicted(fit, true.readings)[:, :3, 3] - true.position
    assert np.sqrt(np.mean(away**2)) < SIGMA


def test_learned_widths_of_ordinary_terms_keep_their_scale() -> None:
    terms = {"harmonics": [WAVING], "harmonic_orders": (1, 2, 3)}
    model = calib.error_model(
        machines.load(*UR5), offsets="all", placements="all", terms=terms, priors=calib.Priors(harmonics="learned")
    )
    for seed in range(3):
        fit = calib.identify(model, rows(seed, 30, wave=5e-4)[1])
        assert all(p.wider is not None for p in fit.parameters if p.kind == "term")


def test_the_choice_of_terms_finds_a_soft_arm() -> None:
    """Beside what is left without them, a narrow prior held compliances back, and gears were taken in their place."""
    robot, data, _ = sagging(3, 80)
    model = calib.error_model(robot, offsets="all", placements="all")
    chosen = calib.judging.choose_terms(model, data)
    assert {JointTerm(name, "elastic") for name in SOFT} <= set(chosen.terms)
