"""What a machine adds to the positions of its kinematics, where its errors were measured: a grid, or a process."""

from collections.abc import Sequence
from typing import Final, Literal, NamedTuple, Protocol, runtime_checkable

import numpy as np

from calib.foundations.arrays import Array
from calib.foundations.errors import JobError, MeasurementError

Frame = Literal["base", "tip"]
FRAMES: Final[tuple[Frame, ...]] = ("base", "tip")


class Leaning(NamedTuple):
    """What a residual model takes its values from, at N readings.

    Errors measured at ``points`` (N, c, nr), with ``weights`` (N, c). ``unknown`` (N,): which share of errors that are
    common to neighbours it leaves; ``sigma`` (N,): of a component of its own prediction, in m, beside these.
    """

    points: Array
    weights: Array
    unknown: Array
    sigma: Array


@runtime_checkable
class ResidualModel(Protocol):
    """Errors of positions over joint space that no model of the arm explains."""

    @property
    def frame(self) -> Frame:
        """Whose axes the vectors have: those of the base or of the tip link."""

    @property
    def setups(self) -> tuple[str, ...]:
        """Of a machine with several, the names of the set-ups in which the errors were measured."""

    @property
    def tools(self) -> tuple[str, ...]:
        """Of a machine with several, the names of the tools with which the errors were measured."""

    @property
    def rows(self) -> int:
        """How many measured rows are gone through for every vector."""

    def at(self, readings: Array, *, clamp: bool = False) -> Array:
        """Return vectors (N, 3) in m to add to predicted positions at readings (N, nr), finite where it clamps."""

    def shifts(self, base: Array, tips: Array, readings: Array) -> Array:
        """Return vectors (N, 3) in the instrument's axes, finite; ``base`` (4, 4) is there, ``tips`` in the base."""

    def outside(self, readings: Array) -> tuple[str, ...]:
        """Return for every row why the model does not know it, or an empty text."""

    def leaning(self, readings: Array) -> Leaning:
        """Return what it takes its values from at readings (N, nr)."""

    def own_errors(self, readings: Array, noise: float) -> Array:
        """Return a factor (N, r) of the covariance that a component of its own errors has at readings (N, nr), in m.

        What it gets wrong is common to neighbours. ``noise``: standard deviation of what it was made of, in m.
        """

    def scatter(self, noise: float) -> float:
        """Return the standard deviation in m of what a component errs by from pose to pose, whatever neighbours do.

        It is in what the model was made of, beside ``noise``, in m: errors that follow other joints than the model's.
        """

    @property
    def when_clamped(self) -> str:
        """What is added in such rows where it clamps."""


def shifted(known: ResidualModel | None, tips: Array, readings: Array) -> Array:
    """Return the tips (N, 4, 4) in the base link, from those without them, with what a residual model adds."""
    if known is None:
        return tips
    found = np.array(tips)
    found[:, :3, 3] += known.shifts(np.eye(4), tips, readings)
    return found


def axes_of(frame: Frame, base: Array, tips: Array) -> Array:
    """Return the axes (N, 3, 3) of a residual model's frame in the instrument's.

    Arguments as for :meth:`ResidualModel.shifts`; ``base`` also (N, 4, 4), of every row.
    """
    turned = base[..., :3, :3] if frame == "base" else (base @ tips)[:, :3, :3]
    return np.broadcast_to(turned, (len(tips), 3, 3))


def joint_numbers(names: Sequence[str], joints: Sequence[str], frame: str) -> list[int]:
    """Return the joints of a residual model, by number. Raises JobError for others, and for another frame."""
    if frame not in FRAMES:
        raise JobError(f"the frame of a residual model is {frame!r}; allowed are {', '.join(FRAMES)}.")
    for name in joints:
        if name not in names:
            raise JobError(f"a residual model cannot follow {name!r}; the joints that are read are {', '.join(names)}.")
    if not joints or len(set(joints)) < len(joints):
        raise JobError("the joints of a residual model must be at least one, each named once.")
    return [names.index(name) for name in joints]


def measured_errors(readings: Array, errors: Array, width: int, place: str) -> tuple[Array, Array]:
    """Return readings (N, width) and errors (N, 3), one row or more. Raises MeasurementError for anything else."""
    readings, errors = np.asarray(readings, dtype=np.float64), np.asarray(errors, dtype=np.float64)
    if readings.shape != (len(errors), width) or errors.shape != (len(readings), 3) or not len(errors):
        raise MeasurementError(
            f"{place}: readings {readings.shape} and errors {errors.shape} must have the shapes (N, {width}) and "
            "(N, 3)."
        )
    if not (np.isfinite(readings).all() and np.isfinite(errors).all()):
        raise MeasurementError(f"{place}: readings and errors must be finite numbers.")
    return readings, errors
