"""Rigid motions against their axioms, finite differences and Pinocchio, also where formulas usually break."""

import numpy as np
import pinocchio as pin
import pytest
from scipy.spatial.transform import Rotation

from calib.foundations import rigid
from calib.foundations.arrays import Array

EYE = np.eye(3)
ANGLES = [0.0, 1e-300, 1e-160, 1e-13, 1e-9, 0.9e-4, 1.1e-4, 1e-2, 1.0, 3.0, np.pi - 1e-4, np.pi - 1e-9, np.pi - 1e-13]


def vectors(n: int, seed: int = 0) -> Array:
    return np.random.default_rng(seed).normal(size=(n, 3))


def axes(n: int = 50) -> Array:
    """Random unit vectors, and the coordinate axes and diagonals where a component vanishes."""
    special = np.vstack([EYE, -EYE, [[1, 1, 0], [0, -1, 1], [1, 0, 1]], np.ones((1, 3))])
    all_ = np.vstack([vectors(n), special])
    return np.asarray(all_ / np.linalg.norm(all_, axis=-1, keepdims=True))


def rotations(n: int = 200) -> Array:
    return rigid.exp3(2.0 * vectors(n, seed=1))


def placements(n: int = 200) -> Array:
    return rigid.placement(rotations(n), vectors(n, seed=2))


def se3(T: Array) -> pin.SE3:
    return pin.SE3(T)


def test_skew_is_the_cross_product() -> None:
    v, u = vectors(20), vectors(20, seed=3)
    np.testing.assert_allclose((rigid.skew(v) @ u[..., None])[..., 0], np.cross(v, u), atol=1e-15)


def test_inverse_and_translation() -> None:
    T = placements()
    np.testing.assert_allclose(rigid.inverse(T) @ T, np.broadcast_to(np.eye(4), T.shape), atol=1e-14)
    np.testing.assert_allclose(rigid.translation(np.array([1.0, 2.0, 3.0])) @ [0, 0, 0, 1], [1, 2, 3, 1])


def test_carried_twists_are_those_of_the_adjoint() -> None:
    T, twists = placements(), np.random.default_rng(4).normal(size=(len(placements()), 6, 5))
    np.testing.assert_allclose(rigid.carried(T, twists), rigid.adjoint(T) @ twists, rtol=0, atol=1e-13)
    np.testing.assert_allclose(rigid.carried(T[1], twists[1]), rigid.adjoint(T[1]) @ twists[1], rtol=0, atol=1e-13)


def test_products_are_the_same_however_rows_lie_in_memory() -> None:
    A, B = placements()[0], placements()
    last = np.ascontiguousarray(B.transpose(2, 1, 0)).transpose(2, 1, 0)
    for one, other in ((A, B), (A, last), (B, last), (B, A)):
        np.testing.assert_allclose(rigid.product(one, other), one @ other, rtol=0, atol=1e-14)


def test_batches_of_any_shape() -> None:
    w = vectors(6).reshape(2, 3, 3)
    for f in (rigid.exp3, rigid.skew, rigid.left_jacobian_inverse, rigid.rx_ry_rz, rigid.rotation_of_rpy):
        whole = f(w)
        assert whole.shape == (2, 3, 3, 3)
        np.testing.assert_allclose(whole[1, 2], f(w[1, 2]), rtol=0, atol=1e-15)
    R = rigid.exp3(w)
    for g in (rigid.log3, rigid.rpy_of, rigid.quaternion_of, rigid.nearest_rotation):
        np.testing.assert_allclose(g(R)[1, 2], g(R[1, 2]), rtol=0, atol=1e-15)
    T = rigid.placement(R, w)
    for h in (rigid.inverse, rigid.adjoint):
        np.testing.assert_allclose(h(T)[1, 2], h(T[1, 2]), rtol=0, atol=1e-15)


@pytest.mark.parametrize("angle", ANGLES)
def test_exp_makes_rotations_and_log_takes_them_back(angle: float) -> None:
    w = angle * axes()
    R = rigid.exp3(w)
    np.testing.assert_allclose(R @ np.swapaxes(R, -1, -2), np.broadcast_to(EYE, R.shape), atol=1e-15)
    np.testing.assert_allclose(np.linalg.det(R), 1.0, atol=2e-15)
    np.testing.assert_allclose(rigid.log3(R), w, rtol=0, atol=4e-15)
    np.testing.assert_allclose(R, [pin.exp3(row) for row in w], atol=1e-15)
    np.testing.assert_allclose(R, rigid.rotation_about(axes(), np.full(len(w), angle)), atol=1e-15)


def test_log_of_small_rotations_keeps_its_relative_accuracy() -> None:
    for angle in (1e-12, 1e-8, 1e-4):
        w = angle * axes()
        np.testing.assert_allclose(rigid.log3(rigid.exp3(w)), w, rtol=0, atol=4e-16 * angle)


def test_log_at_half_a_turn_is_one_of_its_two_values() -> None:
    w = np.pi * axes()
    log = rigid.log3(rigid.exp3(w))
    np.testing.assert_allclose(np.minimum(np.abs(log - w).max(axis=-1), np.abs(log + w).max(axis=-1)), 0.0, atol=4e-15)


def test_log_never_turns_farther_than_half_a_turn() -> None:
    log = rigid.log3(rigid.exp3(5.0 * vectors(500)))
    assert np.linalg.norm(log, axis=-1).max() <= np.pi + 1e-15
    np.testing.assert_allclose(rigid.exp3(log), rigid.exp3(5.0 * vectors(500)), atol=1e-14)


def test_adjoint_moves_twists_and_agrees_with_pinocchio() -> None:
    T = placements(50)
    np.testing.assert_allclose(rigid.adjoint(T), [se3(row).action for row in T], atol=1e-14)
    twist = np.hstack([vectors(50, seed=4), vectors(50, seed=5)])
    for Ti, x, y in zip(T, twist, (rigid.adjoint(T) @ twist[..., None])[..., 0], strict=True):
        np.testing.assert_allclose(pin.exp6(y).homogeneous @ Ti, Ti @ pin.exp6(x).homogeneous, atol=1e-13)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 0.99e-4, 1.01e-4, 1e-2, 1.0, 2.5, 3.1])
def test_left_jacobian_inverse_is_the_derivative_of_log(angle: float) -> None:
    w = angle * axes(20)
    h = 1e-5
    columns = [
        (rigid.log3(rigid.exp3(h * e) @ rigid.exp3(w)) - rigid.log3(rigid.exp3(-h * e) @ rigid.exp3(w))) / (2 * h)
        for e in EYE
    ]
    # Near half a turn the derivative curves so much that central differences are the weaker side.
    np.testing.assert_allclose(
        rigid.left_jacobian_inverse(w), np.stack(columns, axis=-1), atol=1e-6 if angle > 3 else 1e-9
    )


@pytest.mark.parametrize("angle", [0.0, 1e-300, 1e-12, 1e-4, 1.0, 2.0, 2.2, np.pi - 1e-7, np.pi])
def test_log_with_its_derivative_is_what_both_are_alone(angle: float) -> None:
    R = rigid.exp3(angle * axes(20))
    w, back = rigid.log3_with_derivative(np.ascontiguousarray(R.transpose(1, 2, 0)))
    np.testing.assert_allclose(w.T, rigid.log3(R), rtol=0, atol=1e-15 * angle)
    np.testing.assert_allclose(back.transpose(2, 0, 1), rigid.left_jacobian_inverse(w.T), rtol=0, atol=2e-15)


def test_left_jacobian_inverse_agrees_with_pinocchio() -> None:
    for angle in (1e-12, 1e-7, 0.99e-4, 1.01e-4, 0.5, 2.0, 3.0):
        w = angle * axes(10)
        # Pinocchio's Jlog3 is the right one; the left one of w is the right one of -w.
        expected = [pin.Jlog3(pin.exp3(-row)) for row in w]
        np.testing.assert_allclose(rigid.left_jacobian_inverse(w), expected, atol=1e-12)


def test_rx_ry_rz_and_rpy_have_the_stated_order() -> None:
    a, b, c = 0.3, -0.5, 0.7
    X, Y, Z = (rigid.rotation_about(axis, angle) for axis, angle in zip(EYE, (a, b, c), strict=True))
    np.testing.assert_allclose(rigid.rx_ry_rz(np.array([a, b, c])), X @ Y @ Z, atol=1e-15)
    np.testing.assert_allclose(rigid.rotation_of_rpy(np.array([a, b, c])), Z @ Y @ X, atol=1e-15)
    np.testing.assert_allclose(rigid.rotation_of_rpy(np.array([a, b, c])), pin.rpy.rpyToMatrix(a, b, c), atol=1e-15)
    np.testing.assert_allclose(X @ [0, 1, 0], [0, np.cos(a), np.sin(a)], atol=1e-15)


def test_rpy_of_takes_rotation_of_rpy_back() -> None:
    rpy = np.random.default_rng(8).uniform(-1.0, 1.0, size=(500, 3)) * [np.pi, np.pi / 2, np.pi]
    np.testing.assert_allclose(rigid.rpy_of(rigid.rotation_of_rpy(rpy)), rpy, atol=1e-12)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("distance", [0.0, 1e-16, 1e-13, 1e-11, 1e-8, 1e-5, 1e-3])
def test_rpy_near_gimbal_lock_keeps_the_rotation(distance: float, sign: float) -> None:
    rpy = np.random.default_rng(9).uniform(-np.pi, np.pi, size=(300, 3))
    rpy[:, 1] = sign * (np.pi / 2 - distance)
    R = rigid.rotation_of_rpy(rpy)
    found = rigid.rpy_of(R)
    # Within 1e-12 of the lock roll is dropped, at the cost of at most twice the distance.
    dropped = 2.1 * distance if distance < 1e-12 else 0.0
    np.testing.assert_allclose(rigid.rotation_of_rpy(found), R, rtol=0, atol=5e-15 + dropped)
    np.testing.assert_allclose(found[:, 1], rpy[:, 1], atol=1e-15)
    if distance == 0.0:
        np.testing.assert_allclose(found[:, 0], 0.0, atol=1e-15)


def test_rpy_of_exact_quarter_turns() -> None:
    for axis in EYE:
        for quarter in range(-2, 3):
            R = np.round(rigid.rotation_about(axis, quarter * np.pi / 2))
            np.testing.assert_allclose(rigid.rotation_of_rpy(rigid.rpy_of(R)), R, atol=1e-15)


def test_quaternions_agree_with_pinocchio_and_go_both_ways() -> None:
    special = rigid.exp3(np.vstack([angle * axes() for angle in (*ANGLES, np.pi)]))
    R = np.concatenate([rotations(), special])
    q = rigid.quaternion_of(R)
    assert (q[:, 0] >= 0.0).all()
    np.testing.assert_allclose(np.linalg.norm(q, axis=-1), 1.0, atol=1e-15)
    np.testing.assert_allclose(rigid.rotation_of_quaternion(q), R, atol=2e-15)
    np.testing.assert_allclose(rigid.rotation_of_quaternion(-3.0 * q), R, atol=2e-15)
    np.testing.assert_allclose([pin.Quaternion(*row).matrix() for row in q], R, atol=2e-15)


def test_nearest_rotation() -> None:
    R = rotations()
    np.testing.assert_allclose(rigid.nearest_rotation(R), R, atol=2e-15)
    noisy = R + 1e-3 * np.random.default_rng(10).normal(size=R.shape)
    near = rigid.nearest_rotation(noisy)
    np.testing.assert_allclose(np.linalg.det(near), 1.0, atol=1e-14)
    for e in 1e-4 * np.vstack([EYE, -EYE]):
        other = near @ rigid.exp3(e)
        assert (np.linalg.norm(other - noisy, axis=(1, 2)) > np.linalg.norm(near - noisy, axis=(1, 2))).all()
    np.testing.assert_allclose(np.linalg.det(rigid.nearest_rotation(-R)), 1.0, atol=1e-14)


def test_lengths_and_angles_of_placements() -> None:
    rng = np.random.default_rng(4)
    turns, shifts = rng.normal(scale=0.7, size=(20, 3)), rng.normal(size=(20, 3))
    lengths, angles = rigid.lengths_and_angles(rigid.placement(Rotation.from_rotvec(turns).as_matrix(), shifts))
    np.testing.assert_allclose(lengths, np.linalg.norm(shifts, axis=1))
    np.testing.assert_allclose(angles, Rotation.from_rotvec(turns).magnitude())
