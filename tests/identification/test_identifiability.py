"""Rank, directions of the null space, and the three policies for them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import null_space

import calib
from calib.foundations.errors import IdentificationError
from calib.identification.identifiability import (
    inner_constraints,
    minimal_set,
    null_directions,
    preference,
    singular_directions,
)
from calib.identification.parameters import Parameter, scales
from calib.identification.system import Problem, jacobian
from tests.support import machines
from tests.support.machines import Array, Machine, anywhere, miss, pose, predicted

UR10 = ("example:ur_description/urdf/ur10_robot.urdf", "tool0")
SIGMA = 0.05e-3


@pytest.fixture(scope="module")
def robot() -> calib.Robot:
    return machines.load(*UR10)


def fitted(
    robot: calib.Robot,
    observes: str = "position",
    points: tuple[tuple[float, ...], ...] = ((0.05, 0.02, 0.15),),
    sigma: float = SIGMA,
    policy: str = "nearest",
    errors: float = 1.0,
    at: Array | None = None,
    **options: object,
) -> tuple[calib.Fit, Machine, Array]:
    """A fit of 200 rows, its machine, and readings it has not seen."""
    rng = np.random.default_rng(2)
    arm = machines.arm(*UR10)
    names = [f"p{k}" for k in range(len(points))]
    moved = arm.moved(rng, length=errors * 0.5e-3, angle=errors * 1e-3, zero=errors * 5e-3)
    true = Machine(moved, anywhere(rng) if at is None else at, dict(zip(names, map(pose, points), strict=True)))
    data = true.measure(
        robot, arm.draw(rng, 200), observes, points=(names * 200)[:200], rng=rng, sigma=sigma, sigma_angle=2 * sigma
    )
    model = machines.model(robot, **({"offsets": "all", "placements": "all"} | options))
    return calib.identify(model, data, null_space=policy), true, arm.draw(rng, 200)


def scaled_jacobian(fit: calib.Fit) -> Array:
    (J,) = jacobian(Problem(fit.model, fit.parameters, fit.nominal.frames, fit.measurements), fit.values)
    return J.reshape(-1, len(fit.values)) * scales(fit.parameters)


# ---- what can be seen


@pytest.mark.parametrize(
    ("observes", "points", "options", "rank"),
    [
        ("pose", ((0.05, 0.02, 0.15),), {"tool": "pose"}, 30),
        ("position", ((0.05, 0.02, 0.15),), {}, 27),
        ("position", ((0.05, 0.02, 0.15), (-0.1, 0, 0.1), (0, 0.1, 0.05)), {}, 33),
        ("position", ((0.05, 0.02, 0.15),), {"placements": ["*"]}, 27),
        ("position", ((0.05, 0.02, 0.15),), {"offsets": "none", "placements": "none"}, 9),
    ],
)
def test_the_rank_of_a_6r_arm(
    robot: calib.Robot, observes: str, points: tuple[tuple[float, ...], ...], options: dict[str, object], rank: int
) -> None:
    fit, *_ = fitted(robot, observes, points, **options)
    assert (fit.rank, fit.numerical_rank) == (rank, rank)
    assert len(fit.null_space) == len(fit.parameters) - rank
    s = fit.singular_values
    assert s[rank - 1] > 1e6 * np.append(s, 0.0)[rank]


def test_a_point_on_the_last_axis_hides_two_more_directions(robot: calib.Robot) -> None:
    """Noise lifts the point off the axis, so that 27 are seen by the letter and 25 to any use."""
    fit, *_ = fitted(robot, points=((0, 0, 0.15),), errors=0.0)
    assert (fit.rank, fit.numerical_rank) == (27, 25)
    assert len(fit.null_space) == len(fit.parameters) - 25


def test_a_null_direction_changes_no_residual_and_says_so(robot: calib.Robot) -> None:
    fit, *_ = fitted(robot, sigma=0.0, offsets=["wrist_2_joint", "wrist_3_joint"], placements=["wrist_3_joint.ty"])
    (direction,) = (d for d in fit.null_space if d.parameter == "wrist_3_joint.offset")
    # A turn of the last joint moves a point like a shift of the point across its arm.
    own, *others = direction.shares.items()
    assert own == ("wrist_3_joint.offset", pytest.approx(1e-3))
    assert {name for name, _ in others} <= {"tool.p0.x", "tool.p0.y", "tool.p0.z"}
    assert str(direction).startswith("+1 mrad of wrist_3_joint.offset cannot be told from ")
    change = np.array(
        [direction.shares.get(p.name, 0.0) * (1 if p.name == direction.parameter else -1) for p in fit.parameters]
    )
    moved = scaled_jacobian(fit) @ (change / scales(fit.parameters))
    seen = scaled_jacobian(fit) @ (np.abs(change) / scales(fit.parameters))
    assert np.abs(moved).max() < 0.02 * np.abs(seen).max()


@pytest.mark.parametrize("seed", range(5))
def test_directions_that_only_errors_reveal_are_told_in_ordinary_numbers(seed: int) -> None:
    """Without noise the fit sees, by second order, what the nominal parallelogram hides: rank 31 instead of 29."""
    rng = np.random.default_rng(seed)
    robot, arm = machines.load(machines.INLINE["mimic"], "tip"), machines.arm(machines.INLINE["mimic"], "tip")
    true = Machine(arm.moved(rng), anywhere(rng), {"tool": pose((0.05, 0.02, 0.15))})
    fit = calib.identify(
        calib.error_model(robot, offsets="all", placements="all"), true.measure(robot, arm.draw(rng, 150))
    )
    assert miss(fit, true, arm.draw(rng, 100)) < 1e-12
    # One mm or mrad is never imitated by metres.
    assert max(abs(share) for direction in fit.null_space for share in direction.shares.values()) < 1.0


# ---- what is done about it


def test_nearest_is_the_equal_fit_with_the_smallest_robot(robot: calib.Robot) -> None:
    fit, *_ = fitted(robot)
    of_robot = np.array([p.of_robot for p in fit.parameters])
    widths = np.array([p.weak_prior for p in fit.parameters])
    pull = fit.values * scales(fit.parameters) / widths**2 * of_robot
    basis = null_space(scaled_jacobian(fit), rcond=1e-9)
    assert basis.shape[1] == 18
    # No step along a direction of the null space makes the robot's part smaller, in its weak priors; frames have much
    # wider ones.
    assert np.abs(basis.T @ pull).max() < 1e-2 * np.linalg.norm(pull)


def test_all_policies_predict_the_same_and_nearest_deviates_least(robot: calib.Robot) -> None:
    (nearest, _, unseen), (minimal, *_) = fitted(robot), fitted(robot, policy="minimal")
    # But for weak priors, of which a fit of fewer parameters has fewer.
    np.testing.assert_allclose(predicted(minimal, unseen), predicted(nearest, unseen), rtol=0, atol=0.05 * SIGMA)
    np.testing.assert_allclose(minimal.residuals[0], nearest.residuals[0], rtol=0, atol=0.05 * SIGMA)

    def size(fit: calib.Fit) -> float:
        return float(
            np.linalg.norm([v / p.weak_prior for p, v in zip(fit.parameters, fit.values, strict=True) if p.of_robot])
        )

    assert size(nearest) < 0.99 * size(minimal)
    assert len(minimal.parameters) == minimal.rank == 27
    assert len(minimal.held) == 18
    assert {p.name for p in minimal.held} | {p.name for p in minimal.parameters} == {p.name for p in nearest.parameters}
    assert {"base", "tool"} <= {p.kind for p in minimal.parameters} - {p.kind for p in minimal.held}
    assert not minimal.unidentifiable.any()


def test_refuse_names_the_first_direction(robot: calib.Robot) -> None:
    with pytest.raises(IdentificationError) as caught:
        fitted(
            robot,
            offsets=["shoulder_pan_joint", "wrist_3_joint"],
            placements="none",
            errors=0.0,
            at=pose(),
            policy="refuse",
        )
    assert str(caught.value) == (
        "the data do not determine 2 combinations of parameters; the first: "
        "+1 mrad of shoulder_pan_joint.offset cannot be told from +1 mrad of base.rz."
    )


def test_refuse_accepts_what_is_all_determined(robot: calib.Robot) -> None:
    fit, *_ = fitted(robot, offsets=["elbow_joint"], placements=["wrist_1_joint.tx"], policy="refuse")
    assert fit.null_space == ()
    assert np.all(np.isfinite(fit.sigmas))


# ---- the pieces


def test_directions_of_a_small_matrix() -> None:
    found = singular_directions(np.array([[3.0, 0.0, 0.0], [0.0, 0.05, 0.0]]))
    assert (found.rank, found.numerical_rank) == (2, 1)
    np.testing.assert_allclose(found.singular_values, [3.0, 0.05, 0.0])
    np.testing.assert_allclose(np.abs(found.null_basis(2)), [[0], [0], [1]], atol=1e-15)
    np.testing.assert_allclose(found.vectors @ found.vectors.T, np.eye(3), atol=1e-15)


def parameters(robot: calib.Robot) -> tuple[Parameter, ...]:
    return calib.error_model(robot, offsets=["elbow_joint"], placements=["elbow_joint.tx"]).parameters()


def test_a_minimal_set_takes_base_tool_and_offsets_before_placements(robot: calib.Robot) -> None:
    found = parameters(robot)
    assert [found[k].kind for k in preference(found)] == ["base"] * 6 + ["tool"] * 3 + ["offset", "placement"]


@pytest.mark.parametrize(
    ("matrix", "rank", "order", "kept"),
    [
        ([[1, 1, 0], [0, 0, 1]], 2, (0, 1, 2), (0, 2)),
        ([[1, 1, 0], [0, 0, 1]], 2, (1, 2, 0), (1, 2)),
        ([[1, 1, 0], [0, 1e-4, 1]], 2, (0, 1, 2), (0, 2)),  # nearly the same is not taken while others are left
        ([[1, 1, 0], [0, 1e-4, 1]], 1, (2, 1, 0), (1,)),  # the third is in the direction that does not count
        ([[0, 1]], 1, (0, 1), (1,)),
        ([[1e-13, 1]], 1, (0, 1), (1,)),  # rounding is not taken either
        ([[1, 0, 0], [0, 1e-3, 1]], 2, (1, 0, 2), (0, 2)),  # nor what is hardly seen, in its place
        ([[0, 0]], 0, (0, 1), ()),
    ],
)
def test_a_minimal_set_follows_the_order(
    matrix: list[list[float]], rank: int, order: tuple[int, ...], kept: tuple[int, ...]
) -> None:
    assert minimal_set(np.array(matrix, dtype=float), rank, order) == kept


def test_what_a_minimal_set_leaves_out_spans_the_null_space_where_nothing_parts_it_from_the_rest() -> None:
    """Of values about the threshold, parameters of the null space were taken, and its directions could not be told."""
    chance = np.random.default_rng(0)
    for p in range(2, 9):
        V = np.linalg.qr(chance.normal(size=(p, p)))[0]
        for vectors in (V, np.linalg.qr(np.eye(p) + 1e-3 * chance.normal(size=(p, p)))[0]):
            rows = np.linspace(1.2, 0.9, p)[:, None] * vectors.T
            for rank in range(1, p):
                kept = minimal_set(rows, rank, range(p - 1, -1, -1))
                left = np.setdiff1d(np.arange(p), kept)
                assert len(kept) == rank
                assert np.linalg.svd(vectors[left, rank:], compute_uv=False)[-1] > 1e-3


def test_a_gauge_weighs_the_robot_and_keeps_frames_only_where_nothing_else_moves(robot: calib.Robot) -> None:
    found = parameters(robot)
    number = {p.name: k for k, p in enumerate(found)}
    basis = np.zeros((len(found), 2))
    basis[[number["elbow_joint.offset"], number["base.z"]], 0] = 0.6, 0.8
    basis[number["tool.z"], 1] = 1.0
    G = inner_constraints(basis, found)
    expected = np.zeros((2, len(found)))
    expected[0, number["elbow_joint.offset"]] = expected[1, number["tool.z"]] = 1.0
    np.testing.assert_allclose(np.abs(G), expected, atol=1e-15)


def test_a_null_direction_is_told_with_the_sign_of_the_imitation(robot: calib.Robot) -> None:
    found = parameters(robot)
    number = {p.name: k for k, p in enumerate(found)}
    basis = np.zeros((len(found), 1))
    basis[[number["elbow_joint.tx"], number["base.x"], number["base.rz"], number["base.y"]], 0] = 1, -2, 0.5, 1e-3
    kept = [k for k in range(len(found)) if k != number["elbow_joint.tx"]]
    (told,) = null_directions(basis / np.linalg.norm(basis), found, kept)
    assert str(told) == "+1 mm of elbow_joint.tx cannot be told from +2 mm of base.x, -0.5 mrad of base.rz."
    assert told.shares == pytest.approx({"elbow_joint.tx": 1e-3, "base.x": 2e-3, "base.rz": -0.5e-3})


def test_what_has_a_wide_prior_imitates_by_millimetres_all_the_same(robot: calib.Robot) -> None:
    """Of its prior's standard deviation, half a metre, they are some thousandths."""
    wide = [replace(p, prior=0.5) if p.name == "base.x" else p for p in parameters(robot)]
    number = {p.name: k for k, p in enumerate(wide)}
    basis = np.zeros((len(wide), 1))
    basis[[number["elbow_joint.tx"], number["base.x"]], 0] = 1.0, -4e-3
    for own, says in (
        ("elbow_joint.tx", "+1 mm of elbow_joint.tx cannot be told from +2 mm of base.x."),
        ("base.x", "+500 mm of base.x cannot be told from +250 mm of elbow_joint.tx."),
    ):
        (told,) = null_directions(basis, wide, [k for k in range(len(wide)) if k != number[own]])
        assert str(told) == says


def test_a_minimal_set_of_nothing_is_refused_in_a_sentence(robot: calib.Robot) -> None:
    """The tool stands on the only axis whose zero is free, and base and tool are known."""
    rng = np.random.default_rng(6)
    true = Machine(machines.arm(*UR10), np.eye(4), {"tool": np.eye(4)})
    data = true.measure(robot, true.arm.draw(rng, 12), rng=rng, sigma=SIGMA)
    model = calib.error_model(robot, offsets=["wrist_3_joint"], base="fixed", tool="fixed")
    assert calib.identify(model, data).numerical_rank == 0
    with pytest.raises(IdentificationError, match="determine nothing of what is free"):
        calib.identify(model, data, null_space="minimal")


def test_no_parameter_is_better_known_than_if_all_others_were(tmp_path: Path) -> None:
    """A direction of the null space moved the coefficient by 2e-9, which was then held: its sigma was 1/300."""
    (tmp_path / "one.urdf").write_text(
        '<robot name="r"><link name="a"/><link name="b"/><joint name="j" type="continuous"><parent link="a"/>'
        '<child link="b"/><origin xyz="0.017 -0.057 0.096" rpy="0.781 -1.8975 1.8761"/><axis xyz="-0.807 0.695 0.09"/>'
        "</joint></robot>",
        encoding="utf-8",
    )
    robot, rng, N = calib.load_robot(tmp_path / "one.urdf", tip="b"), np.random.default_rng(1), 60
    readings, celsius = rng.uniform(-2.2, 2.2, (N, 1)), rng.uniform(15.0, 30.0, N)
    tips = robot.tips(readings)
    seen = tips[:, :3, :3] @ [0.05, -0.04, 0.09] + tips[:, :3, 3] + rng.normal(0.0, 2e-5, (N, 3)) + [1.0, 2.0, 0.5]
    table = {"j [rad]": readings[:, 0], "temperature [degC]": celsius}
    table |= {f"{axis} [m]": seen[:, k] for k, axis in enumerate("xyz")}
    data = calib.read_measurements(table, robot, sigma=2e-5)
    fit = calib.identify(calib.error_model(robot, terms={"expansion": "arm"}), data)
    # All that the coefficient does is to move the joint along the link before it.
    alone = 2e-5 / (np.linalg.norm([0.017, -0.057, 0.096]) * np.linalg.norm(celsius - 20.0))
    names = [parameter.name for parameter in fit.parameters]
    assert alone < fit.sigmas[names.index("arm.expansion")] < 3.0 * alone
