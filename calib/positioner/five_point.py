"""A two-axis positioner from five places of one mark on its table, in closed form.

Source: a patent of the South China University of Technology on two-axis positioners and five points.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from calib.foundations import rigid
from calib.foundations.arguments import checked, told
from calib.foundations.arrays import Array, read_only
from calib.foundations.brief import brief
from calib.foundations.errors import IdentificationError, JobError, MeasurementError
from calib.foundations.ranges import finite, refuse_no_placement, refuse_sigma
from calib.foundations.sealing import sealed
from calib.foundations.units import DEG, MM
from calib.measurement.checks import Finding
from calib.measurement.columns import stacked
from calib.measurement.table import Table, read_table
from calib.positioner.axes import expected_circle_error
from calib.positioner.machine import robot_of_joints
from calib.robot.robot import Robot

# Which of the five a row is, by the senses of its tilt and its rotary turn.
_PLACES: Mapping[tuple[float, float], str] = {
    (0.0, 0.0): "P1",
    (0.0, 1.0): "P2",
    (0.0, -1.0): "P3",
    (1.0, 0.0): "P4",
    (-1.0, 0.0): "P5",
}
_NAMES: Mapping[str, str] = {
    "P1": "both axes at zero",
    "P2": "rotary turned in its positive sense",
    "P3": "rotary turned in its negative sense",
    "P4": "tilt turned in its positive sense",
    "P5": "tilt turned in its negative sense",
}
# The patent asks for more than 30 deg; below 60 deg and 100 mm the table is known ten times worse than its points.
_SMALL_TURN = 60.0 * DEG
_SMALL_RADIUS = 0.1
# What is short of these by less than their digits show, or than noise, is as large.
_SHOWN = 1e-3
# Height of the triangle over its longest side: +-30 deg have 0.13.
_THIN = 0.1
_DEGENERATE = 1e-9
# What an axis that rests may read.
_AT_REST = 1e-3 * DEG
# How far a point may lie from where its angle says: a degree, or six standard deviations of the point.
_TURN_TOLERANCE = 1.0 * DEG
_SIGMAS = 6.0

_NO_POINTS = "the points on a table must be finite numbers (..., 3), in m."


@contextmanager
def _going_together() -> Iterator[None]:
    """Let a ValueError of NumPy about shapes in the block be a sentence."""
    try:
        yield
    except ValueError as e:
        raise MeasurementError("tilt, rotary and zero have shapes that do not go together.") from e


@dataclass(frozen=True, slots=True, eq=False)
@sealed
class FivePoint:
    """A two-axis positioner from five points. Made by :func:`five_point`.

    Placements (4, 4), all of tilt = rotary = 0: ``B_R``, rotary axis in the robot's base; ``B_L``, tilt axis; ``B_P``,
    the positioner's base, which is ``B_L``; ``L_R = inv(B_L) B_R``. The z axes are the joints' axes. The table's frame
    W is R. ``findings``: what makes the result doubtful, as sentences with the expected error of an axis.
    """

    __repr__ = brief

    B_R: Array
    B_L: Array
    B_P: Array
    L_R: Array
    findings: tuple[Finding, ...]

    @checked
    def motion(self, tilt: npt.ArrayLike, rotary: npt.ArrayLike) -> Array:
        """Return what the axes do, at readings (...) in rad, to whatever lies on the table at zero: (..., 4, 4).

        B_P Rz(tilt) inv(B_P) B_R Rz(rotary) inv(B_R). Raises MeasurementError for readings that are not finite, or of
        shapes that do not go together.
        """
        # What is no reading has a sentence of its own, which is a ValueError as well.
        tilting, turning = _about_z(tilt), _about_z(rotary)
        with _going_together():
            tilted = self.B_P @ tilting @ rigid.inverse(self.B_P)
            return np.asarray(tilted @ self.B_R @ turning @ rigid.inverse(self.B_R))

    @checked
    def points(self, zero: npt.ArrayLike, tilt: npt.ArrayLike, rotary: npt.ArrayLike) -> Array:
        """Return where table points are at readings (...), in the robot's base, as ``zero`` (..., 3) at zero.

        Raises MeasurementError as :meth:`motion` does.
        """
        T = self.motion(tilt, rotary)
        x = finite(zero, None, _NO_POINTS)
        if x.shape[-1:] != (3,):
            raise MeasurementError(_NO_POINTS)
        with _going_together():
            return np.asarray((T[..., :3, :3] @ x[..., None])[..., 0] + T[..., :3, 3])

    @checked
    def frames(self, tilt: npt.ArrayLike, rotary: npt.ArrayLike, zero: npt.ArrayLike | None = None) -> Array:
        """Return where a table frame, W unless it is given as it is at ``zero`` (4, 4), is at readings (...).

        Raises MeasurementError as :meth:`motion` does, and for a ``zero`` that is no placement.
        """
        T = self.B_R
        if zero is not None:
            T = finite(zero, None, "zero: needs a placement (4, 4) of finite numbers.")
            refuse_no_placement(T, "zero", MeasurementError)
        return np.asarray(self.motion(tilt, rotary) @ T)

    def contents(self) -> dict[str, Any]:
        """Return what was found as plain data, in m: both axes by a point and a direction, frames, findings."""
        return {
            "axes": {
                name: {"point": T[:3, 3].tolist(), "direction": T[:3, 2].tolist()}
                for name, T in (("tilt", self.B_L), ("rotary", self.B_R))
            },
            "frames": {name: getattr(self, name).tolist() for name in ("B_R", "B_L", "B_P", "L_R")},
            "findings": [finding.sentence for finding in self.findings],
        }

    @checked
    def robot(self, names: tuple[str, str] = ("tilt", "rotary")) -> Robot:
        """Return the positioner as a URDF machine, in whose nominal geometry these axes are; its tip is the table."""
        return robot_of_joints([("revolute", self.B_P), ("revolute", self.B_R)], names)


@checked
def five_point(
    P1: npt.ArrayLike,
    P2: npt.ArrayLike,
    P3: npt.ArrayLike,
    P4: npt.ArrayLike,
    P5: npt.ArrayLike,
    angles: Sequence[float] | None = None,
    sigma: float = 0.1e-3,
) -> FivePoint:
    """Find the axes of a two-axis positioner from five places of one mark on its table, in closed form.

    ``P1``, at tilt = rotary = 0, to ``P5`` (3,): the mark in the robot's base, in m. P2 and P3 at rotary +theta1 and
    -theta2, P4 and P5 at tilt +theta3 and -theta4, the other axis at zero; each pair less than a turn together.

    For each axis, C is where the plane of its three points meets the planes that bisect P1P2 and P1P3; x = (P1 - C) /
    |P1 - C|, z = (P1P2 x P2P3) / |.|, y = z x x, and the frame is [x y z C]. It is exact without noise.

    What of the frames is physical: the two axis lines alone. Origins may slide along their axes, and the x axes point
    at the mark, wherever it was punched; that changes ``L_R``, and no place of any table point. The sense of z is the
    encoder's only if P2 and P4 are the positive turns.

    ``angles``: the readings (+theta1, -theta2, +theta3, -theta4) in rad. They do not enter the result; they tell
    whether the points lie where they say and come in the right order: an error where a turn differs by a degree, a
    finding where it differs by more than the noise of the points. Of two turns that are equally large nothing but the
    signs of the angles can tell the order: the points themselves are then symmetric. ``sigma``: standard deviation of
    a coordinate in m, for that, and for the expected errors that findings tell: of turns below 60 deg, radii below 100
    mm, and three points almost on a line.

    Raises MeasurementError when points are no points, swapped or not where their angles say, IdentificationError when
    three points lie on a line, JobError when there are not four angles, and for a sigma out of range.
    """
    P = np.stack([_point(p, f"P{i + 1}") for i, p in enumerate((P1, P2, P3, P4, P5))])
    if angles is not None and (len(angles) != 4 or not np.isfinite(angles).all()):
        raise JobError("angles: there must be four, of P2, P3 (rotary), P4 and P5 (tilt), in rad.")
    refuse_sigma(sigma, "sigma")
    frames, findings = [], list[Finding]()
    for axis, i in (("rotary", 1), ("tilt", 3)):
        names = (f"P{i + 1}", f"P{i + 2}")
        if angles is not None:
            _refuse_signs(axis, names, angles[i - 1 : i + 1])
        T, turns = _circle_frame(P[[0, i, i + 1]], axis)
        radius = float(np.linalg.norm(P[0] - T[:3, 3]))
        if angles is not None:
            _refuse_turns(axis, names, turns, angles[i - 1 : i + 1], _TURN_TOLERANCE + _SIGMAS * sigma / radius)
            findings += _off_angles(axis, names, turns, angles[i - 1 : i + 1], sigma / radius)
        findings += _doubts(axis, names, P[[0, i, i + 1]], radius, turns, sigma)
        frames.append(read_only(T))
    B_R, B_L = frames
    return FivePoint(B_R, B_L, B_L, read_only(rigid.inverse(B_L) @ B_R), tuple(findings))


def _about_z(angle: npt.ArrayLike) -> Array:
    turns = finite(angle, None, "the readings of a positioner must be finite numbers, in rad.")
    return rigid.placement(rigid.rotation_about(np.array([0.0, 0.0, 1.0]), turns), np.zeros(3))


def _point(p: npt.ArrayLike, name: str) -> Array:
    return finite(p, (3,), f"{name}: {told(p)} is not a point of three finite numbers, in m.")


def _circle_frame(P: Array, axis: str) -> tuple[Array, tuple[float, float]]:
    """Return the frame (4, 4) of three points (3, 3), and how far the second and the third are turned from the first.

    The second turn is counted backwards, so that both are positive: theta1 and theta2 of the patent.
    """
    a, b = P[1] - P[0], P[2] - P[0]
    normal = np.cross(a, b - a)
    length = float(np.linalg.norm(normal))
    if not length > _DEGENERATE * float(max(a @ a, b @ b)) or length == 0.0:
        raise IdentificationError(f"the three points of the {axis} axis lie on a line, or two of them in one place.")
    z = normal / length
    # The plane and the two bisector planes, about P1, where the numbers are small.
    C = np.linalg.solve(np.stack([z, a, b]), np.array([0.0, 0.5 * (a @ a), 0.5 * (b @ b)]))
    x = -C / np.linalg.norm(C)
    y = np.cross(z, x)
    forward, backward = (
        float(np.arctan2(s * ((p - C) @ y), (p - C) @ x)) % (2.0 * np.pi) for p, s in ((a, 1), (b, -1))
    )
    return rigid.placement(np.stack([x, y, z], axis=-1), P[0] + C), (forward, backward)


def _refuse_signs(axis: str, names: tuple[str, str], angles: Sequence[float]) -> None:
    first, second = (a / DEG for a in angles)
    if first < 0.0 < second:
        raise MeasurementError(
            f"{names[0]} and {names[1]} are swapped: {names[0]} has to be the positive turn of the {axis} axis, and "
            f"its angle is {first:.6g} deg; exchange them."
        )
    if not first > 0.0 > second:
        raise MeasurementError(
            f"{names[0]} and {names[1]} are turned by {first:.6g} and {second:.6g} deg about the {axis} axis; the "
            "first has to be a positive turn from P1 and the second a negative one."
        )
    if not first - second < 360.0:
        raise MeasurementError(
            f"{names[0]} and {names[1]} are {first - second:.6g} deg apart about the {axis} axis; it has to be less "
            "than 360 deg."
        )


def _refuse_turns(
    axis: str, names: tuple[str, str], turns: tuple[float, float], angles: Sequence[float], tolerance: float
) -> None:
    expected = (float(angles[0]), -float(angles[1]))
    if max(abs(t - e) for t, e in zip(turns, expected, strict=True)) <= tolerance:
        return
    seen = " and ".join(f"{t / DEG:.4g}" for t in turns)
    said = " and ".join(f"{e / DEG:.4g}" for e in expected)
    if max(abs(t - e) for t, e in zip(turns, reversed(expected), strict=True)) <= tolerance:
        raise MeasurementError(
            f"{names[0]} and {names[1]} are swapped: seen from P1 they are turned by {seen} deg, one way and the "
            f"other, about the {axis} axis, where the angles say {said}; exchange them."
        )
    raise MeasurementError(
        f"{names[0]} and {names[1]} are turned by {seen} deg, one way and the other, about the {axis} axis, where the "
        f"angles say {said}: points or angles are wrong, or the other axis moved as well."
    )


def _off_angles(
    axis: str, names: tuple[str, str], turns: tuple[float, float], angles: Sequence[float], noise: float
) -> Iterator[Finding]:
    """Yield what points say of turns beyond their ``noise``, a coordinate's over the radius: one was touched wrongly.

    A circle through three points takes up their radial errors; its centre moves by what they ask.
    """
    at = np.array([0.0, turns[0], -turns[1]])
    radial, tangential = np.stack([np.cos(at), np.sin(at)], axis=1), np.stack([-np.sin(at), np.cos(at)], axis=1)
    centre = np.linalg.inv(np.column_stack([radial, np.ones(3)]))[:2]
    for name, turn, angle, by in zip(names, turns, angles, tangential[1:] - tangential[0], strict=True):
        off = (turn - abs(angle)) / (noise * np.sqrt(2.0 + np.sum((by @ centre) ** 2)))
        if abs(off) > _SIGMAS:
            yield Finding.warning(
                "turn-off",
                f"{name} is turned by {turn / DEG:.4g} deg about the {axis} axis, where its angle says "
                f"{abs(angle) / DEG:.4g}: {abs(off):.2g} standard deviations of the points. One of them was touched "
                "wrongly, or angle or sigma is not what is said; nothing else checks five points.",
            )


def _doubts(
    axis: str, names: tuple[str, str], P: Array, radius: float, turns: tuple[float, float], sigma: float
) -> Iterator[Finding]:
    expected = expected_circle_error(radius, [0.0, turns[0], -turns[1]], sigma) / DEG
    so = f"with {sigma / MM:.3g} mm per coordinate its direction is expected to be {expected:.2g} deg off."
    smallest = min(turns)
    if smallest < (1.0 - _SHOWN) * _SMALL_TURN - _SIGMAS * sigma / radius:
        yield Finding.warning(
            "small-turn",
            f"{names[int(turns[1] < turns[0])]} is turned by only {smallest / DEG:.3g} deg about the {axis} axis, and "
            f"60 or more are advised; {so}",
        )
    if radius < (1.0 - _SHOWN) * _SMALL_RADIUS - _SIGMAS * sigma:
        yield Finding.warning(
            "small-radius",
            f"the mark is only {radius / MM:.3g} mm from the {axis} axis, and 100 or more are advised; {so}",
        )
    sides = np.linalg.norm(P - np.roll(P, 1, axis=0), axis=1)
    height = np.linalg.norm(np.cross(P[1] - P[0], P[2] - P[0])) / sides.max()
    if height < _THIN * sides.max():
        yield Finding.warning(
            "almost-collinear",
            f"P1, {names[0]} and {names[1]} lie almost on a line, {height / MM:.3g} mm off one of "
            f"{sides.max() / MM:.3g} mm; {so}",
        )


@checked
def five_point_of(source: str | Path | Table, *, sigma: float = 0.1e-3) -> FivePoint:
    """Find the axes from a table of the five places: columns ``tilt``, ``rotary``, ``x``, ``y``, ``z``, with units.

        found = calib.positioner.five_point_of("five.csv")

    Which row is which, its readings say: one at zero, two at turns of the rotary axis alone, a positive and a negative
    one, two of the tilt axis alone; up to 0.001 deg, an axis is at zero. Raises MeasurementError when there are others,
    and as :func:`five_point` does.
    """
    table = source if isinstance(source, Table) else read_table(source)
    needed = ("tilt", "rotary", "x", "y", "z")
    if missing := [name for name in needed if name not in table.columns]:
        listed, there = (", ".join(map(repr, some)) for some in (missing, table.columns))
        raise MeasurementError(f"{table.where}: there is no column {listed}; the columns are {there}.")
    turns = stacked(table, dict.fromkeys(("tilt", "rotary"), "angle"))
    points = stacked(table, dict.fromkeys(("x", "y", "z"), "length"))
    rows: dict[str, int] = {}
    for n, (tilt, rotary) in enumerate(turns):
        tilts, turned = (float(np.sign(angle)) if abs(angle) > _AT_REST else 0.0 for angle in (tilt, rotary))
        place = _PLACES.get((tilts, turned))
        at = f"{table.where}:{table.lines[n]}: tilt {tilt / DEG:g} deg, rotary {rotary / DEG:g} deg"
        if place is None:
            raise MeasurementError(f"{at}: both axes are turned; at each of the five points one axis at most may be.")
        if place in rows:
            raise MeasurementError(f"{at}: appears twice, as {place}; needed is one row of each sense of each axis.")
        rows[place] = n
    if absent := [f"{place} ({what})" for place, what in _NAMES.items() if place not in rows]:
        raise MeasurementError(f"{table.where}: there is no {', '.join(absent)}.")
    P1, P2, P3, P4, P5 = (points[rows[place]] for place in _NAMES)
    angles = [float(turns[rows[place], axis]) for place, axis in (("P2", 1), ("P3", 1), ("P4", 0), ("P5", 0))]
    return five_point(P1, P2, P3, P4, P5, angles, sigma)
