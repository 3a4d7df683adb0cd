"""The case robots/irb2400: its URDF is the robot and closes; its data is what the script makes and the truth says."""

import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yourdfpy
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

import calib
from scripts.simulate import irb2400 as simulation

Array = NDArray[np.float64]

ROOT = Path(__file__).resolve().parents[2]
CASE = ROOT / "robots" / "irb2400"
SCRIPT = ROOT / "scripts/simulate/irb2400.py"
AXES = tuple(f"joint_{i}" for i in range(1, 7))
LIMITS_DEG = ((-180, 180), (-100, 110), (-60, 65), (-200, 200), (-120, 120), (-400, 400))
ROWS = {"base_fit": 10, "level1": 138, "level2": 60, "harmonics": 300, "nodes": 600, "test": 284}
REFLECTOR = np.array([0.025, 0.0, 0.04955])


@pytest.fixture(scope="module")
def robot() -> yourdfpy.URDF:
    return yourdfpy.URDF.load(str(CASE / "irb2400.urdf"))


@pytest.fixture(scope="module")
def truth() -> dict[str, Any]:
    return tomllib.loads((CASE / "truth.toml").read_text(encoding="utf-8"))


def random_axes(count: int, seed: int) -> Array:
    return np.random.default_rng(seed).uniform(*np.radians(LIMITS_DEG).T, (count, 6))


def link(robot: yourdfpy.URDF, q: Array, name: str) -> Array:
    robot.update_cfg(dict(zip(AXES, q, strict=True)))
    return robot.get_transform(name, "base_link")


def read_table(name: str) -> tuple[list[str], list[list[str]]]:
    lines = [line for line in (CASE / name).read_text(encoding="utf-8").splitlines() if not line.startswith("#")]
    return lines[0].split(", "), [line.split(", ") for line in lines[1:]]


def numbers(name: str) -> tuple[Array, Array]:
    """Commanded axes in rad and positions in m."""
    table = np.array([row[:9] for row in read_table(name)[1]], dtype=float)
    return np.radians(table[:, :6]), table[:, 6:] * 1e-3


def dh(theta: float, d: float, a: float, alpha: float, beta: float = 0.0) -> Array:
    """Rot(z, theta) Trans(a, 0, d) Rot(x, alpha) Rot(y, beta)."""
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_euler("ZXY", [theta, alpha, beta]).as_matrix()
    matrix[:3, 3] = a * np.cos(theta), a * np.sin(theta), d
    return matrix


def nominal_flange(q: Array) -> Array:
    """The DH product with the published lengths; the forearm's angle is axis 3, so the elbow's is axis 3 - axis 2."""
    right = 0.5 * np.pi
    rows = (
        (q[0], 0.615, 0.1, -right),
        (q[1] - right, 0.0, 0.705, 0.0),
        (q[2] - q[1], 0.0, 0.135, -right),
        (q[3], 0.755, 0.0, right),
        (q[4], 0.0, 0.0, -right),
        (q[5] + np.pi, 0.085, 0.0, 0.0),
    )
    return np.linalg.multi_dot([dh(*row) for row in rows])


# ---- the URDF


def test_names_limits_and_drivers(robot: yourdfpy.URDF) -> None:
    assert set(robot.actuated_joint_names) == set(AXES)
    for name, limits in zip(AXES, np.radians(LIMITS_DEG), strict=True):
        limit = robot.joint_map[name].limit
        np.testing.assert_allclose([limit.lower, limit.upper], limits, atol=1e-15)


def test_home_is_lower_arm_up_forearm_to_the_front_crank_to_the_back(robot: yourdfpy.URDF) -> None:
    home = np.zeros(6)
    expected = {
        "lower_arm": (0.1, 0, 0.615),
        "forearm": (0.1, 0, 1.32),
        "rod": (-0.08, 0, 0.615),
        "rod_end": (-0.08, 0, 1.32),
        "wrist_bend": (0.855, 0, 1.455),
        "tool0": (0.94, 0, 1.455),
    }
    for name, position in expected.items():
        np.testing.assert_allclose(link(robot, home, name)[:3, 3], position, atol=1e-15)
    np.testing.assert_allclose(link(robot, home, "tool0")[:3, :3], [[0, 0, 1], [0, 1, 0], [-1, 0, 0]], atol=1e-15)


def test_signs_of_axes_2_and_3(robot: yourdfpy.URDF) -> None:
    forward, down = np.array([0, 0.1, 0, 0, 0, 0]), np.array([0, 0, 0.1, 0, 0, 0])
    assert link(robot, forward, "forearm")[0, 3] > 0.1
    assert link(robot, down, "wrist_bend")[2, 3] < 1.455
    # The forearm keeps its direction when the lower arm leans.
    np.testing.assert_allclose(link(robot, forward, "forearm")[:3, :3], np.eye(3), atol=1e-15)


def test_the_flange_is_the_dh_product(robot: yourdfpy.URDF) -> None:
    for q in random_axes(50, 0):
        np.testing.assert_allclose(link(robot, q, "tool0"), nominal_flange(q), atol=2e-15)


def test_the_toolkit_reads_the_same_flange() -> None:
    arm = calib.load_robot(CASE / "irb2400.urdf", tip="tool0")
    assert tuple(reading.name for reading in arm.readings) == AXES
    q = random_axes(50, 1)
    np.testing.assert_allclose(arm.tips(q), [nominal_flange(row) for row in q], atol=3e-15)


def test_the_ideal_parallelogram_closes_at_every_pose(robot: yourdfpy.URDF) -> None:
    for q in random_axes(100, 2):
        rod_end, pin = link(robot, q, "rod_end"), link(robot, q, "rear_lever_pin")
        assert np.abs(rod_end[:3, 3] - pin[:3, 3]).max() < 1e-15


def test_the_ideal_parallelogram_closes_in_plain_trigonometry() -> None:
    q2, q3 = random_axes(1000, 3)[:, 1:3].T
    # x and z of crank and rod, and of lower arm and rear lever, from the shoulder; each at its absolute angle.
    crank, rod = [-0.18 * np.cos(q3), 0.18 * np.sin(q3)], [0.705 * np.sin(q2), 0.705 * np.cos(q2)]
    elbow = -q2 + q3
    lever = [-0.18 * np.cos(q2 + elbow), 0.18 * np.sin(q2 + elbow)]
    assert np.abs(np.add(crank, rod) - np.add(rod, lever)).max() < 1e-15


def test_masses_are_those_of_the_simulation_and_add_up(robot: yourdfpy.URDF) -> None:
    masses = {name: body.inertial for name, body in robot.link_map.items() if body.inertial is not None}
    assert sum(inertial.mass for inertial in masses.values()) == pytest.approx(380.0)
    for name, (mass, centre) in simulation.MASSES.items():
        assert masses[name].mass == mass
        np.testing.assert_allclose(masses[name].origin[:3, 3] * 1e3, centre, atol=1e-12)
    assert set(masses) == {*simulation.MASSES, "base_link", "turret"}
    for inertial in masses.values():
        moments = np.diag(inertial.inertia)
        assert moments.min() > 0.0
        assert 2.0 * moments.max() < moments.sum()


def test_gravity_torques_are_the_slope_of_the_urdf_s_potential(robot: yourdfpy.URDF) -> None:
    bodies = {name: body.inertial for name, body in robot.link_map.items() if body.inertial is not None}

    def potential(q: Array) -> float:
        robot.update_cfg(dict(zip(AXES, q, strict=True)))
        return sum(
            9.81 * body.mass * (robot.get_transform(name, "base_link") @ body.origin[:, 3])[2]
            for name, body in bodies.items()
        )

    for q in random_axes(5, 4):
        slope = [(potential(q + h) - potential(q - h)) / 2e-5 for h in 1e-5 * np.eye(6)]
        np.testing.assert_allclose(simulation.gravity_torques(q[None])[0], slope, atol=1e-5)


# ---- the four-bar

LENGTHS = {"L2": 705.21, "b": 179.86, "c": 704.93, "e": 180.17}


def u(t: Array) -> Array:
    return np.stack([np.cos(t), np.sin(t)])


def assembled(count: int, seed: int) -> tuple[Array, Array]:
    """Angles of lower arm and crank, 25 to 155 deg apart."""
    rng = np.random.default_rng(seed)
    phi2 = np.radians(rng.uniform(-20.0, 190.0, count))
    return phi2, phi2 + np.radians(rng.uniform(25.0, 155.0, count))


def test_the_four_bar_closes() -> None:
    phi2, psi = assembled(1000, 0)
    for mirrored in (1.0, -1.0):
        phi, gamma = simulation.four_bar(mirrored * phi2, mirrored * psi, **LENGTHS, dx=0.07, dy=-0.04)
        left = LENGTHS["L2"] * u(mirrored * phi2) + LENGTHS["e"] * u(phi)
        right = np.array([[0.07], [-0.04]]) + LENGTHS["b"] * u(mirrored * psi) + LENGTHS["c"] * u(gamma)
        assert np.abs(left - right).max() < 1e-10
        # On the branch of the parallelogram, not the crossed one.
        assert np.abs(phi - mirrored * psi).max() < 0.02


def test_an_ideal_four_bar_is_a_parallelogram() -> None:
    phi2, psi = assembled(1000, 1)
    phi, gamma = simulation.four_bar(phi2, psi, 705.0, 180.0, 705.0, 180.0)
    np.testing.assert_allclose(phi, psi, atol=1e-13)
    np.testing.assert_allclose(np.exp(1j * gamma), np.exp(1j * phi2), atol=1e-13)


def test_partial_derivatives_of_the_four_bar() -> None:
    phi2, psi = assembled(200, 2)
    values = {"phi2": phi2, "psi": psi, **LENGTHS}
    phi, gamma = simulation.four_bar(**values)
    S = LENGTHS["e"] * np.sin(gamma - phi)
    expected = {
        "L2": -np.cos(phi2 - gamma) / S,
        "e": -np.cos(phi - gamma) / S,
        "b": np.cos(psi - gamma) / S,
        "c": 1.0 / S,
        "psi": LENGTHS["b"] * np.sin(gamma - psi) / S,
        "phi2": -LENGTHS["L2"] * np.sin(gamma - phi2) / S,
    }
    for name, derivative in expected.items():
        h = 1e-4 if name in ("psi", "phi2") else 1e-2
        steps = [simulation.four_bar(**values | {name: values[name] + k * h})[0] for k in (-2, -1, 1, 2)]
        found = np.dot([1.0, -8.0, 8.0, -1.0], steps) / (12.0 * h)
        np.testing.assert_allclose(found, derivative, atol=1e-8)


@pytest.mark.parametrize(("largest_mrad", "wrong_mrad"), [(2.8, 0.007), (27.0, 0.66)])
def test_first_order_form_of_the_four_bar(largest_mrad: float, wrong_mrad: float) -> None:
    """phi - psi = k0 + k1 csc(alpha) + k2 cot(alpha), k1 = (dL2 - dc) / r, k2 = (de - db) / r, alpha 25 to 155 deg.

    How wrong it is depends on the links: the stated value is a usual one where k0 = 0 and k1, k2 are those of the
    links, and an upper bound where all three are fitted.
    """
    rng = np.random.default_rng(3)
    alpha = np.radians(np.linspace(25.0, 155.0, 200))
    columns = np.stack([np.ones_like(alpha), 1.0 / np.sin(alpha), 1.0 / np.tan(alpha)], axis=1)
    assert np.linalg.cond(columns) == pytest.approx(8.0, abs=0.2)
    given, fitted = [], []
    for dL2, de, db, dc in rng.standard_normal((200, 4)):
        k = np.array([0.0, dL2 - dc, de - db]) / 180.0
        size = largest_mrad * 1e-3 / np.abs(columns @ k).max()
        links = {"L2": 705.0 + size * dL2, "b": 180.0 + size * db, "c": 705.0 + size * dc, "e": 180.0 + size * de}
        psi = 0.5 * np.pi + alpha
        exact = simulation.four_bar(np.full_like(alpha, 0.5 * np.pi), psi, **links)[0] - psi
        best = np.linalg.lstsq(columns, exact, rcond=None)[0]
        given.append(np.abs(exact - columns @ k * size).max() * 1e3)
        fitted.append(np.abs(exact - columns @ best).max() * 1e3)
    assert np.quantile(given, 0.05) < wrong_mrad < np.quantile(given, 0.95)
    assert max(fitted) < wrong_mrad


def test_a_crank_beside_the_shaft_of_the_lower_arm() -> None:
    phi2, psi = assembled(500, 4)
    dx, dy = 0.03, -0.05
    phi, _ = simulation.four_bar(phi2, psi, 705.0, 180.0, 705.0, 180.0, dx, dy)
    first_order = -(dx * np.cos(phi2) + dy * np.sin(phi2)) / (180.0 * np.sin(psi - phi2))
    np.testing.assert_allclose(phi - psi, first_order, atol=2e-6)


# ---- repeatability


def test_repeatability_from_one_side_is_that_of_iso_9283() -> None:
    assert simulation.scatter_sigma() == pytest.approx(16.6e-3, abs=0.05e-3)
    pose = simulation.poses(7)["test"][:1]
    cloud = simulation.Machine().tcp(np.repeat(pose, 40_000, axis=0), np.random.default_rng(0))
    distances = np.linalg.norm(cloud - cloud.mean(axis=0), axis=1)
    rp = distances.mean() + 3.0 * np.sqrt(((distances - distances.mean()) ** 2).sum() / (len(distances) - 1))
    assert rp == pytest.approx(0.060, rel=0.01)
    assert simulation.repeatability(cloud) == pytest.approx(rp, rel=1e-12)


def test_repeatability_from_both_sides_is_that_of_iso_9283() -> None:
    machine, poses, rng = simulation.Machine(), simulation.poses(7)["test"], np.random.default_rng(1)
    sides = np.stack([machine.tcp(poses), machine.tcp(poses, direction=-1.0)], axis=1)
    clouds = np.repeat(sides, 1000, axis=1) + simulation.scatter_sigma() * rng.standard_normal((len(poses), 2000, 3))
    assert np.mean([simulation.repeatability(cloud) for cloud in clouds]) == pytest.approx(0.157, rel=0.005)


def test_approach_from_the_usual_side_is_the_default() -> None:
    machine, poses = simulation.Machine(), simulation.poses(7)["test"]
    np.testing.assert_array_equal(machine.tcp(poses), machine.tcp(poses, direction=1.0))
    per_axis = machine.tcp(poses, direction=-np.ones((284, 6)))
    np.testing.assert_array_equal(machine.tcp(poses, direction=-1.0), per_axis)
    assert np.linalg.norm(per_axis - machine.tcp(poses), axis=1).mean() > 0.15


def test_tracker_noise_is_half_of_the_data_sheet_s() -> None:
    np.testing.assert_allclose(simulation.tracker_sigma(np.array([[3000.0, 0, 0], [0, 1000.0, 0]])), [0.0165, 0.0105])


# ---- the data


def test_script_reproduces_the_committed_files(tmp_path: Path) -> None:
    subprocess.run([sys.executable, str(SCRIPT), str(tmp_path)], check=True, capture_output=True)
    made = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    shipped = {path.name: path.read_bytes() for path in CASE.iterdir() if path.suffix == ".csv"}
    assert made == shipped | {"truth.toml": (CASE / "truth.toml").read_bytes()}
    assert sum(map(len, made.values())) < 1_500_000


@pytest.mark.parametrize("name", ROWS)
def test_tables(name: str) -> None:
    header, rows = read_table(f"{name}.csv")
    assert header == [*(f"{axis} [deg]" for axis in AXES), "x [mm]", "y [mm]", "z [mm]"]
    assert len(rows) == ROWS[name]
    arm = calib.load_robot(CASE / "irb2400.urdf", tip="tool0")
    data = calib.read_measurements(CASE / f"{name}.csv", arm)
    q, positions = numbers(f"{name}.csv")
    np.testing.assert_allclose(data.readings, q, atol=1e-15)
    np.testing.assert_allclose(data.position, positions, atol=1e-12)
    limits = np.radians(LIMITS_DEG)
    assert (q >= limits[:, 0]).all()
    assert (q <= limits[:, 1]).all()


def test_every_random_pose_is_inside_a_cell_of_nodes() -> None:
    nodes = {tuple(row) for row in np.round(np.degrees(numbers("nodes.csv")[0][:, :3])).astype(int).tolist()}
    for name in ("base_fit", "level2", "harmonics", "test"):
        low = np.floor(np.degrees(numbers(f"{name}.csv")[0][:, :3]) / 20.0).astype(int) * 20
        for corner in np.ndindex(2, 2, 2):
            assert {tuple(row) for row in (low + 20 * np.array(corner)).tolist()} <= nodes


def true_reflector(truth: dict[str, Any], commands: Array) -> Array:
    """Position (m) in the tracker's frame that the truth file predicts, written out again.

    The four-bar is solved numerically, gravity torques are taken from the script: they are held against the URDF above.
    """
    geometry, bars, waves = truth["dh"], truth["four_bar"], truth["harmonics"]
    da, dd = np.array(geometry["da_mm"]) * 1e-3, np.array(geometry["dd_mm"]) * 1e-3
    dalpha, dtheta = np.array(geometry["dalpha_urad"]) * 1e-6, np.array(geometry["dtheta_urad"]) * 1e-6
    compliance = np.array(truth["wind_up"]["compliance_urad_per_Nm"]) * 1e-6
    q = commands - compliance * simulation.gravity_torques(commands[None])[0] + dtheta
    for order, cosine, sine in zip(
        waves["orders"], np.transpose(waves["cosines_urad"]), np.transpose(waves["sines_urad"]), strict=True
    ):
        q = q + 1e-6 * (cosine * np.cos(order * commands) + sine * np.sin(order * commands))

    def gap(passive: Array) -> Array:
        """From the rod's end to the lever's pin, x forward and z up, at the rod's and the forearm's absolute angles."""
        rod, forearm = passive
        crank, lever = 0.18 + bars["crank_mm"] * 1e-3, 0.18 + bars["rear_lever_mm"] * 1e-3
        x = np.array(bars["coaxiality_mm"]) * 1e-3 + crank * np.array([-np.cos(q[2]), np.sin(q[2])])
        x = x + (0.705 + bars["rod_mm"] * 1e-3) * np.array([np.sin(rod), np.cos(rod)])
        elbow = (0.705 + da[1]) * np.array([np.sin(q[1]), np.cos(q[1])])
        return x - elbow - lever * np.array([-np.cos(forearm), np.sin(forearm)])

    passive = least_squares(gap, [q[1], q[2]], method="lm", xtol=1e-15, ftol=1e-15, gtol=1e-15).x
    theta = q + np.array([0.0, -0.5, 0.0, 0.0, 0.0, 1.0]) * np.pi
    theta[2] = passive[1] - q[1]
    d, a = np.array([0.615, 0, 0, 0.755, 0, 0.085]) + dd, np.array([0.1, 0.705, 0.135, 0, 0, 0]) + da
    alpha = np.array([-0.5, 0.0, -0.5, 0.5, -0.5, 0.0]) * np.pi + dalpha
    frame = np.eye(4)
    frame[:3, :3] = Rotation.from_euler("XYZ", truth["base_rotation_deg"], degrees=True).as_matrix()
    frame[:3, 3] = np.array(truth["base_translation_mm"]) * 1e-3
    for i in range(6):
        frame = frame @ dh(theta[i], d[i], a[i], alpha[i], geometry["beta_2_urad"] * 1e-6 if i == 1 else 0.0)
    return frame[:3, :3] @ np.array(truth["reflector_in_flange_mm"]) * 1e-3 + frame[:3, 3]


def test_truth_file_predicts_the_true_positions(truth: dict[str, Any]) -> None:
    commands, positions = numbers("test_truth.csv")
    predicted = [true_reflector(truth, q) for q in commands]
    # The file's last digit is 0.1 um.
    assert np.abs(predicted - positions).max() < 0.07e-6


@pytest.mark.parametrize("name", ROWS)
def test_measurements_are_the_truth_and_the_noise(name: str) -> None:
    commands, positions = numbers(f"{name}.csv")
    true = simulation.Machine().tcp(np.degrees(commands))
    sigma = np.hypot(simulation.scatter_sigma(), simulation.tracker_sigma(true))[:, None]
    deviates = (positions * 1e3 - true) / sigma
    assert np.sqrt(np.mean(deviates**2)) == pytest.approx(1.0, abs=3.0 / np.sqrt(2.0 * deviates.size))
    assert abs(deviates.mean()) < 3.0 / np.sqrt(deviates.size)
    assert np.abs(deviates).max() < 4.5


def test_both_sides() -> None:
    header, rows = read_table("test_both_sides.csv")
    assert header[-1] == "direction"
    commands, positions = numbers("test_both_sides.csv")
    np.testing.assert_array_equal(commands, numbers("test.csv")[0])
    direction = np.array([{"+": 1.0, "-": -1.0}[row[-1]] for row in rows])[:, None]
    assert 100 < (direction > 0.0).sum() < 184
    errors = positions * 1e3 - simulation.Machine().tcp(np.degrees(commands), direction=direction)
    assert np.sqrt(np.mean(errors**2)) == pytest.approx(0.024, rel=0.15)


def fitted_errors(commands: Array, positions: Array) -> Array:
    """Distances of the nominal robot once its base and its reflector are fitted, from a start a user would have."""
    flanges = np.stack([nominal_flange(q) for q in commands])

    def misses(x: Array) -> Array:
        points = flanges[:, :3, :3] @ x[6:] + flanges[:, :3, 3]
        return Rotation.from_rotvec(x[:3]).apply(points) + x[3:6] - positions

    start = np.array([0.0, 0.0, 2.4, 2.8, -1.0, -0.4, *REFLECTOR])
    fit = least_squares(lambda x: misses(x).ravel(), start, x_scale=[1, 1, 1, 1, 1, 1, 0.1, 0.1, 0.1])
    return np.linalg.norm(misses(fit.x), axis=1)


def test_the_nominal_robot_starts_where_the_paper_s_did() -> None:
    errors = fitted_errors(*numbers("test_truth.csv"))
    assert errors.mean() == pytest.approx(0.42e-3, rel=2e-4)
    assert errors.max() == pytest.approx(1.618e-3, rel=1e-3)
    # And as measured, scatter and tracker included.
    assert fitted_errors(*numbers("test.csv")).mean() == pytest.approx(0.42e-3, rel=0.01)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_every_seed_is_another_robot_with_the_same_start(seed: int) -> None:
    commands = simulation.poses(seed)["test"]
    errors = fitted_errors(np.radians(commands), simulation.Machine(seed).tcp(commands) * 1e-3)
    assert errors.mean() == pytest.approx(0.42e-3, rel=2e-4)


def test_effects_can_be_switched_off() -> None:
    commands = simulation.poses(7)["test"]
    full, plain = simulation.Machine(), simulation.Machine(wind_up=False, harmonics=False)
    assert not plain.truth.compliances.any()
    assert not plain.truth.cosines.any()
    assert not plain.truth.sines.any()
    assert plain.truth.rod == full.truth.rod
    np.testing.assert_array_equal(plain.truth.da, full.truth.da)
    moved = np.linalg.norm(plain.tcp(commands) - full.tcp(commands), axis=1)
    assert 0.05 < moved.mean() < 0.3


def test_the_job_names_what_is_there(robot: yourdfpy.URDF) -> None:
    job = tomllib.loads((CASE / "calibration.toml").read_text(encoding="utf-8"))
    assert job["robot"]["tip"] in robot.link_map
    (loop,) = job["robot"]["loop"]
    assert set(loop["frames"]) <= set(robot.link_map)
    assert set(loop["passive"]) <= set(robot.joint_map)
    files = {section["file"] for section in job["measurements"]}
    assert all((CASE / file).is_file() for file in files)
    assert all(set(level["measurements"]) <= files for level in job["levels"])
