"""Error model of a multi-joint CMM (Ye Dong, Huang Qingcheng, Che Rensheng): the printed tables.

The printed numbers are in robots/arm_cmm/papers/error_model.toml. A second opinion comes from DH rows written out here.
"""

import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import calib
from calib.assessment.sensitivity import error_coefficients, exact_error, group_study, predicted_error, sensitivity

Array = NDArray[np.float64]
Errors = dict[str, float]

CASE = Path(__file__).resolve().parents[2] / "robots" / "arm_cmm"
PAPER: dict[str, Any] = tomllib.loads((CASE / "papers" / "error_model.toml").read_text(encoding="utf-8"))
NOMINAL, GIVEN = PAPER["nominal"], PAPER["errors"]
PRINTED = PAPER["pose"]
ROWS = [row | row.get("corrected", {}) for row in PRINTED]
Q = np.radians([row["angles"] for row in ROWS])
OF_A = np.array([row["set"] == "A" for row in ROWS])
HALF_DIGIT = 0.0005

JOINTS = [f"joint_{i}" for i in range(1, 7)]
NAMES = {
    "a": [f"{joint}.a" for joint in JOINTS],
    "d": [f"{joint}.d" for joint in [*JOINTS, "handle_mount"]],
    "alpha": [f"{joint}.alpha" for joint in JOINTS],
    "offset": [f"{joint}.offset" for joint in JOINTS],
}
D_7 = NAMES["d"][-1]


def named(alpha: Array, theta: Array) -> Errors:
    """The 25 errors in m and rad; ``alpha`` and ``theta`` in rad."""
    values = {"a": np.multiply(GIVEN["a"], 1e-3), "d": np.multiply(GIVEN["d"], 1e-3), "alpha": alpha, "offset": theta}
    return {name: float(v) for group, names in NAMES.items() for name, v in zip(names, values[group], strict=False)}


SETS = {s: named(np.radians(GIVEN[s]["alpha"]), np.radians(GIVEN[s]["theta"])) for s in "AB"}


def model_with(**options: Any) -> calib.ErrorModel:
    robot = calib.load_robot(CASE / "arm_cmm.urdf", tip="probe")
    numbers = [*NAMES["a"], *NAMES["d"], *NAMES["alpha"]]
    return calib.error_model(robot, offsets="all", placements=calib.dh.Free(numbers), **options)


@pytest.fixture(scope="module")
def model() -> calib.ErrorModel:
    return model_with(base="fixed", tool="fixed")


def mm(vectors: Array) -> Array:
    return np.linalg.norm(vectors, axis=1) * 1e3


def true(model: calib.ErrorModel, errors: Errors | None = None) -> Array:
    """|E| (20,) in mm, by default of every row's own set."""
    if errors is not None:
        return mm(exact_error(model, Q, errors))
    return np.where(OF_A, true(model, SETS["A"]), true(model, SETS["B"]))


def linear(model: calib.ErrorModel, *without: str) -> Array:
    """|dP| (20,) in mm of every row's own set."""
    a, b = ({name: v for name, v in SETS[s].items() if name not in without} for s in "AB")
    return np.where(OF_A, mm(predicted_error(model, Q, a)), mm(predicted_error(model, Q, b)))


def column(name: str, rows: list[dict[str, Any]] = ROWS) -> Array:
    return np.array([row[name] for row in rows])


def point(q: Array, errors: Errors) -> Array:
    """Probe position (3,) in m: the product of the standard DH rows with the errors added to their entries."""
    T = np.eye(4)
    for joint, reading, *row in zip(
        [*JOINTS, "handle_mount"], [*q, 0.0], NOMINAL["d"], NOMINAL["a"], NOMINAL["alpha"], strict=True
    ):
        theta, d = reading + errors.get(f"{joint}.offset", 0.0), row[0] * 1e-3 + errors[f"{joint}.d"]
        a, alpha = row[1] * 1e-3 + errors.get(f"{joint}.a", 0.0), np.radians(row[2]) + errors.get(f"{joint}.alpha", 0.0)
        ct, st, ca, sa = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
        T = T @ [[ct, -st * ca, st * sa, a * ct], [st, ct * ca, -ct * sa, a * st], [0, sa, ca, d], [0, 0, 0, 1]]
    return T[:3, 3]


def test_the_model_has_the_25_parameters(model: calib.ErrorModel) -> None:
    names = [name for of_group in NAMES.values() for name in of_group]
    assert sorted(error_coefficients(model, Q).names) == sorted(names)
    assert len(names) == 25


def test_exact_error_is_that_of_the_dh_product(model: calib.ErrorModel) -> None:
    nothing = dict.fromkeys(SETS["A"], 0.0)
    for errors in (SETS["A"], SETS["B"], {name: 20.0 * value for name, value in SETS["A"].items()}):
        expected = [point(q, errors) - point(q, nothing) for q in Q]
        assert np.max(np.abs(exact_error(model, Q, errors) - expected)) < 1e-14


def test_nominal_positions(model: calib.ErrorModel) -> None:
    off = np.abs(model.robot.tips(Q)[:, :3, 3] * 1e3 - column("position")) > HALF_DIGIT
    assert not off.any()


def test_misprints_are_no_more_than_those_named() -> None:
    changed = {k + 1: sorted(row["corrected"]) for k, row in enumerate(PRINTED) if "corrected" in row}
    assert changed == {9: ["angles"], 10: ["position"], 11: ["position"], 13: ["position"], 16: ["error"]}
    different = [
        np.flatnonzero(np.not_equal(PRINTED[k - 1]["position"], ROWS[k - 1]["position"])).tolist() for k in (10, 11, 13)
    ]
    assert different == [[0], [2], [0, 1, 2]]


def test_row_13_prints_the_actual_position(model: calib.ErrorModel) -> None:
    actual = model.robot.tips(Q[12:13])[:, :3, 3] + exact_error(model, Q[12:13], SETS["B"])
    assert np.max(np.abs(actual * 1e3 - PRINTED[12]["position"])) <= HALF_DIGIT


def test_true_errors(model: calib.ErrorModel) -> None:
    assert np.max(np.abs(true(model) - column("error"))) <= HALF_DIGIT
    as_printed = np.abs(true(model) - column("error", PRINTED)) <= HALF_DIGIT
    assert np.flatnonzero(~as_printed).tolist() == [15]


def test_linear_errors_are_sums_of_24_terms(model: calib.ErrorModel) -> None:
    assert np.max(np.abs(linear(model, D_7) - column("linear"))) <= HALF_DIGIT
    assert np.min(np.abs(linear(model) - column("linear"))) > HALF_DIGIT


def test_linear_errors_of_25_terms_are_near_the_true_ones(model: calib.ErrorModel) -> None:
    assert np.max(np.abs(linear(model) - true(model))) < 0.002


def test_angle_errors_as_printed_in_rad_miss(model: calib.ErrorModel) -> None:
    radians = named(np.array(GIVEN["alpha_rad"]), np.array(GIVEN["theta_rad"]))
    assert np.max(np.abs(true(model, radians) - column("error"))) == pytest.approx(0.083, abs=0.0005)


def test_one_set_cannot_serve_rows_3_and_12(model: calib.ErrorModel) -> None:
    for errors in SETS.values():
        values = true(model, errors)
        assert values[2] == pytest.approx(values[11], abs=1e-12)
    assert PRINTED[2]["error"] != PRINTED[11]["error"]


def test_rank_and_null_space(model: calib.ErrorModel) -> None:
    found = sensitivity(model, Q)
    assert (found.rank, len(found.parameters)) == (23, 25)
    directions = {frozenset(direction.shares): direction.shares for direction in found.undetermined}
    offset = directions[frozenset(("joint_6.a", "joint_6.offset"))]
    assert offset["joint_6.offset"] / offset["joint_6.a"] == pytest.approx(1.0 / 0.150, rel=1e-9)
    alpha = directions[frozenset(("joint_6.alpha", "joint_6.d"))]
    assert alpha["joint_6.alpha"] / alpha["joint_6.d"] == pytest.approx(-1.0 / 0.150, rel=1e-9)
    in_place = sensitivity(model_with(base="pose", tool="position"), Q)
    assert (in_place.rank, len(in_place.parameters)) == (27, 34)


def test_group_study_over_the_20_poses(model: calib.ErrorModel) -> None:
    studies = [group_study(model, Q, SETS[s]) for s in "AB"]
    assert studies[0].factors == (10.0, 0.1)
    changes = np.where(OF_A, studies[0].changes, studies[1].changes) * 1e3
    tenfold = {group: (of.min(), of.max()) for group, (of, _) in zip(studies[0].groups, changes, strict=True)}
    assert tenfold == {
        "a": pytest.approx((0.08, 3.52), abs=0.005),
        "d": pytest.approx((-1.29, 1.85), abs=0.005),
        "alpha": pytest.approx((5.29, 20.43), abs=0.005),
        "offset": pytest.approx((2.12, 24.42), abs=0.005),
    }
