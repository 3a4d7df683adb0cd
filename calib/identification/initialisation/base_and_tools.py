"""Where are the base and the tool? Start values for the nominal robot, with no guess.

With A = R_base^T and s = -A t_base, the position of row n says ``A x_n + s = t_n + R_n p``: linear in A, s and the tool
point p, with a residual that is the measured one turned by A. Its orientation says ``R_n^T A R_measured = R_tool``: the
left side is the same for all rows. Eliminating s, p and R_tool (as a free matrix) leaves a quadratic function of the
nine entries of A, which is minimised over the rotations from many starts at once. For positions this is the global
least-squares fit; poses are weighted by an arm's length, and orientations add to what positions cannot see.
"""

import itertools
from functools import cache
from typing import NamedTuple

import numpy as np

from calib.foundations import linear, rigid
from calib.foundations.arrays import Array, BoolArray, IntArray, read_only
from calib.foundations.ranges import SMALLEST_CELL
from calib.identification.parameters import TOOL

_MOST_STEPS = 100
_STEP_TOLERANCE = 1e-11
# After so many steps, what lowers a cost by less than this share creeps along a valley that shows no rotation.
_MANY_STEPS, _HARDLY_LOWER = 20, 1e-5
_NEGLIGIBLE = 1e-10
# A tool has hardly a part in a unit direction.
_HARDLY = 0.1
# Metres that weigh like one radian: a typical lever between an error of orientation and one of position.
_LEVER = 0.3


class TipObservations(NamedTuple):
    """N rows that may carry an orientation.

    ``tips`` (N, 4, 4): tip link in the base link. ``position`` (N, 3) in the instrument's frame. ``orientation``
    (N, 3, 3), nan where only the position was measured. ``tool`` (N,): which of the tools was measured.
    """

    tips: Array
    position: Array
    orientation: Array
    tool: IntArray

    def some(self, which: BoolArray | IntArray) -> "TipObservations":
        """Return some rows, by mask (N,) or number."""
        return TipObservations(self.tips[which], self.position[which], self.orientation[which], self.tool[which])


class KnownFrames(NamedTuple):
    """What is known of base (4, 4), tool points (k, 3) and tool rotations (k, 3, 3); None for what is sought."""

    base: Array | None
    points: Array | None
    rotations: Array | None


class BaseAndTools(NamedTuple):
    """The base pose (4, 4), the tool poses (k, 4, 4), and whether every direction of a tool point is shown (k,)."""

    base: Array
    tools: Array
    shown: BoolArray


def base_and_tools(rows: TipObservations, known: KnownFrames, guess: Array) -> BaseAndTools:
    """Return the base pose and the tool poses that explain the rows best.

    ``guess`` (k, 4, 4): tool poses from which what the rows do not show takes its value. A direction of a tool point is
    shown when a tool of ordinary length along it changes positions by more than what the rows leave unexplained: where
    the tip hardly turns, the best fit would put the tool kilometres away.
    """
    points = guess[:, :3, 3] if known.points is None else known.points
    R, turned = rows.tips[:, :3, :3], ~np.isnan(rows.orientation[:, 0, 0])
    predicted = rows.tips[:, :3, 3] + (R @ points[rows.tool, :, None])[..., 0]
    # Changes of the tool points beside those of the guess, as they move positions, best shown first.
    columns = [R * (rows.tool == k)[:, None, None] for k in range(len(guess))] if known.points is None else []
    L = np.concatenate(columns, axis=2) if columns else np.zeros((len(R), 3, 0))
    seen = L if known.base is not None else L - L.mean(axis=0)
    values, Vt, count = _best_shown(seen.reshape(3 * len(R), -1))
    of_base = 0 if known.base is not None else 6
    spare = rows.position.size - of_base - np.arange(1, count + 1)
    needed = np.sqrt(rows.position.size / np.maximum(spare, 1))
    while True:
        best = L @ Vt[:count].T
        base, change = _base_and_change(rows, known, turned, len(guess), predicted, best)
        left = np.linalg.norm((rows.position - base[:3, 3]) @ base[:3, :3] - predicted - best @ change)
        # Without the last ones no less is left.
        clear = np.flatnonzero(values[:count] * TOOL > left * needed[:count])
        if (shown := int(clear[-1]) + 1 if len(clear) else 0) == count:
            break
        count = shown
    points = points + (Vt[:count].T @ change).reshape(-1, 3) if columns else points
    rotations = known.rotations
    if rotations is None:
        rotations = guess[:, :3, :3].copy()
        for k in np.unique(rows.tool[turned]):
            own = turned & (rows.tool == k)
            by_base = np.swapaxes(R[own], -1, -2) @ base[:3, :3].T @ rows.orientation[own]
            rotations[k] = rigid.nearest_rotation(by_base.sum(axis=0))
    return BaseAndTools(base, rigid.placement(rotations, points), _shown(Vt, count, len(guess)))


def poses_off(rows: TipObservations, some: BoolArray | IntArray, tools: int) -> tuple[Array, Array]:
    """Return how far off all poses (n,) are, in m and rad, where base and ``tools`` are found from some of them."""
    base, found, _ = base_and_tools(rows.some(some), KnownFrames(None, None, None), np.tile(np.eye(4), (tools, 1, 1)))
    placed = rigid.inverse(base @ rows.tips @ found[rows.tool])
    return rigid.lengths_and_angles(placed @ rigid.placement(rows.orientation, rows.position))


def points_together(
    rows: TipObservations, setup: IntArray, bases: Array, given: BoolArray, points: Array, sought: BoolArray
) -> tuple[Array, BoolArray]:
    """Return tool points (k, 3) that the positions of all set-ups (N,) together explain best, and which are shown (k,).

    Only those that are ``sought`` (k,) change. ``bases`` (b, 4, 4) move with them, by small turns, but for those that
    are ``given`` (b,).
    """
    R, of = rows.tips[:, :3, :3], np.flatnonzero(sought)
    L = np.concatenate([R * (rows.tool == k)[:, None, None] for k in of], axis=2)
    at = np.einsum("nij,ni->nj", bases[setup, :3, :3], rows.position - bases[setup, :3, 3])
    missed = at - rows.tips[:, :3, 3] - (R @ points[rows.tool, :, None])[..., 0]
    both = np.concatenate([L, missed[..., None]], axis=2)
    moving = np.unique(setup[~given[setup]])
    for s in moving:
        own = setup == s
        # What a base explains by moving is left out.
        moves = np.concatenate([np.broadcast_to(np.eye(3), (own.sum(), 3, 3)), rigid.skew(at[own])], axis=2)
        Q, _ = np.linalg.qr(moves.reshape(-1, 6))
        those = both[own].reshape(len(Q), -1)
        both[own] = (those - Q @ (Q.T @ those)).reshape(both[own].shape)
    flat = both.reshape(3 * len(both), -1)
    values, Vt, count = _best_shown(flat[:, :-1])
    spare = max(flat.shape[0] - 6 * len(moving) - count, 1)
    # As far as the rows say more than what is known of tools at all: bases that are far off mislead.
    width = np.linalg.norm(flat[:, -1]) / np.sqrt(spare) / TOOL
    along = flat[:, :-1] @ Vt[:count].T
    change = Vt[:count].T @ ((along.T @ flat[:, -1]) / (values[:count] ** 2 + width**2))
    left = np.linalg.norm(flat[:, -1] - flat[:, :-1] @ change)
    count = int(np.count_nonzero(values[:count] * TOOL > left * np.sqrt(flat.shape[0] / spare)))
    found, shown = points.copy(), ~sought
    found[of] += change.reshape(-1, 3)
    shown[of] = _shown(Vt, count, len(of))
    return found, shown


def _best_shown(seen: Array) -> tuple[Array, Array, int]:
    """Return singular values, right singular vectors, best shown first, and how many of them are seen at all."""
    _, values, Vt = linear.svd(linear.triangle(seen))
    return values, Vt, int(np.count_nonzero(values > _NEGLIGIBLE * max(float(values.max(initial=0.0)), 1.0)))


def _shown(Vt: Array, count: int, n_tools: int) -> BoolArray:
    """Return the tools (k,) that have hardly a part in directions behind the first ``count``."""
    if count == len(Vt):
        return np.ones(n_tools, dtype=np.bool_)
    return np.asarray(np.linalg.norm(Vt[count:].T.reshape(-1, 3, len(Vt) - count), axis=(1, 2)) < _HARDLY)


def _base_and_change(
    rows: TipObservations, known: KnownFrames, turned: BoolArray, n_tools: int, predicted: Array, L: Array
) -> tuple[Array, Array]:
    """Return the base (4, 4) and the coefficients (c,) of changes L (N, 3, c) to the ``predicted`` positions (N, 3)."""
    if known.base is not None:
        found = (rows.position - known.base[:3, 3]) @ known.base[:3, :3] - predicted
        return known.base, _solve(L.reshape(3 * len(L), -1), found.ravel())
    # The mean row, which the base's translation alone explains, is taken out.
    centre = rows.position.mean(axis=0)
    y, L_c, predicted_c = rows.position - centre, L - L.mean(axis=0), predicted - predicted.mean(axis=0)
    # A y = (y^T kron I) vec(A), column by column; the same for every column of a measured rotation.
    X = np.einsum("ni,jk->njik", y, np.eye(3)).reshape(-1, 9)
    whole = linear.triangle(np.column_stack([L_c.reshape(len(X), -1), X, predicted_c.ravel()]))
    by_change, by_turn, told = whole[:, : L.shape[2]], whole[:, L.shape[2] : -1], whole[:, -1]
    A = _rotation(rows, turned, known.rotations, n_tools, by_change, by_turn, told)
    change = _solve(by_change, by_turn @ A.T.ravel() - told)
    return rigid.placement(A.T, centre - A.T @ (predicted + L @ change).mean(axis=0)), change


def _rotation(
    rows: TipObservations,
    turned: BoolArray,
    rotations: Array | None,
    n_tools: int,
    L: Array,
    X: Array,
    c: Array,
) -> Array:
    """Return A = R_base^T from centred positions, ``L change = X vec(A) - c`` (q,), and from orientations."""
    U, values, _ = linear.svd(L, full_matrices=False)
    U = U[:, values > _NEGLIGIBLE * max(float(values.max(initial=0.0)), 1.0)]
    blocks = [np.column_stack([X - U @ (U.T @ X), c - U @ (U.T @ c)])]
    for k in range(n_tools):
        own = turned & (rows.tool == k)
        if not own.any():
            continue
        R_t = np.swapaxes(rows.tips[own, :3, :3], -1, -2)
        # vec(R^T A R_measured) = (R_measured^T kron R^T) vec(A)
        K = np.einsum("nji,nkl->nikjl", rows.orientation[own], R_t).reshape(-1, 9, 9)
        if rotations is None:
            K, target = K - K.mean(axis=0), np.zeros((len(K), 9))
        else:
            target = np.broadcast_to(rotations[k].T.ravel(), (len(K), 9))
        blocks.append(_LEVER * np.column_stack([K.reshape(-1, 9), target.ravel()]))
    quadratic = linear.triangle(np.concatenate(blocks))
    return _best_rotation(quadratic[:, :-1], quadratic[:, -1])


def _solve(L: Array, c: Array) -> Array:
    """Return the shortest least-squares solution of L z = c."""
    return np.asarray(np.linalg.lstsq(L, c, rcond=_NEGLIGIBLE)[0] if L.shape[1] else np.zeros(0))


@cache
def cube_rotations() -> Array:
    """Return the 24 rotations (24, 3, 3) of the cube: every rotation is within 63 degrees of one of them."""
    found = []
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1.0, -1.0), repeat=3):
            M = np.eye(3)[list(order)] * np.array(signs)[:, None]
            if np.linalg.det(M) > 0.0:
                found.append(M)
    return read_only(np.stack(found))


def _best_rotation(X: Array, c: Array) -> Array:
    """Return the rotation A that minimises ``|X vec(A) - c|``, by Newton's method from many starts at once.

    Where much is left, as of a table with a mistake in it, the Hessian without its second derivatives creeps.
    """
    # Numbers that no table may have, since nothing can be divided by them, say as little as zeros.
    X = np.where(np.abs(X) < SMALLEST_CELL, 0.0, X)
    relaxed = _solve(X, c).reshape(3, 3).T
    A = np.concatenate([rigid.nearest_rotation(relaxed)[None], cube_rotations()])
    basis, eye = rigid.skew(np.eye(3)), np.eye(3)

    def residual(A: Array) -> Array:
        return np.asarray(np.swapaxes(A, -1, -2).reshape(len(A), 9) @ X.T - c)

    r = residual(A)
    cost = (r * r).sum(axis=1)
    damping = np.full(len(A), 1e-3)
    for done in range(_MOST_STEPS):
        # d vec(A exp(w)) = vec(A [w]x)
        J = np.swapaxes(A[:, None] @ basis, -1, -2).reshape(len(A), 3, 9) @ X.T
        H = J @ np.swapaxes(J, -1, -2)
        g = (J @ r[:, :, None])[..., 0]
        size = np.trace(H, axis1=1, axis2=2)[:, None, None] / 3.0
        # d2 vec(A exp(w)) = vec(A [w]x [w]x), and [w]x [w]x = w w^T - |w|^2
        C = (r @ X).reshape(-1, 3, 3) @ A
        H = H + 0.5 * (C + np.swapaxes(C, -1, -2)) - np.trace(C, axis1=1, axis2=2)[:, None, None] * eye
        lifted = np.maximum(-2.0 * np.linalg.eigvalsh(H)[:, :1, None], 0.0)  # downhill, where it is no minimum
        damped = H + (damping[:, None, None] * size + lifted + np.finfo(float).tiny) * eye
        step = -np.linalg.solve(damped, g[..., None])[..., 0]
        trial = A @ rigid.exp3(step)
        r_trial = residual(trial)
        cost_trial = (r_trial * r_trial).sum(axis=1)
        better = cost_trial < cost
        A, r = np.where(better[:, None, None], trial, A), np.where(better[:, None], r_trial, r)
        gain, cost = cost - cost_trial, np.where(better, cost_trial, cost)
        damping = np.where(better, np.maximum(0.1 * damping, 1e-12), 10.0 * damping)
        leading = better & (cost <= 1.01 * cost.min())
        if np.max(np.where(leading, np.linalg.norm(step, axis=1), 0.0)) < _STEP_TOLERANCE:
            break
        if done >= _MANY_STEPS and not np.any(leading & (gain > _HARDLY_LOWER * cost)):
            break
    return rigid.nearest_rotation(A[np.argmin(cost)])
