"""Rows of a stream: when each was measured, and where the joints were then, as far as clocks are known."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Literal, NamedTuple, get_args

import numpy as np

from calib.foundations.arguments import own_fields
from calib.foundations.arrays import Array, BoolArray, IntArray, read_only_view
from calib.foundations.brief import brief
from calib.foundations.errors import JobError
from calib.foundations.ranges import refuse_beyond
from calib.foundations.sealing import sealed
from calib.foundations.words import refuse_other
from calib.measurement.scalars import Scalar
from calib.measurement.streams.joints import JointStream

ClockFreedom = Literal["free", "given"]
# What unknown numbers are to the rows of a stream.
OFFSET, SKEW, LATENCY = SHIFTS = ("clock offset", "clock skew", "clock latency")
ONLY_CLOCK = "clock"
NO_SHIFTS: Mapping[str, float] = MappingProxyType({})


class OneClock(NamedTuple):
    """The free clock of a stream, ``where`` it is: its offset, told at ``middle`` in s, and its skew."""

    middle: float
    offset: Scalar
    skew: Scalar
    where: str


@dataclass(frozen=True, slots=True)
class Clock:
    """What is known of an instrument's clock beside that of the controller.

    ``kind``: "free", its offset and skew are found with the machine, or "given", both are one clock. ``latency``:
    whether measurements come later than readings by an unknown time; of a free clock that is part of the offset, and
    only a second stream of that clock shows how much later it comes than the first. ``gap``: in s, from which on a gap
    in a stream is not bridged; None for 0.1 s or, of slow streams, 2.5 steps, 0.25 s at the most. ``name``: of its
    parameters, ``clock.offset``. ``of``: that of another stream, its ``Measurements.clock``, by which this one goes.

    Raises JobError for a number out of range.
    """

    kind: ClockFreedom = "free"
    latency: bool = False
    gap: float | None = None
    name: str = ONLY_CLOCK
    of: OneClock | None = None

    def __post_init__(self) -> None:
        own_fields(self)
        refuse_other(self.kind, get_args(ClockFreedom), "clock")
        if self.gap is not None:
            refuse_beyond(self.gap, "gap", "clock: gap")
        if self.of is not None and self.kind != "free":
            raise JobError(f"clock: is given, and is that of {self.of.where} as well, which is free; keep one of them.")


@dataclass(frozen=True, slots=True, eq=False)
@sealed
class Stream:
    """When rows were measured: ``since`` (N,) s after ``middle``, in s, by the instrument's clock.

    ``joints``: what the controller recorded meanwhile. Its clock shows ``u = t - offset + skew (t - middle)`` when the
    instrument's shows t: the offset is that in the middle of the stream, where it does not depend on the skew. A
    latency is taken off as the offset is.
    """

    __repr__ = brief

    joints: JointStream
    since: Array
    middle: float

    def times(self, shifts: Mapping[str, float] = NO_SHIFTS, rows: slice | IntArray | BoolArray = slice(None)) -> Array:
        """Return what the controller's clock showed (n,) in s; ``shifts``: offset and skew, 0 where not given."""
        since = self.since[rows]
        late = shifts.get(OFFSET, 0.0) + shifts.get(LATENCY, 0.0)
        return np.asarray((self.middle - late) + since * (1.0 + shifts.get(SKEW, 0.0)))

    def readings(self, shifts: Mapping[str, float], rows: slice | IntArray | BoolArray = slice(None)) -> Array:
        """Return the readings (n, k) of some rows."""
        return self.joints.at(self.times(shifts, rows))

    def rates(self, shifts: Mapping[str, float], rows: slice | IntArray | BoolArray = slice(None)) -> Array:
        """Return how fast the readings change (n, k), per s of the controller's clock."""
        return self.joints.rates(self.times(shifts, rows))

    def mean_rates(self, shifts: Mapping[str, float], rows: slice | IntArray | BoolArray = slice(None)) -> Array:
        """Return how fast the readings change on the mean (n, k), per s, around the time of each row."""
        return self.joints.mean_rates(self.times(shifts, rows))

    def motion(self, shifts: Mapping[str, float], rows: slice | IntArray | BoolArray = slice(None)) -> Array:
        """Return rates and accelerations (n, 2, k) of the readings; zeros of joints whose samples do not show them."""
        times, shown = self.times(shifts, rows), self.joints.accelerates
        found = np.stack([self.joints.rates(times), self.joints.accelerations(times)], axis=1)
        return np.asarray(found * (0.0 if shown is None else shown))

    def by_shift(self, role: str, rows: slice | IntArray | BoolArray = slice(None)) -> Array:
        """Return how the controller's time (n,) follows one unit of the offset or latency, or of the skew."""
        since = self.since[rows]
        return since if role == SKEW else np.full(len(since), -1.0)

    def subset(self, rows: IntArray | BoolArray) -> "Stream":
        """Return the stream of some rows; the offset stays that in the middle of all."""
        return replace(self, since=read_only_view(self.since[rows]))
