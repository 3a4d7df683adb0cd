"""Where are the base and the tool? Start values in closed form, for the nominal robot, with no guess.

Positions. With A = R_base^T and s = -A t_base, the equation of row n, ``A x_n + s - R_n p - t_n = 0``, is linear in A,
s and the tool point p, and its residual is the measured one turned by A. Eliminating s and p leaves a quadratic
function of the nine entries of A, which is minimised over the rotations from many starts at once: the global
least-squares fit.

Poses. ``R_base R_n R_tool = R_measured`` is linear in the Kronecker product of the two unknown rotations, whose nearest
factors follow from an SVD (M. Shah, "Solving the robot-world/hand-eye calibration problem using the Kronecker product",
J. Mechanisms Robotics 5, 2013); the two translations are then linear.
"""

import itertools

import numpy as np

from calib.foundations import linear, rigid
from calib.foundations.arrays import Array, IntArray

_MOST_STEPS = 100
_NEGLIGIBLE = 1e-10
_STEP_TOLERANCE = 1e-11


def align_positions(
    tips: Array, measured: Array, tool: IntArray, n_tools: int, base: Array | None, points: Array | None
) -> tuple[Array, Array]:
    """Return the base pose (4, 4) and the tool points (k, 3) that explain measured positions best.

    ``tips`` (N, 4, 4): tip link in the base link; ``measured`` (N, 3) in the instrument's frame; ``tool`` (N,): which
    of the ``n_tools`` points was measured. ``base`` and ``points`` are given where they are known. Of the values that
    the rows do not determine, the shortest are taken.
    """
    R, t = tips[:, :3, :3], tips[:, :3, 3]
    if points is not None:
        t = t + (R @ points[tool, :, None])[..., 0]
    # Unknown s and tool points: L z = t - A y, with y centred for the sake of conditioning.
    centre = measured.mean(axis=0) if base is None else base[:3, 3]
    y = measured - centre
    L = _columns(-R, tool, n_tools, own=base is None, tools=points is None)
    if base is not None:
        A = base[:3, :3].T
        z = _solve(L, (t - y @ A.T).reshape(-1))
        t_base = centre
    else:
        # A y = (y^T kron I) vec(A), column by column.
        X = np.einsum("ni,jk->njik", y, np.eye(3)).reshape(-1, 9)
        triangle = linear.triangle(np.column_stack([L, X, t.reshape(-1)]))
        L, X, c = triangle[:, : L.shape[1]], triangle[:, L.shape[1] : -1], triangle[:, -1]
        U, values, _ = np.linalg.svd(L, full_matrices=False)
        U = U[:, values > _NEGLIGIBLE * values[0]]
        A = _best_rotation(X - U @ (U.T @ X), c - U @ (U.T @ c))
        z = _solve(L, c - X @ A.T.reshape(-1))
        t_base, z = centre - A.T @ z[:3], z[3:]
    return rigid.placement(A.T, t_base), z.reshape(-1, 3) if points is None else points


def align_poses(
    tips: Array,
    measured: Array,
    tool: IntArray,
    n_tools: int,
    base: Array | None,
    rotations: Array | None,
    points: Array | None,
) -> tuple[Array, Array]:
    """Return the base pose (4, 4) and the tool poses (k, 4, 4) that explain measured poses (N, 4, 4) best.

    Arguments as for :func:`align_positions`; ``rotations`` (k, 3, 3) of the tools are given where they are known.
    """
    R, orientation = tips[:, :3, :3], measured[:, :3, :3]
    if base is not None:
        R_base = base[:3, :3]
    elif rotations is not None:
        R_base = rigid.nearest_rotation(np.einsum("nij,nkj->ik", orientation, R @ rotations[tool]))
    else:
        often = tool == np.argmax(np.bincount(tool))
        R_base = _shah(R[often], orientation[often])
    if rotations is None:
        turned = np.swapaxes(R_base @ R, -1, -2) @ orientation
        rotations = rigid.nearest_rotation(np.stack([turned[tool == k].sum(axis=0) for k in range(n_tools)]))
    # The rotations are known now, so positions determine the translations linearly.
    rest = measured[:, :3, 3] - tips[:, :3, 3] @ R_base.T
    rest = rest if points is None else rest - (R_base @ R @ points[tool, :, None])[..., 0]
    rest = rest if base is None else rest - base[:3, 3]
    z = _solve(_columns(R_base @ R, tool, n_tools, own=base is None, tools=points is None), rest.reshape(-1))
    t_base, z = (z[:3], z[3:]) if base is None else (base[:3, 3], z)
    points = z.reshape(-1, 3) if points is None else points
    return rigid.placement(R_base, t_base), rigid.placement(rotations, points)


def _columns(R: Array, tool: IntArray, n_tools: int, *, own: bool, tools: bool) -> Array:
    """Return the columns (3 N, ...) of an unknown translation of its own, and of every unknown tool point."""
    columns = [np.broadcast_to(np.eye(3), R.shape)] if own else []
    columns += [R * (tool == k)[:, None, None] for k in range(n_tools)] if tools else []
    return np.concatenate(columns, axis=2).reshape(3 * len(R), -1) if columns else np.zeros((3 * len(R), 0))


def _solve(L: Array, c: Array) -> Array:
    """Return the shortest least-squares solution of L z = c."""
    return np.asarray(np.linalg.lstsq(L, c, rcond=_NEGLIGIBLE)[0] if L.shape[1] else np.zeros(0))


def _shah(R: Array, measured: Array) -> Array:
    """Return R_base of ``R_base R_n R_tool = R_measured``."""
    K = np.einsum("nij,nkl->ikjl", measured, R).reshape(9, 9)
    U, _, _ = np.linalg.svd(K)
    V = U[:, 0].reshape(3, 3)
    return rigid.nearest_rotation(np.sign(np.linalg.det(V)) * V)


def _cube_rotations() -> Array:
    """Return the 24 rotations (24, 3, 3) of the cube: every rotation is within 63 degrees of one of them."""
    found = []
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1.0, -1.0), repeat=3):
            M = np.eye(3)[list(order)] * np.array(signs)[:, None]
            if np.linalg.det(M) > 0.0:
                found.append(M)
    return np.stack(found)


def _best_rotation(X: Array, c: Array) -> Array:
    """Return the rotation A that minimises ``|X vec(A) - c|``, by Levenberg-Marquardt from many starts at once."""
    triangle = linear.triangle(np.column_stack([X, c]))
    X, c = triangle[:, :-1], triangle[:, -1]
    relaxed = _solve(X, c).reshape(3, 3).T
    A = np.concatenate([rigid.nearest_rotation(relaxed)[None], _cube_rotations()])
    basis = rigid.skew(np.eye(3))

    def residual(A: Array) -> Array:
        return np.swapaxes(A, -1, -2).reshape(len(A), 9) @ X.T - c

    r = residual(A)
    cost = (r * r).sum(axis=1)
    damping = np.full(len(A), 1e-3)
    for _ in range(_MOST_STEPS):
        # d vec(A exp(w)) = vec(A [w]x)
        J = np.swapaxes(A[:, None] @ basis, -1, -2).reshape(len(A), 3, 9) @ X.T
        H = J @ np.swapaxes(J, -1, -2)
        g = (J @ r[:, :, None])[..., 0]
        size = np.trace(H, axis1=1, axis2=2) / 3.0 + 1e-300
        step = -np.linalg.solve(H + (damping * size)[:, None, None] * np.eye(3) + 1e-300 * np.eye(3), g[..., None])[
            ..., 0
        ]
        trial = A @ rigid.exp3(step)
        r_trial = residual(trial)
        cost_trial = (r_trial * r_trial).sum(axis=1)
        better = cost_trial < cost
        A, r = np.where(better[:, None, None], trial, A), np.where(better[:, None], r_trial, r)
        cost = np.where(better, cost_trial, cost)
        damping = np.where(better, np.maximum(0.1 * damping, 1e-12), 10.0 * damping)
        if np.max(np.where(better, np.linalg.norm(step, axis=1), 0.0)[cost <= cost.min() * 1.01]) < _STEP_TOLERANCE:
            break
    return rigid.nearest_rotation(A[np.argmin(cost)])
