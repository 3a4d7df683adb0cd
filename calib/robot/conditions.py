"""What a row carries beside its readings, where joints stand differently for the same reading."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from operator import attrgetter
from typing import Any

import numpy as np

from calib.foundations.arguments import checked, own_fields
from calib.foundations.arrays import Array, BoolArray, IntArray, read_only
from calib.foundations.brief import brief
from calib.foundations.errors import RobotError
from calib.foundations.ranges import OF_DIMENSION
from calib.foundations.sealing import sealed
from calib.foundations.units import Dimension
from calib.robot.warming import lagged

# Lengths are stated at this temperature (ISO 1), in degC.
REFERENCE_TEMPERATURE = 20.0


@dataclass(frozen=True, slots=True, eq=False)
@sealed
class Conditions:
    """Conditions of N rows; None where nobody says, and NaN for a reading of which nobody does.

    ``approach`` (N, nr): the side from which every reading was reached: +1 growing, -1 falling, 0 from neither.
    ``temperature`` (N,): of the machine, in degC. ``torque`` (N, nr): what drives were measured to hold, in Nm.
    ``payload`` (N, links, 4): what each of the robot's ``links`` carries, its first moment in kg m in the link and its
    mass in kg; ``gravity`` (N, 3): in m/s^2 in the base link. Where they are NaN, those of the robot are meant.
    ``motion`` (N, 2, nr): rates and accelerations of the readings, per s and s^2; None at rest.
    ``lagged``: temperatures in degC of what follows late, as :meth:`in_time` makes them. ``torque_sigma`` (N,): the
    standard deviation of the torques in Nm, None where they are taken as they are. ``ordered``, of targets: they are
    visited in the order of their rows, without overshoot, and the commands for them tell the approach.
    """

    __repr__ = brief

    approach: Array | None = None
    temperature: Array | None = None
    torque: Array | None = None
    payload: Array | None = None
    gravity: Array | None = None
    lagged: Array | None = None
    torque_sigma: Array | None = None
    motion: Array | None = None
    ordered: bool = False

    def __post_init__(self) -> None:
        own_fields(self)

    @property
    def of_loads(self) -> tuple[Array | None, ...]:
        """What bears on the robot beside its own links: payloads, gravity, and how the joints moved."""
        return self.payload, self.gravity, self.motion

    @checked
    def subset(self, rows: slice | IntArray | BoolArray | Sequence[int]) -> "Conditions":
        """Return the conditions of some rows; these are no longer ordered. Raises RobotError for rows that are none."""
        those = rows if isinstance(rows, slice | np.ndarray) else np.array(rows, dtype=np.intp)
        try:
            found: dict[str, Any] = {name: values[those] for name, values in self.told().items()}
        except IndexError as e:
            raise RobotError(f"conditions: there are no such rows ({e}).") from e
        return Conditions(**found) if found else NO_CONDITIONS

    def told(self) -> dict[str, Array]:
        """Return what is known of the rows, by name."""
        return {name: values for name, values in zip(_NAMES, _every(self), strict=True) if values is not None}

    @checked
    def refuse_other_rows(self, rows: int, readings: int) -> None:
        """Raise RobotError where these are not the conditions of so many rows, of so many readings each.

        Nor are they where a number is beyond what the cells of a table may be; NaN says nothing, and is none.
        """
        for name, values in self.told().items():
            needed = (rows, readings) if name in _OF_READINGS else (rows, *values.shape[1:])
            if values.shape != needed:
                raise RobotError(f"conditions: {name} has the shape {values.shape}; of these rows it is {needed}.")
            allowed = OF_DIMENSION[_DIMENSIONS.get(name, "number")]
            low, high = allowed.ends
            if (beyond := (values < low) | (values > high)).any():
                row = int(np.argwhere(beyond)[0][0])
                raise RobotError(f"conditions: {name} of row {row} is {values[beyond][0]:g}; allowed is {allowed}.")

    @checked
    def in_time(self, times: Array) -> "Conditions":
        """Return the conditions of rows whose temperatures were told at times (N,) in s, for terms with memory.

            calib.measuring.Conditions(temperature=celsius).in_time(seconds)

        The rows are all of one session, in any order. Before the first one the machine had its temperature for long.
        Raises RobotError where there is no temperature, or not a time for each.
        """
        if self.temperature is None:
            raise RobotError("in_time: the rows have no temperature; state it first.")
        if np.shape(times) != self.temperature.shape:
            raise RobotError(
                f"in_time: times of shape {np.shape(times)}; needed is one for each of {len(self.temperature)} rows."
            )
        return replace(self, lagged=lagged(times, self.temperature))


NO_CONDITIONS = Conditions()
_NAMES = tuple(field.name for field in fields(Conditions) if field.name != "ordered")
_every = attrgetter(*_NAMES)
_OF_READINGS = ("approach", "torque")
_DIMENSIONS: Mapping[str, Dimension] = {
    "temperature": "temperature",
    "lagged": "temperature",
    "torque": "torque",
    "torque_sigma": "torque",
    "gravity": "acceleration",
}
# What rows have of which nobody says anything, beside others of which somebody does; of all else, nobody then does.
_UNSAID = {"payload": np.nan, "gravity": np.nan, "motion": 0.0}


def ordinary(readings: Array) -> Conditions:
    """Return the conditions of readings (N, nr) of which nothing is said: they add nothing.

    Reached from neither side, at the reference temperature, no torque measured.
    """
    told = Conditions(np.zeros_like(readings), np.full(len(readings), REFERENCE_TEMPERATURE), np.zeros_like(readings))
    return told.in_time(np.zeros(len(readings)))


def joined(parts: Sequence[tuple[int, Conditions]]) -> Conditions:
    """Return the conditions of rows one part after the other, each part being how many rows it has, and theirs.

    None where one part has none; but a part that tells no load has that of the robot, and one without motion rests.
    """

    def of_all(name: str) -> Array | None:
        found: list[Array | None] = [getattr(told, name) for _, told in parts]
        like = next((values for values in found if values is not None), None)
        if like is not None and name in _UNSAID:
            of_rows = [np.full((rows, *like.shape[1:]), _UNSAID[name]) for rows, _ in parts]
            found = [unsaid if own is None else own for own, unsaid in zip(found, of_rows, strict=True)]
        known = [values for values in found if values is not None]
        return read_only(np.concatenate(known)) if known and len(known) == len(found) else None

    of_rows: dict[str, Any] = {name: of_all(name) for name in _NAMES}
    return Conditions(**of_rows)


def in_order(readings: Array) -> Array:
    """Return the approach (N, nr) of readings (N, nr) that were reached one after the other, without overshoot.

    A reading that rests keeps the side of its last move; before the first one it is 0.
    """
    signs = np.zeros_like(readings)
    signs[1:] = np.sign(np.diff(readings, axis=0))
    # Of every row the last one in which the reading moved.
    last = np.maximum.accumulate(np.where(signs != 0.0, np.arange(len(signs))[:, None], 0), axis=0)
    return read_only(np.take_along_axis(signs, last, axis=0))
