"""How parameter errors move the tip: the error model of a multi-joint arm, before anything is measured.

The total differential of the touched point P = F(x) is dP = J dx, with one column for every parameter of an error model
(Ye Dong, Huang Qingcheng, Che Rensheng, *error model of a multi-joint CMM*: dP = sum df/da da + df/dd dd + df/dalpha
dalpha + df/dtheta dtheta, 25 columns for six joints). The coefficients are those of the nominal robot, analytic and
exact; what linearising leaves out is seen by setting :func:`predicted_error` beside :func:`exact_error`.

Terms that depend on more than readings count as reached from below, and a kelvin above the reference temperature.
Everywhere ``readings`` (N, k) are encoder readings in rad or m, one column for every reading of the robot, and the
point is the model's only tool, at its given place.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from calib.foundations.arguments import checked
from calib.foundations.arrays import Array, IntArray, read_only
from calib.foundations.brief import brief
from calib.foundations.errors import JobError
from calib.foundations.ranges import finite
from calib.foundations.sealing import sealed
from calib.identification import identifiability
from calib.identification.arrow import Arrow
from calib.identification.error_model import ErrorModel
from calib.identification.identifiability import NullDirection
from calib.identification.machine import Frames, Machine, machine, values_at
from calib.identification.parameters import Parameter, directions, refuse_none_free, scales
from calib.machine.tool_motion import tool_jacobian, tool_poses
from calib.measurement.table import nearest
from calib.robot.conditions import REFERENCE_TEMPERATURE, Conditions
from calib.robot.robot import Robot


class ErrorCoefficients(NamedTuple):
    """Change of the tip point with each parameter: ``matrix`` (N, 3, p) in m per m or m per rad, columns ``names``."""

    names: tuple[str, ...]
    matrix: Array


@dataclass(frozen=True, slots=True, eq=False)
@sealed
class Sensitivity:
    """How far each parameter moves the tip over a set of poses. Made by :func:`sensitivity`.

    ``rms`` and ``largest`` (p,): length of a parameter's coefficient over the ``poses``, in m per m or m per rad, which
    are mm per mm and mm per mrad. ``rank``: how many combinations of the parameters the positions tell apart;
    ``undetermined``: those they do not.
    """

    __repr__ = brief

    parameters: tuple[Parameter, ...]
    poses: int
    rms: Array
    largest: Array
    rank: int
    undetermined: tuple[NullDirection, ...]

    @property
    def order(self) -> IntArray:
        """Indices (p,) of the parameters by rms, the strongest first; equal ones in the order of the model."""
        return np.argsort(-np.round(self.rms, 9), kind="stable")

    def records(self) -> list[dict[str, object]]:
        """Return one plain record for every parameter, in the order of the model."""
        return [
            {"name": p.name, "unit": f"m/{p.unit}", "rms": float(rms), "max": float(largest)}
            for p, rms, largest in zip(self.parameters, self.rms, self.largest, strict=True)
        ]


@dataclass(frozen=True, slots=True, eq=False)
@sealed
class GroupStudy:
    """What becomes of the tip error when one group of parameter errors grows or shrinks. Made by :func:`group_study`.

    ``errors`` (N,): exact length of the tip error in m under the given parameter errors. ``scaled`` (groups, factors,
    N): the same with the errors of one group multiplied by one factor.
    """

    __repr__ = brief

    groups: tuple[str, ...]
    factors: tuple[float, ...]
    errors: Array
    scaled: Array

    @property
    def changes(self) -> Array:
        """``scaled - errors`` (groups, factors, N) in m."""
        return np.asarray(self.scaled - self.errors)

    def records(self) -> list[dict[str, object]]:
        """Return one plain record for every group and factor: the change of the tip error in m over the poses."""
        return [
            {
                "group": group,
                "factor": factor,
                "smallest": float(change.min()),
                "mean": float(change.mean()),
                "largest": float(change.max()),
            }
            for group, of_group in zip(self.groups, self.changes, strict=True)
            for factor, change in zip(self.factors, of_group, strict=True)
        ]


@checked
def error_coefficients(model: ErrorModel, readings: npt.ArrayLike) -> ErrorCoefficients:
    """Return the error model's coefficient matrix (N, 3, p) at the nominal robot.

    Raises JobError when nothing is free, MeasurementError when the readings are not of this robot.
    """
    poses, x = _at_nominal(model, readings)
    return ErrorCoefficients(tuple(p.name for p in poses.parameters), read_only(poses.jacobian(x)))


@checked
def predicted_error(model: ErrorModel, readings: npt.ArrayLike, errors: Mapping[str, float]) -> Array:
    """Return the linear tip error dP = J dx (N, 3) in m for ``errors`` by parameter name, in m and rad.

    What is not named has no error. Raises JobError for a name that is no free parameter, or a value that is no number.
    """
    poses, x = _at_nominal(model, readings)
    return read_only(poses.jacobian(x) @ _values(poses.parameters, errors))


@checked
def exact_error(model: ErrorModel, readings: npt.ArrayLike, errors: Mapping[str, float]) -> Array:
    """Return the tip error F(x + dx) - F(x) (N, 3) in m for ``errors`` as in :func:`predicted_error`."""
    poses, x = _at_nominal(model, readings)
    return read_only(poses.points(x + _values(poses.parameters, errors)) - poses.points(x))


@checked
def sensitivity(model: ErrorModel, readings: npt.ArrayLike) -> Sensitivity:
    """Return how far every parameter moves the tip over a set of poses, and which parameters positions tell apart."""
    poses, x = _at_nominal(model, readings)
    J, parameters = poses.jacobian(x), poses.parameters
    motion = np.linalg.norm(J, axis=1)
    scaled = J.reshape(-1, len(parameters)) * scales(parameters)
    # A joint whose axis runs through the tip moves it by rounding: that is nothing, and no direction of its own.
    size = np.linalg.norm(scaled, axis=0)
    scaled = np.where(size > identifiability.RANK_TOLERANCE * size.max(initial=0.0), scaled, 0.0)
    seen = identifiability.singular_directions(scaled)
    _, undetermined = identifiability.told(Arrow.plain(scaled), seen.rank, parameters)
    return Sensitivity(
        parameters,
        len(J),
        read_only(np.sqrt(np.mean(motion**2, axis=0))),
        read_only(np.max(motion, axis=0)),
        seen.rank,
        undetermined,
    )


def group_of(name: str) -> str:
    """Return the group of a parameter, the last part of its name: ``a``, ``d``, ``alpha``, ``offset``, ``tx``, ..."""
    return name.rpartition(".")[2]


@checked
def group_study(
    model: ErrorModel, readings: npt.ArrayLike, errors: Mapping[str, float], factors: Sequence[float] = (10.0, 0.1)
) -> GroupStudy:
    """Multiply the errors of one group of parameters at a time, and return the exact tip errors.

    The study of the paper (Ye Dong, Huang Qingcheng, Che Rensheng) takes the groups a, d, alpha and theta - here called
    ``offset`` - of a DH table ten times as large and ten times as small. ``errors`` as in :func:`predicted_error`.
    """
    finite(factors, (None,), f"factors: {factors!r} are not finite numbers.", JobError)
    groups = _unique(map(group_of, errors))
    poses, x = _at_nominal(model, readings)
    nominal = poses.points(x)

    def length(factor: float, scaled_group: str | None) -> Array:
        scaled = {name: value * (factor if group_of(name) == scaled_group else 1.0) for name, value in errors.items()}
        moved = poses.points(x + _values(poses.parameters, scaled))
        return np.asarray(np.linalg.norm(moved - nominal, axis=1))

    scaled = np.array([[length(factor, group) for factor in factors] for group in groups])
    return GroupStudy(
        groups,
        tuple(float(factor) for factor in factors),
        read_only(length(1.0, None)),
        read_only(scaled.reshape(len(groups), len(factors), len(nominal))),
    )


def _unique(words: Iterable[str]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(words))


class _Poses(NamedTuple):
    """Readings (N, nr) with conditions, of a robot with frames whose ``parameters`` are errors."""

    robot: Robot
    parameters: tuple[Parameter, ...]
    reference: Frames
    readings: Array
    conditions: Conditions

    def at(self, x: Array) -> Machine:
        return machine(self.robot, self.parameters, self.reference, x)

    def points(self, x: Array) -> Array:
        """Return the tip points (N, 3) at parameter values x (p,)."""
        return tool_poses(self.robot, self.at(x), self.readings, self.conditions)[:, :3, 3]

    def jacobian(self, x: Array) -> Array:
        """Return the derivatives (N, 3, p) of the points."""
        by_state = tool_jacobian(self.robot, self.at(x), self.readings, self.conditions)[:, :3]
        return np.asarray(by_state @ directions(self.parameters, by_state.shape[2]))


def _at_nominal(model: ErrorModel, readings: npt.ArrayLike) -> tuple[_Poses, Array]:
    """Return the poses, and the nominal robot's parameter values (p,)."""
    names = tuple(reading.name for reading in model.robot.readings)
    needed = f"needed are finite numbers (N, {len(names)}), a column for each of {', '.join(names)}."
    q = finite(readings, (None, len(names)), f"readings of shape {np.shape(readings)}: {needed}")
    tools = ("tool",)
    parameters = model.parameters(tools)
    refuse_none_free(parameters)
    warm = Conditions(np.ones_like(q), np.full(len(q), REFERENCE_TEMPERATURE + 1.0), np.ones_like(q))
    warm = warm.in_time(np.zeros(len(q)))
    reference = model.given_frames(tools)
    return _Poses(model.robot, parameters, reference, q, warm), values_at(model.robot, parameters, reference)


def _values(parameters: Sequence[Parameter], errors: Mapping[str, float]) -> Array:
    names = [parameter.name for parameter in parameters]
    for name, value in errors.items():
        if name not in names:
            raise JobError(f"{name!r} is not a free parameter of the error model{nearest(name, names)}.")
        if not np.isfinite(value):
            raise JobError(f"{name}: {value!r} is not a finite error in m or rad.")
    return np.array([float(errors.get(name, 0.0)) for name in names])
