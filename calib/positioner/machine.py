"""A positioner as a URDF machine, identified from any number of points, and how well it carries a table point."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from calib.foundations import rigid
from calib.foundations.arguments import checked
from calib.foundations.arrays import Array, read_only
from calib.foundations.brief import brief
from calib.foundations.errors import JobError, MeasurementError
from calib.foundations.ranges import are_numbers
from calib.foundations.sealing import sealed
from calib.foundations.xml_text import quoted
from calib.identification.error_model import ErrorModel, error_model
from calib.identification.fit import Fit
from calib.machine.of_fit import machine_of, measured_factor
from calib.positioner.axes import Axis
from calib.robot.conditions import ordinary
from calib.robot.load import load_robot
from calib.robot.robot import Robot
from calib.robot.urdf import parse_urdf
from calib.robot.urdf_writer import origin_text

# ---- as a machine


@checked
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
    return robot_of_joints(placed, names)


def robot_of_joints(placed: Sequence[tuple[str, Array]], names: Sequence[str]) -> Robot:
    """Return the machine whose joints, each of a kind, have their z axes at placements (4, 4) in the base at zero."""
    links = ["base", *(f"{name}_carrier" for name in names[:-1]), "table"]
    lines = [f"<link name={quoted(link)}/>" for link in links]
    carrier = np.eye(4)
    for (kind, T), name, parent, child in zip(placed, names, links, links[1:], strict=False):
        origin = rigid.inverse(carrier) @ T
        carrier = T
        xyz, rpy = origin_text(origin)
        limits = '<limit lower="-1e3" upper="1e3" effort="0" velocity="0"/>' if kind == "prismatic" else ""
        lines.append(
            f"<joint name={quoted(name)} type={quoted('continuous' if kind == 'revolute' else kind)}>"
            f'<parent link={quoted(parent)}/><child link={quoted(child)}/><origin xyz="{xyz}" rpy="{rpy}"/>'
            f'<axis xyz="0 0 1"/>{limits}</joint>'
        )
    text = "\n".join(['<robot name="positioner">', *lines, "</robot>", ""])
    return load_robot(parse_urdf(text.encode(errors="surrogatepass"), "positioner"), "table", "base")


@checked
def axes_model(robot: Robot) -> ErrorModel:
    """Return the error model whose unknowns are the lines of all axes of ``robot``, and the marks on its table.

    The base's pose places the first moving joint, the placements of the others place them after it, and the marks are
    points on the tip link (column ``tool`` of the measurements). These are more names than numbers: the rank is 4 for
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
@sealed
class TableError:
    """Expected errors of predicted table points, to first order. Made by :func:`table_error`.

    ``covariances`` (N, 3, 3), in m^2. ``rms`` and ``largest``: of the points' expected 3D errors, in m. ``held``: how
    many directions the fit kept at their nominal values, as the data hardly see them; here they count as known, so that
    any other number than 0 makes the rest too small.
    """

    __repr__ = brief

    covariances: Array
    rms: float
    largest: float
    held: int


@checked
def table_points(fit: Fit, points: npt.ArrayLike, angles: npt.ArrayLike) -> Array:
    """Return where table points are, in the instrument's frame, at ``angles`` (N, k), by an identified positioner.

    ``points`` (N, 3) or (3,): where they are, in m, while all axes read zero. ``angles``: readings in rad and m.
    """
    x, q = _checked(fit, points, angles)
    rows = np.concatenate([q, np.zeros_like(q[:1])])
    T = fit.machine.frames.base @ fit.model.robot.tips(rows, fit.machine.deviations, ordinary(rows))
    moved = T[:-1] @ rigid.inverse(T[-1])
    return np.asarray((moved[:, :3, :3] @ x[:, :, None])[..., 0] + moved[:, :3, 3])


@checked
def table_error(fit: Fit, points: npt.ArrayLike, angles: npt.ArrayLike) -> TableError:
    """Return how far off table points are expected to be that an identified positioner predicts.

    ``points`` and ``angles`` as in :func:`table_points`: a point known exactly at zero, such as a seam taught there, is
    carried along by the axes, and the fit's covariance goes with it. What counts is thus how the axes lie and not where
    the marks are. The same convention as in the table of expected errors, docs/positioner.md.
    """
    x, q = _checked(fit, points, angles)
    rows = np.concatenate([q, np.zeros_like(q[:1])])
    machine = machine_of(fit)
    (tool,) = list(machine.tools)[:1]
    usual = ordinary(rows)
    T = machine.predict(rows, tool=tool, conditions=usual)
    # Local twists of the table (N, 6, r), one for each direction in which the machine is uncertain.
    twist = machine.tool_jacobian(rows, tool=tool, conditions=usual) @ measured_factor(fit)
    twist[:, :3] = np.swapaxes(T[:, :3, :3], -1, -2) @ twist[:, :3]
    # x = T(q) s with s = T(0)^-1 x0: dx = R (v + w x s - v0 - w0 x s), twists local.
    back = rigid.inverse(T[-1])
    s = (x @ back[:3, :3].T) + back[:3, 3]
    S = rigid.skew(s)
    local = twist[:-1, :3] - S @ twist[:-1, 3:] - (twist[-1, :3] - S @ twist[-1, 3:])
    change = T[:-1, :3, :3] @ local
    covariances = change @ np.swapaxes(change, -1, -2)
    squares = np.trace(covariances, axis1=1, axis2=2)
    rms, largest = float(np.sqrt(squares.mean())), float(np.sqrt(squares.max()))
    return TableError(read_only(covariances), rms, largest, fit.rank - fit.numerical_rank)


def _checked(fit: Fit, points: npt.ArrayLike, angles: npt.ArrayLike) -> tuple[Array, Array]:
    q = np.asarray(angles, dtype=np.float64)
    if q.ndim != 2 or q.shape[1] != len(fit.model.robot.readings) or not are_numbers(q):
        names = ", ".join(reading.name for reading in fit.model.robot.readings)
        raise MeasurementError(f"angles: must be finite numbers (N, {len(fit.model.robot.readings)}), of {names}.")
    x = np.asarray(points, dtype=np.float64)
    if x.shape not in ((3,), (len(q), 3)) or not are_numbers(x):
        raise MeasurementError(f"points: must be finite numbers (3,) or ({len(q)}, 3), in m.")
    return np.broadcast_to(x, (len(q), 3)), q
