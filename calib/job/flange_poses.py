"""Poses of a flange held against the photographs taken there: what three angles are, and which mistake poses have.

Photographs by themselves show how board and camera are to each other. One of them is at one place of the flange in all,
the other one stands still. That fits poses that are read as they are meant, within the errors of an arm, and hardly
any that are read otherwise.
"""

import re
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from calib.foundations import rigid
from calib.foundations.arrays import Array, BoolArray, IntArray, evenly
from calib.foundations.errors import MeasurementError
from calib.foundations.units import DEG, MM
from calib.identification.initialisation.base_and_tools import TipObservations, poses_off
from calib.identification.initialisation.lenses import legible
from calib.identification.photographs import Photograph, found_optics, poses_of
from calib.job.half_turns import AGREE, half_turns
from calib.measurement.columns import POSITION, stacked
from calib.measurement.instruments import Camera, CameraPlace
from calib.measurement.lens import BENT, CENTRE, FOCAL
from calib.measurement.orientations import ANGLES, EULER, MAKERS, rotations_of
from calib.measurement.table import QUATERNION_COLUMNS, Table

# So many photographs decide, and no more are needed.
LEAST, _MOST = 6, 60
# What is read rightly is off by less than this share of the camera's distance, and what is read otherwise by so many
# times more: right readings of four real arms leave 0.6 to 2.4 %, and the nearest wrong ones 13 to 28 %.
_GOOD, _CLEARLY = 0.05, 4.0
# Of what fits so well no mistake is sought.
_BEYOND_DOUBT = 0.01
# Photographs that are off by so many times the median do not take part in the second fit.
_STRAY = 3.0
# Where all photographs fit badly, each of so many parts is left out once.
_PARTS = 4
# Rotations that agree to so much are the same.
_SAME = 1e-3
_NUMBER = re.compile("[0-9]+")


class Seen(NamedTuple):
    """What photographs show: poses (n, 4, 4) of the board in the camera, and the row of the readings of each.

    ``half_turn`` (4, 4): in the board, where it looks the same with it: each pose may be with it or without.
    """

    boards: Array
    rows: IntArray
    half_turn: Array | None = None

    @property
    def few(self) -> "Seen":
        """As many of them as decide, evenly among all."""
        some = evenly(len(self.rows), _MOST)
        return self._replace(boards=self.boards[some], rows=self.rows[some])

    def upright(self, tips: Array) -> Array:
        """Return the poses (n, 4, 4) of the board, all the same way up by the poses (n, 4, 4) of the flange there."""
        if self.half_turn is None:
            return self.boards
        turned = half_turns(self.boards, tips).turned
        return np.where(turned[:, None, None], self.boards @ self.half_turn, self.boards)


class WayUp(NamedTuple):
    """Rows of readings whose photographs are to be turned, of which this is told, and which contradict the others."""

    turned: frozenset[int]
    told: frozenset[int]
    contradict: frozenset[int]


class _Off(NamedTuple):
    """By how much half of the photographs are off at most: in m, in rad, and as a share of the camera's distance."""

    length: float
    angle: float
    share: float

    @property
    def words(self) -> str:
        return f"{_short(self.length / MM)} mm and {_short(self.angle / DEG)} deg"


class _Way(NamedTuple):
    """Another way to read poses (N, 4, 4) of a flange, and what they then look as if."""

    looks_as_if: str
    poses: Array


def _short(value: float) -> str:
    return f"{value:.0f}" if value >= 10.0 else f"{value:.2g}"


def shown_by(
    photographs: Sequence[tuple[Array, Array]],
    rows: Sequence[int],
    size: tuple[int, int],
    half_turn: Array | None = None,
) -> Seen | None:
    """Return the poses that photographs of a board show, by pixels (n, 2) and marks (n, 3); None of too few.

    Of a board that looks the same with a ``half_turn`` (4, 4), all that show one; else as many as decide.
    """
    free = (*FOCAL, *CENTRE, *BENT)
    lens = Camera("tip", free=free, size=size).lens
    given = [
        (Photograph(pixels, marks, np.zeros((len(pixels), 3, 0)), np.ones_like(pixels)), row)
        for (pixels, marks), row in zip(photographs, rows, strict=True)
    ]
    told = [(one, row) for one, row in given[evenly(len(given), _MOST)] if legible([one], lens)]
    found = found_optics([one for one, _ in told], free, lens) if len(told) >= LEAST else None
    if found is None:
        return None
    if half_turn is None:
        return Seen(found.poses, np.array([row for _, row in told], dtype=np.intp))
    boards, shown = poses_of([one for one, _ in given], found.optics)
    return Seen(boards[shown], np.array(rows, dtype=np.intp)[shown], half_turn)


def way_up(seen: Seen, poses: Array) -> WayUp | None:
    """Return which way up the board was in photographs, by the poses (N, 4, 4) of the flange; None where hardly told.

    The first one that is told is the right way up.
    """
    found = half_turns(seen.boards, poses[seen.rows])
    told = found.told
    if np.count_nonzero(told) < max(LEAST, 0.5 * len(told)):
        return None
    # Of readings that are not of these photographs, some fit by chance, and then not all in one place.
    few = seen._replace(boards=seen.boards[told], rows=seen.rows[told]).few
    if min(_off(poses, few, "tip").angle, _off(poses, few, "floor").angle) > AGREE:
        return None
    turned = found.turned ^ found.turned[int(np.argmax(told))]
    return WayUp(*(frozenset(seen.rows[which].tolist()) for which in (turned & told, told, found.contradict)))


def orientation_of(table: Table, seen: Seen | None, camera_on: CameraPlace) -> tuple[str | None, str]:
    """Return what three angles of the flange are by the photographs, and how it is known; None where none is clear."""
    if seen is None or not {*ANGLES, *POSITION} <= table.columns.keys():
        return None, ""
    seen = seen.few
    turned = [way._replace(poses=way.poses[seen.rows]) for way in _turned(table)]
    seen = seen._replace(rows=np.arange(len(seen.rows)))
    tried = {way.looks_as_if: _off(way.poses, seen, camera_on) for way in turned}
    best, *others = sorted(turned, key=lambda way: tried[way.looks_as_if].share)
    off = tried[best.looks_as_if]
    others = [way for way in others if not _alike(way.poses, best.poses)]
    if off.share > _GOOD or any(tried[way.looks_as_if].share < _CLEARLY * off.share for way in others):
        return None, ""
    said = f"{table.where}: by the photographs, rx, ry, rz are {best.looks_as_if!r}: they are then off by {off.words}"
    more = f", and by {tried[others[0].looks_as_if].words} with {others[0].looks_as_if!r}, the next best"
    return best.looks_as_if, said + (more if others else "")


def refuse_mistakes(
    table: Table, poses: Array, seen: Seen | None, camera_on: CameraPlace, images: Sequence[str]
) -> None:
    """Raise MeasurementError where photographs show that poses (N, 4, 4) of the flange are meant otherwise.

    ``table``: of them, as it was written. ``images``: the photograph of each row.
    """
    seen = None if seen is None else seen.few
    now = None if seen is None else _off(poses, seen, camera_on)
    if seen is None or now is None or now.share < _BEYOND_DOUBT:
        return
    # One after the other: a table may have far more rows than photographs.
    tried = ((_off(way.poses, seen, camera_on), way.looks_as_if) for way in _ways(table, poses, camera_on, images))
    best, looks_as_if = min(tried, key=lambda one: one[0].share)
    if best.share < min(_GOOD, now.share / _CLEARLY):
        raise MeasurementError(
            f"{table.where}: it looks as if {looks_as_if}: half of the photographs are off by {now.words} or more, and "
            f"by {best.words} with this corrected."
        )


def _off(poses: Array, seen: Seen, camera_on: CameraPlace) -> _Off:
    """Return by how much photographs are off from the best place on the flange and the best one beside the robot."""
    tips = poses[seen.rows]
    boards = seen.upright(tips)
    measured = rigid.inverse(boards) if camera_on == "tip" else boards
    rows = TipObservations(tips, measured[:, :3, 3], measured[:, :3, :3], np.zeros(len(tips), dtype=np.intp))
    away = float(np.median(np.linalg.norm(boards[:, :3, 3], axis=1)))

    def off(kept: BoolArray) -> tuple[Array, Array, Array]:
        lengths, angles = poses_off(rows, kept, 1)
        return lengths, angles, np.hypot(lengths / away, angles)

    found = off(np.ones(len(tips), dtype=np.bool_))
    if np.median(found[2]) > _GOOD:
        # One photograph that is far off may turn all of them.
        parts = np.arange(len(tips)) % min(_PARTS, len(tips))
        found = min(found, *(off(parts != k) for k in np.unique(parts)), key=_median_share)
    found = min(found, off(found[2] <= _STRAY * float(np.median(found[2]))), key=_median_share)
    return _Off(*(float(np.median(each)) for each in found))


def _median_share(found: tuple[Array, Array, Array]) -> float:
    return float(np.median(found[2]))


def _ways(table: Table, poses: Array, camera_on: CameraPlace, images: Sequence[str]) -> Iterator[_Way]:
    """Yield the other ways to read poses, the most typical first."""
    R, t = poses[:, :3, :3], poses[:, :3, 3]
    if set(ANGLES) <= table.columns.keys():
        yield from (way._replace(looks_as_if=f"rx, ry, rz were {way.looks_as_if!r}") for way in _turned(table))
        for factor, says in ((DEG, "degrees stand under [rad]"), (1.0 / DEG, "radians stand under [deg]")):
            yield from (
                way._replace(looks_as_if=f"{says} in rx, ry, rz, which are {way.looks_as_if!r}")
                for way in _turned(table, factor)
            )
    if set(QUATERNION_COLUMNS) <= table.columns.keys():
        q = stacked(table, dict.fromkeys(QUATERNION_COLUMNS, "number"))
        for order, says in (((3, 0, 1, 2), "x, y, z, w"), ((1, 2, 3, 0), "z, w, x, y")):
            turned = rigid.rotation_of_quaternion(q[:, list(order)])
            yield _Way(f"qw, qx, qy, qz hold {says}", rigid.placement(turned, t))
    yield _Way("the rotations are inverse (quaternions conjugated)", rigid.placement(R.mT, t))
    yield _Way("millimetres stand under [m] in x, y, z", rigid.placement(R, t * MM))
    yield _Way("metres stand under [mm] in x, y, z", rigid.placement(R, t / MM))
    # What no photograph can tell apart.
    beside = "the camera stands beside the robot, and the board is on the flange (camera_on = floor)"
    on = "the camera is on the flange, and the board stands beside the robot (camera_on = tip)"
    inverse = "or the poses are those of the base in the flange"
    yield _Way(f"{beside if camera_on == 'tip' else on}, {inverse}", rigid.inverse(poses))
    letters, digits = sorted(images), sorted(images, key=_numbered)
    named = {1: "of letters (1, 10, 2)", -1: "of numbers (1, 2, 10)"}
    for given, meant, way in ((letters, digits, 1), (digits, letters, -1)) if letters != digits else ():
        row = {image: k for k, image in enumerate(images)}
        of = np.zeros(len(images), dtype=np.intp)
        of[[row[name] for name in meant]] = [row[name] for name in given]
        yield _Way(f"images stand in the order {named[way]}, and poses in that {named[-way]}", poses[of])
    for by, says in ((1, "before"), (-1, "after")):
        yield _Way(f"each row is of the photograph {says} its own", np.roll(poses, -by, axis=0))


def _turned(table: Table, factor: float = 1.0) -> Iterator[_Way]:
    """Yield the poses of three angles as every order of turns makes them, the most usual ones first."""
    angles = factor * stacked(table, dict.fromkeys(ANGLES, "angle"))
    places = stacked(table, dict.fromkeys(POSITION, "length"))
    usual = ("rotation_vector", *dict.fromkeys(MAKERS.values()))
    for name in dict.fromkeys((*usual, *EULER)):
        yield _Way(name, rigid.placement(rotations_of(angles, name), places))


def _alike(poses: Array, others: Array) -> bool:
    return bool(np.abs(poses - others).max() < _SAME)


def _numbered(name: str) -> list[tuple[str, int, str]]:
    """Return a key by which numbers in names are in their order, however many digits they have."""
    words, numbers = _NUMBER.split(name), [number.lstrip("0") for number in _NUMBER.findall(name)]
    return [(word, len(number), number) for word, number in zip(words, [*numbers, ""], strict=True)]
