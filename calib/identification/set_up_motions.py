"""Motions of a whole set-up that its measurements do not determine: turning it, and making it larger.

A machine that is larger throughout touches sockets, planes and balls in unknown places just as well, if their places
grow with it; and everything may be turned together. Residuals make such directions look determined: a machine shrunk to
a point explains every socket, and a turn turns what sockets leave unexplained. So they must be taken out, and not be
left to a threshold.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from calib.foundations import linear, rigid
from calib.foundations.arrays import Array, IntArray
from calib.identification import identifiability
from calib.identification.machine import Machine
from calib.identification.observations.seen import Moved
from calib.identification.parameters import Parameter, scales
from calib.identification.relations import Relation
from calib.identification.targets import Shape, Target, shape_of, shapes
from calib.measurement.kinds import IN_INSTRUMENT_FRAME
from calib.measurement.measurements import Measurements, numbered

# Two ways to move every tool are the same when they differ by less than this share.
_SAME = 1e-7
# What of a target's twist moves what is measured of it: of a point its place, of a plane height and tilts.
_SEEN_OF: Mapping[Shape, slice] = {"point": slice(0, 3), "plane": slice(2, 5), "frame": slice(0, 6)}
# Unit directions are dependent when a combination of them is shorter than this.
_DEPENDENT = 1e-3
# J sees a motion clearly when its direction lies in the row space by more than this share: of a unit direction, of a
# radian, or of the robot's reach.
_CLEARLY = 0.1
# The unit in which what a link carries is shifted, in m: as large as errors of a machine.
_SHIFT = 1e-3
# Known places, in m, and directions agree within this.
_AGREE = 1e-9


class Motions(NamedTuple):
    """Motions of a whole set-up about a point (3,) that no measurement shows: turns (3, m), and whether it grows.

    ``on_links``: turns (3, m), about the link's origin, of all that links carry, by link. ``shifted``: links that carry
    nothing known; what they carry may be shifted as well, so that it turns about any axis.
    """

    about: Array
    turns: Array
    grows: bool
    on_links: Mapping[str, Array]
    shifted: tuple[str, ...] = ()

    @property
    def directions(self) -> int:
        """How many turns there are, of the floor and of links."""
        return sum(int(turns.shape[1]) for turns in (self.turns, *self.on_links.values()))

    def of(self, link: str | None) -> tuple[Array, Array]:
        """Return about which point (3,) all on a link, None being the floor, moves, and its turns (3, k)."""
        turns, start = np.zeros((3, self.directions)), 0
        for ground, own in ((None, self.turns), *self.on_links.items()):
            if ground == link:
                turns[:, start : start + own.shape[1]] = own
            start += own.shape[1]
        return self.about if link is None else np.zeros(3), turns


def motions(
    measurements: Sequence[Measurements], known: Mapping[str, Target], relations: Sequence[Relation], near: Array
) -> Motions | None:
    """Return the motions of a whole set-up that must be taken out; None where there are none.

    ``measurements`` have common names; ``near`` (3,): where the robot stands. Turns are only taken out where sockets
    are: a turn changes the three numbers of their residuals, and those of no other kind. What a link carries turns by
    itself, with the joint before it, also where an instrument shows where the robot is.
    """
    placed = any(data.kind in IN_INSTRUMENT_FRAME for data in measurements)
    if placed and not measurements[0].target_links:
        return None
    found = None if placed else _centre(measurements, known, relations, near)
    shape, links = shapes(measurements), measurements[0].target_links
    points = {name: known[name].pose[:3, 3] for name in shape if name in known and shape[name] == "point"}
    floor = [place for name, place in points.items() if name not in links]
    about = (floor[0] if floor else near) if found is None else found

    sat_in = {links.get(name) for data in measurements if data.kind == "socket" for name in data.seen_targets}

    def free(link: str | None) -> Array:
        if (placed and link is None) or link not in sat_in:
            return np.zeros((3, 0))
        origin = about if link is None else np.zeros(3)
        fixed = [place - origin for name, place in points.items() if links.get(name) == link]
        fixed += [
            known[name].pose[:3, 2]
            for name in shape
            if name in known and shape[name] == "plane" and links.get(name) == link
        ]
        # Turns about an axis leave what lies along it.
        axes, values, _ = linear.svd(np.concatenate([np.zeros((3, 3)), *map(rigid.skew, np.array(fixed))]).T)
        return np.asarray(axes[:, values < _AGREE])

    turns, on_links = free(None), {link: free(link) for link in dict.fromkeys(links.values())}
    held = {links.get(name) for name in shape if name in known}
    shifted = tuple(link for link, own in on_links.items() if own.shape[1] and link not in held)
    every = Motions(about, turns, found is not None, on_links, shifted)
    return None if found is None and not every.directions else every


def _centre(
    measurements: Sequence[Measurements], known: Mapping[str, Target], relations: Sequence[Relation], near: Array
) -> Array | None:
    """Return the point (3,) about which all that was touched may grow; None where something tells a length.

    It is the nearest to ``near`` (3,), where the robot stands, that what is known allows.

    ``measurements`` have common names. A length tells nothing when an unknown one takes it up: that of a plane's height
    or of a set's offset, as long as it is the same in all rows. Known places tell no size unless they are at a distance
    from each other: one socket, or planes through one point.
    """
    if any(relation.kind != "angle" for relation in relations):
        return None
    taken_up: dict[tuple[str, str | int | None], float] = {}
    normals, heights = [np.zeros((0, 3))], [np.zeros(0)]
    for data in measurements:
        unknown = _unknown_length(data)
        of_a_mark = data.kind == "pixels" and not data.of_boards
        if data.points is not None and np.ptp(data.points, axis=0).any():
            # What a scanner sees has a known size.
            return None
        if data.kind not in ("socket", "plane") and unknown is None and not of_a_mark:
            return None
        for t, rows in numbered(data.target):
            name = data.targets[t] if t >= 0 else ""
            values = data.value[rows][:, : 0 if of_a_mark else None]
            own: tuple[str, str | int | None] = ("plane", name) if data.kind == "plane" else ("length", unknown)
            if values.size and np.any(values != taken_up.setdefault(own, float(values[0, 0]))):
                return None
            target = known.get(name) if t >= 0 else None
            if target is not None and target.height_is_known:
                axes = target.pose[:3, 2:3].T if data.kind == "plane" else target.pose[:3, :3].T
                # A known plane does not take up the probe's radius.
                height = axes @ target.pose[:3, 3] + (values[0] if data.kind == "plane" else 0.0)
                if data.link_of(t) is None:
                    normals.append(axes)
                    heights.append(height)
                elif np.any(height != 0.0):
                    return None
    A, b = np.concatenate(normals), np.concatenate(heights)
    found = near + np.linalg.lstsq(A, b - A @ near, rcond=_AGREE)[0]
    return np.asarray(found) if np.all(np.abs(A @ found - b) < _AGREE) else None


def _unknown_length(data: Measurements) -> int | None:
    """Return the number of the scalar that is a part of what the rows measure, where one is."""
    return data.uses.get("offset", data.uses.get("radius"))


def without(J: Array, set_up_motions: Array) -> Array:
    """Return scaled rows J (q, p) that do not see the directions ``set_up_motions`` (p, k)."""
    Q = taken_out(J, set_up_motions)
    return np.asarray(J - (J @ Q) @ Q.T)


def taken_out(J: Array, set_up_motions: Array) -> Array:
    """Return orthonormal directions (p, j) to take out of scaled rows J (q, p): as J sees ``set_up_motions`` (p, k).

    They may depend on each other: where one socket alone is touched, turns and growing are shifts but for residuals.
    Far from a solution, where J sees one clearly, only what J sees of it is taken out: what else is in the null space
    of J, such as a shift of the whole set-up, would be seen through it. Near a solution nothing is left to be told
    apart.
    """
    U, sizes, _ = linear.svd(set_up_motions, full_matrices=False)
    U = U[:, sizes > _DEPENDENT]
    found = identifiability.singular_directions(J)
    seen = found.vectors[:, : found.rank]
    # Principal vectors of both spaces: columns of `seen @ A` and `U @ B.T` are at angles whose cosines are `shares`.
    A, shares, B = linear.svd(seen.T @ U, full_matrices=False)
    return np.linalg.qr(np.where(shares > _CLEARLY, seen @ A, U @ B.T))[0]


def _small(A: Array, most: float) -> Array:
    """Return orthonormal combinations (k, j) of the columns of A (q, k) that are no longer than ``most``."""
    _, values, V = linear.svd(A)
    return np.asarray(V[np.count_nonzero(values > most) :].T)


def _large(A: Array, least: float) -> Array:
    """Return orthonormal combinations (k, j) of the columns of A (q, k) that are longer than ``least``."""
    _, values, V = linear.svd(A, full_matrices=False)
    return np.asarray(V[values > least].T)


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
    """Collects, row by row, what the motions of a whole set-up do to tools, and what of it parameters can imitate."""

    def __init__(self, parameters: Sequence[Parameter], motions: Motions, reach: float) -> None:
        self._motions, self._reach = motions, reach
        self._scales = scales(parameters)
        self._of_targets = np.array([parameter.nuisance for parameter in parameters], dtype=np.bool_)
        self._lengths = np.array([parameter.unit == "m" for parameter in parameters], dtype=np.bool_)
        self._triangle = np.empty((0, len(parameters) + self._count + 3 * len(motions.shifted)))

    @property
    def _count(self) -> int:
        return self._motions.directions + self._motions.grows

    def _shift_of(self, link: str) -> slice:
        """Return which columns, behind the parameters, shift what a link carries."""
        first = self._count + 3 * self._motions.shifted.index(link)
        return slice(first, first + 3)

    def _moved(self, x: Array, link: str | None) -> Array:
        """Return how points (n, 3) on a link, None being the floor, move (n, 3, k): by every turn, then by growing."""
        about, turns = self._motions.of(link)
        away = x - about
        turned = np.cross(turns.T[None], away[:, None]).swapaxes(-1, -2)
        return np.concatenate([turned, *[away[:, :, None]] * self._motions.grows], axis=2)

    def add(
        self,
        J: Array,
        moved: Sequence[Moved],
        sigma: Array,
        grounds: Sequence[tuple[str | None, IntArray | slice]],
    ) -> None:
        """Add rows (n, d, p) with their sigmas (n, d).

        ``moved``: tools, and other ends. ``grounds``: which rows are told in which link, None being the floor.
        """
        changed = np.zeros((*J.shape[:2], self._count + 3 * len(self._motions.shifted)))
        for one in moved:
            by_shift, by_turn = one.by_motion
            for link, own in grounds:
                turns = self._motions.of(link)[1]
                changed[own, :, : self._count] += by_shift[own] @ self._moved(one.placed[own, :3, 3], link)
                if link in self._motions.shifted:
                    changed[own, :, self._shift_of(link)] += by_shift[own] * _SHIFT
                changed[own, :, : turns.shape[1]] += by_turn[own] @ turns
        # What parameters, targets left out, do to a tool.
        rows = np.concatenate([np.where(self._of_targets, 0.0, J), changed], axis=2) / sigma[:, :, None]
        self._triangle = linear.triangle(np.concatenate([self._triangle, rows.reshape(-1, rows.shape[2])]))

    def directions(
        self, measurements: Sequence[Measurements], at: Machine, of_targets: TargetsFollowed, by_scalars: Array
    ) -> Array:
        """Return unit directions (p, j), scaled, of the motions that parameters imitate, turns first, then growing.

        ``of_targets`` that are common, ``by_scalars`` (s, p): scalars, as the scaled parameters change; targets
        that were eliminated follow the data. None where what a motion takes is held, and where nothing of it is seen: a
        robot that turns or grows about the only point that it touches moves no row; of growing, which is the last where
        it is a motion, zeros are left. Turns may be imitated about one axis alone, and along no axis of a frame: a link
        turns with the joint before it.
        """
        p = len(self._scales)
        q = p + self._count
        J, C = np.delete(self._triangle, np.s_[p:q], axis=1), self._triangle[:, p:q]
        X = np.linalg.lstsq(J, C, rcond=_SAME)[0]
        Z, shifts = X[:p], np.asarray(-_SHIFT * X[p:])
        # A turn shows in angles, growing in lengths, each of a size that is known.
        sizes = Z * self._scales[:, None]
        own, lengths, left = ~self._of_targets, self._lengths, J @ X - C
        Z = Z + self._of_common_targets(measurements, at, of_targets, by_scalars, shifts)
        found = []
        for some, shown, size in (
            (slice(None, self._motions.directions), own & ~lengths, 1.0),
            (slice(self._motions.directions, None), own & lengths, self._reach),
        ):
            seen = np.linalg.norm(C[:, some], axis=0).max(initial=0.0)
            V = _small(left[:, some], _SAME * seen)
            found.append(Z[:, some] @ V @ _large(sizes[shown, some] @ V, _CLEARLY * size))
        if self._motions.grows and not found[1].shape[1]:
            found[1] = np.zeros((p, 1))
        every = np.concatenate(found, axis=1)
        return np.asarray(every / np.maximum(np.linalg.norm(every, axis=0), _AGREE))

    def _of_common_targets(
        self,
        measurements: Sequence[Measurements],
        at: Machine,
        of_targets: TargetsFollowed,
        by_scalars: Array,
        shifts: Array,
    ) -> Array:
        """Return how the scaled parameters (p, k) of targets and scalars follow the motions, and ``shifts`` (s, k)."""
        turns = self._motions.directions
        Z = np.zeros((len(self._scales), self._count))
        left = dict(zip(of_targets.numbers.tolist(), of_targets.by_twist, strict=True))
        for data in measurements:
            for t in sorted(left.keys() & set(data.target.tolist())):
                by_twist = left.pop(t)
                R, c = at.frames.targets[t, :3, :3], at.frames.targets[t, :3, 3]
                twist = np.zeros((6, self._count))
                link = data.link_of(t)
                twist[:3] = R.T @ self._moved(c[None], link)[0]
                if link in self._motions.shifted:
                    first = 3 * self._motions.shifted.index(link)
                    twist[:3] += R.T @ shifts[first : first + 3]
                twist[3:, :turns] = R.T @ self._motions.of(link)[1]
                rows = _SEEN_OF[shape_of(data) or "point"]
                if data.kind == "plane":
                    # With the probe's radius it is where the tool is that grows.
                    twist[2, turns:] += data.value[data.target == t][0, 0]
                Z += np.linalg.lstsq(by_twist[rows], twist[rows], rcond=None)[0]
            unknown = _unknown_length(data)
            if unknown is not None and self._motions.grows:
                # What is left of the measured length when the unknown part is taken away grows.
                length = data.value[0, 0] if "radius" in data.uses else -data.value[0, 0]
                row, known = by_scalars[unknown], at.frames.scalars[unknown] + length
                Z[:, turns] = np.where(row != 0.0, known * row / (row @ row), Z[:, turns])
        return Z
