"""Closed loops: joints that no encoder reads, found from frames that must coincide.

Loop l asks that the origins of two frames A and B coincide in some directions S of A: ``g = S R_A^T (p_B - p_A) = 0``.
The passive joints are solved by Newton's method from their nominal coupling; their derivatives with respect to anything
follow from the implicit function theorem, ``dq_passive = -(dg/dq_passive)^-1 dg``.

A loop can be closed in several ways, and the machine was assembled in one. Where the coupling is far from what closes,
Newton's method may find another; there the way is followed in small steps, from readings where the coupling is near.

Only the joints behind the last one that carries both frames matter to a loop: these are walked here, all rows at once.
A turn z of such a joint at p, on the way to B, changes the gap by ``S R_A^T (z x (p_B - p))``; on the way to A it turns
the directions too, and the change is the same with the other sign, whatever the gap is.

Loops that no passive joint of another one moves are solved without it: what is asked of an arm of many grows with their
number, and not with its third power.
"""

from collections.abc import Sequence
from functools import cached_property
from typing import NamedTuple

import numpy as np

from calib.foundations.arrays import Array, BoolArray
from calib.foundations.errors import PoseError
from calib.robot.kinematics import way
from calib.robot.skeleton import Skeleton, derivative

_MOST_STEPS = 30
# Where a quarter of a micrometre is left, the links cannot reach; rounding leaves a thousandth of a nanometre.
_OPEN = 1e-10
# Newton's steps square: after one this small (rad or m) nothing is left but rounding.
_LAST_STEP = 1e-9
_NEGLIGIBLE = 1e-14
# Passive joints that are found nearer than this, in rad or m, to where the search began, are on the branch meant.
_NEAR = 0.5
# The way from home to far readings: its first stretch, as a share, and the shortest; so many of Newton's steps in one.
_FIRST_STRETCH, _LEAST_STRETCH, _STEPS_OF_ONE = 0.5, 1.0 / 64.0, 8
_NO_REACH = "cannot close: its links do not reach"
_NO_HOME = "cannot close: its links do not reach, or its passive joints are far from where their <mimic>, or zero, is"
# Smallest singular value of the closure, in m/rad or per unit: below it a pose is at a dead centre.
_SINGULAR = 1e-6


class Loop(NamedTuple):
    """A closed loop. ``ends``: the joints that carry frames A and B; ``closes``: axes of A, of x y z = 0 1 2.

    ``passive``: numbers of the moving joints that the loop determines, as many as directions that close.
    """

    name: str
    ends: tuple[int, int]
    closes: tuple[int, ...]
    passive: tuple[int, ...]


class _Frames(NamedTuple):
    """Columns (3, 3, N) of the rotation and origin (3, N) of a frame, in the joint that carries the whole loop.

    Rows come last, so that what is done to all of them is done at once.
    """

    R: Array
    p: Array


class _Side(NamedTuple):
    """The way from the joint that carries the whole loop to one of its two frames.

    ``joints``: moving joints on the way, with their ``placements`` (len, 4, 4); ``end`` (4, 4): the frame in the last.
    ``still``: how many of them come before the first passive one. ``sign``: -1 towards A, +1 towards B.
    """

    joints: tuple[int, ...]
    placements: Array
    end: Array
    still: int
    sign: float


class _Ring(NamedTuple):
    """A loop ready to be walked. ``follows`` (f, 6 n): the twists that change the gap, as they follow deviations.

    f counts six for every joint of both sides, in order, then six for each of the two frames.
    """

    closes: list[int]
    sides: tuple[_Side, _Side]
    follows: Array

    @property
    def joints(self) -> tuple[int, ...]:
        """The moving joints of both sides, in order."""
        return self.sides[0].joints + self.sides[1].joints


def passive_joints(loops: Sequence[Loop]) -> list[int]:
    """Return the numbers of all passive joints, loop by loop."""
    return [j for loop in loops for j in loop.passive]


class Closure:
    """The loops of a tree at given deviations.

    ``homes`` (k, nj): joint positions with the passive joints where the coupling puts them, which is right near one.
    """

    def __init__(self, s: Skeleton, loops: Sequence[Loop], homes: Array) -> None:
        self._passive = passive_joints(loops)
        self._systems = [LoopsTogether(s, [loops[i] for i in own], homes) for own in together(s, loops)]

    def close(self, q: Array) -> Array:
        """Return joint positions (N, nj) with the passive joints solved, from q (N, nj) as start.

        Raises PoseError naming the loops that move each other of which some cannot close or are at a dead centre, and
        the first row where they do not.
        """
        for system in self._systems:
            q = system.close(q)
        return q

    def closes(self, q: Array) -> BoolArray:
        """Return in which rows :meth:`close` finds joint positions from q (N, nj)."""
        found = np.ones(len(q), dtype=bool)
        for system in self._systems:
            found[found] = system.closes(q[found])
        return found

    def determinants(self, q: Array) -> Array:
        """Return the determinants (N,) of the closure by the passive joints, where :meth:`close` finds them from q.

        q (N, nj); nan in rows where it does not. Each is 0 at a dead centre, whose two sides differ in sign, and to be
        compared with its own kind alone.
        """
        found = self._systems[0].determinants(q)
        for system in self._systems[1:]:
            found *= system.determinants(q)
        return found

    def rates(self, q: Array, by_position: Array) -> Array:
        """Return how the passive joints follow deviations and active joints, at closed positions q (N, nj).

        (N, k, 6 n + a): per change of the n joints' deviations, then of parameters that move the positions of the
        joints by ``by_position`` (nj, a), where rows of passive joints do not count.
        """
        if len(self._systems) == 1:
            return self._systems[0].rates(q, by_position)
        found: Array | None = None
        for system in self._systems:
            own = system.rates(q, by_position)
            if found is None:
                found = np.empty((len(q), len(self._passive), own.shape[2]))
            found[:, [self._passive.index(j) for j in system.passive]] = own
        assert found is not None, "a closure has loops"
        return found


class LoopsTogether:
    """Loops that move each other, by their ``passive`` joints; the rest as in :class:`Closure`."""

    def __init__(self, s: Skeleton, loops: Sequence[Loop], homes: Array) -> None:
        self._homes = homes
        self._loops, self._types, self.passive = tuple(loops), s.tree.types, passive_joints(loops)
        self._rings = [_ring(s, loop, self.passive) for loop in loops]

    def close(self, q: Array) -> Array:
        """Return what :meth:`Closure.close` does, and raise as it does."""
        q, dead, open_ = self._sought(q)
        self._refuse(dead, "is at a dead centre: its joints may go two ways")
        # Without a home, nothing but the search from where the coupling puts the passive joints has been tried.
        self._refuse(open_, _NO_REACH if self._home is not None else _NO_HOME)
        return q

    def closes(self, q: Array) -> BoolArray:
        """Return what :meth:`Closure.closes` does."""
        _, dead, open_ = self._sought(q)
        return ~(dead | open_)

    def _sought(self, q: Array) -> tuple[Array, BoolArray, BoolArray]:
        """Return joint positions (N, nj) with the passive joints solved, which rows are at a dead centre, which open.

        Where that is far from q, or nothing is found, they are sought anew on the way from home.
        """
        found, dead, open_ = self._from(q)
        far = np.flatnonzero(dead | open_ | (self._change(found, q) > _NEAR))
        if len(far) and self._home is not None:
            reached, there = self._along(self._home, q[far])
            rows = far[there]
            found[rows], dead[rows], open_[rows] = reached[there], False, False
        return found, dead, open_

    @cached_property
    def _home(self) -> tuple[Array, Array] | None:
        """Joint positions (nj) as the coupling puts them and closed, where these are nearest; None: nowhere near."""
        found, dead, open_ = self._from(self._homes)
        change = self._change(found, self._homes)
        change[dead | open_] = np.inf
        best = int(np.argmin(change))
        return (self._homes[best], found[best]) if change[best] <= _NEAR else None

    def _change(self, found: Array, q: Array) -> Array:
        """Return how far (N,) the passive joints of found (N, nj) are from those of q."""
        return np.asarray(np.max(np.abs((found - q)[:, self.passive]), axis=1, initial=0.0))

    def _along(self, home: tuple[Array, Array], q: Array) -> tuple[Array, BoolArray]:
        """Return joint positions (N, nj) on the branch of home, and which rows (N,) are reached.

        ``home``: joint positions (nj) as the coupling puts them, and closed.
        """
        whole = q - home[0]
        at, gone, stretch = np.tile(home[1], (len(q), 1)), np.zeros(len(q)), np.full(len(q), _FIRST_STRETCH)
        side = np.sign(self._turning(home[1][None]))
        while len(going := np.flatnonzero((gone < 1.0) & (stretch >= _LEAST_STRETCH))):
            ahead = np.minimum(1.0, gone[going] + stretch[going])
            start = home[0] + ahead[:, None] * whole[going]
            start[:, self.passive] = (at[going] + (ahead - gone[going])[:, None] * whole[going])[:, self.passive]
            found, dead, open_ = self._from(start, _STEPS_OF_ONE, _NEAR)
            good = ~(dead | open_)
            # Branches meet at dead centres: near one, both are near where the search began.
            good[good] = np.sign(self._turning(found[good])) == side
            at[going[good]], gone[going[good]] = found[good], ahead[good]
            stretch[going[~good]] /= 2.0
        return at, gone >= 1.0

    def _from(self, q: Array, most: int = _MOST_STEPS, farthest: float = np.inf) -> tuple[Array, BoolArray, BoolArray]:
        """Return what :meth:`_sought` does, with ``most`` of Newton's steps from q (N, nj) alone.

        What they lead ``farthest`` from q, or farther, counts as open.

        A row that has come to its end is left alone: few need as many steps as the last one.
        """
        found, dead, open_ = q.copy(), np.zeros(len(q), dtype=bool), np.zeros(len(q), dtype=bool)
        begun, left, q, still = q, np.arange(len(q)), q.copy(), self._still(q)
        for _ in range(most):
            stuck, step = self._step(q, still)
            dead[left[stuck]] = True
            q[:, self.passive] -= step
            strayed = self._change(q, begun[left]) >= farthest
            open_[left[strayed]] = True
            going = ~(stuck | strayed) & (np.max(np.abs(step), axis=1, initial=0.0) >= _LAST_STEP)
            if not going.all():
                found[left[~going]] = q[~going]
                left, q, still = left[going], q[going], _rows_of(still, going)
            if not len(left):
                return found, dead, open_
        found[left], open_[left] = q, self._open(q, still)
        return found, dead, open_

    def determinants(self, q: Array) -> Array:
        """Return what :meth:`Closure.determinants` does, of these loops."""
        q, dead, open_ = self._sought(q)
        found, closed = np.full(len(q), np.nan), ~(dead | open_)
        found[closed] = self._turning(q[closed])
        return found

    def _turning(self, q: Array) -> Array:
        """Return the determinants (N,) of the closure by the passive joints, at closed positions q (N, nj)."""
        return np.asarray(np.linalg.det(self._gaps(q, self._still(q))[1]))

    def _still(self, q: Array) -> list[list[_Frames]]:
        """Return, for both sides of every ring, the frames (N) behind the joints before the first passive one."""
        return [[self._walk(side, slice(side.still), q)[-1] for side in ring.sides] for ring in self._rings]

    def _step(self, q: Array, still: Sequence[Sequence[_Frames]]) -> tuple[BoolArray, Array]:
        """Return which rows are at a dead centre (N,), and Newton's step (N, k) of the passive joints in the others."""
        value, slope = self._gaps(q, still)
        dead = at_dead_centre(slope)
        if dead.any():
            slope[dead] = np.eye(slope.shape[1])
        step = np.asarray(np.linalg.solve(slope, value[:, :, None])[:, :, 0], dtype=np.float64)
        # A step of more than half a radian could leave the branch that the machine was assembled in.
        step *= np.minimum(1.0, 0.5 / np.maximum(np.max(np.abs(step), axis=1, keepdims=True), _NEGLIGIBLE))
        return dead, step

    def _open(self, q: Array, still: Sequence[Sequence[_Frames]]) -> BoolArray:
        """Tell in which rows the links do not reach, where Newton's steps have come to no end."""
        return np.asarray(np.max(np.abs(self._gaps(q, still)[0]), axis=1) > _OPEN)

    def rates(self, q: Array, by_position: Array) -> Array:
        """Return what :meth:`Closure.rates` does, of these loops."""
        driven = by_position.copy()
        driven[self.passive] = 0.0
        by_twists = [self._by_twist(ring, q) for ring in self._rings]
        slope = np.zeros((len(q), len(self.passive), len(self.passive)))
        row = 0
        for ring, by_twist in zip(self._rings, by_twists, strict=True):
            rows = slice(row, row := row + len(ring.closes))
            for i, j in enumerate(ring.joints):
                if j in self.passive:
                    slope[:, rows, self.passive.index(j)] = by_twist[:, :, 6 * i + self._own(j)]
        inverse, row, found = -np.linalg.inv(slope), 0, np.zeros((1, 1))
        for ring, by_twist in zip(self._rings, by_twists, strict=True):
            shares = inverse[:, :, row : (row := row + len(ring.closes))] @ by_twist
            found = found + shares.reshape(-1, by_twist.shape[2]) @ self._follows(ring, driven)
        return found.reshape(*slope.shape[:2], found.shape[1])

    def _own(self, joint: int) -> int:
        """Return which component of a twist is a joint's own motion, which commutes with a change of its placement."""
        return 5 if self._types[joint] == "revolute" else 2

    def _follows(self, ring: _Ring, driven: Array) -> Array:
        """Return how the twists that change a gap follow deviations and driven positions: (f, 6 n + a)."""
        by_position = np.zeros((len(ring.follows), driven.shape[1]))
        for i, j in enumerate(ring.joints):
            by_position[6 * i + self._own(j)] = driven[j]
        return np.hstack([ring.follows, by_position])

    def _walk(self, side: _Side, part: slice, q: Array, start: _Frames | None = None) -> list[_Frames]:
        """Return the frames of some joints of a side, each before its own motion, then that behind the last one."""
        R, p = _at_rest(len(q)) if start is None else start
        found: list[_Frames] = []
        for j, placement in zip(side.joints[part], side.placements[part], strict=True):
            R, p = _placed(R, p, placement)
            found.append(_Frames(R, p))
            if self._types[j] == "prismatic":
                p = p + R[2] * q[:, j]
            else:
                c, s, before = np.cos(q[:, j]), np.sin(q[:, j]), R
                R = np.empty_like(before)
                R[0], R[1], R[2] = before[0] * c + before[1] * s, before[1] * c - before[0] * s, before[2]
        return [*found, _Frames(R, p)]

    def _gaps(self, q: Array, starts: Sequence[Sequence[_Frames]]) -> tuple[Array, Array]:
        """Return all gaps (N, k) and their change (N, k, k) with the passive joints.

        ``starts``: for both sides of every ring, the frames (N) behind its still joints.
        """
        values, slopes = [], []
        for ring, start in zip(self._rings, starts, strict=True):
            parts = [slice(side.still, None) for side in ring.sides]
            walks = [self._walk(side, part, q, at) for side, part, at in zip(ring.sides, parts, start, strict=True)]
            a, b = (_placed(*walk[-1], side.end) for walk, side in zip(walks, ring.sides, strict=True))
            moved = np.zeros((3, len(self.passive), len(q)))
            for side, part, walk in zip(ring.sides, parts, walks, strict=True):
                for j, (R, p) in zip(side.joints[part], walk, strict=False):
                    if j in self.passive:
                        by_joint = R[2] if self._types[j] == "prismatic" else _cross(R[2], b.p - p)
                        moved[:, self.passive.index(j)] = side.sign * by_joint
            S = a.R[ring.closes]
            values.append(np.einsum("mcn,cn->nm", S, b.p - a.p))
            slopes.append(np.einsum("mcn,ckn->nmk", S, moved))
        return np.concatenate(values, axis=1), np.concatenate(slopes, axis=1)

    def _by_twist(self, ring: _Ring, q: Array) -> Array:
        """Return how a gap follows local twists: of the placements of its joints, then of its frames (N, m, f)."""
        walks = [self._walk(side, slice(None), q) for side in ring.sides]
        a, b = (_placed(*walk[-1], side.end) for walk, side in zip(walks, ring.sides, strict=True))
        at = [frames for walk in walks for frames in walk[:-1]] + [a, b]
        signs = [side.sign for side, walk in zip(ring.sides, walks, strict=True) for _ in walk[:-1]] + [-1.0, 1.0]
        R, p = (np.stack(own) for own in zip(*at, strict=True))
        # S (v + w x d) with v, w and d, the way to B, in the frame that is twisted: w . (d x S) each row.
        S = a.R[ring.closes] * np.reshape(signs, (-1, 1, 1, 1))
        local, d = np.einsum("imcn,ikcn->kimn", S, R), np.einsum("icn,ikcn->kin", b.p - p, R)
        found = np.concatenate([local, _cross(d[:, :, None], local)])
        return found.transpose(3, 2, 1, 0).reshape(len(q), len(ring.closes), 6 * len(at))

    def _refuse(self, rows: BoolArray, why: str) -> None:
        if np.any(rows):
            reason = f"loop {', '.join(repr(loop.name) for loop in self._loops)} {why}"
            raise PoseError(int(np.argmax(rows)), reason, np.flatnonzero(rows).tolist())


def together(s: Skeleton, loops: Sequence[Loop]) -> list[list[int]]:
    """Return the numbers of loops that are to be solved at once: where passive joints of one are on the way of another.

    In order of the first of each.
    """
    passive = [set(loop.passive) for loop in loops]
    on_way = [set(_between(s, loop)[0]) | set(_between(s, loop)[1]) for loop in loops]
    found: list[list[int]] = []
    for i in range(len(loops)):
        joined = [own for own in found if any(passive[k] & on_way[i] or passive[i] & on_way[k] for k in own)]
        merged = sorted([i, *(k for own in joined for k in own)])
        found = [own for own in found if own not in joined] + [merged]
    return sorted(found)


def _between(s: Skeleton, loop: Loop) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Return the moving joints from the last one that carries both frames of a loop to each of them."""
    a, b = (way(s.tree.parents, s.end_frame(end).joint) for end in loop.ends)
    common = sum(one == other for one, other in zip(a, b, strict=False))
    return a[common:], b[common:]


def _ring(s: Skeleton, loop: Loop, passive: Sequence[int]) -> _Ring:
    sides: list[_Side] = []
    rows: list[Array] = []
    tails: list[Array] = []
    for end, joints, sign in zip(loop.ends, _between(s, loop), (-1.0, 1.0), strict=True):
        still = next((i for i, j in enumerate(joints) if j in passive), len(joints))
        sides.append(_Side(joints, s.tree.placements[list(joints)], s.end_frame(end).placement, still, sign))
        by_joint, tail = derivative(s, end)
        rows += [by_joint[6 * j : 6 * j + 6] for j in joints]
        tails.append(tail)
    return _Ring(list(loop.closes), (sides[0], sides[1]), np.concatenate(rows + tails))


def _rows_of(frames: Sequence[Sequence[_Frames]], rows: BoolArray) -> list[list[_Frames]]:
    return [[_Frames(one.R[:, :, rows], one.p[:, rows]) for one in own] for own in frames]


def _at_rest(n: int) -> _Frames:
    return _Frames(np.repeat(np.eye(3)[:, :, None], n, axis=2), np.zeros((3, n)))


def _placed(R: Array, p: Array, placement: Array) -> _Frames:
    """Return frames (N) moved on by one placement (4, 4) in themselves."""
    moved = (placement[:3].T @ R.reshape(3, 3 * p.shape[1])).reshape(4, *p.shape)
    return _Frames(moved[:3], p + moved[3])


def _cross(a: Array, b: Array) -> Array:
    """Return cross products (3, ...); numpy's own takes several times as long."""
    found = np.empty(np.broadcast_shapes(a.shape, b.shape))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        np.subtract(a[j] * b[k], a[k] * b[j], out=found[i])
    return found


def at_dead_centre(slope: Array) -> BoolArray:
    """Tell of which closures (N, k, k) a singular value is below the smallest that is allowed.

    The determinant is their product, and found in an eighth of the time: where it is large for what the others can be
    at most, none is small. The singular values decide about what remains.
    """
    largest = np.sqrt(np.einsum("nij,nij->n", slope, slope))
    found = np.asarray(~(np.abs(np.linalg.det(slope)) > 2.0 * _SINGULAR * largest ** (slope.shape[1] - 1)))
    if found.any():
        found[found] = np.linalg.svd(slope[found], compute_uv=False)[:, -1] < _SINGULAR
    return found
