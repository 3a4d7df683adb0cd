"""Units at the edges: SI inside, a unit on everything a user reads or writes.

The only place where a conversion factor stands, whether something is read, computed or shown.
"""

import math
import re
from dataclasses import dataclass
from typing import Literal, NamedTuple

from calib.foundations.errors import CalibError, JobError

Dimension = Literal[
    "length",
    "angle",
    "torque",
    "mass",
    "acceleration",
    "time",
    "temperature",
    "pixel",
    "turning compliance",
    "sliding compliance",
    "number",
]


@dataclass(frozen=True, slots=True)
class Unit:
    """A unit: ``si = factor * value``."""

    symbol: str
    dimension: Dimension
    factor: float


UNITS: dict[str, Unit] = {
    unit.symbol: unit
    for unit in (
        Unit("m", "length", 1.0),
        Unit("cm", "length", 1e-2),
        Unit("mm", "length", 1e-3),
        Unit("um", "length", 1e-6),
        Unit("inch", "length", 25.4e-3),
        Unit("rad", "angle", 1.0),
        Unit("mrad", "angle", 1e-3),
        Unit("urad", "angle", 1e-6),
        Unit("deg", "angle", math.pi / 180.0),
        Unit("Nm", "torque", 1.0),
        Unit("kg", "mass", 1.0),
        Unit("m/s2", "acceleration", 1.0),
        Unit("s", "time", 1.0),
        Unit("ms", "time", 1e-3),
        Unit("degC", "temperature", 1.0),
        Unit("px", "pixel", 1.0),
        Unit("rad/Nm", "turning compliance", 1.0),
        Unit("mrad/Nm", "turning compliance", 1e-3),
        Unit("urad/Nm", "turning compliance", 1e-6),
        Unit("m/N", "sliding compliance", 1.0),
        Unit("mm/N", "sliding compliance", 1e-3),
        Unit("um/N", "sliding compliance", 1e-6),
        Unit("1", "number", 1.0),
    )
}

# ``value / MM`` is a length in millimetres, ``5.0 * DEG`` an angle in rad.
MM, INCH, MRAD, DEG, MS = (UNITS[symbol].factor for symbol in ("mm", "inch", "mrad", "deg", "ms"))
MINUTE, MICRO = 60.0, 1e-6


class Display(NamedTuple):
    """What people are shown of an SI quantity: ``value * times``, in the unit ``symbol``."""

    times: float
    symbol: str


# By SI unit, and for joint readings by dimension.
DISPLAY = {
    "m": Display(1.0 / MM, "mm"),
    "rad": Display(1.0 / DEG, "deg"),
    "px": Display(1.0, "px"),
    "s": Display(1.0 / MS, "ms"),
    "s/s": Display(1.0 / MICRO, "us/s"),
    "decade": Display(1.0, "decade"),
    "Nm": Display(1.0, "Nm"),
}
DISPLAY_OF: dict[str, Display] = {"length": DISPLAY["m"], "angle": DISPLAY["rad"]}

# How others write them. Case is theirs, but for Nm, which is no nanometre.
_SPELLINGS: dict[str, tuple[str, ...]] = {
    "m": ("meter", "meters", "metre", "metres", "\u7c73"),
    "cm": ("centimeter", "centimeters", "centimetre", "centimetres"),
    "mm": (
        *("millimeter", "millimeters", "millimetre", "millimetres", "millim\u00e8tre", "millim\u00e8tres"),
        *("mil\u00edmetro", "mil\u00edmetros", "millimetri", "\u6beb\u7c73"),
    ),
    "um": ("\u00b5m", "\u03bcm", "micron", "microns", "micrometer", "micrometre"),
    "inch": ("in", "inches", "zoll"),
    "rad": ("radian", "radians", "\u5f27\u5ea6"),
    # Also what German calls them; the hundredth of a right angle, of surveyors, is "gon" there, and in no robot.
    "deg": (
        *("\u00b0", "\u00ba", "degree", "degrees", "grad", "degr\u00e9", "degr\u00e9s", "grado", "grados", "gradi"),
        "\u5ea6",
    ),
    "s": ("sec", "second", "seconds"),
    "ms": ("msec", "millisecond", "milliseconds"),
    "degC": ("\u00b0c", "\u00bac", "celsius", "deg c"),
    "px": ("pixel", "pixels"),
    "1": ("-",),
}
_SYMBOL_OF = {
    **{symbol.lower(): symbol for symbol in UNITS if symbol != "Nm"},
    **{spelling: symbol for symbol, spellings in _SPELLINGS.items() for spelling in spellings},
}


def symbol_of(text: str) -> str | None:
    """Return the symbol of a unit as others spell it, such as ``"\u00b0"`` or ``"Degrees"``; None where it is none."""
    text = text.strip()
    return text if text in UNITS else _SYMBOL_OF.get(text.lower())


# The plain decimal and exponent forms only: float() would also take 1_0, nan, inf and full-width digits.
NUMBER = re.compile(r"[+-]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][+-]?[0-9]+)?", re.ASCII)
NO_NUMBER = "is not a number like 12.5 or 1.25e1"
_QUANTITY = re.compile(rf"\s*({NUMBER.pattern})\s*([A-Za-z0-9/]*)\s*", re.ASCII)


def symbols(dimension: Dimension) -> tuple[str, ...]:
    """Return the symbols allowed for a dimension, in the order they are offered to a user."""
    return tuple(unit.symbol for unit in UNITS.values() if unit.dimension == dimension)


def unit_of(symbol: str, dimension: Dimension, where: str, error: type[CalibError] = JobError) -> Unit:
    """Return the unit ``symbol`` of the given dimension, or raise ``error`` with a sentence."""
    unit = UNITS.get(symbol)
    if unit is None or unit.dimension != dimension:
        allowed = ", ".join(symbols(dimension))
        raise error(f"{where}: unit {symbol!r} is not a unit of {dimension}; allowed are {allowed}.")
    return unit


def parse_quantity(text: str, dimension: Dimension, where: str, error: type[CalibError] = JobError) -> float:
    """Return the SI value of a quantity like ``"0.02 mm"``.

    Raises ``error`` when there is no finite number, no unit, or a unit of another dimension.
    """
    match = _QUANTITY.fullmatch(text)
    if match is None:
        raise error(f"{where}: {text!r} is not a number with a unit, like {example_of(dimension)!r}.")
    if not match[2]:
        raise error(f"{where}: {text!r} has no unit; allowed are {', '.join(symbols(dimension))}.")
    value = float(match[1]) * unit_of(match[2], dimension, where, error).factor
    if not math.isfinite(value):
        raise error(f"{where}: {text!r} is not a finite number.")
    return value


def example_of(dimension: Dimension) -> str:
    """Return a quantity of a dimension as a message shows one."""
    common = {"length": "0.02 mm", "angle": "0.01 deg", "mass": "5 kg", "time": "0.1 s", "pixel": "0.2 px"}
    rarer = {"acceleration": "9.81 m/s2", "turning compliance": "10 urad/Nm"}
    return (common | rarer).get(dimension, f"1.5 {symbols(dimension)[0]}")
