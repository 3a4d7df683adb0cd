"""How large and how small every quantity of a job may be, in one table: what lies beyond is a slip of the pen.

The same holds of the numbers that are given from Python, and of the cells of tables. Within the ranges the mathematics
has room: products of them stay numbers.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
import numpy.typing as npt

from calib.foundations import rigid
from calib.foundations.arrays import Array
from calib.foundations.errors import CalibError, JobError, MeasurementError
from calib.foundations.units import UNITS, Dimension, parse_quantity


@dataclass(frozen=True, slots=True)
class Range:
    """From ``low`` to ``high`` in ``unit``; ``zero``: or 0, where that is below."""

    low: float
    high: float
    unit: str
    zero: bool = False

    @property
    def dimension(self) -> Dimension:
        """Of what the range is."""
        return UNITS[self.unit].dimension

    @property
    def ends(self) -> tuple[float, float]:
        """The ends in SI units; a little wider, so that these themselves are within."""
        factor = UNITS[self.unit].factor
        low, high = self.low * factor, self.high * factor
        return low - 1e-9 * abs(low), high + 1e-9 * abs(high)

    def holds(self, value: float) -> bool:
        """Return whether a value in SI units is within."""
        low, high = self.ends
        return low <= value <= high or (self.zero and value == 0.0)

    def __str__(self) -> str:
        """Return the words of messages and of the documentation."""
        unit = "" if self.unit == "1" else f" {self.unit}"
        return f"{'0, or ' if self.zero else ''}{self.low:g} to {self.high:g}{unit}"


_SIGMA = Range(1e-6, 1e3, "mm")
_SIGMA_FROM_ZERO = Range(1e-6, 1e3, "mm", zero=True)
_SIGMA_ANGLE = Range(1e-6, 1e3, "mrad")
_PLACE = Range(-1e4, 1e4, "m")

# By the key of the job, with its section where others have the same; what Python calls otherwise has a line of its own.
RANGES: Mapping[str, Range] = MappingProxyType(
    {
        "position, station, point": _PLACE,
        "height": _PLACE,
        "normal": Range(-1e6, 1e6, "1"),
        "gravity": Range(-100.0, 100.0, "m/s2"),
        "mass": Range(1e-6, 1e5, "kg", zero=True),
        "coupling.drivers": Range(-1e6, 1e6, "1"),
        "coupling.offset": Range(-1e3, 1e3, "rad"),
        "coupling.offset of what slides": _PLACE,
        "error_model.dh_parallel": Range(1e-9, 0.5, "rad"),
        "prior.length": Range(1e-6, 1e3, "mm"),
        "prior.angle": Range(1e-6, 1e3, "mrad"),
        "prior.harmonics": Range(1e-6, 1e3, "mrad"),
        "prior.elastic": Range(1e-9, 1e6, "urad/Nm"),
        "prior.elastic of readings that slide": Range(1e-9, 1e6, "um/N"),
        "solver.stop": Range(1e-6, 1e3, "mm"),
        "solver.rounding": Range(1e-6, 1e3, "mrad"),
        "sigma": _SIGMA,
        "sigma_angle": _SIGMA_ANGLE,
        "instruments.sigma": _SIGMA_FROM_ZERO,
        "instruments.sigma of a camera": Range(1e-4, 1e4, "px", zero=True),
        "sigma_per_metre": _SIGMA_FROM_ZERO,
        "fx, fy": Range(1.0, 1e6, "px"),
        "cx, cy": Range(-1e6, 1e6, "px"),
        "k1, k2, p1, p2, k3, k4, k5, k6": Range(-1e4, 1e4, "1"),
        "lens_sigma": Range(1e-4, 1e5, "px"),
        "lens_sigma of distortion": Range(1e-9, 1e3, "1"),
        "size": Range(16.0, 1e5, "px"),
        "square, marker": Range(1e-4, 10.0, "m"),
        "square_sigma": Range(1e-6, 0.2, "1", zero=True),
        "model_sigma": _SIGMA_FROM_ZERO,
        "model_sigma of pixels": Range(1e-4, 1e4, "px", zero=True),
        "model_sigma_angle": Range(1e-6, 1e3, "mrad", zero=True),
        "gap": Range(1e-3, 10.0, "s"),
        "relations.distance": Range(0.0, 1e4, "m"),
        "relations.offset": _PLACE,
        "relations.angle": Range(0, 180, "deg"),
        "relations.sigma": _SIGMA,
        "relations.sigma of an angle": _SIGMA_ANGLE,
    }
)

# Of the cells of tables, and of quantities on the command line; seconds since 1970 are within.
OF_DIMENSION: Mapping[Dimension, Range] = MappingProxyType(
    {
        "length": _PLACE,
        "angle": Range(-1e4, 1e4, "rad"),
        "torque": Range(-1e9, 1e9, "Nm"),
        "mass": Range(-1e6, 1e6, "kg"),
        "acceleration": Range(-1e3, 1e3, "m/s2"),
        "time": Range(-1e12, 1e12, "s"),
        "temperature": Range(-300.0, 1e4, "degC"),
        "pixel": Range(-1e6, 1e6, "px"),
        "turning compliance": Range(-1.0, 1.0, "rad/Nm"),
        "sliding compliance": Range(-1.0, 1.0, "m/N"),
        "number": Range(-1e12, 1e12, "1"),
    }
)

# A cell that is nearer to 0 in SI units, and not 0, comes from memory that nobody wrote to; its inverse is no number.
SMALLEST_CELL = 1e-100

# An argument that is farther from 0 in SI units, as its square is no number.
LARGEST = 1.0 / SMALLEST_CELL

# How many of what a job may have.
COUNTS: Mapping[str, int] = MappingProxyType(
    {
        "robot.mesh_roots": 100,
        "robot.coupling": 200,
        "robot.coupling.drivers": 200,
        "robot.loop": 12,
        "error_model.harmonic_orders": 20,
        "setups": 100,
        "tools": 100,
        "instruments": 200,
        "targets": 100,
        "relations": 300,
        "levels": 50,
        "measurements": 100,
        "measurements.columns": 1000,
        "measurements.targets": 1000,
    }
)
# As many may be in the tables of a calibration: set-ups and tools are found with the robot, targets one by one.
MOST_SETUPS = COUNTS["setups"]
MOST_TOOLS = COUNTS["tools"]
# Of both together: rows that see all pairs of many have nothing in common by which they could be reduced.
MOST_FRAMES = 81
MOST_TARGETS = 20_000
# Of a job's targets those that are touched: what is said of each takes longer than the fit.
MOST_TOUCHED = 500
# Of targets that relations join, which are not eliminated.
MOST_RELATED, MOST_RELATIONS = 50, COUNTS["relations"]
# Closed loops of an arm: what follows the machine at a row grows with their number, and with its square in memory.
MOST_LOOPS = COUNTS["robot.loop"]
# Joint terms of a machine: all harmonics of 200 joints in 20 orders.
MOST_TERMS = 8000
# Of names and globs, wherever a list of them may stand.
MOST_NAMES = 1000


def refuse_beyond(values: npt.ArrayLike, name: str, where: str, error: type[CalibError] = JobError) -> None:
    """Raise ``error`` when one of the numbers, in SI units, is not within the range of ``name``."""
    for value in np.ravel(values):
        if not RANGES[name].holds(float(value)):
            raise error(f"{where} is {value:g}{_si(RANGES[name])}; allowed is {RANGES[name]}.")


def refuse_no_placement(T: Array, where: str, error: type[CalibError] = JobError) -> None:
    """Raise ``error`` for what is no placement (4, 4): a rotation, a position in m within its range, 0 0 0 1."""
    if T.shape != (4, 4) or not rigid.are_placements(T[None])[0]:
        raise error(f"{where}: needs a rigid placement (4, 4): a rotation, a position in m, and the last row 0 0 0 1.")
    refuse_beyond(T[:3, 3], "position, station, point", where, error)


def refuse_shape(values: Array, shape: tuple[int | None, ...], where: str, error: type[CalibError] = JobError) -> None:
    """Raise ``error`` for an array of another shape, None being any number, or with what is no finite number."""
    if values.ndim != len(shape) or any(n not in (None, m) for n, m in zip(shape, values.shape, strict=True)):
        needed = ", ".join("any" if n is None else str(n) for n in shape)
        raise error(f"{where} has the shape {values.shape}; needed is ({needed}).")
    if not are_numbers(values):
        raise error(f"{where} has numbers that are not finite, or above {LARGEST:g}.")


def finite(
    values: npt.ArrayLike,
    shape: tuple[int | None, ...] | None,
    sentence: str,
    error: type[CalibError] = MeasurementError,
) -> Array:
    """Return numbers of a shape as an array, or raise ``error`` with the sentence.

    None is any shape, and in a shape any number from 1.
    """
    found = np.asarray(values, dtype=np.float64)
    fits = shape is None or (
        found.ndim == len(shape)
        and all(
            there == wanted or (wanted is None and there > 0) for there, wanted in zip(found.shape, shape, strict=True)
        )
    )
    if not (fits and are_numbers(found)):
        raise error(sentence)
    return found


def are_numbers(values: Array) -> bool:
    """Tell whether all of them are finite, and their squares are as well."""
    return bool(np.all(np.abs(values) <= LARGEST))  # a comparison with nan is false


def refuse_sigma(value: float | None, where: str) -> None:
    """Raise JobError when a standard deviation of a length, in m, is given and out of range."""
    if value is not None:
        refuse_beyond(value, "instruments.sigma", where)


def parse_within(text: str, of: Range, where: str, error: type[CalibError] = JobError) -> float:
    """Return the SI value of a quantity like ``"0.02 mm"``, or raise ``error`` when it is none, or out of range."""
    value = parse_quantity(text, of.dimension, where, error)
    if not of.holds(value):
        raise error(f"{where}: {text!r} is out of range; allowed is {of}.")
    return value


def _si(of: Range) -> str:
    unit = next(unit.symbol for unit in UNITS.values() if unit.dimension == of.dimension and unit.factor == 1.0)
    return "" if unit == "1" else f" {unit}"
