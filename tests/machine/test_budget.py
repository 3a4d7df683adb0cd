"""The budget of the tool point: what is not seen stays wide, what repeats is found, a grid leaves the wrist."""

import json
import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import calib
from calib.identification.losses import Loss
from calib.identification.noise import Noise
from calib.machine.budget import errors_by_cause
from calib.machine.calibrated import CalibratedMachine
from calib.machine.gaussian import GaussianResiduals, gaussian_bytes, gaussian_from_residuals, load_gaussian
from calib.machine.grid import SectorGrid, grid_bytes, grid_from_residuals, load_grid
from calib.machine.of_fit import _beyond, machine_of
from calib.machine.tool_uncertainty import residual_errors, tool_errors, tool_uncertainty
from calib.machine.uncertainty import CAUSES, Waves, rms_by_cause
from calib.presentation.sheets import rank_sentences
from calib.robot.joint_terms import with_joint_terms
from tests.support import machines, sagging
from tests.support.machines import Array, Machine, anywhere, pose

UR10 = ("example:ur_description/urdf/ur10_robot.urdf", "tool0")
SIGMA = 5e-5


def fitted(
    seed: int = 0,
    rows: int = 60,
    off: Callable[[Array], Array] = np.zeros_like,
    disturbed: Callable[[Array], Array] | None = None,
    stated: float | None = SIGMA,
    observes: str = "position",
    **options: object,
) -> tuple[calib.Fit, Callable[[Array], Array], machines.Arm]:
    """A fit to a machine whose readings (N, nr) are off by what nobody tells the fit, and the true tool points."""
    rng = np.random.default_rng(seed)
    robot, arm = machines.load(*UR10), machines.arm(*UR10)
    true = Machine(arm.moved(rng), anywhere(rng), {"tool": pose((0.05, 0.02, 0.15), (0.3, -0.2, 0.4))})

    def points(readings: Array) -> Array:
        return true.see(readings + off(readings))[:, :3, 3]

    q = arm.draw(rng, rows)
    seen = points(q) + SIGMA * rng.standard_normal((rows, 3))
    if disturbed is not None:
        seen = disturbed(seen)
    columns = {f"{r.name} [rad]": q[:, k] for k, r in enumerate(robot.readings)}
    columns |= {f"{axis} [m]": seen[:, k] for k, axis in enumerate("xyz")}
    if observes == "pose":
        turned = Rotation.from_matrix(true.see(q + off(q))[:, :3, :3])
        turned *= Rotation.from_rotvec(2.0 * SIGMA * rng.standard_normal((rows, 3)))
        columns |= {f"q{axis}": turned.as_quat()[:, k] for k, axis in enumerate("xyzw")}
    sigmas = (stated, 2.0 * SIGMA) if observes == "pose" else stated
    data = calib.read_measurements(columns, robot, observes, sigma=sigmas)
    chosen = {"offsets": "all", "placements": "all", "tool": "pose" if observes == "pose" else "position"} | options
    return calib.identify(machines.model(robot, **chosen), data), points, arm


def through_fit(fit: calib.Fit, readings: Array) -> float:
    """Rms of what scatter that the model leaves out does to the tool through the fit."""
    machine = machine_of(fit)
    known = machine.known_uncertainty
    assert known.left_out is not None
    start, end = sum(known.causes[:2]), known.factor.shape[1] - known.left_out.columns
    motions = tool_errors(machine, readings)[:, :3, start:end]
    return float(np.sqrt(np.mean(np.sum(motions**2, axis=(1, 2)))))


def waving(readings: Array) -> Array:
    return 1.5e-4 * np.cos(2.0 * readings + np.arange(readings.shape[1]))


def winding(readings: Array) -> Array:
    """What weights make of readings, by drives that give way: a function of several readings at once."""
    found, walked = np.zeros_like(readings), sagging.Sagging(UR10[0], {})
    joints = list(machines.arm(*UR10).ranges)
    for row, at in enumerate(readings):
        places = walked._places(dict(zip(joints, at, strict=True)))
        for name, compliance in sagging.SOFT.items():
            found[row, joints.index(name)] = compliance * walked._torque(name, places, sagging.DOWN, {})
    return found


def against_the_truth(
    off: Callable[[Array], Array], rows: int, poses: int, **options: object
) -> tuple[float, float, CalibratedMachine, Array]:
    """Of four sessions: how often regions hold, and how large errors are stated to be, by the true ones.

    And the machine and the readings of the last session.
    """
    inside, true, stated = [], 0.0, 0.0
    for seed in range(4):
        fit, points, arm = fitted(seed, rows, off, **options)
        q = arm.draw(np.random.default_rng(seed + 50), poses)
        machine = machine_of(fit)
        found = tool_uncertainty(machine, q)
        errors = machine.predict(q)[:, :3, 3] - points(q)
        inside.append(found.inside(errors).mean())
        true += float(np.mean(np.sum(errors**2, axis=1)))
        stated += float(np.mean(found.position**2))
    return float(np.mean(inside)), float(np.sqrt(stated / true)), machine, q


def share(machine: CalibratedMachine, readings: Array, cause: str) -> float:
    return float(np.sqrt(np.mean(tool_uncertainty(machine, readings).budget[cause][:, 0] ** 2)))


def own_errors(machine: CalibratedMachine, data: calib.Measurements, readings: Array) -> Array:
    """The covariance (N, N, 3, 3) of what a residual model gets wrong."""
    n = len(readings)
    F = residual_errors(machine, replace(data.subset(np.arange(n)), readings=readings))
    return np.einsum("nik,mjk->nmij", F, F)


def test_shares_add_up_to_the_covariance() -> None:
    fit, _, arm = fitted(off=waving)
    found = tool_uncertainty(machine_of(fit), arm.draw(np.random.default_rng(1), 30))
    assert tuple(found.budget) == CAUSES
    squares = sum(sigmas**2 for sigmas in found.budget.values())
    np.testing.assert_allclose(squares[:, 0], found.position**2, rtol=1e-9)
    np.testing.assert_allclose(squares[:, 1], found.orientation**2, rtol=1e-9)


def test_what_repeats_with_the_readings_is_the_models_and_found_in_size() -> None:
    for off, least, most in ((np.zeros_like, 0.0, 0.4), (waving, 0.7, 1.6)):
        inside, by_truth, machine, q = against_the_truth(off, 120, 100)
        assert inside > 0.9
        assert 0.8 < by_truth < 1.8
        # 0.15 mrad in six joints of a UR10 move the tool by some 0.17 mm.
        model = share(machine, q, "model") / 1.7e-4
        assert least <= model < most


def test_the_worse_the_data_the_larger_the_doubts() -> None:
    def noisy(seen: Array) -> Array:
        return seen + 0.3 * np.random.default_rng(3).standard_normal(seen.shape)

    (good, _, arm), (bad, *_) = fitted(), fitted(disturbed=noisy)
    q = arm.draw(np.random.default_rng(1), 20)
    fine, poor = (float(np.median(tool_uncertainty(machine_of(fit), q).position)) for fit in (good, bad))
    assert fine < 2e-4
    assert poor > 0.1


def test_what_the_data_do_not_show_has_the_width_of_not_knowing() -> None:
    # One joint was never turned: where the tool goes when it turns is known from nominal, and by its widths alone.
    fit, _, arm = fitted()
    held = machines.load(*UR10)
    rng = np.random.default_rng(4)
    q = arm.draw(rng, 60)
    q[:, 0] = 0.3
    columns = {f"{r.name} [rad]": q[:, k] for k, r in enumerate(held.readings)}
    points = machine_of(fit).predict(q)[:, :3, 3] + SIGMA * rng.standard_normal((60, 3))
    columns |= {f"{axis} [m]": points[:, k] for k, axis in enumerate("xyz")}
    narrow = machine_of(calib.identify(fit.model, calib.read_measurements(columns, held, sigma=SIGMA)))
    turned = q.copy()
    turned[:, 0] = 1.8
    assert np.median(tool_uncertainty(narrow, q).position) < 2e-4
    assert np.median(tool_uncertainty(narrow, turned).position) > 1e-3
    assert share(narrow, turned, "parameters") > 0.9e-3


def test_drifts_of_many_tables_take_little_memory_and_are_still_told() -> None:
    rng = np.random.default_rng(8)
    ways = np.repeat(rng.normal(0.0, 4.0 * SIGMA, (72, 3)), 50, axis=0)

    def drifting(seen: Array) -> Array:
        return seen + ways * (np.arange(3600) % 50 / 50)[:, None]

    (plain, _, arm), (drifted, *_) = (fitted(rows=3600, disturbed=change) for change in (None, drifting))
    q, told = arm.draw(np.random.default_rng(1), 50), []
    for fit in (plain, drifted):
        (data,) = fit.measurements
        many = calib.identify(fit.model, [data.subset(rows) for rows in np.array_split(np.arange(3600), 72)])
        tracemalloc.start()
        told.append(share(machine_of(many), q, "instrument"))
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert peak < 400e6, "with five shapes of a drift of each table it is 2.8 GB"
    assert told[1] > 3.0 * told[0]


def test_a_drift_is_the_instruments_and_rows_that_err_together_count_less() -> None:
    def drifting(seen: Array) -> Array:
        return seen + np.linspace(0.0, 4.0 * SIGMA, len(seen))[:, None] * [1.0, -1.0, 0.5]

    def in_runs(seen: Array) -> Array:
        return seen + np.repeat(SIGMA * np.random.default_rng(8).standard_normal((len(seen) // 10, 3)), 10, axis=0)

    (plain, _, arm), (drifted, *_), (together, *_) = (
        fitted(rows=300, disturbed=change) for change in (None, drifting, in_runs)
    )
    q = arm.draw(np.random.default_rng(1), 40)
    of_plain, of_drift = (share(machine_of(fit), q, "instrument") for fit in (plain, drifted))
    assert of_drift > 1.5 * of_plain
    # Ten rows that share half of their variance count as two: what reaches the tool is more than twice the variance.
    noise = [np.hypot(share(machine_of(fit), q, "instrument"), through_fit(fit, q)) for fit in (plain, together)]
    assert noise[1] > 1.5 * noise[0]


@pytest.mark.parametrize("loss", ["huber", "soft_l1", "cauchy"])
def test_a_robust_loss_makes_the_noise_of_ordinary_rows_no_smaller(loss: Loss) -> None:
    """Rows weigh less the farther off they are, so that weighed rows scatter less than the tool does."""
    fit, _, _ = fitted(rows=150, stated=None)
    robust = calib.identify(fit.model, fit.measurements, losses=[loss])
    plain, weighed = (machine_of(found).known_uncertainty.position for found in (fit, robust))
    assert plain is not None
    assert weighed is not None
    assert weighed.total == pytest.approx(plain.total, rel=0.04)


def test_noise_that_is_not_stated_counts_as_the_robots() -> None:
    fit, _, arm = fitted(stated=0.0)
    q = arm.draw(np.random.default_rng(1), 20)
    machine = machine_of(fit)
    assert machine.known_uncertainty.position is not None
    assert machine.known_uncertainty.position.model == pytest.approx(SIGMA, rel=0.2)
    assert share(machine, q, "model") > SIGMA


def test_a_scatter_within_chance_is_none() -> None:
    stated = Noise(0, "position", 1.0, 0.0, 200.0, 1.0)
    assert _beyond(0.9, stated) == 0.0
    # A tenth is what chance makes of 200 degrees of freedom.
    assert _beyond(1.1, stated) == 0.0
    assert _beyond(1.5, stated) == pytest.approx(0.455)
    assert _beyond(9.0, stated) == pytest.approx(8.0, abs=0.11)
    # Where no noise is stated, all of it is the model's.
    assert _beyond(1.1, replace(stated, instrument=0.0)) == 1.1


def test_waves_are_errors_of_readings() -> None:
    fit, _, arm = fitted(off=waving)
    machine = machine_of(fit)
    known = machine.known_uncertainty
    assert known.left_out is not None
    q, waves = arm.draw(np.random.default_rng(2), 3), known.left_out.waves
    # With a machine that follows nothing, a wave is what the tool does when the reading is off by it.
    alone = known.left_out._replace(root=np.eye(len(known.left_out.root)))
    still = replace(machine, uncertainty=replace(known, factor=np.zeros_like(known.factor), left_out=alone))
    errors = tool_errors(still, q)[:, :3, -alone.columns :]
    orders, h = waves.width.shape[1], 1e-6
    for j, k, wave in ((1, 2, np.cos), (4, 1, np.sin)):
        column = 2 * (j * orders + k - 1) + (wave is np.sin)
        step = np.zeros_like(q)
        step[:, j] = h * wave(k * q[:, j])
        by_step = (machine.predict(q + step)[:, :3, 3] - machine.predict(q - step)[:, :3, 3]) / (2.0 * h)
        np.testing.assert_allclose(-errors[:, :, column], by_step * waves.width[j, k - 1], rtol=1e-6, atol=1e-12)


def test_wind_up_is_what_masses_that_nobody_states_do_to_readings() -> None:
    fit, _, arm = fitted(off=waving)
    machine = machine_of(fit)
    known = machine.known_uncertainty
    assert known.left_out is not None
    wind_up, q = known.left_out.wind_up, arm.draw(np.random.default_rng(2), 3)
    alone = known.left_out._replace(root=np.eye(len(known.left_out.root)))
    still = replace(machine, uncertainty=replace(known, factor=np.zeros_like(known.factor), left_out=alone))
    errors = tool_errors(still, q)[:, :3, -len(wind_up.terms) :]
    soft = with_joint_terms(machine.robot, wind_up.terms)
    for k in (2, 12):
        # The same as what a robot does that has this one as a joint term.
        ends = []
        for sign in (1.0, -1.0):
            coefficients = np.zeros(len(wind_up.terms))
            coefficients[k] = sign * wind_up.width[k]
            bent = replace(machine.deviations, terms=coefficients)
            ends.append((machine.base @ soft.tips(q, bent) @ machine.tools["tool"])[:, :3, 3])
        np.testing.assert_allclose(-errors[:, :, k], 0.5 * (ends[0] - ends[1]), rtol=1e-5, atol=1e-12)


@pytest.mark.parametrize("observes", ["position", "pose"])
def test_regions_are_as_large_as_what_wind_up_leaves_out(observes: str) -> None:
    """Wind-up follows several readings at once, and that of the shoulder is far larger than any other."""
    inside, by_truth, _, _ = against_the_truth(winding, 60, 50, observes=observes)
    assert inside > 0.945
    assert 0.95 < by_truth < 1.2


def test_waves_of_what_slides_have_a_length_for_their_period() -> None:
    waves = Waves(np.array([2.0 * np.pi, 0.5]), np.full((2, 3), 1e-4))
    at = waves.at(np.array([[0.3, 0.1]]), np.ones((1, 1, 2)))
    assert at.shape == (1, 1, 12)
    assert at[0, 0, 6] == pytest.approx(1e-4 * np.cos(2.0 * np.pi * 0.1 / 0.5))
    np.testing.assert_allclose(waves.at(np.array([[0.3, 0.6]]), np.ones((1, 1, 2))), at, atol=1e-18)


def test_a_grid_knows_its_nodes_and_leaves_the_wrist() -> None:
    fit, _, _ = fitted(off=waving)
    plain = machine_of(fit)
    axes = [np.linspace(-0.4, 0.4, 3), np.linspace(-1.2, -0.4, 3), np.linspace(0.4, 1.2, 3)]
    nodes = np.zeros((27, 6))
    nodes[:, :3] = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    names = [reading.name for reading in fit.robot.readings]
    grid = grid_from_residuals(nodes, np.full((27, 3), 1e-4), fit.robot.readings, names[:3])
    machine = replace(plain, residual_model=grid)
    at_node = nodes[13][None]
    np.testing.assert_allclose(tool_errors(machine, at_node)[:, :3], 0.0, atol=1e-15)
    elsewhere, outside = at_node.copy(), at_node.copy()
    elsewhere[0, 3:] = 1.5
    outside[0, 0] = 2.0
    assert np.linalg.norm(tool_errors(machine, elsewhere)[:, :3]) > 1e-5
    np.testing.assert_allclose(tool_errors(machine, outside), tool_errors(plain, outside), rtol=1e-12)
    total = machine.known_uncertainty.position.total  # type: ignore[union-attr]
    assert share(machine, at_node, "residual_model") == pytest.approx(np.sqrt(3.0) * total)
    between = at_node + np.array([0.2, 0.2, 0.2, 0.0, 0.0, 0.0])
    assert share(machine, between, "residual_model") == pytest.approx(np.sqrt(3.0 / 8.0) * total)
    rows = np.concatenate([at_node, between, outside, at_node])
    covariance = own_errors(machine, fit.measurements[0], rows)
    single = [share(machine, rows[n : n + 1], "residual_model") ** 2 for n in range(4)]
    np.testing.assert_allclose(np.trace(covariance, axis1=2, axis2=3).diagonal(), single, atol=1e-18)
    # One node twice is one error; of the middle of the cell it makes up an eighth.
    np.testing.assert_allclose(covariance[0, 3], total**2 * np.eye(3), atol=1e-18)
    np.testing.assert_allclose(covariance[0, 1], total**2 / 8.0 * np.eye(3), atol=1e-18)


def test_a_process_leaves_what_it_does_not_know() -> None:
    fit, *_ = fitted(off=waving)
    (data,) = fit.measurements
    process = gaussian_from_residuals(data.readings, fit.residuals[0], fit.robot.readings)
    # Whole turns away an arm errs as here: what is far is so of a machine whose joints do not turn.
    process = replace(process, turning=())
    plain, machine = machine_of(fit), machine_of(fit, process)
    far = np.full((1, 6), 40.0)
    np.testing.assert_allclose(tool_errors(machine, far), tool_errors(plain, far), rtol=1e-6)
    assert share(machine, far, "residual_model") == pytest.approx(np.sqrt(3.0) * process.kernel.amplitude, rel=1e-6)
    near = data.readings[:5]
    rows = np.concatenate([near + 0.1, near[:1] + 0.1001, far])
    covariance = own_errors(machine, data, rows)
    single = [share(machine, rows[n : n + 1], "residual_model") ** 2 for n in range(7)]
    np.testing.assert_allclose(np.trace(covariance, axis1=2, axis2=3).diagonal(), single, rtol=1e-6)
    # Neighbours err alike, and what is far away for itself.
    np.testing.assert_allclose(covariance[0, 5], covariance[0, 0], rtol=0.05, atol=1e-3 * covariance[0, 0, 0, 0])
    np.testing.assert_allclose(covariance[0, 6], 0.0, atol=1e-18)
    assert np.linalg.norm(tool_errors(machine, near)[:, :3]) <= np.linalg.norm(tool_errors(plain, near)[:, :3])


def test_parameters_that_were_held_are_not_known() -> None:
    nearest = fitted()[0]
    minimal = calib.identify(nearest.model, nearest.measurements, null_space="minimal")
    assert minimal.held
    assert "which the sigmas of all others take for exact. " in rank_sentences(minimal)[0]
    limits = np.tile([[-np.pi, np.pi]], (6, 1))
    assert {p.name for p in errors_by_cause(minimal, limits).parameters} == {p.name for p in nearest.parameters}


def test_plain_json_of_the_budget() -> None:
    fit, *_ = fitted()
    found = calib.judging.uncertainty_map(machine_of(fit), 20)
    assert json.loads(json.dumps(rms_by_cause(found.budget))).keys() == set(CAUSES)


@pytest.mark.parametrize("kind", ["grid", "process"])
def test_errors_measured_in_one_set_up_leave_those_of_another(kind: str, tmp_path: Path) -> None:
    """A base that is known less well in one set-up is so beside errors that were measured in the other, too."""
    fit, *_ = fitted(off=waving)
    (data,) = fit.measurements
    both = calib.identify(fit.model, [data, data.subset(np.arange(12)).named(setup="few")])
    plain, axis = machine_of(both), np.linspace(-1.0, 1.0, 5)
    nodes = np.zeros((25, 6))
    nodes[:, :2] = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)
    if kind == "grid":
        names = [reading.name for reading in fit.robot.readings]
        model: GaussianResiduals | SectorGrid = grid_from_residuals(
            nodes, np.full((25, 3), 1e-4), fit.robot.readings, names[:2]
        )
    else:
        rows = np.random.default_rng(1).uniform(-1.0, 1.0, (300, 6))
        model = gaussian_from_residuals(rows, 2e-4 * np.sin(rows[:, :3]), fit.robot.readings)
    here = nodes[12:13] + 1e-9
    first = plain.setup
    standing = {
        name: replace(plain, residual_model=replace(model, setups=(name,))).at("few") for name in (first, "few")
    }
    own, other = (np.linalg.norm(tool_errors(standing[name], here)[:, :3]) for name in ("few", first))
    bases = [plain.at(name) for name in (first, "few")]
    apart = np.linalg.norm(
        bases[1].base[:3, :3].T @ tool_errors(bases[1], here)[0, :3]
        - bases[0].base[:3, :3].T @ tool_errors(bases[0], here)[0, :3]
    )
    assert own < 0.2 * apart
    assert other == pytest.approx(apart, rel=0.2)
    # And a file tells it.
    named = replace(model, setups=(first, "few"), tools=("ball",))
    path = tmp_path / "known.npz"
    path.write_bytes(gaussian_bytes(named) if isinstance(named, GaussianResiduals) else grid_bytes(named))
    read = (load_gaussian if kind == "process" else load_grid)(path, fit.robot.readings)
    assert (read.setups, read.tools) == ((first, "few"), ("ball",))


def test_errors_measured_with_one_tool_leave_those_of_another() -> None:
    fit, *_ = fitted(off=waving)
    (data,) = fit.measurements
    both = calib.identify(fit.model, [data, data.subset(np.arange(6)).named(tool="few")])
    plain, rows = machine_of(both), np.random.default_rng(1).uniform(-1.0, 1.0, (300, 6))
    model = gaussian_from_residuals(rows, 2e-4 * np.sin(rows[:, :3]), fit.robot.readings)

    def error(tools: tuple[str, ...]) -> float:
        machine = replace(plain, residual_model=replace(model, tools=tools))
        return float(np.linalg.norm(tool_errors(machine, rows[:1], "few")[:, :3]))

    apart = np.linalg.norm(tool_errors(plain, rows[:1], "few")[:, :3] - tool_errors(plain, rows[:1])[:, :3])
    assert error(("few",)) == error(("few", "tool")) < 0.2 * apart
    assert error(("tool",)) == pytest.approx(apart, rel=0.2)


def test_what_a_process_over_some_joints_scatters_by_moves_the_tool() -> None:
    """Errors of the wrist are none that a process over the first joints follows: they come at every pose anew."""
    fit, *_ = fitted(off=waving)
    rng, names = np.random.default_rng(4), [reading.name for reading in fit.robot.readings]
    readings = rng.uniform(-1.0, 1.0, (400, 6))

    def errors(q: Array) -> Array:
        return 2e-4 * np.stack([np.sin(q[:, 0]), np.cos(q[:, 1]), q[:, 0]], axis=1) + 5e-5 * np.sin(5.0 * q[:, 3:])

    plain = machine_of(fit)
    total = plain.known_uncertainty.position.total  # type: ignore[union-attr]
    seen = errors(readings) + rng.normal(scale=total, size=(400, 3))
    process = gaussian_from_residuals(readings, seen, fit.robot.readings, names[:3])
    machine = replace(plain, residual_model=process)
    new = rng.uniform(-1.0, 1.0, (200, 6))
    off = np.linalg.norm(process.at(new) - errors(new), axis=1)
    assert share(machine, new, "residual_model") == pytest.approx(np.sqrt(np.mean(off**2)), rel=0.15)
    some = new[:50]
    told = np.trace(own_errors(machine, fit.measurements[0], some), axis1=2, axis2=3).diagonal()
    assert np.sqrt(told.mean()) == pytest.approx(share(machine, some, "residual_model"), rel=1e-6)
    # Noise is no error of the tool.
    assert process.scatter(process.kernel.noise) == process.scatter(1.001 * process.kernel.noise) == 0.0
