"""What parameters imitate of the motions of a whole set-up, and which strains touches hardly tell."""

from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from calib.foundations import linear, rigid
from calib.foundations.arrays import Array, IntArray, read_only
from calib.identification.machine import Frames
from calib.identification.observations.seen import Moved
from calib.identification.parameters import Parameter, scales
from calib.identification.set_up_motions import Motions, unknown_length
from calib.identification.targets import Shape, shape_of
from calib.identification.unmeasured import Unmeasured
from calib.measurement.kinds import TOUCHES
from calib.measurement.measurements import Measurements

if TYPE_CHECKING:
    from calib.identification.rates import Block

# Two ways to move every tool are the same when they differ by less than this share.
_SAME = 1e-7
# What of a target's twist moves what is measured of it: of a point its place, of a plane height and tilts.
_SEEN_OF: Mapping[Shape, slice] = {"point": slice(0, 3), "plane": slice(2, 5), "frame": slice(0, 6)}
# A motion is imitated clearly by more than this share of a radian, or of the robot's reach; and it moves what is
# touched clearly where what is left of touches is less than this share.
_CLEARLY = 0.1
# The unit in which things are shifted, in m, and turned, in rad: as large as errors of a machine.
_SHIFT = 1e-3
# A length, in m, or a direction that is none.
_NONE = 1e-9
# The data tell nothing of a strain of which they tell less than by so many numbers that it shrinks.
_NOTHING = 4.0
# Where these are strained the tool goes along; a ball that is strained is none.
_FOLLOWED = ("socket", "plane")
# An orthonormal basis of symmetric strains: growing, and five that change no volume.
_STRAINS = read_only(
    np.array(
        [
            np.eye(3) / np.sqrt(3.0),
            np.diag([1.0, 1.0, -2.0]) / np.sqrt(6.0),
            np.diag([1.0, -1.0, 0.0]) / np.sqrt(2.0),
            *(np.sqrt(0.5) * (np.outer(a, b) + np.outer(b, a)) for a, b in combinations(np.eye(3), 2)),
        ]
    )
)


class TargetsFollowed(NamedTuple):
    """How targets follow common parameters: local twists ``by_twist`` (k, 6, c) of those of these ``numbers`` (k,)."""

    numbers: IntArray
    by_twist: Array

    def twists(self, numbers: Sequence[int]) -> Array:
        """Return those (n, 6, c) of some targets, by number; zero for one that follows none."""
        found = np.zeros((len(numbers), *self.by_twist.shape[1:]))
        there = np.isin(numbers, self.numbers)
        found[there] = self.by_twist[np.searchsorted(self.numbers, np.asarray(numbers, dtype=np.intp)[there])]
        return found


class SetUpMotions:
    """Collects, row by row, what the motions of a whole set-up do to tools, and what of it parameters can imitate.

    ``frames``: where targets are, and what scalars are.
    """

    def __init__(self, parameters: Sequence[Parameter], motions: Motions, reach: float, frames: Frames) -> None:
        self._motions, self._reach, self._targets, self._numbers = motions, reach, frames.targets, frames.scalars
        self._scales = scales(parameters)
        self._holds = np.array([0.0 if parameter.nuisance else parameter.hold for parameter in parameters])
        self._of_targets = np.array([parameter.nuisance for parameter in parameters], dtype=np.bool_)
        self._lengths = np.array([parameter.unit == "m" for parameter in parameters], dtype=np.bool_)
        self._strains = _STRAINS if motions.strained else _STRAINS[:0]
        self._triangle = np.empty((0, len(parameters) + self._count + self._rigid))
        # By how much strains shrink the numbers of touches, their squares where they are noise, and as they are.
        self._shorter, (self._shrinking, self._shrunk) = np.zeros(n := len(self._strains)), np.zeros((2, n, n))

    @property
    def _count(self) -> int:
        return self._motions.directions + len(self._strains) + self._motions.grows

    @property
    def _strain(self) -> slice:
        """Return which of the motions are strains: those behind turns, and growing."""
        return slice(self._count - len(self._strains), self._count)

    @property
    def _rigid(self) -> int:
        """Return how many columns, behind the motions, shift what links carry, and shift and turn what is strained."""
        return 3 * len(self._motions.shifted) + 6 * bool(self._motions.strained)

    def _shift_of(self, link: str | None) -> slice:
        """Return which columns, behind the parameters, shift what a link carries; None: shift and turn the strained."""
        shifted = self._motions.shifted
        first = self._count + 3 * (len(shifted) if link is None else shifted.index(link))
        return slice(first, first + (6 if link is None else 3))

    def _moved(self, x: Array, link: str | None) -> Array:
        """Return how points (n, 3) on a link, None being the floor, move (n, 3, k): turned, growing, and strained."""
        about, turns = self._motions.of(link)
        away = x - about
        turned = np.cross(turns.T[None], away[:, None]).swapaxes(-1, -2)
        strained = np.moveaxis(away @ self._strains, 0, -1)
        return np.concatenate([turned, *[away[:, :, None]] * self._motions.grows, strained], axis=2)

    def _moved_rigidly(self, x: Array) -> Array:
        """Return how points (n, 3) that are strained move (n, 3, 6) when all of them are shifted, and turned."""
        turned = -rigid.skew(x - self._motions.about)
        return np.asarray(_SHIFT * np.concatenate([np.broadcast_to(np.eye(3), turned.shape), turned], axis=2))

    def add(self, data: Measurements, block: "Block", sigma: Array) -> None:
        """Add rows of a set with their sigmas (n, d)."""
        J = block.J
        changed = np.zeros((*J.shape[:2], self._count + self._rigid))
        for one in block.moved:
            by_shift, by_turn = one.by_motion
            for link, own in block.grounds:
                turns = self._motions.of(link)[1]
                changed[own, :, : self._count] += by_shift[own] @ self._moved(one.placed[own, :3, 3], link)
                if link in self._motions.shifted:
                    changed[own, :, self._shift_of(link)] += by_shift[own] * _SHIFT
                changed[own, :, : turns.shape[1]] += by_turn[own] @ turns
        if len(self._strains):
            self._strain_targets(changed, block.moved[0], block.observed.residual / sigma, data, block.rows)
        # What parameters, targets left out, do to a tool.
        rows = np.concatenate([np.where(self._of_targets, 0.0, J), changed], axis=2) / sigma[:, :, None]
        self._triangle = linear.triangle(np.concatenate([self._triangle, rows.reshape(-1, rows.shape[2])]))

    def _strain_targets(self, changed: Array, tool: Moved, r: Array, data: Measurements, rows: slice) -> None:
        """Write what strains of unknown targets do to rows (n, d, k), which the tool would have to follow.

        What is measured of anything else stays as it is. A tool that touches is where its target is, but for what is
        left ``r`` (n, d), whitened.
        """
        targets = data.target[rows]
        unknown = [t for t, name in enumerate(data.targets) if name in self._motions.strained]
        follow = np.flatnonzero(np.isin(targets, unknown))
        changed[:, :, self._strain] = 0.0
        where = (tool.placed if data.kind in _FOLLOWED else self._targets[targets])[follow, :3, 3]
        by_shift = tool.by_motion[0][follow]
        changed[follow, :, self._strain] = by_shift @ self._moved(where, None)[:, :, self._strain]
        changed[follow, :, self._shift_of(None)] = by_shift @ self._moved_rigidly(where)
        if data.kind in TOUCHES:
            shrunk = by_shift[:, None] @ self._strains @ by_shift[:, None].swapaxes(-1, -2)
            of_these = shrunk @ r[follow, None, :, None]
            self._shorter += np.einsum("nsaa->s", shrunk)
            self._shrinking += np.einsum("nsab,ntab->st", shrunk, shrunk)
            self._shrunk += np.einsum("nsab,ntab->st", of_these, of_these)

    def directions(
        self,
        measurements: Sequence[Measurements],
        of_targets: TargetsFollowed,
        by_scalars: Array,
        relations: tuple[Sequence[int], Array],
    ) -> Unmeasured:
        """Return the motions that parameters imitate.

        ``of_targets`` that are common, ``by_scalars`` (s, p): scalars, as the scaled parameters change; targets
        that were eliminated follow the data. None where what a motion takes is held, and where nothing of it is seen: a
        robot that turns or grows about the only point that it touches moves no row; of growing, which is the last where
        it is a motion, zeros are left. Turns may be imitated about one axis alone, and along no axis of a frame: a link
        turns with the joint before it. ``relations``: which targets are related, by number, and derivatives (k, m, 6)
        of what is known by their twists, whitened.
        """
        p, q = len(self._scales), len(self._scales) + self._count
        J, C = np.delete(self._triangle, np.s_[p:q], axis=1), self._triangle[:, p:q]
        exact, strain = slice(None, self._strain.start), self._strain
        X = np.zeros((J.shape[1], self._count))
        on_links = J[:, : p + 3 * len(self._motions.shifted)]
        X[: on_links.shape[1], exact] = np.linalg.lstsq(on_links, C[:, exact], rcond=_SAME)[0]
        left = J @ X - C
        # A turn shows in angles, growing in lengths, each of a size that is known.
        own, lengths, sizes, kept = ~self._of_targets, self._lengths, X[:p] * self._scales[:, None], []
        for some, shown, size in (
            (slice(None, self._motions.directions), own & ~lengths, 1.0),
            (slice(self._motions.directions, strain.start), own & lengths, self._reach),
        ):
            seen = np.linalg.norm(C[:, some], axis=0).max(initial=0.0)
            V = _small(left[:, some], _SAME * seen)
            kept.append(np.eye(strain.start)[:, some] @ V @ _large(sizes[shown, some] @ V, _CLEARLY * size))
        turns, grows = kept
        strained = np.zeros((len(self._strains), 0))
        if self._motions.strained:
            related = self._of_relations(*relations)
            others = np.hstack(kept)
            X[:, strain], strained = self._hardly_told(
                J, C[:, strain], related, (X[:, exact] @ others, C[:, exact] @ others)
            )
        Z = X[:p] + self._of_common_targets(measurements, of_targets, by_scalars, -X[p:])
        if self._motions.grows and not grows.shape[1]:
            grows = np.zeros((strain.start, 1))
        return Unmeasured(_unit(Z[:, exact] @ np.hstack([turns, grows])), _unit(Z[:, strain] @ strained), self._holds)

    def _hardly_told(self, J: Array, C: Array, related: Array, exact: tuple[Array, Array]) -> tuple[Array, Array]:
        """Return what imitates strains (p + k, s), from rows J (q, p + k) and C (q, s), and those (s, j) to take out.

        ``related`` (m, s): what strains do to what is known between targets. ``exact``: what imitates other motions
        (p + k, n), and what these do (q, n): what they do to targets, or what shifts and turns of these do, is no
        strain. Priors tell of strains as well.
        """
        p = len(self._holds)
        others = np.hstack([J[:, p:], exact[1]])
        Q, sizes, _ = linear.svd(others / np.maximum(np.linalg.norm(others, axis=0), _NONE), full_matrices=False)
        Q = Q[:, sizes > _SAME]
        by_robot, strained = (A - Q @ (Q.T @ A) for A in (J[:, :p], C))
        rows, sought = (np.vstack(A) for A in ((by_robot, np.diag(self._holds)), (strained, np.zeros((p, C.shape[1])))))
        X = np.zeros((J.shape[1], C.shape[1]))
        X[:p] = np.linalg.lstsq(rows, sought, rcond=_SAME)[0]
        left = np.vstack([rows @ X[:p] - sought, related])
        V, at_least = _shrinking(self._shrinking, left, strained)
        told, W = np.linalg.eigh((left @ V).T @ (left @ V))
        V, at_least = V @ W, strained @ at_least @ W
        beside = np.linalg.lstsq(others, C - J @ X, rcond=None)[0]
        X[p:] += beside[: J.shape[1] - p]
        X += exact[0] @ beside[J.shape[1] - p :]
        shrunk = np.einsum("ik,ij,jk->k", V, self._shrunk, V)
        hardly = told < np.maximum((self._shorter @ V) ** 2, _NOTHING)
        return X, V[:, hardly & (shrunk < _CLEARLY**2 * np.sum(at_least**2, axis=0))]

    def _of_relations(self, numbers: Sequence[int], J: Array) -> Array:
        """Return what strains (m, s) do to what is known between targets, from derivatives J (m, n, 6) by twists."""
        twists = np.array([self._twist(t, None) for t in numbers]).reshape(len(numbers), 6, self._count)
        return np.asarray(np.tensordot(J, twists[:, :, self._strain], axes=2))

    def _twist(self, t: int, link: str | None, above: float = 0.0) -> Array:
        """Return how a target on a link, None being the floor, moves (6, k) with all; that of a plane turns with it.

        ``above``: how far the tool is above a plane, with its probe's radius: where it is moves.
        """
        turns, strain = self._motions.directions, self._strain
        R, c, n = self._targets[t, :3, :3], self._targets[t, :3, 3], self._targets[t, :3, 2]
        by_strain = self._strains @ n
        twist = np.zeros((6, self._count))
        twist[:3] = R.T @ self._moved(c[None], link)[0]
        twist[3:, :turns] = R.T @ self._motions.of(link)[1]
        twist[3:, strain] = R.T @ np.cross(by_strain, n).T
        twist[2, turns : strain.start] += above
        twist[2, strain] += above * (by_strain @ n)
        return twist

    def _of_common_targets(
        self, measurements: Sequence[Measurements], of_targets: TargetsFollowed, by_scalars: Array, shifts: Array
    ) -> Array:
        """Return how the scaled parameters (p, k) of targets and scalars follow the motions, and ``shifts`` (s, k).

        These are of what links carry, and of all that is strained, with its turns.
        """
        turns, strain = self._motions.directions, self._strain
        Z = np.zeros((len(self._scales), self._count))
        left = dict(zip(of_targets.numbers.tolist(), of_targets.by_twist, strict=True))
        for data in measurements:
            for t in sorted(left.keys() & set(data.target.tolist())):
                by_twist, R, link = left.pop(t), self._targets[t, :3, :3], data.link_of(t)
                twist = self._twist(t, link, data.value[data.target == t][0, 0] if data.kind == "plane" else 0.0)
                if link in self._motions.shifted:
                    first = 3 * self._motions.shifted.index(link)
                    twist[:3] += R.T @ (_SHIFT * shifts[first : first + 3])
                elif self._motions.strained:
                    twist[:3, strain] += (
                        R.T @ self._moved_rigidly(self._targets[t : t + 1, :3, 3])[0] @ shifts[-6:, strain]
                    )
                    twist[3:, strain] += R.T @ (_SHIFT * shifts[-3:, strain])
                rows = _SEEN_OF[shape_of(data) or "point"]
                Z += np.linalg.lstsq(by_twist[rows], twist[rows], rcond=None)[0]
            unknown = unknown_length(data)
            if unknown is not None and self._motions.grows:
                # What is left of the measured length when the unknown part is taken away grows.
                length = data.value[0, 0] if "radius" in data.uses else -data.value[0, 0]
                row, known = by_scalars[unknown], self._numbers[unknown] + length
                Z[:, turns] = np.where(row != 0.0, known * row / (row @ row), Z[:, turns])
        return Z


def _shrinking(by_noise: Array, *by_strain: Array) -> list[Array]:
    """Return strains (s, j) by which residuals shrink, each as if there were one number of them.

    ``by_noise`` (s, s): how residuals shrink. Strains by which they do not, such as along a plane, go with the others
    as far as that makes least of what all do, once for each of ``by_strain`` (q, s).
    """
    values, U = np.linalg.eigh(by_noise)
    shrink = values > _SAME * values.max(initial=1.0)
    own, others = U[:, shrink] / np.sqrt(values[shrink]), U[:, ~shrink]
    return [own - others @ np.linalg.lstsq(A @ others, A @ own, rcond=_SAME)[0] for A in by_strain]


def _unit(A: Array) -> Array:
    """Return the columns of A (q, k) with unit length; zeros stay."""
    return np.asarray(A / np.maximum(np.linalg.norm(A, axis=0), _NONE))


def _small(A: Array, most: float) -> Array:
    """Return orthonormal combinations (k, j) of the columns of A (q, k) that are no longer than ``most``."""
    _, values, V = linear.svd(A)
    return np.asarray(V[np.count_nonzero(values > most) :].T)


def _large(A: Array, least: float) -> Array:
    """Return orthonormal combinations (k, j) of the columns of A (q, k) that are longer than ``least``."""
    _, values, V = linear.svd(A, full_matrices=False)
    return np.asarray(V[values > least].T)
