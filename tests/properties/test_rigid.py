"""Rigid motions of any size obey the laws of their groups."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from calib.foundations import rigid
from tests.properties.strategies import poses, triples
from tests.support.machines import Array

SIZES = (1e-12, 1e-6, 1e-2, 1.0, 1.8)
turns = st.builds(lambda v, size: size * np.array(v), triples(1.0), st.sampled_from(SIZES))
twists = st.builds(lambda v, w: np.concatenate([v, w]), triples(10.0), turns)
MANY = settings(max_examples=40)


@MANY
@given(turns)
def test_exp_and_log_are_inverse_and_signs_turn_back(w: Array) -> None:
    R = rigid.exp3(w)
    np.testing.assert_allclose(R @ rigid.exp3(-w), np.eye(3), rtol=0, atol=1e-15)
    np.testing.assert_allclose(R @ w, w, rtol=0, atol=4e-16 * np.linalg.norm(w))
    back = rigid.log3(R)
    whole = 2 * np.pi * np.round((np.linalg.norm(w) - np.linalg.norm(back)) / (2 * np.pi))
    if whole == 0.0 and np.linalg.norm(w) < np.pi:
        np.testing.assert_allclose(back, w, rtol=0, atol=1e-14 * max(np.linalg.norm(w), 1e-3))
    np.testing.assert_allclose(rigid.exp3(back), R, rtol=0, atol=2e-15)


@MANY
@given(poses(50.0), poses())
def test_the_adjoint_is_a_homomorphism(A: Array, B: Array) -> None:
    both = rigid.adjoint(A @ B)
    np.testing.assert_allclose(rigid.adjoint(A) @ rigid.adjoint(B), both, rtol=0, atol=1e-12)
    np.testing.assert_allclose(rigid.adjoint(rigid.inverse(A)) @ rigid.adjoint(A), np.eye(6), rtol=0, atol=1e-11)


@MANY
@given(poses(50.0), twists)
def test_the_adjoint_carries_small_motions(T: Array, x: Array) -> None:
    """``T exp(h x) T^-1`` and ``exp(h Ad(T) x)``, by central differences."""

    def exp(y: Array) -> Array:
        M = np.eye(4)
        M[:3, :3], M[:3, 3] = rigid.exp3(y[3:]), y[:3]
        return M

    h = 1e-6
    moved = T @ (exp(h * x) - exp(-h * x)) @ rigid.inverse(T) / (2 * h)
    v, w = np.split(rigid.adjoint(T) @ x, 2)
    np.testing.assert_allclose(moved[:3, :3], rigid.skew(w), rtol=0, atol=1e-8)
    # The motion of the origin, less what the turn about it does.
    np.testing.assert_allclose(moved[:3, 3], v, rtol=0, atol=1e-6)


@MANY
@given(turns, turns)
def test_every_name_of_a_rotation_leads_back_to_it(a: Array, b: Array) -> None:
    R = rigid.exp3(a) @ rigid.exp3(b)
    np.testing.assert_allclose(rigid.rotation_of_rpy(rigid.rpy_of(R)), R, rtol=0, atol=1e-14)
    np.testing.assert_allclose(rigid.rotation_of_quaternion(rigid.quaternion_of(R)), R, rtol=0, atol=4e-15)
    np.testing.assert_allclose(rigid.nearest_rotation(3.0 * R), R, rtol=0, atol=4e-15)


@MANY
@given(turns, turns)
def test_the_left_jacobian_carries_a_turn_through_the_logarithm(w: Array, d: Array) -> None:
    if np.linalg.norm(w) > 3.0:
        w = w / np.linalg.norm(w)
    h = 1e-6
    ahead, behind = (rigid.log3(rigid.exp3(s * h * d) @ rigid.exp3(w)) for s in (1, -1))
    moved = (ahead - behind) / (2 * h)
    np.testing.assert_allclose(rigid.left_jacobian_inverse(w) @ d, moved, rtol=0, atol=1e-6)
