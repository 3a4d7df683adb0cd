"""External axes: positioners, turntables, tracks, from touched points.

A positioner is a machine like any other: a URDF, its base and its marks (tool points on the table) unknown. What
positions of marks determine are the lines of its axes and the marks themselves, no more: for two revolute axes 4 + 4 +
3 = 11 numbers. :func:`five_point` finds them from five points in closed form, as its inventors do; :func:`axes_robot`
makes a URDF machine of any axes, and :func:`axes_model` frees in it what :func:`calib.identify` then fits to any number
of points.

Source of the closed form: a patent of the South China University of Technology on two-axis positioners and five points.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from calib.foundations import rigid
from calib.foundations.arrays import Array, read_only
from calib.foundations.errors import IdentificationError, JobError, MeasurementError
from calib.foundations.xml_text import quoted
from calib.identification.axes import (
    Axis,
    PrismaticAxis,
    RevoluteAxis,
    circle_axis,
    circle_point_analysis,
    expected_circle_error,
    expected_line_error,
    line_axis,
)
from calib.identification.error_model import ErrorModel, error_model
from calib.identification.fit import Fit
from calib.identification.pivot import Pivot, pivot
from calib.identification.relative import RelativeBase, relative_base
from calib.identification.system import Problem, blocks
from calib.measurement.checks import Finding
from calib.measurement.measurements import unmeasured
from calib.robot.conditions import ordinary
from calib.robot.load import load_robot
from calib.robot.robot import Robot
from calib.robot.urdf import parse_urdf

__all__ = [
    "Axis",
    "FivePoint",
    "Pivot",
    "PrismaticAxis",
    "RelativeBase",
    "RevoluteAxis",
    "TableError",
    "axes_model",
    "axes_robot",
    "circle_axis",
    "circle_point_analysis",
    "expected_circle_error",
    "expected_line_error",
    "five_point",
    "line_axis",
    "pivot",
    "relative_base",
    "table_error",
    "table_points",
]

# The patent asks for more than 30 deg; below 60 deg and 100 mm the table is known ten times worse than its points.
_SMALL_TURN = float(np.radians(60.0))
_SMALL_RADIUS = 0.1
# Height of the triangle over its longest side: +-30 deg have 0.13.
_THIN = 0.1
_DEGENERATE = 1e-9
# How far a point may lie from where its angle says: a degree, or six standard deviations of the point.
_TURN_TOLERANCE = float(np.radians(1.0))
_SIGMAS = 6.0


@dataclass(frozen=True, slots=True, eq=False)
class FivePoint:
    """A two-axis positioner from five points. Made by :func:`five_point`.

    Placements (4, 4), all of tilt = rotary = 0: ``B_R``, rotary axis in the robot's base; ``B_L``, tilt axis; ``B_P``,
    the positioner's base, which is ``B_L``; ``L_R = inv(B_L) B_R``. The z axes are the joints' axes. The table's frame
    W is R. ``findings``: what makes the result doubtful, as sentences with the expected error of an axis.
    """

    B_R: Array
    B_L: Array
    B_P: Array
    L_R: Array
    findings: tuple[Finding, ...]

    def motion(self, tilt: npt.ArrayLike, rotary: npt.ArrayLike) -> Array:
        """Return what the axes do, at readings (...) in rad, to whatever lies on the table at zero: (..., 4, 4).

        B_P Rz(tilt) inv(B_P) B_R Rz(rotary) inv(B_R).
        """
        return np.asarray(
            self.B_P @ _about_z(tilt) @ rigid.inverse(self.B_P) @ self.B_R @ _about_z(rotary) @ rigid.inverse(self.B_R)
        )

    def points(self, zero: npt.ArrayLike, tilt: npt.ArrayLike, rotary: npt.ArrayLike) -> Array:
        """Return where table points are at readings (...), in the robot's base, as ``zero`` (..., 3) at zero."""
        T = self.motion(tilt, rotary)
        x = np.asarray(zero, dtype=np.float64)
        return np.asarray((T[..., :3, :3] @ x[..., None])[..., 0] + T[..., :3, 3])

    def frames(self, tilt: npt.ArrayLike, rotary: npt.ArrayLike, zero: npt.ArrayLike | None = None) -> Array:
        """Return where a table frame, W unless it is given as it is at ``zero`` (4, 4), is at readings (...)."""
        return np.asarray(self.motion(tilt, rotary) @ (self.B_R if zero is None else np.asarray(zero)))

    def robot(self, names: tuple[str, str] = ("tilt", "rotary")) -> Robot:
        """Return the positioner as a URDF machine, in whose nominal geometry these axes are; its tip is the table."""
        return _robot([("revolute", self.B_P), ("revolute", self.B_R)], names)


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
    whether the points lie where they say and come in the right order. Of two turns that are equally large nothing but
    the signs of the angles can tell the order: the points themselves are then symmetric. ``sigma``: standard deviation
    of a coordinate in m, for the expected errors that findings tell: of turns below 60 deg, radii below 100 mm, and
    three points almost on a line.

    Raises MeasurementError when points are swapped or not where their angles say, IdentificationError when three points
    lie on a line.
    """
    P = np.stack([_point(p, f"P{i + 1}") for i, p in enumerate((P1, P2, P3, P4, P5))])
    if angles is not None and (len(angles) != 4 or not np.isfinite(angles).all()):
        raise JobError("angles: there must be four, of P2, P3 (rotary), P4 and P5 (tilt), in rad.")
    if not (np.isfinite(sigma) and sigma >= 0.0):
        raise JobError(f"sigma: {sigma} is not a standard deviation in m.")
    frames, findings = [], []
    for axis, i in (("rotary", 1), ("tilt", 3)):
        names = (f"P{i + 1}", f"P{i + 2}")
        if angles is not None:
            _refuse_signs(axis, names, angles[i - 1 : i + 1])
        T, turns = _circle_frame(P[[0, i, i + 1]], axis)
        radius = float(np.linalg.norm(P[0] - T[:3, 3]))
        if angles is not None:
            _refuse_turns(axis, names, turns, angles[i - 1 : i + 1], _TURN_TOLERANCE + _SIGMAS * sigma / radius)
        findings += _doubts(axis, names, P[[0, i, i + 1]], radius, turns, sigma)
        frames.append(read_only(T))
    B_R, B_L = frames
    return FivePoint(B_R, B_L, B_L, read_only(rigid.inverse(B_L) @ B_R), tuple(findings))


def _about_z(angle: npt.ArrayLike) -> Array:
    return rigid.placement(rigid.rotation_about(np.array([0.0, 0.0, 1.0]), np.asarray(angle, np.float64)), np.zeros(3))


def _point(p: npt.ArrayLike, name: str) -> Array:
    x = np.asarray(p, dtype=np.float64)
    if x.shape != (3,) or not np.isfinite(x).all():
        raise MeasurementError(f"{name}: {p!r} is not a point of three finite numbers, in m.")
    return x


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
    first, second = (float(np.degrees(a)) for a in angles)
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
    seen = " and ".join(f"{np.degrees(t):.4g}" for t in turns)
    said = " and ".join(f"{np.degrees(e):.4g}" for e in expected)
    if max(abs(t - e) for t, e in zip(turns, reversed(expected), strict=True)) <= tolerance:
        raise MeasurementError(
            f"{names[0]} and {names[1]} are swapped: seen from P1 they are turned by {seen} deg, one way and the "
            f"other, about the {axis} axis, where the angles say {said}; exchange them."
        )
    raise MeasurementError(
        f"{names[0]} and {names[1]} are turned by {seen} deg, one way and the other, about the {axis} axis, where the "
        f"angles say {said}: points or angles are wrong, or the other axis moved as well."
    )


def _doubts(
    axis: str, names: tuple[str, str], P: Array, radius: float, turns: tuple[float, float], sigma: float
) -> list[Finding]:
    expected = np.degrees(expected_circle_error(radius, [0.0, turns[0], -turns[1]], sigma))
    so = f"with {sigma * 1e3:.3g} mm per coordinate its direction is expected to be {expected:.2g} deg off."
    found = []
    smallest = min(turns)
    if smallest < _SMALL_TURN - _SIGMAS * sigma / radius - _DEGENERATE:
        found.append(
            Finding(
                "warning",
                "small-turn",
                f"{names[int(turns[1] < turns[0])]} is turned by only {np.degrees(smallest):.3g} deg about the {axis} "
                f"axis, and 60 or more are advised; {so}",
            )
        )
    if radius < _SMALL_RADIUS:
        found.append(
            Finding(
                "warning",
                "small-radius",
                f"the mark is only {radius * 1e3:.3g} mm from the {axis} axis, and 100 or more are advised; {so}",
            )
        )
    sides = np.linalg.norm(P - np.roll(P, 1, axis=0), axis=1)
    height = np.linalg.norm(np.cross(P[1] - P[0], P[2] - P[0])) / sides.max()
    if height < _THIN * sides.max():
        found.append(
            Finding(
                "warning",
                "almost-collinear",
                f"P1, {names[0]} and {names[1]} lie almost on a line, {height * 1e3:.3g} mm off one of "
                f"{sides.max() * 1e3:.3g} mm; {so}",
            )
        )
    return found


# ---- as a machine


def axes_robot(axes: Sequence[Axis], names: Sequence[str]) -> Robot:
    """Return a URDF machine with the given axes, the one that carries all others first; its tip link is ``table``.

    At readings of zero its axes are where ``axes`` say, in the frame of its base link ``base``. Raises JobError when
    there are not as many ``names``, RobotError when they cannot be joints' names.
    """
    if len(names) != len(axes) or not axes:
        raise JobError(f"there are {len(axes)} axes and {len(names)} names; each axis needs one.")
    placed = []
    for axis in axes:
        R = np.column_stack([axis.across, axis.direction])
        placed.append((axis.kind, rigid.placement(R, axis.point)))
    return _robot(placed, names)


def _robot(placed: Sequence[tuple[str, Array]], names: Sequence[str]) -> Robot:
    """Return the machine whose joints stand at placements (4, 4) in the base, all of readings zero, along z."""
    links = ["base", *(f"{name}_carrier" for name in names[:-1]), "table"]
    lines = [f"<link name={quoted(link)}/>" for link in links]
    carrier = np.eye(4)
    for (kind, T), name, parent, child in zip(placed, names, links, links[1:], strict=False):
        origin = rigid.inverse(carrier) @ T
        carrier = T
        xyz, rpy = (
            " ".join(repr(float(v)) for v in values) for values in (origin[:3, 3], rigid.rpy_of(origin[:3, :3]))
        )
        limits = '<limit lower="-1e3" upper="1e3" effort="0" velocity="0"/>' if kind == "prismatic" else ""
        lines.append(
            f"<joint name={quoted(name)} type={quoted('continuous' if kind == 'revolute' else kind)}>"
            f'<parent link={quoted(parent)}/><child link={quoted(child)}/><origin xyz="{xyz}" rpy="{rpy}"/>'
            f'<axis xyz="0 0 1"/>{limits}</joint>'
        )
    text = "\n".join(['<robot name="positioner">', *lines, "</robot>", ""])
    return load_robot(parse_urdf(text.encode(), "positioner"), "table", "base")


def axes_model(robot: Robot) -> ErrorModel:
    """Return the error model whose unknowns are the lines of all axes of ``robot``, and the marks on its table.

    The base's pose places the first moving joint, the placements of the others place them after it, and the marks are
    points on the tip link (column ``point`` of the measurements). These are more names than numbers: the rank is 4 for
    a revolute axis, 2 for a prismatic one, and 3 for every mark. The rest are the freedoms of the frames (origins slide
    and turn on their axes); policy "nearest" leaves those nearest to the nominal machine, "minimal" frees as many
    parameters as the rank. No predicted point depends on the choice.

    No guess is asked for where base and marks are. The axes should lie to each other as in ``robot`` to some
    centimetres and degrees; where nobody knows how, begin with :meth:`FivePoint.robot` or :func:`axes_robot`.
    """
    _, *others = (robot.chain[i].name for i in robot.moving)
    return error_model(robot, placements=others or "none")


# ---- how good it is


@dataclass(frozen=True, slots=True, eq=False)
class TableError:
    """Expected errors of predicted table points, to first order. Made by :func:`table_error`.

    ``covariances`` (N, 3, 3), in m^2. ``rms`` and ``largest``: of the points' expected 3D errors, in m. ``held``: how
    many directions the fit kept at their nominal values, as the data hardly see them; here they count as known, so that
    any other number than 0 makes the rest too small.
    """

    covariances: Array
    rms: float
    largest: float
    held: int


def table_points(fit: Fit, points: npt.ArrayLike, angles: npt.ArrayLike) -> Array:
    """Return where table points are, in the instrument's frame, at ``angles`` (N, k), by an identified positioner.

    ``points`` (N, 3) or (3,): where they are, in m, while all axes read zero. ``angles``: readings in rad and m.
    """
    x, q = _envelope(fit, points, angles)
    rows = np.concatenate([q, np.zeros_like(q[:1])])
    T = fit.machine.frames.base @ fit.model.robot.tips(rows, fit.machine.deviations, ordinary(rows))
    moved = T[:-1] @ rigid.inverse(T[-1])
    return np.asarray((moved[:, :3, :3] @ x[:, :, None])[..., 0] + moved[:, :3, 3])


def table_error(fit: Fit, points: npt.ArrayLike, angles: npt.ArrayLike) -> TableError:
    """Return how far off table points are expected to be that an identified positioner predicts.

    ``points`` and ``angles`` as in :func:`table_points`: a point known exactly at zero, such as a seam taught there, is
    carried along by the axes, and the fit's covariance goes with it. What counts is thus how the axes lie and not where
    the marks are. The same convention as in the table of expected errors, docs/positioner.md.
    """
    x, q = _envelope(fit, points, angles)
    rows = np.concatenate([q, np.zeros_like(q[:1])])
    p = len(fit.parameters)
    # Twists of the table (N, 6, p) for a unit of each parameter: minus the Jacobian of poses seen as predicted.
    tool = fit.machine.frames.tools[0]
    usual = ordinary(rows)
    T = fit.machine.frames.base @ fit.model.robot.tips(rows, fit.machine.deviations, usual) @ tool
    names, tools = [reading.name for reading in fit.model.robot.readings], fit.measurements[0].tools
    seen = unmeasured(names, rows, T[:, :3, 3], T[:, :3, :3], tools=tools, conditions=usual, where="predicted")
    problem = Problem(fit.model, fit.parameters, fit.machine.frames, (seen,))
    J = np.concatenate([block.J for block in blocks(problem, seen, fit.machine, np.ones(p))])
    twist = -J
    twist[:, :3] = np.swapaxes(T[:, :3, :3], -1, -2) @ twist[:, :3]
    # x = T(q) s with s = T(0)^-1 x0: dx = R (v + w x s - v0 - w0 x s), twists local.
    back = rigid.inverse(T[-1])
    s = (x @ back[:3, :3].T) + back[:3, 3]
    S = rigid.skew(s)
    local = twist[:-1, :3] - S @ twist[:-1, 3:] - (twist[-1, :3] - S @ twist[-1, 3:])
    change = T[:-1, :3, :3] @ local
    covariances = change @ fit.covariance @ np.swapaxes(change, -1, -2)
    squares = np.trace(covariances, axis1=1, axis2=2)
    rms, largest = float(np.sqrt(squares.mean())), float(np.sqrt(squares.max()))
    return TableError(read_only(covariances), rms, largest, fit.rank - fit.usable_rank)


def _envelope(fit: Fit, points: npt.ArrayLike, angles: npt.ArrayLike) -> tuple[Array, Array]:
    q = np.asarray(angles, dtype=np.float64)
    if q.ndim != 2 or q.shape[1] != len(fit.model.robot.readings) or not np.isfinite(q).all():
        names = ", ".join(reading.name for reading in fit.model.robot.readings)
        raise MeasurementError(f"angles: must be finite numbers (N, {len(fit.model.robot.readings)}), of {names}.")
    x = np.asarray(points, dtype=np.float64)
    if x.shape not in ((3,), (len(q), 3)) or not np.isfinite(x).all():
        raise MeasurementError(f"points: must be finite numbers (3,) or ({len(q)}, 3), in m.")
    return np.broadcast_to(x, (len(q), 3)), q
