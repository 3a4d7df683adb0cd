"""Rigid motions as arrays, batched over leading axes.

Conventions, said once: a placement ``T_a_b`` is a 4x4 homogeneous matrix that reads "frame b in frame a"; a twist is
``(v, w)``, linear part first, as in Pinocchio; perturbations multiply on the right, ``T exp(twist)``, so twists are
expressed in the local frame of ``T``.
"""

import numpy as np

from calib.foundations.arrays import Array, BoolArray, read_only
from calib.foundations.linear import svd

_TINY = 1e-150
_NEAR_HALF_TURN = -0.5
# By component of a vector, the nine numbers of its cross-product matrix.
_CROSS = np.array(
    [[0, 0, 0, 0, 0, -1, 0, 1, 0], [0, 0, 1, 0, 0, 0, -1, 0, 0], [0, -1, 0, 1, 0, 0, 0, 0, 0]], dtype=np.float64
)
# By component of a vector again, those of -[v]x / 2; and of a rotation's nine numbers, the sine of its angle times its
# axis, and the cosine but for 1/2.
_MINUS_HALF_CROSS = read_only(-0.5 * _CROSS.T)
_PARTS = read_only(0.5 * np.concatenate([_CROSS, np.eye(3).reshape(1, 9)]))


def skew(v: Array) -> Array:
    """Return the cross-product matrices ``[v]x`` (..., 3, 3) of vectors (..., 3)."""
    return np.asarray((v @ _CROSS).reshape(*v.shape, 3))


# Of a turn about x, y and z: what is multiplied by 1, by its cosine and by its sine.
_TURNS = np.array([[np.outer(e, e), np.eye(3) - np.outer(e, e), skew(e)] for e in np.eye(3)])
# Of Rx Ry Rz (27, 3, 3), and of Rz: what is multiplied by each of the products of :func:`products_of_turns`.
RX_RY_RZ = read_only(np.einsum("aij,bjk,ckl->abcil", *_TURNS).reshape(27, 3, 3))
RZ = read_only(np.concatenate([_TURNS[2], np.zeros((24, 3, 3))]))


def placement(rotation: Array, translation: Array) -> Array:
    """Return the placements (..., 4, 4) of rotations (..., 3, 3) and translations (..., 3)."""
    shape = translation.shape[:-1]
    if rotation.shape[:-2] != shape:
        shape = np.broadcast_shapes(rotation.shape[:-2], shape)
    out = np.zeros((*shape, 4, 4))
    out[..., :3, :3], out[..., :3, 3], out[..., 3, 3] = rotation, translation, 1.0
    return out


def translation(t: Array) -> Array:
    """Return the placements (..., 4, 4) that translate by ``t`` (..., 3)."""
    return placement(np.eye(3), t)


def product(A: Array, B: Array) -> Array:
    """Return the products (n, 4, 4) of placements, each (n, 4, 4), or (4, 4) for all; of rotations as well."""
    # Rows may come last in memory, where a product of matrices would be made one by one.
    if A.ndim == 2 and B.ndim == 3:
        return np.asarray((A @ B.transpose(2, 1, 0)).transpose(2, 1, 0))
    return np.asarray(np.einsum("...ij,...jk->...ik", A, B))


def inverse(T: Array) -> Array:
    """Return the inverses of placements (..., 4, 4)."""
    R_t = np.swapaxes(T[..., :3, :3], -1, -2)
    return placement(R_t, -(R_t @ T[..., :3, 3, None])[..., 0])


def adjoint(T: Array) -> Array:
    """Return Ad(T) (..., 6, 6): ``exp(Ad(T) x) = T exp(x) T^-1`` for twists x = (v, w)."""
    R = T[..., :3, :3]
    out = np.zeros((*T.shape[:-2], 6, 6))
    out[..., :3, :3] = out[..., 3:, 3:] = R
    out[..., :3, 3:] = skew(T[..., :3, 3]) @ R
    return out


def carried(T: Array, twists: Array) -> Array:
    """Return Ad(T) (..., 6, 6) times columns of twists (..., 6, k), no adjoint being written out."""
    R, (*_, k) = T[..., None, :3, :3], twists.shape
    found = R @ twists.reshape(*twists.shape[:-2], 2, 3, k)
    found[..., 0, :, :] += skew(T[..., :3, 3]) @ found[..., 1, :, :]
    return np.asarray(found.reshape(*found.shape[:-3], 6, k))


def rotation_about(axis: Array, angle: Array | float) -> Array:
    """Return the rotations (..., 3, 3) by ``angle`` (...) about the unit vector(s) ``axis`` (..., 3)."""
    angle = np.asarray(angle)[..., None, None]
    K = skew(axis)
    return np.asarray(np.eye(3) + np.sin(angle) * K + (1.0 - np.cos(angle)) * (K @ K))


def exp3(w: Array) -> Array:
    """Return the rotations (..., 3, 3) of rotation vectors (..., 3)."""
    theta = np.linalg.norm(w, axis=-1)[..., None, None]
    K = skew(w)
    # sinc is exact at zero, and (1 - cos t)/t^2 = sinc(t/2)^2 / 2 does not cancel.
    return np.asarray(np.eye(3) + np.sinc(theta / np.pi) * K + 0.5 * np.sinc(theta / (2 * np.pi)) ** 2 * (K @ K))


def log3(R: Array) -> Array:
    """Return the rotation vectors (..., 3) of rotations (..., 3, 3), with angles in [0, pi]."""
    w, _ = _logarithms(R.reshape(-1, 9).T)
    return w.T.reshape(R.shape[:-1])


def lengths_and_angles(T: Array) -> tuple[Array, Array]:
    """Return how far placements (..., 4, 4) shift, and by what angle they turn, in rad."""
    return np.linalg.norm(T[..., :3, 3], axis=-1), np.linalg.norm(log3(T[..., :3, :3]), axis=-1)


def log3_with_derivative(R: Array) -> tuple[Array, Array]:
    """Return the rotation vectors w (3, n) of rotations (3, 3, n), rows last, and :func:`left_jacobian_inverse` of w.

    The latter is (3, 3, n); both are found in fewer calls than one by one.
    """
    w, angle = _logarithms(R.reshape(9, -1))
    return w, _left_jacobian_inverse(w, angle)


def _logarithms(R: Array) -> tuple[Array, Array]:
    """Return the rotation vectors (3, n) of rotations (9, n), and their angles (n,), none of which is 0."""
    # Components come first, so that what is done to all rows is done at once.
    parts = _PARTS @ R
    w, c = parts[:3], parts[3] - 0.5
    # Never 0, which divides: the angle over its sine is 1 there.
    s = np.maximum(np.sqrt(np.einsum("in,in->n", w, w)), _TINY)
    angle = np.arctan2(s, c)
    w *= angle / s
    # Towards half a turn the antisymmetric part fades and with it the axis; the quaternion keeps it.
    far = c < _NEAR_HALF_TURN
    if far.any():
        w[:, far] = _log_of_quaternion(quaternion_of(R[:, far].T.reshape(-1, 3, 3))).T
    return w, angle


def _log_of_quaternion(q: Array) -> Array:
    s = np.linalg.norm(q[..., 1:], axis=-1, keepdims=True)
    return np.asarray(q[..., 1:] * (2.0 * np.arctan2(s, q[..., :1]) / s))


def left_jacobian_inverse(w: Array) -> Array:
    """Return Jl(w)^-1 (..., 3, 3): ``log(exp(d) exp(w)) = w + Jl(w)^-1 d`` to first order in d (..., 3)."""
    v = w.reshape(-1, 3).T
    angle = np.maximum(np.sqrt(np.einsum("in,in->n", v, v)), _TINY)
    return _left_jacobian_inverse(v, angle).transpose(2, 0, 1).reshape(*w.shape, 3)


def _left_jacobian_inverse(w: Array, angle: Array) -> Array:
    """Return Jl(w)^-1 (3, 3, n) of rotation vectors (3, n), whose angles (n,) are not 0."""
    half = 0.5 * angle
    k = half / np.tan(half)
    # k - [w]x / 2 + (1 - k) / |w|^2 w w^T: however small w is, the last is not larger than the rounding errors of k.
    out = (_MINUS_HALF_CROSS @ w).reshape(3, 3, -1)
    out += ((1.0 - k) / (angle * angle) * w)[:, None] * w
    out.reshape(9, -1)[::4] += k
    return out


def rx_ry_rz(angles: Array) -> Array:
    """Return Rx(a) Ry(b) Rz(c) (..., 3, 3) of angles (..., 3)."""
    found = products_of_turns(angles) @ RX_RY_RZ.reshape(27, 9)
    return np.asarray(found.reshape(*angles.shape, 3) + 0.0)  # no zero keeps a minus


def products_of_turns(angles: Array) -> Array:
    """Return the products (..., 27) of 1, cosine or sine of each of three angles (..., 3), in the order of these.

    What turns by all three are made of is linear in them.
    """
    own = angles.reshape(-1, 3).T
    # Rows last in memory, so that what is done to all of them is done at once.
    factors = np.empty((3, *own.shape))
    factors[0] = 1.0
    np.cos(own, out=factors[1])
    np.sin(own, out=factors[2])
    x, y, z = factors[:, None, None, 0], factors[:, None, 1], factors[:, 2]
    return (x * y * z).reshape(27, -1).T.reshape(*angles.shape[:-1], 27)


def rpy_of(R: Array) -> Array:
    """Return URDF roll, pitch, yaw (..., 3) with R = Rz(yaw) Ry(pitch) Rx(roll), accurate also near pitch +-90 deg.

    The pitch comes from atan2, which stays exact near +-90 deg where arcsin loses half the digits; there roll and yaw
    are one angle, and roll takes none of it.
    """
    cos_pitch = np.hypot(R[..., 0, 0], R[..., 1, 0])
    pitch = np.arctan2(-R[..., 2, 0], cos_pitch)
    yaw = np.where(cos_pitch > 1e-12, np.arctan2(R[..., 1, 0], R[..., 0, 0]), np.arctan2(-R[..., 0, 1], R[..., 1, 1]))
    s, c = np.sin(yaw), np.cos(yaw)
    # With yaw known, Rz(yaw)^T R = Ry Rx gives roll without dividing by the small cosine.
    roll = np.arctan2(s * R[..., 0, 2] - c * R[..., 1, 2], c * R[..., 1, 1] - s * R[..., 0, 1])
    return np.stack([roll, pitch, yaw], axis=-1)


def rotation_of_rpy(rpy: Array) -> Array:
    """Return R = Rz(yaw) Ry(pitch) Rx(roll) (..., 3, 3), URDF's convention."""
    x, y, z = (rotation_about(axis, rpy[..., i]) for i, axis in enumerate(np.eye(3)))
    return np.asarray(z @ y @ x)


def rotation_of_quaternion(q: Array) -> Array:
    """Return the rotations (..., 3, 3) of unit quaternions (..., 4) in the order w, x, y, z."""
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    K = skew(q[..., 1:])
    return np.asarray(np.eye(3) + 2.0 * q[..., :1, None] * K + 2.0 * (K @ K))


def are_placements(T: Array, within: float = 1e-6) -> BoolArray:
    """Return which of N matrices (N, 4, 4) are placements: a rotation, a position, and a last row 0 0 0 1."""
    finite, last = np.isfinite(T).all(axis=(1, 2)), (T[:, 3] == np.eye(4)[3]).all(axis=1)
    return np.asarray(are_rotations(T[:, :3, :3], within) & finite & last)


def are_rotations(R: Array, within: float = 1e-6) -> BoolArray:
    """Return which of N matrices (N, 3, 3) are rotations, to ``within`` in every entry of R^T R."""
    orthogonal = are_orthogonal(R, within)
    return np.asarray(orthogonal & (np.linalg.det(np.where(orthogonal[:, None, None], R, 0.0)) > 0.0))


def are_orthogonal(R: Array, within: float = 1e-6) -> BoolArray:
    """Return which of N matrices (N, 3, 3) are rotations or mirror images of such, as :func:`are_rotations`."""
    # No entry of a rotation is beyond 1; what is would overflow, and a comparison with nan is false.
    R = np.where((np.abs(R) < 2.0).all(axis=(1, 2), keepdims=True), R, 0.0)
    return np.asarray(np.abs(np.swapaxes(R, 1, 2) @ R - np.eye(3)).max(axis=(1, 2)) < within)


def quaternion_of(R: Array) -> Array:
    """Return unit quaternions (..., 4) in the order w, x, y, z with w >= 0 of rotations (..., 3, 3)."""
    # Largest of the four forms of each quaternion, so that nothing is divided by a small number.
    m = R
    d = np.einsum("...ii->...i", m)
    trace = d.sum(axis=-1)
    forms = np.empty((*m.shape[:-2], 4, 4))
    forms[..., 0, 0] = 1.0 + trace
    forms[..., 0, 1] = forms[..., 1, 0] = m[..., 2, 1] - m[..., 1, 2]
    forms[..., 0, 2] = forms[..., 2, 0] = m[..., 0, 2] - m[..., 2, 0]
    forms[..., 0, 3] = forms[..., 3, 0] = m[..., 1, 0] - m[..., 0, 1]
    for i in range(3):
        forms[..., i + 1, i + 1] = 1.0 + 2.0 * d[..., i] - trace
        for j in range(i):
            forms[..., i + 1, j + 1] = forms[..., j + 1, i + 1] = m[..., i, j] + m[..., j, i]
    best = np.argmax(np.einsum("...ii->...i", forms), axis=-1)
    q = np.take_along_axis(forms, best[..., None, None], axis=-2)[..., 0, :]
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    return np.asarray(np.where(q[..., :1] < 0.0, -q, q))


def nearest_rotation(M: Array) -> Array:
    """Return the rotations nearest (Frobenius) to matrices (..., 3, 3)."""
    U, _, Vt = svd(M)
    U = U.copy()
    U[..., :, -1] *= np.linalg.det(U @ Vt)[..., None]
    return np.asarray(U @ Vt)
