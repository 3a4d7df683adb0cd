"""Joint zero offsets of a 6-joint articulated CMM (Ye Dong et al.): the printed tables, and more than they show.

The printed numbers are in robots/arm_cmm/papers/zero_offsets.toml. The points come from DH rows written out here.
"""

import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import calib
from calib.assessment.sensitivity import error_coefficients
from calib.identification.total_differential import Trace, total_differential

Array = NDArray[np.float64]

ROOT = Path(__file__).resolve().parents[2]
PAPERS = ROOT / "robots" / "arm_cmm" / "papers"
PAPER: dict[str, Any] = tomllib.loads((PAPERS / "zero_offsets.toml").read_text(encoding="utf-8"))
MACHINE = PAPER["machine"]
OFFSETS = np.array(MACHINE["offset"])
SIMULATIONS = PAPER["simulation"]
HALF_DIGIT = 0.0005
EVERY = pytest.mark.parametrize("simulation", SIMULATIONS, ids=["simulation 1", "simulation 2", "simulation 3"])


def mended(row: dict[str, Any]) -> dict[str, Any]:
    return row | row.get("corrected", {})


def point(readings_deg: Array, offsets_deg: Array, a: Array | float = 0.0) -> Array:
    """Probe position (3,) in mm: the product of the standard DH rows."""
    T = np.eye(4)
    thetas = np.radians([*(np.asarray(readings_deg) + offsets_deg), 0.0])
    for theta, d, alpha, a_i in zip(
        thetas, MACHINE["d"], np.radians(MACHINE["alpha"]), np.broadcast_to(a, 7), strict=True
    ):
        ct, st, ca, sa = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
        T = T @ [[ct, -st * ca, st * sa, a_i * ct], [st, ct * ca, -ct * sa, a_i * st], [0, sa, ca, d], [0, 0, 0, 1]]
    return T[:3, 3]


def points(readings_deg: Array, offsets_deg: Array) -> Array:
    return np.array([point(q, offsets_deg) for q in readings_deg])


@pytest.fixture(scope="module")
def model() -> calib.ErrorModel:
    robot = calib.load_robot(PAPERS / "zero_offsets.urdf", tip="probe")
    return calib.error_model(robot, offsets="all", base="fixed", tool="fixed")


def follow(model: calib.ErrorModel, readings_deg: Array, points_mm: Array, **options: Any) -> Trace:
    columns = {f"joint_{i + 1} [deg]": column for i, column in enumerate(np.transpose(readings_deg).astype(float))}
    columns |= {f"{axis} [mm]": column for axis, column in zip("xyz", np.transpose(points_mm), strict=True)}
    return total_differential(model, calib.read_measurements(columns, model.robot), **options)


def as_published(model: calib.ErrorModel, simulation: dict[str, Any]) -> Trace:
    q = simulation["angles"]
    return follow(model, q, points(q, OFFSETS), stop=PAPER["stop"] * 1e-3, rounding=PAPER["rounding"])


def test_urdf_is_what_the_script_makes_and_the_dh_product(model: calib.ErrorModel, tmp_path: Path) -> None:
    script = ROOT / "scripts/studies/arm_cmm_tables.py"
    subprocess.run([sys.executable, str(script), "--urdf", str(tmp_path / "x.urdf")], check=True, capture_output=True)
    assert (tmp_path / "x.urdf").read_bytes() == (PAPERS / "zero_offsets.urdf").read_bytes()
    q = np.random.default_rng(0).uniform(-180.0, 180.0, (50, 6))
    tips = model.robot.tips(np.radians(q))[:, :3, 3] * 1e3
    assert np.max(np.abs(tips - points(q, np.zeros(6)))) < 1e-9


@EVERY
def test_points_and_errors_before_calibration(model: calib.ErrorModel, simulation: dict[str, Any]) -> None:
    q = simulation["angles"]
    touched = points(q, OFFSETS)
    assert np.max(np.abs(touched - simulation["position"])) <= HALF_DIGIT
    start = follow(model, q, touched, stop=1.0).iterations[0]
    assert np.max(np.abs(start.errors * 1e3 - mended(simulation)["error"])) <= HALF_DIGIT


def test_printed_error_that_is_cut_and_lengths_that_were_not_used() -> None:
    off = [abs(p - m) > HALF_DIGIT for s in SIMULATIONS for p, m in zip(s["error"], mended(s)["error"], strict=True)]
    assert off.count(True) == 1
    with_a = [
        point(q, OFFSETS, MACHINE["a"]) - p
        for s in SIMULATIONS
        for q, p in zip(s["angles"], s["position"], strict=True)
    ]
    assert np.max(np.abs(with_a)) == pytest.approx(0.039, abs=0.001)


@EVERY
def test_iterations_with_rounding(model: calib.ErrorModel, simulation: dict[str, Any]) -> None:
    trace = as_published(model, simulation)
    last = len(trace.iterations) - 1
    for k, row in enumerate(map(mended, simulation["iteration"]), 1):
        at = trace.iterations[min(k, last)]
        assert np.max(np.abs(np.degrees(at.values) - row["offset"])) <= 0.001
        assert np.max(np.abs(at.errors * 1e3 - row["error"])) <= 0.001
    assert np.round(trace.values * 1e3).tolist() == [42, -36, -26, 38, 21, -31]


@EVERY
def test_first_iteration_has_no_misprint(simulation: dict[str, Any]) -> None:
    assert "corrected" not in simulation["iteration"][0]


def test_simulation_1_comes_to_rest_above_the_limit(model: calib.ErrorModel) -> None:
    reasons = [as_published(model, simulation) for simulation in SIMULATIONS]
    assert [t.reason for t in reasons] == ["the estimate repeats", "below the limit", "below the limit"]
    assert reasons[0].iterations[-1].largest == pytest.approx(0.406e-3, abs=0.5e-6)
    assert reasons[0].iterations[-1].values.tolist() == reasons[0].iterations[-2].values.tolist()


def test_residuals_printed_in_simulation_1_step_2_are_those_of_30_mrad() -> None:
    simulation = SIMULATIONS[0]
    row, q = simulation["iteration"][1], simulation["angles"]
    carried = np.degrees(np.array([42, -36, -26, 38, 30, -31]) * 1e-3)
    errors = np.linalg.norm(points(q, OFFSETS) - points(q, carried), axis=1)
    assert np.max(np.abs(errors - row["error"])) <= HALF_DIGIT


@EVERY
def test_unrounded_from_points_at_full_precision(model: calib.ErrorModel, simulation: dict[str, Any]) -> None:
    q = simulation["angles"]
    trace = follow(model, q, points(q, OFFSETS), stop=0.0)
    after = [at.errors * 1e3 for at in trace.iterations]
    assert after[1].min() > 0.7
    assert after[1].max() < 2.2
    assert after[2].max() <= 0.0104
    assert np.max(np.abs(np.degrees(trace.iterations[4].values) - OFFSETS)) < 1e-9
    assert np.max(np.abs(np.degrees(trace.values) - OFFSETS)) < 1e-9


@EVERY
def test_printed_points_carry_their_rounding(model: calib.ErrorModel, simulation: dict[str, Any]) -> None:
    trace = follow(model, simulation["angles"], simulation["position"], stop=0.0)
    assert np.max(np.abs(np.degrees(trace.values) - OFFSETS)) < 3e-4


def test_condition_of_the_jacobian(model: calib.ErrorModel) -> None:
    found = [
        np.linalg.cond(error_coefficients(model, np.radians(s["angles"])).matrix.reshape(9, 6)) for s in SIMULATIONS
    ]
    assert [round(condition) for condition in found] == [11, 10, 19]


def test_200_random_sets_converge_from_zero(model: calib.ErrorModel) -> None:
    rng = np.random.default_rng(4)
    for _ in range(200):
        q, offsets = rng.uniform(-180.0, 180.0, (3, 6)), rng.uniform(-3.0, 3.0, 6)
        trace = follow(model, q, points(q, offsets), stop=0.0)
        assert np.max(np.abs(np.degrees(trace.values) - offsets)) < 1e-9
